"""Least squares within bounds, on a problem that is already reduced to p columns.

From the unbounded solution theta_0 the squared residual grows by |R (theta - theta_0)|^2 with
R = S V' D, so the N rows of the regressor are not needed again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from hil.errors import FitError
from hil.identify.design import Term, coefficients
from hil.identify.problem import Problem
from hil.identify.regression import Basis

FloatArray = NDArray[np.float64]
#: Weight of what the data do not determine, in the smallest determined singular value.
WEAK = 1e-3


def limits(terms: Sequence[Term], problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bound of every coefficient (p,); infinite where it is held at its value."""
    free = [p if not t.fixed else None for t in terms for _, p in coefficients(t, problem)]
    low = [-np.inf if p is None else p.lower for p in free]
    high = [np.inf if p is None else p.upper for p in free]
    return np.array(low, dtype=np.float64), np.array(high, dtype=np.float64)


def bounded(theta: FloatArray, b: Basis, low: FloatArray, high: FloatArray) -> FloatArray:
    """Coefficients within their bounds that leave the smallest residual.

    Directions that the data determine decide first; among what they leave open the solution
    stays as close as it can to `theta` (which lies at the prior there).

    Parameters
    ----------
    theta : ndarray (p,)
        Unbounded solution, `b.solve(...)`.
    b : Basis
        Basis of the weighted regressor (N, p) that theta was solved with.
    low, high : ndarray (p,)
        Bounds; infinite where there is none.

    Returns
    -------
    ndarray (p,)
        `theta` itself where it keeps its bounds.
    """
    if np.all((theta >= low) & (theta <= high)):
        return theta
    tied = np.isfinite(low) | np.isfinite(high)
    order = np.concatenate([np.flatnonzero(~tied), np.flatnonzero(tied)])
    first = int(np.sum(~tied))
    # free coefficients first: their part of the triangle can always be brought to zero
    r = np.asarray(np.linalg.qr(_reduced(b)[:, order], mode="r"), dtype=np.float64)
    lowest: FloatArray = ((low - theta) * b.scale)[tied]
    highest: FloatArray = ((high - theta) * b.scale)[tied]
    step, side = _active_set(r[first:, first:], lowest, highest)
    moved = np.zeros_like(theta)
    moved[tied] = step
    moved[~tied] = -scipy.linalg.solve_triangular(r[:first, :first], r[:first, first:] @ step)
    out: FloatArray = theta + moved / b.scale
    out[tied] = np.where(side < 0, low[tied], np.where(side > 0, high[tied], out[tied]))
    return np.clip(out, low, high)


def _reduced(b: Basis) -> FloatArray:
    """[S V'; w N'] (p, p): N spans what the data do not determine, w is small beside S."""
    p = b.v.shape[0]
    complement = np.linalg.qr(b.v, mode="complete")[0][:, b.rank :] if b.rank else np.eye(p)
    weight = WEAK * float(b.s[-1]) if b.rank else 1.0
    out: FloatArray = np.concatenate([b.s[:, None] * b.v.T, weight * complement.T])
    return out


def _active_set(
    r: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, NDArray[np.int_]]:
    """Step within [low, high] that minimises |r step|, and the side (-1, 0, 1) it ends on."""
    found = scipy.optimize.lsq_linear(
        r, np.zeros(len(r)), (low, high), method="bvls", tol=1e-14, max_iter=50 + 10 * len(r)
    )
    if not found.success:
        raise FitError(
            f"bounded least squares of {low.size} coefficients ended with {found.message!r}, "
            "expected a solution; fix the values of some effects (fixed = true)"
        )
    return found.x, found.active_mask
