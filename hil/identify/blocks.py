"""Blocks of time, within which residuals may depend on each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.identify.problem import Problem


def time_blocks(problem: Problem, seconds: float = 1.0) -> NDArray[np.int_]:
    """Number of the time block of each instant, runs kept apart; shape (n,)."""
    length = max(1, round(seconds * problem.rate))
    out = np.empty(problem.n, dtype=int)
    offset = 0
    for k in range(len(problem.recordings)):
        where = np.flatnonzero(problem.run == k)
        out[where] = offset + np.arange(where.size) // length
        offset = int(out[where[-1]]) + 1
    return out
