"""ATI Nano17 and Nano25 force/torque sensors: gauge words in, wrench in the base frame out.

The words come from a box on a bus or from an ideal sensor (`Wire`).  They lose their bias, go
through the calibration, and are rotated into the base frame by compiled code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin
from typing import Any, Protocol, runtime_checkable

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.signals.device import (
    FloatArray,
    IntArray,
    OperatingState,
    StateCommand,
    StateMachine,
    Status,
    Wire,
)


@dataclass(frozen=True)
class Transducer:
    """A model of force sensor.

    Parameters
    ----------
    force, torque : float
        Sensitivity [words/N], [words/(N m)].
    ranges : tuple of 6 floats
        Largest Fx, Fy, Fz [N] and Tx, Ty, Tz [N m], in the sensor's own axes.
    """

    force: float
    torque: float
    ranges: tuple[float, ...]


#: Ranges of ATI's product pages: Nano17 SI-12-0.12 and Nano25 SI-125-3.  Sensitivities are of this
#: rig's converters.
TRANSDUCERS: dict[str, Transducer] = {
    "nano17": Transducer(1280.0, 160000.0, (12.0, 12.0, 17.0, 0.12, 0.12, 0.12)),
    "nano25": Transducer(192.0, 8000.0, (125.0, 125.0, 500.0, 3.0, 3.0, 3.0)),
}


#: Units of the configuration page of a Net F/T box, in N and N m.
_FORCE = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "kgf": 9.80665}
TORQUE = {
    "N-m": 1.0,
    "N-mm": 1e-3,
    "kN-m": 1e3,
    "lbf-in": 0.1129848290276167,
    "lbf-ft": 1.3558179483314004,
}


@dataclass(frozen=True)
class CountScale:
    """Counts per unit and the units, as the box's configuration page shows them.

    Parameters
    ----------
    counts_per_force, counts_per_torque : int
        Usually a million each, but the page decides.
    force_unit, torque_unit : str
        Units of the calibration.
    """

    counts_per_force: int = 1_000_000
    counts_per_torque: int = 1_000_000
    force_unit: str = "N"
    torque_unit: str = "N-m"

    def __post_init__(self) -> None:
        if self.force_unit not in _FORCE:
            raise ConfigError(unknown("force_unit", self.force_unit, _FORCE))
        if self.torque_unit not in TORQUE:
            raise ConfigError(unknown("torque_unit", self.torque_unit, TORQUE))
        if self.counts_per_force < 1 or self.counts_per_torque < 1:
            raise ConfigError("counts_per_force and counts_per_torque must be positive.")

    def calibration(self, factors: tuple[float, ...] = (1.0,) * 6) -> FloatArray:
        """Matrix (6, 6): wrench per word [N, N m]; `factors` are counts per word of each axis."""
        force = _FORCE[self.force_unit] / self.counts_per_force
        torque = TORQUE[self.torque_unit] / self.counts_per_torque
        return np.diag(np.array([force] * 3 + [torque] * 3) * np.array(factors))

    def record(self) -> dict[str, str]:
        """As text, for a session's metadata."""
        return {
            "counts_per_force": str(self.counts_per_force),
            "counts_per_torque": str(self.counts_per_torque),
            "units": f"{self.force_unit}, {self.torque_unit}",
        }


@dataclass(frozen=True)
class FtSensorConfig:
    """Which sensor.

    Parameters
    ----------
    model : str
        ``"nano17"`` or ``"nano25"``.
    tare_samples : int
        Readings that are averaged for the bias before the arm is enabled.
    """

    model: str = "nano17"
    tare_samples: int = 200

    def __post_init__(self) -> None:
        if self.model not in TRANSDUCERS:
            raise ConfigError(unknown("force sensor model", self.model, TRANSDUCERS))
        if self.tare_samples < 1:
            raise ConfigError("tare_samples must be at least 1.")

    def calibration(self) -> NDArray[np.float64]:
        """Matrix (6, 6): wrench in the sensor frame per word [N, N m].

        The three beams stand at 0, 120 and 240 degrees; each has an axial gauge
        fz + tx sin a - ty cos a and a tangential one fy cos a - fx sin a + tz.  Summing over
        the beams inverts this: fz = sum/3, tx = 2/3 sum(axial sin a), and so on.
        """
        force, torque = TRANSDUCERS[self.model].force, TRANSDUCERS[self.model].torque
        c = np.zeros((6, 6))
        for beam in range(3):
            a = 2 * np.pi * beam / 3
            axial, tangential = 2 * beam, 2 * beam + 1
            c[2, axial], c[5, tangential] = 1 / 3, 1 / 3
            c[3, axial], c[4, axial] = 2 / 3 * np.sin(a), -2 / 3 * np.cos(a)
            c[0, tangential], c[1, tangential] = -2 / 3 * np.sin(a), 2 / 3 * np.cos(a)
        return np.asarray(c / np.array([force] * 3 + [torque] * 3)[:, None])


