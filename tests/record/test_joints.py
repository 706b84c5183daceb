"""Joints by name for tables, arrays and sessions: the others of a stock URDF are locked."""

from __future__ import annotations

import json

import numpy as np
import pytest
from test_locked import joint, link

import hil
from hil.cli import main
from hil.record.bags import BagChoice
from hil.record.export import write_recordings
from hil.record.locked import arm_joints, free_joints
from hil.record.mcap_read import load
from hil.record.recording import LOCKED
from hil.record.sources import load_source, load_sources

LIMIT = '<limit lower="-2" upper="2" effort="9" velocity="9"/>'


def gripper_arm(names=("b_shoulder", "a_elbow")):
    """Two joints and a gripper of two fingers, one of which mimics the other."""
    first, second = names
    mimic = LIMIT + '<mimic joint="finger1"/>'
    return "".join(
        [
            '<robot name="arm">',
            *(link(n, 1.0) for n in ("base", "upper", "fore")),
            *(link(n, 0.1) for n in ("finger_l", "finger_r")),
            joint(first, "revolute", "base", "upper"),
            joint(second, "revolute", "upper", "fore", "0 1 0"),
            joint("finger1", "prismatic", "fore", "finger_l"),
            joint("finger2", "prismatic", "fore", "finger_r", more=mimic),
            "</robot>",
        ]
    )


def motion(n=200):
    t = np.arange(n) * 0.004
    q = np.stack([np.sin(5 * t), 0.4 * np.cos(7 * t)], axis=1)
    return t, q, 2 * q


def table(folder):
    t, q, tau = motion()
    path = folder / "run.csv"
    rows = np.column_stack([t, q, tau])
    np.savetxt(path, rows, delimiter=",", header="t,q1,q2,tau1,tau2", comments="", fmt="%.17g")
    (folder / "arm.urdf").write_text(gripper_arm())
    return path


def imported(folder, *words):
    path = table(folder)
    out = folder / "s.mcap"
    assert (
        main(["import", str(path), "--robot", str(folder / "arm.urdf"), "-o", str(out), *words])
        == 0
    )
    return load(out)


def test_a_gripper_beyond_the_arm_is_locked_and_that_is_said(tmp_path, capsys):
    run = imported(tmp_path)
    said = capsys.readouterr().out
    assert run.joints == ("b_shoulder", "a_elbow")
    assert "those of b_shoulder, a_elbow; locked: finger1 at 0" in said
    assert json.loads(run.metadata[LOCKED]) == {"finger1": 0.0}
    assert [j.name for j in free_joints(run.robot.urdf)] == ["b_shoulder", "a_elbow"]


def test_joints_in_the_order_of_the_columns(tmp_path):
    """The columns may come in another order than the robot's joints."""
    _, q, tau = motion()
    run = imported(tmp_path, "--joints", "a_elbow,b_shoulder", "--lock", "finger1=0.02")
    assert run.joints == ("b_shoulder", "a_elbow")
    np.testing.assert_array_equal(run.q, q[:, ::-1])
    np.testing.assert_array_equal(run.tau, tau[:, ::-1])
    assert json.loads(run.metadata[LOCKED]) == {"finger1": 0.02}


def test_a_locked_joint_is_none_of_the_columns(tmp_path):
    """With one joint of the arm held the columns are of the others, the gripper aside."""
    t, q, tau = motion()
    run = hil.from_arrays(t, q[:, 0], tau[:, 0], robot=gripper_arm(), lock={"b_shoulder": 0.4})
    assert run.joints == ("a_elbow",)
    assert json.loads(run.metadata[LOCKED]) == {"b_shoulder": 0.4, "finger1": 0.0}


def test_joints_and_locks_of_a_map(tmp_path):
    path = tmp_path / "m.toml"
    path.write_text('[robot]\njoints = ["finger1", "b_shoulder"]\nlock = {a_elbow = 0.5}\n')
    run = imported(tmp_path, "--map", str(path))
    assert run.joints == ("b_shoulder", "finger1")
    assert json.loads(run.metadata[LOCKED]) == {"a_elbow": 0.5}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--joints", "a_elbow"], "1 moving joint (a_elbow), but 2 position columns"),
        (["--joints", "elbow,b_shoulder"], "a_elbow"),
        (["--joints", "a_elbow,a_elbow"], "names a joint twice"),
        (["--lock", "a_elbow=x"], "JOINT=X"),
        (["--joints", "a_elbow,b_shoulder", "--lock", "a_elbow=0"], "choose one"),
    ],
)
def test_joints_that_cannot_be_meant(tmp_path, capsys, words, said):
    path, out = table(tmp_path), str(tmp_path / "s.mcap")
    assert (
        main(["import", str(path), "--robot", str(tmp_path / "arm.urdf"), "-o", out, *words]) == 2
    )
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_only_an_arm_with_all_others_beyond_it_is_taken_without_names():
    assert arm_joints(gripper_arm(), 2) == ("b_shoulder", "a_elbow")
    assert arm_joints(gripper_arm(), 3) == ()  # nothing to lock
    assert arm_joints(gripper_arm(("b", "a")), 1) == ("b",)
    lift = gripper_arm().replace("</robot>", link("box", 1) + joint("z", "revolute", "base", "box"))
    assert arm_joints(lift + "</robot>", 2) == ()


