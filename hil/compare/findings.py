"""What a diagnosis consists of: findings, rungs of the error ladder, the verdict."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.compare.ambiguity import Indistinguishable
from hil.compare.candidate import Candidate
from hil.compare.evidence import NOTHING, Evidence
from hil.compare.fallback import Share
from hil.compare.heldout import HeldOut
from hil.compare.unseen import Unseen
from hil.errors import DataError
from hil.identify.multistep import MultiStep
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.model import Range, RobotModel, Value

if TYPE_CHECKING:
    from hil.diagnosis.rules import CheckResult

FloatArray = NDArray[np.float64]
#: A candidate that was accepted, its confidence, and its rivals.
Accepted = tuple[Candidate, float, list[Candidate]]


@dataclass(frozen=True)
class Finding:
    """One accepted effect.

    Parameters
    ----------
    effect : str
        Name in the catalogue.
    joint : str or None
        Joint; None where it is not one joint's.
    confidence : float
        Probability that it is this effect and none of the rivals.
    relative_before, relative_after, se : float
        Held-out relative error of the joint [%] and the standard error of the latter.
    excess_explained : float
        Share of the squared error above the noise floor that this effect removed; on the
        held-out runs where there are any, else on the fitted ones.
    parameters : dict of str to Value
        Its parameters after the joint refit.
    rivals : list of str
        Effects that these data cannot tell from it.
    """

    effect: str
    joint: str | None
    confidence: float
    relative_before: float
    relative_after: float
    se: float
    excess_explained: float
    parameters: dict[str, Value]
    rivals: list[str]


@dataclass(frozen=True, repr=False)
class Step:
    """One rung of the error ladder."""

    label: str
    result: FitResult
    heldout: HeldOut

    def __repr__(self) -> str:
        errors = ", ".join(f"{x:.2f}" for x in self.heldout.relative)
        return f"Step({self.label}: held-out error {errors} %)"


@dataclass(repr=False)
class Diagnosis:
    """Verdict, findings and everything they rest on.

    Printed, it is its verdict and its names: ``Diagnosis(missing-effect: delay on j2, 0.98)``.
    """

    verdict: str
    findings: list[Finding] = field(default_factory=list)
    ladder: list[Step] = field(default_factory=list)
    first: Evidence = NOTHING
    last: Evidence = NOTHING
    floor: FloatArray = field(default_factory=lambda: np.zeros(0))
    warnings: list[tuple[str, str]] = field(default_factory=list)
    partial: list[Finding] = field(default_factory=list)
    heldout_floor: FloatArray | None = None
    #: What any function of position, speeds or time could explain of what is left.
    network: list[Share] = field(default_factory=list)
    #: Share of an error at the floor that a function of one joint's position and speed removes.
    beyond: float | None = None
    #: What the motion could not have shown.
    unseen: list[Unseen] = field(default_factory=list)
    #: What the given model had been identified on.
    valid: tuple[Range, ...] = ()
    #: Why an effect was not added to a joint, by effect and joint: the last rule that stopped it.
    stops: dict[tuple[str, int], CheckResult] = field(default_factory=dict)
    #: Rules that stopped something -> whether of one thing at least no other rule would have.
    fired: dict[str, bool] = field(default_factory=dict)
    #: What the data cannot tell apart; made when first asked for (see `tables.sets_of`).
    sets: list[Indistinguishable] | None = field(default=None, init=False)
    #: Simulated errors of the rungs; made when first asked for (see `analysis.ladder`).
    multi_steps: list[MultiStep] | None = field(default=None, init=False)

    def __repr__(self) -> str:
        names = [
            f"{f.effect}{f' on {f.joint}' if f.joint else ''}, {f.confidence:.2f}"
            for f in self.findings
        ]
        return (
            f"Diagnosis({': '.join([self.verdict, '; '.join(names)] if names else [self.verdict])})"
        )

    @property
    def noise(self) -> FloatArray:
        """Noise floor that belongs to the held-out errors (d,)."""
        return self.floor if self.heldout_floor is None else self.heldout_floor

    @property
    def result(self) -> FitResult:
        """Fit of the last rung; DataError if nothing was fitted (verdict ``"bad-data"``)."""
        self._fitted()
        return self.ladder[-1].result

    @property
    def model(self) -> RobotModel:
        """The last model of the ladder, which never rises.

        Where a name does not stand, what it does is kept as a correction without a name.

        Raises
        ------
        DataError
            If nothing was fitted (verdict ``"bad-data"``): then there is no model.
        """
        self._fitted()
        return self.ladder[-1].result.model

    def _fitted(self) -> None:
        if not self.ladder:
            faults = "; ".join(text for _, text in self.warnings[:3])
            raise DataError(
                f"this diagnosis holds no model: its verdict is {self.verdict!r} and nothing was "
                f"fitted ({faults}); mend the recording, see 'hil info'"
            )


def describe(c: Candidate, problem: Problem) -> str:
    """E.g. ``stribeck on joint2``."""
    where = joint_of(c, problem)
    return f"{c.name} on {where}" if where else c.name


def joint_of(c: Candidate, problem: Problem) -> str | None:
    """Joint's name, None for an effect of the whole robot."""
    if c.term.effect.of_robot:
        return None
    return problem.joints[c.term.joint]
