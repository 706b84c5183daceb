"""Which physical effect is missing: detect, attribute, add, refit, retest, and judge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.compare.afterwards import finish
from hil.compare.attribute import choose, kindred, plausible, possible, simplest_first
from hil.compare.candidate import Candidate
from hil.compare.columns import mistaken
from hil.compare.complement import other_gains
from hil.compare.credible import credible
from hil.compare.evidence import Evidence, gather, in_time
from hil.compare.findings import Accepted, Diagnosis, Step, describe
from hil.compare.floor import SENSOR_ACCURACY
from hil.compare.heldout import Examiner
from hil.compare.identifiable import undetermined
from hil.compare.judge import EXPLAINED, judge
from hil.compare.overtones import harmonic
from hil.compare.retest import REFUTED, as_use, drop_superfluous, look_again, refitted
from hil.compare.settle import settled
from hil.identify.context import renew
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.identify.threads import single_threaded
from hil.identify.timing import fit_aligned
from hil.models.model import BASE_EFFECTS, RobotModel
from hil.record.checks import check
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
#: An effect must lower the held-out error of its joint by this much ...
WORTH = 0.04
#: ... and remove this share of what is still above the floor.
SHARE = 0.10
#: ... and, after a first effect on the joint, this share of all that was above the floor:
#: library equations miss real effects by about a percent of their power, which is no new effect.
FORM = 0.0125
#: Share of all, held out, below which an effect is small.
SMALL = 0.05
MOST = 4
#: Factor by which a change at one instant must explain more than a candidate to put it aside.
MORE = 1.1
#: Paired standard errors by which a held-out error must fall: one-sided, 7 % by chance, beside
#: detection at 1 % of the whole family.
BEYOND = 1.5


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

    Returns
    -------
    Diagnosis
        Without a model (an empty ladder) where a run has a fault: verdict ``"bad-data"``.

    Raises
    ------
    DataError
        If no run is given, runs are of different robots, or a held-out run has a fault, is of
        another robot, or is one of the fitted ones.
    """
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
    more = {u.type for u in model.effects} - {*BASE_EFFECTS, "torque-offset"}
    ladder = [settled(result, examine, "given model" if more else "base model")]
    evidence = first = gather(ladder[0].result, seed)
    reasons = undetermined(ladder[0].result)
    if reasons:
        return Diagnosis("not-identifiable", [], ladder, first, first, first.floor.rms, reasons)
    found: list[Accepted] = []
    for _ in range(most):
        step = _next(evidence, ladder, examine, problem, found)
        if step is None:
            break
        ladder.append(step)
        evidence = gather(step.result, seed)
        drop_superfluous(found, ladder, examine)
    renamed = look_again(found, ladder, evidence.floor, examine)
    changed = other_gains(found, first.candidates, ladder, examine) or renamed
    renew(ladder[-1].result)
    if changed:
        evidence = gather(ladder[-1].result, seed)
    out = judge(ladder, found, first, evidence, examine.floor(ladder[-1].result, evidence))
    return finish(out, examine, model, recordings, faults)


def _next(
    evidence: Evidence, ladder: list[Step], examine: Examiner, problem: Problem,
    found: list[Accepted],
) -> Step | None:  # fmt: skip
    """Try the plausible candidates in order; accept the first that also helps held-out."""
    now, projector = ladder[-1], evidence.projector
    if projector is None:
        return None
    pool = [c for c in possible(evidence, now.result) if in_time(c, now.result)]
    failed: list[tuple[Candidate, Step]] = []
    for c in _eligible(evidence, now.result, pool, found)[:3]:
        model = now.result.model + as_use(c, problem)
        step = refitted(f"+ {describe(c, problem)}", model, examine, now)
        pays = _worth(step, now, ladder[0], c, evidence.floor.rms)
        if pays and credible(step, now, c, evidence.floor.rms):
            floor = float(evidence.floor.rms[c.joint])
            worse = [x for x, other in failed if _worse(other, step, now, c.joint, floor)]
            rest = [x for x in pool if x is not c and x not in worse]
            found.append((c, *choose([c, *rest], projector)[1:]))
            return step
        failed.append((c, step))
    return None


