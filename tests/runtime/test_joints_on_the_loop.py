"""Arms of any number of joints on the loop: rig file, record, limits, replay, both back ends."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from hil.errors import ConfigError, DeviceError
from hil.excite import trajectory
from hil.models.robots import bare_robot
from hil.record.container import read
from hil.record.mcap_read import load
from hil.rig.config import load_rig
from hil.rig.open import open_rig
from hil.rigs import rig_path
from hil.runtime.replay import replay
from hil.runtime.runner import run_session
from hil.signals.frame import FrameLayout

LINK = (
    '<link name="l{k}"><inertial><origin xyz="0.05 0 0.02"/><mass value="0.12"/>'
    '<inertia ixx="0.0002" iyy="0.0004" izz="0.0003" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="axis_{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/>'
    '<origin xyz="0.1 0 0" rpy="{turn} 0 0"/><axis xyz="0 0 1"/>'
    '<limit lower="-2" upper="2" velocity="3" effort="9"/></joint>'
)


def urdf(d):
    links = (
        LINK.format(k=k, parent=f"l{k - 1}" if k else "base", turn=1.57 * (k % 2)) for k in range(d)
    )
    return f'<robot name="r"><link name="base"/>{"".join(links)}</robot>'


OWN = 'robot = "own.urdf"'
RIG = """schema = "hil.rig/1"
backend = "{backend}"
[loop]
rate_hz = {rate}
[arms.arm]
robot = "own.urdf"
{more}
[devices.drives]
driver = "damiao"
arm = "arm"
channels.drives = [{places}]
[boxes.bus]
driver = "damiao-can"
[controller]
name = "{law}"
arms = ["arm"]
[controller.parameters]
armature = [{armature}]
center = [{center}]
"""


def rig(folder, d, backend="sim", law="joint-pd", more="", rate=500):
    (folder / "own.urdf").write_text(urdf(d))
    text = RIG.format(
        backend=backend,
        law=law,
        more=more,
        rate=rate,
        places=", ".join(f'"{"-" * (k % 2)}bus/{k + 1}"' for k in range(d)),
        armature=", ".join(["0.012"] * d),
        center=", ".join(["0.2"] * d),
    )
    path = folder / "own.toml"
    path.write_text(text)
    return load_rig(path)


@pytest.mark.parametrize(
    ("law", "d"),
    [*(("joint-pd", d) for d in range(1, 8)), *(("computed-torque", d) for d in range(1, 5))],
)
def test_an_arm_of_any_number_of_joints_runs_and_is_recorded(tmp_path, law, d):
    summary = run_session(rig(tmp_path, d, law=law), 2.0, 1, output=tmp_path / "s.mcap")
    assert summary.state == "ENABLED"
    assert summary.limited == 0
    seen = load(tmp_path / "s.mcap", "arm")
    assert seen.joints == tuple(f"axis_{k}" for k in range(d))
    assert seen.robot.urdf == urdf(d)
    assert seen.wrench is None
    assert np.abs(seen.q[-1] - 0.2).max() < 0.15
    columns = FrameLayout(1, 0, joints=d)
    assert columns.words == 2 * d + 6


@pytest.mark.parametrize("backend", ["sim", "sim-wire"])
def test_a_session_is_bit_identical_for_a_seed_and_replays(tmp_path, backend):
    config = rig(tmp_path, 5, backend)
    names = [tmp_path / f"{k}.mcap" for k in range(3)]
    for name, seed in zip(names, (4, 4, 5), strict=True):
        run_session(config, 0.6, seed, output=name)
    first, again, other = (name.read_bytes() for name in names)
    assert first == again
    assert first != other
    (tmp_path / "own.urdf").unlink()  # the session has what it needs
    found = replay(names[0])
    assert found.compared == found.ticks > 0
    assert found.differ == 0


def test_ideal_wires_and_simulated_can_lead_to_the_same_posture(tmp_path):
    ends = []
    for backend in ("sim", "sim-wire"):
        run_session(rig(tmp_path, 4, backend), 2.0, 2, output=tmp_path / f"{backend}.mcap")
        ends.append(load(tmp_path / f"{backend}.mcap", "arm").q[-1])
    assert np.abs(ends[0] - ends[1]).max() < 0.02


def test_the_raw_words_are_those_of_all_joints(tmp_path):
    run_session(rig(tmp_path, 7), 0.1, 0, output=tmp_path / "s.mcap")
    text = read(tmp_path / "s.mcap").topics["/rig/raw"].schema_text.decode()
    names = re.findall(r"float64 (\w+)", text)
    assert names == [
        *(f"arm_count{k}" for k in range(1, 8)),
        *(f"arm_code{k}" for k in range(1, 8)),
        *(f"arm_gauge{k}" for k in range(1, 7)),
    ]


@pytest.mark.parametrize(
    ("more", "condition", "fault"),
    [
        (
            "position_min = [-1, -1, -1, -1, -1]\nposition_max = [1, 1, 1, 1, 0.05]",
            r"outside of its range \(axis_4 at -?[0-9.]+, range -1 to 0\.05\)",
            False,
        ),
        (
            "speed_limit = [3, 3, 3, 3, 0.1]",
            r"passed its speed_limit \(axis_4 at -?[0-9.]+ of 0\.1\); the motors",
            True,
        ),
    ],
)
def test_the_limits_of_the_last_joint_hold(tmp_path, more, condition, fault):
    config = rig(tmp_path, 5, more=more)
    if fault:
        with pytest.raises(DeviceError, match=condition):
            run_session(config, 2.0, 0, output=tmp_path / "s.mcap")
        return
    # no longer: without torque it falls
    summary = run_session(config, 0.75, 0, output=tmp_path / "s.mcap")
    assert summary.state == "PAUSED"
    assert re.search(condition, summary.reason)


def test_a_motion_that_the_law_does_not_follow_is_told_from_a_fast_one(tmp_path):
    """The motion keeps to the speed limit; who passes it is the law, and the message says so."""
    config = rig(tmp_path, 5, more="speed_limit = [3, 3, 3, 3, 0.1]")
    names = tuple(f"axis_{k}" for k in range(5))
    via, ends = np.full((2, 5), 0.2), np.array([0.0, 10.0])
    still = trajectory.Trajectory(
        names, ("rad",) * 5, 10.0, ends, via, np.full(2, 0.1), np.zeros((5, 1, 2))
    )
    trajectory.write_trajectory(still, tmp_path / "hold.toml", "")
    parameters = {**config.controller.parameters, "trajectory": str(tmp_path / "hold.toml")}
    controller = replace(config.controller, parameters=parameters)
    with pytest.raises(DeviceError, match=r"axis_4 at .*the law does not follow it: see to its g"):
        run_session(replace(config, controller=controller), 2.0, 0, output=tmp_path / "s.mcap")


def test_the_torque_limit_of_every_joint_holds(tmp_path):
    config = rig(tmp_path, 5, more="torque_limit = [9, 9, 9, 9, 0.05]")
    run_session(config, 0.6, 0, output=tmp_path / "s.mcap")
    tau = load(tmp_path / "s.mcap", "arm").tau
    assert np.abs(tau[:, 4]).max() < 0.06


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('"own.urdf"', '"other.urdf"'), "other.urdf: cannot be read"),
        (('"bus/1", ', ""), "drives needs 5 places"),
        (('name = "joint-pd"', 'name = "position-force"'), "(?s)"),
        (("center = [0.2, ", "center = ["), "center needs 5"),
        (
            ('robot = "own.urdf"', 'robot = "own.urdf"\njoints = ["axis_1", "axis_0"]'),
            "in the order",
        ),
        ((OWN, f'{OWN}\njoints = ["finger"]'), "unknown moving joint"),
        (
            (
                'robot = "own.urdf"',
                'robot = "own.urdf"\njoints = ["axis_0"]\nlock = { axis_0 = 0 }',
            ),
            "'axis_0' is to run and locked",
        ),
        ((OWN, f"{OWN}\nlock = {{ finger = 0 }}"), "unknown moving"),
        (('robot = "own.urdf"', 'robot = "own.urdf"\ntorque_limit = [1.0]'), "needs 5 entries"),
    ],
)
def test_mistakes_in_the_rig_file_are_refused(tmp_path, change, said):
    rig(tmp_path, 5)
    path = tmp_path / "own.toml"
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change))
    with pytest.raises(ConfigError, match=said):
        run_session(load_rig(path), 0.1, output=tmp_path / "s.mcap")


def test_joints_that_the_rig_does_not_run_are_locked(tmp_path):
    """A stock arm with a gripper could not be run at all: eight joints."""
    rig(tmp_path, 3)
    (tmp_path / "own.urdf").write_text(urdf(9))
    path = tmp_path / "own.toml"
    text = path.read_text()
    with pytest.raises(ConfigError, match=r'Name those that run, joints = \["axis_0", "axis_1"'):
        load_rig(path)
    named = 'robot = "own.urdf"\njoints = ["axis_0", "axis_1", "axis_2"]\nlock = { axis_4 = 0.3 }'
    path.write_text(text.replace('robot = "own.urdf"', named))
    run_session(load_rig(path), 0.3, 0, output=tmp_path / "s.mcap")
    session = load(tmp_path / "s.mcap", "arm")
    assert session.joints == ("axis_0", "axis_1", "axis_2")
    moving = [
        j for j in ET.fromstring(session.robot.urdf).iter("joint") if j.get("type") != "fixed"
    ]
    assert [j.get("name") for j in moving] == list(session.joints)
    # the locked links still weigh on the joints that run
    heavy = session.tau[-1]
    rig(tmp_path, 3)
    run_session(load_rig(path), 0.3, 0, output=tmp_path / "light.mcap")
    assert np.abs(heavy - load(tmp_path / "light.mcap", "arm").tau[-1]).max() > 0.1


def test_a_law_of_three_joints_says_which_laws_take_more(tmp_path):
    rig(tmp_path, 5)
    path = tmp_path / "own.toml"
    text = path.read_text().replace('name = "joint-pd"', 'name = "position-force"')
    path.write_text(text.split("[controller.parameters]")[0])
    with pytest.raises(ConfigError, match=r"arms of three joints.*computed-torque.*joint-pd"):
        run_session(load_rig(path), 0.1, output=tmp_path / "s.mcap")


def test_the_operator_sends_an_arm_of_six_home(tmp_path):
    from hil.runtime.session import Operator

    said = []
    operator = Operator([(0.5, "home")], said.append)
    run_session(load_rig("arm6"), 3.2, 0, output=tmp_path / "s.mcap", operator=operator)
    assert any("home: done" in text for text in said), said
    end = load(tmp_path / "s.mcap", "arm").q[-1]
    assert np.abs(end).max() < 0.05


def test_the_packaged_rig_brings_its_robot():
    config = load_rig("arm6")
    assert config.arms["arm"].joints[2] == "elbow"
    assert config.arms["arm"].torque_limit == (26.0, 50.0, 26.0, 9.0, 9.0, 9.0)
    assert rig_path("arm6").with_name("arm6.urdf").is_file()


def test_a_robot_without_a_frame_called_tip_is_recorded_with_its_last_one(tmp_path):
    config = rig(tmp_path, 2)
    run_session(config, 0.05, output=tmp_path / "s.mcap")
    robot = load(tmp_path / "s.mcap", "arm").robot
    assert robot.tip == "" and bare_robot(robot).joints == ("axis_0", "axis_1")


def test_sliding_axes_hold_their_place_on_ideal_wires(tmp_path):
    """A linear motor has the fine steps of a scale, not those of a drive that turns."""
    ended = run_session(
        load_rig("inverse3", {"backend": "sim"}), 1.0, 1, "lockstep", tmp_path / "s.mcap"
    )
    assert ended.state == "ENABLED"
    q = load(tmp_path / "s.mcap").q
    assert 0 < np.ptp(q, axis=0).max() < 1e-3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            ('lower="-2" upper="2"', 'lower="1" upper="-1"'),
            "'axis_0': its limits, lower = 1 and upper = -1",
        ),
        (('lower="-2" upper="2"', 'lower="-90" upper="90"'), "'axis_0': -90 rad are 14 turns"),
        (('lower="-2" upper="2"', 'lower="-1" upper="90"'), "if these are degrees, write 1.5708"),
        (("<inertial>", "<visual>"), "[controller]: the URDF has no mass that axis_0, axis_1"),
    ],
)
def test_mistakes_in_the_urdf_of_an_arm_are_refused(tmp_path, change, said):
    rig(tmp_path, 5)
    path = tmp_path / "own.toml"
    bad = (
        urdf(5).replace(*change).replace(change[0].replace("<", "</"), change[1].replace("<", "</"))
    )
    (tmp_path / "own.urdf").write_text(bad)
    path.write_text(path.read_text().replace("armature = ", "# armature = "))
    with pytest.raises(ConfigError, match=re.escape(said)):
        open_rig(load_rig(path), 0).close()


@pytest.mark.parametrize("end", ["100.01", "1e9"])
def test_a_winch_and_a_joint_without_ends_are_no_degrees(tmp_path, end):
    rig(tmp_path, 2)
    turning = urdf(2).replace('lower="-2" upper="2"', f'lower="-{end}" upper="{end}"')
    (tmp_path / "own.urdf").write_text(turning)
    load_rig(tmp_path / "own.toml")


def test_rotors_stand_in_for_links_without_mass(tmp_path):
    config = rig(tmp_path, 5)
    light = urdf(5).replace("inertial>", "visual>")
    (tmp_path / "own.urdf").write_text(light)
    open_rig(load_rig(tmp_path / "own.toml"), 0).close()
    assert config.controller.parameters["armature"]


def test_ranges_of_the_rig_file_take_the_place_of_those_in_degrees(tmp_path):
    rig(tmp_path, 2)
    wrong = urdf(2).replace('lower="-2" upper="2"', 'lower="-90" upper="90"')
    (tmp_path / "own.urdf").write_text(wrong)
    path, own = tmp_path / "own.toml", "position_min = [-2, -2]\nposition_max = [2, 2]\n"
    path.write_text(path.read_text().replace("[devices.drives]", own + "[devices.drives]"))
    assert load_rig(path).arms["arm"].position_max == (2.0, 2.0)


def test_a_tip_that_the_urdf_lacks_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"\[arms\.arm\]: tip: unknown frame .*'nolink'.*l0, l1"):
        rig(tmp_path, 2, more='tip = "nolink"')
    assert rig(tmp_path, 2, more='tip = "l1"').arms["arm"].tip == "l1"


def test_a_driver_of_three_joints_says_so(tmp_path):
    rig(tmp_path, 2)
    path = tmp_path / "own.toml"
    lines = [x for x in path.read_text().splitlines() if not x.startswith("channels.")]
    path.write_text("\n".join(lines).replace('"damiao"', '"premium"'))
    with pytest.raises(ConfigError, match=r"\[devices\.drives\]: .* arm 'arm' has 2 joints"):
        open_rig(load_rig(path), 0)
