"""Operating states of a device: DISABLED, ENABLED, PAUSED, FAULT (CRTK), as one table."""

from __future__ import annotations

from enum import IntEnum

from hil.errors import DeviceError


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
