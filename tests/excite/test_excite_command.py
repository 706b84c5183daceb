"""`hil excite` and `hil run --trajectory`: planned, played, refused."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.excite import trajectory
from hil.excite.trajectory import assumed, sample
from hil.models.urdf import UrdfRobot
from hil.record.mcap_read import load
from hil.rig.check import limits_of_arm
from hil.rig.config import load_rig, robot_source
from hil.work import listening

RIG = Path(__file__).parents[2] / "rigs" / "identify.toml"


def test_a_separating_motion_is_planned_and_played(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["excite", str(RIG), "--for", "stribeck,quadratic-drag", "--joint", "joint2"]
    assert main([*words, "--seconds", "8", "-o", "next.toml", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["schema"] == "hil.excite/1" and data["for"] == ["stribeck", "quadratic-drag"]
    assert data["menu"][0]["log_odds"] == max(m["log_odds"] for m in data["menu"])
    assert {m["what"].split()[0] for m in data["margins"]} >= {"position", "speed", "torque"}
    text = Path("next.toml").read_text()
    assert main([*words, "--seconds", "8", "-o", "again.toml"]) == 0
    assert Path("again.toml").read_text() == text
    assert (
        main(["run", str(RIG), "--trajectory", "next.toml", "-o", "s.mcap", "--seconds", "6"]) == 0
    )
    run, motion = load("s.mcap", "follower"), trajectory.read_trajectory("next.toml")
    late = run.t > 1.5
    wanted, _, _ = sample(motion, run.t[late])
    assert np.abs(run.q[late] - wanted).max() < 0.03


def test_one_line_of_the_rig_file_plays_a_trajectory(tmp_path, capsys):
    motion = ["excite", str(RIG), "--for", "cogging", "--joint", "joint1", "--motion", "rests"]
    assert main([*motion, "--seconds", "8", "-o", str(tmp_path / "m.toml")]) == 0
    text = RIG.read_text(encoding="utf-8")
    line = 'trajectory = "m.toml"\n'
    rig = tmp_path / "rig.toml"
    rig.write_text(text.replace("[controller.parameters]\n", "[controller.parameters]\n" + line))
    assert main(["run", str(rig), "--seconds", "2", "-o", str(tmp_path / "s.mcap")]) == 0
    moved = np.ptp(load(tmp_path / "s.mcap", "follower").q, axis=0)
    assert moved[0] > 0.02 and moved[1:].max() < 0.02


@pytest.mark.parametrize(("motion", "held"), [("rests", True), ("multisine", False)])
def test_joints_hold_their_place_only_where_the_motion_leaves_them(motion, held, tmp_path, capsys):
    """A motion of all joints shows all of them, also where one joint was asked about."""
    words = ["--for", "cogging", "--joint", "joint1", "--motion", motion, "--seconds", "8"]
    assert main(["excite", str(RIG), *words, "-o", str(tmp_path / "m.toml")]) == 0
    x = trajectory.read_trajectory(tmp_path / "m.toml")
    assert np.all(np.ptp(sample(x, np.linspace(0, x.period, 500))[0], axis=0) > 1e-3) is not held
    assert ("The other joints only hold their place" in capsys.readouterr().out) is held


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--for", "stribek"], "Did you mean 'stribeck'"),
        (["--for", "payload"], "one recording with and one without the mass"),
        (
            ["--for", "torque-offset,asymmetric-coulomb", "--joint", "joint2"],
            "no motion within the limits of this robot",
        ),
        (["--for", "torque-gain"], "hand force"),
        (["--for", "contact-damping"], "contact only"),
        (["--for", "coulomb"], "already in the model"),
        (["--for", "stribeck", "--joint", "elbow"], "unknown joint 'elbow'"),
        (["--for", "stribeck", "--arm", "folower"], "Did you mean 'follower'"),
        (["--joint", "joint1"], "need --for"),
        (["--seconds", "1"], "5 to 600"),
    ],
)
def test_mistakes_are_one_sentence(words, says, tmp_path, capsys):
    place = tmp_path / "x.toml"
    assert main(["excite", str(RIG), *words, "-o", str(place)]) == 2
    assert says in capsys.readouterr().err
    assert not place.exists()


def test_outputs_are_not_written_over(tmp_path, capsys):
    model = tmp_path / "m.toml"
    model.write_text('schema = "hil.model/1"\n', encoding="utf-8")
    assert main(["excite", str(RIG), "-o", str(model)]) == 2
    assert "not a trajectory file" in capsys.readouterr().err
    assert model.read_text(encoding="utf-8") == 'schema = "hil.model/1"\n'


def test_a_trajectory_beyond_the_limits_moves_no_motor(tmp_path, capsys):
    main(
        [
            "excite",
            str(RIG),
            "--for",
            "cogging",
            "--joint",
            "joint1",
            "--seconds",
            "8",
            "-o",
            str(tmp_path / "m.toml"),
        ]
    )
    narrow = tmp_path / "narrow.toml"
    rig = RIG.read_text(encoding="utf-8")
    limits = "position_min = [-0.1, 0.0, 0.0]\nposition_max = [0.1, 0.8, 0.6]\n"
    narrow.write_text(rig.replace("[arms.leader]\n", "[arms.leader]\n" + limits), "utf-8")
    capsys.readouterr()
    words = ["--trajectory", str(tmp_path / "m.toml"), "-o", str(tmp_path / "s.mcap")]
    assert main(["run", str(narrow), *words]) == 2
    error = capsys.readouterr().err
    assert "arm 'leader'" in error and "position joint1" in error
    assert main(["run", str(RIG.with_name("teleop.toml")), *words]) == 2
    assert "trajectory" in capsys.readouterr().err
    assert main(["run", str(RIG), "--trajectory", "none.toml", *words[2:]]) == 2
    assert "no such file" in capsys.readouterr().err
    assert not (tmp_path / "s.mcap").exists()


ARM = """<robot name="one"><link name="base"/><link name="l"><inertial><origin xyz="0.1 0 0"/>
<mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="j" type="revolute"><parent link="base"/><child link="l"/><axis xyz="0 1 0"/>
<limit {}/></joint></robot>"""


def planned(tmp_path, limits, *words):
    """Exit code of `hil excite` for an arm of one joint, 1 kg at 0.1 m, and what it has written."""
    (tmp_path / "arm.urdf").write_text(ARM.format(limits), encoding="utf-8")
    out = ["-o", str(tmp_path / "x.toml"), "--csv", str(tmp_path / "x.csv"), "--seconds", "8"]
    code = main(["excite", str(tmp_path / "arm.urdf"), *words, *out])
    return code, sorted(x.name for x in tmp_path.iterdir() if x.name != "arm.urdf")


@pytest.mark.parametrize(
    "words",
    [
        pytest.param((), marks=pytest.mark.slow),
        ("--for", "stribeck,presliding"),
        ("--for", "stribeck"),
    ],
)
def test_a_motion_that_no_size_brings_below_the_torque_limit_is_refused(tmp_path, capsys, words):
    weak = 'lower="-0.5" upper="2" velocity="1.5" effort="0.5"'
    assert planned(tmp_path, weak, *words) == (2, [])
    said = capsys.readouterr().err
    # 9.81 m/s^2 x 1 kg x 0.1 m x cos(0.75)
    assert "torque j" in said and "of 0.5 N m" in said and "Gravity alone takes 0.718 N m" in said
    assert "about another posture (at j = 1.5" in said and "larger torque limit" in said


def test_a_torque_that_gravity_leaves_nothing_of_for_friction_is_refused(tmp_path, capsys):
    weak = 'lower="-0.5" upper="2" velocity="1.5" effort="0.9"'
    assert planned(tmp_path, weak, "--for", "stribeck") == (2, [])
    said = capsys.readouterr().err
    assert "torque j" in said and "friction and what moves the rest" in said


def test_a_posture_in_which_gravity_takes_less_helps_as_it_says(tmp_path, capsys):
    upright = 'lower="1.2" upper="1.9" velocity="1.5" effort="0.5"'
    code, files = planned(tmp_path, upright, "--for", "stribeck", "--json")
    data = json.loads(capsys.readouterr().out)
    assert code == 0 and files == ["x.csv", "x.toml"] and data["assumed_limits"] == []
    (torque,) = (m for m in data["margins"] if m["what"] == "torque j")
    assert torque["used"] <= 0.8 * torque["limit"]


@pytest.mark.slow
def test_the_condition_number_is_also_said_with_the_torque_offset(tmp_path, capsys):
    strong = 'lower="-0.5" upper="2" velocity="1.5" effort="3"'
    assert planned(tmp_path, strong, "--json")[0] == 0
    data = json.loads(capsys.readouterr().out)
    rows = np.genfromtxt(tmp_path / "x.csv", delimiter=",", names=True)
    rows = rows[(rows["t"] >= 2.0) & (rows["t"] < 12.0)]  # one period
    q, v, a = rows["q1"], rows["qd1"], rows["qdd1"]
    # inertia, weight along and across, dry and viscous friction; then the offset
    x = np.column_stack([a, np.cos(q), np.sin(q), np.sign(v), v, np.ones_like(q)])
    x /= np.linalg.norm(x, axis=0)
    assert data["columns"] == 5
    assert data["condition"] == pytest.approx(np.linalg.cond(x[:, :5]), rel=0.1)
    assert data["condition_with_offset"] == pytest.approx(np.linalg.cond(x), rel=0.1)


def test_a_torque_limit_of_the_rig_file_is_kept_or_the_motion_refused(tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    weak = "[arms.leader]\ntorque_limit = [0.027, 0.027, 0.027]\n"
    rig.write_text(RIG.read_text(encoding="utf-8").replace("[arms.leader]\n", weak), "utf-8")
    words = ["--for", "stribeck", "--joint", "joint2", "--seconds", "8"]
    assert main(["excite", str(rig), *words, "-o", str(tmp_path / "x.toml")]) == 2
    said = capsys.readouterr().err
    assert "torque joint3" in said and "of 0.027 N m" in said and "Gravity alone takes" in said
    assert not (tmp_path / "x.toml").exists()


def test_limits_that_nobody_stated_are_told(tmp_path, capsys):
    still = 'lower="-0.5" upper="2" velocity="0" effort="3"'
    assert planned(tmp_path, still, "--for", "stribeck")[0] == 0
    assert "assumed, as the robot states none: speed j 1 rad/s;" in capsys.readouterr().out
    assert planned(tmp_path, 'effort="3" velocity="0"', "--for", "stribeck", "--json")[0] == 0
    assert json.loads(capsys.readouterr().out)["assumed_limits"] == [
        {"what": "position j", "values": pytest.approx([-np.pi / 2, np.pi / 2]), "unit": "rad"},
        {"what": "speed j", "values": [1.0], "unit": "rad/s"},
    ]


def test_limits_that_the_rig_file_gives_for_the_urdf_are_not_assumed(tmp_path, capsys):
    """A description without efforts and speeds is enough where the rig file has them."""
    text = (RIG.parent / "arm6.urdf").read_text(encoding="utf-8")
    bare, count = re.subn(r' (?:effort|velocity)="[^"]*"', "", text)
    assert count >= 12
    (tmp_path / "bare.urdf").write_text(bare, encoding="utf-8")
    rig, said = tmp_path / "rig.toml", (RIG.parent / "arm6.toml").read_text(encoding="utf-8")
    said = said.replace('"arm6.urdf"', '"bare.urdf"')
    rig.write_text(said, encoding="utf-8")
    assert main(["excite", str(rig), "-o", str(tmp_path / "x.toml")]) == 2
    assert re.search(r"bare\.urdf has no limit of effort above 0 for base", capsys.readouterr().err)
    efforts, speeds = [26.0, 50.0, 26.0, 9.0, 9.0, 9.0], [2.5, 2.5, 2.5, 4.0, 4.0, 4.0]
    given = f"[arms.arm]\ntorque_limit = {efforts}\nspeed_limit = {speeds}\n"
    rig.write_text(said.replace("[arms.arm]\n", given), encoding="utf-8")
    arm = load_rig(rig).arms["arm"]
    source = robot_source(arm)
    limits = limits_of_arm(arm, source)
    np.testing.assert_array_equal(limits.speed, speeds)
    np.testing.assert_array_equal(limits.torque, efforts)
    assert assumed(limits, UrdfRobot(source.urdf)) == []


@pytest.mark.parametrize("ends", ['lower="2" upper="-1"', 'lower="1" upper="1"'])
def test_a_range_that_is_none_is_refused(tmp_path, capsys, ends):
    assert planned(tmp_path, f'{ends} velocity="1.5" effort="3"') == (2, [])
    said = capsys.readouterr().err
    assert "arm.urdf: joint 'j'" in said and "expected lower below upper" in said


@pytest.mark.parametrize("words", [[], ["--for", "stribeck"]])
def test_a_robot_of_too_many_joints_is_refused_at_once(tmp_path, capsys, words):
    joints = "".join(
        f'<link name="l{k + 1}"/><joint name="j{k}" type="continuous"><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/></joint>'
        for k in range(20)
    )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="r"><link name="l0"/>{joints}</robot>')
    assert main(["excite", str(path), *words, "-o", str(tmp_path / "t.toml")]) == 2
    said = capsys.readouterr().err
    assert "has 20 moving joints; a motion is planned for at most 14" in said
    assert not (tmp_path / "t.toml").exists()


def test_a_motion_that_is_not_in_the_menu_is_no_other_one(tmp_path, capsys):
    limits = 'lower="-0.5" upper="2" velocity="1.5" effort="3"'
    assert planned(tmp_path, limits, "--for", "stribeck", "--motion", "pairs") == (2, [])
    assert "needs more joints; there is" in capsys.readouterr().err


@pytest.mark.slow
def test_an_identifying_motion_has_a_small_condition_number(tmp_path, capsys):
    place = str(tmp_path / "id.toml")
    assert main(["excite", str(RIG), "-o", place, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["columns"] == 14
    assert data["condition"] < 5.0 < 8.0 < data["condition_naive"]
    assert data["condition"] < data["condition_with_offset"]


def test_where_no_motion_separates_effects_none_is_asked_for():
    from hil.commands.excite import _inseparable

    said = _inseparable(("torque-offset", "asymmetric-coulomb"))
    assert said.startswith("no motion within the limits of this robot separates torque-offset ")
    assert said.endswith("use either for predictions") and "motion with rests" not in said
    assert _inseparable(("payload",)).endswith(
        "Beyond these limits: one recording with and one without the mass"
    )


def test_the_search_for_a_motion_says_how_far_it_is(tmp_path, capsys):
    """Thirteen seconds at 0 %."""
    heard = []
    with listening(lambda what, done: heard.append((what, done))):
        assert main(["excite", "identify", "-o", str(tmp_path / "m.toml")]) == 0
    shares = [done for what, done in heard if what == "seek the motion"]
    assert shares == sorted(shares) and shares[0] == 0.0 and len(set(shares)) > 20
    assert max(shares) <= 1.0 and any(0.4 < x < 0.6 for x in shares)
    capsys.readouterr()
