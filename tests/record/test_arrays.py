"""Arrays and frames of a program become recordings, checked as tables are."""

from __future__ import annotations

import ast
import inspect
import pickle
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import plants
import polars as pl
import pyarrow as pa
import pytest

import hil
from hil.errors import ConfigError, DataError
from hil.models import robots
from hil.record.arrays import as_runs
from hil.record.recording import PRESETS, RobotSource

ARM = """<robot name="arm"><link name="base"/><link name="upper"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/></joint></robot>"""


@pytest.fixture(scope="module")
def plain():
    return plants.smooth_axis(seconds=2.0)


@pytest.fixture(scope="module")
def run():
    return plants.joints(d=3)


def two(run):
    return np.hstack([run.q, 2 * run.q]), np.hstack([run.tau, 3 * run.tau])


def test_arrays_are_the_recording(plain):
    q, tau = two(plain)
    run = hil.from_arrays(plain.t, q, tau, qd=q, wrench=np.ones((plain.n, 3)), joints=("a", "b"))
    assert run.joints == ("a", "b") and run.robot == RobotSource("single-axis")
    assert np.array_equal(run.q, q) and np.array_equal(run.tau, tau) and np.array_equal(run.qd, q)
    assert run.wrench.shape == (plain.n, 6) and not run.wrench[:, 3:].any()


def test_recordings_and_results_are_compared_as_the_objects_that_they_are(plain):
    """Arrays have no truth value: `run == other`, `run in runs` and sets had raised."""
    other = replace(plain)
    assert plain == plain and plain != other
    assert plain in [other, plain] and len({plain, other, plain}) == 2
    fitted = hil.fit(plain, hil.base_model(plain.robot))
    again = hil.fit(plain, hil.base_model(plain.robot))
    assert fitted == fitted and fitted != again and fitted in {fitted}


def test_one_joint_may_be_a_vector_and_a_list(plain):
    run = hil.from_arrays(list(plain.t), list(plain.q[:, 0]), plain.tau[:, 0])
    assert np.array_equal(run.q, plain.q)


@pytest.mark.parametrize("made", [pd.DataFrame, pl.DataFrame, dict, pa.table])
def test_a_frame_is_the_recording(plain, made):
    q, tau = two(plain)
    columns = {"t": plain.t, "q1": q[:, 0], "q2": q[:, 1], "tau1": tau[:, 0], "tau2": tau[:, 1]}
    words = ["a note"] * plain.n
    run = hil.from_arrays(made({**columns, "label": words}), name="lab")
    assert np.array_equal(run.q, q) and np.array_equal(run.tau, tau) and run.name == "lab"


def test_a_frame_of_other_names_takes_a_map(plain, tmp_path):
    place = tmp_path / "m.toml"
    place.write_text(
        '[columns]\nt = "time"\nq1 = { from = "angle", scale = 0.5 }\ntau1 = "torque"\n'
    )
    frame = pd.DataFrame({"time": plain.t, "angle": plain.q[:, 0], "torque": plain.tau[:, 0]})
    assert np.allclose(hil.from_arrays(frame, map=place).q, plain.q / 2)


def test_the_robot_is_a_file_a_text_or_that_of_another_run(plain, tmp_path):
    place = tmp_path / "arm.urdf"
    place.write_text(ARM)
    runs = [hil.from_arrays(plain.t, plain.q, plain.tau, robot=r) for r in (place, str(place), ARM)]
    runs.append(hil.from_arrays(plain.t, plain.q, plain.tau, robot=runs[0].robot))
    assert {r.joints for r in runs} == {("shoulder",)} and {r.robot.urdf for r in runs} == {ARM}


