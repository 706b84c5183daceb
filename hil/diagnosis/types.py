"""What a diagnosis consists of: candidates and their evidence, errors, findings, the verdict.

Types alone: everything else of the diagnosis lies above.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.constants import ADEQUATE, LEVEL, NEAR_FLOOR, RISEN, WORTH
from hil.errors import DataError
from hil.identify.design import Term
from hil.identify.multistep import MultiStep
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult, relative
from hil.models.effect import Trait
from hil.models.model import Range, RobotModel, Value
from hil.shown import Plotted

FloatArray = NDArray[np.float64]


# ------------------------------------------------------------ evidence


@dataclass(frozen=True)
class Floor:
    """Noise floor by joint.

    Parameters
    ----------
    rms : ndarray (d,)
        Floor [N m or N], in the band of the effort filter.
    method : str
        ``"repeats"`` or ``"largest-model"``.
    residual : ndarray (d, n)
        Residual of the largest model: the noise that detection is tested against.
    inflation : ndarray (d,)
        1 + 2 sum of autocorrelations of that residual.
    scale : ndarray (d,)
        Its root mean square, corrected for degrees of freedom.
    """

    rms: FloatArray
    method: str
    residual: FloatArray
    inflation: FloatArray
    scale: FloatArray

    def effective(self, problem: Problem) -> FloatArray:
        """Number of independent instants by joint (d,)."""
        return problem.count / self.inflation

    def below(self, other: Floor) -> Floor:
        """The same with no floor above that of another one."""
        rms, scale = np.minimum(self.rms, other.rms), np.minimum(self.scale, other.scale)
        return replace(self, rms=rms, scale=scale)

    def exceeded(self, rms: FloatArray, j: int) -> bool:
        """Whether an error (d,) of joint j is above the floor: what is down to it needs no name.

        The floor of short or very repetitive data holds what the model lacks, too; the residual of
        the largest model is then far lower.
        """
        return bool(rms[j] > min(ADEQUATE * self.rms[j], NEAR_FLOOR * self.scale[j]))

    def met(self, rms: FloatArray) -> bool:
        """Whether all errors (d,) are down to the floor."""
        return bool(np.all(rms <= ADEQUATE * self.rms))


@dataclass
class Candidate:
    """One effect on one joint, tried beside the present model.

    Parameters
    ----------
    term : Term
        With the best shape.
    gain : float
        Fall of the weighted residual sum of squares if it is added.
    net : float
        The same if it takes the place of what it replaces.
    chi2 : float
        `net` in units of the noise, for the effective number of instants.
    dof : int
        Coefficients and shape values spent.
    price : float
        dof * log(effective instants).
    spare : float
        What a rival may lack in chi2 and still leave less than 1.1 times the noise floor.
    missed : float
        chi2 of what it leaves above the noise floor: its law misses no more than that.
    absorbed : float
        Share of its newest column that the base model imitates (1 = indistinguishable from it).
    p_value : float
        Family-wise, by sign flips of noise blocks.
    coefficients, errors : tuple of float
        Its coefficients if it is added, and their standard errors.
    joint : int
        Its joint; of an effect that all joints feel, the joint where it explains most.
    smoother : bool
        Whether all that it does is to smooth the noise of the positions.
    stirred : float
        What that noise makes of the joint's predicted effort, as a gain; of laws that may smooth
        it.
    blurred : bool
        Whether all that it explains is reversals that the motion's filter blurs.
    parts : ndarray (d,)
        `net` by joint.
    """

    term: Term
    gain: float
    net: float
    chi2: float = 0.0
    dof: int = 1
    price: float = 0.0
    spare: float = 0.0
    missed: float = np.inf
    absorbed: float = 0.0
    p_value: float = 1.0
    coefficients: tuple[float, ...] = (0.0,)
    errors: tuple[float, ...] = ()
    joint: int = 0
    smoother: bool = False
    stirred: float = 0.0
    blurred: bool = False
    parts: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    null: FloatArray = field(default_factory=lambda: np.zeros(FLIPS), repr=False)

    @property
    def detected(self) -> bool:
        """Whether it explains more than the best of all candidates would by chance."""
        return self.p_value <= LEVEL

    @property
    def artefact(self) -> bool:
        """Whether it explains no more than what sensors and filters do."""
        return self.smoother or self.blurred

    @property
    def late(self) -> float:
        """How late it says that the effort acts [s], for effects that say so."""
        return self.coefficient * float(np.prod(self.term.shape))

    @property
    def coefficient(self) -> float:
        """First coefficient if it is added."""
        return self.coefficients[0]

    @property
    def name(self) -> str:
        """Effect's name."""
        return self.term.effect.name

    @property
    def score(self) -> float:
        """chi2 less its price (BIC, up to sign)."""
        return self.chi2 - self.price


