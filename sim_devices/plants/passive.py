"""Torques that need no motor: springs, umbilical, end stops, and three that no model holds."""

from __future__ import annotations

from math import exp, fabs, pi, sin, tanh
from typing import Any

import numba as nb


@nb.njit(cache=True, nogil=True, error_model="numpy")
def torque(p: Any, x: Any, i: int, dt: float) -> float:
    """Passive torque [N m] on link i."""
    q, v = x.q[i], x.v[i]
    total = 0.0
    if p.spring[i] != 0.0:
        # over-centre spring: -k sin(q - q0)
        total = -p.spring[i] * sin(q - p.spring_rest[i])
    if p.umbilical[i] != 0.0:
        # a cable that stiffens to one side and has a kink
        d = q - p.umbilical_at[i]
        total -= p.umbilical[i] * (tanh(4.0 * d) + 0.8 * exp(-((d - 0.2) ** 2) / 0.03))
    if p.stop[i] != 0.0 and q > p.stop_at[i]:
        # rubber: k d^1.5 (1 + c v), never pulling
        total -= max(0.0, p.stop[i] * (q - p.stop_at[i]) ** 1.5 * (1.0 + 0.15 * v))
    return float(total + outside(p, x, i, dt))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def outside(p: Any, x: Any, i: int, dt: float) -> float:
    """Effects of no catalogue [N m] on link i: speed product, speed-dependent resonance."""
    a, b = (i + 1) % 3, (i + 2) % 3
    total = -p.product[i] * x.v[a] * x.v[b]
    if p.resonance[i] != 0.0:
        # damping that lives in a band: x'' + 0.3 w x' + w^2 x = v, torque -0.3 w A x',
        # w = 2 pi 2 (1 + |v|)
        w = 2.0 * pi * 2.0 * (1.0 + fabs(x.v[i]))
        x.ring[i, 1] += dt * (x.v[i] - w * w * x.ring[i, 0] - 0.3 * w * x.ring[i, 1])
        x.ring[i, 0] += dt * x.ring[i, 1]
        total -= p.resonance[i] * 0.3 * w * x.ring[i, 1]
    return float(total)
