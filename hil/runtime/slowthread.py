"""The thread of the slow side in real time.

It is locked to the loop's grid, a little behind the tick, so that its work falls into the loop's
sleep.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from hil.runtime.clock import Clock
from hil.runtime.slow import SlowSide

#: Behind the tick, in periods of the loop: after its work, before its next wake-up.
PHASE = 0.3


class SlowThread:
    """Steps a `SlowSide` on the loop's grid until stopped.

    An error in the thread ends it and is raised by `stop`; rows then pile up in the ring,
    which counts what it drops.

    Parameters
    ----------
    side : SlowSide
        What it steps.
    clock : Clock
        Its grid is that of the loop.
    period, tick : float
        Of this thread and of the loop [s].
    duties : callable
        Called with the time [s] at every step.
    prepare : callable
        Called once in the thread, first.
    """

    def __init__(
        self, side: SlowSide, clock: Clock, period: float, tick: float,
        duties: Callable[[float], None] = lambda seconds: None,
        prepare: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        self._duties, self._prepare = duties, prepare
        self._side, self._clock, self._period, self._phase = side, clock, period, PHASE * tick
        self._done, self._going = threading.Event(), threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="slow", daemon=True)

    def start(self) -> None:
        """Start the thread, before the clock: it gets ready and waits for `go`."""
        self._thread.start()

    def go(self) -> None:
        """The clock runs."""
        self._going.set()

    def _run(self) -> None:
        try:
            self._prepare()
            self._going.wait()
            while not self._done.is_set():
                now = self._clock.since_start() * 1e-9 - self._phase
                time.sleep(self._period - now % self._period)
                self._duties(now)
                self._side.step(now)
        except BaseException as error:
            self._error = error
            self._side.died(error)

    def stop(self) -> None:
        """Stop, drain what is left, and raise what went wrong."""
        self._done.set()
        self._going.set()
        if self._thread.ident is not None:
            self._thread.join()
        if self._error is not None:
            raise self._error
        self._side.step(self._clock.since_start() * 1e-9)
