"""Fit a model: all coefficients jointly, shapes by variable projection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from hil.errors import DataError, FitError
from hil.identify.design import Term, bind, block, coefficients, known_values, prefix, stack
from hil.identify.problem import Problem
from hil.identify.regression import Basis, basis, cluster_covariance
from hil.identify.result import FitResult
from hil.identify.shapes import search_shapes
from hil.models.model import RobotModel, Use, Value
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]


def fit(problem: Problem, model: RobotModel, sweeps: int = 2) -> FitResult:
    """Fit every free parameter of a model jointly.

    Coefficients are eliminated by weighted least squares; shape values that the model does
    not hold are searched on the effects' grids and refined; effort scales and the
    transmitted load are updated until they settle.

    Parameters
    ----------
    problem : Problem
        The runs.
    model : RobotModel
        Effects; values it holds for shapes are starting points, `fixed` ones stay.
    sweeps : int
        Rounds of shape search.

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
    sigma = np.maximum(np.std(problem.y, axis=1), 1e-12)
    terms = [replace(t, shape=t.shape or _start(t, problem)) for t in terms]
    _find_surface(problem, terms, sigma)
    idle: set[tuple[str, int]] = set()
    for sweep in range(sweeps + 1):
        terms = search_shapes(problem, terms, sigma, idle)
        _set_context(problem, terms)
        sigma, now = _scales(problem, terms, model, sigma)
        if now == idle and sweep >= sweeps - 1:
            break
        idle = now
    return assemble(problem, model, terms, sigma)


def _start(term: Term, problem: Problem) -> tuple[float, ...]:
    grid = term.effect.grid(problem.motions[0], term.joint)
    if not grid:
        reason = term.effect.available(problem.motions[0], term.joint) or "no shape to try"
        raise FitError(_impossible(term, problem, reason))
    return grid[0]


def _impossible(term: Term, problem: Problem, reason: str) -> str:
    joint = problem.joints[term.joint]
    return f"effect {term.effect.name!r} cannot be fitted to {joint}: {reason}"


def _find_surface(problem: Problem, terms: list[Term], sigma: FloatArray) -> None:
    """Set the surface that contact laws refer to before any of them is evaluated."""
    motion = problem.motions[0]
    ready = [t for t in terms if not t.effect.available(motion, t.joint)]
    if len(ready) < len(terms):
        _set_context(problem, search_shapes(problem, ready, sigma))
    for t in terms:
        reason = t.effect.available(problem.motions[0], t.joint)
        if reason and not np.all(np.isfinite(block(problem, t))):
            raise FitError(_impossible(t, problem, reason))


def _set_context(problem: Problem, terms: Sequence[Term]) -> None:
    """Tell the effects the sign resolution and the surface that the fit has found."""
    v0 = problem.motions[0].resolution.copy()
    contact = problem.motions[0].contact.copy()
    for t in terms:
        if t.effect.name == "coulomb":
            v0[t.joint] = t.shape[0]
        if t.effect.name == "contact-stiffness":
            contact[t.joint] = t.shape
    old = problem.motions[0]
    same = np.array_equal(contact, old.contact, equal_nan=True)
    if not same or not np.array_equal(v0, old.v0):
        problem.set_context(v0=v0, contact=contact)


def solve(
    problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray
) -> tuple[FloatArray, FloatArray, Basis, list[slice], FloatArray]:
    """Weighted least squares of bound terms: theta, X, basis, slices, residual (d, n)."""
    x, slices = stack(problem, terms)
    names = [n for t in terms for n, _ in coefficients(t, problem)]
    start = prior(problem, terms, model, names)
    w = np.repeat(1.0 / sigma, problem.n)
    y = problem.y.reshape(-1)
    if not np.all(np.isfinite(x)):
        raise DataError("a column of the model is not finite; check the recording (hil info)")
    free = _free(terms, problem)
    held = x @ np.where(free, 0.0, start)
    xw = x * w[:, None] * free
    target = (y - held) * w
    b = basis(xw, 1.0 / max(float(np.linalg.norm(target)), 1.0))
    theta = b.solve(target, start * free, xw @ (start * free)) + np.where(free, 0.0, start)
    theta = _bounded(terms, problem, theta, b, free)
    residual = (y - x @ theta).reshape(problem.d, problem.n)
    return theta, x, b, slices, residual


