"""Laws in joint space for arms of any number of joints, their rigid bodies from the URDF.

``joint-pd`` and ``computed-torque`` play a trajectory (see `hil excite`) or hold a posture;
``joint-coupling`` ties two arms to each other by their positions; it is judged before it runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import cos, pi, sin, tanh
from typing import Any

import numba as nb
import numpy as np

from hil.errors import ConfigError
from hil.excite import trajectory
from hil.excite.trajectory import period_times, sample
from hil.models.bodies import inverse_dynamics, loop_room
from hil.models.robots import bare_robot
from hil.record.recording import RobotSource
from hil.signals.device import FloatArray
from hil.signals.settable import ArmDescription, SettableRange
from hil.teleop import gate

#: Speed over which friction fed forward changes its side [rad/s].
EDGE = 0.05


class Chain:
    """Rigid bodies of an arm, as its URDF has them, ready for the loop.

    Parameters
    ----------
    arm : ArmDescription
        The arm.

    Raises
    ------
    ConfigError
        If it is no URDF, or a joint follows another one.
    """

    def __init__(self, arm: ArmDescription) -> None:
        if not arm.urdf:
            raise ConfigError(
                "laws for any number of joints need the arm's URDF; give the arm robot = "
                '"arm.urdf", or take joint-tracking for the PHANTOM'
            )
        robot = bare_robot(RobotSource("", arm.urdf))
        tree = robot.tree
        if tree is None or not tree.alone:
            raise ConfigError("a joint of the URDF follows another one; fix it there")
        bodies = np.ascontiguousarray((tree.spread @ robot.prior).reshape(-1, 10))
        self.known = (tree.parent, tree.turn, tree.place, tree.axis, tree.gravity, bodies)
        self.room = loop_room(arm.d)

    def efforts(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Efforts (d,) of a state; for building a law."""
        out = np.zeros(q.size)
        inverse_dynamics(*self.known, q, qd, qdd, self.room, out)
        return out

    def inertia(self, q: FloatArray) -> FloatArray:
        """Mass matrix (d, d) [kg m^2 or kg]."""
        none = np.zeros(q.size)
        still = self.efforts(q, none, none)
        return np.stack([self.efforts(q, none, row) - still for row in np.eye(q.size)])


@dataclass(frozen=True)
class _Gains:
    """What all laws here have.

    Parameters
    ----------
    bandwidth_hz, damping_ratio : float
        Of the error of every joint.
    armature : tuple of float
        Guess at what the rotors add to the inertia of each joint [kg m^2 or kg]; empty: nothing.
    velocity_filter : float
        Time constant of the first-order filter on the speed [s].
    """

    bandwidth_hz: float = 3.0
    damping_ratio: float = 0.8
    armature: tuple[float, ...] = ()
    velocity_filter: float = 0.004

    def __post_init__(self) -> None:
        if min(self.bandwidth_hz, self.damping_ratio, self.velocity_filter) <= 0:
            raise ConfigError("bandwidth_hz, damping_ratio and velocity_filter are above 0.")
        if any(a < 0 for a in self.armature):
            raise ConfigError("armature is from 0 on.")

    def settable(self) -> dict[str, SettableRange]:
        """What an operator may set."""
        return {
            "bandwidth_hz": SettableRange(0.2, 6.0, "Hz"),
            "damping_ratio": SettableRange(0.2, 1.5),
            "velocity_filter": SettableRange(0.001, 0.02, "s"),
        }

    def rotors(self, d: int) -> FloatArray:
        """`armature` (d,)."""
        return per_joint(self.armature, d, "armature")


def per_joint(values: tuple[float, ...], d: int, name: str) -> FloatArray:
    """`values` as an array (d,); zeros where there are none.

    Raises
    ------
    ConfigError
        For another number of entries.
    """
    if len(values) not in (0, d):
        raise ConfigError(f"{name} needs {d} entries, one per joint, not {len(values)}.")
    return np.array(values, dtype=np.float64) if values else np.zeros(d)


@dataclass(frozen=True)
class JointMotionConfig(_Gains):
    """Parameters of ``joint-pd`` and ``computed-torque``.

    Parameters
    ----------
    trajectory : str
        Trajectory file that every arm plays; empty: the arms go to `center`.
    center : tuple of float
        Posture [rad or m]; empty: the middle of the joints' ranges.
    friction : tuple of float
        Coulomb friction that is fed forward [N m or N]; empty: none.
    blend : float
        Time over which the motion swells from the starting posture [s].
    """

    trajectory: str = ""
    center: tuple[float, ...] = ()
    friction: tuple[float, ...] = ()
    blend: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.blend <= 0:
            raise ConfigError("blend is above 0.")