@nb.njit(cache=True, nogil=True)
def calibrated(
    words: Any, bias: Any, calibration: Any, ranges: Any, position: Any, out: Any
) -> bool:
    """Force [N] and torque [N m] ON the robot in the base frame.

    Parameters
    ----------
    words, bias : ndarray (6,)
        Gauge words and their values without load.
    calibration : ndarray (6, 6)
        Wrench in the sensor frame per word.
    ranges : ndarray (6,)
        Largest force [N] and torque [N m] of every axis of the sensor.
    position : ndarray (3,)
        Joint angles [rad]; th3 is the forearm's angle from the base.
    out : ndarray (6,)
        Written.

    Returns
    -------
    bool
        Whether each axis of the sensor is within its range.
    """
    within = True
    s1, c1, s3, c3 = sin(position[0]), cos(position[0]), sin(position[2]), cos(position[2])
    for half in range(2):
        x, y, z = 0.0, 0.0, 0.0
        for k in range(6):
            load = words[k] - bias[k]
            x += calibration[3 * half, k] * load
            y += calibration[3 * half + 1, k] * load
            z += calibration[3 * half + 2, k] * load
        own = ranges[3 * half : 3 * half + 3]
        if not (abs(x) <= own[0] and abs(y) <= own[1] and abs(z) <= own[2]):
            within = False
        # sensor axes in (radial, across, up): x = (c3, 0, s3), y = (0, -1, 0), z = (s3, 0, -c3)
        radial, across, up = c3 * x + s3 * z, -y, s3 * x - c3 * z
        # base = Rz(th1) (radial, across, up)
        out[3 * half] = c1 * radial - s1 * across
        out[3 * half + 1] = s1 * radial + c1 * across
        out[3 * half + 2] = up
    return within


@nb.njit(cache=True, nogil=True)
def at_end(words: Any, full: int) -> bool:
    """Whether one of the `words` (6,) is at `full` or more, or below -`full`."""
    for k in range(words.size):
        if words[k] >= full or words[k] < -full:
            return True
    return False


@runtime_checkable
class GaugeSource(Protocol):
    """Six words of a sensor, and what they mean.

    Attributes
    ----------
    gauges : ndarray (6,) of int
        Words of the last whole sample; stays the same array.
    calibration : ndarray (6, 6)
        Wrench in the sensor frame per word [N, N m].
    certificate : dict of str to str
        What the sensor said of itself: serial number, matrix and so on.
    """

    gauges: IntArray
    calibration: FloatArray
    certificate: dict[str, str]

    def receive(self, t_ns: int) -> Status:
        """Take what has arrived by `t_ns` and ask for the next sample; never waits or raises.

        STALE: `gauges` hold the last good sample.  LOST: there has been none for too long.
        """
        ...

    def sample(self, t_ns: int) -> int:
        """Wait for one new sample from `t_ns` on; return the time then [ns].

        Raises
        ------
        DeviceError
            If none comes, or it is not usable.
        """
        ...

    def check(self) -> None:
        """Refuse with a `DeviceError` while the sensor cannot be used."""
        ...

    def close(self) -> None:
        """Release what the source holds."""
        ...


#: Largest word of a converter with 16 bits.
FULL_SCALE = 32767
_GOOD = Status.OK


class IdealGauges:
    """Words of the ideal wire: every reading is there, whole and of now.

    Parameters
    ----------
    wire : Wire
        Wire to the gauges.
    calibration : ndarray (6, 6)
        Wrench per word [N, N m].
    period : float
        Sample period [s].
    """

    def __init__(self, wire: Wire, calibration: FloatArray, period: float) -> None:
        self._wire = wire
        self._period_ns = round(period * 1e9)
        self.gauges, self.calibration = wire.gauges, calibration
        self.certificate: dict[str, str] = {}

    def receive(self, t_ns: int) -> Status:
        """Refresh the words; CLAMPED where one stands at the end of its converter."""
        status = self._wire.receive(t_ns)
        if status is _GOOD and at_end(self.gauges, FULL_SCALE):
            return Status.CLAMPED
        return status

    def sample(self, t_ns: int) -> int:
        """Words of one period later."""
        self._wire.receive(t_ns + self._period_ns)
        return t_ns + self._period_ns

    def check(self) -> None:
        """Always usable."""

    def close(self) -> None:
        """Release the wire."""
        self._wire.close()


