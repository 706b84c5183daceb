"""Small plants of the tests' own: no equation, no filter and no robot of the library is used."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.record.recording import Recording, RobotSource

RATE, J, FV, FC = 500.0, 0.05, 0.3, 0.6
ZERO: Callable[..., float] = lambda *state: 0.0  # noqa: E731


def reference(seed: int, period: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies [Hz], amplitudes and phases of four sines; multiples of 1 / period if given."""
    rng = np.random.default_rng(seed)
    f = np.array([0.11, 0.27, 0.6, 1.3]) * rng.uniform(0.9, 1.1, 4)
    if period:
        f = np.array([1, 2, 5, 9]) / period
    return f, np.array([0.8, 0.3, 0.1, 0.04]), rng.uniform(0, 6.28, 4)


def axis(
    seed: int = 0,
    seconds: float = 20.0,
    noise: float = 0.02,
    period: float = 0.0,
    extra: Callable[[float, float, float], float] = ZERO,
    warm: Callable[[float], float] = lambda t: 1.0,
    push: Callable[[float], float] = ZERO,
    seen: Callable[[float, float], float] = lambda t, q: q,
    sensor: Callable[[float, float], float] = lambda t, w: w,
    gives: Callable[[float], float] = lambda u: u,
) -> Recording:
    """One axis under PD control with exact dry friction, simulated forward.

    J q'' = gives(tau) + push(t) - extra(t, q, q') - warm(t) (Fv q' + Fc sgn q');
    measured: seen(t, q), sensor(t, push).
    """
    rng = np.random.default_rng(100 + seed)
    f, a, ph = reference(seed, period)
    n, steps = int(seconds * RATE), 4
    h, w = 1 / RATE / steps, 2 * np.pi * f
    q, qd = float(a @ np.sin(ph)), float(a * w @ np.cos(ph))
    rows = np.empty((n, 4))
    t = np.arange(n) / RATE
    goal = np.sin(w * t[:, None] + ph) @ a
    rate = np.cos(w * t[:, None] + ph) @ (a * w)
    for k in range(n):
        tau = 80.0 * (goal[k] - q) + 4.0 * (rate[k] - qd)
        rows[k] = t[k], seen(t[k], q), tau, sensor(t[k], push(t[k]))
        for s in range(steps):
            now = t[k] + s * h
            force = gives(tau) + push(now) - extra(now, q, qd)
            free = (qd + h * force / J) / (1 + h * FV * warm(now) / J)
            drop = h * FC * warm(now) / J
            qd = np.sign(free) * max(abs(free) - drop, 0.0)
            q += h * qd
    measured = rows[:, 1] + 1e-5 * rng.normal(size=n)
    effort = rows[:, 2] + noise * rng.normal(size=n)
    outside = rows[:, 3:4].copy() if push is not ZERO else None
    return Recording(
        "axis", "arm", ("joint1",), rows[:, 0], measured[:, None], effort[:, None], tau_ext=outside
    )


L1, L2 = 0.215, 0.170
PI = np.array([2.8e-3, 1.1e-3, -3.9e-4, 9.1e-4, 2.4e-3, 9.3e-4, -1.6e-2, -7.4e-2])


def _tip(q: np.ndarray) -> np.ndarray:
    r = L1 * np.cos(q[:, 1]) + L2 * np.sin(q[:, 2])
    z = L1 * np.sin(q[:, 1]) - L2 * np.cos(q[:, 2])
    return np.stack([r * np.cos(q[:, 0]), r * np.sin(q[:, 0]), z], axis=1)


def _mass(q: np.ndarray) -> np.ndarray:
    m = np.zeros((len(q), 3, 3))
    m[:, 0, 0] = (
        PI[0]
        + PI[1] * np.cos(2 * q[:, 1])
        + PI[2] * np.cos(2 * q[:, 2])
        + PI[3] * np.cos(q[:, 1]) * np.sin(q[:, 2])
    )
    m[:, 1, 1], m[:, 2, 2] = PI[4], PI[5]
    m[:, 1, 2] = m[:, 2, 1] = -PI[3] / 2 * np.sin(q[:, 1] - q[:, 2])
    return m


def _slope(f: Callable[[np.ndarray], np.ndarray], q: np.ndarray) -> np.ndarray:
    """Derivative of f (n, ...) by each joint, last axis."""
    e = 1e-6 * np.eye(3)
    return np.stack([(f(q + e[k]) - f(q - e[k])) / 2e-6 for k in range(3)], axis=-1)


def arm(
    seed: int = 0,
    seconds: float = 20.0,
    noise: float = 2e-3,
    force: Callable[[np.ndarray], np.ndarray] | None = None,
    sensor: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda t, w: w,
    late: float = 0.0,
    joint_error: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Recording:
    """A PHANTOM Premium: its effort from Lagrange's equations along a prescribed motion.

    tau = M q'' + (dM/dt) q' - 1/2 d(q' M q')/dq + N + friction - J' force; the sensor shows
    sensor(t, force), the encoders the motion `late` seconds ago plus joint_error(t, q).
    """
    rng = np.random.default_rng(seed)
    f = np.array([0.13, 0.31, 0.7, 1.1])
    a = np.array([0.35, 0.15, 0.06, 0.03])
    ph = rng.uniform(0, 6.28, (3, 4))
    scale = f * rng.uniform(0.9, 1.1, (3, 4)) * 2 * np.pi
    t = np.arange(int(seconds * RATE)) / RATE
    home = np.array([0.0, 0.3, 0.4])

    def motion(at: np.ndarray) -> np.ndarray:
        return home + np.sum(a * np.sin(scale * at[:, None, None] + ph), axis=2)

    angle = scale * t[:, None, None] + ph
    q = motion(t)
    qd = np.sum(a * scale * np.cos(angle), axis=2)
    qdd = -np.sum(a * scale**2 * np.sin(angle), axis=2)
    dm = _slope(_mass, q)
    tau = np.einsum("nij,nj->ni", _mass(q), qdd)
    tau += np.einsum("nijk,nk,nj->ni", dm, qd, qd) - np.einsum("njki,nj,nk->ni", dm, qd, qd) / 2
    tau[:, 1] += PI[6] * np.cos(q[:, 1])
    tau[:, 2] += PI[7] * np.sin(q[:, 2])
    tau += 0.01 * np.sign(qd) + 0.002 * qd
    wrench = None
    if force is not None:
        w = force(t)
        tau -= np.einsum("nkd,nk->nd", _slope(_tip, q), w)
        wrench = np.zeros((t.size, 6))
        wrench[:, :3] = sensor(t, w) + 1e-3 * rng.normal(size=w.shape)
    shown = motion(t - late)
    shown = shown if joint_error is None else shown + joint_error(t, shown)
    return Recording(
        "arm",
        "arm",
        ("joint1", "joint2", "joint3"),
        t,
        shown + 2e-6 * rng.normal(size=q.shape),
        tau + noise * rng.normal(size=q.shape),
        wrench=wrench,
        robot=RobotSource("phantom-premium-1.5"),
    )


def hand(t: np.ndarray) -> np.ndarray:
    """A hand that pushes in all directions, up to 3 N."""
    parts = [np.sin(2 * np.pi * f * t + p) for f, p in ((0.23, 0.4), (0.41, 1.9), (0.17, 2.8))]
    return 2.0 * np.stack(parts, axis=1) + 0.5
