"""The one splitter: which instants are tested, and on which others the model is fitted then.

A recording is cut into many short blocks.  The ends of a block are a guard of the filter's length
that is neither fitted nor tested while the block is held out, so that no filtered sample is on
both sides.  Blocks are dealt to folds so that each fold is spread over the whole recording; with
three runs or more a fold is whole runs.  An instant counts as tested only where every joint is
within positions, and moves in a direction, that the other folds have seen: the rest would be
extrapolation and is counted apart.

Source: Roberts et al., Ecography 40, 2017 (blocked cross-validation); Racine, J. Econometrics 99,
2000 (guards).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.constants import BINS, FEWEST, FOLDS, GUARD, LEVELS, MOST, PARTS, PERIODS
from hil.identify.problem import Problem

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Split:
    """Blocks of time and the folds they are dealt to.

    Parameters
    ----------
    block : ndarray (n,)
        Block of each instant; blocks are contiguous and within one run.
    fold : ndarray (blocks,)
        Fold of each block.
    tested : ndarray (n,)
        Whether an instant is tested: no guard, and not beyond what the other folds have seen.
    extrapolated : ndarray (n,)
        Whether an instant is left out of the test because it is beyond what they have seen.
    by_run : bool
        Whether folds are whole runs.
    """

    block: NDArray[np.int_]
    fold: NDArray[np.int_]
    tested: NDArray[np.bool_]
    extrapolated: NDArray[np.bool_]
    by_run: bool

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.fold.size)

    @property
    def folds(self) -> int:
        """Number of folds."""
        return int(self.fold.max()) + 1

    def edges(self) -> list[tuple[int, int]]:
        """First instant of every block and the one after its last."""
        starts = np.flatnonzero(np.diff(self.block, prepend=-1))
        ends = [*starts[1:].tolist(), self.block.size]
        return list(zip(starts.tolist(), ends, strict=True))


def split(problem: Problem, seed: int = 0, whole_runs: bool = True) -> Split:
    """Deal the instants of a problem.

    Parameters
    ----------
    problem : Problem
        The runs.
    seed : int
        Of the order in which neighbouring blocks go to the folds.
    whole_runs : bool
        Whether folds may be whole runs; not where a run has coefficients of its own, which no
        other run determines.
    """
    block, inner = _blocks(problem)
    first = np.flatnonzero(np.diff(block, prepend=-1))
    run = np.asarray(problem.whole)[problem.run[first]]
    by_run = whole_runs and problem.runs >= 3
    fold = run % FOLDS if by_run else _dealt(first.size, seed)
    beyond = inner & _beyond(problem, fold[block])
    return Split(block, np.asarray(fold), inner & ~beyond, beyond, by_run)


def parts(dealt: Split) -> Split:
    """The same blocks in `PARTS` folds, each of which is one piece of the recording."""
    fold = np.arange(dealt.blocks) * PARTS // dealt.blocks
    return replace(dealt, fold=fold, tested=dealt.tested | dealt.extrapolated, by_run=False)


def levels(problem: Problem, dealt: Split) -> Split | None:
    """The same blocks in `LEVELS` folds: runs of little effort, and of much; None with few runs."""
    if problem.runs < 2 * LEVELS:
        return None
    whole = np.asarray(problem.whole)
    size = np.maximum(problem.rms(problem.effort), 1e-300)
    power = np.sum((problem.effort / size[:, None]) ** 2, axis=0)
    run = whole[problem.run]
    mean = np.bincount(run, power, problem.runs) / np.maximum(np.bincount(run), 1)
    order = np.argsort(np.argsort(mean))
    first = np.flatnonzero(np.diff(dealt.block, prepend=-1))
    fold = order[run[first]] * LEVELS // problem.runs
    return replace(dealt, fold=fold, tested=dealt.tested | dealt.extrapolated, by_run=False)


def _blocks(problem: Problem) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
    """Block of each instant, and whether it lies between the guards of its block."""
    period = problem.rate / problem.rates.effort
    sizes = np.bincount(problem.run)
    length = int(np.clip(sizes.sum() / MOST, PERIODS * period, max(sizes.sum() / FEWEST, 1)))
    guard = int(np.ceil(GUARD * period))
    if length < 4 * guard:
        guard = length // 4
    block, inner, count = [], [], 0
    for size in sizes:
        pieces = max(1, round(size / max(length, 1)))
        own = np.minimum(np.arange(size) * pieces // size, pieces - 1)
        block.append(own + count)
        inner.append(_inner(own, guard))
        count += pieces
    return np.concatenate(block), np.concatenate(inner)


def _inner(block: NDArray[np.int_], guard: int) -> NDArray[np.bool_]:
    """Whether instants of one run are `guard` away from the next block; ends of a run need none."""
    out = np.ones(block.size, dtype=bool)
    for edge in np.flatnonzero(np.diff(block)) + 1:
        out[max(edge - guard, 0) : edge + guard] = False
    return out


def _dealt(count: int, seed: int) -> NDArray[np.int_]:
    """Fold of each block: every FOLDS neighbours go to different folds, in random order."""
    folds, rng = max(2, min(FOLDS, count)), np.random.default_rng(seed)
    rounds = -(-count // folds)
    return np.concatenate([rng.permutation(folds) for _ in range(rounds)])[:count]


def _beyond(problem: Problem, fold: NDArray[np.int_]) -> NDArray[np.bool_]:
    """Instants at which a joint that moves is where no other fold has been in that direction."""
    out = np.zeros(problem.n, dtype=bool)
    folds = int(fold.max()) + 1
    for j in np.flatnonzero(~problem.holds):
        low, high = problem.q[j].min(), problem.q[j].max()
        place = np.clip((problem.q[j] - low) / max(high - low, 1e-12) * BINS, 0, BINS - 1)
        cell = place.astype(int) + BINS * (problem.qd[j] > 0)
        cells = np.zeros((folds, 2 * BINS))
        np.add.at(cells, (fold, cell), 1.0)
        rest = _neighbours(cells.sum(axis=0) - cells)
        out |= rest[fold, cell] == 0
    return out


def _neighbours(cells: FloatArray) -> FloatArray:
    """Counts (folds, 2 BINS) with those of the bins on either side, direction by direction."""
    wide = np.pad(cells.reshape(len(cells), 2, BINS), ((0, 0), (0, 0), (1, 1)))
    out: FloatArray = (wide[:, :, :-2] + wide[:, :, 1:-1] + wide[:, :, 2:]).reshape(len(cells), -1)
    return out
