"""The verdict: which findings stand, and what remains to be said."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.compare import blur
from hil.compare.ambiguity import CONFIDENT
from hil.compare.denoise import returned, smoothed
from hil.compare.evidence import Candidate, Evidence
from hil.compare.findings import Accepted, Diagnosis, Finding, Step, describe, joint_of
from hil.compare.floor import ADEQUATE
from hil.compare.notes import emptied, notes, noticed
from hil.compare.overruled import overruled
from hil.compare.overtones import overtones
from hil.compare.significance import by_chance
from hil.identify.problem import Problem

FloatArray = NDArray[np.float64]
#: Below this share of the excess explained, no name is given.
EXPLAINED = 0.70
#: Confidence below which a name among rivals is no name, and one that stands alone.
WORTHLESS, ALONE = 0.05, 0.5
#: Shares of a joint's excess that all its names explain: worth nothing, and worth all.
HALF, WHOLE = 0.45, 0.80
#: Factor of an error by which it falls by nothing.
IDLE = 0.998
#: Standard errors that a share on held-out runs may lack.
CHANCE = 2.0
#: Factor over their own floor from which held-out runs refute a model that nothing was added to:
#: their floor and their error are each known to a factor of ADEQUATE, and there is chance.
FAR = 1.25


def judge(
    ladder: list[Step], found: list[Accepted],
    first: Evidence, last: Evidence, heldout_floor: FloatArray | None = None,
) -> Diagnosis:  # fmt: skip
    """Findings that stand, and the verdict over all joints.

    Where other runs were held out, names must explain the excess there, too: what is fitted to
    a run's own chances does not come again.

    Parameters
    ----------
    ladder : list of Step
        Rungs, the base model first.
    found : list of Accepted
        Accepted candidates with confidence and rivals.
    first, last : Evidence
        Beside the base model and beside the last rung.
    heldout_floor : ndarray (d,), optional
        Noise floor of the held-out runs, where there are any.
    """
    problem = ladder[0].result.problem
    floor = np.minimum(last.floor.rms, ladder[-1].result.rms)
    other = None if heldout_floor is None else np.minimum(heldout_floor, ladder[-1].heldout.rms)
    empty = [
        c for c, _, _ in found
        if by_chance(ladder[-1].result, c.term.key) or _idle(c, ladder)
    ]  # fmt: skip
    findings = _findings(ladder, [f for f in found if f[0] not in empty], floor, other)
    open_joints = _open(ladder, found, findings, first, last, floor, heldout_floor)
    against = overruled(ladder, findings, last.floor.rms)
    failed = {problem.joints[j] for j in open_joints} | against.joints
    partial = [
        f for f in findings
        if _worthless(f) or f.joint in failed or (f.joint is None and failed)
    ]  # fmt: skip
    findings = [f for f in findings if f not in partial]
    if findings:
        # the largest effect decides; what is unsure beside it is listed with its rivals
        sure = max(findings, key=lambda f: f.excess_explained).confidence >= CONFIDENT
        verdict = "missing-effect" if sure else "ambiguous"
    else:
        verdict = "unexplained" if failed else "adequate"
        partial = partial if failed else []
    out = Diagnosis(
        verdict, findings, ladder, first, last, floor, notes(ladder[-1].result, last), partial
    )
    out.heldout_floor = other
    out.network, out.multi_steps = against.shares, against.simulated
    out.warnings += against.warnings
    out.warnings += [("emptied", emptied(c, problem)) for c in empty]
    out.warnings += overtones(found, last, ladder[-1].result)
    return _with_changes(out)


def _idle(c: Candidate, ladder: list[Step]) -> bool:
    """Whether a rung lowers neither error of its joint: names found later have changed the way."""
    k = next(k for k, s in enumerate(ladder) if s.label == _label(c, ladder[0].result.problem))
    pairs = [(s.result.rms[c.joint], s.heldout.rms[c.joint]) for s in ladder[k - 1 : k + 1]]
    return all(after > IDLE * before for before, after in zip(*pairs, strict=True))


def _label(c: Candidate, problem: Problem) -> str:
    """Label of the rung that a candidate has."""
    return f"+ {describe(c, problem)}"


def _with_changes(out: Diagnosis) -> Diagnosis:
    """The diagnosis with what changed at once; what is adequate but for that is not."""
    out.warnings += noticed(out.last, out.ladder[-1].result)
    if out.last.changes and out.verdict == "adequate":
        out.verdict = "unexplained"
    return out


def _open(
    ladder: list[Step], found: list[Accepted], findings: list[Finding], first: Evidence,
    last: Evidence, floor: FloatArray, heldout_floor: FloatArray | None,
) -> list[int]:  # fmt: skip
    """Joints whose names do not account for what stands above the floor, here or held out."""
    problem = ladder[0].result.problem
    start, end = ladder[0].result.rms, ladder[-1].result.rms
    excess, left = start**2 - floor**2, np.maximum(end**2 - floor**2, 0.0)
    here = ~problem.holds & (end > ADEQUATE * floor) & (left > (1 - EXPLAINED) * excess)
    here &= ~_of_noise(ladder[-1], last, floor)
    if not found and heldout_floor is not None:
        here |= refuted(ladder[-1], heldout_floor)
    named = {c.joint for c, _, _ in found}
    noise = _of_noise(ladder[0], first, floor)
    noisy = noise & (start <= FAR * floor)
    # what the ladder takes and no name stands for is not explained
    unnamed = (start > FAR * floor) & ~noise & bool(found and not findings)
    worthless = {f.joint for f in findings if _worthless(f)}
    return [
        j for j, joint in enumerate(problem.joints)
        if here[j] or unnamed[j]
        or (j in named and not noisy[j] and _there(ladder, found, heldout_floor, j) < EXPLAINED)
        or (joint in worthless and start[j] > ADEQUATE * floor[j] and not noisy[j])
    ]  # fmt: skip


def _of_noise(step: Step, evidence: Evidence, floor: FloatArray) -> NDArray[np.bool_]:
    """Joints (d,) of which what stands above the floor comes of how the positions are measured.

    Their noise smoothed in the model's load or, where that is little, returned late by the
    controller; or reversals that their filter blurs.
    """
    end, result = step.result.rms, step.result
    most = EXPLAINED * (end**2 - floor**2)
    late = (end <= FAR * floor) & (returned(evidence, result) >= most)
    excused = (smoothed(evidence, result) >= most) | (blur.parts(evidence, result) >= most) | late
    return np.asarray((most > 0.0) & excused)


def refuted(step: Step, floor: FloatArray) -> NDArray[np.bool_]:
    """Joints (d,) where held-out runs are far above their own floor; none without such runs.

    Of motor efforts only: a force sensor's accuracy, which its floor counts, is not known to that.
    """
    told = step.heldout.kind == "holdout" and step.result.model.explains == "motor"
    moves = ~step.result.problem.holds & told
    return np.asarray(moves & (step.heldout.rms > FAR * floor))


def only_there(step: Step, last: Evidence, floor: FloatArray) -> bool:
    """Whether the fitted runs are down to their floor, and held-out ones far above theirs.

    Something acts where the fitted motion does not go, or the rig has changed.
    """
    return last.floor.met(step.result.rms) and bool(np.any(refuted(step, floor)))


def _worthless(f: Finding) -> bool:
    """Whether a name is none: without a rival, one that is sooner wrong than right."""
    return f.confidence < (WORTHLESS if f.rivals else ALONE)


def _there(
    ladder: list[Step], found: list[Accepted], floor: FloatArray | None, j: int
) -> float:  # fmt: skip
    """Share of joint j's excess on the held-out runs that is gone, at most; 1 without any.

    A floor is known to a factor of ADEQUATE: what is left within that is nothing, and the excess
    counts from there.
    What is dated cannot be confirmed there, so that it is not asked either.
    """
    last = ladder[-1].heldout
    if floor is None or last.rms[j] <= ADEQUATE * floor[j]:
        return 1.0
    if any(_dated(c) for c, _, _ in found):
        return 1.0
    share, se = last.share(ladder[0].heldout, ADEQUATE * float(floor[j]), j)
    return share + CHANCE * se


def _dated(c: Candidate) -> bool:
    return c.term.effect.dated(c.term.shape)


def _findings(
    ladder: list[Step], found: list[Accepted], floor: FloatArray, other: FloatArray | None
) -> list[Finding]:
    """All that was accepted; shares on the held-out runs with their floor `other`, if any."""
    problem = ladder[0].result.problem
    values = ladder[-1].result.values
    rungs = {s.label: k for k, s in enumerate(ladder)}
    out = []
    first, final = ladder[0].result.rms ** 2, ladder[-1].result.rms ** 2
    total = (first - final) / np.maximum(first - floor**2, 1e-300)
    for c, confidence, rivals in found:
        k, j = rungs[_label(c, problem)], c.joint
        before, after = ladder[k - 1], ladder[k]
        confidence *= _whole(min(float(total[j]), _there(ladder, found, other, j)))
        share = _share(ladder, k, j, floor, None if _dated(c) else other)
        head = (f"j{c.term.joint + 1}.{c.name}.", f"{c.name}.")
        out.append(
            Finding(
                c.name, joint_of(c, problem), round(confidence, 3),
                float(before.heldout.relative[j]), float(after.heldout.relative[j]),
                float(after.heldout.standard_error()[j]), float(np.clip(share, 0.0, 1.0)),
                {n: v for n, v in values.items() if n.startswith(head)},
                list(dict.fromkeys(_rival(r, c, problem) for r in rivals)),
            )
        )  # fmt: skip
    return out


def _share(
    ladder: list[Step], k: int, j: int, floor: FloatArray, other: FloatArray | None
) -> float:
    """Share of joint j's excess that rung k took; on the held-out runs with their floor."""
    one = [(s.result if other is None else s.heldout).rms[j] ** 2 for s in ladder]
    least = float((floor if other is None else other)[j]) ** 2
    return float((one[k - 1] - one[k]) / max(one[0] - least, 1e-300))


def _whole(share: float) -> float:
    """What a joint's names are worth if together they explain this share of its excess.

    A true name leaves little over; one that leaves a third is often another effect's shadow.
    1 from WHOLE on, 0 at HALF: in `hil bench diagnosis` right and wrong names part between 0.71
    and 0.78.
    """
    return float(np.clip((share - HALF) / (WHOLE - HALF), 0.0, 1.0))


def _rival(r: Candidate, c: Candidate, problem: Problem) -> str:
    """Name of a rival, with its joint where that is what is in doubt."""
    return describe(r, problem) if r.name == c.name else r.name
