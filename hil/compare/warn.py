"""Warnings that come from looking at both errors, one-step and multi-step."""

from __future__ import annotations

from itertools import pairwise

from hil.compare.analysis import Rung


def rising(rungs: list[Rung], factor: float = 1.05) -> list[str]:
    """Sentences where a step lowers the effort error but the simulated motion gets worse.

    Parameters
    ----------
    rungs : list of Rung
        The ladder.
    factor : float
        Rise of the multi-step error that counts.
    """
    out = []
    for before, after in pairwise(rungs):
        for j in range(after.step.result.problem.d):
            old, new = float(before.multi_step.rms[j]), float(after.multi_step.rms[j])
            if new > factor * old:
                out.append(_sentence(before, after, j, old, new))
    return out


def _sentence(before: Rung, after: Rung, j: int, old: float, new: float) -> str:
    problem = after.step.result.problem
    joint, unit = problem.joints[j], problem.robot.units[j]
    errors = [float(r.step.heldout.relative[j]) for r in (before, after)]
    rise = (
        f"simulated position error over {after.multi_step.horizon:g} s rises from {old:.3g} to "
        f"{new:.3g} {unit}"
    )
    if errors[1] < 0.99 * errors[0]:
        return (
            f"{after.step.label}: the one-step error of {joint} falls but its {rise}; the effect "
            "helps the effort prediction, not the simulation"
        )
    return f"{after.step.label}: the one-step error of {joint} stays but its {rise}"
