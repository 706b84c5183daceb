"""Joint torque regressor of a tree of bodies, for many states at once.

With spatial velocity v and acceleration a of body i in its joint's frame (gravity as an
acceleration of the base), the force on it is linear in its mass, first and second moments,

    f = m (a + w x v) + (alpha x + w x w x) mc,      n = mc x (a + w x v) + I alpha + w x I w,

and joint k of the chain below feels J_k' [f; n], J_k being its axis seen from body i.

Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 5; Atkeson, An, Hollerbach,
Int. J. Robotics Research 5(3), 1986 (linearity in the ten parameters).
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@numba.njit(cache=True)
def _cross(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True)
def _rotation(axis: FloatArray, angle: float, out: FloatArray) -> None:
    """Rodrigues' formula."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis
    u = 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = c + u * x * x, u * x * y - s * z, u * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = u * x * y + s * z, c + u * y * y, u * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = u * x * z - s * y, u * y * z + s * x, c + u * z * z


@numba.njit(cache=True)
def _into(r: FloatArray, p: FloatArray, old: FloatArray, new: FloatArray) -> None:
    """Motion vector [linear, angular] of the parent's frame, seen from (R, p) within it."""
    x = old[0] + old[4] * p[2] - old[5] * p[1]
    y = old[1] + old[5] * p[0] - old[3] * p[2]
    z = old[2] + old[3] * p[1] - old[4] * p[0]
    for k in range(3):
        new[k] = r[0, k] * x + r[1, k] * y + r[2, k] * z
        new[k + 3] = r[0, k] * old[3] + r[1, k] * old[4] + r[2, k] * old[5]


@numba.njit(cache=True)
def _wrenches(v: FloatArray, a: FloatArray, spare: FloatArray, out: FloatArray) -> None:
    """Force and moment (6, 10) of unit parameters m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""
    w, b = v[3:], a[3:]
    lin, e, t = spare[0], spare[1], spare[2]
    _cross(w, v[:3], lin)
    lin += a[:3]
    ww = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    out[:] = 0.0
    out[:3, 0] = lin
    for k in range(3):
        for i in range(3):
            out[i, 1 + k] = w[i] * w[k]
        out[k, 1 + k] -= ww
    # [alpha x] and -[lin x]
    for k, i, sign in ((0, 1, 1.0), (1, 2, 1.0), (2, 0, 1.0)):
        o = 3 - k - i
        out[i, 1 + k] += sign * b[o]
        out[k, 1 + i] -= sign * b[o]
        out[3 + i, 1 + k] = -sign * lin[o]
        out[3 + k, 1 + i] = sign * lin[o]
    column = 4
    for i in range(3):
        for k in range(i + 1):
            # E = e_i e_k' (+ e_k e_i'): moment E alpha + w x E w
            e[:] = 0.0
            e[i] = w[k]
            if i != k:
                e[k] = w[i]
            _cross(w, e, t)
            t[i] += b[k]
            if i != k:
                t[k] += b[i]
            out[3:, column] = t
            column += 1


@numba.njit(cache=True)
def _pose(
    turn: FloatArray, place: FloatArray, s: FloatArray, q: float, spin: FloatArray, r: FloatArray,
    p: FloatArray,
) -> None:  # fmt: skip
    """Pose (R, p) of a joint's frame within its parent's at position q."""
    _rotation(s[3:], q if s[3:].any() else 0.0, spin)
    for x in range(3):
        p[x] = place[x]
        for y in range(3):
            r[x, y] = 0.0
            for z in range(3):
                r[x, y] += turn[x, z] * spin[z, y]
            p[x] += turn[x, y] * s[y] * q


@numba.njit(cache=True)
def _own(s: FloatArray, qd: float, qdd: float, v: FloatArray, a: FloatArray) -> None:
    """Add the joint's own motion: v += S qd, a += S qdd + v x S qd."""
    for x in range(6):
        v[x] += s[x] * qd
    w, u = v[3:], v[:3]
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        linear = w[y] * s[z] - w[z] * s[y] + u[y] * s[3 + z] - u[z] * s[3 + y]
        turning = w[y] * s[3 + z] - w[z] * s[3 + y]
        a[x] += s[x] * qdd + linear * qd
        a[3 + x] += s[3 + x] * qdd + turning * qd


@numba.njit(cache=True)
def regressor(
    parent: IntArray, turn: FloatArray, place: FloatArray, axis: FloatArray, gravity: FloatArray,
    q: FloatArray, qd: FloatArray, qdd: FloatArray,
) -> FloatArray:  # fmt: skip
    """Regressor (n, d, 10 d) of d bodies, one behind each joint.

    Parameters
    ----------
    parent : ndarray of int (d,)
        Joint before each one, -1 for the base; parents come first.
    turn, place : ndarray (d, 3, 3), (d, 3)
        Pose of each joint's frame within its parent's, at zero.
    axis : ndarray (d, 6)
        Motion [linear, angular] of each joint in its own frame.
    gravity : ndarray (3,)
        In base axes [m/s^2].
    q, qd, qdd : ndarray (n, d)
        States [rad or m and their derivatives].
    """
    n, d = q.shape
    out = np.zeros((n, d, 10 * d))
    v, a, seen = np.zeros((d, 6)), np.zeros((d, 6)), np.zeros((d, d, 6))
    base, spin, r, p = np.zeros(6), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    forces, still, spare = np.empty((6, 10)), np.zeros(6), np.empty((3, 3))
    base[:3] = -gravity
    for k in range(n):
        for i in range(d):
            before = parent[i]
            _pose(turn[i], place[i], axis[i], q[k, i], spin, r, p)
            _into(r, p, v[before] if before >= 0 else still, v[i])
            _into(r, p, a[before] if before >= 0 else base, a[i])
            _own(axis[i], qd[k, i], qdd[k, i], v[i], a[i])
            _wrenches(v[i], a[i], spare, forces)
            above = before
            while above >= 0:
                _into(r, p, seen[before, above], seen[i, above])
                above = parent[above]
            seen[i, i] = axis[i]
            above = i
            while above >= 0:
                for c in range(10):
                    total = 0.0
                    for x in range(6):
                        total += seen[i, above, x] * forces[x, c]
                    out[k, above, 10 * i + c] = total
                above = parent[above]
    return out
