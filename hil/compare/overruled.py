"""Names that explain enough and are none all the same, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.compare import outdone, worsened
from hil.compare.fallback import Share
from hil.compare.findings import Finding, Step
from hil.identify.multistep import MultiStep, each

#: By the warning's code, what is said in a few words.
REASONS = {
    outdone.CODE: "a function without a name explains more",
    worsened.CODE: "the simulated motion is worse with it",
}


@dataclass(frozen=True)
class Overruled:
    """Joints whose names do not stand.

    Parameters
    ----------
    joints : set of str
        Their names.
    shares : list of Share
        What functions explain there, where one explains more.
    warnings : list of (str, str)
        Code and sentence of each.
    simulated : list of MultiStep, optional
        Simulated errors of the ladder's steps, where they were asked for.
    """

    joints: set[str] = field(default_factory=set)
    shares: list[Share] = field(default_factory=list)
    warnings: list[tuple[str, str]] = field(default_factory=list)
    simulated: list[MultiStep] | None = None


def overruled(
    ladder: Sequence[Step], findings: Sequence[Finding], floor: NDArray[np.float64]
) -> Overruled:
    """Names that a function beats, or with which the model moves worse than without.

    Parameters
    ----------
    ladder : sequence of Step
        First to last model.
    findings : sequence of Finding
        What would be named.
    floor : ndarray (d,)
        Noise floor of the fitted runs.
    """
    if not findings or ladder[0].result.model.explains != "motor":
        return Overruled()
    beaten = outdone.outdone(ladder, findings, floor)
    simulated = each([s.result for s in ladder], ladder[0].result.problem)
    worse = worsened.worsened(ladder, simulated, findings)
    warnings = [(outdone.CODE, x.text) for x in beaten]
    warnings += [(worsened.CODE, text) for text in worse.values()]
    shares = [s for x in beaten for s in x.shares]
    return Overruled({x.joint for x in beaten} | set(worse), shares, warnings, simulated)


def why(f: Finding, warnings: Sequence[tuple[str, str]]) -> str:
    """Reason in a few words, found in warnings (code, sentence); empty where there is none."""
    told = {code for code, text in warnings if text.startswith(f"{f.joint}: ")}
    return next((reason for code, reason in REASONS.items() if code in told), "")
