"""The motion of the menu that answers a question best, and whether any can."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.excite import menu
from hil.excite.foresee import efforts, nominal, problem_of
from hil.excite.margins import HEADROOM, Margin, margins
from hil.excite.separate import Question, Verdict, gram, ready, worst
from hil.excite.space import Space
from hil.excite.trajectory import Trajectory
from hil.identify.bands import Rates
from hil.identify.problem import Problem
from hil.models.model import RobotModel
from hil.record.recording import RobotSource

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Option:
    """One motion of the menu with what it would say.

    Parameters
    ----------
    motion : Trajectory
        The motion, within all limits.
    verdict : Verdict
        On the hardest pair, together with what is recorded already.
    margins : list of Margin
        To each limit.
    """

    motion: Trajectory
    verdict: Verdict
    margins: list[Margin]


@dataclass(frozen=True)
class Choice:
    """The menu, best first.

    Parameters
    ----------
    options : list of Option
        Best first.
    now : Verdict or None
        Of what is recorded already.
    everything : Verdict
        Of the whole menu together.
    """

    options: list[Option]
    now: Verdict | None
    everything: Verdict

    @property
    def best(self) -> Option:
        """The best motion."""
        return self.options[0]

    @property
    def structural(self) -> bool:
        """Whether no motion of the menu, nor all together, could ever decide."""
        return not any(v.possible for v in (self.everything, *(o.verdict for o in self.options)))


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
    asked = Question(base, theta, [], np.ones(len(motion.joints)), first.v0, first.contact)
    out, _, found = fitted(motion, stage, asked)
    return out, found


def _beyond(m: Margin) -> bool:
    """Whether a planned motion passes a limit, or its share of speed and torque."""
    planned = m.what.startswith(("speed", "torque"))
    return m.used > HEADROOM * m.limit * (1 + 1e-6) if planned else m.broken


def choose(
    question: Question,
    stage: Stage,
    joint: int | None,
    known: FloatArray | None = None,
    names: tuple[str, ...] = tuple(menu.MENU),
) -> Choice:
    """Score every motion of the menu.

    Parameters
    ----------
    question : Question
        Base, rivals, noise.
    stage : Stage
        Robot, limits, band, length.
    joint : int or None
        Joint that is to move; None: all of them in turn.
    known : ndarray (p, p), optional
        Gram matrix of what is recorded already.
    names : tuple of str
        Motions to look at.
    """
    d = stage.space.center.size
    usable = [n for n in names if d > 1 or n not in ("pairs", "one-at-a-time", "postures")]
    start = 0.0 if known is None else known
    options, total = [], np.zeros(()) + start
    for name in usable:
        motion = menu.MENU[name](stage.space, joint, stage.seconds)
        motion, problem, found = fitted(motion, stage, question)
        own = gram(problem, question)
        # as long as the others: information per time counts
        own = own * (stage.seconds / motion.period)
        total = total + own
        options.append(Option(motion, worst(start + own, question), found))
    options.sort(key=lambda o: -o.verdict.odds)
    now = None if known is None else worst(known, question)
    return Choice(options, now, worst(total, question))
