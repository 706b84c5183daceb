"""What a name explains, and what is said beside a verdict: excuses, notes, errors, what is left.

A name's confidence falls with what it explains.  Nothing else here changes a name, nor a verdict
but one: an error at its floor that a function of positions or speeds predicts on left-out data, or
that keeps to two sides as no noise does, is not adequate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis import artefacts, rules
from hil.diagnosis.artefacts import returned, shaken_joints, smoothed
from hil.diagnosis.attribution import Named
from hil.diagnosis.candidates import competitor_in_words
from hil.diagnosis.constants import ADEQUATE, BEATEN, HALF, NEAR_FLOOR, SURE, TENTH, WHOLE, WORTH
from hil.diagnosis.equivalence import unseen
from hil.diagnosis.floor import (
    REPEATS,
    alarming,
    explainable,
    free_function_falls,
    masked_at_floor,
    practical,
)
from hil.diagnosis.heldout import Examiner, held_out_differences
from hil.diagnosis.preconditions import contradicted, lost, other_robot
from hil.diagnosis.remodel import Visited
from hil.diagnosis.residual_tests import bends, changes_told, unlike_noise, unlike_notes
from hil.diagnosis.search import Search
from hil.diagnosis.touches import pushed
from hil.diagnosis.types import Candidate, Diagnosis, Evidence, Finding, Step, describe, joint_of
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
from hil.record.consistency import DataFault, Note, notes_of
from hil.record.jumps import described
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]


# ------------------------------------------------------------ what a name explains

#: What a name's free functions say: share that it takes, and their variables.
Shares = dict[tuple[str, int], tuple[float, str]]
#: Why a name is not sure that has rivals.
AS_WELL = "other effects explain the same error about as well"
#: Why an effect has none that held-out runs hardly show.
TOO_LITTLE = (
    "on the held-out runs it is so small that it may be an inaccuracy of the laws named before"
)


def finding(
    n: Named, search: Search, floor: FloatArray, other: FloatArray | None, taken: Shares
) -> Finding:
    """One effect of the last model, with what it explains and how sure its name is."""
    problem, c, rungs = search.problem, n.candidate, search.rungs
    k = rung_with(search, c)
    before, after = rungs[max(k - 1, 0)].step, rungs[k].step
    j = _felt_on(search, c, before, after) if len(rungs[k].added) == 1 else c.joint
    explain, own = _explain(search, c, (floor, other), taken), n.confidence
    hardly = _hardly_there(search, c, (rungs[max(k - 1, 0)], rungs[k]), j, other)
    explain.append((float(not hardly), TOO_LITTLE))
    share = min(value for value, _ in explain)
    worth = float(np.clip((share - HALF) / max(WHOLE - HALF, 1e-300), 0.0, 1.0))
    least_sure = [*explain, (own, AS_WELL)]
    head = (f"j{c.term.joint + 1}.{c.name}.", f"{c.name}.")
    one = [
        float((s.result if other is None else s.heldout).rms[j] ** 2)
        for s in (before, after, search.base.step)
    ]
    least = float((floor if other is None else other)[j]) ** 2
    explained = (one[0] - one[1]) / max(one[2] - least, 1e-300)
    rivals = _weighed(n, problem)
    return Finding(
        c.name,
        joint_of(c, problem),
        round(n.confidence * worth, 3),
        float(before.heldout.relative[j]),
        float(after.heldout.relative[j]),
        float(after.heldout.standard_error()[j]),
        float(np.clip(explained, 0.0, 1.0)),
        {name: v for name, v in search.now.result.values.items() if name.startswith(head)},
        list(rivals),
        min(least_sure)[1],
        problem.joints[j] if c.term.effect.scope.whole or j != c.term.joint else "",
        [round(w, 3) for w in rivals.values()] if all(rivals.values()) else [],
    )


def rung_with(search: Search, c: Candidate) -> int:
    """Number of the rung that an effect of the last model came with."""
    key = search.stands_for.get(c.term.key, c.term.key)
    return next((k for k, r in enumerate(search.rungs) if key in r.keys), len(search.rungs) - 1)


def _weighed(n: Named, problem: Problem) -> dict[str, float]:
    """Names of an effect's rivals, and the weight that speaks most for each; 0 where unknown."""
    out: dict[str, float] = {}
    for k, r in enumerate(n.rivals):
        name = rival_name(r, n.candidate, problem)
        out[name] = max(out.get(name, 0.0), *(n.odds[k] if k < len(n.odds) else (0.0,)))
    return out


