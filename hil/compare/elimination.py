"""Many small linear systems at once."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def eliminated(a: FloatArray, b: FloatArray) -> FloatArray:
    """Solutions x (n, d) of A x = b, a (n, d, d) and b (n, d); NaN or infinite where singular.

    Gauss' elimination with the largest pivot of a column: for matrices of a few joints the call
    of a general solver costs more than the arithmetic.
    """
    out = np.array(b, dtype=np.float64)
    _eliminate(np.array(a, dtype=np.float64, order="C"), out)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _eliminate(a: FloatArray, x: FloatArray) -> None:
    """Solutions in place of the right sides; the matrices are lost."""
    n, d = x.shape
    for k in range(n):
        m, y = a[k], x[k]
        for i in range(d):
            top = i
            for r in range(i + 1, d):
                if abs(m[r, i]) > abs(m[top, i]):
                    top = r
            if top != i:
                for c in range(i, d):
                    m[i, c], m[top, c] = m[top, c], m[i, c]
                y[i], y[top] = y[top], y[i]
            for r in range(i + 1, d):
                f = m[r, i] / m[i, i]
                for c in range(i + 1, d):
                    m[r, c] -= f * m[i, c]
                y[r] -= f * y[i]
        for i in range(d - 1, -1, -1):
            for c in range(i + 1, d):
                y[i] -= m[i, c] * y[c]
            y[i] /= m[i, i]
