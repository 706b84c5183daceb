"""MJCF: bodies, damping, friction loss, armature, springs, ranges, and a motor on every joint.

A constant effort is a bias of the motor: with the control u the joint gets u - t0.
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


def _write(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
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
    motors, offset = ET.SubElement(root, "actuator"), _offset(content)
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
    stiffness, rest = trees.spring(content, k)
    if stiffness:
        out |= {"stiffness": repr(stiffness), "springref": repr(rest)}
    return out


def _offset(content: Content) -> trees.FloatArray:
    """Constant efforts by joint."""
    return content.each("1")


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


TARGET = Program(
    "MuJoCo: bodies, damping, friction loss, armature, springs, ranges, motors",
    ".xml",
    Vocabulary(True, ("v", "sign", "a", "1", SPRING), follows=False),
    _write,
)