def _eligible(
    evidence: Evidence, now: FitResult, pool: list[Candidate], found: list[Accepted]
) -> list[Candidate]:
    """Plausible candidates of a pool that stand for themselves, simplest first."""
    candidates = simplest_first([c for c in plausible(evidence, now) if c in pool])
    # many coefficients on many joints find something in any floor
    candidates = [
        c
        for c in candidates
        if evidence.floor.exceeded(now.rms, c.joint) or not (found or c.term.effect.jointless)
    ]
    candidates = [c for c in candidates if not _sudden(c, evidence, now)]
    motion = now.problem.motions[0]
    if found and evidence.projector is not None:
        made = evidence.projector
        candidates = [c for c in candidates if not harmonic(c, found, motion, made)]
        late = [c for c in possible(evidence, now) if c not in pool]
        candidates = [c for c in candidates if not any(_imitates(c, x) for x in late)]
        candidates = [c for c in candidates if not any(kindred(c, f) for f, _, _ in found)]
    return candidates


def _sudden(c: Candidate, evidence: Evidence, result: FitResult) -> bool:
    """Whether a value that changes at once explains more of a candidate's joint than it does."""
    joint = result.problem.joints[c.joint]
    return any(x.joint == joint and x.fall > MORE * c.parts[c.joint] for x in evidence.changes)


def _imitates(c: Candidate, other: Candidate) -> bool:
    """Whether one that explains more, and is no finding, stands on the same joint."""
    return other.joint == c.joint and other.parts[c.joint] > MORE * c.parts[c.joint]


def _worse(failed: Step, step: Step, now: Step, j: int, floor: float) -> bool:
    """Whether the held-out data refute a candidate that did not help.

    Beyond chance, and by a share of the excess that matters: two forms of one cause differ by less,
    and every time in the same direction.
    """
    other, own, before = (s.heldout.rms[j] ** 2 for s in (failed, step, now))
    matters = other - own > SHARE * (before - floor**2)
    return bool(matters and step.heldout.gain(failed.heldout, j) > REFUTED)


def _worth(step: Step, now: Step, first: Step, c: Candidate, floor: FloatArray) -> bool:
    """Whether a step pays: in held-out error beyond chance, and in the excess over the floor.

    What other runs cannot confirm must pay where it was seen, and not be refuted by the others.
    """
    j = c.joint
    before, after = now.result.rms[j] ** 2, step.result.rms[j] ** 2
    excess = max(before - float(floor[j]) ** 2, 1e-300)
    whole = max(first.result.rms[j] ** 2 - float(floor[j]) ** 2, 1e-300)
    share = min((before - after) / excess, SHARE / FORM * (before - after) / whole)
    gain = step.heldout.gain(now.heldout, j)
    if c.term.effect.dated(c.term.shape):
        return bool(after < (1 - WORTH) ** 2 * before and share > SHARE and gain > -REFUTED)
    better = step.heldout.rms[j] < (1 - WORTH) * now.heldout.rms[j]
    if step.result.model.explains == "external":
        # half the force sensor's accuracy, in percent of the effort
        better &= step.heldout.relative[j] < now.heldout.relative[j] - 50 * SENSOR_ACCURACY
    return bool(better and share > SHARE and _sure(step, now, first, j, float(floor[j])))


def _sure(step: Step, now: Step, first: Step, j: int, floor: float) -> bool:
    """Whether the fall of the held-out error is beyond chance.

    An effect that acts in a few stretches only (a stop, a play) spreads its own gains, which is
    not chance: one that takes EXPLAINED of the excess passes with one standard error.  One that
    is SMALL beside a first effect must be sure and take EXPLAINED: else it is a part of what the
    first one's form misses.
    """
    gain = step.heldout.gain(now.heldout, j)
    whole, before, after = (s.heldout.rms[j] ** 2 - floor**2 for s in (first, now, step))
    most = after < (1 - EXPLAINED) * before
    if before - after < SMALL * whole:
        return bool(most and gain > BEYOND)
    return bool(gain > (1.0 if most else BEYOND))
