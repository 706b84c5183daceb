"""MJCF for the simulator and URDF for the analyst, from one table of links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import cos, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from hil.sim_devices.mujoco_plants.robots import Link, Robot

FloatArray = NDArray[np.float64]


#: MJCF of each form of dry friction; the smooth one is a law.
DRY = {
    "smooth": "",
    "usual": 'frictionloss="{}"',
    "stiff": 'frictionloss="{}" solreffriction="0.003 1" solimpfriction="0.99 0.99 0.001"',
}


@dataclass
class Additions:
    """What a hidden effect changes in the mechanism.

    Parameters
    ----------
    geared : set of int
        Joints whose motor is a body of its own; what lies between is a law.
    joint : dict
        Joint index -> further MJCF attributes of that joint.
    bodies : dict
        Link index -> MJCF of bodies that hang on it.
    tendons : list of str
        MJCF of tendons.
    """

    geared: set[int] = field(default_factory=set)
    joint: dict[int, str] = field(default_factory=dict)
    bodies: dict[int, str] = field(default_factory=dict)
    tendons: list[str] = field(default_factory=list)


def inertia(link: Link) -> tuple[FloatArray, FloatArray]:
    """Centre of mass (3,) [m] and inertia about it (3, 3) [kg m^2] of a solid rod, link axes."""
    along = np.array(link.along)
    length = float(np.linalg.norm(along))
    n = along / length
    across = link.mass * (3 * link.radius**2 + length**2) / 12
    axial = link.mass * link.radius**2 / 2
    return along / 2, across * np.eye(3) + (axial - across) * np.outer(n, n)


def mjcf(robot: Robot, added: Additions, step: float) -> str:
    """MJCF of the robot with all that is hidden in its mechanism."""
    body = ""
    for k in reversed(range(len(robot.links))):
        body = _body(robot, k, added, body)
    rotors = "".join(_rotor(robot, k) for k in sorted(added.geared))
    tendons = f"<tendon>{''.join(added.tendons)}</tendon>" if added.tendons else ""
    return (
        '<mujoco><compiler angle="radian" inertiafromgeom="false" autolimits="true"/>'
        f'<option timestep="{step!r}" integrator="implicitfast" gravity="0 0 -9.81">'
        '<flag contact="disable"/></option>'
        f"<worldbody>{body}{rotors}</worldbody>{tendons}</mujoco>"
    )


def _body(robot: Robot, k: int, added: Additions, inner: str) -> str:
    link, geared = robot.links[k], k in added.geared
    com, about = inertia(link)
    full = (about[0, 0], about[1, 1], about[2, 2], about[0, 1], about[0, 2], about[1, 2])
    motor = "" if geared else _motor(robot, k)
    site = f'<site name="tip" pos="{_text(link.along)}"/>' if link is robot.links[-1] else ""
    return (
        f'<body name="link{k + 1}" pos="{_text(link.at)}" quat="{_text(quaternion(link.turn))}">'
        f'<inertial pos="{_text(com)}" mass="{link.mass!r}" fullinertia="{_text(full)}"/>'
        f'<joint name="joint{k + 1}" type="{"slide" if link.slides else "hinge"}" '
        f'axis="{_text(link.axis)}" {motor} {added.joint.get(k, "")}/>'
        f"{site}{added.bodies.get(k, '')}{inner}</body>"
    )


def _motor(robot: Robot, k: int) -> str:
    """Inertia and friction of the motor of joint k."""
    link = robot.links[k]
    dry = DRY[robot.dry].format(link.friction)
    return f'armature="{link.rotor!r}" damping="{link.viscous!r}" {dry}'


def _rotor(robot: Robot, k: int) -> str:
    """The motor as a body of its own, seen at the joint; the small mass only gives it a body."""
    kind = "slide" if robot.links[k].slides else "hinge"
    return (
        f'<body name="rotor{k + 1}">'
        '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'
        f'<joint name="motor{k + 1}" type="{kind}" axis="1 0 0" {_motor(robot, k)}/></body>'
    )


def quaternion(turn: Sequence[float]) -> tuple[float, float, float, float]:
    """Quaternion (w, x, y, z) of URDF's roll, pitch, yaw [rad]."""
    (cr, cp, cy), (sr, sp, sy) = ([f(x / 2) for x in turn] for f in (cos, sin))
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def urdf(name: str, robot: Robot, wrong: float = 0.0, seed: int = 0) -> str:
    """URDF with exact geometry.

    Parameters
    ----------
    name : str
    robot : Robot
    wrong : float
        Largest relative error of masses, inertias and centres (0: exact).
    seed : int
        Of those errors.
    """
    rng = np.random.default_rng([seed, 0x0DF])
    parts = ['<link name="base"/>']
    for k, link in enumerate(robot.links):
        off = 1.0 + wrong * rng.uniform(0.3, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
        com, about = inertia(link)
        about, com, mass = about * off[0], com * off[1], link.mass * off[2]
        keys = zip(("xx", "xy", "xz", "yy", "yz", "zz"), about[np.triu_indices(3)], strict=True)
        moments = " ".join(f'i{key}="{float(x)!r}"' for key, x in keys)
        parent = f"link{k}" if k else "base"
        middle, half = link.middle, 1.6 * link.reach
        parts.append(
            f'<link name="link{k + 1}"><inertial><origin xyz="{_text(com)}" rpy="0 0 0"/>'
            f'<mass value="{float(mass)!r}"/><inertia {moments}/></inertial></link>'
            f'<joint name="joint{k + 1}" type="{"prismatic" if link.slides else "revolute"}">'
            f'<parent link="{parent}"/><child link="link{k + 1}"/>'
            f'<origin xyz="{_text(link.at)}" rpy="{_text(link.turn)}"/>'
            f'<axis xyz="{_text(link.axis)}"/>'
            f'<limit lower="{middle - half!r}" upper="{middle + half!r}" '
            f'effort="{link.effort!r}" velocity="{2 * link.speed!r}"/></joint>'
        )
    last = robot.links[-1]
    parts.append(
        '<link name="tip"/><joint name="tool" type="fixed">'
        f'<parent link="link{len(robot.links)}"/><child link="tip"/>'
        f'<origin xyz="{_text(last.along)}" rpy="0 0 0"/></joint>'
    )
    return f'<robot name="{name}">{"".join(parts)}</robot>'


def size(robot: Robot, k: int) -> float:
    """Length that the load of joint k is felt over [m]: from its axis to the end of its rod."""
    return sqrt(sum(x * x for x in robot.links[k].along))


def _text(values: Sequence[float] | FloatArray) -> str:
    return " ".join(repr(float(x)) for x in values)