def _hardly_there(
    search: Search, c: Candidate, steps: tuple[Visited, Visited], j: int, floor: FloatArray | None
) -> bool:
    """Whether held-out runs surely show less of an effect than the laws before it may miss.

    The rule that the fitted runs have passed ("discrepancy"), on runs that no value has seen.  Of
    what took another law's place that law's doing is its own.
    """
    before, after = steps
    first, then, last = search.base, before.step.heldout, search.now.step.heldout
    dated = c.term.effect.variation.dated(c.term.shape)
    old, new = ({t.key for t in r.step.result.terms} for r in steps)
    if floor is None or dated or old - new or before is first or last.rms[j] <= ADEQUATE * floor[j]:
        return False
    taken = max(float(first.errors.power[j] - before.errors.power[j]), 1e-300)
    part = rules.inaccuracy(search, c, j, float(before.errors.power[j])) / taken
    share, error = after.step.heldout.share(then, 0.0, j)
    return float((share + SURE * error) * then.rms[j] ** 2) < part * float(
        first.step.heldout.rms[j] ** 2 - then.rms[j] ** 2
    )


def _felt_on(search: Search, c: Candidate, before: Step, after: Step) -> int:
    """The joint whose error tells of an effect: its own, unless that stays and another's falls.

    The masses take the gain of a motor, and what they cannot take is left on the joints that share
    them.
    """
    old, new = (np.maximum(s.heldout.rms, 1e-300) for s in (before, after))
    fall = np.where(search.problem.holds, 0.0, 1.0 - (new / old) ** 2)
    elsewhere = fall[c.joint] < TENTH and np.max(fall) > HALF
    return int(np.argmax(fall)) if elsewhere else c.joint


def _explain(
    search: Search, c: Candidate, floors: tuple[FloatArray, FloatArray | None], taken: Shares
) -> list[tuple[float, str]]:
    """What a name explains, by several measures, and what to say where one of them is the least."""
    own, what = taken.get(c.term.key, (1.0, ""))
    everywhere, held = here(search, c.joint, *floors), there(search, c, floors[1])
    above, lost = "of the squared error above the noise floor", _left_share(search, c.joint)
    return [
        (
            float(lost < 1.0),
            f"with the named effects the left-out error is still {100 * lost:.0f} % of the effort: "
            "no model at all would predict as well",
        ),
        (
            own,
            f"{competitor_in_words(what)} explains much of the same error better"
            if what
            else "left-out data show little of what it explains",
        ),
        _of_one_run(search, c, floors[0]),
        (everywhere, f"the named effects explain {100 * max(everywhere, 0.0):.0f} % {above}"),
        (
            held,
            f"on the held-out runs the named effects explain {100 * max(held, 0.0):.0f} % {above}",
        ),
    ]


def _of_one_run(search: Search, c: Candidate, floor: FloatArray) -> tuple[float, str]:
    """Nothing where one value of one run leaves less than all values of an effect of single runs.

    Less than half of what that effect leaves above the floor: a spring that one session has is no
    payload, though a payload pulls like it near a posture.  What was named beside it later, on its
    joint, is a part of that.
    """
    if search.first is None:
        return 1.0, ""
    j, least, base = c.joint, float(floor[c.joint]) ** 2, search.base.result.rms
    until = search.rungs[: rung_with(search, c) + 1]
    after = [r for r in until if any(x.term.per_run and x.joint == j for x in r.added)]
    for x in search.first.changes:
        left = (1 - x.share) * float(base[j]) ** 2 - least
        whole = x.joint == search.problem.joints[j] and not x.at
        if whole and any(left < HALF * (float(r.result.rms[j]) ** 2 - least) for r in after):
            return 0.0, f"{x.subject} explains the same error better"
    return 1.0, ""


