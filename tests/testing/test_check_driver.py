"""The public conformance suite of drivers: it passes what is right and names what is wrong."""

import sys
from pathlib import Path

import numpy as np
import pytest

from hil.drivers.ft_sensor import FtSensor, FtSensorConfig
from hil.drivers.premium import PremiumArm, PremiumConfig
from hil.errors import DeviceError
from hil.signals.device import OperatingState, StateCommand, Status
from hil.testing import ConformanceError, FarEnd, Tolerance, check_driver

sys.path.insert(0, str(Path(__file__).parents[1] / "drivers"))
from bench_far import ArmFar, SensorFar


class Arm(FarEnd):
    """A far end of three lines a sense: counts, codes and a plug, at once."""

    trouble = ""

    def __init__(self):
        super().__init__()
        self.counts, self.gauges = np.zeros(3, np.int64), np.zeros(6, np.int64)
        self.codes, self.here, self.silent, self.spoilt = np.zeros(3), True, False, False
        config = PremiumConfig()
        gear = np.diag(np.array(config.gear))
        self.per_rad = gear * config.counts_per_turn / (2 * np.pi)
        self.per_code = 10.0 / 2**15 * 0.5513 * 0.0234 * gear
        self.place(self.pose)

    def place(self, position):
        self.pose[:] = position
        self.counts[:] = np.floor(position * self.per_rad)

    def effort(self):
        return self.codes * self.per_code

    def unplug(self):
        self.here, self.codes = False, np.zeros(3)

    def replug(self):
        self.here = True

    def mute(self, on):
        self.silent = on

    def garble(self):
        self.spoilt = True

    def home(self, counts):
        pass

    def receive(self, t_ns):
        spoilt, self.spoilt = self.spoilt, False
        if not self.here:
            return Status.LOST
        return Status.STALE if self.silent or spoilt else Status.OK

    def send(self, codes):
        if self.here:
            self.codes = codes.copy()

    def power(self, on):
        pass

    def close(self):
        pass

    def open(self, kind=PremiumArm):
        if not self.here:
            raise DeviceError("arm 'arm' is not attached; plug it in.")
        return kind("arm", self, PremiumConfig(), 1e-3)


def test_a_good_driver_passes_everything():
    far = Arm()
    checked = check_driver(far.open, far)
    assert not checked.skipped
    assert checked.done == [
        "states",
        "position",
        "effort",
        "zero on exit",
        "unplug",
        "time-out",
        "bad frames",
    ]


def test_the_arm_on_its_ideal_wire_passes():
    far = ArmFar()
    checked = check_driver(lambda: PremiumArm("arm", far.wire, PremiumConfig(), 1e-3), far)
    assert checked.done == ["states", "position", "effort", "zero on exit"]
    assert checked.skipped == ["unplug", "time-out", "bad frames"]


def test_the_force_sensor_on_its_ideal_wire_passes():
    far = SensorFar()
    checked = check_driver(
        lambda: FtSensor("ft", far.wire, FtSensorConfig(), 1e-3),
        far,
        tolerance=Tolerance(torque=0.02),  # of its cross-talk
    )
    assert checked.done == ["states", "force"]


class NoZero(PremiumArm):
    def disable(self):
        if self.state is not OperatingState.FAULT:
            self._machine.command(StateCommand.DISABLE)


class WrongSign(PremiumArm):
    def measured_js(self, t_ns, position, velocity):
        status = super().measured_js(t_ns, position, velocity)
        velocity *= -1.0
        return status


class Raises(PremiumArm):
    def measured_js(self, t_ns, position, velocity):
        if not self._wire.here:
            raise OSError("gone")
        return super().measured_js(t_ns, position, velocity)


class Deaf(PremiumArm):
    def measured_js(self, t_ns, position, velocity):
        super().measured_js(t_ns, position, velocity)
        return Status.OK


class Degrees(PremiumArm):
    def measured_js(self, t_ns, position, velocity):
        status = super().measured_js(t_ns, position, velocity)
        position *= 180 / np.pi
        return status


class Halves(PremiumArm):
    def servo_jf(self, effort, sent):
        effort *= 0.5
        status = super().servo_jf(effort, sent)
        sent *= 2.0
        return status


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        (NoZero, "after disable"),
        (WrongSign, "speed"),
        (Raises, "fast path raised"),
        (Deaf, "does not notice"),
        (Degrees, "measured"),
        (Halves, "sends"),
    ],
)
def test_a_wrong_driver_is_named(kind, says):
    far = Arm()
    with pytest.raises(ConformanceError, match=says):
        check_driver(lambda: far.open(kind), far)
