"""Table of robots: their links, motors and measurements."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

Vec = tuple[float, float, float]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Link:
    """One joint, the rod that it moves, and its motor.

    Parameters
    ----------
    at, turn : tuple (3,)
        Place [m] and roll, pitch, yaw [rad] of the joint in its parent's frame.
    axis : tuple (3,)
        Axis of the joint.
    mass : float
        Of the rod [kg].
    along : tuple (3,)
        From the joint to the end of the rod, link axes [m].
    radius : float
        Of the rod [m].
    rotor : float
        Inertia of the motor seen at the joint [kg m^2 or kg].
    friction, viscous : float
        Dry [N m or N] and viscous [N m s/rad or N s/m] friction.
    middle, reach : float
        Middle and half width of the motion [rad or m].
    speed : float
        Largest speed [rad/s or m/s].
    effort : float
        Largest effort of the motor [N m or N].
    slides : bool
        Whether the joint is prismatic.
    """

    at: Vec
    axis: Vec
    mass: float
    along: Vec
    radius: float
    rotor: float
    friction: float
    viscous: float
    middle: float
    reach: float
    speed: float
    effort: float
    turn: Vec = ORIGIN
    slides: bool = False


@dataclass(frozen=True)
class SimulatedRobot:
    """A robot and how it is measured.

    Parameters
    ----------
    links : tuple of Link
    rate : float
        Rows a second [Hz].
    seconds : float
        Length of a recording [s].
    step : float
        Step of the physics and period of the controller [s].
    counts : float
        Encoder counts a radian (or a metre) at the joint.
    noise : float
        Standard deviation of the effort's noise, share of the largest effort.
    bandwidth : float
        Of the position loop [Hz].
    dry : str
        Form of the dry friction: ``"smooth"``, v / sqrt(v^2 + w^2), or MuJoCo's ``frictionloss``
        with its usual regularisation, ``"usual"``, or a stiffer one, ``"stiff"``.
    speeds : bool
        Whether the recording has measured speeds.
    described : bool
        Whether a URDF belongs to it; else it is a single axis.
    """

    links: tuple[Link, ...]
    rate: float
    seconds: float
    step: float = 1e-3
    counts: float = 2e5
    noise: float = 0.004
    bandwidth: float = 4.0
    dry: str = "smooth"
    speeds: bool = False
    described: bool = True

    @property
    def joints(self) -> tuple[str, ...]:
        """Names, from ``joint1``."""
        return tuple(f"joint{k + 1}" for k in range(len(self.links)))


_HALF = pi / 2

ROBOTS: dict[str, SimulatedRobot] = {
    # a spindle with a disc, vertical axis: nothing but inertia and friction
    "spindle": SimulatedRobot(
        (Link(ORIGIN, Z, 1.9, (0.0, 0.0, 0.05), 0.13, 0.011, 0.21, 0.034, 0.0, 1.4, 7.0, 3.1),),
        2000.0, 22.0, 5e-4, 1.3e4, 0.006, 6.0, "smooth", True, False,
    ),
    "pendulum": SimulatedRobot(
        (Link(ORIGIN, Y, 0.82, (0.0, 0.0, -0.38), 0.018, 0.013, 0.11, 0.021, 0.3, 1.3, 5.5, 4.6),),
        500.0, 24.0, counts=9.1e3, noise=0.005, dry="usual",
    ),
    # two links in a vertical plane
    "planar2": SimulatedRobot(
        (
            Link(ORIGIN, Y, 2.6, (0.43, 0.0, 0.0), 0.031, 0.09, 0.74, 0.31, -0.8, 0.75, 3.1, 38.0),
            Link(
                (0.43, 0.0, 0.0), Y, 1.3, (0.36, 0.0, 0.0), 0.024, 0.035, 0.33, 0.12, 0.7, 0.9,
                4.2, 11.0,
            ),
        ),
        1000.0, 22.0, counts=3.7e4, noise=0.004, dry="stiff", speeds=True,
    ),
    # yaw, shoulder, elbow of a geared workshop arm
    "elbow3": SimulatedRobot(
        (
            Link(ORIGIN, Z, 6.1, (0.0, 0.0, 0.31), 0.071, 0.92, 5.2, 3.9, 0.2, 1.1, 2.3, 120.0),
            Link(
                (0.07, 0.0, 0.31), Y, 7.4, (0.52, 0.0, 0.0), 0.052, 1.6, 7.7, 5.8, -0.7, 0.6, 1.8,
                210.0,
            ),
            Link(
                (0.52, 0.0, 0.0), Y, 4.2, (0.47, 0.0, 0.06), 0.044, 0.55, 3.6, 2.4, 0.9, 0.8, 2.4,
                80.0,
            ),
        ),
        250.0, 30.0, counts=1.6e5, noise=0.004,
    ),
    # a direct-driven stylus for the hand
    "stylus3": SimulatedRobot(
        (
            Link(
                ORIGIN, Z, 0.24, (0.0, 0.0, 0.09), 0.034, 2.1e-4, 0.017, 0.0029, 0.1, 0.65, 4.1,
                0.85,
            ),
            Link(
                (0.0, 0.0, 0.09), Y, 0.11, (0.17, 0.0, 0.0), 0.007, 1.7e-4, 0.014, 0.0024, -0.4,
                0.5, 3.6, 0.7,
            ),
            Link(
                (0.17, 0.0, 0.0), Y, 0.07, (0.15, 0.0, -0.02), 0.006, 1.2e-4, 0.009, 0.0016, 0.8,
                0.55, 4.4, 0.4,
            ),
        ),
        1000.0, 20.0, 1e-3, 1.1e4, 0.006, 6.0, "smooth", True,
    ),
    # two vertical axes, a quill, a roll
    "scara4": SimulatedRobot(
        (
            Link(ORIGIN, Z, 5.3, (0.32, 0.0, 0.0), 0.047, 0.43, 2.6, 1.5, 0.3, 0.9, 3.2, 85.0),
            Link(
                (0.32, 0.0, 0.06), Z, 3.4, (0.26, 0.0, 0.0), 0.041, 0.17, 1.4, 0.8, -0.5, 1.1, 4.1,
                34.0,
            ),
            Link(
                (0.26, 0.0, 0.0), Z, 1.7, (0.0, 0.0, -0.24), 0.013, 4.4, 8.8, 27.0, -0.02, 0.07,
                0.42, 130.0, slides=True,
            ),
            Link(
                (0.0, 0.0, -0.24), Z, 0.6, (0.05, 0.0, -0.06), 0.022, 0.011, 0.19, 0.06, 0.2, 1.4,
                7.0, 6.0,
            ),
        ),
        500.0, 22.0, counts=2.4e5, noise=0.005, dry="stiff", speeds=True,
    ),
    "gantry2": SimulatedRobot(
        (
            Link(
                ORIGIN, X, 14.0, (0.0, 0.0, 0.18), 0.06, 21.0, 34.0, 96.0, 0.1, 0.34, 1.1, 420.0,
                slides=True,
            ),
            Link(
                (0.0, 0.0, 0.18), Z, 3.9, (0.0, 0.06, -0.31), 0.031, 6.8, 16.0, 41.0, -0.05, 0.16,
                0.8, 210.0, slides=True,
            ),
        ),
        1000.0, 20.0, counts=1.1e6, noise=0.004,
    ),
    "desk6": SimulatedRobot(
        (
            Link(ORIGIN, Z, 2.1, (0.0, 0.0, 0.14), 0.055, 0.21, 1.7, 1.2, 0.0, 1.2, 2.6, 40.0),
            Link(
                (0.0, 0.04, 0.14), Y, 2.6, (0.0, 0.0, 0.34), 0.038, 0.24, 1.9, 1.4, 0.5, 0.7, 2.2,
                62.0,
            ),
            Link(
                (0.0, -0.02, 0.34), Y, 1.8, (0.31, 0.0, 0.0), 0.034, 0.13, 1.2, 0.9, 0.3, 0.8, 2.6,
                34.0,
            ),
            Link(
                (0.31, 0.0, 0.03), X, 0.9, (0.09, 0.0, 0.0), 0.03, 0.04, 0.5, 0.3, 0.2, 1.3, 3.5,
                11.0,
            ),
            Link(
                (0.09, 0.0, 0.0), Y, 0.7, (0.08, 0.0, 0.01), 0.027, 0.032, 0.42, 0.24, -0.4, 1.1,
                3.7, 10.0,
            ),
            Link(
                (0.08, 0.0, 0.0), X, 0.35, (0.05, 0.02, 0.0), 0.024, 0.017, 0.25, 0.13, 0.0, 1.7,
                5.0, 5.0,
            ),
        ),
        125.0, 40.0, counts=4.2e5, noise=0.005, dry="usual",
    ),
    "works6": SimulatedRobot(
        (
            Link(ORIGIN, Z, 48.0, (0.0, 0.0, 0.42), 0.16, 19.0, 74.0, 88.0, 0.1, 1.0, 1.7, 1900.0),
            Link(
                (0.16, 0.0, 0.42), Y, 36.0, (0.0, 0.0, 0.71), 0.1, 24.0, 92.0, 97.0, 0.4, 0.5, 1.4,
                2600.0,
            ),
            Link(
                (0.0, 0.0, 0.71), Y, 23.0, (0.21, 0.0, 0.13), 0.09, 9.4, 51.0, 44.0, 0.2, 0.6, 1.7,
                1100.0,
            ),
            Link(
                (0.48, 0.0, 0.13), X, 11.0, (0.26, 0.0, 0.0), 0.07, 1.9, 16.0, 11.0, 0.0, 1.4, 3.0,
                210.0,
            ),
            Link(
                (0.26, 0.0, 0.0), Y, 5.2, (0.1, 0.0, 0.0), 0.06, 1.3, 12.0, 8.1, 0.6, 0.9, 3.0,
                170.0,
            ),
            Link(
                (0.1, 0.0, 0.0), X, 2.4, (0.08, 0.03, 0.0), 0.05, 0.5, 5.7, 3.2, 0.3, 2.1, 4.1,
                80.0,
            ),
        ),
        250.0, 30.0, counts=9.5e5, noise=0.003,
    ),
    "light7": SimulatedRobot(
        (
            Link(ORIGIN, Z, 3.3, (0.0, 0.0, 0.17), 0.06, 0.37, 1.3, 1.1, 0.1, 1.0, 2.0, 90.0),
            Link(
                (0.0, 0.0, 0.17), Y, 3.1, (0.0, 0.0, 0.19), 0.055, 0.41, 1.4, 1.2, 0.4, 0.7, 1.8,
                95.0,
            ),
            Link(
                (0.0, 0.0, 0.19), Z, 2.5, (0.03, 0.0, 0.2), 0.05, 0.27, 1.0, 0.8, -0.2, 1.0, 2.1,
                52.0,
            ),
            Link(
                (0.05, 0.0, 0.2), Y, 2.2, (-0.03, 0.0, 0.19), 0.046, 0.25, 0.9, 0.7, -1.1, 0.7, 2.1,
                50.0,
            ),
            Link(
                (-0.05, 0.0, 0.19), Z, 1.9, (0.0, 0.02, 0.17), 0.042, 0.11, 0.5, 0.35, 0.3, 1.2,
                2.9, 16.0,
            ),
            Link(
                (0.0, 0.0, 0.17), Y, 1.3, (0.06, 0.0, 0.03), 0.04, 0.09, 0.45, 0.3, 0.9, 0.8, 2.8,
                15.0,
            ),
            Link(
                (0.08, 0.0, 0.0), Z, 0.7, (0.0, 0.03, 0.08), 0.03, 0.04, 0.3, 0.16, 0.0, 1.5, 3.3,
                7.0,
            ),
        ),
        1000.0, 24.0, counts=6.4e5, noise=0.005, dry="usual", speeds=True,
    ),
}  # fmt: skip
