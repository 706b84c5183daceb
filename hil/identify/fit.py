"""Fit a model: all coefficients jointly, shapes by variable projection.

The result of a fit: values with errors, bounds and identifiability.

The last step to the optimum: Gauss-Newton of all coefficients and shape values together.

The search on grids stops where the residual hardly falls any more; where the noise is small
that is still many standard errors away from the optimum.

Standard errors of coefficients and shape values, jointly.

At the optimum the model is linear in both:  d y = X d theta + J d s.  The sandwich covariance
over blocks of time is taken of [X, J], so a shape that is uncertain widens the coefficients
that trade off with it, and coloured residuals count as what they are.  A coefficient b
that its bound holds does not trade off:  var(s | b) = V_ss - V_sb V_bb^-1 V_bs.

Source: Golub and Pereyra, Inverse Problems 19, 2003 (separable least squares); Liang and
Zeger, Biometrika 73, 1986.

How the model's effort changes with its shape values: central differences.

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

from hil.errors import FitError
from hil.identify.context import (
    find_surface,
    impossible,
    own_states,
    references,
    scaled_states,
    scales,
    set_context,
    settled_as_given,
    settled_load,
)
from hil.identify.design import Term, bind, by_run, coefficients, prefix
from hil.identify.predict import identified, predict
from hil.identify.problem import Problem
from hil.identify.regression import (
    Basis,
    basis,
    cluster_covariance,
    extended,
    left_open,
    time_blocks,
)
from hil.identify.result import FitResult
from hil.identify.shape_search import search_shapes
from hil.identify.solve import (
    DESCRIBED,
    fit_of,
    limits,
    noise_to_signal,
    prior,
    solve,
    solved,
)
from hil.models.effect import Trait
from hil.models.model import RobotModel, Use, Value
from hil.models.motion import Motion
from hil.models.parts import JOINT

__all__ = ["fit", "predict", "solve", "time_blocks"]
FloatArray = NDArray[np.float64]
#: Relative change of the residual scales that asks for another round of the shape search.
SCALE_CHANGE = 0.1
#: Multiple of a shape value from which its error says only that nothing is known of it.
OPEN = 10.0
#: A shape value: number of its term, and which of the term's shape values it is.
Place = tuple[int, int]


def fit(
    problem: Problem, model: RobotModel, sweeps: int = 2, scale: FloatArray | None = None
) -> FitResult:
    """Fit every free parameter of a model jointly.

    Coefficients are eliminated by weighted least squares; shape values that the model does
    not hold are searched on the effects' grids and refined, at last together; effort scales
    and the transmitted load are updated until they settle.

    Parameters
    ----------
    problem : Problem
        The runs.
    model : RobotModel
        Effects; values it holds for shapes are starting points, `fixed` ones stay.
    sweeps : int
        Rounds of shape search.
    scale : ndarray (d,), optional
        Residual scale by joint of a fit that may be close; one round of the search then suffices
        if the scales hardly change.

    Raises
    ------
    FitError
        If the runs hold no motion at all, or fewer rows than coefficients.
    """
    terms = bind(model, problem)
    if not any(np.ptp(m.q) for m in problem.motions) and not np.any(np.diff(problem.span)):
        raise FitError("the recordings hold no motion, so they determine nothing; move the robot")
    if problem.n * problem.d <= sum(len(coefficients(t, problem)) for t in terms):
        raise FitError(
            f"{problem.n} instants are fewer than the model's coefficients; record longer"
        )
    sigma = np.maximum(np.std(problem.y, axis=1), 1e-12) if scale is None else scale
    whole = all(t.shape for t in terms if t.effect.shape)
    terms = [replace(t, shape=t.shape or _start(t, problem)) for t in terms]
    find_surface(problem, terms, sigma)
    if whole:
        set_context(problem, terms)  # another fit may have left its own
    given = settled_as_given(problem, terms, model, sigma) if whole else None
    idle: set[tuple[str, int]] = set()
    if given:
        sigma, idle = given.sigma, given.idle
    for sweep in range(sweeps + 1):
        before = sigma
        terms = search_shapes(problem, terms, sigma, idle)
        set_context(problem, terms)
        sigma, now = scales(problem, terms, model, sigma)
        near = scale is not None and np.max(np.abs(np.log(sigma / before))) < SCALE_CHANGE
        if now == idle and (near or sweep >= sweeps - 1):
            break
        idle = now
    if any(Trait.LOAD in t.effect.traits for t in terms):
        sigma = settled_load(problem, terms, model, sigma)
    if given:
        own_states(problem, terms, model, sigma)
        terms, sigma = given.or_better(problem, terms, model, sigma)
    return assemble(problem, model, _polished(problem, terms, model, sigma), sigma)


def _polished(
    problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray
) -> list[Term]:
    """Terms at the joint optimum; as they were where they leave less with states of their own.

    The steps to the optimum take the states that laws scale as they are.
    """
    if not scaled_states(problem, terms):
        return gauss_newton(problem, terms, model, sigma)
    own_states(problem, terms, model, sigma)
    motions, before = problem.motions, problem.rms(solve(problem, terms, model, sigma)[-1])
    moved = gauss_newton(problem, terms, model, sigma)
    own_states(problem, moved, model, sigma)
    after = problem.rms(solve(problem, moved, model, sigma)[-1])
    ratio = np.maximum(after, 1e-300) / np.maximum(before, 1e-300)
    if float(np.sum(np.log(ratio[~problem.holds]))) <= 0.0:
        return moved
    problem.motions = motions
    set_context(problem, terms)
    problem.set_context()  # what was made beside the other states is forgotten
    return terms


def _start(term: Term, problem: Problem) -> tuple[float, ...]:
    grid = problem.grid(term.effect, term.joint)
    if not grid:
        reason = term.effect.scope.lacks(problem.motions[0], term.joint) or "no shape to try"
        raise impossible(term, problem, reason)
    return grid[0]


def assemble(
    problem: Problem, model: RobotModel, terms: list[Term], sigma: FloatArray
) -> FitResult:
    """Final solution with errors, bounds and identifiability."""
    theta, x, b, slices, residual, drawn = solved(problem, terms, model, sigma, True)
    beside = drawn.target - drawn.rows @ theta
    weighted = np.concatenate([(residual / sigma[:, None]).reshape(-1), beside])
    found = standard_errors(problem, terms, theta, slices, drawn.basis, weighted, sigma)
    pull = drawn.pull
    # what no row sees stays at the prior; lying on a bound there says nothing
    seen = np.linalg.norm(b.v, axis=1) > 1e-9
    values: dict[str, Value] = {}
    uses: dict[int, dict[str, Value]] = {}
    source = fit_of(problem)
    given = pull.said(b) if pull else np.zeros(theta.size, dtype=bool)
    for t, where, shapes in zip(terms, slices, found.shapes, strict=True):
        part = _linear(
            problem, t, theta[where], found.stderr[where], found.known[where], seen[where], source
        )
        # values of single runs share a name; those of the description do not
        named = zip(coefficients(t, problem), given[where], strict=True)
        said = {name for (name, _), is_said in named if is_said}
        part = {n: replace(v, source=DESCRIBED) if n in said else v for n, v in part.items()}
        part |= _shapes(problem, t, shapes, source)
        values |= part
        uses.setdefault(t.use, {}).update(part)
    effects = tuple(
        Use(u.type, u.joints, u.options, uses.get(k, {})) for k, u in enumerate(model.effects)
    )
    names = [n for t in terms for n, _ in coefficients(t, problem)]
    start = left_open(theta, prior(problem, terms, model, names), b)
    return FitResult(
        replace(model, effects=effects, valid=identified(problem), fitted=problem.taken),
        problem,
        terms,
        theta,
        names,
        values,
        residual,
        sigma,
        b,
        start if pull is None else np.where(np.any(pull.rows, axis=0), pull.centre, start),
        x,
        slices,
        pull=pull,
    )


def _linear(
    problem: Problem,
    term: Term,
    theta: FloatArray,
    stderr: FloatArray,
    known: NDArray[np.bool_],
    seen: NDArray[np.bool_],
    source: str,
) -> dict[str, Value]:
    """Coefficients of a term."""
    out: dict[str, Value] = {}
    named = coefficients(term, problem)
    rows = zip(named, theta, stderr, known, seen, strict=True)
    for (name, p), value, err, ok, moves in rows:
        out[name] = Value(
            float(value),
            float(err) if ok and not term.fixed else float("nan"),
            in_units(p.unit, problem, term.joint),
            p.lower,
            p.upper,
            at_bound=bool(moves and (value <= p.lower or value >= p.upper)),
            identifiable=bool(ok) or term.fixed,
            source="given" if term.fixed else source,
        )
    return out


def _shapes(
    problem: Problem, term: Term, found: Sequence[ShapeError], source: str
) -> dict[str, Value]:
    """Shape values of a term."""
    head = prefix(term, problem.joints)
    return {
        f"{head}.{p.name}": Value(
            float(value),
            error.stderr,
            in_units(p.unit, problem, term.joint),
            p.lower,
            p.upper,
            error.at_bound,
            error.identifiable,
            source,
        )
        for p, value, error in zip(term.effect.shape, term.shape, found, strict=True)
    }


def in_units(unit: str, problem: Problem, j: int) -> str:
    """A unit with joint j's own for {F} and {x}, e.g. N s/m for {F} s/{x}."""
    linear = problem.robot.units[j] == "m"
    return unit.replace("{F}", "N" if linear else "N m").replace("{x}", "m" if linear else "rad")


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
    held = term.fixed or term.fixed_shape or not term.effect.shape or not term.effect.search.refine
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
    """Neighbours of the first shape value on its grid."""
    values = line(problem, term)
    below, above = values[values < term.shape[0]], values[values > term.shape[0]]
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
    x = basis(result.x[:, free] * np.repeat(1.0 / sigma, problem.n)[:, None], least)
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