def ranking(c: Candidate) -> tuple[float, int, float]:
    """Sort key: the higher score first, of equals (in four digits) the one with less to fit."""
    return -float(f"{c.score:.4g}"), c.dof, -float(f"{c.score:.8g}")


FLIPS = 400
#: A run and an instant of it [s].
Cut = tuple[int, float]


@dataclass(frozen=True)
class Change:
    """One value that changed once on one joint.

    Parameters
    ----------
    joint, what, unit : str
        Joint, the value in words, its unit.
    run : str
        Name of the run.
    at : float
        Instant, since the start of the run [s]; zero where the whole run differs from others.
    value : float
        By how much it changed.
    share : float
        Share of the squared error that goes with it.
    fall : float
        The same as the fall of the weighted residual sum of squares.
    """

    joint: str
    what: str
    unit: str
    run: str
    at: float
    value: float
    share: float
    fall: float

    @property
    def text(self) -> str:
        """One sentence without its full stop."""
        fall = 100 * (1 - np.sqrt(1 - self.share))
        return f"{self.joint}: {self.subject} would lower the error by {fall:.0f} %"

    @property
    def subject(self) -> str:
        """What changed, when and by how much, as the subject of a sentence."""
        when = f"from {self.at:.3g} s of {self.run} on" if self.at else f"in {self.run}"
        size = f"{self.value:+.3g} {self.unit}"
        if self.unit == "1":
            size = f"{100 * self.value:+.3g} % against the rest"
        return f"another {self.what} {when} ({size})"


@dataclass(frozen=True)
class Evidence:
    """All candidates beside one fit, best first, with the floor they were judged against."""

    candidates: list[Candidate]
    floor: Floor
    projector: Projector | None
    impossible: list[tuple[str, str]]
    changes: tuple[Change, ...] = ()


_NONE = np.zeros(0)
#: No evidence: a recording that was not analysed.
NOTHING = Evidence([], Floor(_NONE, "none", np.zeros((0, 0)), _NONE, _NONE), None, [])


# ------------------------------------------------------------ errors and doubts


