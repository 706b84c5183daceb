"""Clocks: virtual for lockstep, monotonic for real time; both walk a grid of periods."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

#: Spin this long before a deadline instead of sleeping [ns]: three times what a wake-up takes on
#: an idle core.  Half: late wake-ups show; double: a third of a core for nothing.
SPIN_NS = 150_000


class Clock(Protocol):
    """Grid of ticks: tick k is due at k periods after the start.

    Attributes
    ----------
    name : str
        ``"lockstep"`` or ``"real"``.
    epoch_ns : int
        What to add to tick times for recordings [ns].
    missed : int
        Periods that were skipped.
    set_back : int
        How often its source has gone backwards.
    """

    name: str
    epoch_ns: int
    missed: int
    set_back: int

    def start(self) -> None:
        """Set tick 0 to now."""
        ...

    def wait(self, tick: int) -> int:
        """Wait for `tick`; return the tick that it is, later if periods were missed."""
        ...

    def since_start(self) -> int:
        """Time since tick 0 [ns]."""
        ...


class VirtualClock:
    """Time that passes when it is waited for.

    Parameters
    ----------
    period_ns : int
        Length of a tick [ns].
    """

    name = "lockstep"

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.epoch_ns = 0
        self.missed = self.set_back = 0
        self._now = 0

    def start(self) -> None:
        """Set tick 0 to now."""
        self._now = 0

    def wait(self, tick: int) -> int:
        """Jump to `tick`."""
        self._now = tick * self.period_ns
        return tick

    def since_start(self) -> int:
        """Virtual time since tick 0 [ns]."""
        return self._now


class MonotonicClock:
    """The machine's monotonic clock: sleep to shortly before the deadline, then spin.

    Parameters
    ----------
    period_ns : int
        Length of a tick [ns].
    now, sleep, wall : callable
        Monotonic time [ns], what sleeps [s], and the time of day [ns], which is asked once.
    spin_ns : int
        How long before the deadline it stops to sleep; 0: it sleeps to the end.
    """

    name = "real"

    def __init__(
        self,
        period_ns: int,
        now: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
        wall: Callable[[], int] = time.time_ns,
        spin_ns: int = SPIN_NS,
    ) -> None:
        self.period_ns, self._spin = period_ns, spin_ns
        self._now, self._sleep, self._wall = now, sleep, wall
        self.epoch_ns = 0
        self.missed = self.set_back = 0
        self._zero = 0

    def start(self) -> None:
        """Set tick 0 to now."""
        self._zero = self._now()
        self.epoch_ns = self._wall()

    def wait(self, tick: int) -> int:
        """Sleep, then spin, to the deadline of `tick`; skip whole periods when late.

        A source that has gone back must not hold the loop up for so long: the grid follows it.
        """
        deadline = self._zero + tick * self.period_ns
        now = self._now()
        if deadline - now > 2 * self.period_ns:
            self.set_back += 1
            self._zero += now + self.period_ns - deadline
            deadline = now + self.period_ns
        if now >= deadline + self.period_ns:
            # never catch up by double steps
            skipped = (now - deadline) // self.period_ns
            self.missed += skipped
            tick += skipped
            deadline += skipped * self.period_ns
        if deadline - now > self._spin:
            self._sleep((deadline - now - self._spin) * 1e-9)
        while self._now() < deadline:
            pass
        return tick

    def since_start(self) -> int:
        """Time since tick 0 [ns]."""
        return self._now() - self._zero
