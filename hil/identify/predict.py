"""A fitted model on runs that it has not seen: what it leaves, and where it extrapolates.

A model is identified on a range of positions, speeds and loads; a prediction beyond it is
extrapolation.  Kept are the 0.5 and 99.5 % quantiles of each joint's motion; data count as outside
beyond these by more than a twentieth of the range.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.identify.context import update_load
from hil.identify.design import Term, stack
from hil.identify.problem import Problem
from hil.identify.regression import least_squares
from hil.identify.result import FitResult
from hil.identify.solve import slices_of
from hil.models.model import Range

FloatArray = NDArray[np.float64]


def predict(result: FitResult, problem: Problem) -> FloatArray:
    """Residual (d, n) of a fitted model on another problem (held-out runs).

    The other problem must have been made with the same rates and span.  Coefficients of a
    single run (per-run offsets, a hum's phase) are estimated on the new runs, for they belong to
    a run.
    """
    source = result.problem.motions[0]
    problem.set_context(v0=source.v0, contact=source.contact)
    flat = [t for t in result.terms if not _own(t)]
    keep = {t.key for t in flat}
    theta = np.concatenate(
        [result.theta[s] for t, s in zip(result.terms, result.slices, strict=True) if t.key in keep]
        or [np.empty(0)]
    )
    update_load(problem, flat, theta, slices_of(problem, flat))
    x, _ = stack(problem, flat)
    residual: FloatArray
    residual = (problem.y.reshape(-1) - x @ theta).reshape(problem.d, problem.n)
    for t in result.terms:
        if _own(t):
            residual = _without(residual, t, problem, result.sigma)
    return residual


def own_values(result: FitResult) -> dict[str, tuple[int, list[int]]]:
    """Effects of which every run has values of its own: how many a joint, and their joints.

    Such values are estimated on held-out runs themselves, by `predict`.
    """
    out: dict[str, tuple[int, list[int]]] = {}
    for t in result.terms:
        if _own(t):
            motion = result.problem.motions[0]
            count = np.any(t.effect.columns(motion, t.joint, t.shape) != 0, axis=0)
            size = int(np.sum(np.any(count, axis=0) if t.effect.scope.whole else count))
            joints = [] if t.effect.scope.of_robot else [t.joint]
            known = out.setdefault(t.effect.name, (size, []))
            known[1].extend(joints)
    return out


def _own(t: Term) -> bool:
    """Whether every run has its own coefficients."""
    return t.per_run or t.effect.variation.own(t.shape)


def _without(r: FloatArray, term: Term, problem: Problem, sigma: FloatArray) -> FloatArray:
    """Residual r (d, n) less what a term of every run for itself explains of it."""
    columns = problem.columns(term.effect, term.joint, term.shape, per_run=True, every=True)
    at = slice(None) if term.effect.scope.whole else slice(term.joint, term.joint + 1)
    wide = columns if term.effect.scope.whole else columns[None]
    scale = sigma[at, None]
    rows = (wide / scale[..., None]).reshape(-1, wide.shape[-1])
    part = least_squares(rows, (r[at] / scale).reshape(-1))
    out = r.copy()
    out[at] -= wide @ part
    return out


#: Share of the instants at each end that is no range, the margin beyond it, and the share of
#: instants outside that is worth a warning.
TAIL, MARGIN, WORTH = 0.005, 0.05, 0.02
QUANTITIES = ("position", "speed", "load")


def _every(problem: Problem, what: str) -> list[FloatArray]:
    """One quantity of all joints, run by run (instants, d)."""
    name = {"position": "q", "speed": "qd", "load": "load"}[what]
    return [getattr(m, name) for m in problem.motions]


def _values(problem: Problem, j: int, what: str) -> FloatArray:
    """All values of one quantity of joint j (instants,)."""
    return np.concatenate([x[:, j] for x in _every(problem, what)])


def _ends(problem: Problem, j: int, what: str) -> tuple[float, float]:
    """Quantiles of one quantity of joint j."""

    def made() -> tuple[float, float]:
        low, high = np.quantile(_values(problem, j, what), [TAIL, 1 - TAIL]).tolist()
        return low, high

    return problem.remembered(("ends", j, what), _every(problem, what), made)


def identified(problem: Problem) -> tuple[Range, ...]:
    """Range of every joint over the runs of a fit, the load as the fit has it."""
    out = []
    for j, joint in enumerate(problem.joints):
        place, speed, load = (_ends(problem, j, what) for what in QUANTITIES)
        low, high = problem.span[j].tolist()
        out.append(Range(joint, place, speed, load, (low, high)))
    return tuple(out)


def limits(known: Range, what: str) -> tuple[float, float]:
    """Ends of a range with the margin."""
    low, high = getattr(known, what)
    spare = MARGIN * max(high - low, 1e-12)
    return low - spare, high + spare


def outside(known: Sequence[Range], problem: Problem, which: str = "session") -> list[str]:
    """Sentences on what leaves the identified range: one a quantity, with every such joint.

    Parameters
    ----------
    known : sequence of Range
        Ranges of a model; joints without one are not judged.
    problem : Problem
        The runs that the model is to predict.
    which : str
        What to call them.
    """
    ranges, out = {r.joint: r for r in known}, []
    for what in QUANTITIES:
        parts = [
            _part(problem, j, what, ranges[joint])
            for j, joint in enumerate(problem.joints)
            if joint in ranges
        ]
        beyond = "; ".join(p for p in parts if p)
        if beyond:
            out.append(
                f"the {which} leaves the identified {what} range; "
                f"predictions there are extrapolations: {beyond}"
            )
    return out


def leaves(known: Sequence[Range], problem: Problem, j: int) -> bool:
    """Whether joint j leaves its identified range in any quantity."""
    own = [r for r in known if r.joint == problem.joints[j]]
    return any(_part(problem, j, what, r) for r in own for what in QUANTITIES)


def _part(problem: Problem, j: int, what: str, known: Range) -> str:
    """How often and how far joint j leaves its range; empty where that is rare."""
    x, (low, high) = _values(problem, j, what), limits(known, what)
    share = float(np.mean((x < low) | (x > high)))
    if share <= WORTH:
        return ""
    low, high = getattr(known, what)
    return (
        f"{problem.joints[j]} for {100 * share:.0f} % of the time ({x.min():.3g} to {x.max():.3g}, "
        f"identified {low:.3g} to {high:.3g} {_unit(problem, j, what)})"
    )


def _unit(problem: Problem, j: int, what: str) -> str:
    unit = problem.robot.units[j]
    return {"position": unit, "speed": f"{unit}/s", "load": "N" if unit == "m" else "N m"}[what]
