"""Compiled conversions: counts to joint state, joint efforts to DAC codes."""

from __future__ import annotations

from math import fabs, floor, isfinite
from typing import Any

import numba as nb


@nb.njit(cache=True, nogil=True)
def joint_state(
    counts: Any, rate: Any, to_joint: Any, period: float, position: Any, velocity: Any
) -> None:
    """Position [rad] and velocity [rad/s] from counts and their rates.

    Parameters
    ----------
    counts : ndarray (3,)
        Motor counts now.
    rate : ndarray (3,)
        Motor counts per period.
    to_joint : ndarray (3, 3)
        Joint angle per motor count [rad].
    period : float
        Sample period [s].
    """
    for i in range(3):
        position[i] = 0.0
        velocity[i] = 0.0
        for j in range(3):
            # count n stands for the interval n..n+1: take its middle
            position[i] += to_joint[i, j] * (counts[j] + 0.5)
            velocity[i] += to_joint[i, j] * (rate[j] / period)


@nb.njit(cache=True, nogil=True)
def codes(effort: Any, to_code: Any, to_effort: Any, top: int, out: Any, sent: Any) -> int:
    """DAC codes for joint efforts; 0 = as asked, 1 = clamped, 3 = not a number (all zero).

    Parameters
    ----------
    effort, sent : ndarray (3,)
        Asked for, and really going out [N m].
    to_code, to_effort : ndarray (3, 3)
        Codes per N m and back.
    top : int
        Largest code.
    out : ndarray (3,)
        Codes.
    """
    status = 0
    for i in range(3):
        if not isfinite(effort[i]):
            status = 3
    for i in range(3):
        value = 0.0
        if status != 3:
            for j in range(3):
                value += to_code[i, j] * effort[j]
        if fabs(value) > top:
            value = top if value > 0.0 else -top
            status = 1
        out[i] = floor(value + 0.5)
    for i in range(3):
        sent[i] = 0.0
        for j in range(3):
            sent[i] += to_effort[i, j] * out[j]
    return status