def _left_share(search: Search, j: int) -> float:
    """Left-out error of joint j in its effort's size, or the largest of all that share masses."""
    now, moves = search.now.step, ~search.problem.holds
    body = any(Trait.BODY in t.effect.traits for t in now.result.terms)
    share = now.heldout.relative / 100
    return float(np.max(share[moves]) if body else share[j])


def here(search: Search, j: int, floor: FloatArray, other: FloatArray | None = None) -> float:
    """Share of joint j's excess over its floor that all its names take.

    Fitted and held-out runs together, where there are such: values that are fitted beside an effect
    hide it on the fitted ones.
    """
    first, last = [search.base.result.rms[j]], [search.now.result.rms[j]]
    least = [min(float(floor[j]), float(last[0]))]
    if other is not None:
        first.append(search.base.step.heldout.rms[j])
        last.append(search.now.step.heldout.rms[j])
        least.append(min(float(other[j]), float(last[1])))
    before, after, noise = (float(np.sum(np.square(x))) for x in (first, last, least))
    return (before - after) / max(before - noise, 1e-300)


def there(search: Search, c: Candidate, floor: FloatArray | None) -> float:
    """The same on the held-out runs, at most.

    1 without such runs, and of what acts at instants of the fitted runs alone.
    """
    last, j = search.now.step.heldout, c.joint
    if (
        floor is None
        or last.rms[j] <= ADEQUATE * floor[j]
        or c.term.effect.variation.dated(c.term.shape)
    ):
        return 1.0
    share, se = last.share(search.base.step.heldout, ADEQUATE * float(floor[j]), j)
    return float(share + SURE * se)


# ------------------------------------------------------------ excuses


def floor_with_position_noise(
    step: Step, evidence: Evidence, floor: FloatArray, there: bool = False
) -> FloatArray:
    """A floor (d,) with what comes of how the positions are measured; an error at most.

    Their noise smoothed in the model's load or, where that is little, returned late by the
    controller; or reversals that their filter blurs.  Where `there`, of the held-out error and its
    floor: what the positions make of the fitted runs' error is added to it, and no more.
    """
    result = step.result
    end = step.heldout.rms if there else result.rms
    late = np.where(end <= NEAR_FLOOR * floor, returned(evidence, result), 0.0)
    part = np.maximum(smoothed(evidence, result), artefacts.blurred_parts(evidence, result))
    most = np.maximum(end**2, floor**2)
    return np.asarray(np.sqrt(np.minimum(floor**2 + np.maximum(part, late), most)))


def of_noise(
    step: Step, evidence: Evidence, floor: FloatArray, there: bool = False
) -> NDArray[np.bool_]:
    """Joints (d,) of which what stands above the floor comes of how the positions are measured."""
    end = step.heldout.rms if there else step.result.rms
    excess = end**2 - floor**2
    made = floor_with_position_noise(step, evidence, floor, there) ** 2 - floor**2
    return np.asarray((excess > 0.0) & (made >= WHOLE * excess))


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
        + shaken_joints(evidence, result)
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
    late = {f.joint: effort_lateness(f).value for f, own in traits if Trait.LATE in own}
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


