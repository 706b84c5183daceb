"""Search of the non-linear parameters, the linear ones eliminated (variable projection).

With an orthonormal basis Q of all other columns and residual r, a term's columns C lower the
residual sum of squares by  c' G^+ c  with  c = C' r  and  G = C'C - (Q'C)'(Q'C).

Source: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973.

From the best shape of a grid to the best shape: its first value climbed, the others tried.

Maximum of a smooth function between three points, by few evaluations.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.identify.screening import CLOSE, USUAL, flat, grid_of, left, simplest, tried
from hil.models.effect import Effect, Trait, Waves, alone, continuous, typical_speed
from hil.models.motion import Motion
from hil.models.parts import JOINT

FloatArray = NDArray[np.float64]
#: Share of the squared residual below which a shape is not worth refining.
NEGLIGIBLE = 5e-3
#: Share of what is left that odd harmonics must account for: two columns of noise account for
#: a percent of a few hundred independent instants.
ODD = 0.02
#: Gain of another form's maximum on the grid, in units of the best climbed one, from which it is
#: worth a climb: a step beside its summit a resonance keeps a third of it.
HOPEFUL = 0.3
#: How much more a law that a fit has may leave than another one of its effect.  Half of the
#: surplus: two laws that both foretell what they follow take turns in a fit; double: the law that
#: was found first stays where more was found beside it.
STAYS = 1.25
#: Accuracy of a shape's gain, in a fit and among candidates.
FINE, COARSE = 5e-5, 2e-4


def best_shape(
    projector: Projector, term: Term, refine: bool = True, accuracy: float = FINE
) -> tuple[Term, float]:
    """The term with the shape that lowers the residual most, and the gain.

    `accuracy` is the share of the gain, or of what is left if that is less, within which the
    shape must be the best.
    """
    if term.effect.scope.sought_alone and projector.problem.d > 1:
        own = replace(term, effect=alone(term.effect))
        found = term.reshaped(best_shape(projector, own, refine, accuracy)[0].shape)
        return found, projector.gain(found) if found.shape else 0.0
    problem = projector.problem
    grid = grid_of(problem, term)
    if not grid:
        return term, 0.0
    known = tried(projector, term, grid)
    if not known:
        return term, 0.0
    shapes, gains = list(known), list(known.values())
    first = simplest(shapes, gains, [left(projector, term, g) for g in gains])
    found, gain = term.reshaped(shapes[first]), gains[first]
    if refine and gain > NEGLIGIBLE * left(projector, term):
        found, gain = searched(projector, found, grid, known, accuracy, term.shape)
    if refine:
        found, gain = present(projector, term, (found, gain), grid, accuracy)
    return _fundamental(projector, found, gain, grid, accuracy)


def _fundamental(
    projector: Projector,
    term: Term,
    gain: float,
    grid: list[tuple[float, ...]],
    accuracy: float,
) -> tuple[Term, float]:
    """Twice the order of waves over position whose odd harmonics are nothing.

    The second harmonic of half an order is the order itself: the data cannot tell, people can.
    """
    twice = tuple(2 * s for s in term.shape)
    waves = len(twice) == 1 and len(grid) > 1 and twice[0] <= grid[-1][0]
    search, motion = term.effect.search, projector.problem.motions[0]
    if not waves or not isinstance(search, Waves) or search.carrier(motion, term.joint) is None:
        return term, gain
    known = {twice: projector.gain(term.reshaped(twice))}
    if known[twice] < HOPEFUL * gain:
        return term, gain
    # the end of a grid, or its raster, may lie beside half of the order
    other, most = _refine(projector, term.reshaped(twice), line_of(grid, twice), known, accuracy)
    return (other, most) if most >= gain - ODD * abs(left(projector, term, gain)) else (term, gain)


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
        with problem.aside():
            found, gain = best_shape(projector, term)
            if term.effect.search.sharpest:
                found = _sharpest(projector, found, gain)
            if Trait.DRY in term.effect.traits and _says_little(projector, found):
                found = _by_users(problem, others, sigma, found)
        out[k] = found
    return out


def _says_little(projector: Projector, term: Term) -> bool:
    """Whether friction is below zero, or explains little beside what all others leave."""
    if not term.shape:
        return False
    gain, beta, _, _ = projector.score(term)
    return bool(np.all(beta <= 0.0)) or gain <= OWN_SHARE * left(projector, term, gain)


def _by_users(problem: Problem, others: list[Term], sigma: FloatArray, dry: Term) -> Term:
    """A sign resolved as the laws that use it ask for, where its own friction says little.

    Friction that turns with two joints, or under load, may be all that there is.  The sharpest of
    the grid that leaves within 1 % of what the best one does, or that one.
    """
    users = [t for t in others if _uses(problem, t, dry.joint)]
    if not users:
        return dry
    keys = {t.key for t in users}
    rest = Projector(problem, [t for t in others if t.key not in keys], sigma)
    wide = next((t for t in users if t.effect.scope.whole), dry)

    def gain(v0: float, some: Sequence[Term]) -> float:
        motions = _resolved(problem, dry.joint, v0)
        columns = [_of_user(problem, t, motions, sigma, wide) for t in some]
        return rest.gain_of(wide, np.concatenate(columns, axis=1))

    gains = {v0: gain(v0, [dry.reshaped((v0,)), *users]) for (v0,) in grid_of(problem, dry)}
    line = sorted(gains)
    k = line.index(max(gains, key=lambda v0: gains[v0]))
    ends = np.log(line[max(k - 1, 0)]), np.log(line[min(k + 1, len(line) - 1)])
    if ends[1] > ends[0]:
        found = scipy.optimize.fminbound(
            lambda x: -gain(np.exp(x), [dry.reshaped((np.exp(x),)), *users]),
            *ends,
            xtol=PAIR_CLOSE,
            maxfun=USER_STEPS,
            disp=0,  # near enough is enough: no warning where it stops there
        )
        v0 = float(np.exp(found))
        gains[v0] = gain(v0, [dry.reshaped((v0,)), *users])
    most = max(gains.values())
    least = most - (CLOSE - 1) * left(rest, wide, most)
    return dry.reshaped((min(v0 for v0, g in gains.items() if g >= least),))


def _resolved(problem: Problem, j: int, v0: float) -> list[Motion]:
    """The motions with the sign of joint j resolved to v0."""
    every = np.where(np.arange(problem.d) == j, v0, problem.motions[0].v0)
    return [m.with_(v0=every) for m in problem.motions]


def _uses(problem: Problem, term: Term, j: int) -> bool:
    """Whether a term's columns change with the resolution of joint j's sign."""
    names = [p.name for p in term.effect.shape]
    other = JOINT in names and term.shape[names.index(JOINT)] == j + 1
    here = term.joint == j or other or term.effect.scope.of_robot
    correction = bool(term.effect.traits & (Trait.MOTION | Trait.CORRECTION))
    return here and not correction and problem.uses_sign(term.effect, term.joint, j)


def _of_user(
    problem: Problem, term: Term, motions: Sequence[Motion], sigma: FloatArray, rows: Term
) -> FloatArray:
    """Weighted columns (N, m) of a term beside other motions, on the rows of another term."""
    raw = [term.effect.columns(m, term.joint, term.shape) for m in motions]
    if term.effect.scope.whole:
        each = np.moveaxis(problem.acting(raw, None), 0, 1) / sigma[:, None, None]
        return np.asarray(each.reshape(problem.d * problem.n, -1))
    own: FloatArray = problem.acting(raw, term.joint) / sigma[term.joint]
    if not rows.effect.scope.whole:
        return own
    out = np.zeros((problem.d, problem.n, own.shape[1]))
    out[term.joint] = own
    return out.reshape(problem.d * problem.n, -1)


#: First step of the search for two shapes together, of their logarithms.
LITTLE = 0.2
#: Steps of the search for two shapes together, of each form, and how close its logarithms end.
PAIR_STEPS, PAIR_CLOSE = 60, 0.01
#: Share of what all others leave up to which friction says little of how sharply it turns.
OWN_SHARE = 0.1
#: Steps of the search for a sign by the laws that use it.
USER_STEPS = 12


def together(
    problem: Problem, terms: list[Term], sigma: FloatArray, term: Term, dry: Term
) -> tuple[Term, Term] | None:
    """A term and the sign of its joint with the shapes that leave least where both are sought.

    One after the other they may end where no step of one alone leads down: a Stribeck curve of
    another exponent asks for another resolution of the sign.  In each of its forms the first value
    and the resolution are sought from the best pair of their grids.  None where no pair leaves
    clearly less than they do now.

    Parameters
    ----------
    problem : Problem
        The runs.
    terms : list of Term
        All terms of a fit.
    sigma : ndarray (d,)
        Effort scale by joint.
    term, dry : Term
        Two of them: one with several forms, and the Coulomb friction of its joint.

    Source: Nelder, Mead, Computer Journal 7, 1965.
    """
    others = [t for t in terms if t.key not in (term.key, dry.key)]
    pair = _Pair(problem, Projector(problem, others, sigma), term, dry)
    now = pair.gains(dry.shape[0], [term.shape])[0]
    best, tops = (now, dry.shape[0], term.shape), dict[tuple[float, ...], _Top]()
    for (v0,) in grid_of(problem, dry):
        grid = pair.grid(v0)
        for shape, gain in zip(grid, pair.gains(v0, grid), strict=True):
            tops[shape[1:]] = max(tops.get(shape[1:], (0.0, v0, shape)), (gain, v0, shape))
    for _, v0, shape in tops.values():
        best = max(best, pair.climbed(v0, shape))
    least = pair.projector.rss - best[0]
    if pair.projector.rss - now <= CLOSE * least:
        return None
    return term.reshaped(best[2]), dry.reshaped((best[1],))


#: Gain, resolution of the sign, shape.
_Top = tuple[float, float, tuple[float, ...]]


@dataclass(frozen=True)
class _Pair:
    """A term and the sign of its joint beside all others."""

    problem: Problem
    projector: Projector
    term: Term
    dry: Term

    def _motions(self, v0: float) -> list[Motion]:
        """The motions with the sign resolved to v0."""
        return _resolved(self.problem, self.term.joint, v0)

    def grid(self, v0: float) -> list[tuple[float, ...]]:
        """Shapes that the term may have beside a sign resolved to v0."""
        return self.term.effect.search.grid(self._motions(v0)[0], self.term.joint)

    def gains(self, v0: float, shapes: Sequence[tuple[float, ...]]) -> list[float]:
        """Gain of both with the sign resolved to v0, for some shapes of the term."""
        problem, j, motions = self.problem, self.term.joint, self._motions(v0)
        laws = [(self.dry.effect, (v0,)), *((self.term.effect, s) for s in shapes)]
        raw = [[e.columns(m, j, s) for e, s in laws] for m in motions]
        edges = np.cumsum([x.shape[1] for x in raw[0]])[:-1]
        rows = problem.gated([np.concatenate(x, axis=1) for x in raw], j) / self.projector.sigma[j]
        sign, *each = np.split(rows, edges, axis=1)
        return [self.projector.gain_of(self.dry, np.concatenate([sign, x], axis=1)) for x in each]

    def climbed(
        self, v0: float, shape: tuple[float, ...]
    ) -> tuple[float, float, tuple[float, ...]]:
        """Gain, resolution and shape at the summit next to a pair, within both their grids.

        Beside a sign that turns more slowly than the law itself, the two are but a curve that
        follows what a filter leaves of reversals.
        """
        start = np.log([v0, shape[0]])
        signs = [s[0] for s in grid_of(self.problem, self.dry)]

        def loss(x: FloatArray) -> float:
            one, first = (float(value) for value in np.exp(x))
            own = line_of(self.grid(one), (first, *shape[1:]))
            inside = signs[0] <= one <= signs[-1] and own[0] <= first <= own[-1]
            return -self.gains(one, [(first, *shape[1:])])[0] if inside else 0.0

        simplex = start + np.array([[0.0, 0.0], [LITTLE, 0.0], [0.0, LITTLE]])
        found = scipy.optimize.minimize(
            loss,
            start,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": PAIR_STEPS, "xatol": PAIR_CLOSE},
        )
        one, first = np.exp(found.x)
        return -float(found.fun), float(one), (float(first), *shape[1:])


def _sharpest(projector: Projector, term: Term, best_gain: float) -> Term:
    """A sign's resolution: the sharpest that is within 1 % of what the best one leaves.

    A wide tanh imitates low-speed effects; it is taken only where the data ask for it.
    """
    grid = grid_of(projector.problem, term)
    least = best_gain - (CLOSE - 1) * left(projector, term, best_gain)
    for shape in grid:
        if shape >= term.shape:
            break
        if projector.gain(term.reshaped(shape)) >= least:
            return term.reshaped(shape)
    return term


#: Ratio of one resolution of the sign to the next that is tried.
BLUNTER = 1.25


def expected_sign(result: FitResult, count: FloatArray) -> dict[tuple[str, int], float]:
    """The resolution of the sign that is to be expected, by (``"coulomb"``, joint).

    Where many are as likely, the sharpest foretells slow turns as badly as the bluntest one.  With
    N independent instants and squared errors S of resolutions v0, each a step blunter,

        log v0 = sum w log v0 / sum w,    w = (S / least)^(-N / 2).

    Parameters
    ----------
    result : FitResult
        A fit.
    count : ndarray (d,)
        Independent instants of each joint.

    Returns
    -------
    dict
        Of joints where it is clearly blunter than what the fit has.
    """
    problem, out = result.problem, dict[tuple[str, int], float]()
    for t in result.terms:
        if Trait.DRY not in t.effect.traits or t.fixed_shape or problem.holds[t.joint]:
            continue
        others = [x for x in result.terms if x is not t]
        projector, v0 = Projector(problem, others, result.sigma), float(t.shape[0])
        (most,) = problem.grid(t.effect, t.joint)[-1]
        tries = int(np.log(max(most / v0, 1.0)) / np.log(BLUNTER)) + 1
        values = [v0 * BLUNTER**k for k in range(tries)]
        with problem.aside():
            gains = [projector.gain(t.reshaped((x, *t.shape[1:]))) for x in values]
        rest = np.maximum([left(projector, t, g) for g in gains], 1e-300)
        odds = np.exp(-0.5 * count[t.joint] * np.log(rest / rest.min()))
        middle = float(np.exp(odds @ np.log(values) / odds.sum()))
        if middle > BLUNTER * v0:
            out[t.key] = middle
    return out


#: Largest resolution of the sign that is looked for beyond its range, over the typical speed: a
#: wider one is viscous friction.
ROUNDEST = 1.0


def rounder(result: FitResult, j: int) -> dict[tuple[str, int], float]:
    """The resolution of joint j's sign that leaves least, beyond the range of its search, by term.

    Empty where the least lies within the range, or friction has no range there.

    Parameters
    ----------
    result : FitResult
        A fit.
    j : int
        The joint.
    """
    problem = result.problem
    for t in result.terms:
        if Trait.DRY not in t.effect.traits or t.fixed_shape or t.joint != j:
            continue
        (most,) = problem.grid(t.effect, j)[-1]
        last = ROUNDEST * typical_speed(problem.motions[0], j)
        tries = int(np.log(max(last / most, 1.0)) / np.log(BLUNTER)) + 1
        values = [most * BLUNTER**k for k in range(tries)]
        projector = Projector(problem, [x for x in result.terms if x is not t], result.sigma)
        with problem.aside():
            best = _widest(projector, t, values)
        return {t.key: best} if best > most else {}
    return {}


def _widest(projector: Projector, t: Term, values: Sequence[float]) -> float:
    """The first shape value of most gain: the best of some, then between its neighbours."""

    def gain(x: float) -> float:
        return projector.gain(t.reshaped((x, *t.shape[1:])))

    gains = [gain(x) for x in values]
    best = int(np.argmax(gains))
    if best == 0:
        return values[0]
    low, high = np.log(values[best - 1]), np.log(values[min(best + 1, len(values) - 1)])
    found = scipy.optimize.minimize_scalar(
        lambda x: -gain(float(np.exp(x))), bounds=(low, high), method="bounded"
    )
    return float(np.exp(found.x)) if -found.fun > gains[best] else values[best]


def searched(
    projector: Projector,
    found: Term,
    grid: list[tuple[float, ...]],
    known: dict[tuple[float, ...], float],
    accuracy: float,
    present: tuple[float, ...] = (),
) -> tuple[Term, float]:
    """The best shape about the grid's best: its first value, the others, the first again."""
    gain, effect = known[found.shape], found.effect
    movable = continuous(effect) and len(grid) > 1
    line = line_of(grid, found.shape) if movable else []
    if movable:
        found, gain = _refine(projector, found, line, known, accuracy)
        if effect.search.rounds or _laws(effect):
            found, gain, line = _summits(
                projector, (found, gain, line), grid, known, accuracy, present
            )
    for _ in range(max(effect.search.rounds, 1)):
        before = found.shape
        found, gain = _across(projector, found, gain)
        if found.shape == before:
            break
        if movable:
            known[found.shape] = gain
            found, gain = _refine(projector, found, line, known, accuracy)
    return found, gain


