"""Where a motion is to be played, and making it fit there.

A stage says how far each joint may go from the middle posture, alone and together with the others.
A motion that follows on a recording is played within the robot's limits, else within its own.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.excite.question import Question, efforts, nominal, problem_of, ready
from hil.excite.trajectory import (
    HEADROOM,
    Limits,
    Margin,
    Trajectory,
    allowed,
    grid,
    margins,
    of_data,
    of_robot,
    sample,
    torques,
)
from hil.identify import bands
from hil.identify.bands import Rates
from hil.identify.problem import Problem
from hil.models.effect import Effect
from hil.models.model import RobotModel
from hil.models.robots import Robot
from hil.record.recording import BAG, RobotSource

#: Share of the way to a position limit that is used.
LIMIT_USE = 0.95
#: Speed of a joint whose limit nobody knows: its range in two seconds.
CROSSING = 2.0


@dataclass(frozen=True)
class Space:
    """Room for motions around a posture.

    Parameters
    ----------
    robot : Robot
        Joints and geometry.
    limits : Limits
        The limits.
    center : ndarray (d,)
        Middle posture [rad or m].
    alone : ndarray (d, 2)
        Range of each joint while the others stay in the middle.
    together : ndarray (d, 2)
        Range of each joint in which all of them may move at once.
    speed : ndarray (d,)
        Largest planned speed [rad/s or m/s].
    """

    robot: Robot
    limits: Limits
    center: FloatArray
    alone: FloatArray
    together: FloatArray
    speed: FloatArray


def explore(limits: Limits, robot: Robot) -> Space:
    """Measure the room around the middle posture of the limits.

    Raises
    ------
    ConfigError
        If that posture itself is outside.
    """
    center = limits.center
    if not allowed(limits, robot, center[None])[0]:
        raise ConfigError(
            f"the middle posture {np.round(center, 3).tolist()} is outside the limits of "
            f"{limits.source}; give the rig file another center or wider limits"
        )
    d = center.size
    alone = np.array([_along(limits, robot, j) for j in range(d)])
    reach = alone - center[:, None]
    together = center[:, None] + _common(limits, robot, reach) * reach
    width = np.ptp(alone, axis=1)
    speed = HEADROOM * np.where(np.isfinite(limits.speed), limits.speed, width / CROSSING)
    return Space(robot, limits, center, alone, together, speed)


def _along(limits: Limits, robot: Robot, j: int) -> tuple[float, float]:
    """Positions that joint j reaches either way before a limit, less a margin."""
    ends = []
    for end in (limits.low[j], limits.high[j]):
        steps = np.linspace(0.0, 1.0, 200)
        q = np.tile(limits.center, (steps.size, 1))
        q[:, j] += steps * (end - limits.center[j])
        ok = allowed(limits, robot, q)
        far = steps[-1] if ok.all() else steps[int(np.argmin(ok)) - 1]
        ends.append(float(limits.center[j] + LIMIT_USE * far * (end - limits.center[j])))
    return ends[0], ends[1]


def _common(limits: Limits, robot: Robot, reach: FloatArray) -> float:
    """Largest factor by which all ranges may be used at once: corners and points between."""
    rng = np.random.default_rng(0)
    sides = rng.integers(0, 2, (256, reach.shape[0]))
    inner = rng.uniform(0.0, 1.0, (256, reach.shape[0]))
    inner[:64] = 1.0
    corners = np.take_along_axis(reach[None], sides[:, :, None], axis=2)[..., 0] * inner
    for factor in np.linspace(1.0, 0.05, 39):
        if np.all(allowed(limits, robot, limits.center + factor * corners)):
            return float(factor)
    return 0.05


FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Stage:
    """Where a motion is to be played.

    Parameters
    ----------
    space : Space
        Room and limits.
    source : RobotSource
        The robot.
    rates : Rates
        Filter band.
    quantum : ndarray (d,)
        Resolution of the encoders [rad or m].
    seconds : float
        Length of each motion [s].
    """

    space: Space
    source: RobotSource
    rates: Rates
    quantum: FloatArray
    seconds: float = 30.0

    def foresee(self, motion: Trajectory) -> Problem:
        """What a motion would record, but for the efforts."""
        return problem_of(motion, self.source, self.rates, self.quantum)


def fitted(
    motion: Trajectory, stage: Stage, question: Question
) -> tuple[Trajectory, Problem, list[Margin]]:
    """The motion made small enough for every limit, foreseen, with its margins.

    Its efforts are foreseen where it keeps the other limits.  One that passes the middle posture
    and breaks a torque limit even as small as it may become breaks it there: no size between is
    foreseen.
    """
    limits, robot = stage.space.limits, stage.space.robot
    sizes = [motion]
    for _ in range(SIZES):
        sizes.append(sizes[-1].shrunk(SMALLER, limits.center))

    def foreseen_at(k: int, free: list[Margin]) -> tuple[Trajectory, Problem, list[Margin]]:
        problem = ready(stage.foresee(sizes[k]), question)
        found = free + torques(limits, robot, efforts(problem))
        # one that is too large at any size is played smaller still
        return sizes[k + any(_beyond(m) for m in found)], problem, found

    def unloaded(k: int) -> list[Margin]:
        return margins(sizes[k], limits, robot)

    last, first = SIZES - 1, True
    for k in range(last):
        free = unloaded(k)
        if any(_beyond(m) for m in free):
            continue
        out = foreseen_at(k, free)
        if out[0] is sizes[k]:
            return out
        if first and _passes_middle(motion, stage.space):
            smallest = foreseen_at(last, unloaded(last))
            if smallest[0] is not sizes[last]:
                return smallest
        first = False
    return foreseen_at(last, unloaded(last))


#: Sizes of a motion that are tried, each by so much smaller than the one before.
SIZES, SMALLER = 30, 0.9
#: Share of the way from the middle posture to the ends of the ranges that is next to it.
NEAR_MIDDLE = 0.05


def _passes_middle(motion: Trajectory, space: Space) -> bool:
    """Whether a motion passes by the middle posture."""
    q = sample(motion, grid(motion, MIDDLE_RATE))[0]
    reach = np.maximum(np.max(np.abs(space.alone - space.center[:, None]), axis=1), 1e-12)
    return bool(np.min(np.max(np.abs(q - space.center) / reach, axis=1)) < NEAR_MIDDLE)


#: Rate at which that is looked at [Hz].
MIDDLE_RATE = 100.0


def foreseen(
    motion: Trajectory, stage: Stage, model: RobotModel
) -> tuple[Trajectory, list[Margin]]:
    """A motion that no question is asked of, made small enough, with its margins."""
    problem = stage.foresee(motion)
    base, theta = nominal(model, problem, stage.space.limits)
    first = problem.motions[0]
    one = np.ones(len(motion.joints))
    asked = Question(base, theta, [], one, first.v0, first.contact, stage.space.alone)
    out, _, found = fitted(motion, stage, asked)
    return out, found


def _beyond(m: Margin) -> bool:
    """Whether a planned motion passes a limit, or its share of speed and torque."""
    planned = m.what.startswith(("speed", "torque"))
    return m.used > HEADROOM * m.limit * (1 + 1e-6) if planned else m.broken


#: Length of a motion of the menu [s]: of a described robot, whose rigid body costs time, and else.
DESCRIBED, BARE = 12.0, 30.0


def stage_of(problem: Problem, seconds: float = 0.0) -> Stage:
    """Stage for the robot of some runs, with their filter band and encoders.

    A robot that brings no limits (independent axes) keeps to what was recorded: its range, twice
    its speed, twice its effort.  Of an axis that turned on and on it takes the middle part, as far
    as it gets in a quarter of the motion.

    Parameters
    ----------
    problem : Problem
        The runs.
    seconds : float
        Length of each motion [s]; 0 chooses.

    Raises
    ------
    ConfigError
        If there is no room to move in.
    """
    q, qd = problem.q.T, problem.qd.T
    own = of_robot(problem.source)
    limits: Limits = of_data(q, qd, problem.effort.T) if own is None else own
    first = problem.recordings[0].q
    noise = np.maximum(bands.quanta(first), bands.position_noise(first))
    quantum = np.maximum(noise, 1e-6 * (limits.high - limits.low))
    space = explore(limits, problem.robot)
    seconds = seconds or (DESCRIBED if problem.source.urdf else BARE)
    space = space if own is not None else _crossed(space, seconds * QUARTER)
    return Stage(space, problem.source, problem.rates, quantum, seconds)


#: Share of a motion in which a joint crosses its range, at least.
QUARTER = 0.25


def _crossed(space: Space, seconds: float) -> Space:
    """The space with ranges that each joint crosses in so many seconds, about its middle."""
    half = np.maximum(space.speed * seconds / 2, 1e-9)[:, None]
    low, high = space.center[:, None] - half, space.center[:, None] + half
    return replace(
        space,
        alone=np.clip(space.alone, low, high),
        together=np.clip(space.together, low, high),
    )


def room(problem: Problem) -> bool:
    """Whether there is a range of every joint to move in."""
    own = of_robot(problem.source)
    limits = of_data(problem.q.T, problem.qd.T, problem.effort.T) if own is None else own
    return limits.center.size == problem.d and not np.any(limits.high <= limits.low)


def robot_word(problem: Problem) -> str:
    """What stands for a robot in a command of `hil excite`: the session, where that says enough.

    Of a preset it is the rig; of a robot that only the model describes, its URDF; of a bag without
    a description, the bag.
    """
    source, first = problem.source, problem.recordings[0]
    if BAG in first.metadata:
        return "ROBOT.urdf" if source.urdf else shlex.quote(first.metadata[BAG])
    if source.urdf:
        return f"{first.name}.mcap" if first.robot.urdf == source.urdf else "ROBOT.urdf"
    return f"{first.name}.mcap" if source.preset in ("", "single-axis") else "RIG.toml"


def output_words(problem: Problem) -> list[str]:
    """Where `hil excite` writes; of a robot that `hil run` cannot move also a table."""
    own = robot_word(problem) != "RIG.toml"
    return ["-o", "next.toml", *(["--csv", "next.csv"] if own else [])]


def model_words(effects: Iterable[Effect]) -> list[str]:
    """What a command of `hil excite` needs besides, where an effect is a user's own."""
    own = any(not type(e).__module__.startswith("hil.models.") for e in effects)
    return ["--model", "M.toml"] if own else []
