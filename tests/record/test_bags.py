"""ROS bags: what is taken of them, and what is asked."""

from __future__ import annotations

import functools
import json
import os
import re
import sqlite3
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import plants
import pytest
from bag_files import KINDS, BagFile
from record_tables import URDF, needs_data

from hil.cli import main
from hil.record import binary_tables
from hil.record.bags import BagChoice, is_bag, read_bag
from hil.record.locked import called_in
from hil.record.mcap_read import load
from hil.record.recording import LOCKED
from hil.record.sources import load_source

NAMES = ("elbow", "shoulder")  # as a driver may order them; the robot's order is the other
T = np.arange(300) * 0.004


@pytest.fixture(autouse=True, scope="module")
def read_once():
    """A bag that a test reads several times is read by one process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(binary_tables, "read_arrays", functools.cache(binary_tables.read_arrays))
        yield


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The simple bag, for tests that leave it as it is."""
    return simple(tmp_path_factory.mktemp("plain"), "mcap")


def motion(t=T):
    q = np.stack([np.sin(3 * t), 0.5 * np.cos(5 * t)], axis=1)
    qd = np.stack([3 * np.cos(3 * t), -2.5 * np.sin(5 * t)], axis=1)
    return q, qd, 2 * q + 0.3 * qd


def simple(folder, kind="db3", name="run", **more):
    """Bag of one joint state topic and the robot's description."""
    with BagFile(folder, kind, name) as bag:
        bag.joints("/joint_states", T, NAMES, *motion(), **more)
        bag.description(URDF)
    return bag.path


@pytest.mark.parametrize("kind", KINDS)
def test_each_generation_comes_back_exactly_in_the_order_of_the_robot(tmp_path, kind):
    (r,) = read_bag(simple(tmp_path, kind))
    q, qd, tau = motion()
    assert r.joints == ("shoulder", "elbow")
    np.testing.assert_array_equal(r.q, q[:, ::-1])
    np.testing.assert_array_equal(r.qd, qd[:, ::-1])
    np.testing.assert_array_equal(r.tau, tau[:, ::-1])
    np.testing.assert_allclose(r.t, T, atol=1e-9)
    assert r.robot.urdf == URDF
    assert "/joint_states" in r.metadata["note"]


def test_a_description_of_the_bags_own_is_said(tmp_path):
    for choice, own in ((BagChoice(), True), (BagChoice(robot=URDF), False)):
        (r,) = read_bag(simple(tmp_path, name=f"run{own}"), choice)
        assert ("robot: the description in the bag" in r.metadata["note"]) is own


@pytest.mark.parametrize("kind", ["mcap", "db3"])
def test_a_file_of_a_folder_is_a_bag_without_its_metadata(tmp_path, kind):
    file = next(simple(tmp_path, kind).glob(f"*.{kind}"))
    alone = file.rename(tmp_path / f"alone.{kind}")
    (r,) = read_bag(alone)
    np.testing.assert_array_equal(r.q, motion()[0][:, ::-1])


def test_the_stamp_of_the_message_counts_not_its_reception(tmp_path):
    late = np.random.default_rng(1).integers(0, 3_000_000)
    with BagFile(tmp_path, "db3") as bag:
        bag.joints("/joint_states", T[::2], NAMES, *(x[::2] for x in motion()), late=int(late))
        bag.joints("/joint_states", T[1::2], NAMES, *(x[1::2] for x in motion()))
    (r,) = read_bag(bag.path, BagChoice(robot=URDF))
    np.testing.assert_allclose(r.t, T, atol=1e-9)
    np.testing.assert_array_equal(r.q, motion()[0][:, ::-1])


def test_without_stamps_the_reception_counts_and_that_is_said(tmp_path):
    (r,) = read_bag(simple(tmp_path, stamped=False))
    np.testing.assert_allclose(r.t, T, atol=1e-9)
    assert "times of reception" in r.metadata["note"]


