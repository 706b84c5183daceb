"""Where a motion could be played that follows on a recording: the robot's limits, else its own."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hil.excite.limits import Limits, of_data, of_robot
from hil.excite.space import explore
from hil.excite.stage import Stage
from hil.identify import standstill
from hil.identify.problem import Problem
from hil.models.effect import Effect

#: Length of a motion of the menu [s]: of a described robot, whose rigid body costs time, and else.
DESCRIBED, BARE = 12.0, 30.0


def stage_of(problem: Problem, seconds: float = 0.0) -> Stage:
    """Stage for the robot of some runs, with their filter band and encoders.

    A robot that brings no limits (independent axes) keeps to what was recorded: its range, twice
    its speed, twice its effort.

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
    noise = np.maximum(standstill.quanta(first), standstill.position_noise(first))
    quantum = np.maximum(noise, 1e-6 * (limits.high - limits.low))
    space = explore(limits, problem.robot)
    seconds = seconds or (DESCRIBED if problem.source.urdf else BARE)
    return Stage(space, problem.source, problem.rates, quantum, seconds)


def room(problem: Problem) -> bool:
    """Whether there is a range of every joint to move in."""
    own = of_robot(problem.source)
    limits = of_data(problem.q.T, problem.qd.T, problem.effort.T) if own is None else own
    return limits.center.size == problem.d and not np.any(limits.high <= limits.low)


def robot_word(problem: Problem) -> str:
    """What stands for a robot in a command of `hil excite`: the session, where that says enough.

    Of a preset it is the rig; of a robot that only the model describes, its URDF.
    """
    source, first = problem.source, problem.recordings[0]
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
