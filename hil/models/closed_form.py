"""Rigid bodies of the PHANTOM arms, compiled: one state, and what is made of many.

One row is the only place where their equations stand; the regressor and the balance of a
simulation are loops over it.  Sources as of `hil.models.phantom`.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@numba.njit(cache=True, nogil=True)
def _row(omni: bool, q: FloatArray, v: FloatArray, a: FloatArray, y: FloatArray) -> None:
    """Regressor (3, p) of one state; what is zero for any motion is left as it is.

    M11 = pi1 + pi2 cos 2th2 + pi3 cos 2th3 + pi4 cos th2 sin th3,  M23 = -(pi4 / 2) sin(th2 - th3)
    and the Coriolis terms that follow from them; Premium and Omni share these four parameters.
    """
    s2, c2, s3, c3 = np.sin(q[1]), np.cos(q[1]), np.sin(q[2]), np.cos(q[2])
    s22, c22, s23, c23 = 2 * s2 * c2, c2 * c2 - s2 * s2, 2 * s3 * c3, c3 * c3 - s3 * s3
    sd, cd = s2 * c3 - c2 * s3, c2 * c3 + s2 * s3
    y[0, 0] = a[0]
    y[0, 1] = a[0] * c22 - 2 * v[0] * v[1] * s22
    y[0, 2] = a[0] * c23 - 2 * v[0] * v[2] * s23
    y[0, 3] = a[0] * c2 * s3 - v[0] * v[1] * s2 * s3 + v[0] * v[2] * c2 * c3
    y[1, 1] = v[0] ** 2 * s22
    y[2, 2] = v[0] ** 2 * s23
    y[1, 3] = (v[0] ** 2 * s2 * s3 + v[2] ** 2 * cd - a[2] * sd) / 2
    y[2, 3] = (-(v[0] ** 2) * c2 * c3 - v[1] ** 2 * cd - a[1] * sd) / 2
    if omni:
        # M12 = k5 sin th2,  N2 = k8 cos th2 + k10 (th2 - pi/2),  N3 = k9 sin th3
        y[0, 4], y[1, 4] = s2 * a[1] + c2 * v[1] ** 2, s2 * a[0]
        y[1, 5], y[2, 6] = a[1], a[2]
        y[1, 7], y[2, 8], y[1, 9] = c2, s3, q[1] - np.pi / 2
    else:
        # N = [0, pi7 cos th2, pi8 sin th3]
        y[1, 4], y[2, 5] = a[1], a[2]
        y[1, 6], y[2, 7] = c2, s3


@numba.njit(cache=True, nogil=True)
def regressor(
    omni: bool, q: FloatArray, qd: FloatArray, qdd: FloatArray, p: int
) -> FloatArray:  # fmt: skip
    """Regressor (n, 3, p) at states (n, 3)."""
    out = np.zeros((len(q), 3, p))
    for k in range(len(q)):
        _row(omni, q[k], qd[k], qdd[k], out[k])
    return out


@numba.njit(cache=True, nogil=True)
def balance(
    omni: bool, q: FloatArray, qd: FloatArray, pi: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Effort (n, 3) without acceleration and mass matrix (n, 3, 3) of parameters pi (n, p).

    h = Y(q, qd, 0) pi,  M e_j = Y(q, 0, e_j) pi - Y(q, 0, 0) pi
    """
    n, p = pi.shape
    rest, mass = np.zeros((n, 3)), np.zeros((n, 3, 3))
    still, unit, y = np.zeros(3), np.zeros(3), np.zeros((3, p))
    hold = np.zeros(3)
    for k in range(n):
        _row(omni, q[k], qd[k], still, y)
        _times(y, pi[k], rest[k])
        _row(omni, q[k], still, still, y)
        _times(y, pi[k], hold)
        for j in range(3):
            unit[j] = 1.0
            _row(omni, q[k], still, unit, y)
            unit[j] = 0.0
            for i in range(3):
                for c in range(p):
                    mass[k, i, j] += y[i, c] * pi[k, c]
                mass[k, i, j] -= hold[i]
    return rest, mass


@numba.njit(cache=True, nogil=True)
def _times(y: FloatArray, pi: FloatArray, out: FloatArray) -> None:
    """Y pi, to out (3,)."""
    for i in range(3):
        out[i] = 0.0
        for c in range(pi.size):
            out[i] += y[i, c] * pi[c]