@nb.njit(cache=True, nogil=True)
def _aim(t: float, x: Any, u: Any, table: Any, goal: Any, times: Any, x_next: Any) -> None:
    """Reference place, speed and acceleration (3, d) into `goal`, filtered speed into `x_next`.

    Parameters
    ----------
    x, x_next : ndarray (1 + 3 d,)
        1 once started, starting posture, reference, filtered speed.
    u : ndarray (2 d + 6,)
        Of one arm.
    table : ndarray (n, d, 3)
        Place, speed and acceleration of the motion at every tick of one period.
    times : ndarray (3,)
        Blending time [s], share of the velocity filter, period of the loop [s].
    """
    d = table.shape[1]
    row = round(t / times[2]) % table.shape[0]
    part = min(1.0, t / times[0])
    ramp, rate, push = (1.0 - cos(pi * part)) / 2.0, 0.0, 0.0
    if part < 1.0:
        w = pi / times[0]
        rate, push = w / 2.0 * sin(pi * part), w * w / 2.0 * cos(pi * part)
    x_next[0] = 1.0
    for i in range(d):
        place, speed, change = table[row, i, 0], table[row, i, 1], table[row, i, 2]
        start = x[1 + i] if x[0] > 0.0 else u[i]
        # r = q0 + ramp (motion - q0)
        goal[0, i] = start + ramp * (place - start)
        goal[1, i] = ramp * speed + rate * (place - start)
        goal[2, i] = ramp * change + 2.0 * rate * speed + push * (place - start)
        before = x[1 + 2 * d + i] if x[0] > 0.0 else u[d + i]
        x_next[1 + i], x_next[1 + d + i] = start, goal[0, i]
        # v <- v + share (q' - v)
        x_next[1 + 2 * d + i] = before + times[1] * (u[d + i] - before)


@nb.njit(cache=True, nogil=True)
def pd(u: Any, v: Any, goal: Any, gains: Any, chain: Any, room: Any, work: Any, y: Any) -> None:
    """Tau = K (r - q) + D (r' - v) + Fc tanh(r' / 0.05) + g(q)  into `y` (d,).

    `gains` (5, d): inertia, rotor, friction, and of the error w^2, 2 z w; K and D are these times
    inertia and rotor.
    """
    d = y.size
    for i in range(d):
        work[0, i], work[1, i] = u[i], 0.0
    a, b, c, e, f, g = chain
    inverse_dynamics(a, b, c, e, f, g, work[0], work[1], work[1], room, y)
    for i in range(d):
        pull = gains[3, i] * (goal[0, i] - u[i]) + gains[4, i] * (goal[1, i] - v[i])
        y[i] += (gains[0, i] + gains[1, i]) * pull
        y[i] += gains[2, i] * tanh(goal[1, i] / EDGE)


@nb.njit(cache=True, nogil=True)
def computed(
    u: Any, v: Any, goal: Any, gains: Any, chain: Any, room: Any, work: Any, y: Any
) -> None:
    """Tau = M(q) a + h(q, v) + J a + Fc tanh(r' / 0.05) into `y` (d,).

    With a = r'' + w^2 (r - q) + 2 z w (r' - v); `gains` as of `pd`.
    """
    d = y.size
    for i in range(d):
        work[0, i], work[1, i] = u[i], v[i]
        work[2, i] = goal[2, i] + gains[3, i] * (goal[0, i] - u[i])
        work[2, i] += gains[4, i] * (goal[1, i] - v[i])
    a, b, c, e, f, g = chain
    inverse_dynamics(a, b, c, e, f, g, work[0], work[1], work[2], room, y)
    for i in range(d):
        y[i] += gains[1, i] * work[2, i] + gains[2, i] * tanh(goal[1, i] / EDGE)


#: What damping times the delay of a loop (filter, sampling) may come to.
MOST_LAG = 0.7


def _gains(
    config: _Gains, arm: ArmDescription, chain: Chain, friction: FloatArray, period: float
) -> FloatArray:
    """Rows of `pd`.

    Joints that move others feel less inertia than the diagonal of M has: the quickest motion of
    all joints together is damped by 2 z w times the largest eigenvalue of M^-1 diag(M).  Where the
    delay of the loop does not allow that, inertia and rotor, and with them K and D, are less.
    """
    w, one, rotors = 2 * pi * config.bandwidth_hz, np.ones(arm.d), config.rotors(arm.d)
    whole = chain.inertia(np.array(arm.center)) + np.diag(rotors)
    _refuse_weightless(whole, arm.joints)
    own = np.diag(whole).copy()
    quickest = np.abs(np.linalg.eigvals(np.linalg.solve(whole, np.diag(own)))).max()
    lag = 2 * config.damping_ratio * w * quickest * (config.velocity_filter + 1.5 * period)
    felt = own * min(1.0, MOST_LAG / lag) - rotors
    pull, brake = w * w * one, 2 * config.damping_ratio * w * one
    return np.array([felt, rotors, friction, pull, brake])


