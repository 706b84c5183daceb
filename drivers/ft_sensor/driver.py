"""Driver of a force/torque sensor: bias, calibration, rotation into the base frame."""

from __future__ import annotations

import numpy as np

from hil.drivers.ft_sensor import convert
from hil.drivers.ft_sensor.config import MODELS, FtSensorConfig
from hil.drivers.ft_sensor.source import GaugeSource, IdealGauges
from hil.signals.device import FloatArray, Status, Wire
from hil.signals.state import OperatingState, StateCommand, StateMachine

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
    max_force : float
        Range of the transducer [N]; beyond it a sample counts as clamped.
    """

    def __init__(self, name: str, source: GaugeSource, tare_samples: int, max_force: float) -> None:
        self.name = name
        self.source = source
        self._samples = tare_samples
        self._machine = StateMachine(name)
        self._calibration = source.calibration
        self.max_force = self._limit = max_force
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
        size = convert.wrench(self.gauges, self.bias, self._calibration, position, wrench)
        if status is _OK:
            return _CLAMPED if size > self._limit else _OK
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
        super().__init__(name, source, config.tare_samples, MODELS[config.model][2])


def open_device(
    name: str, wire: Wire | GaugeSource, config: FtSensorConfig, period: float
) -> ForceSensor:
    """Open a sensor: on a box that knows its calibration, or behind an ideal wire."""
    if isinstance(wire, GaugeSource):
        return ForceSensor(name, wire, config.tare_samples, MODELS[config.model][2])
    return FtSensor(name, wire, config, period)
