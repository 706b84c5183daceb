"""The last step to the optimum: Gauss-Newton of all coefficients and shape values together.

The search on grids stops where the residual hardly falls any more; where the noise is small
that is still many standard errors away from the optimum.

How the model's effort changes with its shape values: central differences.

A law of a spring or a play refers to the load that passes it, which is made of the masses that are
fitted.  Taken in turns - the masses beside a load, the load of these masses - the two settle where
the law changes the load little.  Near a resonance it multiplies the load: the masses that fit
beside one load are then not those that it was made of, and the model foretells other efforts than
the fit had.  There the last steps take the load for what it is, a function of the masses.

Standard errors of coefficients and shape values, jointly.

At the optimum the model is linear in both:  d y = X d theta + J d s.  The sandwich covariance
over blocks of time is taken of [X, J], so a shape that is uncertain widens the coefficients
that trade off with it, and coloured residuals count as what they are.  A coefficient b
that its bound holds does not trade off:  var(s | b) = V_ss - V_sb V_bb^-1 V_bs.

Source: Golub and Pereyra, Inverse Problems 19, 2003 (separable least squares); Liang and
Zeger, Biometrika 73, 1986.

Standard errors of all shape values are for what is printed.

`spread` counts the first shape value of a term, by which the search goes.  An exponent, a damping
ratio or a sign resolution that was picked beside it is as uncertain, and widens what trades off
with it.  With J the derivatives by all of them, beside the free coefficients,

    var = sandwich of [X, J] over blocks of time  +  d^2,

d the Gauss-Newton step that is left to the joint optimum: a value that was picked from a few is
not at it.  Nothing is fitted again, and no verdict rests on these errors.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.identify.context import bearing, carried_by, references, set_context, update_load
from hil.identify.design import Term, by_run, prefix, stack
from hil.identify.problem import Problem
from hil.identify.regression import (
    Basis,
    basis,
    cluster_covariance,
    decomposed,
    extended,
    least_squares,
    time_blocks,
    unit_scale,
)
from hil.identify.result import FitResult
from hil.identify.solve import Drawn, limits, noise_to_signal, solve, solved
from hil.models.effect import Trait, continuous
from hil.models.model import RobotModel, Value
from hil.models.motion import Motion
from hil.models.parts import JOINT

FloatArray = NDArray[np.float64]
#: A fall of the weighted residual sum of squares (in noise units) that is worth another step.
STEP_GAIN = 0.01
MAX_STEPS = 8


def gauss_newton(
    problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray
) -> list[Term]:
    """Terms with their shapes at the joint optimum, between the neighbours on their grids.

    The sign resolution of Coulomb friction stays: it is the sharpest that fits, not the best.
    """
    ranges = _ranges(problem, terms)
    if not ranges:
        return terms
    theta, _, b, slices, residual = solve(problem, terms, model, sigma)
    left, part = _weighted(residual, sigma), 1.0
    for _ in range(MAX_STEPS):
        joint = with_shapes(problem, terms, theta, slices, b, sigma, list(ranges))
        new = _stepped(terms, ranges, joint, (residual / sigma[:, None]).reshape(-1), part)
        set_context(problem, new)
        found = solve(problem, new, model, sigma)
        after = _weighted(found[-1], sigma)
        if after >= left:
            set_context(problem, terms)
            part /= 4  # the effort is not linear in the shapes that far
            continue
        before, left, terms, part = left, after, new, min(2 * part, 1.0)
        theta, _, b, _, residual = found
        # a step that ended at a neighbour on the grid may go on beyond it
        ranges = _ranges(problem, terms, ranges)
        if before - left < STEP_GAIN:
            break
    return terms


#: A shape value: number of its term, and which of its values.
ShapeAt = tuple[int, int]
#: Ratio by which a tuned value may change at a step.
TUNED_RATIO = 1.3


def _ranges(
    problem: Problem, terms: Sequence[Term], known: Collection[ShapeAt] = ()
) -> dict[ShapeAt, tuple[float, float]]:
    """Shape values that go to the joint optimum, and between what; of those `known` if given."""
    out: dict[ShapeAt, tuple[float, float]] = {}
    for k, t in enumerate(terms):
        if not ((k, 0) in known if known else _movable(problem, t)):
            continue
        out[k, 0] = around(problem, t)
        for i, (p, x) in enumerate(zip(t.effect.shape, t.shape, strict=True)):
            if i and p.tuned and x:
                ends = sorted((x / TUNED_RATIO, x * TUNED_RATIO))
                out[k, i] = max(ends[0], p.lower), min(ends[1], p.upper)
    return out


def _movable(problem: Problem, term: Term) -> bool:
    if term.effect.search.at_resolution or not searched(problem, term):
        return False
    return end_of_range(problem, term) == 0


def _stepped(
    terms: list[Term],
    ranges: dict[ShapeAt, tuple[float, float]],
    joint: Basis,
    r: FloatArray,
    part: float,
) -> list[Term]:
    """Terms after a part of one Gauss-Newton step on the weighted residual r (d n,)."""
    size, out = joint.scale.size, list(terms)
    steps = joint.solve(r, np.zeros(size), np.zeros(r.size))[size - len(ranges) :]
    for ((k, i), (low, high)), step in zip(ranges.items(), steps, strict=True):
        shape = out[k].shape
        new = float(np.clip(shape[i] + part * step, low, high))
        out[k] = out[k].reshaped((*shape[:i], new, *shape[i + 1 :]))
    return out


def _weighted(residual: FloatArray, sigma: FloatArray) -> float:
    return float(np.sum((residual / sigma[:, None]) ** 2))


#: Step of the difference, in distances between grid values.
DIFFERENCE_STEP = 0.01
#: The same for values that lie on no continuous grid, relative to the value.
DIFFERENCE_SHARE = 1e-3


def line(problem: Problem, term: Term) -> FloatArray:
    """Values of the first shape parameter on the term's grid, the form being as it is; sorted.

    All values where the others were changed to what the grid does not hold (`Search.across`).
    """
    grid = problem.grid(term.effect, term.joint)
    own = [s[0] for s in grid if s[1:] == term.shape[1:]]
    return np.unique(own or [s[0] for s in grid])


def searched(problem: Problem, term: Term) -> bool:
    """Whether the first shape value was found on a continuous range (the others are forms)."""
    held = term.fixed or term.fixed_shape or not continuous(term.effect)
    return not held and line(problem, term).size > 1


def end_of_range(problem: Problem, term: Term) -> int:
    """-1 or 1 where the first shape value lies on the lower or upper end of its range, else 0."""
    values = line(problem, term)
    near = 1e-6 * float(np.min(np.diff(values)))
    value = term.shape[0]
    return int(value >= values[-1] - near) - int(value <= values[0] + near)


def derivative(
    problem: Problem,
    terms: Sequence[Term],
    theta: FloatArray,
    slices: Sequence[slice],
    k: int,
    i: int,
) -> FloatArray:
    """Derivative of the model's effort by shape value i of term k, shape (d, n).

    What other effects take from it (the sign resolution, the surface) changes with it.
    """
    term = terms[k]
    shape = term.shape
    if i == 0:
        low, high = around(problem, term)
        h = DIFFERENCE_STEP * (high - low) / 2
    else:
        h = DIFFERENCE_SHARE * abs(shape[i])
    # dy/ds = (y(s + h) - y(s - h)) / (2 h)
    up, down = (
        _effort(problem, terms, theta, slices, term.reshaped((*shape[:i], x, *shape[i + 1 :])))
        for x in (shape[i] + h, shape[i] - h)
    )
    return (up - down) / (2 * h)


def around(problem: Problem, term: Term) -> tuple[float, float]:
    """Neighbours of the first shape value on its grid; beyond an end of it, the last two there.

    A grid that refers to a surface ends elsewhere once the surface is found elsewhere.
    """
    values, value = line(problem, term), term.shape[0]
    if value < values[0] or value > values[-1]:
        low, high = values[:2] if value < values[0] else values[-2:]
        return float(low), float(high)
    below, above = values[values < value], values[values > value]
    return float(below.max(initial=values[0])), float(above.min(initial=values[-1]))


def with_shapes(
    problem: Problem,
    terms: Sequence[Term],
    theta: FloatArray,
    slices: Sequence[slice],
    b: Basis,
    sigma: FloatArray,
    which: Sequence[ShapeAt],
) -> Basis:
    """Basis of [X, J]: the coefficients' basis and some shape values of terms."""
    if not which:
        return b
    columns = [derivative(problem, terms, theta, slices, *at) / sigma[:, None] for at in which]
    j = np.stack([c.reshape(-1) for c in columns], axis=1)
    j = np.concatenate([j, np.zeros((len(b.q) - len(j), len(which)))])
    return extended(b, j, noise_to_signal(problem.y / sigma[:, None]))


