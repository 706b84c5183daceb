"""Written feed-forwards, compiled and run: the efforts of our evaluation to 1e-9."""

import math
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import plants
import pytest
from export_reference import evaluated
from plants import serial_urdf

import hil
from hil.errors import ConfigError
from hil.export import code
from hil.export.content import Column, Content, Vocabulary, translate
from hil.export.target import Job, get, reduced, within
from hil.models import bodies
from hil.models.files import read_model, write_model
from hil.models.model import Use, base_model
from hil.models.robots import bare_robot
from hil.record.recording import RobotSource

RUNNERS = {
    "c": (code.run_c, ".h", ("cc", "gcc", "clang")),
    "cpp": (code.run_cpp, ".hpp", ("c++", "g++", "clang++")),
    "python": (code.run_python, ".py", ()),
}


def compiled(name):
    """Runner of a target, where this machine has what it takes."""
    run, ending, compilers = RUNNERS[name]
    if compilers and not any(shutil.which(x) for x in compilers):
        pytest.skip(f"no compiler here: {', '.join(compilers)}")
    return run, ending


def slowly(states):
    """The states, half of them as slow as a reversal."""
    q, v, a = states
    return q, np.where(np.arange(len(q))[:, None] % 2, v, 1e-3 * v), a


@pytest.mark.parametrize("name", RUNNERS)
def test_a_feed_forward_gives_our_efforts(name, made, states):
    run, ending = compiled(name)
    found, at = made(name), slowly(states)
    assert not found.lost
    ran = run(found.texts[ending], np.stack(at, axis=1))
    np.testing.assert_allclose(ran.efforts, evaluated(found.steps[-1], *at), rtol=0, atol=1e-9)
    still = np.zeros_like(at[0])
    body = found.steps[-1].result
    own = body.slices[[t.effect.name for t in body.terms].index("rigid-body")]
    weight = body.problem.robot.regressor(at[0], still, still) @ body.theta[own]
    np.testing.assert_allclose(ran.gravity, weight, rtol=0, atol=1e-9)
    assert np.max(np.abs(weight)) > 1.0
    # measured in both: by the target itself, and here
    assert all("cost of a call: " in x and "unknown" not in x for x in (found.notes[-1], ran.cost))


def _yaml(text):
    """Nested tables of the few forms that are written."""
    out, levels = {}, [(-1, None)]
    levels[0] = (-1, out)
    for line in text.splitlines():
        if line.startswith("#"):
            continue
        depth = len(line) - len(line.lstrip())
        key, _, value = line.strip().partition(":" if line.endswith(":") else ": ")
        while levels[-1][0] >= depth:
            levels.pop()
        key = key.strip('"')
        if value:
            levels[-1][1][key] = eval(value, {"__builtins__": {}})
        else:
            levels[-1][1][key] = {}
            levels.append((depth, levels[-1][1][key]))
    return out


def test_ros_2_parameters_say_the_same_model(made, states):
    found, (q, v, a) = made("ros2"), slowly(states)
    told = _yaml(found.texts[".yaml"])["/**"]["ros__parameters"]
    table = {k: np.array(x) for k, x in told["bodies"].items()}
    d = len(told["joints"])
    y = bodies.regressor(
        table["parent"],
        table["turn"].reshape(-1, 3, 3),
        table["place"].reshape(-1, 3),
        table["axis"].reshape(-1, 6),
        table["gravity_vector"],
        q,
        v,
        a,
    )
    tau = y @ table["body"]
    functions = {n: getattr(math, n) for n in ("sin", "cos", "exp", "tanh")}
    functions |= {"abs": abs, "max": max, "min": min}
    for j in range(d):
        own = told["columns"][told["joints"][j]]
        for value, text in zip(own["values"], own["formulas"], strict=True):
            for k in range(len(q)):
                at = {"q": q[k, j], "v": v[k, j], "a": a[k, j]}
                tau[k, j] += value * eval(text, {"__builtins__": {}}, functions | at)
    np.testing.assert_allclose(tau, evaluated(found.steps[-1], q, v, a), rtol=0, atol=1e-9)
    # a list of ROS 2 holds one type, and is not empty
    flat = [*told["bodies"].values(), *(x["values"] for x in told["columns"].values())]
    assert all(x and len({type(n) for n in x}) == 1 for x in flat)


def _content(urdf, joints=(), columns=()):
    robot = bare_robot(RobotSource("" if urdf else "single-axis", urdf), joints)
    own = robot.prior if urdf else np.arange(1.0, 1.0 + len(joints))
    return Content(robot, urdf, (robot.tree.spread @ own).reshape(-1, 10), columns, {}, ())


