"""Rigid body of a PHANTOM Premium 1.5 and its momentum observer, compiled for the loop.

th1 turntable, th2 upper link from the horizontal, th3 forearm from the base (0 = hanging);
z up, origin on the shoulder axis (Cavusoglu, Feygin & Tendick 2002).

Eight parameters: tau = M(q) q'' + C(q, q') q' + N(q), form of Cavusoglu, Feygin & Tendick 2002 with
the sign of C32 that conserves energy; pi as `hil.models.phantom.Premium` identifies it.  The
observer tells the external torque without an acceleration.
"""

from __future__ import annotations

from collections.abc import Callable
from math import acos, atan2, cos, hypot, pi, sin
from typing import Any

import numba as nb
import numpy as np

#: Smallest |det J| [m^3] that is inverted; below, the arm is treated as this far from singular.
SINGULAR = 1e-4


@nb.njit(cache=True, nogil=True)
def premium_inverse_dynamics(q: Any, v: Any, a: Any, pi: Any, out: Any) -> None:
    """Joint torques [N m] into `out` (3,) for q, q', q'' (3,) [rad, ...] and pi (8,)."""
    s2, c2, s3, c3 = sin(q[1]), cos(q[1]), sin(q[2]), cos(q[2])
    s23, c23 = sin(q[1] - q[2]), cos(q[1] - q[2])
    # dM11/dth2 = -2 e2, dM11/dth3 = -2 e3
    e2 = 2.0 * pi[1] * s2 * c2 + 0.5 * pi[3] * s2 * s3
    e3 = 2.0 * pi[2] * s3 * c3 - 0.5 * pi[3] * c2 * c3
    # M11 = pi1 + pi2 cos 2th2 + pi3 cos 2th3 + pi4 cos th2 sin th3
    m11 = pi[0] + pi[1] * (c2 * c2 - s2 * s2) + pi[2] * (c3 * c3 - s3 * s3) + pi[3] * c2 * s3
    half = 0.5 * pi[3]
    out[0] = m11 * a[0] - 2.0 * (e2 * v[1] + e3 * v[2]) * v[0]
    out[1] = pi[4] * a[1] - half * s23 * a[2] + e2 * v[0] ** 2 + half * c23 * v[2] ** 2 + pi[6] * c2
    out[2] = pi[5] * a[2] - half * s23 * a[1] + e3 * v[0] ** 2 - half * c23 * v[1] ** 2 + pi[7] * s3


@nb.njit(cache=True, nogil=True)
def premium_momentum(q: Any, v: Any, pi: Any, work: Any, out: Any) -> None:
    """M(q) q' [N m s] into `out` (3,); `work` (2, 3) is scratch."""
    # N alone, then M a + N with a = q'
    work[0, :] = 0.0
    premium_inverse_dynamics(q, work[0], work[0], pi, work[1])
    premium_inverse_dynamics(q, work[0], v, pi, out)
    for i in range(3):
        out[i] -= work[1, i]


@nb.njit(cache=True, nogil=True)
def push(q: Any, v: Any, pi: Any, work: Any, out: Any) -> None:
    """C^T q' - N [N m] into `out` (3,), with C^T q' = M' q' - C q'; `work` (6, 3) is scratch."""
    h = 1e-5
    for side in range(2):
        for i in range(3):
            work[2, i] = q[i] + (h if side == 0 else -h) * v[i]
        premium_momentum(work[2], v, pi, work[:2], work[3 + side])
    work[0, :] = 0.0
    premium_inverse_dynamics(q, v, work[0], pi, work[5])
    for i in range(3):
        out[i] = (work[3, i] - work[4, i]) / (2.0 * h) - work[5, i]


@nb.njit(cache=True, nogil=True)
def drift(q: Any, v: Any, lengths: Any, out: Any) -> None:
    """J' q' [m/s^2] into `out` (3,): the tip's acceleration without joint accelerations."""
    s1, c1, s2, c2 = sin(q[0]), cos(q[0]), sin(q[1]), cos(q[1])
    s3, c3 = sin(q[2]), cos(q[2])
    l1, l2 = lengths[0], lengths[1]
    r, dr = l1 * c2 + l2 * s3, -l1 * s2 * v[1] + l2 * c3 * v[2]
    ddr = -l1 * c2 * v[1] ** 2 - l2 * s3 * v[2] ** 2
    out[0] = ddr * c1 - 2.0 * dr * s1 * v[0] - r * c1 * v[0] ** 2
    out[1] = ddr * s1 + 2.0 * dr * c1 * v[0] - r * s1 * v[0] ** 2
    out[2] = -l1 * s2 * v[1] ** 2 + l2 * c3 * v[2] ** 2


