"""From a URDF to the bodies of a simulated arm, each off the file by a seeded share.

The file is read here a second time, without the rigid-body library of the models.  Links behind
fixed joints are part of the body that carries them.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

Array = NDArray[np.float64]
#: How far a mass, a first moment or an inertia is off the file, either way.
OFF = (0.05, 0.15)
#: Weight [m/s^2].
WEIGHT = 9.80665


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
    turn: Array
    place: Array
    axis: Array
    slides: NDArray[np.int64]
    inertia: Array


def _numbers(element: ET.Element | None, key: str, default: tuple[float, ...]) -> Array:
    text = element.get(key) if element is not None else None
    return np.array([float(x) for x in text.split()] if text else default)


def _pose(element: ET.Element | None) -> tuple[Array, Array]:
    """Rotation and place of an ``<origin>``."""
    place, (r, p, y) = _numbers(element, "xyz", (0.0,) * 3), _numbers(element, "rpy", (0.0,) * 3)
    yaw = np.array([[cos(y), -sin(y), 0], [sin(y), cos(y), 0], [0, 0, 1.0]])
    pitch = np.array([[cos(p), 0, sin(p)], [0, 1.0, 0], [-sin(p), 0, cos(p)]])
    roll = np.array([[1.0, 0, 0], [0, cos(r), -sin(r)], [0, sin(r), cos(r)]])
    return yaw @ pitch @ roll, place


def _cross(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def solid(mass: float, center: Array, about_center: Array) -> Array:
    """Spatial inertia (6, 6) about the origin of a body with its centre of mass at `center`."""
    c = _cross(center)
    top = np.hstack([about_center + mass * c @ c.T, mass * c])
    return np.vstack([top, np.hstack([mass * c.T, mass * np.eye(3)])])


def _off(rng: np.random.Generator, size: int) -> Array:
    """Factors that are 5 to 15 % away from 1."""
    return 1.0 + rng.choice([-1.0, 1.0], size) * rng.uniform(*OFF, size)


def _own(link: ET.Element, rng: np.random.Generator) -> Array:
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


def _moved(inertia: Array, turn: Array, place: Array) -> Array:
    """Spatial inertia of a child's frame in that of its carrier."""
    x = np.zeros((6, 6))
    x[:3, :3] = x[3:, 3:] = turn.T
    x[3:, :3] = -turn.T @ _cross(place)
    return x.T @ inertia @ x


def read(urdf: str, joints: tuple[str, ...], seed: int) -> Bodies:
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


def tip(urdf: str, last: str) -> tuple[Array, Array]:
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
