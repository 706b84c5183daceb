"""Driver of a PHANTOM Premium 1.5: counts <-> SI, operating states."""

from __future__ import annotations

import numpy as np

from hil.drivers.premium import convert
from hil.drivers.premium.config import PremiumConfig
from hil.errors import DeviceError
from hil.signals.device import FloatArray, Status, Wire
from hil.signals.state import OperatingState, StateCommand, StateMachine
from hil.signals.velocity import estimator

_STATUS = tuple(Status)
#: Looked up once: members of an enumeration are slow to find in the fast path.
_INVALID, _LOST = Status.INVALID, Status.LOST
_ENABLED, _FAULT = OperatingState.ENABLED, OperatingState.FAULT


class PremiumArm:
    """One arm: `MeasuredJs` and `ServoJf`.

    Parameters
    ----------
    name : str
        Name of the device.
    wire : Wire
        Wire to its encoders and DACs.
    config : PremiumConfig
        Drive train.
    period : float
        Sample period [s].
    """

    def __init__(self, name: str, wire: Wire, config: PremiumConfig, period: float) -> None:
        self.name = name
        self._wire = wire
        self._machine = StateMachine(name)
        self._period = period
        gear = np.array(config.gear)
        # theta = gear^-1 * 2 pi / counts_per_turn * counts
        self._to_joint = np.linalg.inv(gear) * (2 * np.pi / config.counts_per_turn)
        volts = config.dac_volts / 2 ** (config.dac_bits - 1)
        motor = volts * config.amps_per_volt * config.torque_constant
        # tau = gear^T tau_motor
        self._to_effort = gear.T * motor
        self._to_code = np.linalg.inv(self._to_effort)
        stall = int(config.stall_torque / motor)
        self._top = min(stall, 2 ** (config.dac_bits - 1) - 1)
        self._period_ns = round(period * 1e9)
        self._last_ns = 0
        # counts = floor(gear theta counts_per_turn / 2 pi)
        at_home = gear @ np.array(config.home) * config.counts_per_turn / (2 * np.pi)
        wire.home(np.floor(at_home).astype(np.int64))
        self.counts = wire.counts
        self._rate = np.zeros(3)
        self._velocity = estimator(config.velocity, dict(config.velocity_options), 3, period)
        self.codes = np.zeros(3, np.int64)

    @property
    def state(self) -> OperatingState:
        """Operating state now."""
        return self._machine.state

    @property
    def effort_limit(self) -> FloatArray:
        """Largest joint effort that a single DAC can ask for [N m] (3,)."""
        return np.asarray(np.diag(self._to_effort) * self._top)

    def measured_js(self, t_ns: int, position: FloatArray, velocity: FloatArray) -> Status:
        """Write position [rad] and velocity [rad/s] (3,) at `t_ns`.

        A wire that is lost takes the arm to FAULT.
        """
        status = self._wire.receive(t_ns)
        steps = max(1, (t_ns - self._last_ns + self._period_ns // 2) // self._period_ns)
        self._last_ns = t_ns
        self._velocity.update(self.counts, steps, self._rate)
        convert.joint_state(
            self.counts, self._rate, self._to_joint, self._period, position, velocity
        )
        if status is _LOST:
            self._machine.command(StateCommand.FAULT)
            return _INVALID
        return status

    def servo_jf(self, effort: FloatArray, sent: FloatArray) -> Status:
        """Send `effort` [N m] (3,) as DAC codes; `sent` = what they stand for.

        Not a number: no torque, and the arm goes to FAULT.  Not ENABLED: no torque.
        """
        status = _STATUS[
            convert.codes(effort, self._to_code, self._to_effort, self._top, self.codes, sent)
        ]
        if status is _INVALID:
            self._machine.command(StateCommand.FAULT)
        if self._machine.state is not _ENABLED:
            self.codes[:] = 0
            sent[:] = 0.0
        self._wire.send(self.codes)
        return _INVALID if self._machine.state is _FAULT else status

    def enable(self) -> None:
        """Start the velocity at rest and switch the amplifiers on.

        Raises
        ------
        DeviceError
            If the wire is lost, or the arm is not DISABLED.
        """
        if self._wire.trouble:
            raise DeviceError(f"{self.name} cannot be enabled: {self._wire.trouble}")
        self._machine.command(StateCommand.ENABLE)
        self._velocity.reset(self.counts)
        self._wire.power(True)

    def disable(self) -> None:
        """No torque; amplifiers off.  A fault stays latched."""
        if self._machine.state is not OperatingState.FAULT:
            self._machine.command(StateCommand.DISABLE)
        self.codes[:] = 0
        self._wire.send(self.codes)
        self._wire.power(False)

    def pause(self) -> None:
        """Keep measuring, send no torque."""
        self._machine.command(StateCommand.PAUSE)

    def resume(self) -> None:
        """From PAUSED back to ENABLED."""
        self._machine.command(StateCommand.RESUME)

    def fault(self) -> None:
        """Latch FAULT: no torque until cleared."""
        self._machine.command(StateCommand.FAULT)

    def close(self) -> None:
        """Disable and release the wire."""
        self.disable()
        self._wire.close()
