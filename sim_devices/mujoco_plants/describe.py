"""MJCF for the simulator, URDF for the analyst from one table of links, and flaws of the mechanism.

A hidden effect of the mechanism adds bodies, tendons or limits to the MJCF, or puts a shaft of its
own between a motor and its link.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import copysign, cos, exp, expm1, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from hil.sim_devices.mujoco_plants.laws import UNIT, EffectPlace, PlantState
from hil.sim_devices.mujoco_plants.robots import Link, SimulatedRobot

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


def mjcf(robot: SimulatedRobot, added: Additions, step: float) -> str:
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


def _body(robot: SimulatedRobot, k: int, added: Additions, inner: str) -> str:
    link, geared = robot.links[k], k in added.geared
    com, about = inertia(link)
    full = (about[0, 0], about[1, 1], about[2, 2], about[0, 1], about[0, 2], about[1, 2])
    motor = "" if geared else _motor(robot, k)
    site = f'<site name="tip" pos="{_text(link.along)}"/>' if link is robot.links[-1] else ""
    return (
        f'<body name="link{k + 1}" pos="{_text(link.at)}" quat="{_text(_quaternion(link.turn))}">'
        f'<inertial pos="{_text(com)}" mass="{link.mass!r}" fullinertia="{_text(full)}"/>'
        f'<joint name="joint{k + 1}" type="{"slide" if link.slides else "hinge"}" '
        f'axis="{_text(link.axis)}" {motor} {added.joint.get(k, "")}/>'
        f"{site}{added.bodies.get(k, '')}{inner}</body>"
    )


def _motor(robot: SimulatedRobot, k: int) -> str:
    """Inertia and friction of the motor of joint k."""
    link = robot.links[k]
    dry = DRY[robot.dry].format(link.friction)
    return f'armature="{link.rotor!r}" damping="{link.viscous!r}" {dry}'


def _rotor(robot: SimulatedRobot, k: int) -> str:
    """The motor as a body of its own, seen at the joint; the small mass only gives it a body."""
    kind = "slide" if robot.links[k].slides else "hinge"
    return (
        f'<body name="rotor{k + 1}">'
        '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'
        f'<joint name="motor{k + 1}" type="{kind}" axis="1 0 0" {_motor(robot, k)}/></body>'
    )


def _quaternion(turn: Sequence[float]) -> tuple[float, float, float, float]:
    """Quaternion (w, x, y, z) of URDF's roll, pitch, yaw [rad]."""
    (cr, cp, cy), (sr, sp, sy) = ([f(x / 2) for x in turn] for f in (cos, sin))
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def exact_urdf(name: str, robot: SimulatedRobot, wrong: float = 0.0, seed: int = 0) -> str:
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


def size(robot: SimulatedRobot, k: int) -> float:
    """Length that the load of joint k is felt over [m]: from its axis to the end of its rod."""
    return sqrt(sum(x * x for x in robot.links[k].along))


def _text(values: Sequence[float] | FloatArray) -> str:
    return " ".join(repr(float(x)) for x in values)


#: Effort that motor and link exchange, from twist and its rate.
Shaft = Callable[[PlantState], float]
#: Frequency of the link on a shaft that is soft, and on one that is not the effect [Hz]; damping.
_SOFT, _STIFF, _DAMPED = 24.0, 45.0, 0.12


def _shaft(p: EffectPlace, inertia: float, hertz: float) -> tuple[float, float]:
    """Stiffness and damping of a shaft on which the link swings at `hertz`."""
    w = 2 * pi * hertz
    return inertia * w * w, 2 * _DAMPED * inertia * w


def elastic(p: EffectPlace, inertia: float) -> Shaft:
    """A linear shaft: the softer, the larger the amplitude."""
    j = p.j
    k, c = _shaft(p, inertia, _SOFT / p.amplitude**0.5)
    return lambda x: k * (x.m[j] - x.q[j]) + c * (x.w[j] - x.v[j])


