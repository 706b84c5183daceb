"""One axis with exact dry friction (it sticks), a controller and a noisy log: a stranger's drive.

Written for the tests alone: neither the library's effects nor the simulated devices take part.
"""

from __future__ import annotations

import numpy as np

from hil.record.recording import Recording

INERTIA, COULOMB, VISCOUS = 0.05, 0.6, 0.3
STIFFNESS, DAMPING = 80.0, 4.0
RATE, SUBSTEPS = 500, 10


def stiction_run(
    seed: int, drag: float = 0.0, peak: float = 0.0, late: int = 0, seconds: float = 20.0
) -> Recording:
    """Recording of a multisine; `drag` v|v|, a Stribeck `peak` of 0.15 rad/s, `late` samples."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * np.array([0.11, 0.27, 0.6, 1.3]) * rng.uniform(0.9, 1.1, 4)
    size, phase = np.array([0.8, 0.3, 0.1, 0.04]), rng.uniform(0, 2 * np.pi, 4)
    n, dt = int(seconds * RATE), 1 / RATE / SUBSTEPS
    t = np.arange(n) / RATE
    goal = np.sin(np.outer(t, omega) + phase) @ size
    speed = np.cos(np.outer(t, omega) + phase) @ (size * omega)
    q, v, out, sent = float(goal[0]), 0.0, np.zeros((n, 2)), [0.0] * (late + 1)
    for k in range(n):
        tau = STIFFNESS * (goal[k] - q) + DAMPING * (speed[k] - v)
        out[k] = q, tau
        sent = [*sent[1:], tau]
        for _ in range(SUBSTEPS):
            free = (v + dt * (sent[0] - drag * v * abs(v)) / INERTIA) / (1 + dt * VISCOUS / INERTIA)
            dry = COULOMB + peak * np.exp(-((v / 0.15) ** 2))
            step = dt * dry / INERTIA / (1 + dt * VISCOUS / INERTIA)
            v = float(np.sign(free) * max(abs(free) - step, 0.0))
            q += v * dt
    out += rng.normal(size=out.shape) * [1e-5, 0.02]
    return Recording("stiction", "arm", ("joint1",), t, out[:, :1].copy(), out[:, 1:].copy())
