"""Which shapes of a grid are tried, what is left by them, and which of equals is taken."""

from __future__ import annotations

import numpy as np

from hil.identify import timelines
from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.screening import FIRST, SURE, promising, screen
from hil.models.effect import Lines

#: Difference of gains that is none, relative to the gain, and to what it leaves: the first of a
#: grid's equals is taken.  Where hardly anything is left, much of it is little of the gain.
FLAT, REST = 5e-4, 0.1
#: What is left, in units of the least, from which a simpler shape will do.
CLOSE = 1.01


def grid_of(problem: Problem, term: Term) -> list[tuple[float, ...]]:
    """The effect's grid, from its least value on where one is known."""
    grid = problem.grid(term.effect, term.joint)
    least = problem.least.get(term.key)
    if least is None:
        return grid
    return [(least,), *(shape for shape in grid if shape[0] > least)]


def tried(
    projector: Projector, term: Term, grid: list[tuple[float, ...]]
) -> dict[tuple[float, ...], float]:
    """Gains of the part of a long grid that deserves an exact fit; of other grids, of all.

    Of orders over position those that promise most come first, with their neighbours; the others
    follow where they could still leave less than the best of these.
    """
    if isinstance(term.effect.search, Lines):
        rows, j = projector.rows(term), term.joint
        effort = projector.problem.effort[j] / projector.sigma[j]
        grid = timelines.promising(projector.problem, term, projector.residual[rows], effort)
    waves = None if isinstance(term.effect.search, Lines) else screen(projector.problem, term, grid)
    if waves is None:
        return _gains(projector, term, grid)
    n, j = projector.problem.n, term.joint
    back = projector.problem.back(projector.residual[j * n : (j + 1) * n], j)
    near = waves.gains(back)
    out = _gains(projector, term, [grid[k] for k in promising(near, FIRST)])
    most = max(out.values())
    more = [k for k in promising(near) if SURE * near[k] > most and grid[k] not in out]
    out |= _gains(projector, term, [grid[k] for k in more])
    return dict(sorted(out.items()))


def _gains(
    projector: Projector, term: Term, shapes: list[tuple[float, ...]]
) -> dict[tuple[float, ...], float]:
    """Gains by shape."""
    if not shapes:
        return {}
    return dict(zip(shapes, projector.gains(term, shapes).tolist(), strict=True))


def simplest(grid: list[tuple[float, ...]], gains: list[float], rest: list[float]) -> int:
    """Best index of the first form (all shape values but the first) within 1 % of the best gain.

    A grid lists its forms from the usual to the unusual one.
    """
    top = max(gains)
    for form in dict.fromkeys(shape[1:] for shape in grid):
        own = [k for k, shape in enumerate(grid) if shape[1:] == form]
        most = max(gains[k] for k in own)
        if most >= 0.99 * top:
            none = next(flat(most, rest[k]) for k in own if gains[k] == most)
            return next(k for k in own if gains[k] >= most - none)
    return int(np.argmax(gains))


def flat(gain: float, rest: float) -> float:
    """Difference from a gain that is none."""
    return min(FLAT * abs(gain), REST * abs(rest))


def left(projector: Projector, term: Term, gain: float = 0.0) -> float:
    """What a gain leaves on a joint of the term, each joint having its share of the residual.

    Joints are weighted by their own residuals, so that these are alike; of the sum over all of
    them one joint's loss would seem small on a robot with many.
    """
    joints = 1 if term.effect.scope.whole else projector.problem.d
    return (projector.rss - gain) / joints