@dataclass(frozen=True)
class HeldOut:
    """Residuals on held-out data.

    Parameters
    ----------
    residual, effort : ndarray (d, n)
        Residual and measured effort after the same filter.
    blocks : ndarray (n,)
        Blocks of time, for standard errors.
    kind : str
        ``"holdout"`` (other runs) or ``"folds"`` (blocks of the same runs).
    run : ndarray (n,)
        Run of each instant.
    names : tuple of str
        Names of the runs.
    """

    residual: FloatArray
    effort: FloatArray
    blocks: NDArray[np.int_]
    kind: str
    run: NDArray[np.int_] = field(default_factory=lambda: np.zeros(0, dtype=np.int_))
    names: tuple[str, ...] = ()

    @property
    def rms(self) -> FloatArray:
        """Rms residual (d,)."""
        return self._rms(self.residual)

    @property
    def effort_rms(self) -> FloatArray:
        """Rms measured effort at the same instants (d,)."""
        return self._rms(self.effort)

    def _rms(self, x: FloatArray) -> FloatArray:
        moving = np.sum(self.effort != 0.0, axis=1)  # zero where the joint stands still
        out: FloatArray = np.sqrt(np.sum(x**2, axis=1) / np.maximum(moving, 1))
        return out

    @property
    def relative(self) -> FloatArray:
        """100 rms(residual) / rms(effort) (d,) [%]."""
        return relative(self.residual, self.effort)

    @property
    def relative_all(self) -> float:
        """The same over all joints together, each in its own effort's scale [%]."""
        return float(np.sqrt(np.mean(self.relative**2)))

    def standard_error(self) -> FloatArray:
        """Standard error of `relative` from the spread over blocks (d,)."""
        count = int(self.blocks.max()) + 1
        size = np.bincount(self.blocks, minlength=count)
        power = np.stack([np.bincount(self.blocks, r**2, minlength=count) for r in self.residual])
        mean = power.sum(axis=1) / size.sum()
        spread = np.sqrt(np.sum((power - mean[:, None] * size) ** 2, axis=1)) / size.sum()
        out: FloatArray = self.relative * spread / np.maximum(2 * mean, 1e-300)
        return out

    def gain(self, before: HeldOut, j: int) -> float:
        """Fall of joint j's squared error against `before`, in standard errors (paired blocks)."""
        fall = np.bincount(self.blocks, before.residual[j] ** 2 - self.residual[j] ** 2)
        spread = float(np.sqrt(np.sum((fall - fall.mean()) ** 2)))
        return float(fall.sum()) / max(spread, 1e-300)

    def risen(self, other: HeldOut, j: int, moves: Sequence[int], small: float) -> str:
        """Why another model is worse on held-out runs, beyond chance; empty where it is not.

        What stays below the practical size on another joint is not worse there.

        Parameters
        ----------
        other : HeldOut
            Errors of the other model.
        j : int
            Joint for which it was made; others may rise by less than an effect must bring.
        moves : sequence of int
            Joints that move.
        small : float
            Share of the rms effort below which nothing matters.
        """
        if self.kind != "holdout":
            return ""
        worse = [k for k in moves if other.rms[k] > self.rms[k] and self.gain(other, k) > RISEN]
        if j in worse:
            return "the error of the held-out runs rises"
        matters = other.rms > small * self.effort_rms
        worse = [k for k in worse if matters[k]]
        ratio = (other.rms / np.maximum(self.rms, 1e-300)) ** 2
        ratio = np.where(matters, ratio, np.minimum(ratio, 1.0))[moves]
        more = any(other.rms[k] > (1 + WORTH / 2) * self.rms[k] for k in worse)
        if more and float(ratio.mean()) > 1:
            return "the error of the held-out runs rises on other joints"
        size = np.maximum(self.effort_rms[moves], 1e-300)
        one, two = (float(np.sum((x.rms[moves] / size) ** 2)) for x in (self, other))
        return "the error of the held-out runs rises over all joints" if two > one else ""

    def share(self, first: HeldOut, floor: float, j: int) -> tuple[float, float]:
        """Share of joint j's squared error above `floor` that is gone since `first`, and its se.

        With A and B the sums of squares after and before and F the floor's, s = (B - A) / (B - F);
        blocks are paired, so that  se(s)^2 = sum ((1 - s) b_k - a_k)^2 / (B - F)^2  about the
        mean, the floor being taken as known.
        """
        before = np.bincount(self.blocks, first.residual[j] ** 2)
        after = np.bincount(self.blocks, self.residual[j] ** 2)
        moving = float(np.sum(self.effort[j] != 0.0))
        excess = max(float(before.sum()) - moving * floor**2, 1e-300)
        share = float(before.sum() - after.sum()) / excess
        each = (1.0 - share) * before - after
        return share, float(np.sqrt(np.sum((each - each.mean()) ** 2))) / excess


@dataclass(frozen=True)
class Explainable:
    """What one set of inputs could explain on one joint.

    Parameters
    ----------
    joint, feature : str
        Joint, and the inputs, e.g. ``network: q,qd of joint2``.
    share : float
        Left-out share of the error above the floor, 0 to 1.
    text : str
        One sentence.
    words : str
        The inputs in words.
    """

    joint: str
    feature: str
    share: float
    text: str
    words: str = ""


@dataclass(frozen=True)
class Unseen:
    """Effects that a motion could not show, and why.

    Parameters
    ----------
    effects, joints : tuple of str
        What, and where; no joint is the whole robot.
    why : str
        Half a sentence.
    command : str
        What plans a motion that would; empty where none does.
    """

    effects: tuple[str, ...]
    joints: tuple[str, ...]
    why: str
    command: str = ""

    def hides(self, effect: str, joint: str) -> bool:
        """Whether it is this effect on this joint that could not be shown."""
        return effect in self.effects and (not self.joints or joint in self.joints)

    @property
    def text(self) -> str:
        """One line for people."""
        where = f" on {', '.join(self.joints)}" if self.joints else ""
        how = f": {self.command}" if self.command else ""
        return f"{', '.join(self.effects)}{where}: {self.why}{how}"


#: Why a set cannot be told apart.
STRUCTURAL, EXCITATION = "structural", "excitation"


#: What is said where the size of an effect is too small for any motion to separate rivals.
EITHER = "nothing at this size (use either; they predict the same)"


@dataclass(frozen=True)
class Indistinguishable:
    """A set of effects that the data cannot separate.

    Parameters
    ----------
    effects : tuple of str
        The set.
    why, experiment : str
        Sentences for people.
    reason : str
        ``"structural"``: no motion of this robot would; ``"excitation"``: another motion would.
    motion, command : str
        Best motion of the menu and the command that makes it; empty where there is none.
    """

    effects: tuple[str, ...]
    why: str
    experiment: str
    reason: str = STRUCTURAL
    motion: str = ""
    command: str = ""


# ------------------------------------------------------------ the answer


