"""Attribution: of the candidates that explain the residual, which is it, and how sure."""

from __future__ import annotations

import numpy as np

from hil.compare.candidate import Candidate
from hil.compare.detect import LEVEL
from hil.compare.evidence import Evidence
from hil.compare.rivals import ECHO, late, mirrored, weights
from hil.identify.projector import Projector, within
from hil.identify.result import FitResult
from hil.identify.timing import LATE
from hil.models.motion import Motion

#: An effect must account for at least this share of the noise variance to matter.
MATERIAL = 0.10
#: Share of the excess that a line over time must account for by itself.
ALONE = 0.8
#: ... or this share, if without the line the joint is within so much of its floor: a floor that is
#: a twentieth too low is a third of an excess of half a floor.
MAJOR, MET = 0.6, 1.06
#: Forms of one physical cause as the motor sees it: beside one of them another is no news.
KINDRED = (
    {"elastic-transmission", "hardening-cable", "vibration-mode"},
    {"hardening-cable", "backlash"},
    set(LATE),
    {"torque-offset", "asymmetric-coulomb"},
)


def variance_share(c: Candidate, evidence: Evidence, result: FitResult) -> float:
    """Variance that the candidate removes on its joint, in units of the noise floor's."""
    j = c.joint
    removed = c.parts[j] * result.sigma[j] ** 2 / result.problem.count[j]
    return float(removed / max(evidence.floor.rms[j] ** 2, 1e-300))


def physical(c: Candidate, motion: Motion) -> bool:
    """Whether the coefficients can be: a negative Stribeck peak cannot, nor an unseen bias."""
    term = c.term
    if not term.effect.credible(motion, term.joint, term.shape, c.coefficients, c.errors):
        return False
    params = c.term.effect.params
    if len(params) != 1 and not c.term.effect.strict:
        return True
    return within(c.term.effect, np.array(c.coefficients))


def alone(c: Candidate, evidence: Evidence, result: FitResult) -> bool:
    """Whether a line over time is most of what stands above the floor on its joint now.

    Any missing effect leaves lines at sums of the motion's frequencies: one among many is its
    shadow, and only a line that stands by itself is a disturbance.
    """
    if not c.term.effect.spectral:
        return True
    j = c.term.joint
    noise = min(evidence.floor.rms[j], evidence.floor.scale[j])
    excess = float(result.rms[j] ** 2 - noise**2)
    removed = c.parts[j] * result.sigma[j] ** 2 / result.problem.count[j]
    # of a small excess the floor's own error is a good part
    rest = float(result.rms[j] ** 2) - removed
    at_floor = rest < (MET * evidence.floor.rms[j]) ** 2 and removed > MAJOR * excess
    return bool(removed > ALONE * excess or at_floor)


def possible(evidence: Evidence, result: FitResult) -> list[Candidate]:
    """Candidates that are detected and pay their price, so that they may be a rival; best first."""
    return [
        c
        for c in evidence.candidates
        if c.p_value <= LEVEL
        and physical(c, result.problem.motions[0])
        and c.score > 0
        and not c.smoother
        and not c.blurred
        and c.absorbed < 0.9999
        and alone(c, evidence, result)
    ]


def plausible(evidence: Evidence, result: FitResult) -> list[Candidate]:
    """Those of them that matter, so that they may be named."""
    return [
        c for c in possible(evidence, result) if variance_share(c, evidence, result) >= MATERIAL
    ]


def kindred(a: Candidate, b: Candidate) -> bool:
    """Whether two candidates are forms of one cause on one joint."""
    return a.term.joint == b.term.joint and any({a.name, b.name} <= k for k in KINDRED)


def simplest_first(candidates: list[Candidate]) -> list[Candidate]:
    """The same, a delay before the lag that explains no more than noise would make of it."""
    out = list(candidates)
    for k, c in enumerate(out):
        for other in out[k + 1 :]:
            close = late(c, other) and c.score - other.score < ECHO * c.spare
            if close and other.name == LATE[0]:
                out.remove(other)
                out.insert(k, other)
                return out
    return out


def choose(
    candidates: list[Candidate], projector: Projector
) -> tuple[Candidate, float, list[Candidate]]:
    """Best candidate, its confidence, and the rivals that keep at least 5 % each.

    Rivals on another joint compete for the same residual only through the shared rigid-body
    parameters; they are retested after the best one is in, so only rivals on the same joint
    (or of the whole robot) count here, and the same effect elsewhere where the shared parameters
    make the two one (of two torque gains only the ratio is determined).
    """
    best = candidates[0]
    anywhere = best.term.effect.whole_robot
    same = [
        c
        for c in candidates[1:]
        if anywhere or c.term.joint == best.term.joint or c.term.effect.whole_robot
        or mirrored(best, c)
    ]  # fmt: skip
    p = weights(best, same[:12], projector)
    rivals = [c for k, c in enumerate(same[:12], start=1) if p[k] >= 0.05]
    return best, p[0], rivals
