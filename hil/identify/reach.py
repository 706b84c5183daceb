"""Which error no fit of the base model can go below, whatever its shapes and bounds.

The columns of the base model are those of the motion.  With all of them, in all shapes that a fit
tries, as free columns X_j of each joint's rows, and efforts y_j of rms size s_j,

    min over theta of  sum_j |y_j - X_j theta|^2 / (N_j s_j^2)

is no more than what any fit leaves.  X_j = Q_j R_j is made once for any number of efforts that the
same motion may have had.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.identify.factors import factors
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.model import BASE_EFFECTS

FloatArray = NDArray[np.float64]


class Reach:
    """Least errors of the base model over the motion of a fit.

    Parameters
    ----------
    result : FitResult
        The fit; of one with other terms than the base model's nothing is known.
    """

    def __init__(self, result: FitResult) -> None:
        self._known = all(t.effect.name in BASE_EFFECTS for t in result.terms)
        if self._known:
            problem = result.problem
            grids = ((t, problem.grid(t.effect, t.joint) or [t.shape]) for t in result.terms)
            terms = [replace(t, shape=s) for t, grid in grids for s in grid]
            with problem.aside():
                self._q, self._r = factors(problem, terms, np.ones(problem.d))

    def least(self, problem: Problem) -> float:
        """Least relative error over all joints [%] for the efforts of another problem.

        Parameters
        ----------
        problem : Problem
            Of the same motion.

        Returns
        -------
        float
            Root mean square over the joints; 0 where nothing is known.
        """
        if not self._known or any(len(q) != problem.n for q in self._q):
            return 0.0
        size = np.sqrt(np.sum(problem.effort**2, axis=1))
        weight = 100.0 / np.maximum(size, 1e-300)
        parts = zip(self._q, self._r, problem.y, weight, strict=True)
        each = [(w * (q.T @ y), w * r, w * w * float(y @ y)) for q, r, y, w in parts]
        right = np.concatenate([c for c, _, _ in each])
        rows = np.concatenate([r for _, r, _ in each])
        theta = np.linalg.lstsq(rows, right, rcond=None)[0]
        # what no column of its joint reaches, and what not all joints reach at once
        beyond = sum(whole - float(c @ c) for c, _, whole in each)
        rest = float(np.sum((right - rows @ theta) ** 2))
        return float(np.sqrt(max(beyond + rest, 0.0) / problem.d))
