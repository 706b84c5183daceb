"""Channels of the force sensor: where they point, what they say, what they mean to the joints.

They lie along the axes of the base (a sensor under the object, or one whose reading is turned in
its own electronics) or of the tip (a sensor on the last link).  Without a wrench at the tip the
sensors are one a joint and J is the unit matrix.
"""

from __future__ import annotations

import numpy as np

from hil.models.motion import FloatArray, Motion

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
#: Values of the shape parameter `frame`.
BASE, TIP = 0.0, 1.0


def at_tip(motion: Motion) -> bool:
    """Whether the external effort comes from a wrench at the tip."""
    return bool(motion.wrench.shape[0] == motion.n)


def channels(motion: Motion) -> list[int]:
    """Sensor channels: the wrench's three forces (and torques, if it has any), or the joints."""
    if not at_tip(motion):
        return list(range(motion.d))
    return list(range(6 if np.any(motion.wrench[:, 3:]) else 3))


def pairs(motion: Motion) -> list[tuple[int, int]]:
    """Pairs (a, b) of different channels of one kind, b with a reading."""
    of = channels(motion)
    kinds = [of[:3], of[3:]] if at_tip(motion) else [of]
    return [(a, b) for kind in kinds for a in kind for b in kind if a != b]


def lever(motion: Motion, frame: float) -> FloatArray:
    """Effort of unit readings (n, d, channels): J' with the channels along the frame's axes."""
    count = len(channels(motion))
    if not at_tip(motion):
        return np.broadcast_to(np.eye(motion.d), (motion.n, motion.d, motion.d))
    axes = _axes(motion, frame)
    parts = []
    for k in range(count):
        unit = np.zeros((motion.n, 6))
        unit[:, 3 * (k // 3) : 3 * (k // 3) + 3] = axes[:, :, k % 3]
        parts.append(motion.robot.external(motion.q, unit))
    return np.stack(parts, axis=2)


def readings(motion: Motion, frame: float) -> FloatArray:
    """What the channels say (n, channels)."""
    if not at_tip(motion):
        return motion.tau_ext
    axes, w = _axes(motion, frame), motion.wrench
    parts = [np.einsum("nij,ni->nj", axes, w[:, k : k + 3]) for k in (0, 3)]
    return np.concatenate(parts, axis=1)[:, : len(channels(motion))]


def _axes(motion: Motion, frame: float) -> FloatArray:
    """Axes of the channels as columns in base axes (n, 3, 3)."""
    turned = motion.robot.tip_axes(motion.q) if frame == TIP else None
    return np.broadcast_to(np.eye(3), (motion.n, 3, 3)) if turned is None else turned
