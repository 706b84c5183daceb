"""What the recording holds of the true signals: force sensor in its own axes, filtered position."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.signal
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
#: Resolution and noise of the force sensor [N], what its certificate does not know.
STEP, NOISE, CROSSTALK = 1.0 / 1280.0, 2e-3, 2e-3


def axes(q: FloatArray) -> FloatArray:
    """Sensor axes in the base frame, (n, 3, 3): rows normal to the forearm, across, along."""
    (s1, _, s3), (c1, _, c3) = np.sin(q).T, np.cos(q).T
    zero = np.zeros_like(s1)
    rows = [[c1 * c3, s1 * c3, s3], [s1, -c1, zero], [c1 * s3, s1 * s3, -c3]]
    return np.stack([np.stack(r, -1) for r in rows], 1)


def force(
    push: FloatArray, q: FloatArray, effects: dict[str, Any], rng: np.random.Generator, tick: float
) -> FloatArray:
    """Measured wrench (n, 6) [N, N m] in the base frame of the true tip force `push` (n, 3)."""
    turn = axes(q)
    f = np.einsum("nij,nj->ni", turn, push)
    k, t = int(effects.get("joint", 0)), tick * np.arange(len(q))
    e = CROSSTALK * np.random.default_rng(0xCA1).standard_normal((3, 3))
    e[k, (k + 1) % 3] += effects.get("cross", 0.0)
    f = f @ (np.eye(3) + e).T
    # gain that is largest for small forces: f (1 + g / (1 + |f|))
    f[:, k] *= 1.0 + effects.get("gain", 0.0) / (1.0 + np.abs(f[:, k]))
    f[:, k] += effects.get("bias", 0.0) + effects.get("drift", 0.0) * t / (t + 10.0)
    f = STEP * np.round((f + NOISE * rng.standard_normal(f.shape)) / STEP)
    out = np.zeros((len(q), 6))
    out[:, :3] = np.einsum("nij,ni->nj", turn, f)
    return out


def late(q: FloatArray, seconds: float, joint: int, tick: float) -> FloatArray:
    """Position (n, 3) with two poles of time constant `seconds` / 2 on one joint."""
    if seconds <= 0.0:
        return q
    a = float(np.exp(-2.0 * tick / seconds))
    b = np.array([(1.0 - a) ** 2])
    out = q.copy()
    start = q[0, joint]
    filtered = scipy.signal.lfilter(b, np.array([1.0, -2.0 * a, a * a]), q[:, joint] - start)
    out[:, joint] = np.asarray(filtered) + start
    return out
