"""Motion of a simulated arm, compiled: articulated bodies, drives, friction.

Featherstone, Rigid Body Dynamics Algorithms (2008), table 7.1, in frames of the bodies, with the
rotor of a drive on the axis of its joint.  Friction is four Maxwell elements a joint, whose level
falls by a rational Stribeck curve; the viscous part thins with speed.  The library's models have
none of these forms.
"""

from __future__ import annotations

from math import cos, exp, fabs, sin, sqrt
from typing import Any

import numba as nb
import numpy as np

from hil.sim_devices.joints import touch
from hil.sim_devices.plants.friction import slip
from hil.sim_devices.plants.layout import ELEMENTS

#: Numbers of scratch a body: transform, articulated inertia (6, 6), then v, c, p, U, a (6).
_F = np.float64
#: Parameters of a joint.  The last row is zero unless a hidden effect is put in.
JOINT = np.dtype([
    ("rotor", _F), ("coulomb", _F), ("viscous", _F), ("thin", _F),
    ("limit", _F, (ELEMENTS,)), ("weight", _F, (ELEMENTS,)),
    ("lag", _F), ("top", _F), ("noise", _F), ("code", _F), ("count", _F), ("rate", _F),
    ("stribeck", _F), ("stribeck_speed", _F), ("drag", _F), ("slope", _F), ("cogging", _F),
    ("cogging_cycles", _F), ("spring", _F), ("spring_rest", _F), ("gain", _F),
])  # fmt: skip
#: State of a joint.
STATE = np.dtype([
    ("q", _F), ("v", _F), ("drive", _F), ("low", _F), ("z", _F, (ELEMENTS,)),
])  # fmt: skip


@nb.njit(cache=True, nogil=True, error_model="numpy")
def frames(b: Any, q: Any, x: Any) -> None:
    """Transforms (d, 6, 6) of motion from each parent to its body."""
    parent, turn, place, axis, slides, _ = b
    for i in range(parent.size):
        # Rodrigues: R = 1 + sin K + (1 - cos) K^2 about the axis
        s, c = (0.0, 1.0) if slides[i] else (sin(q[i]), cos(q[i]))
        u = axis[i]
        way = q[i] if slides[i] else 0.0
        for r in range(3):
            for k in range(3):
                total = 0.0
                for m in range(3):
                    # own[m, r] = turn column by column, transposed: E = (turn R)^T
                    own = (1.0 - c) * u[m] * u[r] + (c if m == r else 0.0)
                    if m != r:
                        n = 3 - m - r
                        sign = 1.0 if (m - r) % 3 == 1 else -1.0
                        own += sign * s * u[n]
                    total += turn[i, k, m] * own
                x[i, r, k] = total
                x[i, 3 + r, 3 + k] = total
                x[i, r, 3 + k] = 0.0
        p0 = place[i, 0] + way * (
            turn[i, 0, 0] * u[0] + turn[i, 0, 1] * u[1] + turn[i, 0, 2] * u[2]
        )
        p1 = place[i, 1] + way * (
            turn[i, 1, 0] * u[0] + turn[i, 1, 1] * u[1] + turn[i, 1, 2] * u[2]
        )
        p2 = place[i, 2] + way * (
            turn[i, 2, 0] * u[0] + turn[i, 2, 1] * u[1] + turn[i, 2, 2] * u[2]
        )
        for r in range(3):
            e0, e1, e2 = x[i, r, 0], x[i, r, 1], x[i, r, 2]
            # -E [p]x
            x[i, 3 + r, 0] = -(e1 * p2 - e2 * p1)
            x[i, 3 + r, 1] = -(e2 * p0 - e0 * p2)
            x[i, 3 + r, 2] = -(e0 * p1 - e1 * p0)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def crossed(v: Any, m: Any, sign: float, out: Any) -> None:
    """V x m of motions (sign 1), or v x* f of a force (sign -1), into `out` (6,)."""
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        ww = v[i] * m[j] - v[j] * m[i]
        wl = v[i] * m[3 + j] - v[j] * m[3 + i]
        if sign > 0.0:
            out[k] = ww
            out[3 + k] = wl + v[3 + i] * m[j] - v[3 + j] * m[i]
        else:
            out[k] = ww + v[3 + i] * m[3 + j] - v[3 + j] * m[3 + i]
            out[3 + k] = wl


