"""Notes beside a verdict: what was not tested, left out, changed at once, or not determined."""

from __future__ import annotations

import numpy as np

from hil.compare import blur
from hil.compare.candidate import Candidate
from hil.compare.changes import told
from hil.compare.denoise import shaken
from hil.compare.evidence import Evidence
from hil.compare.findings import describe
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.identify.standstill import HELD
from hil.identify.timing import late_effort

#: Share of time at standstill that is worth a note.
STILL = 0.05


def notes(result: FitResult, last: Evidence) -> list[tuple[str, str]]:
    """Notes (code, sentence) on what was not tested, left out, or not determined."""
    out = [
        (f"impossible-{name}", f"{name} cannot be tested: {why}") for name, why in last.impossible
    ]
    out += _held(result)
    still = 1.0 - result.problem.count / result.problem.n
    for j in np.flatnonzero(still > STILL):
        out.append(
            (
                "standstill",
                f"{result.problem.joints[j]} stands still for {100 * still[j]:.0f} % of the time: "
                "left out, for static friction balances any effort there",
            )
        )
    for name, v in result.values.items():
        if v.at_bound:
            out.append(("at-bound", f"parameter {name} lies on its bound {v.value:g} {v.unit}"))
    lost = result.not_identifiable()
    if lost:
        out.append(
            (
                "not-identifiable",
                f"{len(lost)} parameters are determined only in combination, e.g. "
                f"{', '.join(lost[:4])}; no prediction of such motions depends on it",
            )
        )
    return out


def _held(result: FitResult) -> list[tuple[str, str]]:
    """Notes on joints that hold their place; one that reads the same throughout may be blind."""
    problem = result.problem
    held = [j for j, holds in enumerate(problem.holds) if holds]
    if not held:
        return []
    names = [problem.joints[j] for j in held]
    dead = [
        problem.joints[j] for j in held if all(np.ptp(r.q[:, j]) == 0 for r in problem.recordings)
    ]
    blind = f"; {', '.join(dead)} never changes by a single count: a brake, or a dead encoder?"
    text = (
        f"{', '.join(names)}: only held in place (within {HELD:.0f} steps of the encoder), so "
        "nothing is named there; diagnose it together with a session that moves it"
    )
    return [("holds", text + (blind if dead else ""))]


def noticed(evidence: Evidence, result: FitResult) -> list[tuple[str, str]]:
    """Notes (code, sentence) on values that changed at once and on noise that is no physics."""
    before = result.problem.notes + late_effort(result.problem)
    found = told(evidence.changes) + shaken(evidence, result) + blur.notes(evidence, result)
    return before + found


def emptied(c: Candidate, problem: Problem) -> str:
    """Note on an effect that later ones have left without any work."""
    return (
        f"{describe(c, problem)} was added on the way and is no more than chance beside what came "
        "later, so it is not named; the model keeps it, for without it the fit gets worse"
    )
