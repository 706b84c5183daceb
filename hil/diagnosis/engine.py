"""Which physical effect is missing: prepare, fit, search, name, judge.

The measured external effort, at an unknown ratio and sign.

The model says  tau + tau_ext = model.  With a free gain g of the external effort,

    tau + tau_ext = model + (1 - g) tau_ext,

g near 1 is right or a gain error (an effect that may be named), g near -1 a wrong sign, and g far
from both another ratio: of a gear, of units, or of where it was measured.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil import work
from hil.diagnosis import rules
from hil.diagnosis.artefacts import converter
from hil.diagnosis.attribution import Named
from hil.diagnosis.candidates import shares
from hil.diagnosis.columns import mistaken
from hil.diagnosis.constants import (
    ADEQUATE,
    BEATEN,
    CONFIDENT,
    HALF,
    NEAR_FLOOR,
    RIVAL,
    SURE,
    WORTH,
)
from hil.diagnosis.floor import alarming, practical
from hil.diagnosis.grams import Split, split
from hil.diagnosis.heldout import Examiner, settled, still_differ, within_errors
from hil.diagnosis.naming import emptied, exchange, separated
from hil.diagnosis.preconditions import (
    doubts,
    touched,
    undetermined,
    without_effort,
)
from hil.diagnosis.remodel import Visited
from hil.diagnosis.search import Search
from hil.diagnosis.touches import TOUCHED, Touch, confirmed, suspects, touches
from hil.diagnosis.types import (
    NOTHING,
    Candidate,
    CheckResult,
    Diagnosis,
    Evidence,
    Finding,
    HeldOut,
    Step,
    UnnamedCorrection,
    describe,
    joint_of,
    to_try,
)
from hil.diagnosis.verdict import (
    AS_WELL,
    NO_GEOMETRY,
    REFUSED,
    finding,
    finish,
    floor_with_position_noise,
    matters,
    notes,
    noticed,
    of_noise,
    rival_name,
    rung_with,
    with_errors,
)
from hil.identify import multistep
from hil.identify.context import renew
from hil.identify.design import by_run
from hil.identify.fit import fit
from hil.identify.problem import Problem, of_model
from hil.identify.result import FitResult
from hil.identify.timing import fit_aligned, late_beside
from hil.models import catalogue
from hil.models.effect import Trait
from hil.models.model import BASE_EFFECTS, RobotModel, as_model
from hil.models.robots import undescribed
from hil.record.arrays import Runs, as_runs, held_out
from hil.record.checks import check
from hil.record.consistency import DataFault, Note, notes_of
from hil.record.recording import Recording
from hil.work import single_threaded

FloatArray = NDArray[np.float64]


@single_threaded
def diagnose(
    recordings: Runs,
    model: RobotModel,
    holdout: Runs | None = None,
    seed: int = 0,
) -> Diagnosis:
    """Find the physical effects that a model lacks.

    Parameters
    ----------
    recordings : Recording or list of Recording
        Runs to fit.
    model : RobotModel
        The model under suspicion.
    holdout : Recording or list of Recording, optional
        Runs that confirm a name and that no rung may raise; blocks of the same runs otherwise.
    seed : int
        Of the folds and of the sign flips.

    Returns
    -------
    Diagnosis
        Without a model (an empty ladder) where a run has a fault: verdict ``"bad-data"``.

    Raises
    ------
    DataError
        If no run is given, runs are of different robots, or a held-out run has a fault, is of
        another robot, or is one of the fitted ones.
    ConfigError
        If an argument is of another kind.
    """
    recordings, model = as_runs(recordings, "hil.diagnose"), as_model(model, "hil.diagnose")
    held = held_out(holdout, "hil.diagnose")
    faults = [f for r in recordings for f in check(r)]
    errors = [f for f in faults if f.severity == "error"] or without_effort(recordings)
    if errors:
        return Diagnosis("bad-data", warnings=[f.note for f in errors])
    out = _diagnosed(recordings, model, held, seed, faults)
    lightest = _lightest(out)
    if lightest:
        work.at("another run is the lightest: seek again", 0.1)
        others = [r for k, r in enumerate(recordings) if k != lightest]
        # once: where two runs carry as much, either may seem the lighter one
        return _diagnosed([recordings[lightest], *others], model, held, seed, faults)
    return out


def _diagnosed(
    recordings: list[Recording],
    model: RobotModel,
    held: list[Recording],
    seed: int,
    faults: list[DataFault],
    cuts: int = 0,
) -> Diagnosis:
    """The same of runs without a fault, in the order in which they are given.

    `cuts`: how often moments have been left out of them.
    """
    # the shares are about those of the time, by the middle of each piece of work
    work.at("fit the given model", 0.0)
    problem = of_model(recordings, model)
    result = fit_aligned(problem, model)
    folds = split(problem, seed, not any(t.per_run for t in result.terms))
    wrong, doubtful = doubts(result, folds)
    wrong += mistaken(result, recordings)
    if wrong:
        return Diagnosis("bad-data", warnings=wrong)
    examine = Examiner(problem, held)
    search = _begun(result, folds, examine, seed)
    first = search.now.step
    reasons = undetermined(first.result)
    if reasons:
        none, _ = search.evidence([])
        return Diagnosis("not-identifiable", [], [first], none, none, none.floor.rms, reasons)
    search.geometry()
    search.forward()
    if search.found and late_beside(search.now.result):
        work.at("efforts are late: seek again", 0.1)
        examine = Examiner(problem, held)
        search = _begun(fit_aligned(problem, model), folds, examine, seed)
        search.geometry()
        search.forward()
    if steps := converter(search.now.result, _open(search)):
        work.at("efforts are rounded: seek again", 0.1)
        # once: the model says its steps then
        stated = replace(model, band=replace(model.band, effort_step=steps))
        return _diagnosed(recordings, stated, held, seed, faults, cuts)
    named = _named(search)
    if search.retimed():
        search.forward()
        named = _named(search)
    out = floored(_concluded(search, named, model, recordings, faults, doubtful))

    def again(some: list[Touch], cuts: int) -> Diagnosis:
        work.at("something pushed for a moment: seek again without these times", 0.1)
        return _diagnosed(_without(recordings, some), model, held, seed, faults, cuts)

    return out if cuts >= CUTS else _aside(out, recordings, again, cuts)


#: Times that moments are left out and all is sought again.
CUTS = 3


def _aside(
    out: Diagnosis,
    recordings: list[Recording],
    again: Callable[[list[Touch], int], Diagnosis],
    cuts: int,
) -> Diagnosis:
    """The diagnosis without moments in which something pushed; `out` where nothing did.

    At first also what is only suspected is left out, and the better model, which `again` gives, is
    asked of all: what it does not confirm comes back.
    """
    told = _acting(out, recordings, touches)
    some = told or ([] if cuts else _acting(out, recordings, suspects))
    if not some:
        return out
    other = again(some, cuts + 1 if told else CUTS)
    ask = other.ladder and not cuts
    sure = confirmed(_of_all(recordings, other), some) if ask else some
    if [t.spans for t in sure] == [t.spans for t in some]:
        return _told(other, sure)
    if told and sure:
        return _told(again(sure, CUTS), sure)
    renew(out.result)
    return out


def _told(out: Diagnosis, sure: list[Touch]) -> Diagnosis:
    """A diagnosis that says which moments were left out of it."""
    out.warnings = [(TOUCHED, t.text) for t in sure] + out.warnings
    return out


def _acting(
    out: Diagnosis, recordings: list[Recording], which: Callable[[FitResult], list[Touch]]
) -> list[Touch]:
    """What acted for moments beside the last names; nothing where a fifth of the time is left out.

    What is left out on one joint may have hidden what acts on another.  Nor is anything told on
    joints of which a value changed for good.
    """
    gone = [sum(b - a for a, b in r.left_out) / (r.t[-1] - r.t[0]) for r in recordings]
    if max(gone) > BEATEN:
        return []
    changed = {c.joint for c in out.last.changes}
    return [t for t in which(out.explained.result) if t.joint not in changed]


def _of_all(recordings: list[Recording], out: Diagnosis) -> FitResult:
    """All that has a name in another diagnosis, fitted to these runs."""
    named = out.explained.result.model
    return fit(of_model(recordings, named), named, sweeps=1)


def _without(recordings: list[Recording], told: list[Touch]) -> list[Recording]:
    """The runs, of which what acted for moments enters no equation."""
    spans = [[x for t in told if t.run == k for x in t.spans] for k in range(len(recordings))]
    return [r.leaving_out(own) for r, own in zip(recordings, spans, strict=True)]


def _named(search: Search) -> list[Named]:
    """What was found with its rivals, after other forms of it have been tried."""
    work.at("compare with rivals", 0.62)
    search.complete()
    if search.untimed():
        search.forward()
    return exchange(search)


def _open(search: Search) -> NDArray[np.bool_]:
    """Joints (d,) that got an effect, or are still above the noise floor."""
    evidence, result = search.last or search.first, search.now.result
    out = np.zeros(result.problem.d, dtype=bool)
    out[[c.joint for c in search.found]] = True
    return out if evidence is None else out | (result.rms > ADEQUATE * evidence.floor.rms)


def _lightest(out: Diagnosis) -> int:
    """The run that differences between runs count from, where they are bodies; 0 is the first.

    A body is something that is there: the run without it is the one that a description is of.
    """
    named = {f.effect for f in out.findings}
    if not named:
        return 0
    result = out.ladder[-1].result
    for t, where in zip(result.terms, result.slices, strict=True):
        e = t.effect
        if t.per_run and e.variation.relative and e.family == "mass" and e.name in named:
            return int(np.argmin(by_run(t, result.theta[where], result.problem.runs)[:, 0]))
    return 0


def _concluded(
    search: Search,
    named: list[Named],
    model: RobotModel,
    recordings: list[Recording],
    faults: list[DataFault],
    doubtful: list[tuple[str, str]],
    again: bool = True,
) -> Diagnosis:
    """The diagnosis of what was found, with corrections for the rest.

    Once more, where that may be, if corrections have led the fit out of a local minimum and are not
    needed there.
    """
    search.blunted()
    renew(search.now.result)
    work.at("judge the names", 0.8)
    out = judged(search, named, _last(search))
    if named and not out.findings and all(f.of_no_size for f in out.partial):
        search.given()
        out = judged(search, [], _last(search))
    out.warnings = without_robot(search.problem) + doubtful + out.warnings
    out.stops, out.fired = search.stops, search.fired
    if touched(out.ladder[-1].result, out.ladder[-1].heldout.relative):
        return finish(_unnamed(out, search), search.examine, model, recordings, faults)
    finish(out, search.examine, model, recordings, faults)
    corrected(out, search)
    if again and out.corrected and (search.settle(out.corrected) or search.promoted(out.corrected)):
        # once: a blunter sign may lead the fit back into the minimum that it has left
        search.forward()
        named = _named(search)
        return _concluded(search, named, model, recordings, faults, doubtful, again=False)
    return separate(withdrawn(out, search, named), search, named)


def _unnamed(out: Diagnosis, search: Search) -> Diagnosis:
    """The diagnosis of the given model alone: names beside masses that are none mean nothing."""
    out.verdict, out.findings, out.partial = "unexplained", [], []
    out.ladder, out.corrections = out.ladder[:1], []
    out.warnings = [n for n in out.warnings if n[0] != REFUSED]
    renew(out.ladder[0].result)
    return out


def _begun(result: FitResult, folds: Split, examine: Examiner, seed: int) -> Search:
    """A search that begins with a fit of the given model."""
    search = Search(result.problem, folds, examine, seed)
    given = {u.type for u in result.model.effects} - set(BASE_EFFECTS)
    first = settled(result, examine, "given model" if given else "base model")
    search.rungs.append(search.judged(first.label, first.result))
    search.blind = bool(without_robot(result.problem))
    return search


#: Why an effect that is not sure has none where it is little.
UNSURE = "it is less than {:g} % of the effort, and others may explain it as well"
HARDLY = "the left-out data hardly show it"
UNMOVED = "it is less than {:g} % of the effort, and the simulated motion is worse with it"


def floored(out: Diagnosis) -> Diagnosis:
    """The diagnosis with no floor above an error that a model of its ladder reached.

    Verdict and names were judged by the floor that was measured beside the model they speak of.
    """
    reached = np.min([s.heldout.rms for s in out.ladder], axis=0)
    if out.heldout_floor is None:
        out.floor = np.minimum(out.floor, reached)
    else:
        out.floor = np.minimum(out.floor, np.min([s.result.rms for s in out.ladder], axis=0))
        out.heldout_floor = np.minimum(out.heldout_floor, reached)
    return out


def corrected(out: Diagnosis, search: Search) -> Diagnosis:
    """The diagnosis with free functions for what no effect explains in its last model.

    The verdict and all that is said of the remainder are those of the model before: a correction
    explains nothing.
    """
    problem, step = search.problem, out.ladder[-1]
    over = (step.result.rms > ADEQUATE * out.floor) | (step.heldout.rms > ADEQUATE * out.noise)
    open_joints = ~problem.holds & over & matters(step.result)
    if out.verdict == "adequate" or not np.any(open_joints):
        return out
    work.at("seek corrections for the rest", 0.9)
    joints = (None, *problem.joints)
    search.standing = [
        (f.effect, max(joints.index(f.joint) - 1, 0)) for f in out.findings if f.confidence >= HALF
    ]
    for rung in search.correct(np.flatnonzero(open_joints).tolist()):
        out.corrections += corrections_of(rung, out.ladder[-1].heldout, problem)
        out.ladder.append(rung.step)
        out.corrected += 1
    if out.corrected:
        with_errors(out)
        out.corrections = with_laws(out.corrections, search)
        said = {c.joint for c in out.corrections if c.alike}
        served = [n for n in notes_of(out.warnings, REFUSED) if n.joint in said]
        out.warnings = [n for n in still_differ(out) if n not in served]
    renew(search.now.result)
    return out


#: Why a name does not stand that came to nothing.
EMPTIED = "nothing is left of it beside the correction for the remaining error"


def withdrawn(out: Diagnosis, search: Search, named: list[Named]) -> Diagnosis:
    """The diagnosis without names of which the corrections leave nothing in its last model.

    A law that stood for what is in no catalogue is nothing beside a function that follows it.
    """
    of = {(n.candidate.name, joint_of(n.candidate, search.problem)): n.candidate for n in named}
    gone: list[Finding] = []
    for f in out.findings if out.corrected else []:
        c = of[f.effect, f.joint]
        rung = emptied(search, c, search.rungs[-1 - out.corrected])
        if rung is None:
            continue
        rung.added = search.now.added
        search.rungs[-1], out.ladder[-1] = rung, rung.step
        search.found.remove(c)
        search.forget()
        gone.append(f)
        label = describe(c, search.problem)
        out.ladder = [
            replace(s, label=f"+ {label} (not named)") if s.label == f"+ {label}" else s
            for s in out.ladder
        ]
    if gone:
        out.findings = [f for f in out.findings if f not in gone]
        out.partial += [replace(f, confidence=0.0, rivals=[], reason=EMPTIED) for f in gone]
        out.verdict = _verdict(out.findings, out.partial, True)
        with_errors(out)
        renew(search.now.result)
    return out


def separate(out: Diagnosis, search: Search, named: list[Named]) -> Diagnosis:
    """The diagnosis without rivals that the last model shows to be none."""
    problem = search.problem
    of = {(n.candidate.name, joint_of(n.candidate, problem)): n for n in named}
    for k, f in enumerate(out.findings):
        before = of[f.effect, f.joint]
        now = separated(search, before) if f.rivals else before
        if now is not before:
            c = now.candidate
            names = dict.fromkeys(rival_name(r, c, problem) for r in now.rivals)
            most = HALF if f.reason.startswith(rules.DOUBTS) else 1.0
            sure = min(f.confidence * now.confidence / max(before.confidence, 1e-300), most)
            why = "" if not names and f.reason == AS_WELL else f.reason
            out.findings[k] = replace(f, confidence=round(sure, 3), rivals=list(names), reason=why)
    if out.verdict in ("ambiguous", "missing-effect"):
        out.verdict = _verdict(out.findings, out.partial, True)
    return out


def corrections_of(rung: Visited, before: HeldOut, problem: Problem) -> list[UnnamedCorrection]:
    """What the corrections of a rung are functions of, and what they do."""
    after, out = rung.step.heldout, []
    for c in rung.added:
        errors = (before.relative, after.relative, after.standard_error())
        effect, name = c.term.effect, problem.joints[c.joint]
        before_it, after_it, se = (float(e[c.joint]) for e in errors)
        out.append(
            UnnamedCorrection(effect.name, effect.doc.variables, name, before_it, after_it, se)
        )
    return out


def with_laws(made: list[UnnamedCorrection], search: Search) -> list[UnnamedCorrection]:
    """Corrections with the laws that would do as much in their place."""
    joints = search.problem.joints
    free = [c for c in made if Trait.GEOMETRY not in catalogue.get(c.effect).traits]
    found = search.alike(sorted({joints.index(c.joint) for c in free}))
    return [replace(c, alike=found.get(joints.index(c.joint), ())) for c in made]


#: What names mean where the geometry is unknown.
MEANS = (
    "Sums of sines and cosines without a name replace these. Effects are named only for the error "
    "that is left beside these sums; what may be gravity gets no name, or an uncertain one."
)


def without_robot(problem: Problem) -> list[tuple[str, str]]:
    """Warning where several joints have no geometry: nothing couples them in the model."""
    text = undescribed(problem.source, problem.d, MEANS)
    return [(NO_GEOMETRY, text)] if text else []


def _last(search: Search) -> Evidence:
    """Evidence beside the last model."""
    if not search.found:
        return search.last or NOTHING
    search.first, first = None, search.first  # the floor of the last model is its own
    last, _ = search.evidence(np.flatnonzero(~search.problem.holds).tolist())
    search.first = first
    return last


def judged(search: Search, named: list[Named], last: Evidence) -> Diagnosis:
    """Findings that stand, and the verdict over all joints.

    Parameters
    ----------
    search : Search
        With its rungs.
    named : list of Named
        Effects of the last model.
    last : Evidence
        Beside the last model.
    """
    ladder, end = [r.step for r in search.rungs], search.now.result
    floor = np.minimum(last.floor.rms, end.rms)
    there = search.examine.floor(end, last)
    renew(end)
    other = None if there is None else np.minimum(there, ladder[-1].heldout.rms)
    taken = shares(end, search.split, search.found, search.base.errors.power, last.floor.rms)
    # what the positions' measurement makes of an error no name need explain
    beside = floor_with_position_noise(ladder[-1], last, floor)
    held = None if other is None else floor_with_position_noise(ladder[-1], last, other, there=True)
    every = [finding(n, search, beside, held, taken) for n in named]
    over = above(search, last, there, named)
    left = ladder[-1].heldout.rms > ADEQUATE * (floor if other is None else other)
    every = rules.doubted(every, named, search, over, left | (end.rms > ADEQUATE * floor))
    every = _of_no_size(every, named, search)
    partial = [f for f in every if f.confidence < (RIVAL if f.rivals else HALF) or f.of_no_size]
    findings = [f for f in every if f not in partial]
    last = _with_theirs(last, search, partial)
    ladder = unnamed(search, named, every, partial)
    # what stands for a robot description explains nothing either
    stands = [(a, b) for a, b in pairwise(search.rungs) if _geometry(b)]
    lacking = bool(np.any(over)) or bool(stands)
    verdict = _verdict(findings, partial, lacking)
    out = Diagnosis(
        verdict, findings, ladder, search.first or last, last, floor, notes(end, last), partial
    )
    out.heldout_floor = other
    for a, b in stands:
        out.corrections += corrections_of(b, a.step.heldout, search.problem)
    out.warnings += [*noticed(last, end), *overtones(search), *nearest_refused(search, out, last)]
    least = alarming(search.problem) * search.problem.rms(search.problem.effort)
    power = dict(
        zip(search.problem.joints, (end.rms / np.maximum(least, 1e-300)) ** 2, strict=True)
    )
    if out.verdict == "adequate" and any(c.share * power[c.joint] > 1 for c in last.changes):
        out.verdict = "unexplained"
    return out


def _with_theirs(last: Evidence, search: Search, partial: list[Finding]) -> Evidence:
    """The last evidence with the changes in place of which names did not stand."""
    first = search.first.changes if search.first else ()
    better = [x for x in first if any(f.reason.startswith(x.subject) for f in partial)]
    joints = {x.joint for x in better}
    return replace(last, changes=(*better, *(x for x in last.changes if x.joint not in joints)))


def _of_no_size(every: list[Finding], named: list[Named], search: Search) -> list[Finding]:
    """The same; names that are not sure, of joints where all of these are little, say so.

    What a filter blurs takes the form of some law, but no arm moves by it.  Not sure is a name with
    rivals of another cause beside which the simulated motion is not clearly better than before, and
    any name beside which it is worse.
    """
    least, falls, doubts = 100 * alarming(search.problem), defaultdict[str | None, float](float), []
    for f, n in zip(every, named, strict=True):
        fall = max(f.relative_before**2 - f.relative_after**2, 0.0)
        doubts.append(_doubtful(f, n, search, fall < least**2))
        falls[f.felt] += fall * bool(doubts[-1])
    return [
        replace(f, of_no_size=True, reason=why.format(least))
        if why and falls[f.felt] < least**2
        else f
        for f, why in zip(every, doubts, strict=True)
    ]


def _doubtful(f: Finding, n: Named, search: Search, little: bool) -> str:
    """Why a name is not sure enough for a little effect; empty where it is."""
    unsure = f.confidence < CONFIDENT and not _of_one_cause(n)
    if not little:
        return UNSURE if unsure else ""
    better, worse = _moves(f, n.candidate, search)
    if unsure and not better:
        return UNSURE
    if worse and not unsure:
        return UNMOVED
    term, varies = n.candidate.term, n.candidate.term.effect.variation
    # what acts at instants of the fitted runs, or differs between them, need not be seen elsewhere
    elsewhere = varies.dated(term.shape) or (term.per_run and not varies.own(term.shape))
    size = f.relative_before**2 - f.relative_after**2 >= (100 * practical(search.problem)) ** 2
    seen = elsewhere or size or ADEQUATE * f.relative_after < f.relative_before
    return "" if seen else HARDLY


def _moves(f: Finding, c: Candidate, search: Search) -> tuple[bool, bool]:
    """Whether the simulated motion of its joint is surely better, by a fifth, or worse with it."""
    joints, result = search.problem.joints, search.now.result
    if f.felt not in joints or result.model.explains != "motor":
        return False, False
    k, j = rung_with(search, c), joints.index(f.felt)
    steps = [search.rungs[i].step.result for i in (max(k - 1, 0), k)]
    before, after = multistep.each(steps, search.problem)
    return before.rises(after, j, 1 / (1 - BEATEN)), after.rises(before, j, ADEQUATE)


def _of_one_cause(n: Named) -> bool:
    """Whether an effect has rivals, and all are other forms of its cause on its joint."""
    own = n.candidate.term
    causes = [
        set(r.term.effect.relations.causes) if r.term.joint == own.joint else set()
        for r in n.rivals
    ]
    return bool(causes) and all(c & set(own.effect.relations.causes) for c in causes)


def unnamed(
    search: Search, named: list[Named], every: list[Finding], partial: list[Finding]
) -> list[Step]:
    """Steps of the ladder; those whose effects all got no name say so."""
    none = {n.candidate.term.key for n, f in zip(named, every, strict=True) if f in partial}
    return [
        replace(r.step, label=f"{r.step.label} (not named)")
        if r.added and {c.term.key for c in r.added} <= none
        else r.step
        for r in search.rungs
    ]


def _geometry(rung: Visited) -> bool:
    """Whether a rung adds what stands for a robot description."""
    return any(Trait.GEOMETRY in c.term.effect.traits for c in rung.added)


def overtones(search: Search) -> list[tuple[str, str]]:
    """Notes (code, sentence) on waves that are further harmonics of a named one, a joint each."""
    joints, told = search.problem.joints, dict[int, str]()
    for (_, j), stop in search.stops.items():
        if stop.code == "overtone" and any(f.joint == j for f in search.found):
            told.setdefault(j, stop.reason)
    return [
        ("harmonic", f"{joints[j]}: {why} of that effect, not another effect")
        for j, why in told.items()
    ]


#: Rules that say that a law only seems to fit: what they stop is not told.
ARTEFACTS = ("detected", "late", "line", "position-noise", "blurred-sign", "overtone")


def nearest_refused(search: Search, out: Diagnosis, last: Evidence) -> list[Note]:
    """Notes (code, sentence) on joints above their floor: which law would do most, and why not.

    One that would take half of the squared error that is left, surely.
    """
    problem, errors = search.problem, search.now.errors
    told = {(f.effect, f.joint) for f in (*out.findings, *out.partial)}
    effort, found = problem.rms(problem.effort), []
    # tables are of the held-out runs then
    of = " on left-out blocks of the fitted runs" if search.examine.kind == "holdout" else ""
    for j in np.flatnonzero(~problem.holds).tolist():
        left = float(errors.power[j])
        above_it = left - float(last.floor.rms[j]) ** 2 > (alarming(problem) * effort[j]) ** 2
        if not (above_it and last.floor.exceeded(np.sqrt(errors.power), j)):
            continue
        near = [
            (stop.evidence["after"], name, stop)
            for (name, k), stop in search.stops.items()
            if k == j
            and stop.code not in ARTEFACTS
            and Trait.CORRECTION not in catalogue.get(name).traits
            and (name, problem.joints[j]) not in told
            and abs(stop.evidence.get("before", 0.0) - left) < WORTH * left
            and stop.evidence["after"] < HALF * left
            and stop.evidence["standard_errors"] > SURE
        ]
        if near:
            after, name, stop = min(near, key=lambda x: x[:2])
            was, now = (100 * max(x, 0.0) ** 0.5 / effort[j] for x in (left, after))
            text = (
                f"{problem.joints[j]}: {name} would lower the error{of} from {was:.3g} to "
                f"{now:.3g} % of the effort, but is not named: {stop.reason}. "
                + _what_then(stop, name, problem.joints[j], bool(search.found))
            )
            found.append(Note(REFUSED, text, problem.joints[j]))
    return found


def _what_then(stop: CheckResult, name: str, joint: str, beside: bool) -> str:
    """What to do with a law that would help, perhaps beside others, and is not named."""
    if stop.code == "physical":
        return "What is missing acts much like it"
    return to_try(name, joint, beside)


def _verdict(findings: list[Finding], partial: list[Finding], remains: bool) -> str:
    """The word for an answer; `remains`: whether an error of practical size is above the floor."""
    if findings:
        sure = max(findings, key=lambda f: f.excess_explained).confidence >= CONFIDENT
        return "missing-effect" if sure else "ambiguous"
    return "unexplained" if remains or any(not f.of_no_size for f in partial) else "adequate"


def above(
    search: Search, last: Evidence, there: FloatArray | None, named: list[Named]
) -> NDArray[np.bool_]:
    """Joints (d,) whose error is above the noise floor by more than leaves a model adequate."""
    problem, step = search.problem, search.now.step
    least, rms = alarming(problem) * problem.rms(problem.effort), step.result.rms
    floor = np.minimum(last.floor.rms, rms)
    out = (rms > ADEQUATE * floor) & (rms**2 - floor**2 > least**2)
    out &= ~of_noise(step, last, floor)
    if there is not None and not named:
        held = step.heldout.rms
        over = (held > NEAR_FLOOR * there) & (held**2 - there**2 > least**2)
        over &= ~of_noise(step, last, there, there=True)
        out |= over & ~within_errors(search.examine.alone, step, there, over)
    return np.asarray(out & ~problem.holds)