def _effort(
    problem: Problem, terms: Sequence[Term], theta: FloatArray, slices: Sequence[slice], new: Term
) -> FloatArray:
    """Filtered effort (d, n) of a changed term and of those that may refer to it."""
    old = problem.motions[0]
    context = references([new], old.v0, old.contact)
    motions = [m.with_(**context) for m in problem.motions]
    changed = not np.array_equal(context["v0"], old.v0) or not np.array_equal(
        context["contact"], old.contact, equal_nan=True
    )
    out = np.zeros((problem.d, problem.n))
    for t, where in zip(terms, slices, strict=True):
        if t.key == new.key:
            out += _acting(problem, motions, new, theta[where])
        elif changed and _refers(t, new.joint):
            out += _acting(problem, motions, t, theta[where])
    return out


def _refers(term: Term, joint: int) -> bool:
    """Whether a term's columns may depend on what was found for a joint."""
    coupled = any(p.name == JOINT for p in term.effect.shape)
    return Trait.MOTION not in term.effect.traits and (term.joint == joint or coupled)


def _acting(
    problem: Problem, motions: Sequence[Motion], term: Term, theta: FloatArray
) -> FloatArray:
    """Filtered effort (d, n) of one term."""
    each = by_run(term, theta, problem.runs)[problem.whole] if term.per_run else None
    own = np.tile(theta, (len(motions), 1)) if each is None else each
    raw = [
        term.effect.columns(m, term.joint, term.shape) @ c
        for m, c in zip(motions, own, strict=True)
    ]
    out = np.zeros((problem.d, problem.n))
    if term.effect.scope.whole:
        out[:] = problem.acting(raw, None).T
    else:
        out[term.joint] = problem.acting(raw, term.joint)
    return out


