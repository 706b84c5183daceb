"""Motions on which effects are checked: seeded, smooth, with exact derivatives."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hil.models.motion import FloatArray, Motion
from hil.models.phantom import Premium
from hil.models.robots import IndependentAxes, Robot


def sample_motions(n: int = 2000) -> Iterator[tuple[str, Motion]]:
    """Motions on which effects are checked: label and motion.

    Parameters
    ----------
    n : int
        Instants of each motion.

    Yields
    ------
    str, Motion
        1 to 3 joints, moving and at standstill, with and without an external effort and a
        known surface; the three-joint robot has geometry.
    """
    for d in (1, 2, 3):
        names = tuple(f"joint{k + 1}" for k in range(d))
        robot: Robot = _Geared(names) if d == 3 else IndependentAxes(names)
        for seed, external in ((d, False), (10 + d, True)):
            what = "with" if external else "without"
            yield f"{d} joints moving, {what} external effort", _moving(robot, n, seed, external)
        yield f"{d} joints at standstill", _still(robot, n)


class _Geared(Premium):
    """Three joints with geometry, and rotors that are not part of the links' inertias."""

    has_armature = True


def _moving(robot: Robot, n: int, seed: int, external: bool) -> Motion:
    """Sum of seeded random sines up to 3 Hz, with exact derivatives."""
    rng, d = np.random.default_rng(seed), len(robot.joints)
    t = np.arange(n, dtype=np.float64) / 128.0
    w = 2 * np.pi * rng.uniform(0.1, 3.0, (d, 8))
    size, phase = rng.normal(0.0, 0.3, (d, 8)) / w, rng.uniform(0, 2 * np.pi, (d, 8))
    angle = w[None] * t[:, None, None] + phase[None]
    q = np.sum(size * np.sin(angle), axis=2)
    qd = np.sum(size * w * np.cos(angle), axis=2)
    qdd = -np.sum(size * w**2 * np.sin(angle), axis=2)
    tau = 0.1 * qdd + 0.05 * np.tanh(qd / 0.01) + 0.01 * q
    push = 0.2 * np.sin(2.0 * np.pi * 0.7 * t)[:, None] * np.ones(d) if external else 0.0 * q
    middle = np.stack([q.mean(axis=0), np.where(np.arange(d) % 2, -1.0, 1.0)], axis=1)
    contact = middle if external else np.full((d, 2), np.nan)
    return _motion(robot, t, (q, qd, qdd), tau, push, contact)


def _still(robot: Robot, n: int) -> Motion:
    t, d = np.arange(n, dtype=np.float64) / 128.0, len(robot.joints)
    q, zero = np.full((n, d), 0.3), np.zeros((n, d))
    contact = np.tile([0.3, 1.0], (d, 1))
    return _motion(robot, t, (q, zero, zero.copy()), zero.copy(), zero.copy(), contact)


def _motion(
    robot: Robot, t: FloatArray, state: tuple[FloatArray, FloatArray, FloatArray],
    tau: FloatArray, push: FloatArray, contact: FloatArray,
) -> Motion:  # fmt: skip
    q, qd, qdd = state
    speed = np.sqrt(np.mean(qd**2, axis=0))
    return Motion(
        t=t, q=q, qd=qd, qdd=qdd, tau=tau, tau_ext=push, load=0.1 * qdd + 0.05 * q - push,
        static=0.05 * q,
        v0=np.maximum(0.01 * speed, 1e-9), resolution=np.maximum(0.005 * speed, 1e-9),
        span=np.stack([q.min(axis=0), q.max(axis=0)], axis=1),
        contact=contact, robot=robot, temperature=20.0 + 0.1 * t[:, None] + 0.0 * q,
        wrench=_wrench(robot, t, push), response=_Stiff(*q.shape),
    )  # fmt: skip


class _Stiff:
    """A model of one inertia, stiffness and friction for all joints."""

    def __init__(self, n: int, d: int) -> None:
        unit: FloatArray = np.broadcast_to(np.eye(d), (n, d, d)).copy()
        self.inertia, self.gradient, self.damping = 0.1 * unit, 0.05 * unit, np.full(d, 0.02)
        self._n, self._d = n, d

    def unslipped(self, j: int) -> FloatArray:
        """A jump in the middle."""
        out = np.zeros((self._n, self._d))
        out[self._n // 2 :, j] = -0.05 * 1e-3
        return out


def _wrench(robot: Robot, t: FloatArray, push: FloatArray) -> FloatArray:
    """A force that turns, for the robot that has a tip; no rows otherwise."""
    if not isinstance(robot, Premium) or not np.any(push):
        return np.zeros((0, 6))
    angle = 2 * np.pi * 0.3 * t
    zero = np.zeros_like(t)
    return np.stack([np.sin(angle), np.cos(angle), 0.5 + zero, zero, zero, zero], axis=1)
