"""URDF: inertials, damping and friction put into the robot's own description.

The rest of it (meshes, frames, limits) stays.  What is fixed to a link is part of its body.

Isaac Lab: joints' actuator settings as YAML, and the description whose bodies belong to them.  The
keys of a joint are those of `ImplicitActuatorCfg`; stiffness and damping of the drive are the
controller's, hence zero for a joint that is driven by its effort.
"""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET

from hil.errors import ConfigError
from hil.export import trees
from hil.export.content import Content, Vocabulary
from hil.export.target import Program
from hil.record.urdf_checks import link_at


def described(content: Content, damped: bool = True) -> ET.Element:
    """The description with the content's bodies, and its damping and friction if `damped`."""
    root = ET.fromstring(content.urdf) if content.urdf else trees.skeleton(content)
    if content.bodies is None:
        raise ConfigError(
            "the model has no bodies: it lacks the robot's own masses and inertias; add its "
            "effect of the robot's links, or fit the base model"
        )
    joints = {str(j.get("name")): j for j in root.iter("joint") if j.find("child") is not None}
    for name, body in zip(content.tree.joints, content.bodies, strict=True):
        _inertial(root, joints, link_at(joints[name], "child"), body)
    # links before the first joint move nothing; what is written of them is ignored
    damping, friction = content.each("v"), content.each("sign")
    for k, name in enumerate(content.robot.joints):
        joint = joints[name]
        for old in joint.findall("dynamics"):
            joint.remove(old)
        if damped:
            said = {"damping": repr(float(damping[k])), "friction": repr(float(friction[k]))}
            ET.SubElement(joint, "dynamics", said)
    return root


def _inertial(
    root: ET.Element, joints: dict[str, ET.Element], link: str, body: trees.FloatArray
) -> None:
    """Give a link the body of all that is fixed to it."""
    links = {str(x.get("name")): x for x in root.findall("link")}
    held = [link]
    for name in held:
        for old in links[name].findall("inertial"):
            links[name].remove(old)
        fixed = [j for j in joints.values() if j.get("type") == "fixed"]
        held += [link_at(j, "child") for j in fixed if link_at(j, "parent") == name]
    m, centre, i = trees.about_centre(body)
    new = ET.SubElement(links[link], "inertial")
    ET.SubElement(new, "origin", xyz=trees.numbers(centre), rpy="0 0 0")
    ET.SubElement(new, "mass", value=repr(m))
    named = ("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)
    ET.SubElement(new, "inertia", {key: repr(float(i[a, b])) for key, a, b in named})


def _write(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
    return {".urdf": trees.text(described(content), head)}


TARGET = Program(
    "robot description: inertials, damping, friction",
    ".urdf",
    Vocabulary(True, ("v", "sign")),
    _write,
)


def _settings(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
    known, friction = trees.limits(content), content.each("sign")
    each = {
        "armature": content.each("a"),
        "friction": friction,
        "dynamic_friction": friction,
        "viscous_friction": content.each("v"),
    }
    lines = [*(f"# {x}" for x in head), f"urdf: {json.dumps(name + '.urdf')}", "actuators:"]
    for k, joint in enumerate(content.robot.joints):
        quoted = json.dumps(joint)
        lines += [f"  {quoted}:", f"    joint_names_expr: [{quoted}]"]
        lines += [f"    {key}: {float(values[k])!r}" for key, values in each.items()]
        lines += ["    stiffness: 0.0", "    damping: 0.0"]
        if joint in known:
            most = {
                "effort_limit_sim": known[joint].effort,
                "velocity_limit_sim": known[joint].velocity,
            }
            lines += [f"    {key}: {x!r}" for key, x in most.items() if math.isfinite(x)]
    urdf = trees.text(described(content, damped=False), head)
    return {".yaml": "\n".join(lines) + "\n", ".urdf": urdf}


ISAAC = Program(
    "Isaac Lab: actuator settings, and the URDF with the bodies beside them",
    ".yaml",
    Vocabulary(True, ("v", "sign", "a"), follows=False),
    _settings,
)
