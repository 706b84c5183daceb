"""SDF 1.9: bodies, damping, friction, springs and limits of joints.

A constant effort has no word; on a joint with a spring it moves the spring's reference.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

from hil.errors import ConfigError
from hil.export import trees
from hil.export.content import Content, Vocabulary
from hil.export.target import Program
from hil.models.mass import SPRING


def _write(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
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
        _joint(model, content, k, parent)
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


def _joint(model: ET.Element, content: Content, k: int, parent: str) -> None:
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
    stiffness, rest = trees.spring(content, k)
    if stiffness:
        # k (q - rest) + t0 = k (q - reference)
        _leaf(dynamics, "spring_reference", [rest - content.each("1")[k] / stiffness])
        _leaf(dynamics, "spring_stiffness", [stiffness])


TARGET = Program(
    "Gazebo and others: bodies, damping, friction, springs",
    ".sdf",
    Vocabulary(True, ("v", "sign", "1", SPRING), follows=False, beside={"1": SPRING}),
    _write,
)