def test_a_recording_gives_its_samples_back(plain):
    frame = plain.to_frame()
    assert list(frame.columns) == ["t", "q1", "tau1"]
    again = hil.from_arrays(frame)
    assert np.array_equal(again.t, plain.t) and np.array_equal(again.tau, plain.tau)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda t, q, tau: (t, q.T, tau), "q has shape .*give its transpose"),
        (lambda t, q, tau: (t, q, np.hstack([tau, tau])), r"tau has shape .*expected \(1000, 1\)"),
        (lambda t, q, tau: (t[:-1], q, tau), r"q has shape \(1000, 1\); expected \(999, 1\)"),
        (lambda t, q, tau: (t, np.where(q > 0, np.nan, q), tau), "column 'q1' has .* missing"),
        (lambda t, q, tau: (t[::-1], q, tau), "time runs backward"),
        (lambda t, q, tau: (t, ["x"] * 1000, tau), "q is of type .*; expected real numbers"),
        (lambda t, q, tau: (t, q, tau + 1j), "tau is of type complex128"),
        (lambda t, q, tau: (t, q, None), "lacks tau"),
        (lambda t, q, tau: (t, None, None), "one frame with columns .*it got ndarray alone"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(plain, change, sentence):
    with pytest.raises((DataError, ConfigError), match=sentence) as caught:
        hil.from_arrays(*change(plain.t, plain.q, plain.tau))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ("run1.mcap", r"not str; hil.load\('run1.mcap'\) reads a session"),
        (["run1.csv"], r"hil.load\('run1.csv', robot=...\) reads a table"),
        (pd.DataFrame(), r"not DataFrame; hil.from_arrays\(frame"),
        (np.zeros(3), r"hil.from_arrays\(t, q, tau"),
        ([], "not an empty list"),
        (None, "not None"),
        (5, "not int"),
    ],
)
def test_a_verb_refuses_what_is_no_recording(given, sentence):
    with pytest.raises(ConfigError, match=sentence):
        as_runs(given, "hil.fit")


def test_one_run_stands_for_a_list_of_one(plain):
    assert as_runs(plain, "v") == [plain] == as_runs((plain,), "v") == as_runs(iter([plain]), "v")


def test_models_refuse_what_is_none(plain):
    model = hil.base_model(plain.robot)
    for given, sentence in (
        ("arm.urdf", "not str: a URDF is read with the recording"),
        (plain, r"hil.base_model\(run.robot\)"),
    ):
        with pytest.raises(ConfigError, match=sentence):
            hil.base_model(given)
    with pytest.raises(ConfigError, match=r"hil.read_model\('m.toml'\)"):
        hil.fit(plain, "m.toml")
    with pytest.raises(ConfigError, match=r"holdout of hil\.compare takes"):
        hil.compare(plain, model, holdout="other.mcap")


def test_the_verbs_are_listed():
    assert {"from_arrays", "diagnose", "fit", "load", "add"} <= set(dir(hil))
    assert "annotations" not in dir(hil) and "importlib" not in dir(hil)