def test_two_publishers_on_one_topic_are_told_apart(tmp_path):
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/joint_states", T, NAMES, *motion())
        bag.joints("/joint_states", T + 0.001, ["finger"], 0.02 + 0 * T[:, None])
    (r,) = read_bag(bag.path)
    assert r.joints == NAMES
    np.testing.assert_array_equal(r.q, motion()[0])


def test_efforts_of_another_topic_at_another_rate_and_gaps(tmp_path):
    slow = np.arange(0.1, 1.0, 0.01)
    slow = slow[(slow < 0.4) | (slow > 0.6)]
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/joint_states", T, NAMES, motion()[0])
        bag.numbers("/commands", slow, np.stack([slow, 2 * slow], axis=1))
    with pytest.raises(ValueError, match=r"--effort-topic \(/commands\)"):
        read_bag(bag.path)
    (r,) = read_bag(bag.path, BagChoice(effort_topic="/commands", joints=NAMES))
    np.testing.assert_allclose(r.tau, np.stack([r.t, 2 * r.t], axis=1), atol=1e-9)
    assert r.t[0] >= 0.1 - 1e-9
    assert r.t[-1] <= slow[-1] + 1e-9
    assert not np.any((r.t > 0.4) & (r.t < 0.6))
    assert r.qd is None
    assert "left out" in r.metadata["note"]


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_the_state_of_a_trajectory_controller(tmp_path, kind):
    with BagFile(tmp_path, kind) as bag:
        bag.controller("/arm_controller/state", T, NAMES, *motion())
    (r,) = read_bag(bag.path)
    np.testing.assert_array_equal(r.tau, motion()[2])


def test_a_controller_whose_type_the_bag_does_not_define(tmp_path):
    with BagFile(tmp_path, "db3") as bag:
        bag.controller("/arm_controller/state", T, NAMES, *motion())
    file = next(bag.path.glob("*.db3"))
    with sqlite3.connect(file) as data:  # as before Iron
        data.execute("delete from message_definitions")
    (r,) = read_bag(file.rename(tmp_path / "old.db3"))
    assert r.joints == NAMES
    np.testing.assert_array_equal(r.q, motion()[0])


def test_a_controllers_state_beside_the_joint_states_is_not_in_doubt(tmp_path):
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/joint_states", T, NAMES, *motion())
        bag.controller("/arm_controller/state", T, NAMES, *motion())
    (r,) = read_bag(bag.path)
    assert "not used: /arm_controller/state" in r.metadata["note"]


def test_two_arms_by_the_names_of_crtk(tmp_path):
    q, qd, tau = motion()
    with BagFile(tmp_path, "bag") as bag:
        for sign, arm in ((1, "PSM1"), (-1, "PSM2")):
            bag.joints(f"/{arm}/measured_js", T, ["yaw", "pitch"], sign * q, qd, 0 * tau)
            bag.joints(f"/{arm}/setpoint_jf", T, ["yaw", "pitch"], None, None, sign * tau)
    found = {r.arm: r for r in read_bag(bag.path)}
    assert set(found) == {"PSM1", "PSM2"}
    np.testing.assert_array_equal(found["PSM2"].q, -q)
    np.testing.assert_array_equal(found["PSM2"].tau, -tau)
    (one,) = read_bag(bag.path, BagChoice(arm="PSM2"))
    assert one.arm == "PSM2"


def test_several_joint_states_are_asked_about(tmp_path):
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/left/joint_states", T, NAMES, *motion())
        bag.joints("/right/joint_states", T, NAMES, *motion())
    with pytest.raises(ValueError, match=r"--topic.*/left/joint_states.*/right/joint_states"):
        read_bag(bag.path)
    (r,) = read_bag(bag.path, BagChoice(topic="/right/joint_states"))
    assert r.n == T.size


