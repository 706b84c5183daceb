"""Friction of one joint: parallel Maxwell-slip elements and what modulates their level.

Al-Bender, Lampaert & Swevers, IEEE Trans. Autom. Control 50(11) 2005 (generalised Maxwell
slip).  The library's models use other forms: sgn or tanh signs, exponential Stribeck curve.
"""

from __future__ import annotations

from math import cos, expm1, fabs, pi, sqrt, tanh
from typing import Any

import numba as nb

from hil.sim_devices.plants.layout import ELEMENTS


@nb.njit(cache=True, nogil=True, error_model="numpy")
def slip(z: Any, limit: Any, weight: Any, v: float, dt: float) -> float:
    """Advance the elements `z` [rad] by v dt; return the friction state in -1..1."""
    total = 0.0
    for k in range(ELEMENTS):
        # z' = v while |z| < limit: each spring sticks, then slips at its limit
        deflection = z[k] + v * dt
        if deflection > limit[k]:
            deflection = limit[k]
        elif deflection < -limit[k]:
            deflection = -limit[k]
        z[k] = deflection
        total += weight[k] * deflection / limit[k]
    return total


@nb.njit(cache=True, nogil=True, error_model="numpy")
def direction(p: Any, x: Any, i: int, dt: float) -> float:
    """Friction state -1..1 of motor i: creeping in grease, or Maxwell slip."""
    if p.creep[i] > 0.0:
        # v / sqrt(v^2 + vc^2)
        return float(x.vm[i] / sqrt(x.vm[i] ** 2 + p.creep[i] ** 2))
    return float(slip(x.zm[i], p.slip_motor[i], p.weight, x.vm[i], dt))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def motor_side(p: Any, x: Any, i: int, tension: float) -> float:
    """Friction torque [N m] on motor i; `tension` is the torque that its cable carries [N m]."""
    v, s = x.vm[i], x.sm[i]
    level = p.coulomb_motor[i] * (1.0 - p.warming * x.heat[i])
    if p.stribeck[i] != 0.0:
        # rational Stribeck curve: Fs / (1 + (v/vs)^2)
        w = v / p.stribeck_speed[i]
        level += p.stribeck[i] / (1.0 + w * w)
    if p.eccentric[i] != 0.0:
        # eccentric pulley: cos a / (1 + 0.4 cos a), not a pure sine
        c = cos(2.0 * pi * x.qm[i] / p.eccentric_period[i] + p.eccentric_phase[i])
        level += p.eccentric[i] * c / (1.0 + 0.4 * c)
    if p.capstan[i] != 0.0:
        # capstan law: T (e^(mu beta) - 1)
        level += fabs(tension) * expm1(p.capstan[i])
    viscous = p.viscous_motor[i]
    if p.asym_viscous[i] != 0.0:
        viscous += p.asym_viscous[i] * tanh(v / 0.08)
    torque = level * s + viscous * v
    # one direction rubs harder: vanishes while the elements turn round
    torque += p.asym_coulomb[i] * s * s
    if p.drag[i] != 0.0:
        torque += p.drag[i] * fabs(v) ** 0.8 * v
    for j in range(3):
        torque += p.couple[i, j] * x.sm[j]
    return float(torque + x.bang * p.burst[i] * s)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def link_side(p: Any, x: Any, i: int, dt: float) -> float:
    """Friction torque [N m] in the bearing of link i."""
    s = slip(x.zl[i], p.slip_link[i], p.weight, x.v[i], dt)
    return float(p.coulomb_link[i] * s + p.viscous_link[i] * x.v[i])
