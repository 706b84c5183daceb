"""Arm whose joints are Damiao actuators: half steps of the drives <-> SI, operating states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import fabs, floor, isfinite
from typing import Any, Protocol

import numba as nb
import numpy as np

from hil.errors import ConfigError, DeviceError
from hil.signals.device import (
    FloatArray,
    IntArray,
    OperatingState,
    StateCommand,
    StateMachine,
    Status,
    Wire,
)
from hil.signals.velocity import estimator

#: Value of `velocity`: the speed that the drives themselves measure.
DRIVE = "drive"
#: Largest word of an effort, in half steps.
_TOP = 4095


@dataclass(frozen=True)
class DamiaoArmConfig:
    """How half steps of the drives become joint states and efforts become half steps.

    Parameters
    ----------
    zero : tuple of float
        Joint positions at which the drives read zero [rad], one a joint; empty: all zero.
    velocity : str
        ``"drive"``, the drives' own, or a velocity estimator of the registry group
        ``hil.velocity``.
    velocity_options : mapping
        Options of the estimator.
    """

    zero: tuple[float, ...] = ()
    velocity: str = DRIVE
    velocity_options: Mapping[str, Any] = field(default_factory=dict)


class DrivesWire(Wire, Protocol):
    """Wire to drives: `counts`, `rates` (d,) in half steps about zero, `scales` (d, 3) of them."""

    rates: IntArray
    scales: FloatArray

    def rest(self) -> None:
        """Switch the drives off as soon as possible; never waits."""
        ...


@nb.njit(cache=True, nogil=True)
def _joint_state(
    counts: Any, rates: Any, zero: Any, scale: Any, pace: Any, position: Any, velocity: Any
) -> None:
    """Position [rad] and velocity [rad/s] (d,) from half steps.

    `zero`, `scale` and `pace` (d,): joint position at zero, and size of a half step [rad],
    [rad/s].
    """
    for i in range(position.size):
        position[i] = zero[i] + scale[i] * counts[i]
        velocity[i] = pace[i] * rates[i]


@nb.njit(cache=True, nogil=True)
def codes(effort: Any, scale: Any, out: Any, sent: Any) -> int:
    """Half steps for joint efforts; 0 = as asked, 1 = clamped, 3 = not a number (the least).

    Words are whole steps, an odd number of half steps: there is none for zero.

    Parameters
    ----------
    effort, sent : ndarray (d,)
        Asked for, and really going out [N m].
    scale : ndarray (d,)
        Size of a half step [N m].
    out : ndarray (d,)
        Half steps.
    """
    status = 0
    for i in range(effort.size):
        if not isfinite(effort[i]):
            status = 3
    for i in range(effort.size):
        value = effort[i] / scale[i] if status != 3 else 0.0
        if fabs(value) > _TOP:
            value = float(_TOP) if value > 0.0 else -float(_TOP)
            status = 1
        half = 2 * floor(value / 2.0) + 1
        out[i] = min(max(half, -_TOP), _TOP)
        sent[i] = scale[i] * out[i]
    return status


_STATUS = tuple(Status)
_INVALID, _LOST = Status.INVALID, Status.LOST
_ENABLED, _FAULT = OperatingState.ENABLED, OperatingState.FAULT


class DamiaoArm:
    """One arm of d joints: `MeasuredJs` and `ServoJf`.

    Parameters
    ----------
    name : str
        Name of the device.
    wire : DrivesWire
        Wire to its drives.
    config : DamiaoArmConfig
        Zeros and velocity.
    period : float
        Sample period [s].

    Attributes
    ----------
    counts, codes : ndarray (d,) of int
        Half steps measured and sent.
    scales : ndarray (d, 3)
        Size of a half step: position [rad], speed [rad/s], effort [N m].
    """

    def __init__(self, name: str, wire: DrivesWire, config: DamiaoArmConfig, period: float) -> None:
        self.name, self._wire = name, wire
        self._machine = StateMachine(name)
        self.counts, self.scales = wire.counts, wire.scales
        d = self.counts.size
        if config.zero and len(config.zero) != d:
            raise ConfigError(f"zero: {d} joint positions [rad] are needed, or none.")
        self._zero = np.array(config.zero or (0.0,) * d)
        self._position, self._pace, self._effort = (self.scales[:, k].copy() for k in range(3))
        self._velocity = None
        self._rate: Any = wire.rates
        if config.velocity != DRIVE:
            options = dict(config.velocity_options)
            self._velocity = estimator(config.velocity, options, d, period)
            self._rate, self._pace = np.zeros(d), self._position / period
        self._period_ns, self._last_ns, self._begun = round(period * 1e9), 0, False
        self.codes = np.zeros(d, np.int64)

    @property
    def state(self) -> OperatingState:
        """Operating state now."""
        return self._machine.state

    @property
    def effort_limit(self) -> FloatArray:
        """Largest effort that the drives take [N m] (d,)."""
        return self._effort * _TOP

    def measured_js(self, t_ns: int, position: FloatArray, velocity: FloatArray) -> Status:
        """Write position [rad] and velocity [rad/s] (d,) at `t_ns`.

        A wire that is lost takes the arm to FAULT.
        """
        status = self._wire.receive(t_ns)
        if self._velocity is not None:
            steps = max(1, (t_ns - self._last_ns + self._period_ns // 2) // self._period_ns)
            self._last_ns = t_ns
            if not self._begun:  # where the arm rests is known from the first reading on
                self._begun = True
                self._velocity.reset(self.counts)
            self._velocity.update(self.counts, steps, self._rate)
        _joint_state(
            self.counts, self._rate, self._zero, self._position, self._pace, position, velocity
        )
        if status is _LOST:
            self.fault()
            return _INVALID
        return status

    def servo_jf(self, effort: FloatArray, sent: FloatArray) -> Status:
        """Send `effort` [N m] (d,) in steps of the drives; `sent` = what they stand for.

        Not a number: no torque, and the arm goes to FAULT.  Not ENABLED: no torque.
        """
        status = _STATUS[self._encode(effort, sent)]
        if status is _INVALID:
            self.fault()
        if self._machine.state is not _ENABLED:
            self.codes[:] = 0
            sent[:] = 0.0
        self._wire.send(self.codes)
        return _INVALID if self._machine.state is _FAULT else status

    def _encode(self, effort: FloatArray, sent: FloatArray) -> int:
        status: int = codes(effort, self._effort, self.codes, sent)
        return status

    def enable(self) -> None:
        """Switch the drives on.

        Raises
        ------
        DeviceError
            If the wire is lost, a drive does not follow, or the arm is not DISABLED.
        """
        self._refuse_lost()
        self._machine.command(StateCommand.ENABLE)
        if self._velocity is not None:
            self._velocity.reset(self.counts)
        self._wire.power(True)
        self._refuse_lost()

    def _refuse_lost(self) -> None:
        if self._wire.trouble:
            self.fault()
            raise DeviceError(f"{self.name} cannot be enabled: {self._wire.trouble}")

    def disable(self) -> None:
        """No torque; drives off.  A fault stays latched."""
        if self._machine.state is not OperatingState.FAULT:
            self._machine.command(StateCommand.DISABLE)
        self.codes[:] = 0
        self._wire.power(False)

    def pause(self) -> None:
        """Keep measuring; the drives get their least effort, for they have no word for zero."""
        self._machine.command(StateCommand.PAUSE)

    def resume(self) -> None:
        """From PAUSED back to ENABLED."""
        self._machine.command(StateCommand.RESUME)

    def fault(self) -> None:
        """Latch FAULT: drives off until cleared."""
        self._machine.command(StateCommand.FAULT)
        self._wire.rest()

    def close(self) -> None:
        """Disable and release the wire."""
        self.disable()
        self._wire.close()


#: What the registry looks for.
Config = DamiaoArmConfig
open_device = DamiaoArm