# ------------------------------------------------------------ a load that the masses make

#: Share by which what a fit leaves grows where the load is that of its own masses, from which on it
#: is fitted as such.  Half: more fits take the time for it; double: more of what is printed is
#: another error than that of the written model.
APART = 0.05
#: Directions of the masses in which a load changes, the largest ones, least share of the largest
#: one that counts, and the step of their difference.
DIRECTIONS, LEAST_DIRECTION, LOAD_STEP = 4, 1e-2, 1e-4
#: Least singular value, of columns of length one, in whose direction a step goes.
DETERMINED = 1e-3
#: Most steps, and the share by which the squares must fall for another one.
CARRIED_STEPS, CARRIED_GAIN = 10, 1e-2


def carried(
    problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray
) -> tuple[list[Term], FloatArray] | None:
    """Terms and coefficients (p,) that leave least where the load is that of their own masses.

    With X the columns beside the load L of the present masses, and D the derivative of their sum
    by the coefficients through L, a step goes along [X + D, J], J as for any shape values.

    Parameters
    ----------
    problem : Problem
        The runs; it has the load of what is found then.
    terms, model, sigma : list of Term, RobotModel, ndarray (d,)
        A fit that has settled.

    Returns
    -------
    tuple or None
        None where no law passes the load on, or the fit's load is that of its masses already.
    """
    if not any(_passes(t) for t in terms):
        return None
    theta, _, _, slices, residual, drawn = solved(problem, terms, model, sigma, True)
    motions = problem.motions
    state = _Carried(problem, terms, theta, slices, sigma, drawn)
    if _weighted(state.residual, sigma) <= (1 + APART) ** 2 * _weighted(residual, sigma):
        problem.motions = motions
        set_context(problem, terms)
        return None
    for _ in range(CARRIED_STEPS):
        step, part = state.step(), 1.0
        new = state.moved(step, part)
        while new.squares >= state.squares and part > 0.1:
            part /= 4
            new = state.moved(step, part)
        if new.squares >= state.squares:
            break
        fall, state = 1 - new.squares / state.squares, new
        if fall < CARRIED_GAIN:
            break
    update_load(problem, state.terms, state.theta, slices)
    set_context(problem, state.terms)
    return state.terms, state.theta


def _passes(term: Term) -> bool:
    """Whether a law passes the load on with a motion of its own."""
    return term.effect.family == "transmission" and Trait.LOAD in term.effect.traits


