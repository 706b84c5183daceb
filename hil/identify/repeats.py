"""Whether a motion repeats itself, and after how long."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.identify.problem import Problem

FloatArray = NDArray[np.float64]


def period(problem: Problem, run: int) -> int:
    """Instants after which the motion of a run repeats itself; 0 if it does not.

    The shortest shift at which all positions agree to 2 % of their variation (rms) and
    speeds to 5 %, over at least half of the run.
    """
    if ("period", run) not in problem.memo:
        problem.memo["period", run] = _period(problem, run)
    return int(problem.memo["period", run])


def _period(problem: Problem, run: int) -> int:
    where = problem.run == run
    low, n = int(1.0 * problem.rate), int(np.sum(where))
    if n // 2 < low:
        return 0
    worst = np.zeros(n // 2 + 1 - low)
    for x, tolerance in ((problem.q[:, where], 0.02), (problem.qd[:, where], 0.05)):
        size = np.std(x, axis=1) + 1e-12
        apart = np.stack([_apart(row)[low:] for row in x]) / size[:, None]
        worst = np.maximum(worst, apart.max(axis=0) / tolerance)
    good = np.flatnonzero(worst < 1)
    if not good.size:
        return 0
    # the first valley, to its bottom
    first = good[good <= good[0] + 5]
    return low + int(first[np.argmin(worst[first])])


def _apart(x: FloatArray) -> FloatArray:
    """Rms of x[l:] - x[:-l] for every shift l from 0 to n // 2, by one Fourier transform."""
    n = x.size
    x = x - x.mean()
    spectrum = np.abs(np.fft.rfft(x, 2 * n)) ** 2
    product = np.fft.irfft(spectrum)[: n // 2 + 1]
    power = np.concatenate([[0.0], np.cumsum(x**2)])
    shift = np.arange(n // 2 + 1)
    both = power[n - shift] + power[n] - power[shift]
    out: FloatArray = np.sqrt(np.maximum(both - 2 * product, 0.0) / (n - shift))
    return out