#: Least share of its largest eigenvalue that a mass matrix has.
_SINGULAR = 1e-9


def _refuse_weightless(mass: FloatArray, joints: tuple[str, ...]) -> None:
    """Refuse a robot of which some joint moves no mass: no gain can be told for it."""
    least = np.linalg.eigvalsh(mass)
    if least[0] > _SINGULAR * max(least[-1], 0.0):
        return
    own = np.diag(mass)
    bare = [n for n, m in zip(joints, own, strict=True) if m <= _SINGULAR * own.max()] or joints
    raise ConfigError(
        f"the URDF has no mass that {', '.join(bare)} would move, so the law has no gains; "
        "give its links <inertial> with mass and inertia, or guess at the rotors with armature = "
        f"{[0.01] * len(joints)} [kg m^2 or kg] in [controller.parameters]."
    )


def _share(config: _Gains, period: float) -> float:
    return float(1.0 - np.exp(-period / config.velocity_filter))


class JointMotion:
    """Plays a motion on every arm by `pd` or `computed`.

    Parameters
    ----------
    config : JointMotionConfig
        Parameters.
    arms : tuple of str
        Names, in the order of u and y.
    period : float
        Of the loop [s].
    robots : tuple of ArmDescription
        What the arms are.
    act : callable
        `pd` or `computed`.
    """

    def __init__(
        self,
        config: JointMotionConfig,
        arms: tuple[str, ...],
        period: float,
        robots: tuple[ArmDescription, ...],
        act: Any,
    ) -> None:
        self.config, self._act = config, act
        d = self._d = robots[0].d
        self._own = 1 + 3 * d
        rub = per_joint(config.friction, d, "friction")
        self._rows = []
        for k, robot in enumerate(robots):
            chain = Chain(robot)
            table, gains = _table(config, robot, period), _gains(config, robot, chain, rub, period)
            at = slice(k * self._own, (k + 1) * self._own)
            self._rows.append((at, table, gains, chain.known, chain.room))
        self._times = np.array([config.blend, _share(config, period), period])
        self._goal, self._work = np.zeros((3, d)), np.zeros((3, d))
        whats = ("start", "reference", "speed")
        self.state_names = tuple(
            name
            for arm in arms
            for name in (
                f"{arm}.started",
                *(f"{arm}.{what}{i + 1}" for what in whats for i in range(d)),
            )
        )

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period; see `hil.signals.device.Controller`."""
        for a, (at, table, gains, known, room) in enumerate(self._rows):
            following = x_next[at]
            _aim(t, x[at], u[a], table, self._goal, self._times, following)
            speed = following[1 + 2 * self._d :]
            self._act(u[a], speed, self._goal, gains, known, room, self._work, y[a])


def _table(config: JointMotionConfig, arm: ArmDescription, period: float) -> FloatArray:
    """Place, speed and acceleration (n, d, 3) at every tick; one row where the arm holds still."""
    if not config.trajectory:
        still = np.zeros((1, arm.d, 3))
        still[0, :, 0] = per_joint(config.center, arm.d, "center") if config.center else arm.center
        return still
    motion = trajectory.read_trajectory(config.trajectory)
    if motion.joints != arm.joints:
        raise ConfigError(
            f"trajectory {config.trajectory} moves {', '.join(motion.joints)}, the arm has "
            f"{', '.join(arm.joints)}."
        )
    return np.ascontiguousarray(
        np.stack(sample(motion, period_times(motion, 1.0 / period)), axis=-1)
    )


@dataclass(frozen=True)
class JointCouplingConfig(_Gains):
    """Parameters of ``joint-coupling``.

    Parameters
    ----------
    share : float
        Of the pull on the second arm that the first one feels.
    """

    share: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.share <= 1.0:
            raise ConfigError("share is from 0 to 1.")


class JointCoupling:
    """Position against position: each of two arms is pulled to where the other one is.

    tau_1 = s [K (q2 + o - q1) + D (v2 - v1)] + g(q1), tau_2 likewise with s = 1 and the other
    sign; o is how far apart they were at the start.

    Parameters
    ----------
    config : JointCouplingConfig
        Parameters.
    arms : tuple of str
        Two names.
    period : float
        Of the loop [s].
    robots : tuple of ArmDescription
        What the arms are; with the same number of joints.
    judged : bool
        Whether it is refused where it is unstable over the set of `hil.teleop.gate`.

    Raises
    ------
    ConfigError
        If the law must not run.
    """

    def __init__(
        self,
        config: JointCouplingConfig,
        arms: tuple[str, ...],
        period: float,
        robots: tuple[ArmDescription, ...],
        judged: bool = True,
    ) -> None:
        if len(arms) != 2:
            raise ConfigError(f"joint-coupling ties two arms to each other, not {len(arms)}.")
        self.config = config
        d = self._d = robots[0].d
        chains = [Chain(robot) for robot in robots]
        rub = np.zeros(d)
        rows = [_gains(config, *both, rub, period) for both in zip(robots, chains, strict=True)]
        # one spring between them, by the lighter arm
        body = np.minimum(rows[0][0], rows[1][0])
        for gains in rows:
            gains[0] = body
        self._rows = [(g, c.known, c.room) for g, c in zip(rows, chains, strict=True)]
        self._share, self._goal, self._work = _share(config, period), *np.zeros((2, 3, d))
        self._pull = (config.share, 1.0)
        self._scaled = np.zeros((5, d))
        self.state_names = (
            "started",
            *(f"offset{i + 1}" for i in range(d)),
            *(f"{arm}.speed{i + 1}" for arm in arms for i in range(d)),
        )
        if judged:
            found = coupling_margin(config, arms, period, robots, gate.USUAL_DELAY_TICKS)
            gate.refuse_coupled(found, period, gate.JOINTS)

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period; see `hil.signals.device.Controller`."""
        d, share = self._d, self._share
        filtered(x, u, share, d, x_next)
        for a, (gains, known, room) in enumerate(self._rows):
            facing(a, x_next, u, d, self._goal)
            self._scaled[:] = gains
            self._scaled[3:] *= self._pull[a]
            v = x_next[1 + d + a * d : 1 + 2 * d + a * d]
            pd(u[a], v, self._goal, self._scaled, known, room, self._work, y[a])


