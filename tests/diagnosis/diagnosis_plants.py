"""Simulated axes for tests of the diagnosis: exact motion, any extra effort, white noise."""

import numpy as np

from hil.record.recording import Recording, RobotSource


def motion(t, seed=0, count=8, top=2.0):
    """Position, speed and acceleration of seeded sines up to `top` Hz."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * rng.uniform(0.1, top, count)
    a, p = rng.normal(0.0, 0.5, count) / np.sqrt(w), rng.uniform(0.0, 2 * np.pi, count)
    angle = w * t[:, None] + p
    q = (a * np.sin(angle)).sum(axis=1)
    v = (a * w * np.cos(angle)).sum(axis=1)
    return q, v, -(a * w**2 * np.sin(angle)).sum(axis=1)


def axis(seed=0, seconds=30.0, rate=500.0, extra=None, push=None, noise=0.01):
    """One axis: inertia 0.1, Coulomb 0.3, viscous 0.1, offset 0.05.

    `extra(t, q, v, a)` is an effort more that the motor supplies; `push(t, q, v)` an external one.
    """
    t = np.arange(int(seconds * rate)) / rate
    q, v, a = motion(t, seed)
    tau = 0.1 * a + 0.3 * np.tanh(v / 0.02) + 0.1 * v + 0.05
    outside = None
    if push is not None:
        outside = push(t, q, v)
        tau = tau - outside
    if extra is not None:
        tau = tau + extra(t, q, v, a)
    tau = tau + noise * np.random.default_rng(seed + 100).normal(size=t.size)
    return Recording(
        f"axis{seed}",
        "arm",
        ("joint1",),
        t,
        q[:, None],
        tau[:, None],
        tau_ext=None if outside is None else outside[:, None],
        robot=RobotSource("single-axis"),
    )
