"""Periods missed within the last second."""

from __future__ import annotations

import numpy as np


class Overload:
    """Counts missed periods in ten slots of a tenth of a second.

    Parameters
    ----------
    limit : int
        More than so many missed within a second are too many.
    ticks : int
        Per second; the first second does not count (cold caches).
    """

    def __init__(self, limit: int, ticks: int) -> None:
        self._limit, self._ticks = limit, ticks
        self._slot = max(1, ticks // 10)
        self._counts = np.zeros(10, np.int64)
        self._at = 0
        self._sum = 0

    def over(self, tick: int, missed: int) -> bool:
        """Count what was `missed` before `tick`; whether the last second had too many."""
        at = tick // self._slot
        if at != self._at:
            for k in range(self._at + 1, min(at, self._at + 10) + 1):
                self._sum -= int(self._counts[k % 10])
                self._counts[k % 10] = 0
            if at - self._at >= 10:
                self._counts[:] = 0
                self._sum = 0
            self._at = at
        if missed and tick > self._ticks:
            self._counts[at % 10] += missed
            self._sum += missed
        return self._sum > self._limit