@lru_cache(maxsize=16)
def coupling_margin(
    config: JointCouplingConfig,
    arms: tuple[str, ...],
    period: float,
    robots: tuple[ArmDescription, ...],
    latest: float = gate.LONGEST_DELAY_TICKS,
) -> gate.CoupledMargin:
    """How the law stands over the set of `hil.teleop.gate.coupled`.

    Parameters
    ----------
    config, arms, period, robots
        As of `JointCoupling`.
    latest : float
        Longest delay that is tried [ticks].
    """
    law = JointCoupling(config, arms, period, robots, judged=False)
    rotors = [config.rotors(robots[0].d)] * 2
    return gate.coupled(law, robots, rotors, period, latest=latest, drifts=True)


@nb.njit(cache=True, nogil=True)
def filtered(x: Any, u: Any, share: float, d: int, x_next: Any) -> None:
    """Offset of the start, and filtered speeds of both arms, into `x_next` (1 + 3 d,)."""
    x_next[0] = 1.0
    for i in range(d):
        x_next[1 + i] = x[1 + i] if x[0] > 0.0 else u[0, i] - u[1, i]
        for a in range(2):
            n = 1 + d + a * d + i
            before = x[n] if x[0] > 0.0 else u[a, d + i]
            x_next[n] = before + share * (u[a, d + i] - before)


@nb.njit(cache=True, nogil=True)
def facing(a: int, x: Any, u: Any, d: int, goal: Any) -> None:
    """Where arm `a` is to be, as the other one sees it, into `goal` (3, d)."""
    other, sign = 1 - a, 1.0 if a == 0 else -1.0
    for i in range(d):
        goal[0, i] = u[other, i] + sign * x[1 + i]
        goal[1, i] = x[1 + d + other * d + i]
        goal[2, i] = 0.0


@dataclass(frozen=True)
class JointSpaceLaw:
    """What the registry finds: parameters, how the law is built, that it takes any arm, and how it
    is judged where it can be.
    """

    Config: Any
    build: Any
    ANY_JOINTS: bool = True
    margin: Any = None

    @property
    def JUDGED(self) -> bool:
        """Whether building it judges it, also outside of what an operator sets."""
        return self.margin is not None


JOINT_PD = JointSpaceLaw(JointMotionConfig, lambda c, a, t, r: JointMotion(c, a, t, r, pd))
COMPUTED_TORQUE = JointSpaceLaw(
    JointMotionConfig, lambda c, a, t, r: JointMotion(c, a, t, r, computed)
)
JOINT_COUPLING = JointSpaceLaw(JointCouplingConfig, JointCoupling, margin=coupling_margin)
