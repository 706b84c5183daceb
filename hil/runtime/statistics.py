"""Statistics of a session's ticks: histograms of lateness and tick time, misses, gaps.

Fed by the slow side with whole blocks of rows; the fast loop pays nothing for it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
#: Edges of the bins [ns]: 0.1 us to 10 s, twenty a decade, so within 12 percent.
EDGES = np.concatenate([[0.0], np.logspace(2.0, 10.0, 161)])


#: Blocks of rows that are taken together.
BLOCKS = 20


class Histogram:
    """Counts of times in logarithmic bins, with the exact extremes."""

    def __init__(self) -> None:
        self.counts = np.zeros(EDGES.size, np.int64)
        self.n, self.most = 0, 0.0

    def add(self, times: FloatArray) -> None:
        """Count `times` (n,) [ns]; negative ones are zero."""
        if not times.size:
            return
        bins = np.searchsorted(EDGES, np.maximum(times, 0.0), side="right") - 1
        self.counts += np.bincount(bins, minlength=EDGES.size)
        self.n += times.size
        self.most = max(self.most, float(times.max()))

    def quantile(self, share: float) -> float:
        """Time [ns] that `share` of the ticks do not exceed, to a bin; never above the most."""
        if not self.n:
            return 0.0
        k = int(np.searchsorted(np.cumsum(self.counts), share * self.n))
        upper = EDGES[k + 1] if k + 1 < EDGES.size else np.inf
        return float(min(upper, self.most))

    def filled(self) -> list[list[float]]:
        """Bins that hold something: [lower edge in us, count]."""
        return [[float(EDGES[k]) * 1e-3, int(self.counts[k])] for k in np.flatnonzero(self.counts)]


@dataclass(frozen=True)
class Figures:
    """Figures of the ticks so far; times [us].

    Parameters
    ----------
    ticks : int
        Rows seen.
    missed, dropped : int
        Periods skipped; rows that the ring did not take.
    late_p50, late_p99, late_p999, late_most : float
        Wake-up after the deadline.
    busy_p50, busy_p99, busy_p999, busy_most : float
        Wake-up to the last command.
    longest_gap : float
        Between two ticks that follow each other.
    ring_most : int
        High-water mark of the ring.
    winding_most : float
        Hottest winding [degC].
    """

    ticks: int
    missed: int
    dropped: int
    late_p50: float
    late_p99: float
    late_p999: float
    late_most: float
    busy_p50: float
    busy_p99: float
    busy_p999: float
    busy_most: float
    longest_gap: float
    ring_most: int
    winding_most: float

    def as_dict(self) -> dict[str, float]:
        """Plain dictionary for JSON."""
        return asdict(self)


class Statistics:
    """Collects the figures.

    Parameters
    ----------
    period_ns : int
        Of the loop [ns].
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._late, self._busy = Histogram(), Histogram()
        #: Rows that wait: few large blocks cost less than many small ones.
        self._waiting: list[tuple[NDArray[np.int64], FloatArray]] = []
        self._last = -1.0
        self._gap = 0.0
        self._missed = self._dropped = self._ring = self.ticks = 0
        self._hot = 0.0

    def add(self, ticks: NDArray[np.int64], timing: FloatArray) -> None:
        """Take rows: tick numbers (n,) and timing columns (n, 9) of `hil.signals.frame.TIMING`."""
        self._waiting.append((ticks, timing))
        if len(self._waiting) >= BLOCKS:
            self._digest()

    def _digest(self) -> None:
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return
        ticks = np.concatenate([t for t, _ in waiting])
        timing = np.concatenate([rows for _, rows in waiting])
        if not ticks.size:
            return
        self._late.add(timing[:, 0])
        self._busy.add(timing[:, 1])
        woken = ticks * float(self._period_ns) + timing[:, 0]
        before = np.concatenate([[woken[0] if self._last < 0 else self._last], woken])
        self._gap = max(self._gap, float(np.diff(before).max()))
        self._last = float(woken[-1])
        self._missed, self._dropped = int(timing[-1, 2]), int(timing[-1, 3])
        self._ring = max(self._ring, int(timing[:, 7].max()) + 1)
        self._hot = max(self._hot, float(timing[:, 8].max()))
        self.ticks += ticks.size

    @property
    def late(self) -> Histogram:
        """Lateness of the wake-ups [ns]."""
        self._digest()
        return self._late

    @property
    def busy(self) -> Histogram:
        """Times from the wake-up to the last command [ns]."""
        self._digest()
        return self._busy

    def figures(self) -> Figures:
        """Figures of what was added so far."""
        self._digest()
        late, busy = self.late, self.busy
        us = 1e-3
        return Figures(
            ticks=self.ticks,
            missed=self._missed,
            dropped=self._dropped,
            late_p50=late.quantile(0.5) * us,
            late_p99=late.quantile(0.99) * us,
            late_p999=late.quantile(0.999) * us,
            late_most=late.most * us,
            busy_p50=busy.quantile(0.5) * us,
            busy_p99=busy.quantile(0.99) * us,
            busy_p999=busy.quantile(0.999) * us,
            busy_most=busy.most * us,
            longest_gap=self._gap * us,
            ring_most=self._ring,
            winding_most=self._hot,
        )

    def line(self) -> str:
        """One line for the operator."""
        f = self.figures()
        return (
            f"late p50 {f.late_p50:.1f} p99 {f.late_p99:.0f} max {f.late_most:.0f} us, tick "
            f"{f.busy_p50:.0f} us, missed {f.missed}, ring {f.ring_most}, dropped {f.dropped}"
        )
