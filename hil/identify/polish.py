"""The last step to the optimum: Gauss-Newton of all coefficients and shape values together.

The search on grids stops where the residual hardly falls any more; where the noise is small
that is still many standard errors away from the optimum.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.identify.context import set_context
from hil.identify.design import Term
from hil.identify.jacobian import around, end_of_range, searched, with_shapes
from hil.identify.problem import Problem
from hil.identify.regression import Basis
from hil.identify.solve import solve
from hil.models.model import RobotModel

FloatArray = NDArray[np.float64]
#: A fall of the weighted residual sum of squares (in noise units) that is worth another step.
WORTH = 0.01
STEPS = 8


def polish(problem: Problem, terms: list[Term], model: RobotModel, sigma: FloatArray) -> list[Term]:
    """Terms with their shapes at the joint optimum, between the neighbours on their grids.

    The sign resolution of Coulomb friction stays: it is the sharpest that fits, not the best.
    """
    ranges = {k: around(problem, t) for k, t in enumerate(terms) if _movable(problem, t)}
    if not ranges:
        return terms
    theta, _, b, slices, residual = solve(problem, terms, model, sigma)
    left, part = _weighted(residual, sigma), 1.0
    for _ in range(STEPS):
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
        ranges = {k: around(problem, terms[k]) for k in ranges}
        if before - left < WORTH:
            break
    return terms


def _movable(problem: Problem, term: Term) -> bool:
    if term.effect.search.at_resolution or not searched(problem, term):
        return False
    return end_of_range(problem, term) == 0


def _stepped(
    terms: list[Term], ranges: dict[int, tuple[float, float]], joint: Basis, r: FloatArray,
    part: float,
) -> list[Term]:  # fmt: skip
    """Terms after a part of one Gauss-Newton step on the weighted residual r (d n,)."""
    size, out = joint.scale.size, list(terms)
    steps = joint.solve(r, np.zeros(size), np.zeros(r.size))[size - len(ranges) :]
    for (k, (low, high)), step in zip(ranges.items(), steps, strict=True):
        first = float(np.clip(terms[k].shape[0] + part * step, low, high))
        out[k] = terms[k].reshaped((first, *terms[k].shape[1:]))
    return out


def _weighted(residual: FloatArray, sigma: FloatArray) -> float:
    return float(np.sum((residual / sigma[:, None]) ** 2))
