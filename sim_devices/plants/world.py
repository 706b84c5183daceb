"""One tick of the whole bench, compiled: arms, drives, operators, gels, encoders and gauges.

th1 turntable, th2 upper link from the horizontal, th3 forearm from the base (0 = hanging).
Form of Cavusoglu, Feygin & Tendick, IEEE Trans. Robot. Autom. 18(6) 2002, with the sign of
C32 that conserves energy.

The drive of a joint goes from a DAC code to torque on the rotor: delay line, amplifier lag, gain,
cogging, noise.  Friction is made of parallel Maxwell-slip elements and of what modulates their
level: Al-Bender, Lampaert & Swevers, IEEE Trans. Autom. Control 50(11) 2005 (generalised Maxwell
slip).  The library's models use other forms: sgn or tanh signs, exponential Stribeck curve.
Without a motor act springs, umbilical, end stops, and three that no model holds.
"""

from __future__ import annotations

from math import cos, exp, expm1, fabs, floor, hypot, pi, sin, sqrt, tanh
from typing import Any

import numba as nb
import numpy as np

from hil.sim_devices.plants.layout import ELEMENTS, HISTORY, SINES


@nb.njit(cache=True, nogil=True, error_model="numpy")
def take_command(p: Any, x: Any, codes: Any, random: Any, dt: float) -> None:
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
def passive_force(p: Any, x: Any, i: int, dt: float) -> float:
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
    return float(total + uncatalogued_effects(p, x, i, dt))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def uncatalogued_effects(p: Any, x: Any, i: int, dt: float) -> float:
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _angles(x: Any) -> Any:
    """Sines and cosines of the joints: s1, c1, s2, c2, s3, c3."""
    return sin(x.q[0]), cos(x.q[0]), sin(x.q[1]), cos(x.q[1]), sin(x.q[2]), cos(x.q[2])


@nb.njit(cache=True, nogil=True, error_model="numpy")
def tip_state(p: Any, x: Any) -> None:
    """Tip position and velocity of the link side into `x.tip`, `x.tip_v`."""
    tip_at(p, x, _angles(x))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def tip_at(p: Any, x: Any, trig: Any) -> None:
    """`tip_state` with the `_angles` of now."""
    s1, c1, s2, c2, s3, c3 = trig
    # r = l1 cos th2 + l2 sin th3;  z = l1 sin th2 - l2 cos th3
    r = p.l1 * c2 + p.l2 * s3
    dr = -p.l1 * s2 * x.v[1] + p.l2 * c3 * x.v[2]
    x.tip[0] = r * c1
    x.tip[1] = r * s1
    x.tip[2] = p.l1 * s2 - p.l2 * c3
    x.tip_v[0] = dr * c1 - r * s1 * x.v[0]
    x.tip_v[1] = dr * s1 + r * c1 * x.v[0]
    x.tip_v[2] = p.l1 * c2 * x.v[1] + p.l2 * s3 * x.v[2]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def push_links(p: Any, x: Any, torque: Any, dt: float) -> None:
    """Advance the link velocities by `dt` under joint `torque` (3,) and `x.force` at the tip."""
    push_at(p, x, torque, dt, _angles(x))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def push_at(p: Any, x: Any, torque: Any, dt: float, trig: Any) -> None:
    """`push_links` with the `_angles` of now."""
    s1, c1, s2, c2, s3, c3 = trig
    s23, c23 = sin(x.q[1] - x.q[2]), cos(x.q[1] - x.q[2])
    v1, v2, v3 = x.v[0], x.v[1], x.v[2]
    # M11 = a + b cos 2th2 + c cos 2th3 + d cos th2 sin th3
    cc2, cc3 = c2 * c2 - s2 * s2, c3 * c3 - s3 * s3
    m11 = p.m11[0] + p.m11[1] * cc2 + p.m11[2] * cc3 + p.m11[3] * c2 * s3
    # dM11/dth2 = -2 e2, dM11/dth3 = -2 e3
    e2 = 2.0 * p.m11[1] * s2 * c2 + 0.5 * p.m11[3] * s2 * s3
    e3 = 2.0 * p.m11[2] * s3 * c3 - 0.5 * p.m11[3] * c2 * c3
    # tip force: J^T f in the (turn, radial, vertical) frame
    r = p.l1 * c2 + p.l2 * s3
    radial = c1 * x.force[0] + s1 * x.force[1]
    across = -s1 * x.force[0] + c1 * x.force[1]
    f2 = -p.l1 * s2 * radial + p.l1 * c2 * x.force[2]
    f3 = p.l2 * c3 * radial + p.l2 * s3 * x.force[2]
    # M v' = torque + J^T f - C v - N
    b1 = torque[0] + r * across + 2.0 * (e2 * v2 + e3 * v3) * v1
    b2 = torque[1] + f2 - e2 * v1 * v1 - p.m23 * c23 * v3 * v3 - p.g2 * c2
    b3 = torque[2] + f3 - e3 * v1 * v1 + p.m23 * c23 * v2 * v2 - p.g3 * s3
    m23 = -p.m23 * s23
    det = p.m22 * p.m33 - m23 * m23
    x.v[0] += dt * b1 / m11
    x.v[1] += dt * (p.m33 * b2 - m23 * b3) / det
    x.v[2] += dt * (p.m22 * b3 - m23 * b2) / det


# Gel under the tip: Hunt-Crossley with one Maxwell arm and wet lateral drag.
#
# Hunt & Crossley, J. Appl. Mech. 42(2) 1975.  The surface is the plane z = `surface`.  A bolt along
# x below the surface stiffens the layer above it, U = k d^(n+1) / (n+1) (1 + a g(y)) with
# g = exp(-(y - y0)^2 / 2 w^2); what its flank pushes sideways is -dU/dy.


@nb.njit(cache=True, nogil=True, error_model="numpy")
def press_gel(gel: Any, x: Any, dt: float) -> None:
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
def _substep(
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
        `motor_share` of the step.
    trig : tuple
        `_angles` of now.
    """
    for i in range(3):
        stretch = x.qm[i] - x.q[i]
        # cable: k (qm - q) + D (vm - v), D not proportional to k
        pull = p.cable[i] * stretch
        for j in range(3):
            pull += p.cable_damping[i, j] * (x.vm[j] - x.v[j])
        x.sm[i] = direction(p, x, i, dt)
        link[i] = pull - link_side(p, x, i, dt) + passive_force(p, x, i, dt)
        x.heat[i] += dt * (fabs(x.vm[i]) - x.heat[i]) / p.warming_time
        push = motor_by(p, x, i, elapsed, tick, risen) - pull
        x.vm[i] += dt * (push - motor_side(p, x, i, pull)) / p.rotor[i]
    push_at(p, x, link, dt, trig)
    for i in range(3):
        x.qm[i] += dt * x.vm[i]
        x.q[i] += dt * x.v[i]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def read_sensors(p: Any, x: Any, t: float, random: Any, counts: Any, gauges: Any) -> None:
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
def run_plant(
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
        take_command(pa, xa, codes[a], random[a], tick)
        aim(ha, t)
        risen = motor_share(pa, dt)
        for k in range(n):
            trig = _angles(xa)
            if k == 0 or ha.kind > 0 or ga.on > 0:
                tip_at(pa, xa, trig)
                xa.force[:] = 0.0
                if xa.parked == 0:
                    hold(ha, xa, dt)
                    if ga.on > 0:
                        press_gel(ga, xa, dt)
            if xa.parked == 0:
                _substep(pa, xa, k * dt, tick, dt, link, risen, trig)
        read_sensors(pa, xa, t + tick, random[a], counts[a], gauges[a])