@pytest.mark.parametrize("name", ["c", "python"])
def test_a_joint_that_follows_another_one(name):
    run, ending = compiled(name)
    urdf = serial_urdf(3).replace(
        '<axis xyz="0 1 0"/><limit',
        '<axis xyz="0 1 0"/><mimic joint="joint1" multiplier="-0.5" offset="0.2"/><limit',
        1,
    )
    content = _content(urdf)
    d = len(content.robot.joints)
    assert d == 2 and len(content.tree.joints) == 3
    at = np.random.default_rng(0).normal(size=(20, 3, d))
    text = get(name).write(content, "two", ())[ending]
    wanted = content.robot.regressor(*at.transpose(1, 0, 2)) @ content.robot.prior
    np.testing.assert_allclose(run(text, at).efforts, wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", RUNNERS)
def test_axes_that_do_not_feel_each_other(name):
    run, ending = compiled(name)
    content, at = _content("", ("x", "y")), np.random.default_rng(0).normal(size=(5, 3, 2))
    text = get(name).write(content, "class", ())[ending]
    np.testing.assert_allclose(run(text, at).efforts, at[:, 2] * [1.0, 2.0], atol=1e-12)


@pytest.mark.parametrize("name", RUNNERS)
def test_friction_that_follows_another_joint(name):
    run, ending = compiled(name)
    known = {"v0": 0.05, "q0": 0.2}
    rubs = "sign * abs(qk - q0)", "sign * (qk - q0) ** 2", "tanh(vk / v0)"
    columns = [Column("rubs", 0, x, 0.5 + k, known, 1) for k, x in enumerate(rubs)]
    content, at = _content("", ("x", "y"), columns), np.random.default_rng(0).normal(size=(9, 3, 2))
    q, v, a = at.transpose(1, 0, 2)
    bend, sign = np.abs(q[:, 1] - 0.2), np.tanh(v[:, 0] / 0.05)
    wanted = a * [1.0, 2.0]
    wanted[:, 0] += sign * (0.5 * bend + 1.5 * bend**2) + 2.5 * np.tanh(v[:, 1] / 0.05)
    text = get(name).write(content, "arm", ())[ending]
    np.testing.assert_allclose(run(text, at).efforts, wanted, atol=1e-12)
    np.testing.assert_allclose(content.effort(q, v, a), wanted, atol=1e-12)


@pytest.mark.parametrize("name", RUNNERS)
def test_a_name_of_a_users_file_never_becomes_code(name):
    run, ending = compiled(name)
    evil = '*/ int x = 1/0; /* \\\n"""\n#error @NAME@ ??/'
    content = _content("", (evil, "y"))
    content = replace(content, columns=())
    text = get(name).write(content, "arm", (evil,))[ending]
    at = np.ones((1, 3, 2))
    np.testing.assert_allclose(run(text, at).efforts, [[1.0, 2.0]])
    if ending != ".py":
        body = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
        assert "int x" not in body and "#error" not in text


@pytest.mark.skipif(shutil.which("cc") is None, reason="no compiler")
def test_what_a_program_does_not_call_is_no_warning(tmp_path):
    content = _content(serial_urdf(3))
    (tmp_path / "arm.h").write_text(get("c").write(content, "arm", ())[".h"])
    (tmp_path / "main.c").write_text('#include "arm.h"\nint main(void) { return 0; }\n')
    command = ["cc", "-std=gnu99", "-Wall", "-Werror", "main.c", "-o", "main", "-lm"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_missing_compiler_is_said(monkeypatch):
    monkeypatch.setattr(code.shutil, "which", lambda name: None)
    text = get("c").write(_content("", ("x",)), "arm", ())[".h"]
    said = code.run_c(text, np.zeros((1, 3, 1))).cost
    assert "unknown, no compiler here (cc, gcc, clang)" in said


def test_a_program_that_does_not_compile_is_an_error():
    compiled("c")
    text = (
        get("c").write(_content("", ("x",)), "arm", ())[".h"].replace("tau[j] = 0.0;", "tau[j] =;")
    )
    with pytest.raises(ConfigError, match="written program fails"):
        code.run_c(text, np.zeros((1, 3, 1)))


def test_names_of_files_become_names_of_programs():
    assert code.identifier("my arm-2") == "my_arm_2"
    assert code.identifier("2arm") == "model_2arm" and code.identifier("std") == "model_std"


def test_without_a_recording_it_is_only_translated(made, tmp_path):
    from hil.models.files import write_model

    place = tmp_path / "arm.toml"
    write_model(made("c").steps[-1].result.model, place)
    model = read_model(place)
    found = get("python").make(Job(model, Path("arm.toml"), "arm"))
    # nothing is lost, so nothing is said of what a loss costs
    assert not any("only, not refitted" in x for x in found.notes)
    assert "translated without a recording" in found.texts[".py"]
    assert not found.lost and not found.steps
    # a file of an earlier version does not state the range that a spring refers to
    old = replace(model, valid=tuple(replace(r, span=None) for r in model.valid))
    found = get("python").make(Job(old, Path("arm.toml"), "arm"))
    assert [x.partition(":")[0] for x in found.lost] == ["spring on upper"]
    assert any("only, not refitted" in x for x in found.notes)
    assert "--data" in found.lost[0]


def test_gravity_of_an_unknown_geometry_goes_with_the_model(tmp_path):
    run = plants.double_pendulum()
    path = tmp_path / "m.toml"
    # what a diagnosis adds: tests/diagnosis/test_unknown_robot.py
    model = base_model(run.robot) + "generic-gravity" + "generic-inertia" + "generic-posture"
    write_model(hil.fit([run], model).model, path)
    made = get("python").make(Job(read_model(path), path, "pendulum"))
    assert not any("generic" in x for x in made.lost)
    q = np.array([[0.0, 0.0], [0.5, -0.4], [-0.6, 0.3]])
    states = np.stack([q, np.zeros_like(q), np.zeros_like(q)], axis=1)
    both = 4 * np.cos(q.sum(axis=1))
    weight = np.stack([12 * np.cos(q[:, 0]) + both, both], axis=1)
    efforts = code.run_python(made.texts[".py"], states).efforts
    np.testing.assert_allclose(efforts, weight, atol=0.2)


def test_what_the_sensors_do_stays_in_the_fit_and_out_of_the_program():
    words = Vocabulary()
    model = base_model(RobotSource("single-axis")) + "encoder-eccentricity" + "friction-drift"
    left, lost = reduced(model, words, ("joint1",))
    assert "encoder-eccentricity" in left.names() and "friction-drift" not in left.names()
    assert [x.effect for x in lost] == ["friction-drift"]


def test_simple_friction_stands_for_a_law_that_was_all_the_friction_of_its_joint():
    """A program that lost the presliding of such a joint had no dry friction at all."""
    runs = [plants.smooth_axis(k, 6.0, 250.0) for k in range(2)]
    base = base_model(runs[0].robot)
    model = replace(base, effects=tuple(u for u in base.effects if u.type != "coulomb"))
    found = within(model + "presliding", Vocabulary(), runs[:1], runs[1:])
    whole, left = found.steps
    assert left.heldout.relative[0] < 1.5 * whole.heldout.relative[0] + 0.5
    assert left.result.values["j1.coulomb.fc"].value == pytest.approx(0.3, rel=0.1)
    assert "coulomb on joint1 stands for presliding" in found.notes
    # what a model has of it stays alone, and a target without a word for it gets none
    assert "stands for" not in " ".join(within(base, Vocabulary(), runs[:1], []).notes)
    left, lost = reduced(model + "presliding", Vocabulary(columns=("v",)), ("joint1",))
    assert "coulomb" not in left.names() and "presliding" in {x.effect for x in lost}


def test_a_model_of_contact_has_no_feed_forward(arm):
    with pytest.raises(ConfigError, match="law of contact"):
        robot = bare_robot(arm.model.robot)
        translate(replace(arm.model, explains="external"), robot, Vocabulary())


def test_offsets_of_every_run_become_one_for_all():
    runs = [
        plants.smooth_axis(k, seconds=6.0, rate=250.0, extra=lambda t, q, v, a, z=z: z)
        for k, z in enumerate((0.1, 0.3, 0.2))
    ]
    model = base_model(runs[0].robot)
    model += Use("torque-offset", ("joint1",), options={"per_run": True})
    found = get("python").make(Job(model, Path("axis.toml"), "axis", runs))
    whole, within = (step.result for step in found.steps)
    assert [t.per_run for t in whole.terms if t.effect.name == "torque-offset"] == [True]
    assert [t.per_run for t in within.terms if t.effect.name == "torque-offset"] == [False]
    assert within.values["j1.torque-offset.t0"].value == pytest.approx(0.25, abs=0.02)
