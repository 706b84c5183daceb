"""Which physical effect is missing: detect, attribute, add, refit, retest, and judge."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.compare.attribute import LEVEL, choose, plausible
from hil.compare.evidence import NOTHING, Candidate, Evidence, gather
from hil.compare.floor import SENSOR_ACCURACY
from hil.compare.heldout import Examiner, HeldOut
from hil.compare.identifiable import undetermined
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.identify.threads import single_threaded
from hil.identify.timing import fit_aligned, longest_shift
from hil.models import catalogue
from hil.models.model import RobotModel, Use, Value
from hil.record.checks import check
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
#: Below this share of the excess explained, no name is given.
EXPLAINED = 0.70
#: Errors within this factor of the floor count as adequate.
ADEQUATE = 1.10
CONFIDENT = 0.75
#: An effect must lower the held-out error of its joint by this much ...
WORTH = 0.04
#: ... and remove this share of what is still above the floor.
SHARE = 0.10
#: ... and, after a first effect on the joint, this share of all that was above the floor:
#: library equations miss real effects by about a percent of their power, which is no new effect.
FORM = 0.02
MOST = 4


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
        Share of the squared error above the noise floor that this effect removed.
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


@dataclass(frozen=True)
class Step:
    """One rung of the error ladder."""

    label: str
    result: FitResult
    heldout: HeldOut


@dataclass
class Diagnosis:
    """Verdict, findings and everything they rest on."""

    verdict: str
    findings: list[Finding] = field(default_factory=list)
    ladder: list[Step] = field(default_factory=list)
    first: Evidence = NOTHING
    last: Evidence = NOTHING
    floor: FloatArray = field(default_factory=lambda: np.zeros(0))
    warnings: list[tuple[str, str]] = field(default_factory=list)
    partial: list[Finding] = field(default_factory=list)
    heldout_floor: FloatArray | None = None

    @property
    def noise(self) -> FloatArray:
        """Noise floor that belongs to the held-out errors (d,)."""
        return self.floor if self.heldout_floor is None else self.heldout_floor

    @property
    def result(self) -> FitResult:
        """Fit of the last rung."""
        return self.ladder[-1].result

    @property
    def model(self) -> RobotModel:
        """The improved model; the first one where nothing is named."""
        return (self.ladder[-1] if self.findings else self.ladder[0]).result.model


@single_threaded
def diagnose(
    recordings: list[Recording],
    model: RobotModel,
    holdout: list[Recording] | None = None,
    most: int = MOST,
    seed: int = 0,
) -> Diagnosis:
    """Find the physical effects that a model lacks.

    Parameters
    ----------
    recordings : list of Recording
        Runs to fit.
    model : RobotModel
        The model under suspicion.
    holdout : list of Recording, optional
        Runs to judge on; contiguous fifths of the same runs otherwise.
    most : int
        Largest number of effects to add.
    seed : int
        Of the sign flips.
    """
    errors = [f for r in recordings for f in check(r) if f.severity == "error"]
    if errors:
        return Diagnosis("bad-data", warnings=[(f.code, f.text) for f in errors])
    problem = Problem(recordings, model.robot, model.explains, model.band)
    result = fit_aligned(problem, model)
    examine = Examiner(problem, holdout or [])
    ladder = [Step("base model", result, examine(result))]
    evidence = first = gather(result, seed)
    reasons = undetermined(result)
    if reasons:
        return Diagnosis("not-identifiable", [], ladder, first, first, first.floor.rms, reasons)
    found: list[tuple[Candidate, float, list[Candidate]]] = []
    for _ in range(most):
        step = _next(evidence, ladder, examine, problem, found)
        if step is None:
            break
        ladder.append(step)
        evidence = gather(step.result, seed)
        _retest(found, ladder, examine, problem)
    out = _judge(ladder, found, first, evidence)
    out.heldout_floor = examine.floor(ladder[-1].result)
    return out


def _next(
    evidence: Evidence, ladder: list[Step], examine: Examiner, problem: Problem,
    found: list[tuple[Candidate, float, list[Candidate]]],
) -> Step | None:  # fmt: skip
    """Try the plausible candidates in order; accept the first that also helps held-out."""
    now, projector = ladder[-1], evidence.projector
    if projector is None:
        return None
    candidates = [
        c for c in plausible(evidence, now.result.sigma, problem.n)
        if c.name != "delay" or abs(c.coefficient) > longest_shift(problem)
    ]  # fmt: skip
    for k, c in enumerate(candidates[:3]):
        rest = [c, *[x for x in candidates if x is not c and candidates.index(x) > k]]
        best, confidence, rivals = choose(rest, projector)
        model = now.result.model + as_use(best, problem)
        step = Step(f"+ {describe(best, problem)}", *_refit(model, problem, examine))
        if _worth(step, now, ladder[0], best.term.joint, evidence.floor.rms):
            found.append((best, confidence, rivals))
            return step
    return None


def _worth(step: Step, now: Step, first: Step, j: int, floor: FloatArray) -> bool:
    """Whether a step pays: in held-out error beyond chance, and in the excess over the floor."""
    before, after = now.result.rms[j] ** 2, step.result.rms[j] ** 2
    excess = max(before - float(floor[j]) ** 2, 1e-300)
    whole = max(first.result.rms[j] ** 2 - float(floor[j]) ** 2, 1e-300)
    share = min((before - after) / excess, SHARE / FORM * (before - after) / whole)
    better = step.heldout.rms[j] < (1 - WORTH) * now.heldout.rms[j]
    if step.result.model.explains == "external":
        # half the force sensor's accuracy, in percent of the effort
        better &= step.heldout.relative[j] < now.heldout.relative[j] - 50 * SENSOR_ACCURACY
    return bool(better and share > SHARE and step.heldout.gain(now.heldout, j) > 1.0)


def _refit(model: RobotModel, problem: Problem, examine: Examiner) -> tuple[FitResult, HeldOut]:
    result = fit_aligned(problem, model)
    return result, examine(result)


def as_use(c: Candidate, problem: Problem) -> Use:
    """A candidate as a part of a model, its shape as the starting value."""
    effect = c.term.effect
    head = f"j{c.term.joint + 1}.{effect.name}"
    values = {
        f"{head}.{p.name}": Value(v, unit=p.unit)
        for p, v in zip(effect.shape, c.term.shape, strict=True)
    }
    whole = effect.whole_robot and not effect.shape
    options: dict[str, object] = {"per_run": True} if c.term.per_run else {}
    joints = ("*",) if whole else (problem.joints[c.term.joint],)
    return Use(effect.name, joints, options, values)


def describe(c: Candidate, problem: Problem) -> str:
    """E.g. ``stribeck on joint2``."""
    where = joint_of(c, problem)
    return f"{c.name} on {where}" if where else c.name


def joint_of(c: Candidate, problem: Problem) -> str | None:
    """Joint's name, None for an effect of the whole robot."""
    if c.term.effect.whole_robot and not c.term.effect.shape:
        return None
    return problem.joints[c.term.joint]


