"""When the data do not determine the model at all, and why."""

from __future__ import annotations

import numpy as np

from hil.identify.result import FitResult
from hil.models.contact import penetration

#: A contact law is undetermined when forward and reverse regression differ by this factor.
DISAGREEMENT = 1.5
#: Rows with at least this share of the deepest penetration count as contact.
TOUCHING = 0.02

#: Shortest recording, all runs together, from which effects are named [s].
SHORTEST = 4.0


def undetermined(result: FitResult) -> list[tuple[str, str]]:
    """Reasons (code, sentence) why nothing can be concluded; empty if something can.

    *No motion*: every joint's speed stays below what the encoder and filter resolve.
    *Rigid contact*: the force varies while the position hardly does, so stiffness is bounded
    from below only: least squares of force on position and of position on force then differ
    by 1 / R^2, the attenuation that noise in the position causes.
    """
    problem = result.problem
    if result.model.explains == "external":
        return _rigid(result)
    speed = np.sqrt(np.mean(problem.qd**2, axis=1))
    if np.all(speed < 4 * problem.speed_noise):
        names = ", ".join(problem.joints)
        return [("no-motion", f"{names}: no motion above what the encoders resolve; record motion")]
    seconds = problem.n / problem.rate
    if seconds < SHORTEST:
        return [
            (
                "too-short",
                f"{seconds:.2g} s of recording are too little to tell an effect from chance; "
                f"record {SHORTEST:g} s of motion or more",
            )
        ]
    return []


def _rigid(result: FitResult) -> list[tuple[str, str]]:
    problem, out = result.problem, []
    for j, joint in enumerate(problem.joints):
        r2 = _agreement(result, j)
        if r2 < 1 / DISAGREEMENT:
            out.append(
                (
                    "not-identifiable",
                    f"{joint}: while touching, position explains only {100 * r2:.0f} % of the "
                    "contact effort's variance, so its stiffness is bounded from below only "
                    f"(forward and reverse regression differ by a factor {1 / max(r2, 1e-3):.1f}):"
                    " the object is stiffer than the position resolves, or there is no contact; "
                    "use a softer object, a finer encoder or a stiffer mount",
                )
            )
    return out if len(out) == problem.d else []


def _agreement(result: FitResult, j: int) -> float:
    """Squared correlation of effort and penetration over the rows in contact."""
    problem = result.problem
    y = problem.y[j]
    if not np.isfinite(problem.motions[0].contact[j]).all():
        return 1 - float(np.mean(result.residual[j] ** 2) / max(np.var(y), 1e-300))
    depth = problem.filtered([penetration(m, j)[0][:, None] for m in problem.motions])[:, 0]
    touching = depth > TOUCHING * depth.max()
    if np.sum(touching) < 20 or np.std(depth[touching]) == 0:
        return 0.0
    return float(np.corrcoef(depth[touching], y[touching])[0, 1] ** 2)
