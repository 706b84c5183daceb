"""Isaac Lab: joints' actuator settings as YAML, and the description whose bodies belong to them.

The keys of a joint are those of `ImplicitActuatorCfg`; stiffness and damping of the drive are the
controller's, hence zero for a joint that is driven by its effort.
"""

from __future__ import annotations

import json
import math

from hil.export import trees
from hil.export.content import Content, Vocabulary
from hil.export.target import Program
from hil.export.urdf import described


def _write(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
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


TARGET = Program(
    "Isaac Lab: actuator settings, and the URDF with the bodies beside them",
    ".yaml",
    Vocabulary(True, ("v", "sign", "a"), follows=False),
    _write,
)
