"""Ring of rows between the fast loop and the slow side: one writer, one reader, no lock.

The writer fills a row before it publishes the new head; the reader copies rows out before
it publishes the new tail.  A full ring drops the new row and counts it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Ring:
    """Preallocated rows of `width` numbers with tick and time.

    Parameters
    ----------
    rows : int
        Capacity.
    width : int
        Numbers per row.

    Attributes
    ----------
    dropped : int
        Rows that found the ring full.
    """

    def __init__(self, rows: int, width: int) -> None:
        self._stamps = np.zeros((rows, 2), np.int64)
        self._data = np.zeros((rows, width))
        self._rows = rows
        self._head = 0
        self._tail = 0
        self.dropped = 0

    def __len__(self) -> int:
        """Rows that wait."""
        return self._head - self._tail

    def push(self, tick: int, t_ns: int, row: NDArray[np.float64]) -> bool:
        """Store one row (width,); False if it was dropped."""
        if self._head - self._tail >= self._rows:
            self.dropped += 1
            return False
        k = self._head % self._rows
        stamp = self._stamps[k]
        stamp[0] = tick
        stamp[1] = t_ns
        self._data[k] = row
        self._head += 1
        return True

    def take(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """All waiting rows, oldest first: stamps (n, 2) = tick, time [ns]; data (n, width)."""
        head, first = self._head, self._tail % self._rows
        n = head - self._tail
        if first + n <= self._rows:
            stamps = self._stamps[first : first + n].copy()
            data = self._data[first : first + n].copy()
        else:
            index = np.arange(first, first + n) % self._rows
            stamps, data = self._stamps[index], self._data[index]
        self._tail = head
        return stamps, data

    def before(self, tick: int, n: int) -> NDArray[np.float64]:
        """Rows of the n ticks before `tick` that are still there, oldest first: (up to n, width).

        For looking back at why the loop let go, when nothing is written any more.
        """
        first = max(self._head - self._rows, 0)
        index = np.arange(first, self._head) % self._rows
        ticks = self._stamps[index, 0]
        found: NDArray[np.float64] = self._data[index[(ticks < tick) & (ticks >= tick - n)]]
        return found