@nb.njit(cache=True, nogil=True, error_model="numpy")
def accelerations(
    b: Any, rotor: Any, weight: float, q: Any, qd: Any, tau: Any, room: Any, qdd: Any
) -> None:
    """Joint accelerations into `qdd` (d,) under efforts `tau` (d,).

    Parameters
    ----------
    b : tuple
        Fields of `hil.sim_devices.joints.bodies.Bodies`.
    rotor : ndarray (d,)
        Inertia of each drive at its joint [kg m^2 or kg].
    weight : float
        [m/s^2], along -z of the base.
    room : tuple
        From `scratch`.
    """
    outward(b, q, qd, room)
    inward(b, rotor, weight, tau, room, qdd)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def outward(b: Any, q: Any, qd: Any, room: Any) -> None:
    """Transforms, speeds and inertias of the bodies, and the forces of their own motion."""
    parent, _, _, axis, slides, inertia = b
    x, ia, vec, work = room
    d = parent.size
    frames(b, q, x)
    for i in range(d):
        v, c, p = vec[i, 0], vec[i, 1], vec[i, 2]
        first = 3 if slides[i] else 0
        for r in range(6):
            v[r] = 0.0
            if parent[i] >= 0:
                for k in range(6):
                    v[r] += x[i, r, k] * vec[parent[i], 0, k]
            work[r] = 0.0
        for k in range(3):
            work[first + k] = axis[i, k] * qd[i]
            v[first + k] += work[first + k]
        crossed(v, work, 1.0, c)
        for r in range(6):
            work[r] = 0.0
            for k in range(6):
                ia[i, r, k] = inertia[i, r, k]
                work[r] += inertia[i, r, k] * v[k]
        crossed(v, work, -1.0, p)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def inward(b: Any, rotor: Any, weight: float, tau: Any, room: Any, qdd: Any) -> None:
    """Articulated inertias from the tip to the base, accelerations back out, after `outward`."""
    parent, _, _, axis, slides, _ = b
    x, ia, vec, work = room
    d = parent.size
    for i in range(d - 1, -1, -1):
        c, p, u = vec[i, 1], vec[i, 2], vec[i, 3]
        first = 3 if slides[i] else 0
        # U = IA S, D = S^T U + rotor, u = tau - S^T pA
        top, left = rotor[i], tau[i]
        for r in range(6):
            u[r] = 0.0
            for k in range(3):
                u[r] += ia[i, r, first + k] * axis[i, k]
        for k in range(3):
            top += axis[i, k] * u[first + k]
            left -= axis[i, k] * p[first + k]
        vec[i, 5, 0], vec[i, 5, 1] = top, left
        h = parent[i]
        if h < 0:
            continue
        for r in range(6):
            for k in range(6):
                ia[i, r, k] -= u[r] * u[k] / top
        for r in range(6):
            work[r] = p[r] + u[r] * left / top
            for k in range(6):
                work[r] += ia[i, r, k] * c[k]
        # IA_parent += X^T Ia X, pA_parent += X^T pa
        for r in range(6):
            for k in range(6):
                total = 0.0
                for m in range(6):
                    total += ia[i, r, m] * x[i, m, k]
                vec[d + r, 0, k] = total
        for r in range(6):
            for m in range(6):
                vec[h, 2, r] += x[i, m, r] * work[m]
                for k in range(6):
                    ia[h, r, k] += x[i, m, r] * vec[d + m, 0, k]
    for i in range(d):
        c, u, a = vec[i, 1], vec[i, 3], vec[i, 4]
        first = 3 if slides[i] else 0
        left = vec[i, 5, 1]
        for r in range(6):
            # the base accelerates upwards instead of a weight on every body
            a[r] = c[r] + (x[i, r, 5] * weight if parent[i] < 0 else 0.0)
            if parent[i] >= 0:
                for k in range(6):
                    a[r] += x[i, r, k] * vec[parent[i], 4, k]
            left -= u[r] * a[r]
        qdd[i] = left / vec[i, 5, 0]
        for k in range(3):
            a[first + k] += axis[i, k] * qdd[i]


def scratch(d: int) -> tuple[Any, ...]:
    """Room for `accelerations` of d bodies."""
    return np.zeros((d, 6, 6)), np.zeros((d, 6, 6)), np.zeros((d + 6, 6, 6)), np.zeros(6)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def friction(p: Any, x: Any, dt: float) -> float:
    """Friction of one joint [N m or N]."""
    w = x.v / p.stribeck_speed if p.stribeck != 0.0 else 0.0
    level = p.coulomb + p.stribeck / (1.0 + w * w)
    torque = level * slip(x.z, p.limit, p.weight, x.v, dt)
    torque += p.viscous * x.v / (1.0 + fabs(x.v) / p.thin) ** 0.25
    return float(torque + p.drag * fabs(x.v) * x.v)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def pushed(p: Any, x: Any, code: int, dt: float) -> float:
    """Torque of one drive with what hides in it [N m or N]."""
    wanted = min(max(code * p.code, -p.top), p.top)
    x.drive += (wanted - x.drive) * (1.0 - exp(-dt / p.lag))
    torque = (1.0 + p.gain) * x.drive + p.noise * x.low
    torque += p.cogging * (
        sin(p.cogging_cycles * x.q) + 0.4 * sin(2.0 * p.cogging_cycles * x.q + 0.7)
    )
    return float(torque - p.spring * (x.q - p.spring_rest))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def run(
    b: Any,
    p: Any,
    x: Any,
    room: Any,
    rotor: Any,
    codes: Any,
    random: Any,
    weight: float,
    span: float,
    n: int,
    met: Any,
    met_room: Any,
) -> None:
    """Advance an arm by `span` [s] in `n` steps.

    Parameters
    ----------
    p, x : structured arrays (d,)
        `JOINT` and `STATE`.
    codes : ndarray (d,)
        Efforts in half steps of the drives.
    random : ndarray (d,)
        Standard normal numbers.
    met, met_room : structured record, ndarray
        What touches the arm (`hil.sim_devices.joints.touch`), and room for it.
    """
    q, qd, tau, qdd = room[4], room[5], room[6], room[7]
    dt, d = span / n, p.size
    keep = exp(-60.0 * span)
    for i in range(d):
        x[i].low = keep * x[i].low + sqrt(1.0 - keep * keep) * random[i]
    for _ in range(n):
        for i in range(d):
            q[i], qd[i] = x[i].q, x[i].v
            tau[i] = pushed(p[i], x[i], codes[i], dt) - friction(p[i], x[i], dt)
        outward(b, q, qd, room[:4])
        if met.any:
            touch.act(b, room[0], room[2], met, dt, met_room)
        inward(b, rotor, weight, tau, room[:4], qdd)
        for i in range(d):
            x[i].v += dt * qdd[i]
            x[i].q += dt * x[i].v
