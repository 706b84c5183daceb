"""Search of the non-linear parameters, the linear ones eliminated (variable projection).

With an orthonormal basis Q of all other columns and residual r, a term's columns C lower the
residual sum of squares by  c' G^+ c  with  c = C' r  and  G = C'C - (Q'C)'(Q'C).

Source: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.identify import timelines
from hil.identify.climb import climb
from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.screening import FIRST, SURE, promising, screen

FloatArray = NDArray[np.float64]
#: Share of the squared residual below which a shape is not worth refining.
NEGLIGIBLE = 5e-3
#: Difference of gains that is none, relative to the gain, and to what it leaves: the first of a
#: grid's equals is taken.  Where hardly anything is left, much of it is little of the gain.
FLAT, REST = 5e-4, 0.1
#: Share of what is left that odd harmonics must account for: two columns of noise account for
#: a percent of a few hundred independent instants.
ODD = 0.02
#: What is left, in units of the least, from which a simpler shape will do.
CLOSE = 1.01
#: Gain of another form's maximum on the grid, in units of the best climbed one, from which it is
#: worth a climb: a step beside its summit a resonance keeps a third of it.
HOPEFUL = 0.3
#: Accuracy of a shape's gain, in a fit and among candidates.
FINE, COARSE = 5e-5, 2e-4


def best_shape(
    projector: Projector, term: Term, refine: bool = True, accuracy: float = FINE
) -> tuple[Term, float]:
    """The term with the shape that lowers the residual most, and the gain.

    `accuracy` is the share of the gain, or of what is left if that is less, within which the
    shape must be the best.
    """
    problem = projector.problem
    grid = _grid(problem, term)
    if not grid:
        return term, 0.0
    known = _tried(projector, term, grid)
    if not known:
        return term, 0.0
    tried, gains = list(known), list(known.values())
    first = _simplest(tried, gains, [left(projector, term, g) for g in gains])
    found, gain = term.reshaped(tried[first]), gains[first]
    if refine and gain > NEGLIGIBLE * left(projector, term):
        found, gain = _searched(projector, found, grid, known, accuracy)
    if refine:
        found, gain = _present(projector, term, (found, gain), grid, accuracy)
    return _fundamental(projector, found, gain, grid)


def _grid(problem: Problem, term: Term) -> list[tuple[float, ...]]:
    """The effect's grid, from its least value on where one is known."""
    grid = term.effect.grid(problem.motions[0], term.joint)
    least = problem.least.get(term.key)
    if least is None:
        return grid
    return [(least,), *(shape for shape in grid if shape[0] > least)]


def _searched(
    projector: Projector, found: Term, grid: list[tuple[float, ...]],
    known: dict[tuple[float, ...], float], accuracy: float,
) -> tuple[Term, float]:  # fmt: skip
    """The best shape about the grid's best: its first value, the others, the first again."""
    gain, effect = known[found.shape], found.effect
    movable = effect.refine and len(effect.shape) and len(grid) > 1
    line = _line(grid, found.shape) if movable else []
    if movable:
        found, gain = _refine(projector, found, line, known, accuracy)
        if effect.rounds:
            found, gain, line = _summits(projector, (found, gain, line), grid, known, accuracy)
    for _ in range(max(effect.rounds, 1)):
        before = found.shape
        found, gain = _across(projector, found, gain)
        if not (effect.rounds and movable) or found.shape == before:
            break
        known[found.shape] = gain
        found, gain = _refine(projector, found, line, known, accuracy)
    return found, gain