def _laws(effect: Effect) -> bool:
    """Whether the forms of an effect are laws of their own."""
    return any(p.choice for p in effect.shape)


def _summits(
    projector: Projector,
    best: tuple[Term, float, list[float]],
    grid: list[tuple[float, ...]],
    known: dict[tuple[float, ...], float],
    accuracy: float,
    present: tuple[float, ...],
) -> tuple[Term, float, list[float]]:
    """The best of the forms' own maxima: term, gain and line of first values.

    The maxima of two laws lie anywhere on a grid.  Of one law with another damping, a form whose
    best value on the grid is next to what was found climbs the same one.  A usual law stands where
    an unusual one takes hardly more; beside a fit that of the `present` shape does, until another
    one leaves clearly less: its rivals are seen beside what the model foretells with it.
    """
    first, laws = best[0], _laws(best[0].effect)
    tops = {first.shape[1:]: best}
    for form in dict.fromkeys(shape[1:] for shape in grid):
        line = sorted(s[0] for s in grid if s[1:] == form)
        gains = [known.get((x, *form), 0.0) for x in line]
        k = int(np.argmax(gains))
        top, gain = line[k], gains[k]
        near = line[max(k - 1, 0)] <= first.shape[0] <= line[min(k + 1, len(line) - 1)]
        if form in tops or (near and not laws) or gain < HOPEFUL * best[1]:
            continue
        other = _refine(projector, first.reshaped((top, *form)), line, known, accuracy)
        tops[form] = (*other, line)
    most = max(tops.values(), key=lambda t: t[1])
    if not laws:
        return most
    rest = left(projector, most[0], most[1])
    if own := tops.get(present[1:]):
        timed = most[0].effect.variation.timed
        if timed(most[0].shape) and not timed(own[0].shape) and own[1] >= USUAL * most[1]:
            return own  # a clock only stands for the state that was measured
        return own if own[1] >= most[1] - (STAYS - 1) * rest else most
    usual = [tops[f] for f in dict.fromkeys(s[1:] for s in grid) if f in tops]
    return next((t for t in usual if t[1] >= (2 - CLOSE) * most[1]), most)


