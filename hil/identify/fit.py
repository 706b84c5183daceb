"""Fit a model: all coefficients jointly, shapes by variable projection.

The result of a fit: values with errors, bounds and identifiability.

A fitted model on runs that it has not seen: what it leaves, and where it extrapolates.

A model is identified on a range of positions, speeds and loads; a prediction beyond it is
extrapolation.  Kept are the 0.5 and 99.5 % quantiles of each joint's motion; data count as outside
beyond these by more than a twentieth of the range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.errors import FitError
from hil.identify.context import (
    Settled,
    find_surface,
    impossible,
    own_states,
    scaled_states,
    scales,
    set_context,
    settled_as_given,
    settled_load,
    update_load,
)
from hil.identify.design import Term, bind, coefficients, prefix, stack
from hil.identify.gauss_newton import (
    ShapeError,
    carried,
    gauss_newton,
    standard_errors,
)
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.regression import (
    least_squares,
    left_open,
    time_blocks,
)
from hil.identify.result import FitResult
from hil.identify.shape_search import best_shape, search_shapes
from hil.identify.solve import (
    DESCRIBED,
    fit_of,
    prior,
    slices_of,
    solve,
    solved,
)
from hil.models.effect import Trait, continuous
from hil.models.model import Range, RobotModel, Use, Value
from hil.models.parts import Param

__all__ = ["fit", "predict", "solve", "time_blocks"]
FloatArray = NDArray[np.float64]
#: Relative change of the residual scales that asks for another round of the shape search.
SCALE_CHANGE = 0.1


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
    swept, idle = None, set[tuple[str, int]]()
    if given:
        sigma, idle = given.sigma, given.idle
    for sweep in range(sweeps + 1):
        before = sigma
        terms = search_shapes(problem, terms, sigma, idle)
        set_context(problem, terms)
        sigma, now = scales(problem, terms, model, sigma)
        swept = Settled(terms, problem.motions, sigma, now).or_less(swept, problem)
        near = scale is not None and np.max(np.abs(np.log(sigma / before))) < SCALE_CHANGE
        if now == idle and (near or sweep >= sweeps - 1):
            break
        idle = now
    if swept and swept.terms is not terms:
        terms, sigma = swept.or_better(problem, terms, model, sigma)
    if any(Trait.LOAD in t.effect.traits for t in terms):
        sigma = settled_load(problem, terms, model, sigma)
    if given:
        own_states(problem, terms, model, sigma)
        terms, sigma = given.or_better(problem, terms, model, sigma)
    terms = _polished(problem, terms, model, sigma)
    if found := carried(problem, terms, model, sigma):
        return assemble(problem, model, found[0], sigma, found[1])
    return assemble(problem, model, terms, sigma)


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
    problem: Problem,
    model: RobotModel,
    terms: list[Term],
    sigma: FloatArray,
    given: FloatArray | None = None,
) -> FitResult:
    """Final solution with errors, bounds and identifiability; `given` are its coefficients."""
    theta, x, b, slices, residual, drawn = solved(problem, terms, model, sigma, True)
    if given is not None:
        theta, residual = given, problem.y - (x @ given).reshape(problem.y.shape)
    beside = drawn.target - drawn.rows @ theta
    weighted = np.concatenate([(residual / sigma[:, None]).reshape(-1), beside])
    found = standard_errors(problem, terms, theta, slices, drawn.basis, weighted, sigma)
    pull = drawn.pull
    # what no row sees stays at the prior; lying on a bound there says nothing
    seen = np.linalg.norm(b.v, axis=1) > 1e-9
    values: dict[str, Value] = {}
    uses: dict[int, dict[str, Value]] = {}
    source = fit_of(problem)
    by_prior = pull.said(b) if pull else np.zeros(theta.size, dtype=bool)
    for t, where, shapes in zip(terms, slices, found.shapes, strict=True):
        part = _linear(
            problem, t, theta[where], found.stderr[where], found.known[where], seen[where], source
        )
        # values of single runs share a name; those of the description do not
        named = zip(coefficients(t, problem), by_prior[where], strict=True)
        said = {name for (name, _), is_said in named if is_said}
        part = {n: replace(v, source=DESCRIBED) if n in said else v for n, v in part.items()}
        part |= _shapes(problem, t, shapes, source)
        values |= part
        uses.setdefault(t.use, {}).update(part)
    differ = {t.use for t in terms if t.per_run and t.first}
    reference = {"reference": problem.recordings[0].name}
    effects = tuple(
        Use(u.type, u.joints, u.options | (reference if k in differ else {}), uses.get(k, {}))
        for k, u in enumerate(model.effects)
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
            unit_of(p, problem, term),
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
    """Shape values of a term but for those that need not be said."""
    head = prefix(term, problem.joints)
    return {
        f"{head}.{p.name}": Value(
            float(value),
            error.stderr,
            unit_of(p, problem, term),
            p.lower,
            p.upper,
            error.at_bound,
            error.identifiable,
            source,
        )
        for p, value, error in zip(term.effect.shape, term.shape, found, strict=True)
        if value != p.usual
    }


def unit_of(p: Param, problem: Problem, term: Term) -> str:
    """Unit of a parameter of a term, with those of the other joint where its shape names one."""
    return p.unit_at(problem.robot.units, term.joint, term.other)


def in_units(unit: str, problem: Problem, j: int) -> str:
    """A unit with joint j's own for {F} and {x}, e.g. N s/m for {F} s/{x}."""
    return Param("", unit, "").unit_at(problem.robot.units, j, j)


