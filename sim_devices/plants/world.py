"""One tick of the whole bench, compiled: arms, operators, gels, encoders and gauges."""

from __future__ import annotations

from math import cos, exp, fabs, floor, hypot, sin, sqrt
from typing import Any

import numba as nb
import numpy as np

from hil.sim_devices.plants import arm, torques
from hil.sim_devices.plants.layout import SINES

# Gel under the tip: Hunt-Crossley with one Maxwell arm and wet lateral drag.
#
# Hunt & Crossley, J. Appl. Mech. 42(2) 1975.  The surface is the plane z = `surface`.  A bolt along
# x below the surface stiffens the layer above it, U = k d^(n+1) / (n+1) (1 + a g(y)) with
# g = exp(-(y - y0)^2 / 2 w^2); what its flank pushes sideways is -dU/dy.


@nb.njit(cache=True, nogil=True, error_model="numpy")
def press(gel: Any, x: Any, dt: float) -> None:
    """Add the gel's force [N] on the tip to `x.force`."""
    depth = gel.surface - x.tip[2]
    if depth <= 0.0:
        # free: the Maxwell arm relaxes
        gel.flow -= dt * gel.flow / gel.relaxation
        return
    rate = -x.tip_v[2]
    # f = k d^n (1 + 1.5 c d') + k b (d - flow),  flow' = (d - flow) / tau
    near = 0.0
    if gel.bolt > 0.0:
        off = (x.tip[1] - gel.bolt_y) / gel.bolt_width
        near = gel.bolt * exp(-0.5 * off * off)
        energy = gel.stiffness * depth ** (gel.power + 1.0) / (gel.power + 1.0)
        x.force[1] += energy * near * off / gel.bolt_width
    normal = gel.stiffness * depth**gel.power * (1.0 + 1.5 * gel.damping * rate) * (1.0 + near)
    normal += gel.branch * (depth - gel.flow)
    gel.flow += dt * (depth - gel.flow) / gel.relaxation
    if normal <= 0.0:
        return
    x.force[2] += normal
    speed = hypot(x.tip_v[0], x.tip_v[1]) + 1e-3
    for k in range(2):
        x.force[k] -= gel.drag * fabs(normal) * x.tip_v[k] / speed


# Who moves the leader: a hand (mass, arm and grip impedance, tremor), a machine that follows a
# path, or one that strokes along a path and presses down with a constant force.


@nb.njit(cache=True, nogil=True, error_model="numpy")
def aim(h: Any, t: float) -> None:
    """Where the operator wants the tip at time t [s]: a sum of sines about home."""
    if h.kind == 0:
        return
    ramp = min(1.0, t / h.onset)
    ramp = ramp * ramp * (3.0 - 2.0 * ramp)
    for k in range(3):
        place, speed = h.home[k], 0.0
        for n in range(SINES):
            angle = h.rate[k, n] * t + h.phase[k, n]
            place += ramp * h.size[k, n] * sin(angle)
            speed += ramp * h.size[k, n] * h.rate[k, n] * cos(angle)
        h.aim[k] = place
        h.aim_v[k] = speed
    if h.kind == 3:
        # in place of a height: the force downwards [N]
        h.aim[2], h.aim_v[2] = ramp * h.limit, 0.0