def above_zero(noise: FloatArray) -> FloatArray:
    """Noise floors to divide by: a joint without an effort has none."""
    return np.maximum(noise, np.finfo(np.float64).tiny)


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
    reason : str
        What holds its confidence down most.
    felt_on : str
        Joint whose errors these are, where that is not the effect's own or all joints feel it;
        else empty.
    rival_weights : list of float
        Weight of each rival, by the measure that speaks most for it; empty where it is not known.
    of_no_size : bool
        Whether it has no name because it is neither sure nor of practical size.
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
    reason: str = ""
    felt_on: str = ""
    rival_weights: list[float] = field(default_factory=list)
    of_no_size: bool = False

    @property
    def felt(self) -> str | None:
        """The joint whose errors these are."""
        return self.felt_on or self.joint

    @property
    def weighed_rivals(self) -> list[str]:
        """Rivals with their weights, e.g. ``spring (0.91)``."""
        if len(self.rival_weights) != len(self.rivals):
            return self.rivals
        pairs = zip(self.rivals, self.rival_weights, strict=True)
        return [f"{name} ({weight:.2f})" for name, weight in pairs]


@dataclass(frozen=True, repr=False)
class Step:
    """One rung of the error ladder."""

    label: str
    result: FitResult
    heldout: HeldOut

    def __repr__(self) -> str:
        errors = ", ".join(f"{x:.2f}" for x in self.heldout.relative)
        return f"Step({self.label}: held-out error {errors} %)"


@dataclass(frozen=True)
class UnnamedCorrection:
    """A free function without a name that the written model holds, for what no effect explains.

    Parameters
    ----------
    effect, of : str
        Its name in the model file, and what it is a function of, in words.
    joint : str
        Joint.
    relative_before, relative_after, se : float
        Held-out relative error of the joint [%] and the standard error of the latter.
    alike : tuple of str
        Laws of the catalogue that would do as much in the place of all corrections of the joint.
    """

    effect: str
    of: str
    joint: str
    relative_before: float
    relative_after: float
    se: float
    alike: tuple[str, ...] = ()


def to_try(effect: str, joint: str, beside: bool = False) -> str:
    """How to try an effect that has no name: a sentence, and a command for stand-in files.

    `beside`: it helps only with the effects that are named.
    """
    model = "IMPROVED.toml" if beside else "M.toml"
    typed = f"hil add {effect} S.mcap --joint {shlex.quote(joint)} --model {model}"
    with_ = "improved model, which -o writes" if beside else "given model"
    return f"To try it with the {with_}:\n{typed}"


@dataclass(frozen=True)
class CheckResult:
    """Why a rule stopped a case.

    Parameters
    ----------
    code : str
        The rule.
    stage : str
        ``"candidate"`` before a fit with it, ``"fit"`` after one.
    reason : str
        One sentence without its full stop.
    evidence : dict of str to float
        The numbers it rests on.
    """

    code: str
    stage: str
    reason: str
    evidence: dict[str, float] = field(default_factory=dict)


@dataclass(repr=False, eq=False)
class Diagnosis(Plotted):
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
    network: list[Explainable] = field(default_factory=list)
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
    #: Free functions without a name that the last model holds beside what was found.
    corrections: list[UnnamedCorrection] = field(default_factory=list)
    #: Rungs at the end of the ladder that corrections give.
    corrected: int = 0
    #: What the data cannot tell apart; made when first asked for (see `equivalence.sets_of`).
    sets: list[Indistinguishable] | None = field(default=None, init=False)
    #: Simulated errors of the rungs; made when first asked for (see `verbs.ladder`).
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
        """Noise floor that belongs to the held-out errors (d,), above zero."""
        noise = self.floor if self.heldout_floor is None else self.heldout_floor
        return above_zero(noise)

    @property
    def explained(self) -> Step:
        """The last rung without corrections: all that has a name, and nothing else."""
        self._fitted()
        return self.ladder[-1 - self.corrected]

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
    """E.g. ``stribeck on joint2``; of a correction what it is a function of."""
    where = joint_of(c, problem)
    if Trait.CORRECTION in c.term.effect.traits:
        of = c.term.effect.doc.variables
        return (
            f"{of} on {where}"
            if Trait.GEOMETRY in c.term.effect.traits
            else f"correction over {of} on {where}"
        )
    return f"{c.name} on {where}" if where else c.name


def joint_of(c: Candidate, problem: Problem) -> str | None:
    """Joint's name, None for an effect of the whole robot."""
    if c.term.effect.scope.of_robot:
        return None
    return problem.joints[c.term.joint]