def effort_lateness(f: Finding, apart: float = 0.0) -> Value:
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
    differ = [] if absurd else held_out_differences(out, examine)
    left = outside(model.valid, result.problem) + examine.outside(result)
    out.warnings += absurd
    out.warnings += other_robot(model, recordings)
    # a description is not doubted by values that are no masses
    last = out.explained
    out.warnings += [] if absurd else contradicted(last.result, last.heldout.rms / out.noise)
    out.warnings += [("outside-range", text) for text in left]
    out.warnings += examine.own(result)
    out.warnings += differ
    out.warnings += [f.note for f in faults]
    out.warnings += lost_counts(out.findings, recordings, out.warnings)
    told = {s.joint for s in out.network}
    out.network += [s for s in explainable(result, out.last.floor) if s.joint not in told]
    if out.verdict == "adequate":
        # what is less than efforts are known to needs no explanation, nor what sensors do
        least = alarming(result.problem) * result.problem.rms(result.problem.effort)
        felt = alarms(result) & ~of_noise(out.ladder[-1], out.last, out.floor)
        falls = free_function_falls(result)
        if falls is not None:
            falls = {j: x for j, x in falls.items() if felt[j]}
        out.beyond = None if falls is None else max([0.0, *falls.values()])
        # what a function takes of the error counts, and not the whole of it
        size = np.square(result.rms / np.maximum(least, 1e-300))
        out.network = masked_at_floor(
            result, {j: x for j, x in (falls or {}).items() if x * size[j] > 1}
        )
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
#: How its sentence begins.
LARGE = "the noise floor itself is a large part of the effort"
#: What such a floor is: mostly no white noise of the efforts; no noise of any sensor.
NOT_WHITE, NO_SENSOR = "not-white", "no-sensor"
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
    kind, made = _made_of(out, much)
    return [Note(HIGH_FLOOR, f"{LARGE}: {each}. {tried}. {made}", size=each, kind=kind)]


#: What a high floor may come of where nothing is ruled out.
_OF_ANYTHING = (
    "It may be a disturbance, a push, a poor sensor, a motion that hardly needs effort, or an "
    "effect that is in no catalogue"
)


def _made_of(out: Diagnosis, joints: NDArray[np.int_]) -> tuple[str, str]:
    """What makes the floor of some joints, by how much of it white noise does: kind, sentences.

    Less than half of its power in the band of the fit: something else does.  Less than a tenth of
    its size, hence a hundredth of its power: no sensor.  A force from outside that was measured has
    noise of its own.
    """
    problem = out.ladder[-1].result.problem
    if any(r.wrench is not None or r.tau_ext is not None for r in problem.recordings):
        return "", _OF_ANYTHING
    noise = [effort_noise(r, problem.rates.effort) for r in problem.recordings]
    part = float(np.max((np.sqrt(np.mean(np.square(noise), axis=0)) / out.noise)[joints]))
    if part**2 > HALF:
        return "", _OF_ANYTHING
    white = f"White noise of the efforts is at most {100 * part:.2g} % of that floor"
    if part > TENTH:
        return (
            NOT_WHITE,
            f"{white}. The rest may be a disturbance, a push, a poor sensor, or an effect that is "
            "in no catalogue",
        )
    return (
        NO_SENSOR,
        f"{white}. Is an effect missing that is in no catalogue, or did a force act from outside "
        "that was not measured (a hand, a wearer, a cable)?",
    )


def no_noise(warnings: Sequence[tuple[str, str]]) -> str:
    """How large what is left is where it is much of the effort and no noise of a sensor."""
    return next((n.size for n in notes_of(warnings, HIGH_FLOOR) if n.kind == NO_SENSOR), "")


def not_white(warnings: Sequence[tuple[str, str]]) -> str:
    """How large noise floors are that are mostly no noise of the efforts; empty where none is."""
    return next((f"{LARGE}: {n.size}" for n in notes_of(warnings, HIGH_FLOOR) if n.kind), "")


def _with_unlike(out: Diagnosis) -> None:
    """What is left where that is no noise; who leaves a wave or a switch is not adequate."""
    step = out.ladder[-1]
    found = unlike_noise(step.result, step.heldout.rms, out.noise, out.last.projector)
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
