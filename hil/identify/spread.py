"""Standard errors of coefficients and shape values, jointly.

At the optimum the model is linear in both:  d y = X d theta + J d s.  The sandwich covariance
over blocks of time is taken of [X, J], so a shape that is uncertain widens the coefficients
that trade off with it, and coloured residuals count as what they are.  A coefficient b
that its bound holds does not trade off:  var(s | b) = V_ss - V_sb V_bb^-1 V_bs.

Source: Golub and Pereyra, Inverse Problems 19, 2003 (separable least squares); Liang and
Zeger, Biometrika 73, 1986.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.identify.blocks import time_blocks
from hil.identify.bounds import limits
from hil.identify.design import Term
from hil.identify.jacobian import end_of_range, searched, with_shapes
from hil.identify.problem import Problem
from hil.identify.regression import Basis, cluster_covariance

FloatArray = NDArray[np.float64]


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


def spread(
    problem: Problem, terms: Sequence[Term], theta: FloatArray, slices: Sequence[slice],
    b: Basis, residual: FloatArray, sigma: FloatArray,
) -> Spread:  # fmt: skip
    """Errors from the solution (p,), its basis, and the residual (d, n) with its scale (d,)."""
    ends = {k: end_of_range(problem, t) for k, t in enumerate(terms) if searched(problem, t)}
    free = [k for k, end in ends.items() if not end]
    b = with_shapes(problem, terms, theta, slices, b, sigma, free)
    blocks = np.tile(time_blocks(problem), problem.d)
    weighted = (residual / sigma[:, None]).reshape(-1)
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
