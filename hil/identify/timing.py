"""Alignment of effort and position within one sample.

A command that is held over its period acts half a period late, and position and effort of one
row are rarely taken at the same instant.  Up to one sample that is how the recording was made,
not a physical delay; left in, it imitates small effects at every reversal.
"""

from __future__ import annotations

import numpy as np

from hil.identify.design import Term
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.identify.shapes import Projector
from hil.models import catalogue
from hil.models.model import RobotModel


def longest_shift(problem: Problem) -> float:
    """What counts as alignment and not as delay: a twentieth more than one sample [s]."""
    return 1.05 * max(1.0 / r.rate for r in problem.recordings)


def sample_shift(result: FitResult) -> float:
    """Delay of the effort against the motion [s], common to all joints; 0 beyond one sample.

    The median over joints of the delays that the residual asks for, so that one joint's real
    delay or hysteresis does not shift the others.
    """
    problem = result.problem
    if result.model.explains != "motor":
        return 0.0
    late = {t.joint for t in result.terms if t.effect.name == "delay"}
    projector = Projector(problem, result.terms, result.sigma)
    effect = catalogue.get("delay")
    delays = []
    for j in set(range(problem.d)) - late:
        gain, beta, _, _ = projector.score(Term(effect, j))
        strong = gain > 10 * np.log(problem.n)
        delays.append(float(beta[0]) if strong and beta.size else 0.0)
    shift = float(np.median(delays)) if delays else 0.0
    return shift if abs(shift) <= longest_shift(problem) else 0.0


def fit_aligned(problem: Problem, model: RobotModel) -> FitResult:
    """Fit, align the effort within one sample, fit again; leaves the problem aligned."""
    result = fit(problem, model)
    shift = sample_shift(result)
    if not shift:
        return result
    problem.shift_effort(shift)  # tau(t) = model(t) + T tau'(t)
    return fit(problem, model)
