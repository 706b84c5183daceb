"""Rig files: mistakes are one sentence that names the nearest right thing."""

import dataclasses
import datetime
import re
import shutil
import tomllib
from pathlib import Path

import pytest

from hil.cli import main
from hil.controllers.joint_tracking import JointTrackingConfig
from hil.errors import ConfigError, DataError
from hil.rig.config import BACKENDS, load_rig
from hil.rig.open import build_controller, open_rig
from hil.runtime.runner import run_session
from hil.runtime.session import Operator, rig_text, to_toml
from hil.toml import merge

RIGS = Path(__file__).parents[2] / "rigs"
PAUSING = Operator(schedule=[(0.05, "pause")])


@pytest.mark.parametrize(
    ("over", "says"),
    [
        ({"lop": {}}, "unknown key 'lop'. Did you mean 'loop'"),
        ({"loop": {"rate": 1000}}, "unknown key 'rate'. Did you mean 'rate_hz'"),
        ({"loop": {"rate_hz": "fast"}}, "should be of type float"),
        ({"loop": {"rate_hz": -1}}, "0 < slow_hz <= rate_hz"),
        ({"loop": {"seconds": 0}}, "must be positive"),
        ({"loop": {"clock": "lockstp"}}, "Did you mean 'lockstep'"),
        ({"loop": 3}, "a table is needed"),
        ({"backend": "usbb"}, "Did you mean 'usb'"),
        ({"schema": "hil.rig/9"}, "this version reads 'hil.rig/1'"),
        ({"devices": {"leader-arm": {"arm": "leeder"}}}, "Did you mean 'leader'"),
        ({"devices": {"new": {"arm": "leader"}}}, "the key 'driver' is missing"),
        ({"arms": {"leader": {"torque_limit": [1.0]}}}, "3 entries"),
        ({"arms": {"leader": {"torque_limit": [1.0, 1.0, 0.0]}}}, "must be positive"),
        ({"controller": {"arms": ["leader", "x"]}}, "unknown arm"),
        ({"controller": {"arms": "leader"}}, "a list is needed"),
    ],
)
def test_mistakes_in_a_rig_are_named(over, says):
    with pytest.raises(ConfigError, match=says.replace("(", r"\(")):
        load_rig(RIGS / "teleop.toml", over)


@pytest.mark.parametrize(
    ("over", "says"),
    [
        ({"controller": {"name": "position-forse"}}, "Did you mean 'position-force'"),
        ({"controller": {"parameters": {"stifness": [1, 1, 1]}}}, "Did you mean 'stiffness'"),
        ({"controller": {"parameters": {"space": "jointt"}}}, "Did you mean 'joint'"),
        ({"controller": {"arms": ["leader"]}}, "needs leader and follower"),
    ],
)
def test_mistakes_in_a_controller_are_named(over, says):
    with pytest.raises(ConfigError, match=says):
        build_controller(load_rig(RIGS / "teleop.toml", over))


def test_the_command_line_answers_with_exit_code_2(tmp_path, capsys):
    assert main(["run", str(tmp_path / "no.toml"), "-o", str(tmp_path / "s.mcap")]) == 2
    assert "no such rig file" in capsys.readouterr().err
    bad = tmp_path / "bad.toml"
    bad.write_text("a = = 1")
    assert main(["run", str(bad), "-o", str(tmp_path / "s.mcap")]) == 2
    assert main(["run", str(RIGS / "teleop.toml"), "-o", "x.mcap", "--seed", "-1"]) == 2
    assert not Path("x.mcap").exists()


def test_overrides_do_not_change_what_they_are_merged_into():
    base = {"a": {"b": 1, "c": 2}}
    assert merge(base, {"a": {"b": 3}}) == {"a": {"b": 3, "c": 2}}
    assert base == {"a": {"b": 1, "c": 2}}


def test_the_attached_rig_is_toml_that_lacks_the_simulation():
    config = load_rig(RIGS / "teleop.toml")
    table = tomllib.loads(rig_text(config))
    assert "simulation" not in table
    assert table["devices"]["leader-force"]["options"]["model"] == "nano25"
    assert tomllib.loads(to_toml({"a": {"b": [1, 2.5, "x"], "c": {"d": True}}})) == {
        "a": {"b": [1, 2.5, "x"], "c": {"d": True}}
    }


@pytest.mark.parametrize("path", sorted(RIGS.glob("*.toml")), ids=lambda p: p.stem)
def test_a_rig_file_names_the_back_ends_beside_its_own(path):
    line = next(x for x in path.read_text().splitlines() if x.startswith("backend ="))
    named = re.findall(r'"([a-z-]+)"', line)
    assert {"sim", "sim-wire", "hardware"} == set(named) <= set(BACKENDS)