def test_arrays_take_joints_by_name():
    t, q, tau = motion()
    run = hil.from_arrays(t, q, tau, robot=gripper_arm(), joints=("a_elbow", "b_shoulder"))
    assert run.joints == ("b_shoulder", "a_elbow")
    np.testing.assert_array_equal(run.q, q[:, ::-1])
    assert hil.from_arrays(t, q, tau, robot=gripper_arm()).joints == ("b_shoulder", "a_elbow")
    with pytest.raises(ValueError, match="lock is of the joints of a URDF"):
        hil.from_arrays(t, q, tau, lock={"finger1": 0.0})


def test_a_session_without_a_robot_takes_one_with_robot(tmp_path):
    path = table(tmp_path)
    assert main(["import", str(path), "-o", str(tmp_path / "s.mcap")]) == 0
    run = load_source(tmp_path / "s.mcap", choice=BagChoice(robot=gripper_arm()))
    assert run.joints == ("b_shoulder", "a_elbow")
    np.testing.assert_array_equal(run.q, motion()[1])
    locked = BagChoice(robot=gripper_arm(), lock={"a_elbow": 0.1})
    assert load_source(tmp_path / "s.mcap", choice=locked).joints == ("b_shoulder",)
    four = BagChoice(robot=gripper_arm().replace("prismatic", "fixed").replace("finger", "f"))
    assert load_source(tmp_path / "s.mcap", choice=four).joints == ("b_shoulder", "a_elbow")
    with pytest.raises(ValueError, match="of another robot"):
        load_source(tmp_path / "s.mcap", choice=BagChoice(robot=one_joint()))


def test_a_session_from_python_with_its_robot_and_joints(tmp_path):
    path = table(tmp_path)
    assert main(["import", str(path), "-o", str(tmp_path / "s.mcap")]) == 0
    urdf = str(tmp_path / "arm.urdf")
    run = hil.load(tmp_path / "s.mcap", robot=urdf, joints=["a_elbow"], lock={"b_shoulder": 0.3})
    assert run.joints == ("a_elbow",)
    np.testing.assert_array_equal(run.q[:, 0], motion()[1][:, 1])
    assert json.loads(run.metadata[LOCKED]) == {"finger1": 0.0, "b_shoulder": 0.3}
    with pytest.raises(ValueError, match=r"none.urdf cannot be read"):
        hil.load(tmp_path / "s.mcap", robot="none.urdf")


def test_what_is_judged_on_is_of_the_arm_that_is_fitted(tmp_path):
    """A held-out session with several arms gives the one that the fitted session has."""
    t, q, tau = motion()
    tail = hil.from_arrays(t, q, tau, arm="tail")
    write_recordings(str(tmp_path / "one.mcap"), [tail])
    other = hil.from_arrays(t, 2 * q, tau, arm="head")
    write_recordings(str(tmp_path / "two.mcap"), [other, tail])
    runs, held = load_sources([tmp_path / "one.mcap"], [tmp_path / "two.mcap"])
    assert (runs[0].arm, held[0].arm) == ("tail", "tail")
    np.testing.assert_array_equal(held[0].q, q)


def one_joint():
    parts = link("base", 1), link("arm", 1), joint("hinge", "revolute", "base", "arm")
    return f'<robot name="one">{"".join(parts)}</robot>'


# ------------------------------------------------------------ tables that are analysed as they are


