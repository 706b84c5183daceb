"""Fit a model: all coefficients jointly, shapes by variable projection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.errors import FitError
from hil.identify.assemble import assemble
from hil.identify.blocks import time_blocks
from hil.identify.context import find_surface, impossible, set_context, update_load
from hil.identify.design import Term, bind, coefficients
from hil.identify.polish import polish
from hil.identify.predict import predict
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.identify.shapes import search_shapes
from hil.identify.solve import solve
from hil.models.model import RobotModel

__all__ = ["fit", "predict", "solve", "time_blocks"]
FloatArray = NDArray[np.float64]
#: Relative change of the residual scales that asks for another round of the shape search.
NEAR = 0.1


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
    terms = [replace(t, shape=t.shape or _start(t, problem)) for t in terms]
    find_surface(problem, terms, sigma)
    idle: set[tuple[str, int]] = set()
    for sweep in range(sweeps + 1):
        before = sigma
        terms = search_shapes(problem, terms, sigma, idle)
        set_context(problem, terms)
        sigma, now = _scales(problem, terms, model, sigma)
        near = scale is not None and np.max(np.abs(np.log(sigma / before))) < NEAR
        if now == idle and (near or sweep >= sweeps - 1):
            break
        idle = now
    terms = polish(problem, terms, model, sigma)
    return assemble(problem, model, terms, sigma)


def _start(term: Term, problem: Problem) -> tuple[float, ...]:
    grid = problem.grid(term.effect, term.joint)
    if not grid:
        reason = term.effect.scope.lacks(problem.motions[0], term.joint) or "no shape to try"
        raise impossible(term, problem, reason)
    return grid[0]


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
