"""Further hidden laws, compiled; each is of another form than the library's of that name."""

from __future__ import annotations

from math import asin, cos, exp, fabs, pi, sin, sqrt, tanh
from typing import Any

import numba as nb

from hil.sim_devices.plants import drive, friction

#: Load at which the exponent of the load friction is normalised [N m].
LOAD = 0.05
#: Mean of exp(1.2 sin x) over a turn: the Bessel function I0(1.2).
MEAN_HUM = 1.3937
#: Idler: inertia [kg m^2], shaft stiffness [N m/rad] and damping [N m s/rad].
IDLER, SHAFT, SHAFT_DAMPING = 2e-5, 20.0, 0.02


@nb.njit(cache=True, nogil=True)
def cable(p: Any, x: Any, i: int) -> float:
    """Torque [N m] that the cable of joint i carries: compliance, softness at zero, dead zone."""
    stretch = x.qm[i] - x.q[i]
    if p.slack[i] > 0.0:
        # nothing is carried within the gap, neither by the spring nor by its damper
        half = 0.5 * p.slack[i]
        if stretch > half:
            stretch -= half
        elif stretch < -half:
            stretch += half
        else:
            return 0.0
    # 1/k' = 1/k + give
    pull = p.cable[i] * stretch / (1.0 + p.cable[i] * p.give[i])
    if p.soft[i] > 0.0:
        # k' = k (1 + w^2) / (1 + soft + w^2), w = stretch / soft_at
        w = stretch / p.soft_at[i]
        pull *= (1.0 + w * w) / (1.0 + p.soft[i] + w * w)
    for j in range(3):
        pull += p.cable_damping[i, j] * (x.vm[j] - x.v[j])
    return float(pull)


@nb.njit(cache=True, nogil=True)
def motor_torque(p: Any, x: Any, i: int, elapsed: float, tick: float, dt: float) -> float:
    """Torque [N m] of motor i: the plant's drive, a second-order lag, ripple and detents."""
    value = drive.torque(p, x, i, elapsed, tick, dt)
    fed = x.drive[i]
    if p.slow_drive[i] > 0.0:
        # T^2 u'' + 1.4 T u' + u = drive
        w = 1.0 / p.slow_drive[i]
        x.slow[i, 1] += dt * (w * w * (fed - x.slow[i, 0]) - 1.4 * w * x.slow[i, 1])
        x.slow[i, 0] += dt * x.slow[i, 1]
        value += (1.0 + p.gain[i]) * (x.slow[i, 0] - fed)
        fed = x.slow[i, 0]
    if p.ripple[i] != 0.0:
        # commutation: |cos(phase / 2)| less its mean, times the torque
        value += p.ripple[i] * fed * (fabs(cos(0.5 * p.ripple_cycles[i] * x.qm[i])) - 2.0 / pi)
    if p.choke[i] != 0.0:
        # beyond L a tenth of what is asked for comes through, by a knee of L / 20
        beyond = fabs(fed) - 1.0 / p.choke[i]
        if beyond > 0.0:
            most = 0.9 * (beyond - 0.05 / p.choke[i] * tanh(20.0 * beyond * p.choke[i]))
            value -= most if fed > 0.0 else -most
    if p.leak[i] != 0.0:
        value += p.leak[i] * x.drive[(i + 1) % 3]
    if p.detent[i] != 0.0:
        # phase-modulated wave: all harmonics
        phase = p.detent_cycles[i] * x.qm[i]
        value += p.detent[i] * sin(phase + 0.4 * sin(phase) + 0.3)
    return float(value + p.offset[i])


@nb.njit(cache=True, nogil=True)
def motor_friction(p: Any, x: Any, i: int, t: float, tension: float, dt: float) -> float:
    """Further friction torque [N m] on motor i; `tension` is what its cable carries [N m]."""
    s, total = x.sm[i], 0.0
    if p.preslide[i] != 0.0:
        total += p.preslide[i] * friction.slip(x.zp[i], p.preslide_at[i], p.weight, x.vm[i], dt)
    if p.rub[i] != 0.0:
        # triangular over position
        total += p.rub[i] * s * asin(sin(p.rub_cycles[i] * x.qm[i] + 0.6)) * 2.0 / pi
    if p.load_rub[i] != 0.0:
        total += p.load_rub[i] * s * (fabs(tension) / LOAD) ** 1.3
    if p.fade[i] != 0.0:
        # friction lost while the grease warms up: t / (t + 8 s)
        total -= p.fade[i] * s * t / (t + 8.0)
    if p.thixotropy[i] != 0.0:
        # structure rebuilds at rest and is sheared away: l' = (1 - l) / 3 - 1.5 |v| l
        x.thick[i] += dt * ((1.0 - x.thick[i]) / 3.0 - 1.5 * fabs(x.vm[i]) * x.thick[i])
        total += p.thixotropy[i] * x.thick[i] * s
    return float(total + p.placed_viscous[i] * x.qm[i] * x.vm[i])


