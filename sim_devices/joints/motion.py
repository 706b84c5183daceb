"""Motion of a simulated arm: bodies read from a URDF; their motion, drives and friction, compiled.

The file is read here a second time, without the rigid-body library of the models; every body is off
the file by a seeded share.  Links behind fixed joints are part of the body that carries them.

Featherstone, Rigid Body Dynamics Algorithms (2008), table 7.1, in frames of the bodies, with the
rotor of a drive on the axis of its joint.  Friction is four Maxwell elements a joint, whose level
falls by a rational Stribeck curve; the viscous part thins with speed.  The library's models have
none of these forms.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from math import cos, exp, fabs, sin, sqrt
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.sim_devices.joints import touch
from hil.sim_devices.plants.layout import ELEMENTS
from hil.sim_devices.plants.world import slip

FloatArray = NDArray[np.float64]
#: How far a mass, a first moment or an inertia is off the file, either way.
_OFF = (0.05, 0.15)
#: Weight of a mass where the URDF says nothing [m/s^2], in axes of the base.
WEIGHT = (0.0, 0.0, -9.80665)


@dataclass
class Bodies:
    """Moving bodies, parents before children.

    Parameters
    ----------
    parent : ndarray (d,) of int
        Body that carries it; -1 the base.
    turn : ndarray (d, 3, 3)
        Axes of the joint's frame in those of its parent.
    place : ndarray (d, 3)
        Its origin there [m].
    axis : ndarray (d, 3)
        Unit vector of the joint.
    slides : ndarray (d,) of int
        1 where the joint slides.
    inertia : ndarray (d, 6, 6)
        Spatial inertia about the joint's origin, angular part first.
    """

    parent: NDArray[np.int64]
    turn: FloatArray
    place: FloatArray
    axis: FloatArray
    slides: NDArray[np.int64]
    inertia: FloatArray


def _numbers(element: ET.Element | None, key: str, default: tuple[float, ...]) -> FloatArray:
    text = element.get(key) if element is not None else None
    return np.array([float(x) for x in text.split()] if text else default)


def _pose(element: ET.Element | None) -> tuple[FloatArray, FloatArray]:
    """Rotation and place of an ``<origin>``."""
    place, (r, p, y) = _numbers(element, "xyz", (0.0,) * 3), _numbers(element, "rpy", (0.0,) * 3)
    yaw = np.array([[cos(y), -sin(y), 0], [sin(y), cos(y), 0], [0, 0, 1.0]])
    pitch = np.array([[cos(p), 0, sin(p)], [0, 1.0, 0], [-sin(p), 0, cos(p)]])
    roll = np.array([[1.0, 0, 0], [0, cos(r), -sin(r)], [0, sin(r), cos(r)]])
    return yaw @ pitch @ roll, place


def _cross(v: FloatArray) -> FloatArray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def solid(mass: float, center: FloatArray, about_center: FloatArray) -> FloatArray:
    """Spatial inertia (6, 6) about the origin of a body with its centre of mass at `center`."""
    c = _cross(center)
    top = np.hstack([about_center + mass * c @ c.T, mass * c])
    return np.vstack([top, np.hstack([mass * c.T, mass * np.eye(3)])])


def _off(rng: np.random.Generator, size: int) -> FloatArray:
    """Factors that are 5 to 15 % away from 1."""
    return 1.0 + rng.choice([-1.0, 1.0], size) * rng.uniform(*_OFF, size)


def _own(link: ET.Element, rng: np.random.Generator) -> FloatArray:
    """Spatial inertia of a link about its own frame, off the file."""
    inertial = link.find("inertial")
    factor = _off(rng, 5)
    if inertial is None:
        return np.zeros((6, 6))
    turn, center = _pose(inertial.find("origin"))
    mass = _numbers(inertial.find("mass"), "value", (0.0,))[0]
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    xx, yy, zz, xy, xz, yz = (_numbers(inertial.find("inertia"), n, (0.0,))[0] for n in names)
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    # a congruence keeps it the inertia of a body only roughly, the factor of all of it exactly
    about = turn @ (about * factor[4]) @ turn.T
    return solid(mass * factor[0], center * factor[1:4], about)


def _moved(inertia: FloatArray, turn: FloatArray, place: FloatArray) -> FloatArray:
    """Spatial inertia of a child's frame in that of its carrier."""
    x = np.zeros((6, 6))
    x[:3, :3] = x[3:, 3:] = turn.T
    x[3:, :3] = -turn.T @ _cross(place)
    return x.T @ inertia @ x