@nb.njit(cache=True, nogil=True)
def solve_jacobian(j: Any, b: Any, out: Any) -> None:
    """J x = b by cofactors into `out` (3,); a determinant below `SINGULAR` counts as that."""
    a0 = j[1, 1] * j[2, 2] - j[1, 2] * j[2, 1]
    a1 = j[1, 2] * j[2, 0] - j[1, 0] * j[2, 2]
    a2 = j[1, 0] * j[2, 1] - j[1, 1] * j[2, 0]
    det = j[0, 0] * a0 + j[0, 1] * a1 + j[0, 2] * a2
    if abs(det) < SINGULAR:
        det = SINGULAR if det >= 0.0 else -SINGULAR
    out[0] = (
        a0 * b[0]
        + (j[0, 2] * j[2, 1] - j[0, 1] * j[2, 2]) * b[1]
        + (j[0, 1] * j[1, 2] - j[0, 2] * j[1, 1]) * b[2]
    ) / det
    out[1] = (
        a1 * b[0]
        + (j[0, 0] * j[2, 2] - j[0, 2] * j[2, 0]) * b[1]
        + (j[0, 2] * j[1, 0] - j[0, 0] * j[1, 2]) * b[2]
    ) / det
    out[2] = (
        a2 * b[0]
        + (j[0, 1] * j[2, 0] - j[0, 0] * j[2, 1]) * b[1]
        + (j[0, 0] * j[1, 1] - j[0, 1] * j[1, 0]) * b[2]
    ) / det


@nb.njit(cache=True, nogil=True)
def solve_transposed(j: Any, b: Any, work: Any, out: Any) -> None:
    """J^T x = b into `out` (3,); `work` (3, 3) is scratch."""
    for i in range(3):
        for k in range(3):
            work[i, k] = j[k, i]
    solve_jacobian(work, b, out)


@nb.njit(cache=True, nogil=True)
def interpolate(v: float, speeds: Any, values: Any) -> float:
    """Friction torque [N m] at speed v, linear between knots, straight on beyond them."""
    n = speeds.size
    if n < 2:
        return 0.0
    low, high = 0, n - 1
    while high - low > 1:
        mid = (low + high) // 2
        if speeds[mid] <= v:
            low = mid
        else:
            high = mid
    share = (v - speeds[low]) / (speeds[low + 1] - speeds[low])
    return float(values[low] + share * (values[low + 1] - values[low]))


@nb.njit(cache=True, nogil=True)
def advance(
    running: bool,
    q: Any,
    v: Any,
    sent: Any,
    rub: Any,
    pi: Any,
    gain: float,
    period: float,
    past: Any,
    now: Any,
    room: Any,
    impulse: Any,
    flow: Any,
    r: Any,
) -> None:
    """One period: r = K (M q' - int(tau_c + C^T q' - N - tau_f + r) dt) into `r` (3,) [N m].

    The external torque through a first-order low-pass of corner K; implicit in r, stable for
    any K.

    Parameters
    ----------
    sent, rub : ndarray (3,)
        Torque of the last tick, friction [N m].
    gain, period : float
        K [rad/s], T [s].
    past, now : ndarray (3,)
        Integral before (read) and after (written) [N m s].
    room, impulse, flow : ndarray (6, 3), (3,), (3,)
        Scratch.
    """
    premium_momentum(q, v, pi, room[:2], impulse)
    push(q, v, pi, room, flow)
    for i in range(3):
        known = past[i] + period * (sent[i] + flow[i] - rub[i]) if running else impulse[i]
        r[i] = gain * (impulse[i] - known) / (1.0 + gain * period)
        now[i] = known + period * r[i]


# ------------------------------------------------------------ geometry

#: Nominal l1, l2 [m] (Cavusoglu et al. 2002).
LINK_LENGTHS = (0.215, 0.170)


@nb.njit(cache=True, nogil=True)
def forward_kinematics(q: Any, lengths: Any, out: Any) -> None:
    """Tip position [m] into `out` (3,); `q` (3,) [rad], `lengths` = l1, l2 [m]."""
    r = lengths[0] * cos(q[1]) + lengths[1] * sin(q[2])
    out[0] = r * cos(q[0])
    out[1] = r * sin(q[0])
    out[2] = lengths[0] * sin(q[1]) - lengths[1] * cos(q[2])


@nb.njit(cache=True, nogil=True)
def inverse(p: Any, lengths: Any, out: Any) -> None:
    """Joint angles [rad] into `out` (3,) of the pose with the elbow up; `p` (3,) [m]."""
    l1, l2 = lengths[0], lengths[1]
    radial = hypot(p[0], p[1])
    length = hypot(radial, p[2])
    # law of cosines in the plane of the arm
    out[0] = atan2(p[1], p[0])
    lift = acos((l1**2 + length**2 - l2**2) / (2.0 * l1 * length))
    out[1] = atan2(p[2], radial) + lift
    out[2] = out[1] + acos((l1**2 + l2**2 - length**2) / (2.0 * l1 * l2)) - pi / 2.0


@nb.njit(cache=True, nogil=True)
def jacobian(q: Any, lengths: Any, out: Any) -> None:
    """Position Jacobian (3, 3) of the tip: p' = J q'."""
    s1, c1, s2, c2 = sin(q[0]), cos(q[0]), sin(q[1]), cos(q[1])
    s3, c3 = sin(q[2]), cos(q[2])
    l1, l2 = lengths[0], lengths[1]
    r = l1 * c2 + l2 * s3
    out[0, 0], out[0, 1], out[0, 2] = -s1 * r, -l1 * c1 * s2, l2 * c1 * c3
    out[1, 0], out[1, 1], out[1, 2] = c1 * r, -l1 * s1 * s2, l2 * s1 * c3
    out[2, 0], out[2, 1], out[2, 2] = 0.0, l1 * c2, l2 * s3


def premium() -> tuple[Callable[..., None], Any]:
    """`forward_kinematics` and the lengths of the PHANTOM Premium 1.5, for the registry."""
    return forward_kinematics, np.array(LINK_LENGTHS)
