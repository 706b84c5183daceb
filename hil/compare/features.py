"""The variables over which a residual is looked at: speed, reversal, position, load, others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.identify.problem import Problem
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
#: Name, unit, values (n,) and edges of bins.
View = tuple[str, str, FloatArray, FloatArray]


def since_reversal(v: FloatArray, v0: float, t: FloatArray, run: NDArray[np.int_]) -> FloatArray:
    """How far `t` has come since the last change of direction, shape (n,).

    Speeds below v0 keep the old direction; `t` is time [s] or a path length [rad or m].
    """
    way = np.where(np.abs(v) > v0, np.sign(v), 0.0)
    fresh = np.concatenate([[True], np.diff(run) != 0])
    moving = np.flatnonzero((way != 0) | fresh)
    # the direction that holds at each instant: that of the last one above v0
    held = way[moving][np.searchsorted(moving, np.arange(v.size), side="right") - 1]
    turned = fresh | np.concatenate([[False], np.diff(held) != 0])
    last = np.maximum.accumulate(np.where(turned, np.arange(v.size), 0))
    out: FloatArray = t - t[last]
    return out


def path(q: FloatArray, run: NDArray[np.int_]) -> FloatArray:
    """Length of the way gone so far [rad or m], shape (n,); runs follow one another."""
    step = np.concatenate([[0.0], np.abs(np.diff(q))])
    step[np.concatenate([[False], np.diff(run) != 0])] = 0.0
    out: FloatArray = np.cumsum(step)
    return out


def features(result: FitResult, j: int) -> list[View]:
    """Views of joint j."""
    problem = result.problem
    unit = problem.robot.units[j]
    v, q = problem.qd[j], problem.q[j]
    v0 = float(problem.motions[0].v0[j])
    fast = max(float(np.quantile(np.abs(v), 0.99)), 2 * v0)
    speeds = np.geomspace(max(v0, 0.01 * fast), fast, 7)
    out = [
        ("speed", f"{unit}/s", v, np.concatenate([-speeds[::-1], [0.0], speeds])),
        (
            "since-reversal", "s", since_reversal(v, v0, problem.t, problem.run),
            np.array([0, 0.03, 0.06, 0.1, 0.2, 0.4, 0.8, 1e3]),
        ),
        (
            "distance-since-reversal", unit,
            since_reversal(v, v0, path(q, problem.run), problem.run),
            float(np.ptp(q)) * np.array([0, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 10.0]),
        ),
        ("position", unit, q, np.linspace(q.min(), q.max() + 1e-12, 13)),
        ("time", "s", problem.t, np.linspace(0, problem.t.max() + 1e-9, 7)),
    ]  # fmt: skip
    load = problem.filtered([m.load for m in problem.motions])[:, j]
    if np.ptp(load) > 0:
        out.append(
            ("load", "N" if unit == "m" else "N m", load, np.quantile(load, np.linspace(0, 1, 7)))
        )
    return out + [_of_other(problem, k) for k in range(problem.d) if k != j]


def _of_other(problem: Problem, k: int) -> View:
    """Another joint's speed."""
    top = max(float(np.quantile(np.abs(problem.qd[k]), 0.95)), 1e-9)
    edges = top * np.array([-1.5, -0.5, -0.1, 0, 0.1, 0.5, 1.5])
    return f"speed of {problem.joints[k]}", f"{problem.robot.units[k]}/s", problem.qd[k], edges
