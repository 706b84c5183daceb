"""Coefficients of bound terms: weighted least squares within the parameters' bounds."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError
from hil.identify.bounds import bounded, limits
from hil.identify.design import Term, coefficients, known_values, stack
from hil.identify.factors import factored
from hil.identify.problem import Problem
from hil.identify.regression import Basis
from hil.models.effect import Trait
from hil.models.model import RobotModel

FloatArray = NDArray[np.float64]


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
    target = (y - held) * w
    b = factored(problem, terms, sigma, noise_to_signal(target), free)
    known = (x @ (start * free)) * w
    theta = b.solve(target, start * free, known) + np.where(free, 0.0, start)
    theta = bounded(theta, b, *limits(terms, problem))
    residual = (y - x @ theta).reshape(problem.d, problem.n)
    return theta, x, b, slices, residual


def noise_to_signal(target: FloatArray) -> float:
    """What a column-scaled direction must move a weighted target by, to be determined by it."""
    return 1.0 / max(float(np.linalg.norm(target)), 1.0)


def _free(terms: list[Term], problem: Problem) -> FloatArray:
    return np.concatenate(
        [np.full(len(coefficients(t, problem)), 0.0 if t.fixed else 1.0) for t in terms]
    )


def prior(problem: Problem, terms: list[Term], model: RobotModel, names: list[str]) -> FloatArray:
    """Where undetermined directions stay: the model's values, the robot's, else zero."""
    values = np.nan_to_num(known_values(model, names))
    for t, where in zip(terms, slices_of(problem, terms), strict=True):
        if Trait.BODY in t.effect.traits and not values[where].any():
            values[where] = problem.robot.prior
    return values


def slices_of(problem: Problem, terms: list[Term]) -> list[slice]:
    """Where each term's coefficients lie in theta."""
    widths = [len(coefficients(t, problem)) for t in terms]
    edges = np.concatenate([[0], np.cumsum(widths)]).astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]
