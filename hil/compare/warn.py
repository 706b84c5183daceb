"""Warnings that come from looking at both errors, one-step and multi-step."""

from __future__ import annotations

from itertools import pairwise

from hil.compare.analysis import Rung


def rising(rungs: list[Rung], factor: float = 1.01) -> list[str]:
    """Sentences where a step lowers the effort error but the simulated motion gets worse.

    A rise counts from one percent on, and beyond its standard error over the same windows, where
    no later step takes it back.

    Parameters
    ----------
    rungs : list of Rung
        The ladder.
    factor : float
        Rise of the multi-step error that counts.
    """
    out = []
    for before, after in pairwise(rungs):
        if after.step.result.model.explains != "motor":  # a law of contact has no motion
            continue
        for j in range(after.step.result.problem.d):
            steps = (after.multi_step, rungs[-1].multi_step)
            if all(m.rises(before.multi_step, j, factor) for m in steps):
                out.append(_sentence(before, after, j))
    return out


def useless(before: Rung, after: Rung, joints: list[int]) -> list[str]:
    """Sentences for an effect that lowers no held-out error beyond its standard error.

    Parameters
    ----------
    before, after : Rung
        The model without and with it.
    joints : list of int
        Joints that it acts on.
    """
    old, new = before.step.heldout, after.step.heldout
    if any(new.rms[j] < old.rms[j] and new.gain(old, j) > 1.0 for j in joints):
        return []
    names, se = after.step.result.problem.joints, new.standard_error()
    return [
        f"held-out error of {names[j]} {old.relative[j]:.2f} -> {new.relative[j]:.2f} % "
        f"(se {se[j]:.2f}): no benefit beyond its standard error"
        for j in joints
    ]


def _sentence(before: Rung, after: Rung, j: int) -> str:
    old, new = float(before.multi_step.rms[j]), float(after.multi_step.rms[j])
    problem = after.step.result.problem
    joint, unit = problem.joints[j], problem.robot.units[j]
    errors = [float(r.step.heldout.relative[j]) for r in (before, after)]
    over = f"simulated position error over {after.multi_step.horizon:g} s"
    rise = f"{over} rises from {old:.3g} to {new:.3g} {unit} ({100 * (new / old - 1):+.1f} %)"
    if after.multi_step.lost:
        rise = f"{over} cannot be told any more: every simulation leaves the recorded range"
    if errors[1] < 0.99 * errors[0]:
        return (
            f"{after.step.label}: the one-step error of {joint} falls but its {rise}; the effect "
            "helps the effort prediction, not the simulation"
        )
    if errors[1] > 1.01 * errors[0]:
        return f"{after.step.label}: the one-step error of {joint} rises, too, and its {rise}"
    return f"{after.step.label}: the one-step error of {joint} stays but its {rise}"
