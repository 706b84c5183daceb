"""`hil devices` and sessions over boxes: what is reachable, at which rate, and what goes wrong."""

import json
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from hil import registry
from hil.cli import main
from hil.commands import devices
from hil.drivers.usb_31xx import driver as usb_31xx
from hil.drivers.usb_quad08 import driver as usb_quad08
from hil.errors import ConfigError, DeviceError
from hil.record.mcap_read import load
from hil.rig import boxes
from hil.rig.config import load_rig
from hil.rig.open import bench_of
from hil.runtime.runner import run_session
from hil.signals.bus import Bus
from hil.sim_devices import bench as bench_module
from hil.sim_devices.hid.module import SimHid
from hil.sim_devices.hid.usb31xx import Sim31xx
from hil.sim_devices.usb.backend import SimUsb
from hil.sim_devices.usb.quad08 import SimQuad08

RIGS = Path(__file__).parents[2] / "rigs"
WIRE = {"backend": "sim-wire"}


def rows(capsys, *words):
    code = main(["devices", *map(str, words), "--json"])
    table = json.loads(capsys.readouterr().out)["devices"]
    return code, {r["device"]: r for r in table}


def rig_file(tmp_path, backend, *changes):
    text = (RIGS / "identify.toml").read_text().replace('backend = "sim"', f'backend = "{backend}"')
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return path


def test_rates_follow_the_wiring(tmp_path, capsys):
    code, found = rows(capsys, rig_file(tmp_path, "sim-wire"))
    assert code == 0
    assert "motors change 930 times/s in a loop of 1000 Hz" in found["leader-arm"]["what"]
    one_box = (
        '["leader-motor1/0", "leader-motor2/0", "leader-motor3/0"]',
        '["leader-motor1/0", "leader-motor1/1", "leader-motor1/2"]',
    )
    code, found = rows(capsys, rig_file(tmp_path, "sim", one_box))
    assert "at signal level; over its boxes motors change 232" in found["leader-arm"]["what"]
    code, found = rows(capsys, rig_file(tmp_path, "sim-wire", one_box))
    assert "motors change 232 times/s" in found["leader-arm"]["what"]
    assert "leader-motor2" not in found


def test_on_hardware_every_missing_box_says_so(tmp_path, capsys):
    code, found = rows(capsys, rig_file(tmp_path, "hardware"))
    assert code == 3
    assert {r["reachable"] for r in found.values()} == {"no"}
    assert "plug it in" in found["encoders"]["what"] or "libusb" in found["encoders"]["what"]
    assert "its boxes encoders" in found["leader-arm"]["what"]


def test_without_a_rig_the_real_libraries_are_asked(capsys):
    code, _ = rows(capsys)
    assert code in (0, 3)  # 3 where something is attached that may not be opened
    assert main(["devices"]) == code
    said = capsys.readouterr().out
    assert "usb-quad08" in said
    assert "usb-31xx" in said


def test_a_session_over_boxes_is_that_over_ideal_wires(tmp_path):
    paths = [tmp_path / "ideal.mcap", tmp_path / "wire.mcap"]
    for path, over in zip(paths, ({}, WIRE), strict=True):
        run_session(load_rig(RIGS / "identify.toml", over), 2.0, seed=3, output=path)
    ideal, wire = (load(path, "leader") for path in paths)
    # 0.4 ms of age at up to 2.5 rad/s, and a millisecond more to the motors
    assert np.abs(ideal.q - wire.q).max() < 3e-3
    assert 0 < np.abs(ideal.q - wire.q).max()
    assert np.std(wire.tau) == pytest.approx(np.std(ideal.tau), rel=0.05)


def test_sessions_over_boxes_repeat_to_the_byte(tmp_path):
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for path in paths:
        run_session(load_rig(RIGS / "identify.toml", WIRE), 0.5, seed=3, output=path)
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.parametrize(("box", "says"), [("encoders", "unplugged"), ("leader-motor2", "gone")])
def test_a_box_that_is_pulled_out_stops_the_session(tmp_path, monkeypatch, box, says):
    real = bench_module.Bench.advance

    def advance(self, t_ns):
        real(self, t_ns)
        if t_ns > 600_000_000:
            self.wired.boxes[box].plugged = False

    monkeypatch.setattr(bench_module.Bench, "advance", advance)
    with pytest.raises(DeviceError, match=f"{box}.*{says}") as caught:
        run_session(load_rig(RIGS / "identify.toml", WIRE), 2.0, output=tmp_path / "s.mcap")
    assert "holds what was recorded" in str(caught.value)
    assert 100 < load(tmp_path / "s.mcap", "leader").n < 700


