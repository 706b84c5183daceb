"""What moves a joint: its effort explained by its own motion, and the work that it does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.record.consistency import smooth

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Balance:
    """Joint effort explained by its own motion.

    Parameters
    ----------
    inertia, friction : float
        Coefficients of acceleration and of the direction of motion.
    work : float
        Net work of the effort over the work without regard to sign, -1 to 1.
    external : float
        Coefficient of the external effort (-1 where all is right); NaN without one.
    certainty : float
        Partial correlation of the external effort.
    """

    inertia: float
    friction: float
    work: float
    external: float
    certainty: float


def balance(t: FloatArray, q: FloatArray, tau: FloatArray, ext: FloatArray | None) -> Balance:
    """Regress the effort of a joint on its own motion and the external effort.

    Parameters
    ----------
    t, q, tau : ndarray (n,)
        Time, position and motor effort.
    ext : ndarray (n,) or None
        External effort on the robot.
    """
    period = float(np.median(np.diff(t)))
    width = max(int(0.02 / period), 3)
    position, effort = smooth(q, width), smooth(tau, width)
    speed = np.gradient(position, t)
    acceleration = smooth(np.gradient(speed, t), width)
    scale = 0.1 * float(np.sqrt(np.mean(speed**2))) or 1.0
    direction = smooth(np.tanh(speed / scale), width)
    trim = slice(3 * width, -3 * width, max(width // 2, 1))
    y, v, x = effort[trim], speed[trim], position[trim]
    terms = [acceleration[trim], direction[trim], np.ones_like(x), x, np.sin(x), np.cos(x)]
    known = np.stack(terms, axis=1)
    work = float(np.sum(y * v) / (np.sum(np.abs(y * v)) or 1.0))
    external, certainty = float("nan"), 0.0
    if ext is not None and np.ptp(ext) > 0:
        other = smooth(ext, width)[trim]
        rest = other - known @ np.linalg.lstsq(known, other, rcond=None)[0]
        left = y - known @ np.linalg.lstsq(known, y, rcond=None)[0]
        norm = float(np.sqrt(np.sum(rest**2) * np.sum(left**2)))
        certainty = float(np.sum(rest * left)) / norm if norm else 0.0
        external = float(np.sum(rest * left) / (np.sum(rest**2) or 1.0))
        y = y - external * other
    fitted = np.linalg.lstsq(known, y, rcond=None)[0]
    return Balance(float(fitted[0]), float(fitted[1]), work, external, certainty)
