"""The arm itself: geometry of the parallelogram and accelerations of its links.

th1 turntable, th2 upper link from the horizontal, th3 forearm from the base (0 = hanging).
Form of Cavusoglu, Feygin & Tendick, IEEE Trans. Robot. Autom. 18(6) 2002, with the sign of
C32 that conserves energy.
"""

from __future__ import annotations

from math import cos, sin
from typing import Any

import numba as nb


@nb.njit(cache=True, nogil=True, error_model="numpy")
def angles(x: Any) -> Any:
    """Sines and cosines of the joints: s1, c1, s2, c2, s3, c3."""
    return sin(x.q[0]), cos(x.q[0]), sin(x.q[1]), cos(x.q[1]), sin(x.q[2]), cos(x.q[2])


@nb.njit(cache=True, nogil=True, error_model="numpy")
def tip(p: Any, x: Any) -> None:
    """Tip position and velocity of the link side into `x.tip`, `x.tip_v`."""
    tip_at(p, x, angles(x))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def tip_at(p: Any, x: Any, trig: Any) -> None:
    """`tip` with the `angles` of now."""
    s1, c1, s2, c2, s3, c3 = trig
    # r = l1 cos th2 + l2 sin th3;  z = l1 sin th2 - l2 cos th3
    r = p.l1 * c2 + p.l2 * s3
    dr = -p.l1 * s2 * x.v[1] + p.l2 * c3 * x.v[2]
    x.tip[0] = r * c1
    x.tip[1] = r * s1
    x.tip[2] = p.l1 * s2 - p.l2 * c3
    x.tip_v[0] = dr * c1 - r * s1 * x.v[0]
    x.tip_v[1] = dr * s1 + r * c1 * x.v[0]
    x.tip_v[2] = p.l1 * c2 * x.v[1] + p.l2 * s3 * x.v[2]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def push_links(p: Any, x: Any, torque: Any, dt: float) -> None:
    """Advance the link velocities by `dt` under joint `torque` (3,) and `x.force` at the tip."""
    push_at(p, x, torque, dt, angles(x))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def push_at(p: Any, x: Any, torque: Any, dt: float, trig: Any) -> None:
    """`push_links` with the `angles` of now."""
    s1, c1, s2, c2, s3, c3 = trig
    s23, c23 = sin(x.q[1] - x.q[2]), cos(x.q[1] - x.q[2])
    v1, v2, v3 = x.v[0], x.v[1], x.v[2]
    # M11 = a + b cos 2th2 + c cos 2th3 + d cos th2 sin th3
    cc2, cc3 = c2 * c2 - s2 * s2, c3 * c3 - s3 * s3
    m11 = p.m11[0] + p.m11[1] * cc2 + p.m11[2] * cc3 + p.m11[3] * c2 * s3
    # dM11/dth2 = -2 e2, dM11/dth3 = -2 e3
    e2 = 2.0 * p.m11[1] * s2 * c2 + 0.5 * p.m11[3] * s2 * s3
    e3 = 2.0 * p.m11[2] * s3 * c3 - 0.5 * p.m11[3] * c2 * c3
    # tip force: J^T f in the (turn, radial, vertical) frame
    r = p.l1 * c2 + p.l2 * s3
    radial = c1 * x.force[0] + s1 * x.force[1]
    across = -s1 * x.force[0] + c1 * x.force[1]
    f2 = -p.l1 * s2 * radial + p.l1 * c2 * x.force[2]
    f3 = p.l2 * c3 * radial + p.l2 * s3 * x.force[2]
    # M v' = torque + J^T f - C v - N
    b1 = torque[0] + r * across + 2.0 * (e2 * v2 + e3 * v3) * v1
    b2 = torque[1] + f2 - e2 * v1 * v1 - p.m23 * c23 * v3 * v3 - p.g2 * c2
    b3 = torque[2] + f3 - e3 * v1 * v1 + p.m23 * c23 * v2 * v2 - p.g3 * s3
    m23 = -p.m23 * s23
    det = p.m22 * p.m33 - m23 * m23
    x.v[0] += dt * b1 / m11
    x.v[1] += dt * (p.m33 * b2 - m23 * b3) / det
    x.v[2] += dt * (p.m22 * b3 - m23 * b2) / det