def test_every_name_of_the_page_on_python_comes_with_hil_alone():
    page = (Path(__file__).parents[2] / "docs" / "python.md").read_text(encoding="utf-8")
    names = re.findall(r"^::: (hil\.[\w.]+)$", page, re.MULTILINE)
    assert {"hil.errors", "hil.testing", "hil.signals.device"} <= set(names)
    code = "import hil\n" + "\n".join(names)
    for first in ("", "hil.fit, hil.load\n"):
        done = subprocess.run(
            [sys.executable, "-c", code.replace("\n", f"\n{first}", 1)],
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr


def test_a_robot_that_there_is_none_of_is_refused_at_once(plain):
    for robot in ("nope", RobotSource("nope")):
        with pytest.raises(ConfigError, match=r"robot preset 'nope'.*phantom-omni"):
            hil.from_arrays(plain.t, plain.q, plain.tau, robot=robot)
    with pytest.raises(ConfigError, match="single-axis"):  # the nearest one is named
        hil.from_arrays(plain.t, plain.q, plain.tau, robot="single-axes")


def test_the_names_of_presets_are_those_of_the_robots():
    assert set(PRESETS) == set(robots.PRESET_ROBOTS)


def _framed(plain, t):
    return pd.DataFrame({"q1": plain.q[:, 0], "tau1": plain.tau[:, 0]}, index=t)


@pytest.mark.parametrize("how", ["named", "unnamed", "span", "date", "zone", "column", "utc"])
def test_the_time_of_a_frame_may_be_its_index_or_a_date(plain, how):
    t, date = plain.t, pd.Timestamp("2026-11-25 10:00")
    span = pd.to_timedelta(t, unit="s")
    frames = {
        "named": lambda: _framed(plain, pd.Index(t, name="t")),
        "unnamed": lambda: _framed(plain, t),
        "span": lambda: _framed(plain, span),
        "date": lambda: _framed(plain, date + span),
        "zone": lambda: _framed(plain, (date + span).tz_localize("Europe/Vienna")),
        "column": lambda: _framed(plain, None).assign(time=date + span),
        "utc": lambda: _framed(plain, None).assign(t=(date + span).tz_localize("UTC")),
    }
    run = hil.from_arrays(frames[how]())
    assert np.abs(run.t - run.t[0] - (t - t[0])).max() < 1e-6
    assert np.array_equal(run.q, plain.q)


def test_a_map_is_a_dictionary_and_missing_rows_are_dropped(plain):
    angle = np.degrees(plain.q[:, 0])
    angle[50:60] = np.nan
    frame = {"time_ms": 1e3 * plain.t, "angle": angle, "torque": plain.tau[:, 0]}
    said = {"columns": {"q1": {"from": "angle", "unit": "deg"}, "tau1": "torque"}}
    with pytest.raises(DataError, match=r'or missing="drop" or missing="interpolate"'):
        hil.from_arrays(frame, map=said)
    run = hil.from_arrays(frame, map=said, missing="drop")
    assert run.n == plain.n - 10
    np.testing.assert_allclose(run.q[:50], plain.q[:50])
    with pytest.raises(ConfigError, match=r"map of hil\.from_arrays: unknown key in the map"):
        hil.from_arrays(frame, map={"colums": {}})
    with pytest.raises(ConfigError, match="missing"):
        hil.from_arrays(frame, map=said, missing="skip")


def test_what_is_said_of_a_frame_is_said_in_python(plain):
    frame = {"time": plain.t, "angle": plain.q[:, 0], "torque": plain.tau[:, 0]}
    with pytest.raises(DataError, match=r"Rename with map=\{'columns': \{.*'q1': 'angle'") as told:
        hil.from_arrays(frame)
    assert "hil import" not in str(told.value)
    wide = 15 * plain.q / np.ptp(plain.q)
    with pytest.raises(DataError, match=r'Say unit="rad" if it turns so often') as told:
        hil.from_arrays(plain.t, np.vstack([wide, wide[::-1]])[: plain.n], plain.tau)
    assert hil.from_arrays(plain.t, wide, plain.tau, unit="rad").d == 1
    with pytest.raises(DataError, match="float32, which holds times since 1970 to 128 s"):
        hil.from_arrays((1.7e9 + plain.t).astype(np.float32), plain.q, plain.tau)


@pytest.mark.parametrize("given", [3, None, ["a.mcap"], pd.DataFrame({"t": [0.0]})])
def test_a_path_is_due_where_a_session_is_loaded(given):
    with pytest.raises(ConfigError, match=r"hil\.load takes the path of one session or bag, not"):
        hil.load(given)


def test_robot_and_joints_of_a_load(tmp_path):
    with pytest.raises(ConfigError, match=r"joints is a list of names, not of int; .*'joint1'"):
        hil.load("a.mcap", joints=3)
    with pytest.raises(ConfigError, match=r"robot .*none\.urdf cannot be read"):
        hil.load("a.mcap", robot=tmp_path / "none.urdf")


def test_what_is_said_of_a_robot_is_said_in_python(plain):
    with pytest.raises(DataError, match=r"as the robot \(--robot, or robot="):
        hil.from_arrays(plain.t, plain.q, plain.tau, robot="none.urdf")
    with pytest.raises(DataError, match=r'name the joints .* with joints=\["a", "b"\]'):
        hil.from_arrays(plain.t, *two(plain), robot=ARM)


def test_columns_that_hold_all_joints_are_columns_of_each(run):
    """A dictionary of arrays, and frames whose cells are lists, as those of LeRobot data sets."""
    given = {"t": run.t, "q": run.q, "tau": run.tau}
    listed = {key: list(x) if x.ndim == 2 else x for key, x in given.items()}
    for frame in (given, pd.DataFrame(listed), pl.DataFrame(listed)):
        found = hil.from_arrays(frame)
        np.testing.assert_array_equal(found.q, run.q)
        np.testing.assert_array_equal(found.tau, run.tau)


@pytest.mark.parametrize("joint_first", [False, True])
def test_columns_of_several_levels_are_named_in_the_refusal_and_read_as_it_says(run, joint_first):
    """The map of the message, as it stands there, reads the frame."""
    columns = {}
    for k in range(run.d):
        for what, x in (("position", run.q), ("effort", run.tau)):
            columns[(f"j{k + 1}", what) if joint_first else (what, f"j{k + 1}")] = x[:, k]
    frame = pd.DataFrame(columns, index=pd.Index(run.t, name="time"))
    with pytest.raises(DataError, match="has no column 'q1'") as refused:
        hil.from_arrays(frame)
    text = str(refused.value)
    said = ast.literal_eval(re.search(r"map=(\{.*\}), which", text)[1])
    found = hil.from_arrays(frame, map=said)
    np.testing.assert_array_equal(found.q, run.q)
    np.testing.assert_array_equal(found.tau, run.tau)


def test_values_under_a_mask_are_missing(plain):
    hidden = np.ma.array(plain.q[:, 0], mask=np.arange(plain.n) == 10)
    with pytest.raises(DataError, match="1 missing"):
        hil.from_arrays(plain.t, hidden, plain.tau)
    assert hil.from_arrays(plain.t, hidden, plain.tau, missing="drop").n == plain.n - 1


def test_a_lazy_frame_is_collected(plain):
    frame = pl.DataFrame({"t": plain.t, "q1": plain.q[:, 0], "tau1": plain.tau[:, 0]})
    assert hil.from_arrays(frame.lazy()).n == plain.n


def test_one_name_stands_for_a_list_of_joints(plain, tmp_path):
    run = hil.from_arrays(plain.t, plain.q[:, 0], plain.tau[:, 0], joints="shoulder")
    assert run.joints == ("shoulder",)
    with pytest.raises(DataError, match="No such file"):  # the name is taken
        hil.load(tmp_path / "a.mcap", joints="shoulder")
    with pytest.raises(ConfigError, match="joints is a list of names, not of int"):
        hil.from_arrays(plain.t, plain.q[:, 0], plain.tau[:, 0], joints=[3])


def test_arrays_say_which_joints_they_lock(plain):
    more = ARM.replace("</robot>", '<link name="hand"/><link name="palm"/></robot>').replace(
        "</robot>",
        '<joint name="wrist" type="continuous"><parent link="upper"/><child link="hand"/></joint>'
        '<joint name="grip" type="continuous"><parent link="hand"/><child link="palm"/></joint>'
        "</robot>",
    )
    q, tau = two(plain)
    run = hil.from_arrays(plain.t, q, tau, robot=more)
    assert run.joints == ("shoulder", "wrist")
    note = run.metadata["note"]
    assert "those of shoulder, wrist; locked: grip at 0 (joints=[...] and lock={...})" in note
    assert f"note: {note}" in str(run)
    chosen = hil.from_arrays(plain.t, q, tau, robot=more, joints=["shoulder", "grip"])
    assert chosen.metadata["note"] == "locked: wrist at 0"
    whole = hil.from_arrays(plain.t, plain.q[:, 0], plain.tau[:, 0], robot=ARM)
    assert "note" not in whole.metadata and "note:" not in str(whole)


def test_a_table_in_the_place_of_a_session_has_a_way_from_python(tmp_path):
    rows = "".join(f"{0.01 * k:.2f},{k % 7},{k % 5}\n" for k in range(200))
    (tmp_path / "run.csv").write_text("t,angle,torque\n" + rows)
    with pytest.raises(DataError, match=r"no column 'q1'.*--propose-map.*, and --map"):
        hil.load(tmp_path / "run.csv")
    (tmp_path / "lab.toml").write_text('[columns]\nq1 = "angle"\ntau1 = "torque"\n')
    run = hil.load(tmp_path / "run.csv", map=tmp_path / "lab.toml", unit="rad")
    assert run.n == 200 and np.ptp(run.q) == 6.0


def test_a_frame_without_times_takes_a_rate():
    frame = {"q1": np.sin(0.01 * np.arange(500)), "tau1": np.cos(0.01 * np.arange(500))}
    run = hil.from_arrays(frame, rate=250.0)
    assert run.t[1] == 0.004
    odd = hil.from_arrays({**frame, "t": 0.002 * np.arange(500)}, rate=100)
    assert odd.t[1] == 0.01 and "which in seconds says 500 Hz" in odd.metadata["note"]
    for load in (lambda r: hil.from_arrays(frame, rate=r), lambda r: hil.load("x.csv", rate=r)):
        with pytest.raises(ConfigError, match="rate is 0; expected samples per second"):
            load(0)
    with pytest.raises(DataError, match=r"map=\{'columns': \{'t': '\.\.\.'\}\}"):
        hil.from_arrays(frame)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: hil.add(1, 2, "spring", joint="a"), r"hil\.add\(recordings, .*mean 'joints'\?"),
        (lambda: hil.add(1, 2), r"hil\.add\(.*: missing a required argument: 'effect'"),
        (lambda: hil.load(), r"hil\.load\(path, .*'path'"),
        (lambda: hil.fit(1, 2, 3), r"hil\.fit\(recordings, model\): too many positional"),
        (lambda: hil.write_model("w.toml", MODEL), r"takes \(model, path\); path is RobotModel"),
        (lambda: hil.write_model(MODEL, 3), r"takes \(model, path\); path is int"),
        (lambda: hil.write_model(3, "w.toml"), r"hil\.write_model takes a RobotModel"),
        (lambda: hil.read_model(3), r"hil\.read_model takes the path of a model file, not int"),
        (lambda: MODEL + 3, r"a model takes an effect, not int; .*model \+ 'stribeck'"),
        (lambda: MODEL - 3, r"a model without an effect takes its name, not int"),
        (lambda: hil.Use(3), r"hil\.Use takes the name of an effect, not int"),
        (lambda: hil.Use("stribeck", 3), "joints is a list of names, not of int"),
        (lambda: hil.add(AXIS, MODEL, "spring", 3), "joints is a list of names, not of int"),
        (lambda: hil.refine(AXIS, MODEL), r"hil\.refine takes a fit, not Recording; hil\.fit"),
        (
            lambda: hil.ladder(MODEL),
            r"hil\.ladder takes a diagnosis, not RobotModel; hil\.diagnose",
        ),
        (lambda: hil.from_arrays(AXIS.columns(), map=5), "map is int; expected a map file"),
        (lambda: hil.from_arrays(AXIS.columns(), lock=5), "lock is 5; expected positions by"),
        (lambda: hil.load("x.csv", lock={"a": "1"}), "lock is .*; expected positions by joint"),
        (lambda: hil.from_arrays(AXIS.columns(), rate="5"), "rate is '5'; expected samples per"),
    ],
)
def test_a_wrong_argument_gets_one_sentence(call, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=said):
        call()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        (["a", "a"], "joints 1 and 2 have the same name, 'a'; give each its own"),
        (["a", ""], "joint 2 has the name ''; expected a word"),
        (["x\n", "y"], r"joint 1 has the name 'x\\n'; expected a word"),
        (["a\u202e", "y"], "joint 1 has the name"),
    ],
)
def test_names_of_joints_that_no_file_gives_back_are_refused(joints, said):
    t = np.arange(50) * 0.01
    q = np.stack([np.sin(t), np.cos(t)], axis=1)
    with pytest.raises(DataError, match=said):
        hil.from_arrays(t, q, q, joints=joints)
    assert hil.from_arrays(t, q, q, joints=["jo int", "ü"]).joints == ("jo int", "ü")