def _summits(
    projector: Projector, best: tuple[Term, float, list[float]], grid: list[tuple[float, ...]],
    known: dict[tuple[float, ...], float], accuracy: float,
) -> tuple[Term, float, list[float]]:  # fmt: skip
    """The best of the forms' own maxima: term, gain and line of first values.

    A form whose best value on the grid is next to what was found climbs the same one.
    """
    first = best[0]
    for form in dict.fromkeys(shape[1:] for shape in grid):
        line = sorted(s[0] for s in grid if s[1:] == form)
        gains = [known.get((x, *form), 0.0) for x in line]
        k = int(np.argmax(gains))
        top, gain = line[k], gains[k]
        same = line[max(k - 1, 0)] <= first.shape[0] <= line[min(k + 1, len(line) - 1)]
        if form == first.shape[1:] or same or gain < HOPEFUL * best[1]:
            continue
        other = _refine(projector, first.reshaped((top, *form)), line, known, accuracy)
        if other[1] > best[1]:
            best = (*other, line)
    return best


def _present(
    projector: Projector, term: Term, found: tuple[Term, float], grid: list[tuple[float, ...]],
    accuracy: float,
) -> tuple[Term, float]:  # fmt: skip
    """The shape that the term has already, climbed from there, where it leaves clearly less."""
    if not term.effect.rounds or not term.shape or term.shape == found[0].shape:
        return found
    gain = projector.gain(term)
    if gain - found[1] <= (CLOSE - 1) * left(projector, term, gain):
        return found
    if not term.effect.refine or len(grid) < 2:
        return term, gain
    return _refine(projector, term, _line(grid, term.shape), {term.shape: gain}, accuracy)


def _line(grid: list[tuple[float, ...]], shape: tuple[float, ...]) -> list[float]:
    """First values of the grid in the form of a shape; of all forms where it has none like it."""
    own = [s[0] for s in grid if s[1:] == shape[1:]]
    return sorted(set(own or (s[0] for s in grid)))


def _across(projector: Projector, term: Term, gain: float) -> tuple[Term, float]:
    """The term with other values than the first one changed, where that leaves clearly less."""
    shapes = term.effect.across(projector.problem.motions[0], term.joint, term.shape)
    if not shapes:
        return term, gain
    gains = [*projector.gains(term, shapes).tolist(), gain]
    most = max(gains)
    # gain >= most - 1 % of what the best one leaves
    allowed = (CLOSE - 1) * left(projector, term, most)
    k = int(np.flatnonzero(np.array(gains) >= most - allowed)[0])
    return _other(projector, term.reshaped([*shapes, term.shape][k]), gains[k])


def _other(projector: Projector, term: Term, gain: float) -> tuple[Term, float]:
    """The term in an unusual form where that leaves clearly less than what it has to beat."""
    found = term.effect.others(projector.problem.motions[0], term.joint, term.shape)
    if found is None or not found[0]:
        return term, gain
    shapes, rival, theirs = found
    gains = projector.gains(term, shapes)
    k = int(np.argmax(gains))
    if gains[k] <= gain:
        return term, gain
    beside = float(projector.gains(replace(term, effect=rival, shape=theirs[0]), theirs).max())
    if gains[k] - max(beside, gain) <= (CLOSE - 1) * left(projector, term, gains[k]):
        return term, gain
    known = dict(zip(shapes, gains.tolist(), strict=True))
    return _refine(projector, term.reshaped(shapes[k]), _line(shapes, shapes[k]), known, FINE)


def _tried(
    projector: Projector, term: Term, grid: list[tuple[float, ...]]
) -> dict[tuple[float, ...], float]:
    """Gains of the part of a long grid that deserves an exact fit; of other grids, of all.

    Of orders over position those that promise most come first, with their neighbours; the others
    follow where they could still leave less than the best of these.
    """
    if term.effect.spectral:
        rows, j = projector.rows(term), term.joint
        effort = projector.problem.effort[j] / projector.sigma[j]
        grid = timelines.promising(projector.problem, term, projector.residual[rows], effort)
    waves = None if term.effect.spectral else screen(projector.problem, term, grid)
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