#: Looked up once: members of an enumeration are slow to find in the fast path.
_OK, _CLAMPED, _INVALID, _LOST = Status.OK, Status.CLAMPED, Status.INVALID, Status.LOST


class ForceSensor:
    """One sensor, whatever its wire: `MeasuredCf` and `Tareable`.

    Parameters
    ----------
    name : str
        Name of the device.
    source : GaugeSource
        Where its words come from.
    tare_samples : int
        Readings that are averaged for the bias.
    ranges : sequence of 6 floats
        Largest force [N] and torque [N m] in the sensor's own axes; a sample beyond one of them
        counts as clamped.

    Attributes
    ----------
    max_force : float
        Smallest range of the three forces [N].
    """

    #: Its wrench is turned by the joints of a PHANTOM.
    ANY_ARM = False

    def __init__(
        self, name: str, source: GaugeSource, tare_samples: int, ranges: Sequence[float]
    ) -> None:
        self.name = name
        self.source = source
        self._samples = tare_samples
        self._machine = StateMachine(name)
        self._calibration = source.calibration
        self.max_force, self._ranges = float(min(ranges[:3])), np.array(ranges)
        self.gauges = source.gauges
        self.bias = np.zeros(6)

    @property
    def state(self) -> OperatingState:
        """Operating state now."""
        return self._machine.state

    @property
    def certificate(self) -> dict[str, str]:
        """What the sensor said of its calibration, for recordings."""
        return self.source.certificate

    def tare(self, t_ns: int) -> int:
        """Average readings from `t_ns` on as the bias; nothing may touch the tip.

        Returns
        -------
        int
            Time after the last reading [ns].

        Raises
        ------
        DeviceError
            If the sensor does not answer, or a reading is not usable.
        """
        total = np.zeros(6)
        for _ in range(self._samples):
            t_ns = self.source.sample(t_ns)
            total += self.gauges
        self.bias[:] = total / self._samples
        return t_ns

    def measured_cf(self, t_ns: int, position: FloatArray, wrench: FloatArray) -> Status:
        """Write force [N] and torque [N m] ON the robot (6,), base frame, at `t_ns`.

        A sample that is late or not usable is replaced by the last good one and said so by
        the status.  A sensor that is lost goes to FAULT.
        """
        status = self.source.receive(t_ns)
        within = calibrated(
            self.gauges, self.bias, self._calibration, self._ranges, position, wrench
        )
        if status is _OK:
            return _OK if within else _CLAMPED
        if status is _LOST:
            self._machine.command(StateCommand.FAULT)
            return _INVALID
        return status

    def enable(self) -> None:
        """Make ready; refused with a `DeviceError` while the sensor cannot be used."""
        self.source.check()
        self._machine.command(StateCommand.ENABLE)

    def disable(self) -> None:
        """Stop measuring."""
        if self._machine.state is not OperatingState.FAULT:
            self._machine.command(StateCommand.DISABLE)

    def close(self) -> None:
        """Disable and release the wire."""
        self.disable()
        self.source.close()


class FtSensor(ForceSensor):
    """Sensor behind an ideal wire.

    Parameters
    ----------
    name : str
        Name of the device.
    wire : Wire
        Wire to its gauges.
    config : FtSensorConfig
        Model and taring.
    period : float
        Sample period [s].
    """

    def __init__(self, name: str, wire: Wire, config: FtSensorConfig, period: float) -> None:
        self.config = config
        source = IdealGauges(wire, config.calibration(), period)
        super().__init__(name, source, config.tare_samples, TRANSDUCERS[config.model].ranges)


def open_device(
    name: str, wire: Wire | GaugeSource, config: FtSensorConfig, period: float
) -> ForceSensor:
    """Open a sensor: on a box that knows its calibration, or behind an ideal wire."""
    if isinstance(wire, GaugeSource):
        return ForceSensor(name, wire, config.tare_samples, TRANSDUCERS[config.model].ranges)
    return FtSensor(name, wire, config, period)


#: What the registry looks for.
Config = FtSensorConfig