# ------------------------------------------------------------ prediction


def predict(result: FitResult, problem: Problem) -> FloatArray:
    """Residual (d, n) of a fitted model on another problem (held-out runs).

    The other problem must have been made with the same rates and span.  Coefficients of a
    single run (per-run offsets, a hum's phase) are estimated on the new runs, for they belong to
    a run; so is the instant of what happens once in a run.
    """
    source = result.problem.motions[0]
    problem.set_context(v0=source.v0, contact=source.contact)
    flat = [t for t in result.terms if not _own(t)]
    keep = {t.key for t in flat}
    theta = np.concatenate(
        [result.theta[s] for t, s in zip(result.terms, result.slices, strict=True) if t.key in keep]
        or [np.empty(0)]
    )
    # from the measured efforts, and not from those that another model foretold: beyond a limit
    # hardly anything of a command is seen, so that what was foretold before would stay
    problem.motions = [replace(m, drive=np.empty((0, 0))) for m in problem.motions]
    update_load(problem, flat, theta, slices_of(problem, flat))
    x, _ = stack(problem, flat)
    residual: FloatArray
    residual = (problem.y.reshape(-1) - x @ theta).reshape(problem.d, problem.n)
    for t in result.terms:
        if _own(t):
            own = _dated(t, problem, residual, result.sigma) if _happens(t) else t
            residual = _without(residual, own, problem, result.sigma)
    return residual


def own_values(result: FitResult) -> dict[str, tuple[int, list[int]]]:
    """Effects of which every run has values of its own: how many a joint, and their joints.

    Such values are estimated on held-out runs themselves, by `predict`.
    """
    out: dict[str, tuple[int, list[int]]] = {}
    for t in result.terms:
        if _own(t):
            motion = result.problem.motions[0]
            count = np.any(t.effect.columns(motion, t.joint, t.shape) != 0, axis=0)
            size = int(np.sum(np.any(count, axis=0) if t.effect.scope.whole else count))
            size += int(_happens(t))
            joints = [] if t.effect.scope.of_robot else [t.joint]
            known = out.setdefault(t.effect.name, (size, []))
            known[1].extend(joints)
    return out


def _own(t: Term) -> bool:
    """Whether every run has its own coefficients."""
    return t.per_run or t.effect.variation.own(t.shape)


def _happens(t: Term) -> bool:
    """Whether it happens in every run at an instant of its own, which is searched."""
    varies = t.effect.variation
    return varies.own(t.shape) and varies.dated(t.shape) and continuous(t.effect) and bool(t.shape)


def _dated(t: Term, problem: Problem, r: FloatArray, sigma: FloatArray) -> Term:
    """A term that happens in every run, at the instants that explain most of r (d, n)."""
    bare = Projector(problem, [], sigma)
    bare.residual = (r / sigma[:, None]).reshape(-1)
    bare.rss = float(bare.residual @ bare.residual)
    with problem.aside():
        return best_shape(bare, replace(t, per_run=True))[0]


def _without(r: FloatArray, term: Term, problem: Problem, sigma: FloatArray) -> FloatArray:
    """Residual r (d, n) less what a term of every run for itself explains of it."""
    columns = problem.columns(term.effect, term.joint, term.shape, per_run=True, every=True)
    at = slice(None) if term.effect.scope.whole else slice(term.joint, term.joint + 1)
    wide = columns if term.effect.scope.whole else columns[None]
    scale = sigma[at, None]
    rows = (wide / scale[..., None]).reshape(-1, wide.shape[-1])
    part = least_squares(rows, (r[at] / scale).reshape(-1))
    out = r.copy()
    out[at] -= wide @ part
    return out