class _Carried:
    """Shapes and coefficients, beside the load of their own masses.

    Parameters
    ----------
    problem, terms, theta, slices, sigma, drawn
        As of a fit; what draws the coefficients besides counts among the squares.
    """

    def __init__(
        self,
        problem: Problem,
        terms: list[Term],
        theta: FloatArray,
        slices: Sequence[slice],
        sigma: FloatArray,
        drawn: Drawn,
    ) -> None:
        self.problem, self.terms, self.theta = problem, terms, theta
        self.slices, self.sigma, self.drawn = slices, sigma, drawn
        update_load(problem, terms, theta, list(slices))
        set_context(problem, terms)
        self.x, _ = stack(problem, terms)
        left = problem.y.reshape(-1) - self.x @ theta
        self.residual = left.reshape(problem.d, problem.n)
        rows, wanted = drawn.rows, drawn.target
        if drawn.pull is not None:
            rows = np.concatenate([rows, drawn.pull.rows])
            wanted = np.concatenate([wanted, drawn.pull.rows @ drawn.pull.centre])
        self.beside = rows, wanted - rows @ theta
        self.squares = _weighted(self.residual, sigma) + float(np.sum(self.beside[1] ** 2))

    def step(self) -> tuple[FloatArray, dict[ShapeAt, tuple[float, float]]]:
        """Gauss-Newton step of the coefficients and of some shape values, and the ranges of these.

        The problem has the load of this state.
        """
        problem, terms = self.problem, self.terms
        ranges = _ranges(problem, terms)
        shapes = [
            derivative(problem, terms, self.theta, self.slices, *at).reshape(-1) for at in ranges
        ]
        held = [np.full(s.stop - s.start, t.fixed) for t, s in zip(terms, self.slices, strict=True)]
        x = self.x + through_load(problem, terms, self.theta, self.slices)
        free, drawn = ~np.concatenate(held), self.beside[0]
        rows = np.concatenate([x * free, np.stack(shapes, axis=1)], axis=1) if shapes else x * free
        w = np.repeat(1.0 / self.sigma, problem.n)
        also = np.zeros((len(drawn), rows.shape[1]))
        also[:, : free.size] = drawn * free
        rows = np.concatenate([rows * w[:, None], also])
        norm, live = unit_scale(np.linalg.norm(rows, axis=0))
        # what neither the data nor the description determines stays where it is
        right = np.concatenate([self.residual.reshape(-1) * w, self.beside[1]])
        return least_squares(rows * live / norm, right, DETERMINED) / norm, ranges

    def moved(
        self, step: tuple[FloatArray, dict[ShapeAt, tuple[float, float]]], part: float
    ) -> _Carried:
        """The state after a part of a step, within the bounds of all values."""
        problem, size = self.problem, self.theta.size
        low, high = limits(self.terms, problem)
        theta, out = np.clip(self.theta + part * step[0][:size], low, high), list(self.terms)
        for ((k, i), ends), change in zip(step[1].items(), part * step[0][size:], strict=True):
            shape = out[k].shape
            new = float(np.clip(shape[i] + change, *ends))
            out[k] = out[k].reshaped((*shape[:i], new, *shape[i + 1 :]))
        return _Carried(problem, out, theta, self.slices, self.sigma, self.drawn)


def through_load(
    problem: Problem, terms: Sequence[Term], theta: FloatArray, slices: Sequence[slice]
) -> FloatArray:
    """Derivative D (d n, p) of what the laws pass on by the coefficients, through the load alone.

    In the few directions of the masses in which the load changes most; zero without such a law.
    Of several joints the inertia that a link feels stays what it is: a step that was too long for
    that is shortened.
    """
    passing = [(t, s) for t, s in zip(terms, slices, strict=True) if _passes(t)]
    size = theta.size
    some = np.zeros(size, dtype=bool)
    for _, where in bearing(terms, slices):
        some[where] = True
    out = np.zeros((problem.d * problem.n, size))
    if not passing or not some.any():
        return out
    every, _ = stack(problem, [t for t, s in zip(terms, slices, strict=True) if some[s].any()])
    joints = sorted({t.joint for t, _ in passing})
    own = every.reshape(problem.d, problem.n, -1)[joints].reshape(len(joints) * problem.n, -1)
    norm, live = unit_scale(np.linalg.norm(own, axis=0))
    _, size_of, along = decomposed(own * live / norm)
    count = int(np.sum(size_of[:DIRECTIONS] > LEAST_DIRECTION * size_of[0]))
    step = LOAD_STEP * max(float(np.linalg.norm(theta[some] * norm)), 1e-300)
    rest = _passed(problem, terms, theta, slices, passing)
    for way in along[:count]:
        moved = np.zeros(size)
        moved[some] = step * way / norm
        change = _passed(problem, terms, theta + moved, slices, passing) - rest
        out[:, some] += np.outer(change.reshape(-1) / step, way * norm)
    return out