def arm_of_urdf(urdf: str, joints: tuple[str, ...], seed: int) -> Bodies:
    """Bodies of the joints of a URDF, in their order.

    Raises
    ------
    ConfigError
        If a joint mimics another one, or one of the joints is not there.
    """
    root = ET.fromstring(urdf)
    links = {link.get("name", ""): link for link in root.findall("link")}
    rng = np.random.default_rng([seed, 0xB0D1E5])
    mass = {name: _own(link, rng) for name, link in sorted(links.items())}
    if any(j.find("mimic") is not None for j in root.findall("joint")):
        raise ConfigError("the simulated arm has no joints that mimic others; fix them in the URDF")
    after: dict[str, list[ET.Element]] = {}
    for joint in root.findall("joint"):
        after.setdefault(_end(joint, "parent"), []).append(joint)
    d = len(joints)
    out = Bodies(
        np.full(d, -1, np.int64),
        np.tile(np.eye(3), (d, 1, 1)),
        np.zeros((d, 3)),
        np.zeros((d, 3)),
        np.zeros(d, np.int64),
        np.zeros((d, 6, 6)),
    )
    carried = {_end(j, "child") for row in after.values() for j in row}
    waiting = [(name, -1, np.eye(3), np.zeros(3)) for name in links if name not in carried]
    found: set[str] = set()
    while waiting:
        name, body, turn, place = waiting.pop()
        if body >= 0:
            out.inertia[body] += _moved(mass[name], turn, place)
        for joint in after.get(name, []):
            own_turn, own_place = _pose(joint.find("origin"))
            at = turn @ own_turn, place + turn @ own_place
            label = joint.get("name", "")
            if label in joints:
                k = joints.index(label)
                found.add(label)
                axis = _numbers(joint.find("axis"), "xyz", (1.0, 0.0, 0.0))
                out.parent[k], (out.turn[k], out.place[k]) = body, at
                out.axis[k] = axis / np.linalg.norm(axis)
                out.slides[k] = joint.get("type") == "prismatic"
                waiting.append((_end(joint, "child"), k, np.eye(3), np.zeros(3)))
            else:
                waiting.append((_end(joint, "child"), body, *at))
    missing = [j for j in joints if j not in found]
    if missing or np.any(out.parent >= np.arange(d)):
        raise ConfigError(f"the URDF has no joint {', '.join(missing) or 'order from the base on'}")
    return out


def described_gravity(urdf: str) -> FloatArray:
    """Gravity (3,) in axes of the base [m/s^2]: what ``<gravity>`` of the URDF says, else `WEIGHT`.

    Raises
    ------
    ConfigError
        If that is not three numbers.
    """
    told = ET.fromstring(urdf).findall("gravity")
    if not told:
        return np.array(WEIGHT)
    words = (told[-1].text or "").split()
    try:
        out = np.array([float(word) for word in words])
    except ValueError:
        out = np.zeros(0)
    if len(told) > 1 or out.shape != (3,) or not np.isfinite(out).all():
        raise ConfigError(
            f"<gravity>{' '.join(words)}</gravity> of the simulated arm's URDF: one element with "
            "three numbers [m/s^2] in axes of the base is needed, as 0 0 -9.81"
        )
    return out


def link_tip(urdf: str, last: str) -> tuple[FloatArray, FloatArray]:
    """Axes (3, 3) and place (3,) of the link ``tip`` in the frame of the joint `last`.

    Raises
    ------
    ConfigError
        If no fixed joints lead from the tip to that joint.
    """
    carrier = {_end(j, "child"): j for j in ET.fromstring(urdf).findall("joint")}
    turn, place, link = np.eye(3), np.zeros(3), "tip"
    while link in carrier:
        joint = carrier[link]
        if joint.get("name") == last:
            return turn, place
        own_turn, own_place = _pose(joint.find("origin"))
        turn, place = own_turn @ turn, own_place + own_turn @ place
        link = _end(joint, "parent") if joint.get("type") == "fixed" else ""
    raise ConfigError(
        f"what touches a simulated arm acts on a link 'tip' behind its last joint, {last}; the "
        "URDF has none: add it, with its z along the shaft"
    )


def _end(joint: ET.Element, tag: str) -> str:
    element = joint.find(tag)
    return element.get("link", "") if element is not None else ""