def _free(terms: list[Term], problem: Problem) -> FloatArray:
    return np.concatenate(
        [np.full(len(coefficients(t, problem)), 0.0 if t.fixed else 1.0) for t in terms]
    )


def prior(problem: Problem, terms: list[Term], model: RobotModel, names: list[str]) -> FloatArray:
    """Where undetermined directions stay: the model's values, the robot's, else zero."""
    values = np.nan_to_num(known_values(model, names))
    start = 0
    for t in terms:
        width = len(coefficients(t, problem))
        if t.effect.name == "rigid-body" and not values[start : start + width].any():
            values[start : start + width] = problem.robot.prior
        start += width
    return values


def _bounded(
    terms: list[Term], problem: Problem, theta: FloatArray, b: Basis, free: FloatArray
) -> FloatArray:
    """Best coefficients within their bounds; those that are not determined are left alone.

    In the coordinates of the basis the weighted residual grows by |S V' d|^2 when the scaled
    coefficients move by d away from the unbounded solution.
    """
    params = [p for t in terms for _, p in coefficients(t, problem)]
    judged = b.identifiable() & (free > 0)
    low = np.where(judged, [p.lower for p in params], -np.inf)
    high = np.where(judged, [p.upper for p in params], np.inf)
    if np.all((theta >= low) & (theta <= high)):
        return theta
    bounds = ((low - theta) * b.scale, (high - theta) * b.scale)
    found = scipy.optimize.lsq_linear(
        b.s[:, None] * b.v.T, np.zeros(b.rank), bounds, method="bvls", tol=1e-14
    )
    out = np.where(found.active_mask < 0, low, np.where(found.active_mask > 0, high, theta))
    moved = found.active_mask == 0
    out[moved] += (found.x / b.scale)[moved]
    clipped: FloatArray = np.clip(out, low, high)
    return clipped


def _scales(
    problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray
) -> tuple[FloatArray, set[tuple[str, int]]]:
    """Residual scale by joint, the load, and the terms that their bounds keep at zero."""
    for _ in range(2):
        theta, _, _, slices, residual = solve(problem, terms, model, sigma)
        floor = 1e-6 * np.std(problem.y, axis=1) + 1e-15
        sigma = np.maximum(problem.rms(residual), floor)
    update_load(problem, terms, theta, slices)
    parts = zip(terms, slices, strict=True)
    return sigma, {t.key for t, s in parts if not t.effect.shape and not np.any(theta[s])}


def update_load(
    problem: Problem, terms: list[Term], theta: FloatArray, slices: list[slice]
) -> None:
    """Transmitted load = rigid-body effort minus external effort; its static part at rest."""
    mass = [
        (t, theta[where])
        for t, where in zip(terms, slices, strict=True)
        if t.effect.family == "mass" and not t.per_run
    ]
    loads, still = [], []
    for m in problem.motions:
        at_rest = m.with_(qd=np.zeros_like(m.qd), qdd=np.zeros_like(m.qdd))
        loads.append(_carried(m, mass) - m.tau_ext)
        still.append(_carried(at_rest, mass))
    problem.set_context(load=np.concatenate(loads), static=np.concatenate(still))


def _carried(motion: Motion, mass: list[tuple[Term, FloatArray]]) -> FloatArray:
    """Rigid-body effort (n, d) along a motion."""
    out = np.zeros_like(motion.q)
    for t, theta in mass:
        effort = t.effect.columns(motion, t.joint, t.shape) @ theta
        if t.effect.whole_robot:
            out += effort
        else:
            out[:, t.joint] += effort
    return out


def time_blocks(problem: Problem, seconds: float = 1.0) -> NDArray[np.int_]:
    """Number of the time block of each instant, runs kept apart; shape (n,)."""
    length = max(1, round(seconds * problem.rate))
    out = np.empty(problem.n, dtype=int)
    offset = 0
    for k in range(len(problem.recordings)):
        where = np.flatnonzero(problem.run == k)
        out[where] = offset + np.arange(where.size) // length
        offset = int(out[where[-1]]) + 1
    return out