def _passed(
    problem: Problem,
    terms: Sequence[Term],
    theta: FloatArray,
    slices: Sequence[slice],
    passing: Sequence[tuple[Term, slice]],
) -> FloatArray:
    """Filtered effort (d, n) of some laws, at their own values, beside the load of others."""
    motions = carried_by(problem, list(terms), theta, list(slices), anew=problem.d == 1)
    out = np.zeros((problem.d, problem.n))
    for t, where in passing:
        out += _acting(problem, motions, t, theta[where])
    return out


# ------------------------------------------------------------ standard errors

#: Multiple of a shape value from which its error says only that nothing is known of it.
OPEN = 10.0
#: A shape value: number of its term, and which of the term's shape values it is.
Place = tuple[int, int]


@dataclass(frozen=True)
class ShapeError:
    """What is known of one shape value.

    Parameters
    ----------
    stderr : float
        Standard error; NaN where the value is held, is one of a few forms, or lies at the end
        of its range (the optimum may lie beyond).
    at_bound : bool
        Whether it lies at the end of the range that was searched.
    identifiable : bool
        Whether the data determine it beside everything else.
    """

    stderr: float = float("nan")
    at_bound: bool = False
    identifiable: bool = True


@dataclass(frozen=True)
class Spread:
    """Standard errors of a fit.

    Parameters
    ----------
    stderr : ndarray (p,)
        Of the coefficients.
    known : ndarray (p,)
        Whether the data determine each coefficient, the shapes being free.
    shapes : list of tuple of ShapeError
        For every term, one for each of its shape values.
    """

    stderr: FloatArray
    known: NDArray[np.bool_]
    shapes: list[tuple[ShapeError, ...]]


def standard_errors(
    problem: Problem,
    terms: Sequence[Term],
    theta: FloatArray,
    slices: Sequence[slice],
    b: Basis,
    weighted: FloatArray,
    sigma: FloatArray,
) -> Spread:
    """Errors from the solution (p,), its basis, and the weighted residual of its rows.

    Rows beyond the problem's are of what is known besides; each is a block of its own.
    """
    ends = {k: end_of_range(problem, t) for k, t in enumerate(terms) if searched(problem, t)}
    free = [k for k, end in ends.items() if not end]
    b = with_shapes(problem, terms, theta, slices, b, sigma, [(k, 0) for k in free])
    blocks = np.tile(time_blocks(problem), problem.d)
    more = weighted.size - blocks.size
    blocks = np.concatenate([blocks, int(blocks.max()) + 1 + np.arange(more)])
    covariance = cluster_covariance(weighted, b, blocks)
    stderr = np.sqrt(np.diag(covariance))
    known, p = b.identifiable(), theta.size
    low, high = limits(terms, problem)
    held = (theta <= low) | (theta >= high)
    for i, k in enumerate(free):
        stderr[p + i] = _given(covariance, p + i, slices[k].start + np.flatnonzero(held[slices[k]]))
    found = {
        k: ShapeError(float(stderr[p + i]) if known[p + i] else float("nan"), False, bool(ok))
        for i, (k, ok) in enumerate(zip(free, known[p:], strict=True))
    }
    for k, end in ends.items():
        if not np.any(theta[slices[k]]):  # no effect, so no shape
            found[k] = ShapeError(identifiable=False)
        elif end:
            found[k] = ShapeError(at_bound=end > 0 or not terms[k].effect.search.at_resolution)
    shapes = [
        tuple(found.get(k, ShapeError()) if i == 0 else ShapeError() for i in range(len(t.shape)))
        for k, t in enumerate(terms)
    ]
    return Spread(stderr[:p], known[:p], shapes)


def _given(covariance: FloatArray, s: int, held: NDArray[np.int_]) -> float:
    """Standard error of value number s, given others that are held."""
    across = covariance[s, held]
    own = covariance[np.ix_(held, held)]
    # V_ss - V_sb V_bb^-1 V_bs
    left = covariance[s, s] - across @ np.linalg.pinv(own, hermitian=True) @ across
    return float(np.sqrt(max(left, 0.0)))


