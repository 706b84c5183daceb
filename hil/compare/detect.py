"""Detection: whether any candidate explains more than noise lets the luckiest of them explain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hil.compare.floor import Floor
from hil.identify import timelines
from hil.identify.abreast import abreast
from hil.identify.design import Term
from hil.identify.fit import time_blocks
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.identify.screening import screen

FloatArray = NDArray[np.float64]
#: Family-wise false-alarm level of one step.
LEVEL = 0.01
FLIPS = 400


class Candidate(Protocol):
    """What detection needs to know of a candidate, and what it finds out."""

    term: Term
    gain: float
    absorbed: float
    p_value: float
    null: FloatArray


def detect(
    found: Sequence[Candidate], projector: Projector, floor: Floor, result: FitResult, seed: int
) -> None:
    """Family-wise p values: flip the signs of blocks of noise, take the maximum over all.

    The noise is the residual of the largest model; each candidate's gain, maximised over its
    shapes, is divided by its own 95 % null quantile, so that rich families have no advantage.
    """
    problem = result.problem
    correlation = float(np.max(floor.inflation)) / problem.rate
    seconds = float(np.clip(4 * correlation, 0.4, 2.0))
    blocks = time_blocks(problem, seconds)
    count = int(blocks.max()) + 1
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(FLIPS, count))
    ratio = floor.scale / np.maximum(problem.rms(floor.residual), 1e-300)
    noise = (floor.residual * ratio[:, None] / result.sigma[:, None]).reshape(-1)
    rows = np.tile(blocks, problem.d)
    each = zip(projector.parts, noise.reshape(problem.d, -1), strict=True)
    qb = np.asarray(sum(block_sums(q * x[:, None], blocks, count) @ u for (q, u), x in each))
    nulls = abreast(lambda c: _null(c, projector, noise, rows, signs, qb), found, problem.instants)
    for c, null in zip(found, nulls, strict=True):
        c.null = null
    quantile = {id(c): max(float(np.quantile(c.null, 0.95)), 1e-300) for c in found}
    usable = [c for c in found if c.absorbed < 1 - 1e-6]
    if not usable:
        return
    worst = np.max([c.null / quantile[id(c)] for c in usable], axis=0)
    for c in usable:
        c.p_value = (1 + int(np.sum(worst >= c.gain / quantile[id(c)]))) / (1 + FLIPS)


def _null(
    c: Candidate, projector: Projector, noise: FloatArray, rows: NDArray[np.int_],
    signs: FloatArray, qb: FloatArray,
) -> FloatArray:  # fmt: skip
    """Gains of a candidate on sign-flipped noise, the best over its grid, shape (FLIPS,)."""
    best = np.zeros(len(signs))
    grid = projector.problem.grid(c.term.effect, c.term.joint) or [c.term.shape]
    if c.term.effect.spectral:
        own = projector.rows(c.term)
        return timelines.flipped(projector.problem, c.term, noise[own], rows[own], signs)
    waves = screen(projector.problem, c.term, grid)
    if waves is not None:
        n, j = projector.problem.n, c.term.joint
        back = projector.problem.back(noise[j * n : (j + 1) * n], j)
        return waves.flipped(back, projector.problem.spread(rows[: projector.problem.n]), signs)
    where = projector.rows(c.term)
    for s in projector.scores(c.term, grid[:: max(1, len(grid) // 40)]):
        g, m = s.beta.shape
        weighted = s.columns.reshape(-1, g * m) * noise[where, None]
        part = block_sums(weighted, rows[where], signs.shape[1])
        flipped = (signs @ (part - qb @ s.qc.reshape(-1, g * m))).reshape(-1, g, m)
        # c' G^+ c of each shape
        each = flipped.transpose(1, 0, 2)
        best = np.maximum(best, np.sum((each @ s.inverse) * each, axis=2).max(axis=0))
    return best


def block_sums(x: FloatArray, labels: NDArray[np.int_], count: int) -> FloatArray:
    """Sums (count, m) of the rows of x (n, m) by label; labels come in long stretches."""
    starts = np.flatnonzero(np.diff(labels, prepend=-1))
    out = np.zeros((count, x.shape[1]))
    np.add.at(out, labels[starts], np.add.reduceat(x, starts, axis=0))
    return out
