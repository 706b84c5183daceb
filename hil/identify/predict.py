"""A fitted model on runs that it has not seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.identify.context import update_load
from hil.identify.design import Term, stack
from hil.identify.problem import Problem
from hil.identify.regression import least_squares
from hil.identify.result import FitResult
from hil.identify.solve import slices_of

FloatArray = NDArray[np.float64]


def predict(result: FitResult, problem: Problem) -> FloatArray:
    """Residual (d, n) of a fitted model on another problem (held-out runs).

    The other problem must have been made with the same rates and span.  Coefficients of a
    single run (per-run offsets, a hum's phase) are estimated on the new runs, for they belong to
    a run.
    """
    source = result.problem.motions[0]
    problem.set_context(v0=source.v0, contact=source.contact)
    flat = [t for t in result.terms if not _own(t)]
    keep = {t.key for t in flat}
    theta = np.concatenate(
        [result.theta[s] for t, s in zip(result.terms, result.slices, strict=True) if t.key in keep]
        or [np.empty(0)]
    )
    update_load(problem, flat, theta, slices_of(problem, flat))
    x, _ = stack(problem, flat)
    residual: FloatArray
    residual = (problem.y.reshape(-1) - x @ theta).reshape(problem.d, problem.n)
    for t in result.terms:
        if _own(t):
            residual = _without(residual, t, problem, result.sigma)
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
            joints = [] if t.effect.scope.of_robot else [t.joint]
            known = out.setdefault(t.effect.name, (size, []))
            known[1].extend(joints)
    return out


def _own(t: Term) -> bool:
    """Whether every run has its own coefficients."""
    return t.per_run or t.effect.variation.own(t.shape)


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
