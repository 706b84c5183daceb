"""From the best shape of a grid to the best shape: its first value climbed, the others tried."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.identify.climb import climb
from hil.identify.design import Term
from hil.identify.projector import Projector
from hil.identify.trial import CLOSE, flat, left

#: Gain of another form's maximum on the grid, in units of the best climbed one, from which it is
#: worth a climb: a step beside its summit a resonance keeps a third of it.
HOPEFUL = 0.3
#: Accuracy of a shape's gain, in a fit and among candidates.
FINE, COARSE = 5e-5, 2e-4


def searched(
    projector: Projector, found: Term, grid: list[tuple[float, ...]],
    known: dict[tuple[float, ...], float], accuracy: float,
) -> tuple[Term, float]:  # fmt: skip
    """The best shape about the grid's best: its first value, the others, the first again."""
    gain, effect = known[found.shape], found.effect
    movable = effect.search.refine and len(effect.shape) and len(grid) > 1
    line = line_of(grid, found.shape) if movable else []
    if movable:
        found, gain = _refine(projector, found, line, known, accuracy)
        if effect.search.rounds:
            found, gain, line = _summits(projector, (found, gain, line), grid, known, accuracy)
    for _ in range(max(effect.search.rounds, 1)):
        before = found.shape
        found, gain = _across(projector, found, gain)
        if not (effect.search.rounds and movable) or found.shape == before:
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


def present(
    projector: Projector, term: Term, found: tuple[Term, float], grid: list[tuple[float, ...]],
    accuracy: float,
) -> tuple[Term, float]:  # fmt: skip
    """The shape that the term has already, climbed from there, where it leaves clearly less."""
    if not term.effect.search.rounds or not term.shape or term.shape == found[0].shape:
        return found
    gain = projector.gain(term)
    if gain - found[1] <= (CLOSE - 1) * left(projector, term, gain):
        return found
    if not term.effect.search.refine or len(grid) < 2:
        return term, gain
    return _refine(projector, term, line_of(grid, term.shape), {term.shape: gain}, accuracy)


def line_of(grid: list[tuple[float, ...]], shape: tuple[float, ...]) -> list[float]:
    """First values of the grid in the form of a shape; of all forms where it has none like it."""
    own = [s[0] for s in grid if s[1:] == shape[1:]]
    return sorted(set(own or (s[0] for s in grid)))


def _across(projector: Projector, term: Term, gain: float) -> tuple[Term, float]:
    """The term with other values than the first one changed, where that leaves clearly less."""
    shapes = term.effect.search.across(projector.problem.motions[0], term.joint, term.shape)
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
    found = term.effect.search.others(projector.problem.motions[0], term.joint, term.shape)
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
    return _refine(projector, term.reshaped(shapes[k]), line_of(shapes, shapes[k]), known, FINE)


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

    def at(x: float) -> float:
        shape = (x, *rest)
        if shape not in known:
            known[shape] = projector.gain(term.reshaped(shape))
        return known[shape]

    spare = left(projector, term, gain)
    enough = accuracy * min(abs(gain), abs(spare))
    best, most = climb(at, (low, value, high), enough)
    if most > gain + flat(gain, spare):
        return term.reshaped((best, *rest)), most
    return term, gain
