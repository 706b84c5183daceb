"""Robots: geometry and the rigid-body regressor, from a preset or a URDF."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.models.bodies import Tree
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]


class Robot(Protocol):
    """What identification needs to know of a robot's rigid bodies."""

    #: Joint names, length d.
    joints: tuple[str, ...]
    #: "rad" or "m" for each joint.
    units: tuple[str, ...]
    #: Names and units of the p rigid-body parameters.
    names: tuple[str, ...]
    param_units: tuple[str, ...]
    #: Values to fall back on for what the data cannot determine, shape (p,).
    prior: FloatArray
    #: Whether a separate rotor inertia is a parameter of its own.
    has_armature: bool

    @property
    def tree(self) -> Tree | None:
        """Its bodies one by one; None where its parameters are lumped."""

    @property
    def links(self) -> tuple[int, ...]:
        """Joints, from 1 on, whose links may carry a load: the tip's, then from the base on."""

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Regressor Y with tau = Y pi, shape (n, d, p), from arrays (n, d)."""

    def balance(
        self, q: FloatArray, qd: FloatArray, pi: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Effort without acceleration (n, d), mass matrix (n, d, d), for parameters (n, p)."""

    def external(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Joint effort J^T w of a wrench (n, 6) ON the tip, base frame; shape (n, d)."""

    def tip(self, q: FloatArray) -> FloatArray | None:
        """Place of the tip in base axes (n, 3) [m]; None without a tip."""

    def tip_mass(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray | None:
        """Effort of one kilogram at the tip, shape (n, d); None without a tip."""

    def tip_load(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray | None:
        """Effort of a load at the tip: of one kilogram, and of its first moments if known.

        Shape (n, d, 1 or 4), moments about the tip in axes of the last link; None without a tip.
        """

    def body_load(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, link: int) -> FloatArray:
        """Effort (n, d, 10) of a body on the link behind joint number `link`, one of `links`.

        Of unit m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz in axes of the link: about the tip on
        the link that holds it, else about the joint's frame.
        """

    def tip_axes(self, q: FloatArray) -> FloatArray | None:
        """Axes of the tip's frame as columns in base axes, (n, 3, 3); None without a tip."""


class IndependentAxes:
    """Axes that do not feel each other: one inertia each (preset ``single-axis``).

    tau_j = m_j qdd_j

    `units` is that of all, ``"rad"`` or ``"m"``, or one a joint: ``"rad m"``.
    """

    has_armature = False
    links: tuple[int, ...] = ()

    def __init__(self, joints: tuple[str, ...], units: str = "rad") -> None:
        each = tuple(units.split())
        self.joints, self.units = joints, each if len(each) == len(joints) else each * len(joints)
        single = len(joints) == 1
        self.names = ("m",) if single else tuple(f"m{j + 1}" for j in range(len(joints)))
        self.param_units = tuple("kg m^2" if unit == "rad" else "kg" for unit in self.units)
        self.prior = np.zeros(len(joints))

    @property
    def tree(self) -> Tree:
        """Bodies beside each other: on upright hinges, or on level slides."""
        d = len(self.joints)
        one = np.array([1.0, 0, 0, 0, 1, 0, 1, 0, 0, 1])
        own = np.zeros((10 * d, d))
        axis = np.zeros((d, 6))
        for k, unit in enumerate(self.units):
            turns = unit == "rad"
            axis[k, 5 if turns else 0] = 1.0
            own[10 * k : 10 * k + 10, k] = (
                one if turns else np.where(np.arange(10), 1e-3 * one, one)
            )
        return Tree(
            self.joints,
            np.full(d, -1, dtype=np.int64),
            np.tile(np.eye(3), (d, 1, 1)),
            np.outer(np.arange(d), [0.0, 1.0, 0.0]),
            axis,
            np.array([0.0, 0.0, -9.81]),
            np.eye(d),
            np.zeros(d),
            own,
        )

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Y = diag(qdd), shape (n, d, d)."""
        n, d = qdd.shape
        out = np.zeros((n, d, d))
        out[:, np.arange(d), np.arange(d)] = qdd
        return out

    def balance(
        self, q: FloatArray, qd: FloatArray, pi: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """No effort without acceleration (n, d), mass matrix diag(m) (n, d, d), of pi (n, d)."""
        n, d = q.shape
        mass = np.zeros((n, d, d))
        mass[:, np.arange(d), np.arange(d)] = pi
        return np.zeros((n, d)), mass

    def external(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Refuse: an axis without geometry has no Jacobian."""
        raise ConfigError(
            "robot 'single-axis' has no geometry, so a tip force cannot be turned into joint "
            "effort; record tauext1.. instead of fx,fy,fz, or name a URDF"
        )

    def tip(self, q: FloatArray) -> FloatArray | None:
        """No tip."""
        return None

    def tip_mass(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray | None:
        """No tip."""
        return None

    def tip_load(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray | None:
        """No tip."""
        return None

    def body_load(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, link: int) -> FloatArray:
        """Nothing: no link is known."""
        return np.zeros((*q.shape, 10))

    def tip_axes(self, q: FloatArray) -> FloatArray | None:
        """No tip."""
        return None


def _premium(recording: Recording) -> Robot:
    from hil.models.phantom import Premium

    return Premium(recording.joints)


def _omni(recording: Recording) -> Robot:
    from hil.models.phantom import Omni

    return Omni(recording.joints)


def _axes(recording: Recording) -> Robot:
    return IndependentAxes(recording.joints, " ".join(recording.units))


PRESET_ROBOTS: dict[str, Callable[[Recording], Robot]] = {
    "single-axis": _axes,
    "phantom-premium-1.5": _premium,
    "phantom-omni": _omni,
}


def make_robot(source: RobotSource, recording: Recording) -> Robot:
    """Build the robot of a model for a recording; a model that names none takes the recording's.

    Raises
    ------
    ConfigError
        If the preset is unknown or the joints of robot and recording do not match.
    """
    if not (source.preset or source.urdf):
        source = recording.robot
    if source.urdf:
        from hil.models.urdf import UrdfRobot

        robot: Robot = UrdfRobot(source.urdf, source.tip)
    else:
        if source.preset not in PRESET_ROBOTS:
            raise ConfigError(unknown("robot preset", source.preset, PRESET_ROBOTS))
        robot = PRESET_ROBOTS[source.preset](recording)
    if len(robot.joints) != recording.d:
        raise ConfigError(
            f"the robot has {len(robot.joints)} joints ({', '.join(robot.joints)}) but "
            f"recording {recording.name!r} has {recording.d} position columns; "
            "name the URDF or preset that matches the recording"
        )
    moved = [
        name
        for k, name in enumerate(recording.joints)
        if name in robot.joints and robot.joints[k] != name
    ]
    if moved:
        raise ConfigError(
            f"recording {recording.name!r} has the joints in the order "
            f"{', '.join(recording.joints)}, the robot in the order {', '.join(robot.joints)}; "
            "reorder the recording's columns"
        )
    return robot


def undescribed(source: RobotSource, d: int, means: str = "") -> str:
    """What d joints without a geometry lack and what to do; nothing where they have one.

    Parameters
    ----------
    source : RobotSource
        The robot.
    d : int
        Number of joints; one alone lacks nothing.
    means : str
        What follows from it for an answer, a sentence.
    """
    if d == 1 or source.urdf or source.preset not in ("", "single-axis"):
        return ""
    means = means or "Its values and errors include what these would explain."
    return (
        f"{d} joints without a robot description: the model has no gravity, no inertia "
        f"coupling and no kinematics. {means} Give --robot ARM.urdf (in the studio: its path). "
        "Get a URDF from the maker of the arm or from the topic or parameter robot_description, "
        "or write one with masses and lengths of your own"
    )


def bare_robot(source: RobotSource, joints: tuple[str, ...] = ()) -> Robot:
    """Build a robot without a recording; `joints` name those of a preset.

    Raises
    ------
    ConfigError
        If the preset is unknown or has another number of joints.
    """
    if source.urdf:
        from hil.models.urdf import UrdfRobot

        return UrdfRobot(source.urdf, source.tip)
    one = np.zeros((1, len(joints)))
    return make_robot(source, Recording("none", "arm", joints, one[:, 0], one, one))
