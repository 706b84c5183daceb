"""Time of the simulated devices: an argument, so that no simulator ever sleeps."""

from __future__ import annotations

from typing import Protocol


class SimTime(Protocol):
    """What simulated devices know of time.

    Attributes
    ----------
    now_ns : int
        Time now [ns].
    """

    now_ns: int

    def wait(self, t_ns: int) -> None:
        """Return when it is `t_ns` [ns] at least."""
        ...

    def at(self, t_ns: int) -> None:
        """The driver says that it is `t_ns` [ns] by its own count."""
        ...


class VirtualTime:
    """Time that passes when somebody waits for it, or says how late it is.

    Attributes
    ----------
    now_ns : int
        Time now [ns]; never falls.
    """

    def __init__(self) -> None:
        self.now_ns = 0
        self._ahead_ns = 0

    def at(self, t_ns: int) -> None:
        """The driver's count; it lags by whatever the driver has waited outside of its ticks."""
        if t_ns + self._ahead_ns < self.now_ns:
            self._ahead_ns = self.now_ns - t_ns
        self.wait(t_ns + self._ahead_ns)

    def wait(self, t_ns: int) -> None:
        """Jump to `t_ns`, if that is later."""
        if t_ns > self.now_ns:
            self.now_ns = t_ns
