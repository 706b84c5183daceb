"""Reference motions of an identification session, and the force at the tip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
KINDS = ("repeated", "strokes")
SECONDS, TICK = 25.0, 1e-3
#: Middle and largest excursion [rad], largest speed [rad/s].
CENTER, REACH, SPEED = np.array([0.0, 0.4, 0.3]), np.array([0.6, 0.45, 0.45]), 2.2
PERIOD, HARMONICS = 10.0, 25


def reference(kind: str, seed: int) -> FloatArray:
    """Place, speed and acceleration of three joints, (n, 3, 3), swelling within a second.

    Parameters
    ----------
    kind : str
        ``"repeated"``: a Fourier motion of 10 s, 2.5 times; ``"strokes"``: strokes of minimum
        jerk between random poses with an inharmonic multisine on top, never the same again.
    seed : int
        Chooses the motion.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind), 0xE8C])
    n = round(SECONDS / TICK)
    t: FloatArray = TICK * np.arange(n, dtype=np.float64)
    make = _fourier if kind == "repeated" else _strokes
    parts = np.stack([make(rng, t) for _ in range(3)], 1)
    scale = np.minimum(REACH / np.abs(parts[0]).max(1), SPEED / np.abs(parts[1]).max(1))
    place, speed, push = parts * scale[None, :, None]
    # r = center + ramp * motion
    ramp = np.clip(t, 0.0, 1.0)
    rate = np.where(ramp < 1.0, np.pi / 2 * np.sin(np.pi * ramp), 0.0)
    ramp = (1.0 - np.cos(np.pi * ramp)) / 2
    place, speed, push = place, ramp * speed + rate * place, ramp * push
    return np.ascontiguousarray(
        np.stack([CENTER[:, None] + ramp * place, speed, push], -1).transpose(1, 0, 2)
    )


def _fourier(rng: np.random.Generator, t: FloatArray) -> FloatArray:
    """Slow harmonics, and fast ones that swell and fade within one period, (3, n)."""
    w: FloatArray = 2 * np.pi / PERIOD * np.arange(1.0, HARMONICS + 1)[:, None]
    phase = rng.uniform(0.0, 2 * np.pi, (HARMONICS, 1))
    slow = _sines(t, w[:3], phase[:3], 1.0 / w[:3])
    fast = _sines(t, w[3:], phase[3:], 1.6 / w[3:])
    first = float(rng.uniform(0.0, 2 * np.pi))
    return slow + _swell(t, fast, 2 * np.pi / PERIOD, first)


def _sines(t: FloatArray, w: FloatArray, phase: FloatArray, size: FloatArray) -> FloatArray:
    """Sum of size sin(w t + phase) and its two derivatives, (3, n)."""
    angle = w * t + phase
    s, c = np.sin(angle), np.cos(angle)
    return np.stack([(size * s).sum(0), (size * w * c).sum(0), -(size * w**2 * s).sum(0)])


def _swell(t: FloatArray, x: FloatArray, w: float, phase: float) -> FloatArray:
    """(1 - cos(w t + phase)) / 2 times x, with both derivatives, (3, n)."""
    e = (1.0 - np.cos(w * t + phase)) / 2
    e1, e2 = w * np.sin(w * t + phase) / 2, w * w * np.cos(w * t + phase) / 2
    return np.stack([e * x[0], e1 * x[0] + e * x[1], e2 * x[0] + 2 * e1 * x[1] + e * x[2]])


def _strokes(rng: np.random.Generator, t: FloatArray) -> FloatArray:
    """Minimum-jerk strokes of 0.3 to 2.5 s with short rests, and twelve sines on top, (3, n)."""
    out, now, at = np.zeros((3, t.size)), 0.0, 0.0
    while now < t[-1]:
        goal = rng.uniform(-1.0, 1.0)
        length = max(0.3 * (2.5 / 0.3) ** rng.uniform(), 0.5 * abs(goal - at))
        rest = rng.uniform(0.0, 0.3)
        u = np.clip((t - now) / length, 0.0, 1.0)
        inside = (t >= now) & (t < now + length + rest)
        step = goal - at
        # at + step (10 u^3 - 15 u^4 + 6 u^5)
        out[0, inside] = (at + step * (10 * u**3 - 15 * u**4 + 6 * u**5))[inside]
        out[1, inside] = (step / length * 30 * u**2 * (1 - u) ** 2)[inside]
        out[2, inside] = (step / length**2 * 60 * u * (1 - u) * (1 - 2 * u))[inside]
        now, at = now + length + rest, goal
    w = 2 * np.pi * 0.15 * (2.3 / 0.15) ** rng.uniform(0.0, 1.0, (12, 1))
    phase = rng.uniform(0.0, 2 * np.pi, (12, 1))
    return out + _sines(t, w, phase, 0.1 / (1.0 + w / 3.0))


def push(seed: int) -> FloatArray:
    """Force ON the tip in the base frame (n, 3) [N]: eight sines of 0.1 to 2.5 Hz, 0.3 N rms."""
    rng = np.random.default_rng([seed, 0xF0])
    t: FloatArray = TICK * np.arange(round(SECONDS / TICK), dtype=np.float64)
    out = np.zeros((t.size, 3))
    for k in range(3):
        w = 2 * np.pi * 0.1 * 25.0 ** rng.uniform(0.0, 1.0, (8, 1))
        out[:, k] = _sines(t, w, rng.uniform(0.0, 2 * np.pi, (8, 1)), np.ones((8, 1)))[0]
    return np.asarray(0.3 * out / np.sqrt(np.mean(out**2, 0)) * np.minimum(1.0, t / 2)[:, None])