def _simplest(grid: list[tuple[float, ...]], gains: list[float], rest: list[float]) -> int:
    """Best index of the first form (all shape values but the first) within 1 % of the best gain.

    A grid lists its forms from the usual to the unusual one.
    """
    top = max(gains)
    for form in dict.fromkeys(shape[1:] for shape in grid):
        own = [k for k, shape in enumerate(grid) if shape[1:] == form]
        most = max(gains[k] for k in own)
        if most >= 0.99 * top:
            flat = next(_flat(most, rest[k]) for k in own if gains[k] == most)
            return next(k for k in own if gains[k] >= most - flat)
    return int(np.argmax(gains))


def _fundamental(
    projector: Projector, term: Term, gain: float, grid: list[tuple[float, ...]]
) -> tuple[Term, float]:
    """Twice the order of waves over position whose odd harmonics are nothing.

    The second harmonic of half an order is the order itself: the data cannot tell, people can.
    """
    twice = tuple(2 * s for s in term.shape)
    waves = len(twice) == 1 and len(grid) > 1 and twice[0] <= grid[-1][0]
    if not waves or term.effect.carrier(projector.problem.motions[0], term.joint) is None:
        return term, gain
    most = projector.gain(term.reshaped(twice))
    if most >= gain - ODD * abs(left(projector, term, gain)):
        return term.reshaped(twice), most
    return term, gain


def left(projector: Projector, term: Term, gain: float = 0.0) -> float:
    """What a gain leaves on a joint of the term, each joint having its share of the residual.

    Joints are weighted by their own residuals, so that these are alike; of the sum over all of
    them one joint's loss would seem small on a robot with many.
    """
    joints = 1 if term.effect.whole_robot else projector.problem.d
    return (projector.rss - gain) / joints


def _flat(gain: float, rest: float) -> float:
    """Difference from a gain that is none."""
    return min(FLAT * abs(gain), REST * abs(rest))


def _refine(
    projector: Projector, term: Term, line: list[float],
    known: dict[tuple[float, ...], float], accuracy: float,
) -> tuple[Term, float]:  # fmt: skip
    """Search the first shape parameter between its neighbours on a line (same other values).

    `known` are gains that were computed already, that of the term among them.
    """
    value, rest = term.shape[0], term.shape[1:]
    gain = known[term.shape]
    low = max((x for x in line if x < value), default=value)
    high = min((x for x in line if x > value), default=value)
    if high <= low:
        return term, gain

    def tried(x: float) -> float:
        shape = (x, *rest)
        if shape not in known:
            known[shape] = projector.gain(term.reshaped(shape))
        return known[shape]

    spare = left(projector, term, gain)
    enough = accuracy * min(abs(gain), abs(spare))
    best, most = climb(tried, (low, value, high), enough)
    if most > gain + _flat(gain, spare):
        return term.reshaped((best, *rest)), most
    return term, gain


def search_shapes(
    problem: Problem,
    terms: list[Term],
    sigma: FloatArray,
    idle: Collection[tuple[str, int]] = (),
) -> list[Term]:
    """One round: every term with a shape is searched, all others present.

    Terms in `idle` (effect, joint) are kept at zero by their bounds and take no part.
    """
    out = list(terms)
    for k, term in enumerate(terms):
        if not term.effect.shape or term.fixed or term.fixed_shape:
            continue
        others = [t for t in out[:k] + out[k + 1 :] if t.key not in idle]
        projector = Projector(problem, others, sigma)
        found, gain = best_shape(projector, term)
        if term.effect.name == "coulomb":
            found = _sharpest(projector, found, gain)
        out[k] = found
    return out


def _sharpest(projector: Projector, term: Term, best_gain: float) -> Term:
    """Coulomb's sign resolution: the sharpest that is within 1 % of what the best one leaves.

    A wide tanh imitates low-speed effects; it is taken only where the data ask for it.
    """
    grid = _grid(projector.problem, term)
    least = best_gain - (CLOSE - 1) * left(projector, term, best_gain)
    for shape in grid:
        if shape >= term.shape:
            break
        if projector.gain(term.reshaped(shape)) >= least:
            return term.reshaped(shape)
    return term
