"""Errors of a fit on blocks of time left out in turn, with and without further columns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.identify.blocks import time_blocks
from hil.identify.regression import basis
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
FOLDS, SECONDS, STRENGTHS = 5, 0.5, (1e-4, 1e-3, 1e-2, 1e-1)


class Folds:
    """A model's own columns and residual, every fifth block of time left out in turn."""

    def __init__(self, result: FitResult) -> None:
        self.result, problem = result, result.problem
        q = _free(result).reshape(problem.d, problem.n, -1)
        y = result.residual / result.sigma[:, None]
        fold = time_blocks(problem, SECONDS) % FOLDS
        #: Columns (d, n_k, r) and residual (d, n_k) of each fold.
        self.parts = [(q[:, fold == k], y[:, fold == k]) for k in range(FOLDS)]
        self.fold = fold
        self.grams = [np.tensordot(a, a, axes=((0, 1), (0, 1))) for a, _ in self.parts]
        self.rights = [np.tensordot(a, b, axes=((0, 1), (0, 1))) for a, b in self.parts]

    def left_out(self, more: FloatArray, j: int) -> float:
        """Rms error of joint j on the folds left out; best of four ridges on `more` (n, m).

        The model's own parameters are fitted again each time, on all joints together; those on a
        bound stay there.
        """
        result = self.result
        norm = np.linalg.norm(more, axis=0)
        some = norm > 1e-12 * max(float(norm.max(initial=0.0)), 1e-300)
        more = more[:, some] / norm[some]
        own = [np.hstack([a[j], more[self.fold == k]]) for k, (a, _) in enumerate(self.parts)]
        aims = [b[j] for _, b in self.parts]
        grams, rights = self._products(own, aims)
        gram, right, r = np.sum(grams, axis=0), np.sum(rights, axis=0), self.grams[0].shape[0]
        errors = []
        for strength in STRENGTHS if more.shape[1] else STRENGTHS[:1]:
            ridge = np.diag(np.where(np.arange(len(right)) >= r, strength, 1e-10))
            total = 0.0
            for k, (a, b) in enumerate(zip(own, aims, strict=True)):
                theta = np.linalg.solve(gram - grams[k] + ridge, right - rights[k])
                total += float(np.sum((b - a @ theta) ** 2))
            errors.append(total)
        return float(result.sigma[j] * np.sqrt(min(errors) / max(result.problem.count[j], 1.0)))

    def _products(
        self, own: list[FloatArray], aims: list[FloatArray]
    ) -> tuple[list[FloatArray], list[FloatArray]]:
        """X'X and X'y of each fold; the added columns act on one joint's rows alone."""
        grams, rights, r = [], [], self.grams[0].shape[0]
        for a, b, gram, right in zip(own, aims, self.grams, self.rights, strict=True):
            wide = np.empty((a.shape[1], a.shape[1]))
            wide[:, r:] = a.T @ a[:, r:]
            wide[r:, :r] = wide[:r, r:].T
            wide[:r, :r] = gram
            grams.append(wide)
            rights.append(np.concatenate([right, a[:, r:].T @ b]))
        return grams, rights


def _free(result: FitResult) -> FloatArray:
    """Orthonormal weighted columns (d n, r) of the parameters that are not on a bound."""
    free = np.array([not (n in result.values and result.values[n].at_bound) for n in result.names])
    if free.all():
        return result.basis.q
    w = np.repeat(1.0 / result.sigma, result.problem.n)
    return basis(result.x[:, free] * w[:, None]).q
