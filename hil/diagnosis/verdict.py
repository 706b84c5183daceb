"""What is said beside a verdict: excuses, notes, common causes, errors, what is left.

Nothing here changes a name or a confidence, nor a verdict but one: an error at its floor that a
function of positions or speeds foretells on left-out data, or that keeps to two sides as no noise
does, is not adequate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis import artefacts
from hil.diagnosis.artefacts import returned, shaken, smoothed
from hil.diagnosis.constants import BEATEN, HALF, NEAR_FLOOR, TENTH, WHOLE, WORTH
from hil.diagnosis.equivalence import unseen
from hil.diagnosis.floor import REPEATS, alarming, explainable, foretold, hidden, practical
from hil.diagnosis.heldout import Examiner, differences
from hil.diagnosis.preconditions import contradicted, lost, other_robot
from hil.diagnosis.residual_tests import bends, changes_told, unlike, unlike_notes
from hil.diagnosis.touches import pushed
from hil.diagnosis.types import Candidate, Diagnosis, Evidence, Finding, Step, describe
from hil.identify.bands import HELD, effort_noise
from hil.identify.context import renew
from hil.identify.fit import outside
from hil.identify.gauss_newton import complete
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.identify.timing import late_effort
from hil.models import catalogue
from hil.models.effect import Trait
from hil.models.model import RobotModel, Value
from hil.record.consistency import DataFault
from hil.record.jumps import described
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]


# ------------------------------------------------------------ excuses


def of_noise(
    step: Step, evidence: Evidence, floor: FloatArray, there: bool = False
) -> NDArray[np.bool_]:
    """Joints (d,) of which what stands above the floor comes of how the positions are measured.

    Their noise smoothed in the model's load or, where that is little, returned late by the
    controller; or reversals that their filter blurs.  Where `there`, of the held-out error and its
    floor: what the positions make of the fitted runs' error is taken from it, and no more.
    """
    result = step.result
    end = step.heldout.rms if there else result.rms
    most = WHOLE * (end**2 - floor**2)
    late = (end <= NEAR_FLOOR * floor) & (returned(evidence, result) >= most)
    excused = (
        (smoothed(evidence, result) >= most)
        | (artefacts.blurred_parts(evidence, result) >= most)
        | late
    )
    return np.asarray((most > 0.0) & excused)


def refuted(step: Step, floor: FloatArray) -> NDArray[np.bool_]:
    """Joints (d,) where held-out runs are far above their own floor; none without such runs.

    Of motor efforts only: a force sensor's accuracy, which its floor counts, is not known to that.
    """
    told = step.heldout.kind == "holdout" and step.result.model.explains == "motor"
    moves = ~step.result.problem.holds & told
    return np.asarray(moves & (step.heldout.rms > NEAR_FLOOR * floor))


def only_there(step: Step, last: Evidence, floor: FloatArray) -> bool:
    """Whether the fitted runs are down to their floor, and held-out ones far above theirs.

    Something acts where the fitted motion does not go, or the rig has changed.
    """
    return last.floor.met(step.result.rms) and bool(np.any(refuted(step, floor)))


def rival_name(r: Candidate, c: Candidate, problem: Problem) -> str:
    """Name of a rival, with its joint where that is what is in doubt."""
    return describe(r, problem) if r.name == c.name else r.name


# ------------------------------------------------------------ notes


def notes(result: FitResult, last: Evidence) -> list[tuple[str, str]]:
    """Notes (code, sentence) on what was not tested, left out, or not determined."""
    out = [
        (f"impossible-{name}", f"{name} cannot be tested: {why}") for name, why in last.impossible
    ]
    out += _held(result)
    counted = result.problem.n - int(np.sum(result.problem.left_out))
    still = 1.0 - result.problem.count / max(counted, 1)
    for j in np.flatnonzero(still > WORTH):
        out.append(
            (
                "standstill",
                f"{result.problem.joints[j]} stands still for {100 * still[j]:.0f} % of the time. "
                "These samples are left out: static friction balances any effort there",
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
                f"{len(lost)} parameters are determined only in combination, for example "
                f"{', '.join(lost[:4])}. Predictions of such motions do not depend on this",
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
    blind = f". {', '.join(dead)} never changes by one count: a brake, or a dead encoder?"
    text = (
        f"{', '.join(names)}: held in place (within {HELD:.0f} steps of the encoder), so no "
        "effect is "
        "named there. Diagnose it together with a session that moves it"
    )
    return [("holds", text + (blind if dead else ""))]


def noticed(evidence: Evidence, result: FitResult) -> list[tuple[str, str]]:
    """Notes (code, sentence) on values that changed at once and on noise that is no physics."""
    return (
        result.problem.notes
        + late_effort(result.problem)
        + changes_told(evidence.changes)
        + bends(result, evidence.projector)
        + shaken(evidence, result)
        + artefacts.blur_notes(evidence, result)
        + artefacts.rounded_notes(result.problem)
    )


COMMON, NO_GEOMETRY = "common-cause", "no-geometry"


# ------------------------------------------------------------ what findings have in common


def common(findings: list[Finding], moving: list[str]) -> list[tuple[str, str]]:
    """Note (code, sentence) where every joint that moves is late by the same time.

    Parameters
    ----------
    findings : list of Finding
        What was named.
    moving : list of str
        Joints that move.
    """
    traits = ((f, catalogue.get(f.effect).traits) for f in findings)
    late = {f.joint: lateness(f).value for f, own in traits if Trait.LATE in own}
    if len(moving) < 2 or set(late) != set(moving):
        return []
    times = list(late.values())
    mean = sum(times) / len(times)
    if max(times) - min(times) > BEATEN * mean:
        return []
    text = (
        f"{', '.join(moving)} are late by the same time, {1e3 * mean:.3g} ms: probably one "
        f"cause and not {len(late)}, for example different clocks of efforts and positions, one "
        "filter or one bus"
    )
    return [(COMMON, text)]


def lateness(f: Finding, apart: float = 0.0) -> Value:
    """How late the whole effort acts [s]: the product of its coefficient and its shape values.

    The share that is late and its time make up for each other: neither says it alone.

    Parameters
    ----------
    f : Finding
        An effect that makes the effort late.
    apart : float
        What the recorded efforts may be late by besides, as they were sampled [s].
    """
    effect = catalogue.get(f.effect)
    values = {name.rsplit(".", 1)[-1]: v for name, v in f.parameters.items()}
    own = [values[p.name] for p in (*effect.params, *effect.shape) if p.name in values]
    size = math.prod(v.value for v in own)
    parts = [v.stderr / v.value for v in own if v.stderr == v.stderr and v.value]
    return Value(size, math.hypot(apart, *(size * x for x in parts)), "s")


def lost_counts(
    findings: list[Finding], recordings: list[Recording], said: list[tuple[str, str]]
) -> list[tuple[str, str]]:
    """Instants and sizes of jumps that are named, unless the checks of the recording gave them."""
    out = []
    for f in findings:
        if Trait.JUMPS not in catalogue.get(f.effect).traits or f.joint is None:
            continue
        for r in recordings:
            j = r.joints.index(f.joint)
            lost = r.jumps[j]
            text = f"{f.joint}: q{j + 1} {described(r.t, lost)}"
            if lost.at.size and ("step", text) not in said:
                out.append(("step", text if len(recordings) == 1 else f"{r.name}, {text}"))
    return out


# ------------------------------------------------------------ after the verdict


def finish(
    out: Diagnosis,
    examine: Examiner,
    model: RobotModel,
    recordings: list[Recording],
    faults: list[DataFault],
) -> Diagnosis:
    """The diagnosis with all that is said beside its verdict.

    Parameters
    ----------
    out : Diagnosis
        With its verdict.
    examine : Examiner
        Knows the held-out runs.
    model : RobotModel
        The model under suspicion.
    recordings : list of Recording
        Runs that were fitted.
    faults : list of DataFault
        What the checks say of them.
    """
    result = out.ladder[-1].result
    out.unseen = unseen(result, out.last)
    out.valid = model.valid
    # before the held-out runs are predicted anew: their loads are those of their own fit
    absurd = lost(result, out.ladder[-1].heldout.relative)
    # no change between sessions is told from a model that fits none of them
    differ = [] if absurd else differences(out, examine)
    left = outside(model.valid, result.problem) + examine.outside(result)
    out.warnings += absurd
    out.warnings += other_robot(model, recordings)
    # a description is not doubted by values that are no masses
    last = out.explained
    out.warnings += [] if absurd else contradicted(last.result, last.heldout.rms / out.noise)
    out.warnings += [("outside-range", text) for text in left]
    out.warnings += examine.own(result)
    out.warnings += differ
    out.warnings += [(f.code, f.sentence) for f in faults]
    out.warnings += lost_counts(out.findings, recordings, out.warnings)
    told = {s.joint for s in out.network}
    out.network += [s for s in explainable(result, out.last.floor) if s.joint not in told]
    if out.verdict == "adequate":
        # what is less than efforts are known to needs no explanation, nor what sensors do
        felt = alarms(result) & ~of_noise(out.ladder[-1], out.last, out.floor)
        falls = foretold(result)
        if falls is not None:
            falls = {j: x for j, x in falls.items() if felt[j]}
        out.beyond = None if falls is None else max([0.0, *falls.values()])
        out.network = hidden(result, falls or {})
        if out.network:
            out.verdict = "unexplained"
    _with_unlike(out)
    if out.verdict in ("adequate", "unexplained"):
        slow = pushed(result, alarms(result))
        out.warnings += slow
        out.verdict = "unexplained" if slow else out.verdict
    out.warnings += high_floors(out)
    if out.verdict == "adequate" and no_noise(out.warnings):
        out.verdict = "unexplained"
    with_errors(out)
    holds = zip(result.problem.joints, result.problem.holds, strict=True)
    out.warnings += common(out.findings, [name for name, still in holds if not still])
    return out


#: Code of a note on noise floors that are a good part of the effort.
HIGH_FLOOR = "high-floor"
#: Code of the note on the law that would do most of all that are not named.
REFUSED = "nearest-refused"


def high_floors(out: Diagnosis) -> list[tuple[str, str]]:
    """Note (code, sentence) on joints whose floor is much of the effort.

    They are at their floor, or above it by what no function explains.
    """
    step = out.ladder[-1]
    problem, held = step.result.problem, step.heldout
    share = held.relative * out.noise / np.maximum(held.rms, 1e-300)
    at_floor = held.rms <= NEAR_FLOOR * out.noise
    best: dict[str, float] = {}
    for s in out.network:
        best[s.joint] = max(best.get(s.joint, 0.0), s.share)
    open_ = np.array([best.get(name, 1.0) < WORTH for name in problem.joints])
    much = ~problem.holds & (at_floor | open_) & (share > 100 * TENTH)
    # a floor that is what the user says of the efforts is none to wonder at
    much = np.flatnonzero(much & alarms(step.result))
    if not much.size:
        return []
    each = ", ".join(f"{share[j]:.0f} % on {problem.joints[j]}" for j in much.tolist())
    tried = "No effect of the catalogue explains it"
    if out.last.floor.method == REPEATS:
        tried = "It is what differs between repetitions of the motion"
    elif all(best.get(problem.joints[j], 0.0) < WORTH for j in much.tolist()):
        tried += ", nor does a function of positions and speeds that was tried"
    lead = f"the noise floor itself is a large part of the effort: {each}"
    return [(HIGH_FLOOR, f"{lead}. {tried}. {_made_of(out, much)}")]


#: What a high floor may come of where nothing is ruled out.
_OF_ANYTHING = (
    "It may be a disturbance, a push, a poor sensor, a motion that hardly needs effort, or an "
    "effect that is in no catalogue"
)
#: Words of a floor that is mostly no white noise of the efforts.
NOT_WHITE = "White noise of the efforts is at most"
#: Words of one that no sensor makes.
NO_SENSOR = "Is an effect missing"


def _made_of(out: Diagnosis, joints: NDArray[np.int_]) -> str:
    """What may make the floor of some joints, by how much of it white noise of the efforts makes.

    Less than half of its power in the band of the fit: something else does.  Less than a tenth of
    its size, hence a hundredth of its power: no sensor.  A force from outside that was measured has
    noise of its own.
    """
    problem = out.ladder[-1].result.problem
    if any(r.wrench is not None or r.tau_ext is not None for r in problem.recordings):
        return _OF_ANYTHING
    noise = [effort_noise(r, problem.rates.effort) for r in problem.recordings]
    part = float(np.max((np.sqrt(np.mean(np.square(noise), axis=0)) / out.noise)[joints]))
    if part**2 > HALF:
        return _OF_ANYTHING
    white = f"{NOT_WHITE} {100 * part:.2g} % of that floor"
    if part > TENTH:
        return (
            f"{white}. The rest may be a disturbance, a push, a poor sensor, or an effect that is "
            "in no catalogue"
        )
    return (
        f"{white}. {NO_SENSOR} that is in no catalogue, or did a force act from outside that was "
        "not measured (a hand, a wearer, a cable)?"
    )


def no_noise(warnings: Sequence[tuple[str, str]]) -> str:
    """How large what is left is where it is much of the effort and no noise of a sensor."""
    texts = [text for code, text in warnings if code == HIGH_FLOOR and NO_SENSOR in text]
    return texts[0].split(". ")[0].split(": ")[1] if texts else ""


def not_white(warnings: Sequence[tuple[str, str]]) -> str:
    """How large noise floors are that are mostly no noise of the efforts; empty where none is."""
    texts = [text for code, text in warnings if code == HIGH_FLOOR and NOT_WHITE in text]
    return texts[0].split(". ")[0] if texts else ""


def _with_unlike(out: Diagnosis) -> None:
    """What is left where that is no noise; who leaves a wave or a switch is not adequate."""
    step = out.ladder[-1]
    found = unlike(step.result, step.heldout.rms, out.noise, out.last.projector)
    out.warnings += unlike_notes(found)
    felt = dict(zip(step.result.problem.joints, alarms(step.result), strict=True))
    if out.verdict == "adequate" and any(u.matters and felt[u.joint] for u in found):
        out.verdict = "unexplained"


def matters(result: FitResult) -> NDArray[np.bool_]:
    """Joints (d,) whose error is more than efforts are known to."""
    size = result.problem.rms(result.problem.effort)
    return np.asarray(result.rms > practical(result.problem) * size)


def alarms(result: FitResult) -> NDArray[np.bool_]:
    """Joints (d,) whose error is more than leaves a model adequate."""
    size = result.problem.rms(result.problem.effort)
    return np.asarray(result.rms > alarming(result.problem) * size)


def with_errors(out: Diagnosis) -> None:
    """Give standard errors to every shape value, in the last model and in what was found.

    Values of what was found are those beside no correction: a free function of a law's own
    variables takes any share of it, and the law's values then mean little by themselves.
    """
    step, named = out.ladder[-1], out.explained.result
    values: dict[str, Value] = {}
    if named is not step.result:
        renew(named)
        values = complete(named).values
        renew(step.result)
    out.ladder = [*out.ladder[:-1], replace(step, result=complete(step.result))]
    values = values or out.ladder[-1].result.values
    for kind in ("findings", "partial"):
        told = [
            replace(f, parameters={n: values.get(n, v) for n, v in f.parameters.items()})
            for f in getattr(out, kind)
        ]
        setattr(out, kind, told)