MODEL = hil.base_model(RobotSource("single-axis"))
AXIS = hil.from_arrays(np.arange(99) * 0.01, np.sin(np.arange(99)), np.cos(np.arange(99)))


def test_two_columns_of_one_name_are_refused():
    frame = pd.DataFrame(AXIS.columns())
    twice = pd.concat([frame, frame[["q1"]]], axis=1)
    with pytest.raises(DataError, match="column 'q1' stands twice in the frame"):
        hil.from_arrays(twice)


@pytest.mark.parametrize(
    "verb", [hil.fit, hil.compare, hil.diagnose, lambda *x: hil.add(*x, "spring")]
)
def test_runs_of_different_numbers_of_joints_are_refused(verb):
    two = hil.from_arrays(AXIS.t, np.tile(AXIS.q, 2), np.tile(AXIS.tau, 2), name="two")
    with pytest.raises(DataError, match="'two' has 2 joints but 'arrays' has 1; give sessions of"):
        verb([AXIS, two], MODEL)


def test_an_effect_takes_one_joint_as_a_text():
    assert hil.Use("stribeck", "shoulder") == hil.Use("stribeck", ("shoulder",))
    assert hil.Use("stribeck", ["a", "b"]).joints == ("a", "b")


def test_public_functions_are_one_object_and_travel_to_other_processes():
    assert hil.fit is hil.fit and pickle.loads(pickle.dumps(hil.fit)) is hil.fit
    assert "Fit all parameters" in hil.fit.__doc__
    assert list(inspect.signature(hil.fit).parameters) == ["recordings", "model"]


def test_a_run_that_is_given_twice_counts_once():
    run = plants.smooth_axis(1)
    again = replace(run, name="again")
    with pytest.warns(UserWarning, match="again holds the same data as .*; left out"):
        kept = as_runs([run, again], "hil.fit")
    assert len(kept) == 1 and kept[0] is run


@pytest.mark.parametrize("said", ["abc", "1.0", "1.0 2.0 3.0"])
def test_times_to_leave_out_that_are_none_are_refused_by_name(said):
    """A file may say anything in its metadata."""
    run = plants.smooth_axis(1)
    assert run.leaving_out([(1.0, 2.5), (4.0, 5.0)]).left_out == [(1.0, 2.5), (4.0, 5.0)]
    odd = replace(run, metadata={**run.metadata, "left_out_s": said})
    with pytest.raises(DataError, match=f"left_out_s = '{said}' in its metadata"):
        hil.fit([odd], hil.base_model(run.robot))
