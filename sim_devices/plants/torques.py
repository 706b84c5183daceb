"""What acts on one joint: its drive, friction on both sides, and torques that need no motor.

The drive goes from a DAC code to torque on the rotor: delay line, amplifier lag, gain, cogging,
noise.  Friction is made of parallel Maxwell-slip elements and of what modulates their level:
Al-Bender, Lampaert & Swevers, IEEE Trans. Autom. Control 50(11) 2005 (generalised Maxwell slip).
The library's models use other forms: sgn or tanh signs, exponential Stribeck curve.  Without a
motor act springs, umbilical, end stops, and three that no model holds.
"""

from __future__ import annotations

from math import cos, exp, expm1, fabs, pi, sin, sqrt, tanh
from typing import Any

import numba as nb

from hil.sim_devices.plants.layout import ELEMENTS, HISTORY


@nb.njit(cache=True, nogil=True, error_model="numpy")
def command(p: Any, x: Any, codes: Any, random: Any, dt: float) -> None:
    """Take the DAC `codes` (3,) of a tick of length `dt` [s] and draw its disturbances."""
    x.head = (x.head + 1) % HISTORY
    for i in range(3):
        torque = codes[i] * p.dac[i]
        x.history[i, x.head] = min(max(torque, -p.torque_max[i]), p.torque_max[i])
        # AR(1): low <- a low + sqrt(1 - a^2) n, corner at noise_pole [rad/s]
        a = exp(-p.noise_pole * dt)
        x.low[i] = a * x.low[i] + sqrt(1.0 - a * a) * random[i]
        x.white[i] = random[3 + i]
    # rare bursts, three a second, that die within 80 ms
    x.bang *= exp(-dt / 0.08)
    if random[12] > 2.75:
        x.bang = 1.0 + 0.3 * random[13]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def motor(p: Any, x: Any, i: int, elapsed: float, tick: float, dt: float) -> float:
    """Torque [N m] of motor i at `elapsed` seconds into the tick, reflected to the joint."""
    return float(motor_by(p, x, i, elapsed, tick, motor_share(p, dt)))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def motor_share(p: Any, dt: float) -> float:
    """Share of a change of torque that the amplifier has made after `dt` [s]."""
    return 1.0 - exp(-dt / p.lag)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def motor_by(p: Any, x: Any, i: int, elapsed: float, tick: float, risen: float) -> float:
    """`motor` with the `motor_share` of a substep."""
    back = 0
    if p.delay[i] > elapsed:
        back = 1 + int((p.delay[i] - elapsed) / tick)
    wanted = x.history[i, (x.head - back) % HISTORY]
    # lag T' = (u - T) / tau, exact over one substep
    x.drive[i] += (wanted - x.drive[i]) * risen
    value = (1.0 + p.gain[i]) * x.drive[i]
    if p.cogging[i] != 0.0:
        phase = p.cogging_cycles[i] * x.qm[i]
        value += p.cogging[i] * (sin(phase) + 0.4 * sin(2.0 * phase + 0.7))
    return float(value + p.noise_low[i] * x.low[i] + p.noise_white[i] * x.white[i])


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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def passive(p: Any, x: Any, i: int, dt: float) -> float:
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