#: Share of the instants at each end that is no range, the margin beyond it, and the shares of
#: instants outside that are worth a warning, and one of their own.
TAIL, MARGIN, WORTH, OFTEN = 0.005, 0.05, 0.02, 0.10
QUANTITIES = ("position", "speed", "load")


def _every(problem: Problem, what: str) -> list[FloatArray]:
    """One quantity of all joints, run by run (instants, d)."""
    name = {"position": "q", "speed": "qd", "load": "load"}[what]
    return [getattr(m, name) for m in problem.motions]


def _values(problem: Problem, j: int, what: str) -> FloatArray:
    """All values of one quantity of joint j (instants,)."""
    return np.concatenate([x[:, j] for x in _every(problem, what)])


def _ends(problem: Problem, j: int, what: str) -> tuple[float, float]:
    """Quantiles of one quantity of joint j."""

    def made() -> tuple[float, float]:
        low, high = np.quantile(_values(problem, j, what), [TAIL, 1 - TAIL]).tolist()
        return low, high

    return problem.remembered(("ends", j, what), _every(problem, what), made)


def identified(problem: Problem) -> tuple[Range, ...]:
    """Range of every joint over the runs of a fit, the load as the fit has it."""
    out = []
    for j, joint in enumerate(problem.joints):
        place, speed, load = (_ends(problem, j, what) for what in QUANTITIES)
        low, high = problem.span[j].tolist()
        out.append(Range(joint, place, speed, load, (low, high)))
    return tuple(out)


def range_limits(known: Range, what: str) -> tuple[float, float]:
    """Ends of a range with the margin."""
    low, high = getattr(known, what)
    spare = MARGIN * max(high - low, 1e-12)
    return low - spare, high + spare


def outside(known: Sequence[Range], problem: Problem, which: str = "session") -> list[str]:
    """Sentences on what leaves the identified range.

    One a quantity, with every joint that is outside often; and a short one for all others, by how
    much of the range they leave it, the worst first.

    Parameters
    ----------
    known : sequence of Range
        Ranges of a model; joints without one are not judged.
    problem : Problem
        The runs that the model is to predict.
    which : str
        What to call them.
    """
    ranges, out, rare = {r.joint: r for r in known}, [], []
    for what in QUANTITIES:
        parts = []
        for j, joint in enumerate(problem.joints):
            share, far = _beyond(problem, j, what, ranges[joint]) if joint in ranges else (0.0, 0.0)
            if share > OFTEN:
                parts.append(_part(problem, j, what, ranges[joint]))
            elif share > WORTH:
                rare.append((far, share, f"{what} of {joint}"))
        if parts:
            out.append(
                f"the {which} leaves the identified {what} range; "
                f"predictions there are extrapolations: {'; '.join(parts)}"
            )
    if rare:
        each = ", ".join(f"{name} {100 * far:.0f} %" for far, _, name in sorted(rare, reverse=True))
        most = max(share for _, share, _ in rare)
        out.append(
            f"the {which} leaves the identified range for up to {100 * most:.0f} % of the time; "
            f"predictions there are extrapolations, by these shares of the range: {each}"
        )
    return out


def leaves(known: Sequence[Range], problem: Problem, j: int) -> bool:
    """Whether joint j leaves its identified range in any quantity."""
    own = [r for r in known if r.joint == problem.joints[j]]
    return any(_beyond(problem, j, what, r)[0] > WORTH for r in own for what in QUANTITIES)


def _beyond(problem: Problem, j: int, what: str, known: Range) -> tuple[float, float]:
    """Share of the time for which joint j is outside its range, and how far, in its width."""
    x, (low, high) = _values(problem, j, what), range_limits(known, what)
    share = float(np.mean((x < low) | (x > high)))
    low, high = getattr(known, what)
    return share, float(max(low - x.min(), x.max() - high, 0.0)) / max(high - low, 1e-12)


def _part(problem: Problem, j: int, what: str, known: Range) -> str:
    """How often and how far joint j leaves its range."""
    x, (low, high) = _values(problem, j, what), getattr(known, what)
    share = _beyond(problem, j, what, known)[0]
    return (
        f"{problem.joints[j]} for {100 * share:.0f} % of the time ({x.min():.3g} to {x.max():.3g}, "
        f"identified {low:.3g} to {high:.3g} {_unit(problem, j, what)})"
    )


def _unit(problem: Problem, j: int, what: str) -> str:
    unit = problem.robot.units[j]
    return {"position": unit, "speed": f"{unit}/s", "load": "N" if unit == "m" else "N m"}[what]
