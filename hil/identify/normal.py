"""Least squares of all rows but some, from products of the columns that are made once.

X'X and X'y of the other rows are those of all rows less those of the left-out ones.  Products
square the condition number, so directions whose singular value lies below the square root of
rounding cannot be told from nothing: `ENOUGH` is where the rows themselves are needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.identify.regression import Basis, unit_scale

FloatArray = NDArray[np.float64]
#: Noise to signal from which on products decide as the rows do: a thousand times sqrt(rounding).
ENOUGH = 1e-5


@dataclass(frozen=True)
class Normal:
    """Products of weighted columns X (N, p) with themselves and with a target y (N,).

    Parameters
    ----------
    gram : ndarray (p, p)
        X'X.
    right : ndarray (p,)
        X'y.
    """

    gram: FloatArray
    right: FloatArray

    @classmethod
    def of(cls, x: FloatArray, y: FloatArray, sigma: FloatArray) -> Normal:
        """Products of columns (d, n, p) and target (d, n), each joint in units of sigma (d,)."""
        w = 1.0 / sigma**2
        parts = [(c.T @ c * s, c.T @ r * s) for c, r, s in zip(x, y, w, strict=True)]
        return cls(np.sum([a for a, _ in parts], axis=0), np.sum([b for _, b in parts], axis=0))

    def __sub__(self, other: Normal) -> Normal:
        return Normal(self.gram - other.gram, self.right - other.right)

    def solved(self, least: float) -> tuple[FloatArray, Basis]:
        """Shortest theta (p,) that minimises |y - X theta|, and the basis but for its q.

        `least`: noise to signal, as in `basis`.
        """
        # D^-1 X'X D^-1 = V S^2 V'
        scale, live = unit_scale(np.sqrt(np.maximum(np.diag(self.gram), 0.0)))
        value, vector = np.linalg.eigh(self.gram * np.outer(live / scale, live / scale))
        s = np.sqrt(np.maximum(value[::-1], 0.0))
        keep = int(np.sum(s > max(1e-9, least) * (s[0] if s.size else 1.0)))
        b = Basis(np.zeros((0, keep)), s[:keep], vector[:, ::-1][:, :keep], scale)
        theta = b.v @ (b.v.T @ (self.right * live / scale) / b.s**2) / scale
        return theta, b