#: Numbers of scratch a body: transform, articulated inertia (6, 6), then v, c, p, U, a (6).
_F = np.float64
#: Parameters of a joint.  The last row is zero unless a hidden effect is put in.
JOINT_DTYPE = np.dtype([
    ("rotor", _F), ("coulomb", _F), ("viscous", _F), ("thin", _F),
    ("limit", _F, (ELEMENTS,)), ("weight", _F, (ELEMENTS,)),
    ("lag", _F), ("top", _F), ("noise", _F), ("code", _F), ("count", _F), ("rate", _F),
    ("stribeck", _F), ("stribeck_speed", _F), ("drag", _F), ("slope", _F), ("cogging", _F),
    ("cogging_cycles", _F), ("spring", _F), ("spring_rest", _F), ("gain", _F),
])  # fmt: skip
#: State of a joint.
JOINT_STATE_DTYPE = np.dtype([
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
    b: Any, rotor: Any, weight: Any, q: Any, qd: Any, tau: Any, room: Any, qdd: Any
) -> None:
    """Joint accelerations into `qdd` (d,) under efforts `tau` (d,).

    Parameters
    ----------
    b : tuple
        Fields of `hil.sim_devices.joints.motion.Bodies`.
    rotor : ndarray (d,)
        Inertia of each drive at its joint [kg m^2 or kg].
    weight : ndarray (3,)
        Gravity in axes of the base [m/s^2].
    room : tuple
        From `motion_scratch`.
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
def inward(b: Any, rotor: Any, weight: Any, tau: Any, room: Any, qdd: Any) -> None:
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
            a[r] = c[r]
            if parent[i] >= 0:
                for k in range(6):
                    a[r] += x[i, r, k] * vec[parent[i], 4, k]
            else:  # the base accelerates against gravity instead of a weight on every body
                for k in range(3):
                    a[r] -= x[i, r, 3 + k] * weight[k]
            left -= u[r] * a[r]
        qdd[i] = left / vec[i, 5, 0]
        for k in range(3):
            a[first + k] += axis[i, k] * qdd[i]


def motion_scratch(d: int) -> tuple[Any, ...]:
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
def _pushed(p: Any, x: Any, code: int, dt: float) -> float:
    """Torque of one drive with what hides in it [N m or N]."""
    wanted = min(max(code * p.code, -p.top), p.top)
    x.drive += (wanted - x.drive) * (1.0 - exp(-dt / p.lag))
    torque = (1.0 + p.gain) * x.drive + p.noise * x.low
    torque += p.cogging * (
        sin(p.cogging_cycles * x.q) + 0.4 * sin(2.0 * p.cogging_cycles * x.q + 0.7)
    )
    return float(torque - p.spring * (x.q - p.spring_rest))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def run_arm(
    b: Any,
    p: Any,
    x: Any,
    room: Any,
    rotor: Any,
    codes: Any,
    random: Any,
    weight: Any,
    span: float,
    n: int,
    met: Any,
    met_room: Any,
) -> None:
    """Advance an arm by `span` [s] in `n` steps.

    Parameters
    ----------
    p, x : structured arrays (d,)
        `JOINT_DTYPE` and `JOINT_STATE_DTYPE`.
    codes : ndarray (d,)
        Efforts in half steps of the drives.
    random : ndarray (d,)
        Standard normal numbers.
    weight : ndarray (3,)
        Gravity in axes of the base [m/s^2].
    met, met_room : structured record and ndarray, or None
        What touches the arm (`hil.sim_devices.joints.touch`), and room for it; None where nothing
        does, so that its laws need not be compiled.
    """
    q, qd, tau, qdd = room[4], room[5], room[6], room[7]
    dt, d = span / n, p.size
    keep = exp(-60.0 * span)
    for i in range(d):
        x[i].low = keep * x[i].low + sqrt(1.0 - keep * keep) * random[i]
    for _ in range(n):
        for i in range(d):
            q[i], qd[i] = x[i].q, x[i].v
            tau[i] = _pushed(p[i], x[i], codes[i], dt) - friction(p[i], x[i], dt)
        outward(b, q, qd, room[:4])
        if met is not None:
            touch.apply_touch(b, room[0], room[2], met, dt, met_room)
        inward(b, rotor, weight, tau, room[:4], qdd)
        for i in range(d):
            x[i].v += dt * qdd[i]
            x[i].q += dt * x[i].v