def test_a_force_is_turned_into_the_base(tmp_path):
    wrench = np.tile([1.0, 2.0, 3.0, 0.1, 0.2, 0.3], (T.size, 1))
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/joint_states", T, NAMES, *motion())
        bag.force("/ft", T, wrench, "hand")
        bag.description(URDF)
    (plain,) = read_bag(bag.path)
    assert plain.wrench is None
    (r,) = read_bag(bag.path, BagChoice(force_topic="/ft"))
    angle = r.q.sum(axis=1)  # both joints turn about y
    c, s = np.cos(angle), np.sin(angle)
    np.testing.assert_allclose(r.wrench[:, 0], c * 1 + s * 3, atol=1e-12)
    np.testing.assert_allclose(r.wrench[:, 2], -s * 1 + c * 3, atol=1e-12)
    np.testing.assert_allclose(r.wrench[:, 5], -s * 0.1 + c * 0.3, atol=1e-12)
    assert r.robot.tip == "hand"


def test_what_stands_still_or_has_no_effort_is_locked_where_it_stood(tmp_path):
    q, qd, tau = motion()
    still = np.column_stack([q[:, 0], np.full(T.size, 0.7)])
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/joint_states", T, NAMES, still, qd, tau)
        bag.description(URDF)
    (r,) = read_bag(bag.path)
    assert r.joints == ("elbow",)
    assert json.loads(r.metadata[LOCKED]) == {"shoulder": 0.7}
    assert "locked: shoulder at 0.7" in r.metadata["note"]
    (both,) = read_bag(bag.path, BagChoice(joints=("shoulder", "elbow")))
    assert both.joints == ("shoulder", "elbow")


def test_efforts_that_are_missing_are_left_out_and_told(tmp_path):
    q, qd, tau = motion()
    holes, never = tau.copy(), tau.copy()
    holes[40, 0] = np.nan
    never[:, NAMES.index("elbow")] = np.nan
    runs = []
    for name, efforts in (("holes", holes), ("never", never)):
        with BagFile(tmp_path, "mcap", name) as bag:
            bag.joints("/joint_states", T, NAMES, q, qd, efforts)
            bag.description(URDF)
        runs += read_bag(bag.path)
    assert runs[0].n == T.size - 1 and "1 message of 300 left out" in runs[0].metadata["note"]
    assert runs[1].joints == ("shoulder",)
    assert "of these elbow moved without an effort" in runs[1].metadata["note"]
    for choice in (BagChoice(joints=("shoulder",)), BagChoice(lock={"elbow": 0.0})):
        (run,) = read_bag(tmp_path / "holes", choice)  # its effort changes; nobody wants it
        assert "of these elbow moved" in run.metadata["note"]
        assert "without an effort" not in run.metadata["note"]


