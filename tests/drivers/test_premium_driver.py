"""Driver of the arm: counts to angles, torques to codes, states."""

import numpy as np
import pytest

from hil.drivers.premium import PremiumArm, PremiumConfig
from hil.errors import DeviceError
from hil.signals.device import MeasuredJs, ServoJf, Status
from hil.signals.state import OperatingState

MS = 1_000_000
GEAR = np.array([13.3, 11.2, 11.2])


class FakeWire:
    trouble = ""

    def __init__(self):
        self.counts, self.gauges = np.zeros(3, np.int64), np.zeros(6, np.int64)
        self.sent, self.on, self.closed = np.zeros(3, np.int64), False, False

    def home(self, counts):
        pass

    def receive(self, t_ns):
        return Status.OK

    def send(self, codes):
        self.sent[:] = codes

    def power(self, on):
        self.on = on

    def close(self):
        self.closed = True


@pytest.fixture
def arm():
    return PremiumArm("arm", FakeWire(), PremiumConfig(), 1e-3)


def wire(arm):
    return arm._wire


def test_it_has_its_capabilities(arm):
    assert isinstance(arm, MeasuredJs)
    assert isinstance(arm, ServoJf)


def test_counts_become_angles_within_half_a_count(arm):
    angle = np.array([0.3, -0.2, 1.1])
    wire(arm).counts[:] = np.floor(angle * GEAR * 4096 / (2 * np.pi))
    q, qd = np.zeros(3), np.zeros(3)
    assert arm.measured_js(MS, q, qd) is Status.OK
    assert (np.abs(q - angle) <= np.pi / 4096 / GEAR + 1e-12).all()


@pytest.mark.parametrize("speed", [0.02, 0.3, 2.5])
def test_speed_of_a_steady_turn(arm, speed):
    q, qd = np.zeros(3), np.zeros(3)
    arm.enable()
    for k in range(1, 200):
        wire(arm).counts[:] = np.floor(speed * k * 1e-3 * GEAR * 4096 / (2 * np.pi))
        arm.measured_js(k * MS, q, qd)
    np.testing.assert_allclose(qd, speed, atol=0.03 * speed + 0.012)


def test_a_missed_tick_is_not_a_jump_of_speed(arm):
    q, qd = np.zeros(3), np.zeros(3)
    arm.enable()
    for k in [*range(1, 100), 120]:
        wire(arm).counts[:] = np.floor(k * 1e-3 * GEAR * 4096 / (2 * np.pi))
        arm.measured_js(k * MS, q, qd)
    np.testing.assert_allclose(qd, 1.0, atol=0.05)


def test_torque_goes_out_in_whole_codes(arm):
    arm.enable()
    asked, sent = np.array([0.1, -0.05, 0.02]), np.zeros(3)
    assert arm.servo_jf(asked, sent) is Status.OK
    step = GEAR * 0.0234 * 0.5513 * 10 / 2**15
    assert (np.abs(sent - asked) <= step / 2 + 1e-12).all()
    np.testing.assert_allclose(sent / step, arm.codes, atol=1e-9)
    np.testing.assert_array_equal(wire(arm).sent, arm.codes)


def test_torque_is_clamped_at_the_stall_of_the_motor(arm):
    arm.enable()
    sent = np.zeros(3)
    assert arm.servo_jf(np.array([99.0, -99.0, 0.0]), sent) is Status.CLAMPED
    np.testing.assert_allclose(np.abs(sent[:2]), 0.129 * GEAR[:2], rtol=1e-3)
    np.testing.assert_allclose(sent[:2], arm.effort_limit[:2] * [1, -1])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_not_a_number_is_no_torque_and_a_latched_fault(arm, bad):
    arm.enable()
    sent = np.zeros(3)
    assert arm.servo_jf(np.array([0.1, bad, 0.1]), sent) is Status.INVALID
    assert arm.state is OperatingState.FAULT
    arm.servo_jf(np.full(3, 0.1), sent)
    assert not sent.any()
    assert not wire(arm).sent.any()


def test_only_an_enabled_arm_sends(arm):
    sent = np.zeros(3)
    arm.servo_jf(np.full(3, 0.1), sent)
    assert not sent.any()
    arm.enable()
    arm.pause()
    arm.servo_jf(np.full(3, 0.1), sent)
    assert not sent.any()
    arm.resume()
    arm.servo_jf(np.full(3, 0.1), sent)
    assert sent.all()
    arm.close()
    assert not wire(arm).sent.any()
    assert wire(arm).closed
    assert not wire(arm).on


def test_enabling_twice_is_refused(arm):
    arm.enable()
    with pytest.raises(DeviceError, match="arm is ENABLED and cannot ENABLE"):
        arm.enable()
