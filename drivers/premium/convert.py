"""Compiled conversions: counts to joint state, joint efforts to DAC codes.

Velocity: first-order adaptive windowing (Janabi-Sharifi, Hayward & Chen, IEEE Trans. Control
Syst. Technol. 8(6) 2000), end-fit, on motor counts.
"""

from __future__ import annotations

from math import fabs, floor, isfinite
from typing import Any

import numba as nb

WINDOW = 24


@nb.njit(cache=True, nogil=True)
def joint_state(
    counts: Any, past: Any, head: int, steps: int, to_joint: Any, period: float, position: Any,
    velocity: Any,
) -> None:  # fmt: skip
    """Position [rad] and velocity [rad/s] from counts.

    Parameters
    ----------
    counts : ndarray (3,)
        Motor counts now; written into `past` (3, WINDOW) at `head`.
    steps : int
        Periods since the last reading; what lies between is filled in by a line.
    to_joint : ndarray (3, 3)
        Joint angle per motor count [rad].
    period : float
        Sample period [s].
    """
    for i in range(3):
        last = past[i, (head - steps) % WINDOW] if steps < WINDOW else float(counts[i])
        for k in range(min(steps, WINDOW)):
            past[i, (head - k) % WINDOW] = counts[i] - (counts[i] - last) * k / steps
        position[i] = 0.0
        velocity[i] = 0.0
    for j in range(3):
        rate = slope(past[j], head) / period
        for i in range(3):
            # count n stands for the interval n..n+1: take its middle
            position[i] += to_joint[i, j] * (counts[j] + 0.5)
            velocity[i] += to_joint[i, j] * rate


@nb.njit(cache=True, nogil=True)
def slope(past: Any, head: int) -> float:
    """Counts per period through the longest window that one count of noise allows."""
    now, best = past[head], 0.0
    for n in range(1, WINDOW):
        # end fit b = (y_k - y_(k-n)) / n; accept while |y_k - b j - y_(k-j)| <= 1
        b = (now - past[(head - n) % WINDOW]) / n
        for j in range(1, n):
            if fabs(now - b * j - past[(head - j) % WINDOW]) > 1.0:
                return float(best)
        best = b
    return float(best)


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
