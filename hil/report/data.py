"""What a report is made of, from a diagnosis or a comparison."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.constants import ADEQUATE
from hil.diagnosis.equivalence import pairs, sets_of
from hil.diagnosis.residual_tests import CHANGED, UNLIKE
from hil.diagnosis.types import (
    Diagnosis,
    Evidence,
    Explainable,
    Finding,
    Indistinguishable,
    Step,
    UnnamedCorrection,
    Unseen,
)
from hil.diagnosis.verbs import Comparison, Rung, ladder
from hil.identify.multistep import MultiStep
from hil.identify.problem import Problem
from hil.models.model import Range

FloatArray = NDArray[np.float64]
#: Verdict of a comparison, which judges nothing.
COMPARED = "compared"


@dataclass(frozen=True)
class Material:
    """Verdict, ladder and evidence of one report.

    Parameters
    ----------
    verdict : str
        Verdict of a diagnosis, or ``"compared"``.
    rungs : list of Rung
        Ladder with both errors; empty where nothing was fitted.
    floor : ndarray (d,)
        Noise floor [N m or N].
    first, last : Evidence
        Candidates beside the first and the last model.
    findings, partial : list of Finding
        Accepted effects; effects that help but explain too little.
    sets : list of Indistinguishable
        What the data cannot tell apart.
    warnings : list of (code, str)
        Notes and faults.
    network : list of Share
        What any function of position, speeds or time could explain of what is left.
    corrections : list of Correction
        Free functions without a name that the last model holds.
    valid : tuple of Range
        What the given model had been identified on, before it was fitted to these sessions.
    """

    verdict: str
    rungs: list[Rung]
    floor: FloatArray
    first: Evidence
    last: Evidence
    findings: list[Finding] = field(default_factory=list)
    partial: list[Finding] = field(default_factory=list)
    sets: list[Indistinguishable] = field(default_factory=list)
    warnings: list[tuple[str, str]] = field(default_factory=list)
    network: list[Explainable] = field(default_factory=list)
    valid: tuple[Range, ...] = ()
    unseen: list[Unseen] = field(default_factory=list)
    beyond: float | None = None
    corrections: list[UnnamedCorrection] = field(default_factory=list)
    #: Rungs at the end of the ladder that corrections give.
    corrected: int = 0

    @property
    def before(self) -> Step:
        """First model."""
        return self.rungs[0].step

    @property
    def after(self) -> Step:
        """Last model."""
        return self.rungs[-1].step

    @property
    def explained(self) -> Step:
        """The last model without corrections."""
        return self.rungs[-1 - self.corrected].step

    @property
    def problem(self) -> Problem:
        """Runs of the fit."""
        return self.before.result.problem

    @property
    def joints(self) -> tuple[str, ...]:
        """Joint names."""
        return tuple(self.problem.joints)

    @property
    def external(self) -> bool:
        """Whether the model explains a contact force instead of the motor's effort."""
        return self.before.result.model.explains == "external"

    def effort_unit(self, j: int) -> str:
        """Unit of joint j's effort."""
        return "N" if self.problem.robot.units[j] == "m" else "N m"

    def relative_floor(self, j: int) -> float:
        """Noise floor of joint j in percent of the held-out effort."""
        size = float(self.before.heldout.effort_rms[j])
        return 100 * float(self.floor[j]) / max(size, 1e-300)

    def ratio(self, step: Step) -> FloatArray:
        """Held-out error of a rung in units of the noise floor (d,)."""
        out: FloatArray = step.heldout.rms / np.maximum(self.floor, 1e-300)
        return out

    def concerned(self, most: int = 3) -> list[int]:
        """Joints worth looking at: those of the findings, else the worst against the floor.

        Where every joint is at its floor, those of which something is said nevertheless.
        """
        names = [f.joint for f in (*self.findings, *self.partial) if f.joint in self.joints]
        ratio = self.ratio(self.before)
        if not names and float(ratio.max()) <= ADEQUATE:
            said = [s.joint for s in self.network]
            said += [
                text.split(":")[0] for code, text in self.warnings if code in (CHANGED, UNLIKE)
            ]
            names = [joint for joint in said if joint in self.joints]
        named = list(dict.fromkeys(self.joints.index(n) for n in names if n is not None))
        worst = [int(j) for j in np.argsort(-ratio)]
        return named[:most] if named else worst[:most]


def from_diagnosis(d: Diagnosis, simulated: bool = True) -> Material:
    """Material of a diagnosis; both errors of every rung, the simulated one where it is wanted."""
    if not d.ladder:
        return Material(d.verdict, [], d.noise, d.first, d.last, warnings=d.warnings)
    motor = d.ladder[0].result.model.explains == "motor"
    rungs = (
        [_honest(r) for r in ladder(d)]
        if motor and simulated
        else [Rung(s, _none(len(d.noise))) for s in d.ladder]
    )
    return Material(
        d.verdict,
        rungs,
        d.noise,
        d.first,
        d.last,
        d.findings,
        d.partial,
        sets_of(d),
        d.warnings,
        d.network,
        d.valid,
        d.unseen,
        d.beyond,
        d.corrections,
        d.corrected,
    )


def from_comparison(c: Comparison) -> Material:
    """Material of a comparison: a ladder of one rung."""
    rung = _honest(Rung(Step("model", c.result, c.heldout), c.multi_step))
    faults = [(f.code, f.sentence) for f in c.faults]
    return Material(
        COMPARED,
        [rung],
        c.noise,
        c.evidence,
        c.evidence,
        sets=pairs(c.evidence, [], c.result),
        warnings=faults,
        valid=c.valid,
    )


def _honest(rung: Rung) -> Rung:
    """Rung without a simulated error where most simulations left the recorded range."""
    multi = rung.multi_step
    if not multi.windows or not multi.lost:
        return rung
    nothing = np.full(multi.rms.size, np.nan)
    return Rung(rung.step, replace(multi, rms=nothing, relative=nothing))


def _none(d: int) -> MultiStep:
    nothing = np.full(d, np.nan)
    return MultiStep(0.0, nothing, nothing, 0, 0)


def number(x: float, digits: int = 3) -> str:
    """A number for people: significant digits, a dash where there is none."""
    if not math.isfinite(x):
        return "-"
    text = f"{x:.{digits}g}"
    if "e+" in text and abs(x) < 1e6:
        text = f"{x:.0f}"
    return text.replace("-", "\u2212")
