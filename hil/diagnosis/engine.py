"""Which physical effect is missing: prepare, fit, search, name, judge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.compare.afterwards import finish
from hil.compare.columns import mistaken
from hil.compare.evidence import NOTHING
from hil.compare.findings import Diagnosis, Finding, joint_of
from hil.compare.heldout import Examiner
from hil.compare.identifiable import undetermined
from hil.compare.judge import _of_noise, _rival
from hil.compare.notes import notes
from hil.compare.settle import settled
from hil.diagnosis.constants import ADEQUATE, MATTERS
from hil.diagnosis.folds import split
from hil.diagnosis.search import Named, Search, exchange, shares
from hil.identify.context import renew
from hil.identify.problem import Problem
from hil.identify.threads import single_threaded
from hil.identify.timing import fit_aligned
from hil.models.model import BASE_EFFECTS, RobotModel
from hil.record.checks import check
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
CONFIDENT, ALONE, WORTHLESS = 0.75, 0.5, 0.05
HALF, WHOLE = 0.45, 0.80


@single_threaded
def diagnose(
    recordings: list[Recording], model: RobotModel, holdout: list[Recording] | None = None,
    seed: int = 0,
) -> Diagnosis:  # fmt: skip
    """Find the physical effects that a model lacks."""
    faults = [f for r in recordings for f in check(r)]
    errors = [(f.code, f.sentence) for f in faults if f.severity == "error"]
    if errors:
        return Diagnosis("bad-data", warnings=errors)
    problem = Problem(recordings, model.robot, model.explains, model.band)
    result = fit_aligned(problem, model)
    wrong = mistaken(result, recordings)
    if wrong:
        return Diagnosis("bad-data", warnings=wrong)
    examine = Examiner(problem, holdout or [])
    search = Search(problem, split(problem), examine, seed)
    more = {u.type for u in model.effects} - {*BASE_EFFECTS, "torque-offset"}
    first = settled(result, examine, "given model" if more else "base model")
    search.rungs.append(search.judged(first.label, first.result))
    reasons = undetermined(first.result)
    if reasons:
        evidence, _ = search.evidence([])
        return Diagnosis(
            "not-identifiable", [], [first], evidence, evidence, evidence.floor.rms, reasons
        )
    search.forward()
    named = exchange(search)
    renew(search.now.result)
    last = search.last
    if search.found:
        last, _ = search.evidence([])
        last, _ = search.evidence([j for j in range(problem.d) if not problem.holds[j]])
    return judged(search, named, last or NOTHING, examine, model, recordings, faults)


def judged(search, named, last, examine, model, recordings, faults) -> Diagnosis:
    """Verdict."""
    problem, ladder = search.problem, [r.step for r in search.rungs]
    first = search.first
    floor = np.minimum(last.floor.rms, ladder[-1].result.rms)
    heldout_floor = examine.floor(ladder[-1].result, last)
    renew(ladder[-1].result)
    other = None if heldout_floor is None else np.minimum(heldout_floor, ladder[-1].heldout.rms)
    share = shares(search) if named else {}
    all_findings = [finding(n, search, floor, other, share) for n in named]
    partial = [f for f in all_findings if f.confidence < (WORTHLESS if f.rivals else ALONE)]
    findings = [f for f in all_findings if f not in partial]
    size = problem.rms(problem.effort)
    end = ladder[-1].result.rms
    excess = np.sqrt(np.maximum(end**2 - floor**2, 0.0))
    above = ~problem.holds & (end > ADEQUATE * floor) & (excess > MATTERS * size)
    above &= ~_of_noise(ladder[-1], last, floor)
    if other is not None and not named:
        above |= ~problem.holds & (ladder[-1].heldout.rms > 1.25 * heldout_floor) & (np.sqrt(np.maximum(ladder[-1].heldout.rms**2 - heldout_floor**2, 0.0)) > MATTERS * size)
    if findings:
        sure = max(findings, key=lambda f: f.excess_explained).confidence >= CONFIDENT
        verdict = "missing-effect" if sure else "ambiguous"
    else:
        verdict = "unexplained" if np.any(above) or partial else "adequate"
    out = Diagnosis(verdict, findings, ladder, first, last, floor, notes(ladder[-1].result, last), partial)
    out.heldout_floor, out.stops, out.fired = other, search.stops, search.fired
    return finish(out, examine, model, recordings, faults)


def finding(n: Named, search: Search, floor, other, share) -> Finding:
    problem, c, j = search.problem, n.candidate, n.candidate.joint
    rungs = search.rungs
    ladder = [r.step for r in rungs]
    k = next((i for i, r in enumerate(rungs) if any(a.term.key == c.term.key for a in r.added)), len(rungs) - 1)
    before, after = ladder[max(k - 1, 0)], ladder[k]
    values = ladder[-1].result.values
    start, end = search.rungs[0], search.now
    base = min(float(floor[j]), float(end.result.rms[j])) ** 2
    whole = (start.result.rms[j] ** 2 - end.result.rms[j] ** 2) / max(start.result.rms[j] ** 2 - base, 1e-300)
    least_share = min(share.get(j, (1.0, ""))[0], float(whole))
    worth = np.clip((least_share - HALF) / (WHOLE - HALF), 0.0, 1.0)
    head = (f"j{c.term.joint + 1}.{c.name}.", f"{c.name}.")
    one = [(s.result if other is None else s.heldout).rms[j] ** 2 for s in (before, after, ladder[0])]
    least = float((floor if other is None else other)[j]) ** 2
    explained = float((one[0] - one[1]) / max(one[2] - least, 1e-300))
    return Finding(
        c.name, joint_of(c, problem), round(float(n.confidence * worth), 3),
        float(before.heldout.relative[j]), float(after.heldout.relative[j]),
        float(after.heldout.standard_error()[j]), float(np.clip(explained, 0.0, 1.0)),
        {k2: v for k2, v in values.items() if k2.startswith(head)},
        list(dict.fromkeys(_rival(r, c, problem) for r in n.rivals)),
    )