def _table(path, head, scale=1.0, remark=""):
    """A table of an axis of 400 rows with these names of columns."""
    rows = []
    for k in range(400):
        t = 0.01 * k
        rows += [remark] if remark and k == 200 else []
        rows.append(f"{t:.2f},{scale * np.sin(3 * t + t * t):.9f},{np.cos(3 * t + t * t):.9f}")
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    "head", ["t [s],q1 [rad],tau1 [Nm]", "T,Q1,TAU1", "t,q (rad),TAU", "time,q0,tau0"]
)
def test_units_and_capitals_are_no_other_columns(tmp_path, head):
    run = hil.load(_table(tmp_path / "a.csv", head))
    assert run.n == 400 and run.tau[0, 0] == 1.0


def test_the_usual_name_of_a_speed_and_a_unit_that_is_not_si(tmp_path):
    path = _table(tmp_path / "a.csv", "t,q1 [deg],tau1", 90.0)
    assert np.ptp(hil.load(path).q) == pytest.approx(np.pi, rel=1e-3)
    frame = {"t": 0.01 * np.arange(50), "q": np.arange(50) ** 2 / 1e3, "tau": np.ones(50)}
    speed = np.gradient(frame["q"], 0.01)
    assert np.array_equal(hil.from_arrays({**frame, "dq": speed}).qd[:, 0], speed)


def test_a_remark_between_the_rows_is_no_sample(tmp_path):
    assert hil.load(_table(tmp_path / "a.csv", "t,q1,tau1", 1.0, "# a button")).n == 400


def test_an_analysis_takes_the_options_of_a_table(tmp_path, capsys):
    path = _table(tmp_path / "a.csv", "t,angle,tau1", 90.0)
    assert main(["fit", str(path)]) == 2
    assert "--propose-map" in (said := capsys.readouterr().err) and "--map MAP.toml" in said
    (tmp_path / "m.toml").write_text('[columns]\nq1 = "angle"\n')
    words = ["fit", str(path), "--map", str(tmp_path / "m.toml"), "--unit"]
    assert main([*words, "deg"]) == 0 and "rad/s" in capsys.readouterr().out
    assert main([*words, "m", "--quiet"]) == 0 and "m/s" in capsys.readouterr().out
    session = str(tmp_path / "s.mcap")
    assert main(["import", str(_table(tmp_path / "b.csv", "t,q1,tau1")), "-o", session]) == 0
    assert main(["fit", session, "--unit", "deg"]) == 2
    assert "--unit is of tables" in capsys.readouterr().err


def test_a_folder_of_tables_and_a_run_that_is_given_twice(tmp_path, capsys):
    for name in ("a.csv", "b.csv"):
        _table(tmp_path / name, "t,q1,tau1")
    (tmp_path / "notes.txt").write_text("a day in the lab\n")
    assert main(["fit", str(tmp_path)]) == 0
    assert "warning: b holds the same data as a; left out" in capsys.readouterr().err
    assert main(["import", str(tmp_path), "-o", str(tmp_path / "s.mcap")]) == 2
    assert "2 recordings would be written into a folder" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.mcap"))
    assert main(["import", str(tmp_path), "-o", str(tmp_path / "out")]) == 0
    written = {p.name for p in (tmp_path / "out").iterdir()}
    assert written == {"a.mcap", "b.mcap", "model.toml"}


def test_a_model_brings_its_robot_to_a_table_and_another_one_is_told(tmp_path, capsys):
    path = _table(tmp_path / "a.csv", "t,q1,tau1")
    link = '<link name="b"/><link name="l"><inertial><mass value="1"/><inertia ixx="1" iyy="1"'
    link += ' izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="hip" '
    link += 'type="continuous"><origin xyz="0 0 {}"/><parent link="b"/><child link="l"/>'
    for name, height in (("one", 0), ("two", 1)):
        text = f'<robot name="r">{link.format(height)}<axis xyz="0 0 1"/></joint></robot>'
        (tmp_path / f"{name}.urdf").write_text(text)
    words = ["fit", str(path), "--robot", str(tmp_path / "one.urdf"), "--quiet"]
    assert main([*words, "-o", str(tmp_path / "m.toml")]) == 0
    model = ["--model", str(tmp_path / "m.toml")]
    assert main(["fit", str(path), *model]) == 0
    assert "hip" in (said := capsys.readouterr()).out and "another robot" not in said.err
    assert main(["fit", str(path), "--robot", str(tmp_path / "two.urdf"), *model]) == 0
    assert "joint hip has the origin xyz 0 0 0 and not 0 0 1" in capsys.readouterr().err
    out = ["--motion", "rests", "-o", str(tmp_path / "x.toml"), "--json"]
    assert main(["excite", str(path), *model, "--for", "stribeck", *out]) in (0, 2)
    assert "TOML" not in capsys.readouterr().err
