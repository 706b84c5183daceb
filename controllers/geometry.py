"""Nominal geometry of the PHANTOM Premium 1.5: tip position, inverse, Jacobian.

th1 turntable, th2 upper link from the horizontal, th3 forearm from the base (0 = hanging);
z up, origin on the shoulder axis (Cavusoglu, Feygin & Tendick 2002).
"""

from __future__ import annotations

from collections.abc import Callable
from math import acos, atan2, cos, hypot, pi, sin
from typing import Any

import numba as nb
import numpy as np

#: Nominal l1, l2 [m] (Cavusoglu et al. 2002).
LENGTHS = (0.215, 0.170)


@nb.njit(cache=True, nogil=True)
def forward(q: Any, lengths: Any, out: Any) -> None:
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
    """`forward` and the lengths of the PHANTOM Premium 1.5, for the registry."""
    return forward, np.array(LENGTHS)
