"""What the XML of simulators shares: poses, inertias about the centre, limits, indented text."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.export.content import Content
from hil.models.mass import SPRING
from hil.record.urdf_checks import UrdfJoint, urdf_joints

FloatArray = NDArray[np.float64]


def text(root: ET.Element, head: tuple[str, ...]) -> str:
    """XML with comments at its head."""
    ET.indent(root)
    told = "\n".join(f"<!-- {line.replace('--', '- -')} -->" for line in head)
    return f'<?xml version="1.0"?>\n{told}\n{ET.tostring(root, encoding="unicode")}\n'


def numbers(values: Sequence[float] | FloatArray) -> str:
    """Numbers with all their digits."""
    return " ".join(repr(float(x)) for x in values)


def about_centre(body: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Mass, centre (3,), and inertia (3, 3) about it, of a body's ten parameters."""
    m, *first = body[:4].tolist()
    xx, xy, yy, xz, yz, zz = body[4:]
    c = np.array(first) / m
    i = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return m, c, i - m * (c @ c * np.eye(3) - np.outer(c, c))


def angles(r: FloatArray) -> FloatArray:
    """Roll, pitch, yaw of a rotation (3, 3): R = Rz(yaw) Ry(pitch) Rx(roll)."""
    across = math.hypot(r[0, 0], r[1, 0])
    pitch = math.atan2(-r[2, 0], across)
    if across < 1e-9:  # roll and yaw are about one axis
        return np.array([math.atan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])])


def rotation(turn: FloatArray) -> FloatArray:
    """Orientation of a base under which gravity has the direction g - r x g, r = `turn`."""
    size = float(np.linalg.norm(turn))
    if not size:
        return np.eye(3)
    x, y, z = turn / size
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = math.atan(size)  # g - r x g is longer than g
    return np.asarray(
        np.eye(3) + math.sin(angle) * across + (1 - math.cos(angle)) * across @ across
    )


def turned(urdf: str, r: FloatArray) -> str:
    """A description on a base of orientation r: a link of its own before the first one."""
    root = ET.fromstring(urdf)
    links = [str(x.get("name")) for x in root.findall("link")]
    held = {str(x.get("link")) for x in root.findall("joint/child")}
    (first,) = (x for x in links if x not in held)
    names = (x for k in range(len(links) + 2) if (x := f"level_ground{k or ''}") not in links)
    ground = next(names)
    ET.SubElement(root, "link", name=ground)
    joint = ET.SubElement(root, "joint", name=f"{ground}_to_{first}", type="fixed")
    ET.SubElement(joint, "parent", link=ground)
    ET.SubElement(joint, "child", link=first)
    ET.SubElement(joint, "origin", xyz="0 0 0", rpy=numbers(angles(r)))
    return ET.tostring(root, encoding="unicode")


def turns(axis: FloatArray) -> bool:
    """Whether a joint with this axis [linear, angular] turns."""
    return bool(np.any(axis[3:]))


def limits(content: Content) -> dict[str, UrdfJoint]:
    """What the description says of the joints, by name."""
    return {j.name: j for j in urdf_joints(content.urdf)} if content.urdf else {}


def ends(content: Content, j: int) -> tuple[float, float]:
    """Range of a joint: of the description, and within the stops that were found."""
    name = content.robot.joints[j]
    known = limits(content).get(name, UrdfJoint(name, content.robot.units[j]))
    low, high = known.lower, known.upper
    for place, side in content.stops.get(j, []):
        low, high = (low, min(high, place)) if side > 0 else (max(low, place), high)
    return low, high


def spring(content: Content, j: int) -> tuple[float, float]:
    """Stiffness, and the middle of the span, where the spring's own part is zero."""
    found = [c for c in content.columns if c.joint == j and c.text == SPRING]
    if not found:
        return 0.0, 0.0
    return found[0].value, (found[0].known["low"] + found[0].known["high"]) / 2


def skeleton(content: Content) -> ET.Element:
    """A URDF of a robot that was none: links behind joints, as its tree has them."""
    tree, root = content.tree, ET.Element("robot", name="robot")
    ET.SubElement(root, "link", name="base")
    for k, name in enumerate(tree.joints):
        ET.SubElement(root, "link", name=f"{name}_link")
        turning = turns(tree.axis[k])
        kind = "continuous" if turning else "prismatic"
        joint = ET.SubElement(root, "joint", name=name, type=kind)
        before = tree.parent[k]
        ET.SubElement(joint, "parent", link="base" if before < 0 else f"{tree.joints[before]}_link")
        ET.SubElement(joint, "child", link=f"{name}_link")
        place = {"xyz": numbers(tree.place[k]), "rpy": numbers(angles(tree.turn[k]))}
        ET.SubElement(joint, "origin", place)
        ET.SubElement(joint, "axis", xyz=numbers(tree.axis[k][3:] if turning else tree.axis[k][:3]))
        if not turning:
            wide = {"lower": "-1e3", "upper": "1e3", "effort": "1e6", "velocity": "1e3"}
            ET.SubElement(joint, "limit", wide)
    return root
