"""The whole session in one compiled loop: encoders, control law, DAC, drive, plant."""

from __future__ import annotations

from math import cos, fabs, floor, sin, tanh
from typing import Any

import numba as nb
import numpy as np

from hil.sim_devices.fast import laws
from hil.sim_devices.plants import arm, drive, friction, passive


@nb.njit(cache=True, nogil=True)
def substep(p: Any, x: Any, t: float, elapsed: float, tick: float, dt: float, link: Any) -> None:
    """Semi-implicit Euler step of motors, cables and links; `link` (3,) is scratch [N m]."""
    for i in range(3):
        pull = laws.cable(p, x, i)
        x.sm[i] = friction.direction(p, x, i, dt)
        link[i] = pull - friction.link_side(p, x, i, dt) + passive.torque(p, x, i, dt)
        link[i] += laws.link_torque(p, x, i, t, dt)
        x.heat[i] += dt * (fabs(x.vm[i]) - x.heat[i]) / p.warming_time
        push = laws.motor_torque(p, x, i, elapsed, tick, dt) - pull
        push -= friction.motor_side(p, x, i, pull) + laws.motor_friction(p, x, i, t, pull, dt)
        x.vm[i] += dt * push / p.rotor[i]
    laws.idlers(p, x, link, dt)
    arm.push_links(p, x, link, dt)
    if p.locked == 1:
        x.v[1:], x.vm[1:] = 0.0, 0.0
    for i in range(3):
        x.qm[i] += dt * x.vm[i]
        x.q[i] += dt * x.v[i]


@nb.njit(cache=True, nogil=True)
def control(p: Any, r: Any, q: Any, v: Any, gains: Any, codes: Any) -> None:
    """PD to the reference `r` (3, 3) with nominal torques fed forward, rounded to DAC codes.

    u = K (r - q) + D (r' - v) + I r'' + Fc tanh(r' / 0.02) + g(q)
    """
    for i in range(3):
        u = gains[0, i] * (r[i, 0] - q[i]) + gains[1, i] * (r[i, 1] - v[i])
        u += gains[3, i] * r[i, 2] + gains[4, i] * tanh(r[i, 1] / 0.02)
        u += gains[2, i] * (cos(q[i]) if i == 1 else sin(q[i]))
        top = floor(p.torque_max[i] / p.dac[i])
        codes[i] = min(max(floor(u / p.dac[i] + 0.5), -top), top)


@nb.njit(cache=True, nogil=True)
def run(
    p: Any,
    x: Any,
    reference: Any,
    gains: Any,
    share: float,
    push: Any,
    random: Any,
    tick: float,
    substeps: int,
    out: Any,
) -> None:
    """Run a session of n ticks.

    Parameters
    ----------
    p, x : records of `layout.ARM` and `layout.STATE`
        Parameters and state.
    reference : ndarray (n, 3, 3)
        Place [rad], speed [rad/s] and acceleration [rad/s^2] of every joint.
    gains : ndarray (5, 3)
        Stiffness, damping, nominal gravity, inertia, Coulomb friction.
    share : float
        Share of the first-order filter on the speed, per tick.
    push : ndarray (n, 3)
        Force ON the tip, base frame [N].
    random : ndarray (n, NOISES)
        Standard normal numbers.
    tick : float
        Period of the loop [s], in `substeps` steps of the plant.
    out : ndarray (n, 9)
        Written: measured positions [rad] and speeds [rad/s], efforts sent [N m].
    """
    dt = tick / substeps
    q, v, codes, link = np.zeros(3), np.zeros(3), np.zeros(3, np.int64), np.zeros(3)
    for k in range(reference.shape[0]):
        for i in range(3):
            count = floor((laws.shaft(p, x, i)) * p.encoder[i] + x.lost[i])
            place = (count + 0.5) / p.encoder[i]
            if k > 0:
                v[i] += share * ((place - q[i]) / tick - v[i])
            q[i] = place
        control(p, reference[k], q, v, gains, codes)
        for i in range(3):
            out[k, i], out[k, 3 + i], out[k, 6 + i] = q[i], v[i], codes[i] * p.dac[i]
        laws.chance(p, x, random[k], tick)
        drive.command(p, x, codes, random[k], tick)
        x.force[:] = push[k]
        for n in range(substeps):
            if n == 0:
                arm.tip(p, x)
            substep(p, x, k * tick + n * dt, n * dt, tick, dt, link)
