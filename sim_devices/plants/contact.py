"""Gel under the tip: Hunt-Crossley with one Maxwell arm and wet lateral drag.

Hunt & Crossley, J. Appl. Mech. 42(2) 1975.  The surface is the plane z = `surface`.
"""

from __future__ import annotations

from math import fabs, hypot
from typing import Any

import numba as nb


@nb.njit(cache=True, nogil=True, error_model="numpy")
def press(gel: Any, x: Any, dt: float) -> None:
    """Add the gel's force [N] on the tip to `x.force`."""
    depth = gel.surface - x.tip[2]
    if depth <= 0.0:
        # free: the Maxwell arm relaxes
        gel.flow -= dt * gel.flow / gel.relaxation
        return
    rate = -x.tip_v[2]
    # f = k d^n (1 + 1.5 c d') + k b (d - flow),  flow' = (d - flow) / tau
    normal = gel.stiffness * depth**gel.power * (1.0 + 1.5 * gel.damping * rate)
    normal += gel.branch * (depth - gel.flow)
    gel.flow += dt * (depth - gel.flow) / gel.relaxation
    if normal <= 0.0:
        return
    x.force[2] += normal
    speed = hypot(x.tip_v[0], x.tip_v[1]) + 1e-3
    for k in range(2):
        x.force[k] -= gel.drag * fabs(normal) * x.tip_v[k] / speed
