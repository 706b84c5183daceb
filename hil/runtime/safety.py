"""Limits between the law and the device: torque clamp, speed limit, not-a-number."""

from __future__ import annotations

from math import fabs, isfinite
from typing import Any

import numba as nb

#: Outcomes, the larger the worse (as `hil.signals.device.Status`).
OK, CLAMPED, INVALID = 0, 1, 3


@nb.njit(cache=True, nogil=True)
def limit(effort: Any, velocity: Any, torque_limit: Any, speed_limit: Any) -> int:
    """Clamp `effort` (d,) [N m] in place; zero all of it where the state is not safe.

    Returns
    -------
    int
        `OK`, `CLAMPED`, or `INVALID`: an effort or speed is not a number, or a joint is faster
        than `speed_limit` (d,) [rad/s].
    """
    status = OK
    for i in range(effort.size):
        if not isfinite(effort[i]) or not fabs(velocity[i]) <= speed_limit[i]:
            status = INVALID
    for i in range(effort.size):
        if status == INVALID:
            effort[i] = 0.0
        elif fabs(effort[i]) > torque_limit[i]:
            effort[i] = torque_limit[i] if effort[i] > 0.0 else -torque_limit[i]
            status = CLAMPED
    return status
