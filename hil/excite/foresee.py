"""What a planned motion would record: an identification problem without a measurement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.excite.limits import Limits
from hil.excite.trajectory import Trajectory, grid, sample
from hil.identify.bands import Rates
from hil.identify.context import update_load
from hil.identify.design import Term, bind, coefficients
from hil.identify.problem import Problem
from hil.identify.solve import prior, slices_of
from hil.models.effect import Trait
from hil.models.model import RobotModel
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]
#: Samples per cut-off of the position filter.
OVERSAMPLING = 3.0
#: Filter band where no recording sets one [Hz].
BAND = Rates(60.0, 20.0)
#: Friction of a joint of which nothing is known, as a share of its torque limit.
FRICTION = 0.015


def problem_of(x: Trajectory, source: RobotSource, rates: Rates, quantum: FloatArray) -> Problem:
    """Problem of one period of a motion, without efforts.

    `quantum` (d,) [rad or m] is what the encoders resolve: what is slower than that stands.
    """
    t = grid(x, OVERSAMPLING * rates.position)
    q = np.round(sample(x, t)[0] / quantum) * quantum
    nothing = np.zeros_like(q)
    run = Recording(x.name, "arm", x.joints, t, q, nothing, robot=source)
    return Problem([run], source, rates=rates)


def complete(problem: Problem, terms: Sequence[Term], theta: FloatArray) -> None:
    """Give a foreseen problem the loads and efforts that a model predicts.

    tau = sum of all terms' columns times their coefficients, before the filter.
    """
    listed = list(terms)
    slices = slices_of(problem, listed)
    update_load(problem, listed, theta, slices)
    total = [np.zeros_like(m.q) for m in problem.motions]
    for t, where in zip(listed, slices, strict=True):
        at = slice(None) if t.effect.scope.whole else t.joint
        for tau, columns in zip(total, problem.raw(t.effect, t.joint, t.shape), strict=True):
            tau[:, at] += columns @ theta[where]
    pairs = zip(problem.motions, total, strict=True)
    problem.motions = [m.with_(tau=tau) for m, tau in pairs]


def nominal(model: RobotModel, problem: Problem, limits: Limits) -> tuple[list[Term], FloatArray]:
    """Terms of a model and what is known of their coefficients.

    The model's values, else the robot's own; a joint without friction values gets Coulomb
    friction of 1.5 % of its torque limit and as much viscous friction at its top speed.
    """
    terms = []
    for t in bind(model, problem):
        shape = t.shape or t.effect.search.grid(problem.motions[0], t.joint)[0]
        terms.append(t.reshaped(shape))
    names = [n for t in terms for n, _ in coefficients(t, problem)]
    theta = prior(problem, terms, model, names)
    for t, where in zip(terms, slices_of(problem, terms), strict=True):
        torque, speed = float(limits.torque[t.joint]), float(limits.speed[t.joint])
        if t.effect.traits & (Trait.DRY | Trait.VISCOUS) and not np.any(theta[where]):
            dry = FRICTION * torque if np.isfinite(torque) else 0.0
            theta[where] = dry if Trait.DRY in t.effect.traits else dry / max(speed, 1e-9)
    return terms, theta


def efforts(problem: Problem) -> FloatArray:
    """Foreseen efforts before the filter, all runs, shape (n, d) [N m or N]."""
    return np.concatenate([m.tau for m in problem.motions])
