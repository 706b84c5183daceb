"""Driver of a force/torque sensor: bias, calibration, rotation into the base frame."""

from __future__ import annotations

import numpy as np

from drivers.ft_sensor import convert
from drivers.ft_sensor.config import MODELS, FtSensorConfig
from hil.signals.device import FloatArray, Status, Wire
from hil.signals.state import OperatingState, StateCommand, StateMachine


class FtSensor:
    """One sensor: `MeasuredCf`.

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
        self.name = name
        self.config = config
        self.period = period
        self._wire = wire
        self._machine = StateMachine(name)
        self._calibration = config.calibration()
        self._limit = MODELS[config.model][2]
        self.gauges = wire.gauges
        self.bias = np.zeros(6)

    @property
    def state(self) -> OperatingState:
        """Operating state now."""
        return self._machine.state

    def tare(self, t_ns: int) -> int:
        """Average readings from `t_ns` on as the bias; nothing may touch the tip.

        Returns
        -------
        int
            Time after the last reading [ns].
        """
        total, step = np.zeros(6), round(self.period * 1e9)
        for _ in range(self.config.tare_samples):
            t_ns += step
            self._wire.receive(t_ns)
            total += self.gauges
        self.bias[:] = total / self.config.tare_samples
        return t_ns

    def measured_cf(self, t_ns: int, position: FloatArray, wrench: FloatArray) -> Status:
        """Write force [N] and torque [N m] ON the robot (6,), base frame, at `t_ns`."""
        self._wire.receive(t_ns)
        convert.wrench(self.gauges, self.bias, self._calibration, position, wrench)
        overload = abs(wrench[0]) + abs(wrench[1]) + abs(wrench[2]) > self._limit
        return Status.CLAMPED if overload else Status.OK

    def enable(self) -> None:
        """Make ready."""
        self._machine.command(StateCommand.ENABLE)

    def disable(self) -> None:
        """Stop measuring."""
        if self._machine.state is not OperatingState.FAULT:
            self._machine.command(StateCommand.DISABLE)

    def close(self) -> None:
        """Disable and release the wire."""
        self.disable()
        self._wire.close()
