"""`hil selftest`: finds turned signs, swapped cables and dead motors; asks before it drives one."""

import io
import json
from pathlib import Path

import pytest

from hil.cli import main
from hil.commands.selftest import selftest
from hil.errors import ConfigError, DeviceError
from hil.rig import boxes
from hil.rig.config import load_rig
from hil.sim_devices.hid.usb31xx import Sim31xx

RIGS = Path(__file__).parents[2] / "rigs"


def steps(over=None, torque=0.1, allowed=lambda: True):
    config = load_rig(RIGS / "identify.toml", {"backend": "sim-wire"} | (over or {}))
    return {(s.device, s.what): s for s in selftest(config, torque, allowed)}


def recabled(monkeypatch, change):
    """Cable the simulated boxes otherwise than the rig file says."""
    real = boxes.wiring_plan

    def plan(config):
        rows = real(config)
        change(rows)
        return rows

    monkeypatch.setattr(boxes, "wiring_plan", plan)


def failed(found):
    return {key: step.text for key, step in found.items() if not step.passed}


def test_a_good_rig_passes():
    found = steps()
    assert not failed(found)
    assert len([what for _, what in found if what.startswith("joint")]) == 6
    assert not failed(steps({"backend": "sim"}))


def test_a_turned_sign_is_found(monkeypatch):
    def turn(rows):
        box = rows["follower-motor2"]
        box["cables"] = [(c, role, arm, k, -sign) for c, role, arm, k, sign in box["cables"]]

    recabled(monkeypatch, turn)
    wrong = failed(steps())
    assert set(wrong) == {("follower", "joint 2")}
    assert "turn the sign" in wrong["follower", "joint 2"]


def test_swapped_cables_are_found(monkeypatch):
    def swap(rows):
        a, b = rows["leader-motor1"], rows["leader-motor3"]
        a["cables"], b["cables"] = b["cables"], a["cables"]

    recabled(monkeypatch, swap)
    wrong = failed(steps())
    assert set(wrong) == {("leader", "joint 1"), ("leader", "joint 3")}
    assert "look at the channel map" in wrong["leader", "joint 1"]


def test_a_dead_motor_is_found(monkeypatch):
    recabled(monkeypatch, lambda rows: rows["leader-motor3"].update(cables=[]))
    wrong = failed(steps())
    assert set(wrong) == {("leader", "joint 3")}
    assert "does not move" in wrong["leader", "joint 3"]


def test_no_motor_moves_before_it_is_allowed(monkeypatch):
    volts = []
    real = Sim31xx.tick
    monkeypatch.setattr(Sim31xx, "tick", lambda b, t: (real(b, t), volts.append(abs(b.volts[0]))))
    found = steps(allowed=lambda: False)
    assert all(not what.startswith("joint") for _, what in found)
    assert max(volts) < 1e-3


def test_a_rig_that_is_not_still_gets_no_power(monkeypatch):
    real = boxes.BoxWire.receive

    def receive(self, t_ns):
        status = real(self, t_ns)
        self.counts[1] += t_ns // 50_000_000
        return status

    monkeypatch.setattr(boxes.BoxWire, "receive", receive)
    wrong = failed(steps(allowed=lambda: pytest.fail("asked for power")))
    assert "rest the arm in its dock" in wrong["leader", "encoders"]


def test_a_torque_that_is_not_small_is_refused():
    with pytest.raises(ConfigError, match=r"0\.02 to 0\.2 N m"):
        steps(torque=1.0)


def test_an_arm_that_runs_away_is_stopped():
    with pytest.raises(DeviceError, match="stopped"):
        steps({"arms": {"leader": {"speed_limit": [0.05, 0.05, 0.05]}}})


@pytest.mark.parametrize(
    ("typed", "code", "says"),
    [
        ("identify\n", 0, "ends the test: \n"),
        ("yes\n", 2, "ends the test: \nhil selftest: 'yes' is not the name of the rig"),
        ("", 2, "ends the test: \nhil selftest: the input ended; the motors stay off"),
    ],
)
def test_the_command_asks_for_the_name_of_the_rig(typed, code, says, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))
    assert main(["selftest", str(RIGS / "identify.toml"), "--json"]) == code
    said = capsys.readouterr()
    assert "Type the name of the rig, identify" in said.err
    assert says in said.err and said.err.endswith("\n")
    rows = json.loads(said.out)["steps"]
    assert any(r["what"] == "joint 1" for r in rows) is (code == 0)


def test_without_the_motors_nothing_is_asked(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert main(["selftest", str(RIGS / "identify.toml"), "--no-motors"]) == 0


@pytest.mark.parametrize("name", ["arm6", "inverse3"])
def test_arms_of_a_urdf_are_read_at_rest(name, capsys):
    assert main(["selftest", name]) == 0  # and nobody is asked
    said = capsys.readouterr().out
    assert "at rest" in said and "not driven" in said
    # counts of drives that measure finer than an encoder are told with how far they are
    assert "rad or m, where up to 0.001 is at rest" in said


def with_options(**options):
    return {"devices": {"leader-arm": {"options": options}}}


def test_a_device_that_sends_another_torque_than_asked_is_stopped():
    with pytest.raises(DeviceError, match=r"arm 'leader', joint 1, 0\.1 N m was asked.*0\.0133"):
        steps(with_options(stall_torque=0.001))


def test_an_amplifier_of_more_gain_than_declared_is_found():
    wrong = failed(steps(with_options(amps_per_volt=0.05), torque=0.02))
    assert "above 0.6 rad/s: the motor gives more torque" in wrong["leader", "joint 3"]
