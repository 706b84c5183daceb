"""Sensitivity-optimised design in two stages (thesis 3.3.2, paper VI).

Stage I (SO) maximises the weighted sensitivity abs(dz_t/dz_e) over eight parameters,

    c_i = theta_i (1 + corner/s), i = 1, 4, 7, 8 (c4 negative),   c_2, c_3, c_5, c_6 numbers,

under tracking in free space and in contact, stability for every passive operator and every
environment of a bounded set, existence of the force-sensor-free form, and bounds.  Stage II
(SOFSF) is `fsf.transform` of the result.  Sensitivity above 1 is feasible in the linear model
unless bounds exclude it: the bounds are part of the design, and every active one is named.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import NonlinearConstraint, minimize

from hil.errors import ConfigError
from hil.teleop import binding, fsf
from hil.teleop.design import Design
from hil.teleop.hybrid import FloatArray
from hil.teleop.problem import Problem
from hil.teleop.search import Search

#: How often a search is taken up again, with the frequencies at which it failed.
REFINEMENTS = 4
_BOX = [(0.0, 1.0)] * 8
_OPTIONS = {"maxiter": 60, "ftol": 1e-5, "eps": 1e-6}


@dataclass(frozen=True)
class Found:
    """An optimised design.

    Parameters
    ----------
    design : Design
        Stage I; its force-sensor-free form is `fsf.transform(design)`.
    theta : tuple of 8 floats
        Parameters, for a warm start.
    sensitivity : float
        Weighted sensitivity sigma_c.
    active : tuple of Active
        What binds, the most expensive first.
    starts, agreeing : int
        Searches made, and how many ended within 1 % of the best.
    """

    design: Design
    theta: tuple[float, ...]
    sensitivity: float
    active: tuple[binding.Active, ...]
    starts: int
    agreeing: int


def optimise(
    problem: Problem, start: tuple[float, ...] | None = None, starts: int = 8, seed: int = 0
) -> Found:
    """Maximise the sensitivity.

    Parameters
    ----------
    problem : Problem
        Task and bounds.
    start : tuple of 8 floats, optional
        `Found.theta` of a neighbouring problem: one search from there (fast enough for a
        re-design on line).
    starts, seed : int
        Searches from random points, without `start`.

    Raises
    ------
    ConfigError
        If no start leads to a feasible design; it names the constraint that fails least.
    """
    search, rng = Search(problem), np.random.default_rng(seed)
    first = [np.clip(np.array(start) / search.top, 0.0, 1.0)] if start is not None else [
        np.array([0.7, 0.4, 0.1, 0.6, 0.1, 0.0, 0.8, 0.8]),
        *rng.uniform(0.0, 1.0, (max(starts - 1, 0), 8)),
    ]  # fmt: skip
    ends = [_climb(search, x) for x in first]
    good = [(search.sensitivity(x), x) for x in ends if search.worst(x)[1] > -1e-3]
    if not good:
        closest = max((search.worst(x) for x in ends), key=lambda r: r[1])
        raise ConfigError(
            f"no design meets all constraints; nearest miss: {closest[0]!r} by "
            f"{-100 * closest[1]:.3g} % of its scale; relax it, or allow larger gains "
            f"(stiffness {problem.stiffness:g} N/m, force {problem.force:g})"
        )
    best, x = max(good, key=lambda r: r[0])
    agreeing = sum(value > 0.99 * best for value, _ in good)
    theta = tuple(float(v) for v in x * search.top)
    return Found(search.design(x), theta, best, binding.active(search, x), len(first), agreeing)


def _climb(search: Search, x: FloatArray) -> FloatArray:
    """Sequential quadratic programming on scaled parameters; grid refined where it was passed."""
    climb: Any = minimize
    for _ in range(REFINEMENTS):
        with np.errstate(all="ignore"):  # the search may pass through designs without a matrix
            found = climb(
                lambda v: -search.sensitivity(v), x, method="SLSQP", bounds=_BOX,
                constraints=NonlinearConstraint(search.flat, 0.0, np.inf),
                options=_OPTIONS,
            )  # fmt: skip
        x = np.asarray(np.clip(found.x, 0.0, 1.0), np.float64)
        if not search.refine(x):
            break
    return x


def two_stages(found: Found, limit: float = fsf.REFUSED) -> tuple[Design, Design]:
    """Both stages: SO, and SOFSF that needs no force sensor."""
    return found.design, fsf.transform(found.design, limit)