@nb.njit(cache=True, nogil=True, error_model="numpy")
def hold(h: Any, x: Any, dt: float) -> None:
    """Add the operator's force [N] on the tip to `x.force`; advances the hand by `dt`."""
    if h.kind == 1:
        for k in range(3):
            # grip between hand and tip; m x'' = arm spring and damper - grip
            grip = h.grip_k * (h.x[k] - x.tip[k]) + h.grip_b * (h.v[k] - x.tip_v[k])
            arm = h.arm_k * (h.aim[k] - h.x[k]) + h.arm_b * (h.aim_v[k] - h.v[k])
            h.v[k] += dt * (arm - grip) / h.mass
            h.x[k] += dt * h.v[k]
            h.aim[k] += dt * h.aim_v[k]
            x.force[k] += grip
    elif h.kind == 2:
        size, push = 0.0, h.x
        for k in range(3):
            # machine: PD to the aim, limited in norm
            push[k] = h.arm_k * (h.aim[k] - x.tip[k]) + h.arm_b * (h.aim_v[k] - x.tip_v[k])
            size += push[k] * push[k]
            h.aim[k] += dt * h.aim_v[k]
        scale = min(1.0, h.limit / (sqrt(size) + 1e-12))
        for k in range(3):
            x.force[k] += scale * push[k]
    elif h.kind == 3:
        for k in range(2):
            x.force[k] += h.arm_k * (h.aim[k] - x.tip[k]) + h.arm_b * (h.aim_v[k] - x.tip_v[k])
            h.aim[k] += dt * h.aim_v[k]
        x.force[2] -= h.aim[2] + h.arm_b * x.tip_v[2]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def substep(
    p: Any, x: Any, elapsed: float, tick: float, dt: float, link: Any, risen: float, trig: Any
) -> None:
    """Semi-implicit Euler step of motors, cables and links.

    Parameters
    ----------
    elapsed, tick, dt : float
        Time into the tick, lengths of the tick and of the step [s].
    link : ndarray (3,)
        Scratch [N m].
    risen : float
        `torques.motor_share` of the step.
    trig : tuple
        `arm.angles` of now.
    """
    for i in range(3):
        stretch = x.qm[i] - x.q[i]
        # cable: k (qm - q) + D (vm - v), D not proportional to k
        pull = p.cable[i] * stretch
        for j in range(3):
            pull += p.cable_damping[i, j] * (x.vm[j] - x.v[j])
        x.sm[i] = torques.direction(p, x, i, dt)
        link[i] = pull - torques.link_side(p, x, i, dt) + torques.passive(p, x, i, dt)
        x.heat[i] += dt * (fabs(x.vm[i]) - x.heat[i]) / p.warming_time
        push = torques.motor_by(p, x, i, elapsed, tick, risen) - pull
        x.vm[i] += dt * (push - torques.motor_side(p, x, i, pull)) / p.rotor[i]
    arm.push_at(p, x, link, dt, trig)
    for i in range(3):
        x.qm[i] += dt * x.vm[i]
        x.q[i] += dt * x.v[i]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def sense(p: Any, x: Any, t: float, random: Any, counts: Any, gauges: Any) -> None:
    """Quadrature counts (3,) of the motor encoders and gauge words (6,) of the sensor."""
    for i in range(3):
        counts[i] = floor(x.qm[i] * p.encoder[i])
    s1, c1, s3, c3 = sin(x.q[0]), cos(x.q[0]), sin(x.q[2]), cos(x.q[2])
    radial = c1 * x.force[0] + s1 * x.force[1]
    # sensor axes: x normal to the forearm, y across, z along it and outwards
    fx = c3 * radial + s3 * x.force[2]
    fy = s1 * x.force[0] - c1 * x.force[1]
    fz = s3 * radial - c3 * x.force[2]
    for k in range(6):
        word = p.gauge[k, 0] * fx + p.gauge[k, 1] * fy + p.gauge[k, 2] * fz
        word += p.gauge_bias[k] + p.gauge_drift[k] * t + p.gauge_noise * random[6 + k]
        gauges[k] = int(min(max(floor(word + 0.5), -32768.0), 32767.0))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def run(
    p: Any,
    x: Any,
    h: Any,
    g: Any,
    t: float,
    tick: float,
    n: int,
    codes: Any,
    random: Any,
    counts: Any,
    gauges: Any,
) -> None:
    """Advance every arm by one `tick` [s] in `n` substeps.

    Parameters
    ----------
    p, x, h, g : structured arrays (arms,)
        Parameters, state, operator and gel of every arm (`layout`).
    t, tick : float
        Time at the start and length of the tick [s].
    n : int
        Substeps.
    codes : ndarray (arms, 3)
        DAC codes; `random` (arms, NOISES) standard normal numbers.
    counts, gauges : ndarray (arms, 3), (arms, 6)
        Written: what the devices answer at the end of the tick.
    """
    dt = tick / n
    link = np.zeros(3)
    for a in range(p.shape[0]):
        pa, xa, ha, ga = p[a], x[a], h[a], g[a]
        torques.command(pa, xa, codes[a], random[a], tick)
        aim(ha, t)
        risen = torques.motor_share(pa, dt)
        for k in range(n):
            trig = arm.angles(xa)
            if k == 0 or ha.kind > 0 or ga.on > 0:
                arm.tip_at(pa, xa, trig)
                xa.force[:] = 0.0
                if xa.parked == 0:
                    hold(ha, xa, dt)
                    if ga.on > 0:
                        press(ga, xa, dt)
            if xa.parked == 0:
                substep(pa, xa, k * dt, tick, dt, link, risen, trig)
        sense(pa, xa, t + tick, random[a], counts[a], gauges[a])
