"""Damiao drives over CAN: conformance, golden bytes, faults, an arm of two buses."""

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.drivers import damiao_can as codec
from hil.drivers.damiao import DamiaoArm, DamiaoArmConfig
from hil.drivers.damiao_can import DamiaoBusConfig
from hil.errors import ConfigError, DeviceError
from hil.rig.boxes import BoxPlace, CanDrives
from hil.signals.device import Status
from hil.sim_devices.canbus.line import CanFrame
from hil.testing import Tolerance, check_driver

sys.path.insert(0, str(Path(__file__).parent))
from joints_far import PERIOD_NS, DrivesFar

ALL = {"states", "position", "effort", "zero on exit", "unplug", "time-out", "bad frames"}


def test_conformance():
    far = DrivesFar()
    # half a step of the largest drive (54 N m in 12 bits) is 13 mN m; its speed has 22 mrad/s
    checked = check_driver(
        far.open, far, period=2e-3, tolerance=Tolerance(velocity=0.06, effort=0.014)
    )
    assert set(checked.done) == ALL
    assert checked.skipped == []


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        # the vendor's controlMIT(0, 0, 0, 0, 0) of a DM4310, and its enable, disable, clear
        (codec.effort_command(0), "7FFF7FF0000007FF"),
        (codec.special(codec.ENABLE), "FFFFFFFFFFFFFFFC"),
        (codec.special(codec.DISABLE), "FFFFFFFFFFFFFFFD"),
        (codec.special(codec.CLEAR_FAULT), "FFFFFFFFFFFFFFFB"),
        # its read_motor_param(1, CTRL_MODE), refresh_motor_status(1), switchControlMode(1, MIT)
        (codec.read_register(1, codec.MODE_REGISTER), "0100330A00000000"),
        (codec.refresh(1), "0100CC0000000000"),
        (codec.write_register(1, codec.MODE_REGISTER, 1), "0100550A01000000"),
    ],
)
def test_frames_are_those_of_the_vendors_program(made, expected):
    assert made.hex().upper() == expected


def test_an_answer_of_the_manual_is_read():
    # drive 1 on, position word 0x8000, speed 0x800, effort 0x7ff, 35 and 32 degC
    said = codec.feedback(bytes.fromhex("11 8000 80 07 FF 23 20"))
    assert said == (1, 1, 1, 1, -1, 35, 32)
    assert codec.feedback(b"\x11\x80") is None
    pmax = codec.register(bytes.fromhex("0100331500004841"))
    assert (pmax.drive, pmax.register, pmax.number) == (1, codec.PMAX, 12.5)


@given(st.integers(-4095, 4095))
def test_every_effort_comes_back_within_a_step(centred):
    far_word = int.from_bytes(codec.effort_command(centred), "big") & 0xFFF
    assert abs((2 * far_word - 4095) - centred) <= 1
    gains = int.from_bytes(codec.effort_command(centred), "big") >> 12 & 0xFFFFFF
    assert gains == 0


@given(st.integers(0, 65535), st.integers(0, 4095), st.integers(0, 4095), st.integers(0, 15))
def test_every_answer_is_read_as_it_was_packed(position, speed, effort, status):
    bits = (status << 4 | 3) << 56 | position << 40 | speed << 28 | effort << 16
    said = codec.feedback(bits.to_bytes(8, "big"))
    assert (said.drive, said.status) == (3, status)
    assert (said.position + 65535, said.speed + 4095, said.effort + 4095) == (
        2 * position,
        2 * speed,
        2 * effort,
    )


@given(st.binary(max_size=9))
def test_no_bytes_break_the_codec(data):
    for read in (codec.feedback, codec.register):
        found = read(data)
        assert found is None or len(data) == 8


def test_scales_come_from_the_drives_and_the_time_out_goes_to_them():
    far = DrivesFar()
    box = far.box()
    assert np.allclose(box.scales[0] * (65535, 4095, 4095), (12.5, 10.0, 28.0))
    assert struct.unpack("<I", far.drives[0].registers[9])[0] == 1000  # 50 ms in 50 us
    box.close()


def test_a_drive_in_another_mode_is_refused():
    far = DrivesFar()
    far.drives[3].registers[10] = struct.pack("<I", 2)
    with pytest.raises(DeviceError, match=r"drive 4 is in mode 2.*CTRL_MODE"):
        far.box()


def test_a_silent_drive_is_named_with_what_to_look_at():
    far = DrivesFar()
    far.drives[5].silent = True
    with pytest.raises(DeviceError, match=r"drive 6 .* does not answer .*0x16.*MST_ID"):
        far.box()


def enabled(far):
    device = far.open()
    q, qd, sent, zero = (np.zeros(6) for _ in range(4))
    t_ns = far.now_ns

    def tick(effort=zero):
        nonlocal t_ns
        t_ns += PERIOD_NS
        status = device.measured_js(t_ns, q, qd)
        return max(status, device.servo_jf(effort.copy(), sent))

    for _ in range(3):
        tick()
    device.enable()
    return device, tick


def test_a_fault_of_a_drive_stops_the_arm_and_is_told():
    far = DrivesFar()
    device, tick = enabled(far)
    assert tick() is Status.OK
    far.drives[1].fault = 0xC
    assert max(tick() for _ in range(3)) is Status.INVALID
    assert "drive 2 stopped: the winding is too hot" in device._wire.trouble
    for _ in range(3):
        tick()
    assert not far.effort().any()
    device.close()


def test_drives_stop_by_themselves_when_the_host_dies():
    far = DrivesFar()
    device, tick = enabled(far)
    for _ in range(3):
        tick(np.full(6, 1.0))
    assert far.effort().all()
    far.bench.advance(far.now_ns + 100_000_000)
    assert not far.effort().any()
    assert far.drives[0].fault == 0xD
    device.close()


def test_two_answers_of_one_drive_are_one():
    far = DrivesFar()
    device, tick = enabled(far)
    far.drives[0].outbox.append((far.now_ns, CanFrame(0x11, b"\x11" * 3)))
    tick()
    assert tick() is Status.OK
    device.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"master": 3}, "master = 0x3"),
        ({"lost_ms": 0.0}, "lost_ms"),
        ({"timeout_ms": -1.0}, "0 on"),
    ],
)
def test_options_out_of_range_are_refused(options, said):
    with pytest.raises(ConfigError, match=said):
        DamiaoBusConfig(**options)


def test_an_estimated_speed_begins_where_the_arm_rests():
    far = DrivesFar()
    box = codec.open_box("bus", far.bus, "can0", far.config, tuple(range(1, 7)))
    wire = CanDrives("arm", [(box, BoxPlace("bus", k + 1, 1)) for k in range(6)])
    arm = DamiaoArm("arm", wire, DamiaoArmConfig(velocity="foaw-end-fit"), 1e-9 * PERIOD_NS)
    q, qd = np.zeros(6), np.ones(6)
    arm.measured_js(far.now_ns + PERIOD_NS, q, qd)
    assert np.abs(arm.counts).min() > 100
    assert not qd.any()
    arm.close()
    box.close()
