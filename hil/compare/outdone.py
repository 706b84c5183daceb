"""Names that a function without a name beats.

The right law of a missing effect is the best there is; a wrong one only comes near.  So what the
names of a joint take from its error on blocks of time left out is set against what any function of
its positions, its own speed or time would take in their place (see `fallback`): with E0, E and F
the left-out errors of the first model, with the names, and with the function,

    E^2 - F^2 > BETTER (E0^2 - floor^2)   and   E^2 > MORE F^2.

Laws with a memory, of loads or of several joints' speeds are no such functions, and lose nothing.
Nor does one that acts at one place of the recording alone: left out there, it is not to be learnt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.compare.fallback import ROWS, Share, functions, shares
from hil.compare.findings import Finding, Step
from hil.compare.leftout import Folds
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int_]
CODE = "outdone"
#: Share of the excess by which a function must do better: from ASKED on, none of 108 right names
#: that were looked at was beaten by more than 0.15, and six of eight wrong ones were.
BETTER = 0.20
#: The same as a factor of its squared error, and errors over the floor from which it is asked:
#: smaller ones and their differences are chance.
MORE, ASKED = 1.10, 1.20
#: Share of what a name does that falls into one fold, from which on the others do not show it.
ALONE = 0.9


@dataclass(frozen=True)
class Outdone:
    """A joint whose names explain less than a function does.

    Parameters
    ----------
    joint : str
        Name.
    shares : list of Share
        What functions explain of what the first model leaves.
    text : str
        One sentence without its full stop.
    """

    joint: str
    shares: list[Share]
    text: str


def outdone(steps: Sequence[Step], findings: Sequence[Finding], floor: FloatArray) -> list[Outdone]:
    """Joints on which a function without a name beats what is named.

    Parameters
    ----------
    steps : sequence of Step
        The ladder: first and last model.
    findings : sequence of Finding
        What would be named; effects of the whole robot are not asked.
    floor : ndarray (d,)
        Noise floor of the fitted runs.
    """
    first, last = steps[0].result, steps[-1].result
    problem = first.problem
    if problem.n * problem.d > ROWS or first.model.explains != "motor" or not findings:
        return []
    one, other, nothing = Folds(first), Folds(last), np.zeros((problem.n, 0))
    out = []
    for joint in dict.fromkeys(f.joint for f in findings if f.joint is not None):
        j = problem.joints.index(joint)
        if any(_alone(last, f, j, one.fold) for f in findings if f.joint == joint):
            continue
        start, now = one.left_out(nothing, j), other.left_out(nothing, j)
        if start < ASKED * floor[j]:
            continue
        found = functions(one, j)
        least = min(found, key=lambda x: x.error)
        excess = start**2 - min(float(floor[j]), now, least.error) ** 2
        gap = now**2 - least.error**2
        if gap > BETTER * excess and now**2 > MORE * least.error**2:
            names = " and ".join(f.effect for f in findings if f.joint == joint)
            text = (
                f"{joint}: {names} would explain {_percent((start**2 - now**2) / excess)} of what "
                f"the model leaves there, and a function of {least.words} "
                f"{_percent((start**2 - least.error**2) / excess)}: that is not the cause"
            )
            out.append(Outdone(joint, shares(found, start, float(floor[j]), joint), text))
    return out


def _alone(last: FitResult, finding: Finding, j: int, fold: IntArray) -> bool:
    """Whether most of what a name does on joint j falls into one fold (n,)."""
    own = [k for k, name in enumerate(last.names) if name in finding.parameters]
    x = last.x.reshape(last.problem.d, last.problem.n, -1)[j][:, own]
    power = np.bincount(fold, np.sum(x**2, axis=1))
    return bool(power.max() > ALONE * power.sum())


def _percent(share: float) -> str:
    return f"{100 * float(np.clip(share, 0.0, 1.0)):.0f} %"