RARE = {
    "hidden": [{"effect": "stribeck", "joint": "joint2", "size": [1.0, 2.0]}, {}],
    "a b": {"c.d": 'ü \x7f \t " \U0001f600', "e": float("inf"), "f": [-float("inf")]},
    "empty": {},
    "nested": {"x": {"y": {}}, "z": [[1, 2], [3]], "day": datetime.date(2026, 1, 2)},
}


def test_what_is_written_is_what_is_read():
    assert tomllib.loads(to_toml(RARE)) == RARE


@pytest.mark.parametrize("name", ["lawrence", "teleop"])
def test_a_rig_with_hidden_effects_survives_hil_design(name, tmp_path, capsys):
    over = "\n[[simulation.hidden]]\neffect = 'stribeck'\njoint = 'joint2'\narm = 'follower'\n"
    rig, own = tmp_path / "rig.toml", tmp_path / "own.toml"
    rig.write_text((RIGS / f"{name}.toml").read_text() + over)
    words = ["--design", "position-error", "--set", "stiffness=150", "--set", "damping=1.2"]
    words += ["--set", "leader_stiffness=150", "--set", "leader_damping=1.2"]
    assert main(["design", str(rig), *words, "-o", str(own)]) == 0
    capsys.readouterr()
    assert load_rig(own).simulation == load_rig(rig).simulation
    assert main(["run", str(own), "-o", str(tmp_path / "s.mcap"), "--seconds", "0.05"]) == 0


def test_a_session_that_ends_paused_says_so_by_its_exit_code(tmp_path, capsys):
    words = ["run", "lawrence", "-o", str(tmp_path / "s.mcap"), "--seconds", "0.1"]
    assert main([*words, "--at", "0.05 pause"]) == 4
    assert "PAUSED" in capsys.readouterr().out
    assert main([*words, "--at", "0.05 pause", "--at", "0.07 resume"]) == 0
    done = run_session(
        load_rig("lawrence"), 0.1, 1, "lockstep", tmp_path / "p.mcap", operator=PAUSING
    )
    with pytest.raises(DataError, match=r"p\.mcap: the session ended PAUSED.*no number"):
        done.enabled()


def test_a_session_says_what_many_limited_commands_mean(tmp_path, capsys):
    text = (RIGS / "lawrence.toml").read_text()
    arm = "[arms.leader]\n"
    for k, (torque, says) in enumerate((("0.01", " % of the ticks: the law asks"), ("0.8", ""))):
        own = f"{arm}torque_limit = [{torque}, {torque}, {torque}]\n"
        (tmp_path / "r.toml").write_text(text.replace(arm, own))
        words = [str(tmp_path / "r.toml"), "--seconds", "0.3", "-o", str(tmp_path / f"{k}.mcap")]
        assert main(["run", *words]) == 0
        row = next(x for x in capsys.readouterr().out.splitlines() if x.startswith("limited"))
        assert says in row and (says or row.split()[-1] == "0")


ROW = "[[simulation.hidden]] row 1"