def present(
    projector: Projector,
    term: Term,
    found: tuple[Term, float],
    grid: list[tuple[float, ...]],
    accuracy: float,
) -> tuple[Term, float]:
    """The shape that the term has already, climbed from there, where it leaves clearly less."""
    if not term.effect.search.rounds or not term.shape or term.shape == found[0].shape:
        return found
    gain = projector.gain(term)
    if gain - found[1] <= (CLOSE - 1) * left(projector, term, gain):
        return found
    if not continuous(term.effect) or len(grid) < 2:
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
    if not np.all(np.isfinite(gains)):  # columns of a joint without an effort
        return term, gain
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
    projector: Projector,
    term: Term,
    line: list[float],
    known: dict[tuple[float, ...], float],
    accuracy: float,
) -> tuple[Term, float]:
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
    best, most = line_search(at, (low, value, high), enough)
    if most > gain + flat(gain, spare):
        return term.reshaped((best, *rest)), most
    return term, gain


#: Share of the larger side that a golden step takes, and the closest step to a known point.
GOLDEN, CLOSEST = 0.381966, 0.01
GOLDEN_STEPS = 12
Function = Callable[[float], float]


def line_search(
    f: Function, points: tuple[float, float, float], tolerance: float
) -> tuple[float, float]:
    """Place and value of a maximum of f on [a, c], found from a, b and c.

    Parabolas through the best three points, golden sections where they lead nowhere or close in
    from one side only; at most twelve evaluations besides the three.  Between uneven sides the
    first parabola may have its vertex on b by chance, far from the maximum: that it promises no
    more is believed of the next one, through a point more on the longer side.

    Parameters
    ----------
    f : callable
        The function; evaluated at the same points again, so it should remember.
    points : tuple of float
        a <= b <= c; b may be one of the ends.
    tolerance : float
        Rise that is none: the search ends where a parabola promises no more.
    """
    a, b, c = points
    if b in (a, c):
        found = _inside(f, b, c if b == a else a)
        if found is None:
            return b, f(b)
        a, b, c = found
    width = 2 * (c - a)
    for step in range(GOLDEN_STEPS):
        x, promise = _vertex(f, a, b, c)
        uneven = min(b - a, c - b) < GOLDEN * (c - a) and f(b) - min(f(a), f(c)) >= tolerance
        if promise < tolerance and (step or not uneven):
            break
        trusted = promise >= tolerance and c - a < 0.7 * width
        x = _apart(a, b, c, x) if trusted else _golden(a, b, c)
        width = c - a
        if f(x) > f(b):
            a, b, c = (b, x, c) if x > b else (a, x, b)
        elif x > b:
            c = x
        else:
            a = x
    return b, f(b)


