"""Warnings that come from looking at both errors, one-step and multi-step."""

from __future__ import annotations

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
    for before, after in zip(rungs[:-1], rungs[1:], strict=True):
        for j, joint in enumerate(after.step.result.problem.joints):
            old, new = float(before.multi_step.rms[j]), float(after.multi_step.rms[j])
            if new > factor * old:
                out.append(
                    f"{after.step.label}: the one-step error of {joint} falls but its simulated "
                    f"position error over {after.multi_step.horizon:g} s rises from {old:.3g} to "
                    f"{new:.3g}; the effect helps the effort prediction, not the simulation"
                )
    return out