@nb.njit(cache=True, nogil=True)
def link_torque(p: Any, x: Any, i: int, t: float, dt: float) -> float:
    """Further torque [N m] on link i: oscillator, disturbances in time, pair of positions."""
    total = p.telegraph[i] * x.flip[i]
    if p.oscillator[i] != 0.0:
        # J (w^2 (phi - q) + 0.08 w (phi' - v)), and its reaction on the attached mass
        w = p.oscillator_rate[i]
        push = w * w * (x.osc[i, 0] - x.q[i]) + 0.08 * w * (x.osc[i, 1] - x.v[i])
        x.osc[i, 1] -= dt * push
        x.osc[i, 0] += dt * x.osc[i, 1]
        total += p.oscillator[i] * push
    if p.hum[i] != 0.0:
        total += p.hum[i] * (exp(1.2 * sin(p.hum_rate[i] * t)) - MEAN_HUM)
    if p.chirp[i] != 0.0:
        # 0.5 Hz rising by 0.2 Hz a second
        total += p.chirp[i] * sin(2.0 * pi * (0.5 + 0.1 * t) * t)
    if p.pair[i] != 0.0:
        total += p.pair[i] * sin(6.0 * x.q[(i + 1) % 3]) * cos(5.0 * x.q[(i + 2) % 3])
    return float(total)


@nb.njit(cache=True, nogil=True)
def idlers(p: Any, x: Any, link: Any, dt: float) -> None:
    """Idler wheels that turn with two joints, on soft shafts; adds to `link` (3,) [N m]."""
    for i in range(3):
        if p.idler[i] == 0.0:
            continue
        # pairs (1, 2), (2, 3), (1, 3)
        a = 0 if i == 2 else i
        b = 2 if i == 2 else i + 1
        twist = x.q[a] + x.q[b] - x.idle[i, 0]
        torque = SHAFT * twist + SHAFT_DAMPING * (x.v[a] + x.v[b] - x.idle[i, 1])
        s = friction.slip(x.idle_z[i], p.slip_link[a], p.weight, x.idle[i, 1], dt)
        x.idle[i, 1] += dt * (torque - p.idler[i] * (s + 0.1 * x.idle[i, 1])) / IDLER
        x.idle[i, 0] += dt * x.idle[i, 1]
        link[a] -= torque
        link[b] -= torque


@nb.njit(cache=True, nogil=True)
def chance(p: Any, x: Any, random: Any, tick: float) -> None:
    """What happens at random in a tick: jittered delay, lost counts, the telegraph's flips."""
    for i in range(3):
        if p.jitter[i] > 0.0:
            # 0.7..1.3 of the mean, new every tick
            p.delay[i] = p.jitter[i] * (1.0 + 0.3 * min(max(random[6 + i], -1.0), 1.0))
        if p.slips[i] != 0.0 and fabs(random[6 + i]) > 3.7:
            # a burst of counts lost, five or six times in 25 s, against the motion
            x.lost[i] -= p.slips[i] * (1.0 if x.vm[i] > 0.0 else -1.0)
        if p.telegraph[i] != 0.0 and fabs(random[9 + i]) > 3.4:
            x.flip[i] = -x.flip[i]


@nb.njit(cache=True, nogil=True)
def shaft(p: Any, x: Any, i: int) -> float:
    """What the encoder of motor i sees [rad]: its angle and its eccentric disc."""
    seen = float(x.qm[i])
    if p.wobble[i] != 0.0:
        phase = p.wobble_cycles[i] * x.qm[i]
        seen += p.wobble[i] * sin(phase + 0.5) / sqrt(1.0 + 0.5 * cos(phase))
    return seen
