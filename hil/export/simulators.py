"""Robots for simulators.

MJCF: bodies, damping, friction loss, armature, springs, ranges, and a motor on every joint.  A
constant effort is a bias of the motor: with the control u the joint gets u - t0.

SDF 1.9: bodies, damping, friction, springs and limits of joints.  A constant effort has no word; on
a joint with a spring it moves the spring's reference.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np

from hil.errors import ConfigError
from hil.export import trees
from hil.export.content import Content, Vocabulary
from hil.export.target import Program
from hil.models.mass import SPRING

# ------------------------------------------------------------ MJCF


def _mjcf(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
    tree = content.tree
    if content.bodies is None:
        raise ConfigError("the model has no bodies, and MuJoCo moves none without a mass")
    root = ET.Element("mujoco", model=name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(root, "option", gravity=trees.numbers(tree.gravity))
    parents = [ET.SubElement(root, "worldbody")]
    for k, joint in enumerate(tree.joints):
        before = parents[int(tree.parent[k]) + 1]
        quat = trees.numbers(_quaternion(tree.turn[k]))
        where = {"pos": trees.numbers(tree.place[k]), "quat": quat}
        body = ET.SubElement(before, "body", {"name": f"{joint}_link"} | where)
        m, centre, i = trees.about_centre(content.bodies[k])
        full = trees.numbers([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])
        own = {"pos": trees.numbers(centre), "mass": repr(m), "fullinertia": full}
        ET.SubElement(body, "inertial", own)
        ET.SubElement(body, "joint", _joint(content, k))
        parents.append(body)
    motors = ET.SubElement(root, "actuator")
    offset = [0.0 if trees.spring(content, k)[0] else x for k, x in enumerate(content.each("1"))]
    for k, joint in enumerate(tree.joints):
        bias = trees.numbers([-offset[k], 0.0, 0.0])
        what = {"gaintype": "fixed", "gainprm": "1", "biastype": "affine", "biasprm": bias}
        ET.SubElement(motors, "general", {"name": f"{joint}_motor", "joint": joint} | what)
    return {".xml": trees.text(root, head)}


def _joint(content: Content, k: int) -> dict[str, str]:
    axis, (low, high) = content.tree.axis[k], trees.ends(content, k)
    turning = trees.turns(axis)
    out = {
        "name": content.tree.joints[k],
        "type": "hinge" if turning else "slide",
        "axis": trees.numbers(axis[3:] if turning else axis[:3]),
        "damping": repr(float(content.each("v")[k])),
        "frictionloss": repr(float(content.each("sign")[k])),
        "armature": repr(float(content.each("a")[k])),
    }
    if math.isfinite(low) and math.isfinite(high):
        out["range"] = trees.numbers([low, high])
    stiffness, _ = trees.spring(content, k)
    if stiffness:
        out |= {"stiffness": repr(stiffness), "springref": repr(_reference(content, k))}
    return out


def _reference(content: Content, k: int) -> float:
    """Where a joint's spring is at rest: the constant effort of the joint moves it.

    k (q - middle) + t0 = k (q - reference)
    """
    stiffness, middle = trees.spring(content, k)
    return float(middle - content.each("1")[k] / stiffness)


def _quaternion(r: trees.FloatArray) -> trees.FloatArray:
    """Quaternion w, x, y, z of a rotation (3, 3): the eigenvector of its largest eigenvalue."""
    (a, b, c), (d, e, f), (g, h, i) = r
    k = np.array(
        [
            [a + e + i, h - f, c - g, d - b],
            [h - f, a - e - i, b + d, c + g],
            [c - g, b + d, e - a - i, f + h],
            [d - b, c + g, f + h, i - a - e],
        ]
    )
    return np.asarray(np.linalg.eigh(k)[1][:, -1])


MJCF = Program(
    "MuJoCo: bodies, damping, friction loss, armature, springs, ranges, motors",
    ".xml",
    Vocabulary(True, ("v", "sign", "a", "1", SPRING), follows=False),
    _mjcf,
)

# ------------------------------------------------------------ SDF


def _sdf(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
    tree = content.tree
    if content.bodies is None:
        raise ConfigError("the model has no bodies, and SDF moves no link without a mass")
    root = ET.Element("sdf", version="1.9")
    model = ET.SubElement(root, "model", name=name)
    for k, joint in enumerate(tree.joints):
        before = int(tree.parent[k])
        parent = f"{tree.joints[before]}_link" if before >= 0 else "world"
        link = ET.SubElement(model, "link", name=f"{joint}_link")
        frame = {"relative_to": parent} if before >= 0 else {}
        _leaf(link, "pose", [*tree.place[k], *trees.angles(tree.turn[k])], frame)
        _inertial(link, content.bodies[k])
        _sdf_joint(model, content, k, parent)
    return {".sdf": trees.text(root, head)}


def _leaf(
    owner: ET.Element, tag: str, values: list[float], attributes: dict[str, str] | None = None
) -> None:
    ET.SubElement(owner, tag, attributes or {}).text = trees.numbers(values)


def _inertial(link: ET.Element, body: trees.FloatArray) -> None:
    m, centre, i = trees.about_centre(body)
    new = ET.SubElement(link, "inertial")
    _leaf(new, "pose", [*centre, 0.0, 0.0, 0.0])
    _leaf(new, "mass", [m])
    inertia = ET.SubElement(new, "inertia")
    named = ("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)
    for key, a, b in named:
        _leaf(inertia, key, [i[a, b]])


def _sdf_joint(model: ET.Element, content: Content, k: int, parent: str) -> None:
    name, axis = content.tree.joints[k], content.tree.axis[k]
    turning = trees.turns(axis)
    joint = ET.SubElement(model, "joint", name=name, type="revolute" if turning else "prismatic")
    ET.SubElement(joint, "parent").text = parent
    ET.SubElement(joint, "child").text = f"{name}_link"
    about = ET.SubElement(joint, "axis")
    _leaf(about, "xyz", list(axis[3:] if turning else axis[:3]))
    low, high = trees.ends(content, k)
    if math.isfinite(low) and math.isfinite(high):
        limit = ET.SubElement(about, "limit")
        _leaf(limit, "lower", [low])
        _leaf(limit, "upper", [high])
    dynamics = ET.SubElement(about, "dynamics")
    _leaf(dynamics, "damping", [content.each("v")[k]])
    _leaf(dynamics, "friction", [content.each("sign")[k]])
    stiffness, _ = trees.spring(content, k)
    if stiffness:
        _leaf(dynamics, "spring_reference", [_reference(content, k)])
        _leaf(dynamics, "spring_stiffness", [stiffness])


SDF = Program(
    "Gazebo and others: bodies, damping, friction, springs",
    ".sdf",
    Vocabulary(True, ("v", "sign", "1", SPRING), follows=False, beside={"1": SPRING}),
    _sdf,
)
