"""Where a motion is to be played, and making it fit there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.excite.foresee import efforts, nominal, problem_of
from hil.excite.margins import HEADROOM, Margin, margins
from hil.excite.question import Question, ready
from hil.excite.space import Space
from hil.excite.trajectory import Trajectory
from hil.identify.bands import Rates
from hil.identify.problem import Problem
from hil.models.model import RobotModel
from hil.record.recording import RobotSource

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
    """The motion made small enough for every limit, foreseen, with its margins."""
    limits, robot = stage.space.limits, stage.space.robot
    for _ in range(30):
        problem = ready(stage.foresee(motion), question)
        found = margins(motion, limits, robot, efforts(problem))
        if not any(_beyond(m) for m in found):
            break
        motion = motion.shrunk(0.9, limits.center)
    return motion, problem, found


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