def _vertex(f: Function, a: float, b: float, c: float) -> tuple[float, float]:
    """Vertex of the parabola through three points and its height over f(b)."""
    # f(x) = f(b) + s (x - b) + k (x - b)^2
    left, right = (f(a) - f(b)) / (a - b), (f(c) - f(b)) / (c - b)
    k = (right - left) / (c - a)
    if k >= 0.0:
        return b, 0.0
    s = left - k * (a - b)
    return b - s / (2 * k), -s * s / (4 * k)


def _apart(a: float, b: float, c: float, x: float) -> float:
    """Next point: x, but within the bracket and not on top of b."""
    near = CLOSEST * (c - a)
    if abs(x - b) <= near:  # a point close by closes the bracket from the longer side
        return b + near if c - b > b - a else b - near
    if a + near < x < c - near:
        return x
    return _golden(a, b, c)


def _golden(a: float, b: float, c: float) -> float:
    return b + GOLDEN * (c - b) if c - b > b - a else b - GOLDEN * (b - a)


def _inside(f: Function, end: float, far: float) -> tuple[float, float, float] | None:
    """Bracket with its largest value inside, next to an end; None where f falls from the end."""
    x = end + GOLDEN * (far - end)
    for _ in range(3):
        low, high = sorted((end, far))
        if f(x) > f(end):
            return low, x, high
        top, _ = _vertex(f, low, x, high)
        if not min(end, x) < top < max(end, x):
            return None
        far, x = x, top
    return None