def test_every_motor_gets_zero_when_a_session_is_broken_off(tmp_path, monkeypatch):
    seen = []
    real = registry.load

    def keep(group, name):
        found = real(group, name)
        if group != "hil.sim_devices":
            return found

        def open_bench(*given):
            seen.append(found(*given))
            return seen[-1]

        return open_bench

    monkeypatch.setattr(registry, "load", keep)

    def stop(ticks):
        if seen[-1].now_ns > 900_000_000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_session(
            load_rig(RIGS / "identify.toml", WIRE), 2.0, output=tmp_path / "s.mcap", progress=stop
        )
    boxes = seen[-1].wired.boxes
    volts = [b.volts[0] for name, b in boxes.items() if "motor" in name]
    assert len(volts) == 6
    assert np.abs(volts).max() < 1e-3
    seen[-1].advance(seen[-1].now_ns + 100_000_000)
    assert seen[-1].state["parked"].all()  # the amplifiers' watchdog


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("encoders/1", "encoder/1"), "Did you mean 'encoders'"),
        (("encoders/1", "encoders"), "write BOX/CHANNEL"),
        (("encoders/1", "encoders/0"), "encoders/0 twice"),
        (('["encoders/0", "encoders/1", "encoders/2"]', '["encoders/0"]'), "needs 3 places"),
        (('address = "leader-2"', 'address = "leader-1"'), "an address of its own"),
        (("channels.motors", "channels.motor"), "Did you mean 'motors'"),
        (("[boxes.encoders]\n", '[boxes.encoders]\nbackend = "hid"\n'), "speaks 'usb', not 'hid'"),
        (
            ("[boxes.leader-motor1]\n", "[boxes.leader-motor1]\noptions.heartbeat_ms = 0.0\n"),
            "none of its motor boxes gives a heartbeat",
        ),
    ],
)
def test_mistakes_in_the_wiring_are_named(tmp_path, change, says):
    path = rig_file(tmp_path, "sim-wire", change)
    with pytest.raises(ConfigError, match=says.replace("(", r"\(")):
        run_session(load_rig(path), 0.1, output=tmp_path / "s.mcap")


def test_the_plan_of_the_cables():
    config = load_rig(RIGS / "identify.toml", WIRE)
    plan = boxes.wiring_plan(config)
    assert plan["follower-motor3"]["cables"] == [(0, "motors", "follower", 2, 1)]
    assert [c[0] for c in plan["encoders"]["cables"]] == [0, 1, 2, 3, 4, 5]
    assert bench_of(config, 0) is not None
    assert boxes.wiring_plan(load_rig(RIGS / "identify.toml")) == {}


def test_boxes_that_may_not_be_opened_say_what_to_do(monkeypatch, capsys):
    usb, hid = SimUsb(), SimHid()
    quads = [SimQuad08(f"Q{k}", lambda out: None, cold=k == 2) for k in range(3)]
    quads[1].readable = False
    usb.devices += quads
    hid.devices += [Sim31xx("usb-3101", "A1"), Sim31xx("usb-3114", "A2")]
    hid.devices[1].readable = False
    handles = {"usb": usb, "hid": hid}
    monkeypatch.setattr(devices, "Bus", lambda kind: Bus(kind, handles.get(kind)))
    seen = {(r["device"], r["reachable"]): r["what"] for r in devices.everything()}
    assert seen["Q0", "yes"].startswith("USB-QUAD08")
    assert "eight encoder counters" in seen["Q0", "yes"]
    assert "usb-3101" in seen["A1", "yes"]
    assert "09db" in seen["A2", "no"]
    texts = [one.what for one in usb_quad08.attached(Bus("usb", usb))]
    assert any("without firmware" in t for t in texts)
    assert any("udevadm" in t for t in texts)
    monkeypatch.setattr("usb.backend.libusb1.get_backend", lambda **kwargs: None)
    monkeypatch.setattr("usb.backend.libusb0.get_backend", lambda **kwargs: None)
    monkeypatch.setattr("usb.backend.openusb.get_backend", lambda **kwargs: None)
    with pytest.raises(DeviceError, match="libusb-1"):
        usb_quad08.attached(Bus("usb"))
    assert main(["devices"]) == 3


def test_the_wrong_hid_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "hid", types.ModuleType("hid"))
    with pytest.raises(DeviceError, match="where 'hidapi' is needed"):
        usb_31xx.attached(Bus("hid"))
    monkeypatch.setitem(sys.modules, "hid", None)
    with pytest.raises(DeviceError, match="pip install hidapi"):
        usb_31xx.attached(Bus("hid"))


