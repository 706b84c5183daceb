"""Laws, drivers and sensors of other distributions: run, recorded, and blamed by name."""

import dataclasses
import json
import sys

import numpy as np
import pytest
from test_run_session import RIGS, record

import hil
from hil import registry
from hil.cli import main
from hil.errors import ConfigError
from hil.interrupt import Ended
from hil.rig.config import ControllerConfig, load_rig
from hil.rig.open import open_rig
from hil.runtime.replay import replay
from hil.runtime.runner import Operator, run_session

LAW = """
from dataclasses import dataclass

@dataclass(frozen=True)
class Config:
    mode: str = "ok"

class Law:
    state_names = ("n",)

    def __init__(self, config, arms, period):
        self.mode = config.mode
        if self.mode == "build":
            raise ValueError("boom")
        if self.mode == "names":
            self.state_names = ("n", "n")

    def update(self, t, x, u, x_next, y):
        y[:] = 0.0
        if t > 0.05 and self.mode == "raise":
            raise RuntimeError("boom")
        if t > 0.05 and self.mode == "exit":
            raise SystemExit(0)

build = Law
"""
ARM = """
from dataclasses import dataclass
import numpy as np
from hil.signals.device import OperatingState, StateCommand, StateMachine, Status

@dataclass(frozen=True)
class Config:
    mode: str = ""

class Arm:
    SELF_CONTAINED = True

    def __init__(self, name, wire, config, period):
        self.name, self.mode, self.machine, self.n = name, config.mode, StateMachine(name), 0
        self.bad("open")

    def bad(self, step):
        if step == self.mode:
            raise RuntimeError("boom")

    @property
    def state(self):
        return self.machine.state

    def enable(self):
        self.bad("enable")
        self.machine.command(StateCommand.ENABLE)

    def disable(self):
        self.bad("disable")
        self.machine.command(StateCommand.DISABLE)

    def fault(self):
        self.machine.command(StateCommand.FAULT)

    def close(self):
        self.bad("close")
        self.disable()

    def measured_js(self, t_ns, position, velocity):
        self.n += 1
        position[:], velocity[:] = 0.0, 0.0
        if self.n > 50:
            self.bad("measured_js")
            return {"none": None, "text": "OK", "far": 7}.get(self.mode, Status.OK)
        return Status.OK

    def servo_jf(self, effort, sent):
        self.bad("servo_jf") if self.n > 50 else None
        sent[:] = effort if self.state is OperatingState.ENABLED else 0.0
        return Status.OK

open_device = Arm
"""
SENSOR = """
from dataclasses import dataclass
from hil.signals.device import StateCommand, StateMachine, Status

@dataclass(frozen=True)
class Config:
    pass

class Sensor:
    def __init__(self, name, wire, config, period):
        self.name, self.machine = name, StateMachine(name)

    @property
    def state(self):
        return self.machine.state

    def measured_cf(self, t_ns, position, wrench):
        wrench[:] = 1.5, 0.0, -2.0, 0.0, 0.0, 0.0
        return Status.OK

    def enable(self):
        self.machine.command(StateCommand.ENABLE)

    def disable(self):
        self.machine.command(StateCommand.DISABLE)

    close = disable

open_device = Sensor


def hidden(name, wire, config, period):
    return Sensor(name, wire, config, period)
"""
ESTIMATOR = """
from dataclasses import dataclass

@dataclass(frozen=True)
class Config:
    pass

class Estimator:
    names, units, memory, force, corner_hz, message = ("a",), ("1",), 0, -1, 0.0, "Mine"

    def update(self, phase, past, u, sent, now, out):
        raise RuntimeError("boom")

def build(parameters, period):
    return Estimator()
"""
POINTS = """
[hil.estimators]
my-estimator = my_estimator

[hil.controllers]
my-law = my_law
my-syntax = my_syntax
my-empty = my_empty

[hil.drivers]
my-arm = my_arm
my-sensor = my_sensor
"""
FILES = {
    "my_estimator": ESTIMATOR,
    "my_law": LAW,
    "my_arm": ARM,
    "my_sensor": SENSOR,
    "my_syntax": "x = (",
    "my_empty": "",
}