def _retest(
    found: list[tuple[Candidate, float, list[Candidate]]], ladder: list[Step],
    examine: Examiner, problem: Problem,
) -> None:  # fmt: skip
    """Take out an accepted effect that later ones have made superfluous."""
    for k, (candidate, _, _) in enumerate(found[:-1]):
        use = as_use(candidate, problem)
        model = ladder[-1].result.model
        rest = tuple(u for u in model.effects if (u.type, u.joints) != (use.type, use.joints))
        if len(rest) == len(model.effects):
            continue
        result, heldout = _refit(replace(model, effects=rest), problem, examine)
        j = candidate.term.joint
        if heldout.rms[j] <= 1.002 * ladder[-1].heldout.rms[j]:
            found.pop(k)
            ladder.append(Step(f"- {describe(candidate, problem)} (superfluous)", result, heldout))
            return


def _judge(
    ladder: list[Step], found: list[tuple[Candidate, float, list[Candidate]]],
    first: Evidence, last: Evidence,
) -> Diagnosis:  # fmt: skip
    problem = ladder[0].result.problem
    floor = np.minimum(last.floor.rms, ladder[-1].result.rms)
    findings = _findings(ladder, found, floor)
    start, end = ladder[0].result.rms, ladder[-1].result.rms
    excess, left = start**2 - floor**2, np.maximum(end**2 - floor**2, 0.0)
    open_joints = [
        j for j in range(problem.d)
        if end[j] > ADEQUATE * floor[j] and left[j] > (1 - EXPLAINED) * excess[j]
    ]  # fmt: skip
    failed = {problem.joints[j] for j in open_joints}
    partial = [f for f in findings if f.joint in failed or (f.joint is None and failed)]
    findings = [f for f in findings if f not in partial]
    if findings:
        sure = all(f.confidence >= CONFIDENT for f in findings)
        verdict = "missing-effect" if sure else "ambiguous"
    else:
        verdict = "unexplained" if open_joints else "adequate"
    return Diagnosis(
        verdict, findings, ladder, first, last, floor, _warnings(ladder, last), partial
    )


def _findings(
    ladder: list[Step], found: list[tuple[Candidate, float, list[Candidate]]], floor: FloatArray
) -> list[Finding]:
    problem = ladder[0].result.problem
    values = ladder[-1].result.values
    rungs = {s.label: k for k, s in enumerate(ladder)}
    out = []
    for c, confidence, rivals in found:
        k, j = rungs[f"+ {describe(c, problem)}"], c.term.joint
        before, after = ladder[k - 1], ladder[k]
        excess = max(ladder[0].result.rms[j] ** 2 - floor[j] ** 2, 1e-300)
        removed = before.result.rms[j] ** 2 - after.result.rms[j] ** 2
        head = (f"j{j + 1}.{c.name}.", f"{c.name}.")
        out.append(
            Finding(
                c.name, joint_of(c, problem), round(confidence, 3),
                float(before.heldout.relative[j]), float(after.heldout.relative[j]),
                float(after.heldout.standard_error()[j]), float(np.clip(removed / excess, 0, 1)),
                {n: v for n, v in values.items() if n.startswith(head)},
                list(dict.fromkeys(r.name for r in rivals)),
            )
        )  # fmt: skip
    return out


def _warnings(ladder: list[Step], last: Evidence) -> list[tuple[str, str]]:
    out = [
        (f"impossible-{name}", f"{name} cannot be tested: {why}") for name, why in last.impossible
    ]
    result = ladder[-1].result
    for name, v in result.values.items():
        if v.at_bound:
            out.append(("at-bound", f"parameter {name} lies on its bound {v.value:g} {v.unit}"))
    lost = result.not_identifiable()
    if lost:
        out.append(
            (
                "not-identifiable",
                f"{len(lost)} parameters are determined only in combination, e.g. "
                f"{', '.join(lost[:4])}",
            )
        )
    return out


def significant(evidence: Evidence) -> bool:
    """Whether anything at all stands out of the noise."""
    return any(c.p_value <= LEVEL and c.score > 0 for c in evidence.candidates)


def known_effects() -> list[str]:
    """Names of all effects that can be found."""
    return sorted(n for n, e in catalogue.table().items() if e.candidate)
