"""Knots of a table: as many as what lies between them takes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.controllers.compensation import BEND
from hil.estimate.part import BENT, Part, refusal
from hil.estimate.probe import ENDS, kind_of

FloatArray = NDArray[np.float64]
#: First and largest number of knots an axis, and what a table may miss between them, as a share
#: of its largest value within `FAIR` of the ends of a speed axis.
KNOTS, MOST, MISS, FAIR = {"q": 65, "v": 97, "load": 5, "gravity": 5, "t": 97}, 4097, 0.01, 0.1


def sampled(part: Part, axes: Sequence[str]) -> tuple[FloatArray, list[Any]]:
    """Table with as many knots as it takes."""
    counts = [KNOTS[kind_of(n)] for n in axes]
    while True:
        sheet, marks = part.sheet(axes, counts)
        coarse = [k for k in range(len(axes)) if _misses(part, axes, counts, k) > MISS]
        if not coarse:
            return sheet, marks
        for k in coarse:
            counts[k] = 2 * counts[k] - 1
        if max(counts) > MOST or math.prod(counts) > 2_000_000:
            raise refusal(part.effect, f"it varies too finely over {axes[coarse[0]]} for a table")


def _misses(part: Part, axes: Sequence[str], counts: Sequence[int], k: int) -> float:
    """Largest error halfway between knots of axis k, over the largest value there is."""
    few = [min(c, 33) if i != k else c for i, c in enumerate(counts)]
    sheet, _ = part.sheet(axes, few)
    twice = [2 * c - 1 if i == k else c for i, c in enumerate(few)]
    fine, marks = part.sheet(axes, twice)
    rows, right = np.moveaxis(fine, k, 0), np.moveaxis(sheet, k, 0)
    start, step, count = marks[k]
    u = start + step * np.arange(count)
    x = BEND * np.sinh(u) if axes[k][0] in BENT else u
    share = ((x[1::2] - x[:-2:2]) / (x[2::2] - x[:-2:2])).reshape(-1, *[1] * (right.ndim - 1))
    between = right[:-1] + share * (right[1:] - right[:-1])
    inner = np.abs(x[1::2]) < (FAIR * ENDS["v"][1] if axes[k][0] == "v" else np.inf)
    error = np.abs(between - rows[1::2])[inner].max(initial=0.0)
    return float(error / max(np.abs(rows[1::2][inner]).max(initial=0.0), 1e-12))
