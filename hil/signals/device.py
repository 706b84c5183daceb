"""Capabilities of devices as protocols, and their operating states, with CRTK names.

Measured and servo; js, jf, cf.  The states are DISABLED, ENABLED, PAUSED, FAULT, as one table.

Methods of the fast path write into arrays of the caller, return a `Status`, allocate nothing
and never raise.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hil.errors import DeviceError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class OperatingState(IntEnum):
    """State of a device; the number is what sessions record."""

    DISABLED = 0
    ENABLED = 1
    PAUSED = 2
    FAULT = 3


class StateCommand(IntEnum):
    """What may be asked of a device."""

    ENABLE = 0
    DISABLE = 1
    PAUSE = 2
    RESUME = 3
    FAULT = 4
    CLEAR = 5


_S, _C = OperatingState, StateCommand

#: (state, command) -> next state; what is not here is refused.  FAULT is latched: only CLEAR
#: leaves it, and only to DISABLED.
TRANSITIONS: dict[tuple[OperatingState, StateCommand], OperatingState] = {
    (_S.DISABLED, _C.ENABLE): _S.ENABLED,
    (_S.DISABLED, _C.DISABLE): _S.DISABLED,
    (_S.DISABLED, _C.FAULT): _S.FAULT,
    (_S.ENABLED, _C.DISABLE): _S.DISABLED,
    (_S.ENABLED, _C.PAUSE): _S.PAUSED,
    (_S.ENABLED, _C.FAULT): _S.FAULT,
    (_S.PAUSED, _C.RESUME): _S.ENABLED,
    (_S.PAUSED, _C.DISABLE): _S.DISABLED,
    (_S.PAUSED, _C.FAULT): _S.FAULT,
    (_S.FAULT, _C.FAULT): _S.FAULT,
    (_S.FAULT, _C.CLEAR): _S.DISABLED,
}


class StateMachine:
    """Operating state of one device.

    Parameters
    ----------
    device : str
        Name for messages.
    """

    def __init__(self, device: str) -> None:
        self.device = device
        self.state = OperatingState.DISABLED

    def command(self, what: StateCommand) -> OperatingState:
        """Apply a command; refuse it with a `DeviceError` where the table has no row."""
        following = TRANSITIONS.get((self.state, what))
        if following is None:
            allowed = sorted(c.name for s, c in TRANSITIONS if s is self.state)
            raise DeviceError(
                f"{self.device} is {self.state.name} and cannot {what.name}; "
                f"possible now: {', '.join(allowed)}."
            )
        self.state = following
        return following


class Status(IntEnum):
    """Outcome of a call in the fast path; the larger, the worse.

    STALE: the last good value again.  INVALID: not to be used, the device is in FAULT.  LOST: said
    by wires and gauges to their driver alone, which goes to FAULT and answers INVALID.
    """

    OK = 0
    CLAMPED = 1
    STALE = 2
    INVALID = 3
    LOST = 4


@runtime_checkable
class Device(Protocol):
    """Anything with a name, an operating state and an end."""

    name: str

    @property
    def state(self) -> OperatingState:
        """Operating state now."""
        ...

    def enable(self) -> None:
        """Make ready for commands."""
        ...

    def disable(self) -> None:
        """Make safe: no torque."""
        ...

    def close(self) -> None:
        """Disable and release."""
        ...


@runtime_checkable
class MeasuredJs(Protocol):
    """Measures the joint state."""

    def measured_js(self, t_ns: int, position: FloatArray, velocity: FloatArray) -> Status:
        """Write position [rad] (d,) and velocity [rad/s] (d,) at time `t_ns`."""
        ...


@runtime_checkable
class MeasuredCf(Protocol):
    """Measures the force ON the robot at its tip."""

    def measured_cf(self, t_ns: int, position: FloatArray, wrench: FloatArray) -> Status:
        """Write force [N] and torque [N m] (6,) in the base frame; `position` (d,) [rad]."""
        ...


@runtime_checkable
class ServoJf(Protocol):
    """Takes joint efforts."""

    def servo_jf(self, effort: FloatArray, sent: FloatArray) -> Status:
        """Command `effort` [N m] (d,); write into `sent` (d,) what really goes out."""
        ...

    def fault(self) -> None:
        """Latch FAULT: no effort until cleared."""
        ...


@runtime_checkable
class Tareable(Protocol):
    """Has a bias that is measured without load."""

    bias: FloatArray

    def tare(self, t_ns: int) -> int:
        """Measure the bias from `t_ns` [ns] on; return the time when done."""
        ...


class Wire(Protocol):
    """Connection to the devices of one arm: raw counts and gauge words in, DAC codes out.

    `counts` (d,) and `gauges` (6,) hold the last answer and stay the same arrays; `trouble` says
    why the wire is lost.
    """

    counts: IntArray
    gauges: IntArray

    @property
    def trouble(self) -> str:
        """Why the wire is lost; empty while it is not."""
        ...

    def home(self, counts: IntArray) -> None:
        """The arm rests where its encoders should read `counts` (d,); absolute ones know."""
        ...

    def receive(self, t_ns: int) -> Status:
        """Refresh the answer for time `t_ns`; LOST when there will be none."""
        ...

    def send(self, codes: IntArray) -> None:
        """Set the DAC codes (d,)."""
        ...

    def power(self, on: bool) -> None:
        """Switch the amplifiers."""
        ...

    def close(self) -> None:
        """Release what the wire holds."""
        ...


class Controller(Protocol):
    """Control law: state in, state out; no clock, no input or output of its own.

    Attributes
    ----------
    state_names : tuple of str
        Names of the entries of the state vector x, for recordings.
    """

    state_names: tuple[str, ...]

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period of the law.

        Parameters
        ----------
        t : float
            Time since the start [s].
        x, x_next : ndarray (k,)
            State before (read) and after (written).
        u : ndarray (arms, 2 d + 6)
            Per arm: position [rad], velocity [rad/s], force [N] and torque [N m] at the tip.
        y : ndarray (arms, d)
            Written: joint efforts [N m].
        """
        ...


class Estimator(Protocol):
    """Estimates something of one arm beside the law; no clock, no input or output of its own.

    Attributes
    ----------
    names, units : tuple of str
        Of the estimates, for recordings.
    memory : int
        Numbers that it remembers.
    force : int
        Where the force ON the tip [N] (3,) stands among the estimates; -1 where there is none.
    corner_hz : float
        Low-pass that this force is seen through.
    message : str
        Name of the message that holds the estimates.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    memory: int
    force: int
    corner_hz: float
    message: str

    def update(
        self,
        phase: int,
        past: FloatArray,
        u: FloatArray,
        sent: FloatArray,
        now: FloatArray,
        out: FloatArray,
    ) -> None:
        """One period, before the law of the same tick.

        Parameters
        ----------
        phase : int
            0 at the first tick, 1 at the first one after a pause, else 2.
        past, now : ndarray (memory,)
            Memory before (read) and after (written).
        u : ndarray (12,)
            Position [rad], velocity [rad/s], force [N] and torque [N m] at the tip.
        sent : ndarray (3,)
            Joint efforts of the last tick [N m], within the arm's limits.
        out : ndarray (len(names),)
            Written: the estimates.
        """
        ...
