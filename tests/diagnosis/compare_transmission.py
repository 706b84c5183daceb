"""A motor, a link behind a spring or a play, a lagging amplifier: written for the tests alone."""

from __future__ import annotations

import numba
import numpy as np

from hil.record.recording import Recording

MOTOR, LINK, VISCOUS, DRY = 0.02, 0.06, 0.25, 0.12
RATE, SUBSTEPS = 500, 40


@numba.njit(cache=True)
def _run(
    goal: np.ndarray,
    speed: np.ndarray,
    gravity: float,
    frequency: float,
    zeta: float,
    width: float,
    lag: float,
    ripple: float,
    harden: float,
    mode: float,
    mode_hz: float,
) -> np.ndarray:
    """Motor angle and command (n, 2) under PD control of the motor's side."""
    dt = 1 / (RATE * SUBSTEPS)
    out = np.empty((goal.size, 2))
    q, v, p, w, real = goal[0], 0.0, goal[0], 0.0, 0.0
    x, xv = goal[0], 0.0
    # with the motor held the link swings at sqrt(k / LINK)
    stiff = LINK * (2 * np.pi * frequency) ** 2 if frequency > 0 else 0.0
    damp = 2 * zeta * np.sqrt(stiff * LINK) if stiff > 0 else 0.0
    hold = mode * (2 * np.pi * mode_hz) ** 2
    for k in range(goal.size):
        tau = 40.0 * (goal[k] - q) + 2.0 * (speed[k] - v)
        tau += gravity * np.sin(q)
        out[k, 0], out[k, 1] = q, tau
        for _ in range(SUBSTEPS):
            if lag > 0:
                real += dt / lag * (tau - real)
            else:
                real = tau
            drive = real * (1 + ripple * np.sin(9.0 * q))
            side = np.tanh(v / 0.002)
            drag = VISCOUS * v + DRY * side
            ring = hold * (q - x) + 0.04 * np.sqrt(hold * mode + 1e-12) * (v - xv)
            if mode > 0:
                xv += dt * ring / mode
                x += dt * xv
            if stiff == 0.0:
                a = (drive - drag - ring - gravity * np.sin(q)) / (MOTOR + LINK)
                v += dt * a
                q += dt * v
                p, w = q, v
                continue
            twist = q - p
            if width > 0:
                twist = twist - min(max(twist, -width / 2), width / 2)
            touch = 1.0 if twist != 0.0 else 0.0
            force = stiff * twist * (1 + harden * abs(stiff * twist)) + damp * (v - w) * touch
            v += dt * (drive - drag - ring - force) / MOTOR
            w += dt * (force - gravity * np.sin(p) - 0.01 * w) / LINK
            q += dt * v
            p += dt * w
    return out


def transmission_run(
    seed: int, gravity: float = 0.0, seconds: float = 20.0, fast: float = 1.0, **what: float
) -> Recording:
    """Recording of a multisine up to about 5 Hz; `what` is hidden in the plant."""
    rng = np.random.default_rng(seed)
    omega = fast * 2 * np.pi * np.array([0.13, 0.37, 0.9, 2.1, 4.7]) * rng.uniform(0.9, 1.1, 5)
    size, phase = np.array([0.5, 0.25, 0.15, 0.08, 0.04]), rng.uniform(0, 2 * np.pi, 5)
    t = np.arange(int(seconds * RATE)) / RATE
    goal = np.sin(np.outer(t, omega) + phase) @ size
    speed = np.cos(np.outer(t, omega) + phase) @ (size * omega)
    names = ("frequency", "zeta", "width", "lag", "ripple", "harden", "mode", "mode_hz")
    values = {"zeta": 0.05, "mode_hz": 9.0, **what}
    out = _run(goal, speed, gravity, *(float(values.get(n, 0.0)) for n in names))
    out += rng.normal(size=out.shape) * [2e-6, 0.01]
    return Recording("drive", "arm", ("joint1",), t, out[:, :1].copy(), out[:, 1:].copy())
