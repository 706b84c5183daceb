"""When the data do not determine the model at all, and why."""

from __future__ import annotations

import numpy as np

from hil.identify.result import FitResult

#: A contact law is undetermined when forward and reverse regression differ by this factor.
DISAGREEMENT = 2.0


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
    if np.all(speed < 2 * problem.v0_resolution):
        names = ", ".join(problem.joints)
        return [("no-motion", f"{names}: no motion above what the encoders resolve; record motion")]
    return []


def _rigid(result: FitResult) -> list[tuple[str, str]]:
    problem, out = result.problem, []
    for j, joint in enumerate(problem.joints):
        y = problem.y[j] - problem.y[j].mean()
        power = float(np.mean(y**2))
        left = float(np.mean(result.residual[j] ** 2))
        r2 = 1 - left / max(power, 1e-300)
        if r2 < 1 / DISAGREEMENT:
            out.append(
                (
                    "not-identifiable",
                    f"{joint}: a spring explains only {100 * max(r2, 0):.0f} % of the contact "
                    "effort's variance: the stiffness is beyond what the position resolves (or "
                    "there is no contact); use a softer object, a finer encoder or a stiffer mount",
                )
            )
    return out if len(out) == problem.d else []