def assemble(
    problem: Problem, model: RobotModel, terms: list[Term], sigma: FloatArray
) -> FitResult:
    """Final solution with errors, bounds and identifiability."""
    theta, x, b, slices, residual = solve(problem, terms, model, sigma)
    w = np.repeat(1.0 / sigma, problem.n)
    blocks = np.tile(time_blocks(problem), problem.d)
    cov = cluster_covariance(x * w[:, None], residual.reshape(-1) * w, b, blocks)
    stderr = np.sqrt(np.diag(cov))
    known = b.identifiable()
    values: dict[str, Value] = {}
    uses: dict[int, dict[str, Value]] = {}
    source = "fit of " + ", ".join(r.name for r in problem.recordings)
    for t, where in zip(terms, slices, strict=True):
        part = _values(problem, t, theta[where], stderr[where], known[where], source)
        values |= part
        uses.setdefault(t.use, {}).update(part)
    effects = tuple(
        Use(u.type, u.joints, u.options, uses.get(k, {})) for k, u in enumerate(model.effects)
    )
    names = [n for t in terms for n, _ in coefficients(t, problem)]
    return FitResult(
        replace(model, effects=effects), problem, terms, theta, names, values,
        residual, sigma, b, prior(problem, terms, model, names), x, slices,
    )  # fmt: skip


def _values(
    problem: Problem, term: Term, theta: FloatArray, stderr: FloatArray,
    known: NDArray[np.bool_], source: str,
) -> dict[str, Value]:  # fmt: skip
    force, length = _units(problem, term)
    out: dict[str, Value] = {}
    named = coefficients(term, problem)
    for (name, p), value, err, ok in zip(named, theta, stderr, known, strict=True):
        at_bound = bool(ok and (value <= p.lower or value >= p.upper))
        unit = p.unit.replace("{F}", force).replace("{x}", length)
        error = float(err) if ok and not term.fixed else float("nan")
        out[name] = Value(
            float(value), error, unit, p.lower, p.upper, at_bound,
            bool(ok) or term.fixed, "given" if term.fixed else source,
        )  # fmt: skip
    head = prefix(term, problem.joints)
    for p, value in zip(term.effect.shape, term.shape, strict=True):
        unit = p.unit.replace("{F}", force).replace("{x}", length)
        out[f"{head}.{p.name}"] = Value(
            float(value), float("nan"), unit, p.lower, p.upper, False, True, source
        )
    return out


def _units(problem: Problem, term: Term) -> tuple[str, str]:
    linear = problem.robot.units[term.joint] == "m"
    return ("N", "m") if linear else ("N m", "rad")


def predict(result: FitResult, problem: Problem) -> FloatArray:
    """Residual (d, n) of a fitted model on another problem (held-out runs).

    The other problem must have been made with the same rates and span.  Coefficients of a
    single run (per-run offsets) are estimated on the new runs, for they belong to a run.
    """
    source = result.problem.motions[0]
    problem.set_context(v0=source.v0, contact=source.contact)
    flat = [t for t in result.terms if not t.per_run]
    keep = {t.key for t in flat}
    theta = np.concatenate(
        [result.theta[s] for t, s in zip(result.terms, result.slices, strict=True) if t.key in keep]
        or [np.empty(0)]
    )
    _, slices = _slices(problem, flat)
    update_load(problem, flat, theta, slices)
    x, _ = stack(problem, flat)
    residual: FloatArray
    residual = (problem.y.reshape(-1) - x @ theta).reshape(problem.d, problem.n)
    for t in result.terms:
        if t.per_run:
            columns = block(problem, t)
            part = np.linalg.lstsq(columns, residual[t.joint], rcond=None)[0]
            residual[t.joint] = residual[t.joint] - columns @ part
    return residual


def _slices(problem: Problem, terms: list[Term]) -> tuple[int, list[slice]]:
    widths = [len(coefficients(t, problem)) for t in terms]
    edges = np.concatenate([[0], np.cumsum(widths)]).astype(int)
    return int(edges[-1]), [slice(int(a), int(b)) for a, b in pairwise(edges)]
