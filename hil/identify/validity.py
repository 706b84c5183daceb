"""The range of positions, speeds and loads that a model was identified on.

A prediction beyond it is extrapolation.  Kept are the 0.5 and 99.5 % quantiles of each joint's
motion; data count as outside beyond these by more than a twentieth of the range.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.identify.problem import Problem
from hil.models.model import Range

FloatArray = NDArray[np.float64]
#: Share of the instants at each end that is no range, the margin beyond it, and the share of
#: instants outside that is worth a warning.
TAIL, MARGIN, WORTH = 0.005, 0.05, 0.02
QUANTITIES = ("position", "speed", "load")


def _values(problem: Problem, j: int, what: str) -> FloatArray:
    """All values of one quantity of joint j (instants,)."""
    name = {"position": "q", "speed": "qd", "load": "load"}[what]
    return np.concatenate([getattr(m, name)[:, j] for m in problem.motions])


def identified(problem: Problem) -> tuple[Range, ...]:
    """Range of every joint over the runs of a fit, the load as the fit has it."""
    out = []
    for j, joint in enumerate(problem.joints):
        ends = [np.quantile(_values(problem, j, w), [TAIL, 1 - TAIL]) for w in QUANTITIES]
        position, speed, load = ((float(low), float(high)) for low, high in ends)
        out.append(Range(joint, position, speed, load))
    return tuple(out)


def limits(known: Range, what: str) -> tuple[float, float]:
    """Ends of a range with the margin."""
    low, high = getattr(known, what)
    spare = MARGIN * max(high - low, 1e-12)
    return low - spare, high + spare


def outside(known: Sequence[Range], problem: Problem, which: str = "session") -> list[str]:
    """Sentences on the joints that leave the identified range: how often, and how far.

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
    for j, joint in enumerate(problem.joints):
        for what in QUANTITIES if joint in ranges else ():
            low, high = limits(ranges[joint], what)
            x = _values(problem, j, what)
            share = float(np.mean((x < low) | (x > high)))
            if share > WORTH:
                ends = (*getattr(ranges[joint], what), float(x.min()), float(x.max()))
                out.append(_sentence(joint, what, share, ends, _unit(problem, j, what), which))
    return out


def _sentence(
    joint: str, what: str, share: float, ends: tuple[float, ...], unit: str, which: str
) -> str:
    low, high, least, most = ends
    return (
        f"{joint}: {100 * share:.0f} % of the {which} lies outside the {what} range that the model "
        f"was identified on ({low:.3g} to {high:.3g} {unit}; here {least:.3g} to {most:.3g}): "
        "predictions there are extrapolation"
    )


def _unit(problem: Problem, j: int, what: str) -> str:
    unit = problem.robot.units[j]
    return {"position": unit, "speed": f"{unit}/s", "load": "N" if unit == "m" else "N m"}[what]
