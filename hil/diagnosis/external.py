"""The measured external effort, at an unknown ratio and sign.

The model says  tau + tau_ext = model.  With a free gain g of the external effort,

    tau + tau_ext = model + (1 - g) tau_ext,

g near 1 is right or a gain error (an effect that may be named), g near -1 a wrong sign, and g far
from both another ratio: of a gear, of units, or of where it was measured.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.candidates import model_groups, paired
from hil.diagnosis.constants import BEYOND
from hil.diagnosis.folds import Split
from hil.diagnosis.grams import Group, Table
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
#: Fall of the held-out mean square error from which the gain is determined, and how near a gain
#: must be to -1 to be a sign, or to 1 to be a gain error.  Half: signs are taken for ratios.
FALL, NEAR = 0.25, 0.35


def gains(result: FitResult, split: Split) -> dict[int, float]:
    """Gain g of the external effort on the joints whose held-out error falls with it.

    Parameters
    ----------
    result : FitResult
        Of the given model.
    split : Split
        Blocks to judge on.
    """
    problem = result.problem
    if result.model.explains != "motor":
        return {}
    columns = {
        j: problem.gated([m.tau_ext[:, j : j + 1] for m in problem.motions], j)
        for j in range(problem.d)
        if any(np.any(m.tau_ext[:, j]) for m in problem.motions)
    }
    free = np.array([np.inf])
    groups = [Group(("external", j), j, x, -free, free, np.zeros(1)) for j, x in columns.items()]
    if not groups:
        return {}
    base = model_groups(result)
    table = Table(problem, split, result.sigma, [*base, *groups])
    keys = [g.key for g in base]
    before, out = table.errors(keys), {}
    for g in groups:
        j = int(g.joint or 0)
        after = table.errors([*keys, g.key])
        fall = before.squared[:, j] - after.squared[:, j]
        if after.power[j] < (1 - FALL) * before.power[j] and paired(fall) > BEYOND:
            out[j] = 1.0 - float(table.coefficients([*keys, g.key])[g.key][0])
    return out


def doubts(result: FitResult, split: Split) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Faults and warnings (code, sentence): wrong signs, and ratios to confirm."""
    faults, warnings = [], []
    for j, g in gains(result, split).items():
        joint, column = result.problem.joints[j], f"tauext{j + 1}"
        if abs(g + 1) < NEAR:
            faults.append(
                (
                    "external-sign",
                    f"the external effort of {joint} has the wrong sign: turned round, the model "
                    f"fits; give {column} (or fx, fy, fz) scale = -1 in a map file",
                )
            )
        elif abs(g - 1) > NEAR:
            warnings.append(
                (
                    "external-ratio",
                    f"the external effort of {joint} fits best at {g:.3g} times its values: "
                    f"confirm the ratio, the unit or the place of the sensor, and give {column} that scale "
                    "in a map file",
                )
            )
    return faults, warnings