def complete(result: FitResult) -> FitResult:
    """The same fit with standard errors of every shape value that is a quantity."""
    places = _quantities(result)
    if all(i == 0 for _, i in places):
        return result
    free = np.array([not result.values[n].at_bound for n in result.names])
    stderr, known = _errors(result, free, places)
    count = int(free.sum())
    names = [n for n, ok in zip(result.names, free, strict=True) if ok]
    pairs = zip(names, stderr[:count].tolist(), strict=True)
    new = {n: _wider(result.values[n], e) for n, e in pairs}
    for place, e, ok in zip(places, stderr[count:], known[count:], strict=True):
        name = _name(result, place)
        new[name] = _wider(result.values[name], float(e) if ok else float("nan"), place[1] > 0)
    return replace(result, values=result.values | new, model=_renewed(result.model, new))


def _quantities(result: FitResult) -> list[Place]:
    """Shape values that are quantities, of terms that do anything, away from the range's ends."""
    out = []
    for k, (t, where) in enumerate(zip(result.terms, result.slices, strict=True)):
        if t.fixed or t.fixed_shape or not np.any(result.theta[where]):
            continue
        for i, (p, value) in enumerate(zip(t.effect.shape, t.shape, strict=True)):
            if not p.choice and value and (i > 0 or _inside(result, t)):
                out.append((k, i))
    return out


def _inside(result: FitResult, t: Term) -> bool:
    return searched(result.problem, t) and not end_of_range(result.problem, t)


def _name(result: FitResult, place: Place) -> str:
    term = result.terms[place[0]]
    return f"{prefix(term, result.problem.joints)}.{term.effect.shape[place[1]].name}"


def _errors(
    result: FitResult, free: NDArray[np.bool_], places: list[Place]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Errors of the free coefficients and of shape values, and whether the data determine them."""
    problem, sigma = result.problem, result.sigma
    least = noise_to_signal(problem.y / sigma[:, None])
    rows = result.x + through_load(problem, result.terms, result.theta, result.slices)
    x = basis(rows[:, free] * np.repeat(1.0 / sigma, problem.n)[:, None], least)
    columns = [derivative(problem, result.terms, result.theta, result.slices, *p) for p in places]
    j = np.stack([(c / sigma[:, None]).reshape(-1) for c in columns], axis=1)
    r = (result.residual / sigma[:, None]).reshape(-1)
    b = extended(x, j, least)
    blocks = np.tile(time_blocks(problem), problem.d)
    variance = np.diag(cluster_covariance(r, b, blocks))
    step = _step(result, x, j, r, places, least)
    return np.sqrt(variance + step**2), b.identifiable()


def _step(
    result: FitResult, x: Basis, j: FloatArray, r: FloatArray, places: list[Place], least: float
) -> FloatArray:
    """Gauss-Newton step to the joint optimum; a shape value on its bound does not go beyond."""
    count, inside = x.scale.size, np.ones(len(places), dtype=bool)
    for _ in range(len(places) + 1):
        b = extended(x, j * inside, least)
        step = b.solve(r, np.zeros(b.scale.size), np.zeros(r.size))
        beyond = [
            inside[n] and not _allowed(result, p, float(step[count + n]))
            for n, p in enumerate(places)
        ]
        if not any(beyond):
            break
        inside &= ~np.array(beyond)
    return step


def _allowed(result: FitResult, place: Place, step: float) -> bool:
    """Whether a shape value that moves by `step` stays within its bounds."""
    k, i = place
    p, value = result.terms[k].effect.shape[i], result.terms[k].shape[i]
    return p.lower <= value + step <= p.upper


def _wider(v: Value, stderr: float, own: bool = False) -> Value:
    """The value with an error that is no smaller than the one it had; `own`: it had none."""
    if own:
        size = min(OPEN * abs(v.value), v.upper - v.lower)
        return replace(v, stderr=stderr if stderr < size else float("nan"))
    return replace(v, stderr=max(v.stderr, stderr)) if v.stderr == v.stderr else v


def _renewed(model: RobotModel, new: dict[str, Value]) -> RobotModel:
    """The model with these values in place of its own."""
    effects = tuple(
        replace(u, values={n: new.get(n, v) for n, v in u.values.items()}) for u in model.effects
    )
    return replace(model, effects=effects)
