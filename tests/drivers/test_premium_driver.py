"""Driver of the arm: counts to angles, torques to codes, states."""

import numpy as np
import pytest

from hil.drivers.premium import PremiumArm, PremiumConfig
from hil.errors import ConfigError, DeviceError
from hil.signals.device import MeasuredJs, OperatingState, ServoJf, Status

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


MINUS = "get a minus before their places in channels.motors"
DIAGONAL = ((13.3, 0.0, 0.0), (0.0, 11.2, 0.0), (0.0, 0.0, 11.2))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"amps_per_volt": -0.5513}, f"amps_per_volt = -0.5513.*{MINUS}"),
        ({"amps_per_volt": np.nan}, "amps_per_volt = nan"),
        ({"torque_constant": -0.0234}, f"torque_constant = -0.0234.*{MINUS}"),
        ({"torque_constant": 0.0}, "torque_constant = 0;"),
        ({"dac_volts": -10.0}, MINUS),
        ({"stall_torque": 0.0}, "stall_torque = 0;"),
        ({"stall_torque": -0.129}, "stall_torque = -0.129"),
        ({"stall_torque": 1e-9}, "less than one code"),
        ({"counts_per_turn": 0}, "counts_per_turn = 0;.*channels.encoders"),
        ({"counts_per_turn": -4096}, "counts_per_turn = -4096;"),
        *(({"dac_bits": bits}, f"dac_bits = {bits}; 8 to 16") for bits in (-4, 0, 17, 64)),
        ({"gear": ((13.3, 0.0), (0.0, 11.2))}, "three rows of three"),
        ({"gear": ((13.3, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 11.2))}, "cannot be inverted"),
        ({"gear": ((np.nan, 0.0, 0.0), *DIAGONAL[1:])}, "cannot be inverted"),
    ],
)
def test_a_drive_train_that_no_arm_has_is_refused(options, says):
    with pytest.raises(ConfigError, match=says):
        PremiumConfig(**options)


def test_every_config_that_is_taken_gives_no_torque_at_zero_effort():
    turned = ((-13.3, 0.0, 0.0), (0.0, 11.2, 0.0), (0.0, 3.0, 11.2))
    for options in ({}, {"dac_bits": 8}, {"amps_per_volt": 5.0}, {"gear": turned}):
        arm = PremiumArm("arm", FakeWire(), PremiumConfig(**options), 1e-3)
        arm.enable()
        sent = np.ones(3)
        assert arm.servo_jf(np.zeros(3), sent) is Status.OK
        assert not sent.any() and not wire(arm).sent.any()
        arm.servo_jf(np.full(3, 0.1), sent)
        np.testing.assert_allclose(sent, 0.1, atol=0.02)
        assert (arm.effort_limit > 0).all()


@pytest.mark.parametrize("velocity", ["foaw-end-fit", "kalman", "first-difference"])
def test_the_first_reading_is_where_the_arm_rests(velocity):
    home = (0.0, 0.4, 0.3)
    arm = PremiumArm("arm", FakeWire(), PremiumConfig(home=home, velocity=velocity), 1e-3)
    arm._wire.counts[:] = np.floor(np.array(home) * GEAR * 4096 / (2 * np.pi))
    q, qd = np.zeros(3), np.ones(3)
    arm.measured_js(MS, q, qd)
    np.testing.assert_allclose(qd, 0.0, atol=1e-9)
    np.testing.assert_allclose(q, home, atol=1e-3)


def test_an_arm_of_another_kind_is_refused_unless_its_drive_train_is_given():
    with pytest.raises(ConfigError, match="arm 'a' has 2 joints"):
        PremiumConfig().refuse_arm("a", "", 2)
    with pytest.raises(ConfigError, match=r"those of phantom-premium-1\.5, and arm 'a' is a"):
        PremiumConfig().refuse_arm("a", "phantom-omni", 3)
    own = ((11.7, 0.0, 0.0), *DIAGONAL[1:])
    PremiumConfig(gear=own).refuse_arm("a", "phantom-omni", 3)
    PremiumConfig().refuse_arm("a", "", 3)