@pytest.mark.parametrize("backend", ["sim", "sim-wire"])
def test_a_motor_channel_of_two_arms_is_refused_on_every_back_end(tmp_path, capsys, backend):
    change = ("follower-motor1/0", "leader-motor1/0")
    path = rig_file(tmp_path, backend, change)
    for words in (["devices", path], ["run", path, "-o", tmp_path / "s.mcap"], ["selftest", path]):
        assert main([str(w) for w in words]) == 2
        said = capsys.readouterr().err
        assert f"{path}: [devices.follower-arm.channels]: motors has leader-motor1/0" in said
        assert "[devices.leader-arm.channels] too" in said
    assert not (tmp_path / "s.mcap").exists()


@pytest.mark.parametrize(
    ("change", "table"),
    [
        (('model = "nano25"', 'model = "nano99"'), "[devices.leader-force.options]"),
        (("[boxes.encoders]", "[boxes.encoders]\noptions.bits = 24"), "[boxes.encoders.options]"),
        (("options.home", "options.hom"), "[devices.leader-arm.options]"),
        (('driver = "premium"', 'driver = "premum"'), "[devices.leader-arm]"),
        (('driver = "usb-quad08"', 'driver = "usb-quad8"'), "[boxes.encoders]"),
        (('"encoders/2"]', '"encoders/2", "encoders/6"]'), "[devices.leader-arm.channels]"),
        (("period = 10.0", "perod = 10.0"), "[controller.parameters]"),
        (('name = "joint-tracking"', 'name = "joint-trackin"'), "[controller]"),
    ],
)
def test_a_mistake_of_a_driver_has_the_name_of_the_file_and_of_the_table(
    tmp_path, capsys, change, table
):
    path = rig_file(tmp_path, "sim-wire", change)
    for words in (["devices", path], ["run", path, "-o", tmp_path / "s.mcap"], ["selftest", path]):
        assert main([str(w) for w in words]) == 2
        assert f"{words[0]}: {path}: {table}: " in capsys.readouterr().err


def test_an_old_session_stays_where_it_is_until_the_devices_are_open(tmp_path, capsys):
    path = tmp_path / "s.mcap"
    path.write_bytes(b"a session")
    assert main(["run", str(rig_file(tmp_path, "hardware")), "-o", str(path)]) == 3
    assert "kept as" not in capsys.readouterr().err
    assert path.read_bytes() == b"a session"
    good = str(rig_file(tmp_path, "sim"))
    missing = ["--model", str(tmp_path / "no.toml")]
    assert main(["run", good, "-o", str(path), "--seconds", "0.1", *missing]) == 2
    assert path.read_bytes() == b"a session"
    assert main(["run", good, "-o", str(path), "--seconds", "0.1"]) == 0
    assert (tmp_path / "s.1.mcap").read_bytes() == b"a session"


@pytest.mark.parametrize("backend", ["sim-wire", "hardware"])
@pytest.mark.parametrize("words", [["devices", "RIG"], ["run", "RIG", "-o", "OUT"]])
def test_a_rig_without_boxes_is_refused_where_they_are_needed(tmp_path, capsys, backend, words):
    text = (RIGS / "lawrence.toml").read_text()
    rig, out = tmp_path / "rig.toml", tmp_path / "s.mcap"
    rig.write_text(text.replace('backend = "sim"', f'backend = "{backend}"'))
    assert main([{"RIG": str(rig), "OUT": str(out)}.get(w, w) for w in words]) == 2
    said = capsys.readouterr()
    assert not said.out and said.err.count("\n") == 1 and not out.exists()
    assert f"'{backend}' needs boxes, and wired to none is leader-arm, leader-force" in said.err
    assert "[devices.leader-arm.channels]" in said.err and 'backend = "sim"' in said.err


def test_only_the_device_on_wires_needs_boxes(tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    old = "[devices.follower-force]\n"
    text = (RIGS / "lawrence.toml").read_text()
    rig.write_text(text.replace(old, f'{old}backend = "sim-wire"\n'))
    assert main(["devices", str(rig)]) == 2
    assert (
        "wired to none is follower-force; add [devices.follower-force.channels]"
        in capsys.readouterr().err
    )
    code, found = rows(capsys, rig_file(tmp_path, "sim", (old, f'{old}backend = "sim-wire"\n')))
    assert code == 0
    assert "over box follower-ft" in found["follower-force"]["what"]
    assert "at signal level" in found["leader-force"]["what"]