def hardening(p: EffectPlace, inertia: float) -> Shaft:
    """A cable that stiffens exponentially: A (exp(|d| / d0) - 1)."""
    j = p.j
    k, c = _shaft(p, inertia, _SOFT / p.amplitude**0.5 * 0.6)
    d0 = 8.0 * UNIT * p.link.effort / k

    def pull(x: PlantState) -> float:
        d = x.m[j] - x.q[j]
        force = k * d0 * expm1(min(abs(d) / d0, 4.0))
        return copysign(force, d) + c * (x.w[j] - x.v[j])

    return pull


def backlash(p: EffectPlace, inertia: float) -> Shaft:
    """A play, and flanks of the usual stiffness that damp only while they touch."""
    j, half = p.j, 1.5e-3 * p.amplitude * p.link.reach
    k, c = _shaft(p, inertia, _STIFF)
    c *= 2.0

    def pull(x: PlantState) -> float:
        d = x.m[j] - x.q[j]
        if abs(d) <= half:
            return 0.0
        force = k * (d - copysign(half, d)) + c * (x.w[j] - x.v[j])
        # a flank pushes and never pulls
        return force if force * d > 0.0 else 0.0

    return pull


def harmonic_drive(p: EffectPlace, inertia: float) -> Shaft:
    """A flexible spline: error twice a turn of the motor, and stiffness that grows."""
    j, e, a = p.j, 1.2e-3 * p.amplitude * p.link.reach, p.phase(11.0, 0.5)
    k, c = _shaft(p, inertia, _SOFT)

    def pull(x: PlantState) -> float:
        d = x.m[j] + e * sin(a(x.m[j])) - x.q[j]
        return k * d * (1.0 + 0.2 * (1.0 - exp(-abs(d) * k / p.link.effort * 5.0))) + c * (
            x.w[j] - x.v[j]
        )

    return pull


def belt(p: EffectPlace, inertia: float) -> Shaft:
    """A belt that jumps teeth once or twice in a recording."""
    j, tooth, rng = p.j, 6e-3 * p.amplitude * p.link.reach, p.rng
    k, c = _shaft(p, inertia, _STIFF)
    start, gone = rng.uniform(0.25, 0.5) * p.robot.seconds, 0.0

    def pull(x: PlantState) -> float:
        nonlocal start, gone
        if x.t > start and abs(x.w[j]) > 0.2 * p.link.speed:
            gone += tooth * (1.0 if x.w[j] > 0.0 else -1.0)
            start = x.t + rng.uniform(0.25, 0.5) * p.robot.seconds
        return k * (x.m[j] - gone - x.q[j]) + c * (x.w[j] - x.v[j])

    return pull


SHAFTS: dict[str, Callable[[EffectPlace, float], Shaft]] = {
    "elastic-transmission": elastic,
    "hardening-cable": hardening,
    "backlash": backlash,
    "harmonic-drive": harmonic_drive,
    "belt-skip": belt,
}


def end_stop(p: EffectPlace, added: Additions) -> None:
    """MuJoCo's limit of the joint, soft, within reach of the motion."""
    link = p.link
    at = link.middle + link.reach * (0.3 if p.odd else 0.15)
    # the constraint takes a share of the joint's motion that grows from nothing over this depth
    width = 3.0 * link.reach / p.amplitude
    added.joint[p.j] = (
        f'limited="true" range="{link.middle - 4 * link.reach!r} {at!r}" '
        f'solreflimit="-300 -12" solimplimit="0.0001 0.9 {width!r} 0.5 1.5"'
    )