def test_a_joint_of_which_nothing_is_known_is_locked_without_a_word(tmp_path):
    q, qd, tau = motion()
    unknown = q.copy()
    unknown[:, NAMES.index("elbow")] = np.nan
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/joint_states", T, NAMES, unknown, qd, tau)
        bag.description(URDF)
    (r,) = read_bag(bag.path)
    assert r.joints == ("shoulder",) and "moved without" not in r.metadata["note"]


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        (BagChoice(topic="/joint_state"), "joint_states"),
        (BagChoice(effort_topic="/tau"), "/joint_states"),
        (BagChoice(force_topic="/ft"), "force topic"),
        (BagChoice(joints=("elbw",)), "elbow"),
        (BagChoice(lock={"finger": 0.0}), "moving joint"),
        (BagChoice(joints=("elbow",), lock={"elbow": 0.0}), "choose one"),
    ],
)
def test_what_is_not_there_is_said(plain, choice, said):
    with pytest.raises(ValueError, match=said):
        read_bag(plain, choice)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("a", "a"), r"the messages of /joint_states name a joint twice \('a', 'a'\)"),
        ((), "the messages of /joint_states name no joint"),
        (("jo int ü", "x\ny"), r"/joint_states: joint 2 has the name 'x\\ny'; expected a word"),
        (("", "b"), "joint 1 has the name ''"),
    ],
)
def test_names_that_no_session_gives_back_are_refused_at_the_import(tmp_path, names, said, capsys):
    with BagFile(tmp_path, "mcap", "b") as bag:
        bag.joints("/joint_states", T, names, *motion())
    assert main(["import", str(bag.path), "-o", str(tmp_path / "s.mcap")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and re.search(said, error)
    assert not (tmp_path / "s.mcap").exists()


def test_a_robot_of_other_joints_is_refused(plain):
    other = URDF.replace('"shoulder"', '"a"').replace('"elbow"', '"b"')
    with pytest.raises(ValueError, match=r"another robot.*a, b.*elbow, shoulder"):
        read_bag(plain, BagChoice(robot=other))


def test_names_that_differ_in_a_prefix_are_the_same_joints(tmp_path):
    """One maker's arm is panda_joint1 in one URDF and fer_joint1 in another."""
    urdf = URDF.replace('"shoulder"', '"panda_joint1"').replace('"elbow"', '"panda_joint2"')
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/joint_states", T, ("fer_joint2", "fer_joint1"), *motion())
    for joints in ((), ("fer_joint1", "fer_joint2")):
        (r,) = read_bag(bag.path, BagChoice(robot=urdf, joints=joints))
        assert r.joints == ("panda_joint1", "panda_joint2")
        np.testing.assert_array_equal(r.q, motion()[0][:, ::-1])
        assert "calls panda_joint1 fer_joint1" in r.metadata["note"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_bag_is_refused_with_one_line(tmp_path, kind, capsys):
    path = simple(tmp_path, kind)
    file = path if path.is_file() else next(path.glob(f"*.{kind}"))
    data = bytearray(file.read_bytes())
    data[40 : len(data) // 2] = bytes(len(data) // 2 - 40)
    file.write_bytes(data)
    assert main(["import", str(path), "-o", str(tmp_path / "s.mcap")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "bag" in error
    assert not (tmp_path / "s.mcap").exists()


def test_import_then_load_is_the_bag(tmp_path, plain, capsys):
    path = plain
    words = ["import", str(path), "-o", str(tmp_path / "s.mcap"), "--joints", "elbow"]
    assert main([*words, "--lock", "shoulder=0.25"]) == 0
    said = capsys.readouterr().out
    assert "positions of /joint_states" in said
    assert "locked: shoulder at 0.25" in said
    back, direct = load(tmp_path / "s.mcap"), read_bag(path, BagChoice(joints=("elbow",)))[0]
    np.testing.assert_array_equal(back.q, direct.q)
    assert back.joints == ("elbow",)
    assert json.loads(back.metadata[LOCKED]) == {"shoulder": 0.25}
    assert not is_bag(tmp_path / "s.mcap")
    assert load_source(tmp_path / "s.mcap").joints == ("elbow",)
    assert main([*words[:4], "--all-runs"]) == 2
    assert "--all-runs" in capsys.readouterr().err


def test_options_of_bags_are_refused_for_tables(tmp_path, capsys):
    table = tmp_path / "t.csv"
    table.write_text("t,q1,tau1\n0,0,0\n")
    assert main(["import", str(table), "-o", str(tmp_path / "s.mcap"), "--topic", "/x"]) == 2
    assert "--topic" in capsys.readouterr().err


@pytest.mark.parametrize("option", [("--unit", "deg"), ("--force-axes", "hand")])
def test_options_of_tables_are_refused_for_bags(tmp_path, plain, capsys, option):
    assert main(["import", str(plain), "-o", str(tmp_path / "s.mcap"), *option]) == 2
    assert f"leave {option[0]} out" in capsys.readouterr().err


def test_an_analysis_takes_a_bag(plain, capsys):
    assert main(["compare", str(plain), "--json"]) == 0
    done = capsys.readouterr()
    assert "positions of /joint_states" in done.err
    assert [j["name"] for j in json.loads(done.out)["joints"]] == ["shoulder", "elbow"]


@needs_data
def test_published_bags():
    folder = Path(os.environ["HIL_DATA"]) / "ros2_bags"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    (r,) = read_bag(folder / "ur10_exciting_trajectory.db3")
    assert r.joints[:2] == ("shoulder_pan_joint", "shoulder_lift_joint")
    assert (r.n, round(r.rate)) == (3441, 125)


def test_a_motion_is_planned_from_a_bag(tmp_path, capsys):
    t = np.arange(2000) / 500.0
    q = np.sin(1.3 * t)[:, None]
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/joint_states", t, ["knee"], q, 1.3 * np.cos(1.3 * t)[:, None], 0.2 * q)
    out = tmp_path / "m.toml"
    words = ["excite", str(bag.path), "--seconds", "6", "-o", str(out)]
    assert main([*words, "--for", "cogging", "--motion", "multisine"]) == 0
    from hil.excite import trajectory

    assert trajectory.read_trajectory(out).joints == ("knee",)
    assert "'hil run' plays on the arms of a rig file only" in capsys.readouterr().out


def test_a_joint_that_turns_on_is_unwrapped(tmp_path):
    q, qd, tau = motion()
    q = q * 4
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/joint_states", T, NAMES, (q + np.pi) % (2 * np.pi) - np.pi, qd, tau)
        bag.description(URDF)
    (r,) = read_bag(bag.path)
    assert np.abs(r.q - q[:, ::-1] - (r.q - q[:, ::-1])[0]).max() < 1e-9
    assert "wraps at 2 pi" in r.metadata["note"]


def test_a_dry_run_shows_what_would_be_taken_of_a_bag(plain, tmp_path, capsys):
    assert main(["import", str(plain), "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "positions of /joint_states" in out and "nothing was written" in out
    assert "q1 [rad]" in out and f"{motion()[0][0, 1]:.6g}" in out
    assert main(["import", str(plain), "--dry-run", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["session"] is None and "/joint_states" in told["arms"][0]["taken"]
    assert main(["import", str(plain)]) == 2
    assert "--dry-run shows what would be read" in capsys.readouterr().err


@pytest.mark.slow
def test_topics_of_another_arm_that_is_taken_are_not_told_as_unused(tmp_path, capsys):
    """Two arms by CRTK's names: each says what nobody took, and faults say whose they are."""
    run = plants.joints(d=2)
    names, t = list(run.joints), run.t[:3000]
    q, tau = (np.ascontiguousarray(x[:3000]) for x in (run.q, run.tau))
    with BagFile(tmp_path, "mcap") as bag:
        for arm in ("PSM1", "MTML"):
            wrong = np.ascontiguousarray(50 * np.gradient(q, t, axis=0))
            bag.joints(f"/{arm}/measured_js", t, names, q, wrong)
            bag.joints(f"/{arm}/setpoint_jf", t, names, None, None, tau)
        bag.force("/spare/wrench", t[:50], np.ones((50, 6)), "tip")
    words = ["import", str(bag.path), "-o", str(tmp_path / "s.mcap")]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert out.count("not used: /spare/wrench\n") == 2
    for arm in ("PSM1", "MTML"):
        assert f"warning [velocity-scale] {arm} {names[0]}: qd1 is 50 times" in out
    assert main([*words, "--topic", "/PSM1/measured_js"]) == 0
    assert "not used: /MTML/measured_js, /MTML/setpoint_jf, " in capsys.readouterr().out


def test_joints_beyond_those_of_the_bag_do_not_hide_a_prefix(tmp_path):
    """A stock arm with fingers was "of another robot"; two arms that both fit are not guessed."""
    urdf = URDF.replace('"shoulder"', '"panda_joint1"').replace('"elbow"', '"panda_joint2"')
    finger = (
        '<link name="finger"/><joint name="panda_finger_joint1" type="prismatic">'
        '<parent link="{}"/><child link="finger"/><axis xyz="0 1 0"/>'
        '<limit lower="0" upper="0.04" effort="20" velocity="1"/></joint></robot>'
    )
    last = ET.fromstring(urdf).findall("link")[-1].get("name")
    stock = urdf.replace("</robot>", finger.format(last))
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/joint_states", T, ("fer_joint2", "fer_joint1"), *motion())
    (r,) = read_bag(bag.path, BagChoice(robot=stock))
    assert r.joints == ("panda_joint1", "panda_joint2")
    np.testing.assert_array_equal(r.q, motion()[0][:, ::-1])
    known = [f"{side}_{n}" for side in ("left", "right") for n in ("joint1", "joint2")]
    assert called_in(known, ["arm_joint1", "arm_joint2"], ()) == {}
    # what both hold decides, not a finger that one of them alone has
    three = ["fer_joint1", "fer_joint2", "fer_finger_joint2"]
    assert called_in(["panda_joint1", "panda_joint2", "panda_finger_joint1"], three, ()) == {
        "fer_joint1": "panda_joint1",
        "fer_joint2": "panda_joint2",
    }
    assert called_in(["panda_joint1", "panda_hand"], three, ()) == {}
    assert called_in(known[:2], ["arm_joint1", "arm_joint2"], ()) == {
        "arm_joint1": "left_joint1",
        "arm_joint2": "left_joint2",
    }


def test_joints_of_other_names_are_those_that_the_user_gives_in_their_order(tmp_path):
    """dVRK calls its joints yaw and pitch, the URDF of the arm otherwise."""
    with BagFile(tmp_path, "mcap") as bag:
        bag.joints("/PSM1/measured_js", T, ("pitch", "yaw"), *motion())
    with pytest.raises(ValueError, match="--joints in the order of the topic"):
        read_bag(bag.path, BagChoice(robot=URDF))
    (r,) = read_bag(bag.path, BagChoice(robot=URDF, joints=("elbow", "shoulder")))
    assert r.joints == ("shoulder", "elbow")
    np.testing.assert_array_equal(r.q, motion()[0][:, ::-1])
    assert "calls shoulder yaw" in r.metadata["note"]


def test_a_joint_that_is_spelt_otherwise_is_not_lost_in_silence(tmp_path):
    """It had been left out, and the joint of the URDF stood still at 0."""
    q, qd, tau = (np.stack([*x.T, x[:, 0]], axis=1) for x in motion())
    for name, said in (("elbow_", "a joint elbow_"), ("wheel", "")):
        names = ("shoulder", name, "third") if said else ("shoulder", "elbow", name)
        with BagFile(tmp_path, "mcap", name) as bag:
            bag.joints("/joint_states", T, names, q, qd, tau)
            bag.description(URDF)
        if said:
            with pytest.raises(ValueError, match=rf"{said}.*elbow, which the topic lacks"):
                read_bag(bag.path)
        else:
            (r,) = read_bag(bag.path)
            assert "not in the URDF, left out: wheel" in r.metadata["note"]


def test_what_a_controller_wants_and_a_jaw_that_rests_are_no_arms(tmp_path):
    """--arm did not choose between arms with efforts in setpoint_js; a gripper ended the import."""
    q, qd, tau = motion()
    with BagFile(tmp_path, "mcap") as bag:
        for sign, arm in ((1, "PSM1"), (-1, "PSM2")):
            for state in ("measured_js", "setpoint_js"):
                bag.joints(f"/{arm}/{state}", T, ["yaw", "pitch"], sign * q, qd, sign * tau)
            bag.joints(f"/{arm}/jaw/measured_js", T, ["jaw"], 0 * q[:, :1], None, None)
    assert [r.arm for r in read_bag(bag.path)] == ["PSM1", "PSM2"]
    (one,) = read_bag(bag.path, BagChoice(arm="PSM2"))
    np.testing.assert_array_equal(one.q, -q)


def test_a_bag_that_was_cut_off_is_recovered_as_a_bag(tmp_path, capsys):
    """It was refused without a way out, and what was recovered "is a session already"."""
    bag = simple(tmp_path, "mcap")
    whole = next(Path(bag).glob("*.mcap")) if Path(bag).is_dir() else Path(bag)
    cut, left = tmp_path / "cut.mcap", tmp_path / "left.mcap"
    cut.write_bytes(whole.read_bytes()[:-300])
    with pytest.raises(ValueError, match=r"hil info .*cut\.mcap --recover OUT\.mcap"):
        read_bag(cut)
    assert main(["info", str(cut), "--recover", str(left)]) == 0
    capsys.readouterr()
    assert is_bag(left)
    (r,) = read_bag(left)
    assert r.n > 0.5 * T.size and r.joints == ("shoulder", "elbow")