def install(folder, monkeypatch, points, name="my-rig"):
    place = folder / f"{name}.dist-info"
    place.mkdir()
    (place / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 3\n")
    (place / "entry_points.txt").write_text(points)
    registry._installed.cache_clear()


@pytest.fixture
def plugged(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    for name, text in FILES.items():
        (tmp_path / f"{name}.py").write_text(text)
    install(tmp_path, monkeypatch, POINTS)
    yield tmp_path
    for name in FILES:
        sys.modules.pop(name, None)
    registry._installed.cache_clear()


def of_law(folder, mode, name="my-law"):
    path = folder / "law.toml"
    text = (RIGS / "identify.toml").read_text().partition("[controller]")[0]
    given = f'mode = "{mode}"' if name == "my-law" else ""
    path.write_text(
        f'{text}[controller]\nname = "{name}"\narms = ["leader", "follower"]\n'
        f"[controller.parameters]\n{given}\n"
    )
    return path


def of_arm(folder, mode="", backend="sim"):
    path = folder / "arm.toml"
    path.write_text(
        f'backend = "{backend}"\n[arms.arm]\n[devices.one]\ndriver = "my-arm"\narm = "arm"\n'
        f'options.mode = "{mode}"\n[controller]\nname = "joint-tracking"\narms = ["arm"]\n'
    )
    return path


def said(capsys, path, output, code):
    words = ["run", str(path), "--seconds", "0.2", "--plain", "-o", str(output)]
    assert main(words) == code
    text = capsys.readouterr().err
    assert "internal error" not in text and "my-rig 3" in text
    return text


@pytest.mark.parametrize(
    ("mode", "told"),
    [
        ("raise", "the law 'my-law' failed at 0.051 s: RuntimeError: boom"),
        ("exit", "the law 'my-law' failed at 0.051 s: SystemExit: 0"),
        ("build", "the law 'my-law' cannot be built: ValueError: boom"),
        ("names", "state_names = ('n', 'n'); strings are needed, each once"),
    ],
)
def test_a_law_that_fails_is_named_with_its_line_and_its_plug_in(plugged, capsys, mode, told):
    output = plugged / "s.mcap"
    text = said(capsys, of_law(plugged, mode), output, 2)
    assert told in text
    if mode in ("raise", "exit"):
        assert "my_law.py, line " in text and f"{output} holds what was recorded" in text
        assert main(["info", str(output)]) == 0
        assert f"broken off at 0.0510 s (tick 51): {told}" in capsys.readouterr().out
        assert main(["list", str(output), "--json"]) == 0
        (row,) = json.loads(capsys.readouterr().out)["sessions"]
        assert row["verdict"].endswith("broken off")


@pytest.mark.parametrize(
    ("name", "told"), [("my-syntax", "SyntaxError: '('"), ("my-empty", "no Config and no build")]
)
def test_a_broken_module_is_named_and_spoils_no_other(plugged, capsys, name, told):
    assert told in said(capsys, of_law(plugged, "", name), plugged / "s.mcap", 2)
    config = load_rig("arm6")
    config = dataclasses.replace(config, controller=ControllerConfig("position-force", ("arm",)))
    with pytest.raises(ConfigError, match="laws for any number of joints are cartesian-coupling"):
        open_rig(config, 0)


@pytest.mark.parametrize(
    ("mode", "told"),
    [
        ("open", "device 'one' (driver 'my-arm') cannot be opened: RuntimeError: boom"),
        ("enable", "device 'one' (driver 'my-arm') cannot be enabled: RuntimeError: boom"),
        ("measured_js", "device 'one' (driver 'my-arm') failed in measured_js: RuntimeError: boom"),
        ("servo_jf", "device 'one' (driver 'my-arm') failed in servo_jf: RuntimeError: boom"),
        ("none", "failed in measured_js: TypeError: it returned None; a hil.signals.device.Status"),
        ("text", "it returned 'OK'; a hil.signals.device.Status is needed"),
        ("far", "it returned 7; a hil.signals.device.Status is needed"),
        ("close", "failed to close (it was disabled): RuntimeError: boom"),
        ("disable", "failed to close (its motors may still be on: take their power off)"),
    ],
)
def test_a_driver_that_fails_is_named_with_its_device_and_its_plug_in(plugged, capsys, mode, told):
    output = plugged / "s.mcap"
    text = said(capsys, of_arm(plugged, mode), output, 3)
    assert told in text
    assert (f"{output} holds what was recorded" in text) == (mode != "open")


def test_an_estimator_that_fails_is_named(plugged, capsys):
    path = of_law(plugged, "ok")
    told = '[estimators.mine]\nname = "my-estimator"\narm = "leader"\n'
    path.write_text(path.read_text() + told)
    text = said(capsys, path, plugged / "s.mcap", 3)
    assert "'my-estimator' of hil.estimators failed: RuntimeError: boom" in text


def test_a_signal_is_no_error_of_the_law_that_it_hits(plugged, monkeypatch):
    rig = open_rig(load_rig(of_law(plugged, "ok")), 0)

    def update(*_):
        raise Ended(15)

    monkeypatch.setattr(rig.controller._law, "update", update)
    with pytest.raises(Ended, match="SIGTERM"):
        rig.controller.update(0.0, *[np.zeros(1)] * 4)
    rig.close()


def test_a_name_that_two_have_is_refused(plugged, monkeypatch):
    install(plugged, monkeypatch, "[hil.controllers]\nposition-force = my_law\n", "other")
    with pytest.raises(ConfigError, match=r"several: of this package .* and of other 3 \(my_law\)"):
        open_rig(load_rig("teleop"), 0)
    open_rig(load_rig("identify"), 0).close()


def test_a_driver_that_speaks_to_its_device_itself_runs_as_hardware_without_boxes(plugged):
    path = plugged / "s.mcap"
    done = run_session(load_rig(of_arm(plugged, backend="hardware")), 0.2, output=path)
    assert (done.clock, done.state) == ("real", "ENABLED")
    assert replay(path).differ == 0  # and opens no device
    with pytest.raises(ConfigError, match="needs boxes"):
        open_rig(load_rig(of_arm(plugged, backend="replay")), 0)


def test_the_force_of_a_plug_in_on_an_arm_with_a_urdf_is_recorded_and_replayed(plugged):
    over = {"devices": {"force": {"driver": "my-sensor", "arm": "arm"}}}
    path = record(plugged / "s.mcap", "arm6.toml", over=over)
    wrench = hil.load(path, "arm").wrench
    assert wrench is not None and (wrench == [1.5, 0.0, -2.0, 0.0, 0.0, 0.0]).all()
    assert replay(path).differ == 0


def test_a_sensor_that_is_not_known_before_it_is_opened_is_refused(plugged, monkeypatch):
    points = "[hil.drivers]\nmy-hidden = my_hidden\n"
    (plugged / "my_hidden.py").write_text(
        "from my_sensor import Config, hidden\nopen_device = hidden\n"
    )
    install(plugged, monkeypatch, points, "hidden")
    over = {"devices": {"force": {"driver": "my-hidden", "arm": "arm"}}}
    with pytest.raises(ConfigError, match="make open_device the class of the device"):
        open_rig(load_rig("arm6", over), 0)


def without(rig, *arms):
    """A rig file without the force sensors of some arms."""
    config = load_rig(rig)
    kept = {n: d for n, d in config.devices.items() if n not in {f"{a}-force" for a in arms}}
    return dataclasses.replace(config, devices=kept)


@pytest.mark.parametrize("rig", ["teleop", "lawrence", "mechanical-operator"])
def test_a_law_that_feels_a_force_refuses_an_arm_that_measures_none(rig):
    with pytest.raises(ConfigError, match=r"reads the force on the tip of arm 'follower'.*sensor"):
        open_rig(without(rig, "follower"), 0)


def test_the_scheme_of_a_delayed_law_says_whether_it_feels_a_force():
    open_rig(without("delayed", "leader", "follower"), 0).close()
    config = without("delayed", "follower")
    parameters = {**config.controller.parameters, "scheme": "model"}
    law = dataclasses.replace(config.controller, parameters=parameters)
    config = dataclasses.replace(config, controller=law)
    with pytest.raises(ConfigError, match="arm 'follower'"):
        open_rig(config, 0)


def test_an_arm_without_a_sensor_records_no_force(tmp_path):
    path = tmp_path / "s.mcap"
    run_session(without("teleop", "leader"), 0.1, output=path)
    assert hil.load(path, "leader").wrench is None
    assert hil.load(path, "follower").wrench is not None
    assert replay(path).differ == 0


def test_a_gain_on_a_force_that_nobody_measures_cannot_be_set(tmp_path):
    config = without("lawrence", "leader")
    operator = Operator([(0.05, "set c6 0.2")])
    with pytest.raises(ConfigError, match="reads the force on the tip of arm 'leader'"):
        run_session(config, 0.1, output=tmp_path / "s.mcap", operator=operator)