def vibration(p: EffectPlace, added: Additions) -> None:
    """A wheel on a spring that the link carries along."""
    inertia = 0.06 * p.amplitude * p.link.rotor
    w = 2 * pi * (4.6 + 0.7 * p.j)
    mass = inertia if p.link.slides else 1e-6
    about = 1e-9 if p.link.slides else inertia
    kind = "slide" if p.link.slides else "hinge"
    x, y, z = p.link.axis
    added.bodies[p.j] = (
        f'<body name="wheel"><inertial pos="0 0 0" mass="{mass!r}" '
        f'diaginertia="{about!r} {about!r} {about!r}"/>'
        f'<joint name="wheel" type="{kind}" axis="{x} {y} {z}" '
        f'stiffness="{inertia * w * w!r}" damping="{0.06 * inertia * w!r}"/></body>'
    )


def slosh(p: EffectPlace, added: Additions) -> None:
    """A tank whose water swings as a pendulum about two axes."""
    length = 0.35 * size(p.robot, p.j)
    # as heavy as a tenth of the motor's effort held at the end of the rod, at amplitude 10
    mass = p.size / (9.81 * size(p.robot, p.j))
    at = " ".join(repr(x) for x in p.link.along)
    damping = 0.05 * mass * length**2 * (9.81 / length) ** 0.5
    swing = "".join(
        f'<joint name="water{k}" type="hinge" axis="{axis}" damping="{damping!r}"/>'
        for k, axis in enumerate(("1 0 0", "0 1 0"))
    )
    about = repr(0.02 * mass * length**2)
    added.bodies[p.j] = (
        f'<body name="water" pos="{at}">{swing}<inertial pos="0 0 {-length!r}" mass="{mass!r}" '
        f'diaginertia="{about} {about} {about}"/></body>'
    )


def idler(p: EffectPlace, added: Additions) -> None:
    """A wheel that turns with two joints: MuJoCo's fixed tendon, with friction and damping."""
    r = 1.0
    f, c = p.size, p.size / p.link.speed
    added.tendons.append(
        f'<fixed name="idler{p.j}" frictionloss="{f!r}" damping="{c!r}" '
        f'armature="{0.1 * p.link.rotor * p.amplitude**0.5!r}">'
        f'<joint joint="joint{p.j + 1}" coef="1"/><joint joint="joint{p.other + 1}" '
        f'coef="{r!r}"/></fixed>'
    )


def _hose(p: EffectPlace, added: Additions) -> None:
    """A hose along two joints: a fixed tendon that is slack about its rest, and damped a little."""
    r, slack = 0.8 if p.odd else -1.0, 0.05 * p.link.reach
    k, c = 2.0 * p.size / p.link.reach, 0.05 * p.size / p.link.speed
    added.tendons.append(
        f'<fixed name="hose{p.j}" stiffness="{k!r}" damping="{c!r}" '
        f'springlength="{-slack!r} {slack!r}">'
        f'<joint joint="joint{p.j + 1}" coef="1"/><joint joint="joint{p.other + 1}" '
        f'coef="{r!r}"/></fixed>'
    )


def payload(p: EffectPlace, added: Additions) -> None:
    """A small heavy body at the tip."""
    mass = load_mass(p)
    at = " ".join(repr(x) for x in p.robot.links[-1].along)
    about = repr(1e-6 * mass)
    added.bodies[len(p.robot.links) - 1] = (
        f'<body name="load" pos="{at}"><inertial pos="0 0 0" mass="{mass!r}" '
        f'diaginertia="{about} {about} {about}"/></body>'
    )


def load_mass(p: EffectPlace) -> float:
    """Mass that a middle motor holds with this amplitude [kg]."""
    lever = sum(size(p.robot, k) for k in range(len(p.robot.links)))
    strong = max(link.effort for link in p.robot.links)
    return p.amplitude * UNIT * strong / (9.81 * lever)


STRUCTURES: dict[str, Callable[[EffectPlace, Additions], None]] = {
    "end-stop": end_stop,
    "vibration-mode": vibration,
    "coupled-transmission": idler,
    "coupled-spring": _hose,
    "payload": payload,
    "outside-slosh": slosh,
}
