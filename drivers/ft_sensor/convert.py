"""Compiled conversion of gauge words to a wrench in the base frame."""

from __future__ import annotations

from math import cos, sin
from typing import Any

import numba as nb


@nb.njit(cache=True, nogil=True)
def wrench(words: Any, bias: Any, calibration: Any, position: Any, out: Any) -> float:
    """Force [N] and torque [N m] ON the robot in the base frame.

    Parameters
    ----------
    words, bias : ndarray (6,)
        Gauge words and their values without load.
    calibration : ndarray (6, 6)
        Wrench in the sensor frame per word.
    position : ndarray (3,)
        Joint angles [rad]; th3 is the forearm's angle from the base.
    out : ndarray (6,)
        Written.

    Returns
    -------
    float
        |Fx| + |Fy| + |Fz| [N].
    """
    s1, c1, s3, c3 = sin(position[0]), cos(position[0]), sin(position[2]), cos(position[2])
    for half in range(2):
        x, y, z = 0.0, 0.0, 0.0
        for k in range(6):
            load = words[k] - bias[k]
            x += calibration[3 * half, k] * load
            y += calibration[3 * half + 1, k] * load
            z += calibration[3 * half + 2, k] * load
        # sensor axes in (radial, across, up): x = (c3, 0, s3), y = (0, -1, 0), z = (s3, 0, -c3)
        radial, across, up = c3 * x + s3 * z, -y, s3 * x - c3 * z
        # base = Rz(th1) (radial, across, up)
        out[3 * half] = c1 * radial - s1 * across
        out[3 * half + 1] = s1 * radial + c1 * across
        out[3 * half + 2] = up
    return float(abs(out[0]) + abs(out[1]) + abs(out[2]))


@nb.njit(cache=True, nogil=True)
def at_end(words: Any, full: int) -> bool:
    """Whether one of the `words` (6,) is at `full` or more, or below -`full`."""
    for k in range(words.size):
        if words[k] >= full or words[k] < -full:
            return True
    return False
