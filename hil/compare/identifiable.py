"""When nothing can be concluded from the data, and why."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.contact import penetration

FloatArray = NDArray[np.float64]
#: A contact law is undetermined when forward and reverse regression differ by this factor.
DISAGREEMENT = 1.5
#: Rows with at least this share of the deepest penetration count as contact.
TOUCHING = 0.02

#: Least rms speed, in units of its noise, that is motion.
SLOWEST = 4.0
#: Shortest recording from which effects are named, all runs without the filter's edges [s].
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
    if np.all(speed < SLOWEST * problem.speed_noise):
        return [("no-motion", _slow(problem, speed))]
    return _short(problem)


def _slow(problem: Problem, speed: FloatArray) -> str:
    """What the joints move, what that drowns in, and what helps."""
    parts = [
        f"{joint} moves at {v:.2g} {unit}/s (rms) and its encoder's steps alone make {noise:.2g}"
        for joint, v, noise, unit in zip(
            problem.joints, speed, problem.speed_noise, problem.robot.units, strict=True
        )
    ]
    band = problem.rates
    return (
        f"{'; '.join(parts)} behind the filter of {band.position:.3g} Hz: too little motion for so "
        f"coarse a position. Move faster or wider, use a finer encoder, or narrow the band in the "
        f"model file, under [signal]: position_hz = {band.position / 3:.2g}, "
        f"effort_hz = {band.effort / 3:.2g}"
    )


def _short(problem: Problem) -> list[tuple[str, str]]:
    """Reason if all runs together are too short to name an effect."""
    left = problem.n / problem.rate
    if left >= SHORTEST:
        return []
    recorded = sum(float(r.t[-1] - r.t[0]) for r in problem.recordings)
    # the filter's edges go at both ends of every run, so they come on top
    wanted = math.ceil(SHORTEST + max(recorded - left, 0.0))
    text = (
        f"{recorded:.2g} s are recorded, of which {left:.2g} s are left when the filter has cut "
        f"its edges; {SHORTEST:g} s must be left to tell an effect from chance. Record "
        f"{wanted} s or more, or give several runs"
    )
    return [("too-short", text)]


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