@pytest.mark.parametrize(
    ("rig", "row", "says"),
    [
        ("teleop", "effect = 3", f"{ROW} effect = 3"),
        ("teleop", 'effect = "spring"\narm = 2', f"{ROW} arm = 2"),
        ("teleop", 'effect = "spring"\njoint = 2', f"{ROW} joint = 2"),
        ("teleop", 'efect = "spring"', f"{ROW}: unknown key 'efect'. Did you mean 'effect'"),
        ("teleop", 'arm = "leader"', f"{ROW}: the key 'effect' is missing"),
        ("teleop", 'effect = "spring"\namplitude = "big"', f"{ROW} amplitude = 'big'"),
        ("teleop", 'effect = "coupled-friction"\nby = 3', f"{ROW} by = 3"),
        ("arm6", "effect = 3", f"{ROW} effect = 3"),
        ("arm6", 'effect = "spring"\njoint = 2', f"{ROW} joint = 2"),
        ("arm6", 'effect = "spring"\narm = 2\njoint = "elbow"', f"{ROW} arm = 2"),
        ("arm6", 'effect = "spring"\namplitude = "big"\njoint = "elbow"', f"{ROW} amplitude"),
        ("arm6", 'effect = "spring"', "the key 'joint' is missing"),
    ],
)
def test_a_row_of_hidden_effects_that_is_none(tmp_path, capsys, rig, row, says):
    shutil.copy(RIGS / "arm6.urdf", tmp_path)
    text = (RIGS / f"{rig}.toml").read_text()
    (tmp_path / "r.toml").write_text(f"{text}\n[[simulation.hidden]]\n{row}\n")
    words = [str(tmp_path / "r.toml"), "--seconds", "0.01", "-o", str(tmp_path / "s.mcap")]
    assert main(["run", *words]) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("seconds = 20.0", "seconds = inf", "beyond"),
        ("seconds = 20.0", "seconds = 20.0\nring_rows = 1_000_000_000_000", "ring_rows"),
        ("options.home = [0.0, 0.4, 0.3]", "options.home = [0.0, 0.4, -1e300]", "beyond"),
        ("below_home = 0.015", "below_home = []", "below_home"),
        ("below_home = 0.015", 'below_home = "x"', "below_home"),
        ("below_home = 0.015", "below_home = nan", "below_home"),
        ("below_home = 0.015", "below_home = 15", "below_home = 15: -1 to 1 m is needed"),
        (
            "below_home = 0.015",
            "below_home = 0.015\n[safety]\nwatchdog = 0.5",
            "r.toml: [safety]: watchdog = 0.5 has no program to run",
        ),
        ("below_home = 0.015", "stiffness = -300.0", "stiffness = -300.0: 0 to 100000 N/m^1.3"),
        ("below_home = 0.015", "stiffness = 1e9", "0 to 100000 N/m^1.3 is needed"),
        ('kind = "hand"', 'kind = "hand"\nfrequency = -2.0', "0.01 to 20 Hz is needed"),
        ('kind = "hand"', 'kind = "hand"\nfrequency = 0', "0.01 to 20 Hz is needed"),
        ('kind = "hand"', 'kind = "hand"\nsize = [9.0, 0, 0]', "-0.5 to 0.5 m is needed"),
        ("\nhome = [0.0, 0.4, 0.3]", "\nhidden_seed = -1", "hidden_seed = -1: 0 to"),
        ("below_home = 0.015", "below_home = 0.015\n[simulation.quadrature]\nlines = 1.5", "lines"),
        (
            "below_home = 0.015",
            'below_home = 0.015\n[simulation.quadrature]\ndirty = ["a"]',
            "dirty",
        ),
        ("\nhome = [0.0, 0.4, 0.3]", '\nhome = [0.0, 0.4, "x"]', "home"),
        ("\nhome = [0.0, 0.4, 0.3]", "\nhome = [0.0, [], 0.3]", "home"),
        ("\nhome = [0.0, 0.4, 0.3]", "\nhome = [0.0, 0.4]", "home"),
    ],
)
def test_values_that_no_rig_has(tmp_path, capsys, old, new, word):
    text = (RIGS / "teleop.toml").read_text()
    assert old in text
    (tmp_path / "r.toml").write_text(text.replace(old, new, 1))
    words = [str(tmp_path / "r.toml"), "--seconds", "0.01", "-o", str(tmp_path / "s.mcap")]
    assert main(["run", *words]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and word in said


@pytest.mark.parametrize(
    "change", ["period = 0.0", "blend = 0", "seed = -1", "amplitude = [1.0]", "gravity = [1.0]"]
)
def test_parameters_of_the_tracking_that_no_motion_has(change):
    with pytest.raises(ConfigError, match=change.split()[0]):
        JointTrackingConfig(
            **{k: tuple(v) if isinstance(v, list) else v for k, v in tomllib.loads(change).items()}
        )


LEADER = "[rig.arms.leader]: "


@pytest.mark.parametrize(
    ("leader", "says"),
    [
        ({"torque_limit": [-0.8, 0.8, 0.8]}, LEADER + "torque_limit = [-0.8, 0.8, 0.8]"),
        ({"speed_limit": [0.0, 1.0, 1.0]}, LEADER + "speed_limit = "),
        ({"acceleration_limit": -1.0}, LEADER + "acceleration_limit = -1"),
        ({"force_red": -2.0}, LEADER + "force_red = -2 N"),
        ({"force_yellow": 5.0, "force_red": 2.0}, LEADER + "force_yellow = 5 N is above"),
        ({"winding": {"red": -1.0}}, "[rig.arms.leader.winding]: "),
        ({"joints": ["a", "b", "a"]}, LEADER + "joints = ['a', 'b', 'a'] has 'a' twice"),
        ({"robot": "phantom-premium-3.0"}, "Did you mean 'phantom-premium-1.5'? Available: ph"),
        (
            {"position_min": [-90, -90, -90], "position_max": [90, 90, 90]},
            LEADER + "position_min: -90 rad are 14 turns",
        ),
        ({"position_max": [1.0, 90.0, 1.0]}, "if these are degrees, write 1.5708"),
    ],
)
def test_a_mistake_in_an_arm_names_the_arm(leader, says):
    with pytest.raises(ConfigError, match=re.escape(says)):
        load_rig(RIGS / "teleop.toml", {"arms": {"leader": leader}})


@pytest.mark.parametrize("name", ["my leader", "f\u00fchrer1", "", "../x", "Leader", "a__b", "1"])
def test_a_name_that_no_session_can_hold_is_refused(name):
    over = {"arms": {name: {"robot": "phantom-premium-1.5"}}}
    with pytest.raises(ConfigError, match="small letters, digits and single _") as told:
        load_rig(RIGS / "teleop.toml", over)
    assert f"[arms.{name}]" in str(told.value).replace('"', "")


def test_an_arm_stands_once_in_a_law():
    over = {"controller": {"arms": ["leader", "leader"]}}
    with pytest.raises(ConfigError, match=r"\[controller\]: arms = .* has 'leader' twice"):
        load_rig(RIGS / "teleop.toml", over)


def opened(over):
    open_rig(load_rig(RIGS / "teleop.toml", over), 0).close()


@pytest.mark.parametrize("scale", [2.5, -0.7, 70000.0])
def test_a_parameter_of_the_file_keeps_to_the_range_of_the_law(scale):
    says = f"[controller.parameters]: force_scale = {scale:g} is out of range: 0..2"
    with pytest.raises(ConfigError, match=re.escape(says)):
        opened({"controller": {"parameters": {"force_scale": scale}}})


def test_the_yellow_lamp_alone_may_be_set():
    opened({"arms": {"leader": {"force_yellow": 2.0}}})
    with pytest.raises(ConfigError, match=r"\[arms.leader\]: force_yellow = 120 N is above 106"):
        opened({"arms": {"leader": {"force_yellow": 120.0}}})


def test_a_phantom_without_force_sensors_runs(tmp_path):
    waves = {"controller": {"parameters": {"scheme": "waves"}}}  # a law that reads no force
    config = load_rig(RIGS / "delayed.toml", waves)
    bare = {n: d for n, d in config.devices.items() if d.driver == "premium"}
    done = run_session(dataclasses.replace(config, devices=bare), 0.05, output=tmp_path / "s.mcap")
    assert done.state == "ENABLED"


@pytest.mark.parametrize("backend", ["sim", "sim-wire"])
@pytest.mark.parametrize(
    ("over", "says"),
    [
        ({"boxes": {"encoders": {"driver": "usb-quad8"}}}, "[boxes.encoders]: unknown box 'usb-q"),
        ({"boxes": {"spare": {"driver": "usb-quad"}}}, "[boxes.spare]: unknown box 'usb-quad'"),
        ({"boxes": {"encoders": {"options": {"bits": 24}}}}, "[boxes.encoders.options]: "),
        (
            {"devices": {"leader-force": {"channels": {"gauges": ["ft/0"]}}}},
            'Add a table [boxes.ft] with driver = "netcanoem" (there are damiao-can, ',
        ),
        (
            {"boxes": {"leader-motor1": {"options": {"heartbeat_ms": 1000.0}}}},
            "[boxes.leader-motor1.options]: heartbeat_ms = 1000: 2 to 50",
        ),
        (
            {
                "devices": {
                    "follower-arm": {
                        "channels": {"encoders": ["encoders/3", "encoders/4", "encoders/8"]}
                    }
                }
            },
            "[devices.follower-arm.channels]: encoders has encoders/8; the box (usb-quad08) has "
            "the channels 0 to 7",
        ),
        (
            {"devices": {"leader-arm": {"options": {"amps_per_volt": -0.5513}}}},
            "[devices.leader-arm.options]: amps_per_volt = -0.5513",
        ),
        (
            {"arms": {"leader": {"robot": "phantom-omni"}}},
            "[devices.leader-arm]: the reductions and motors of the driver are those of",
        ),
    ],
)
def test_devices_and_boxes_are_checked_on_every_back_end(backend, over, says):
    with pytest.raises(ConfigError, match=re.escape(says)):
        opened({"backend": backend, **over})


def test_boxes_of_one_address_are_told_what_an_address_is():
    same = {"boxes": {"leader-ft": {"address": "can0/0x21"}}}
    said = r"leader-ft, follower-ft have one driver and the address 'can0/0x21'; .* CHANNEL/BASE as"
    with pytest.raises(ConfigError, match=said):
        open_rig(load_rig("teleop", {"backend": "sim-wire", **same}), 0)
    same = {"boxes": {"leader-motor1": {"address": "leader-2"}}}
    with pytest.raises(ConfigError, match="the serial number that 'hil devices' shows"):
        open_rig(load_rig("teleop", {"backend": "sim-wire", **same}), 0)
