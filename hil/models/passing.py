"""What a play or a soft cable lets through, and what it is measured by: the load, the inertia."""

from __future__ import annotations

import numpy as np

from hil.models.kernels import softened
from hil.models.motion import FloatArray, Motion

#: Longest step of the integration [s].
LONGEST = 2e-3


def passing(
    motion: Motion, j: int, soft: tuple[float, float], lag: float, rub: float
) -> FloatArray:
    """What a cable (stretch, tension: `softened`) or a play passes, less the load, (n, 1)."""
    load, speed = (np.ascontiguousarray(x[:, j]) for x in (motion.load, motion.qd))
    slow, parts = float(motion.resolution[j]), int(np.ceil(motion.dt / LONGEST))
    inertia = link_inertia(motion, j)
    passed = softened(load, speed, inertia, motion.dt, *soft, lag, rub, slow, parts)
    return (passed - load - rub * np.clip(speed / slow, -1.0, 1.0))[:, None]


def load_size(motion: Motion, j: int) -> float:
    """Standard deviation of the load; 1 where there is none."""
    return float(np.std(motion.load[:, j])) or 1.0


def link_inertia(motion: Motion, j: int) -> FloatArray:
    """Inertia of the link as the joint feels it (n,): of the model, or load by acceleration."""
    if motion.response is not None:
        own = motion.response.inertia[:, j, j]
        if np.min(own) > 0:
            return np.ascontiguousarray(own)
    slope = float(np.std(motion.load[:, j]) / max(float(np.std(motion.qdd[:, j])), 1e-12))
    return np.full(motion.n, max(slope, 1e-12))
