"""Rivals: how alike two candidates are in these data, and how likely each of them is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from hil.compare.candidate import Candidate
from hil.compare.detect import LEVEL
from hil.identify.projector import Projector
from hil.identify.timing import LATE

FloatArray = NDArray[np.float64]
#: Share of chi2 by which functional forms are allowed to miss the truth (tempers confidence).
TEMPER = 0.01
#: ... where the rival has more coefficients.
RICHER = TEMPER / 8
#: Cosine between projected columns from which two effects look the same.
COINCIDE = 0.98
#: Logarithm of a weight below which nobody asks what contains the candidate.
LIKELY = -3.0
#: Share of a direction below which the base model hides it.
UNSEEN = 0.01
#: Only effects that the base absorbs by this share can be imitated from another joint.
MIRROR = 0.9
#: ... and only if on both joints they explain about as much.
SIMILAR = 0.5
#: Noise that comes back late through a controller, in units of what 1.1 floors leave.
ECHO = 2.0


def overlap(a: Candidate, b: Candidate, projector: Projector) -> float:
    """How well the poorer candidate is imitated by the richer one, after projection off the base.

    Smallest canonical correlation over the poorer one's directions: 1 means that whatever it
    does, the other can do too with these data.
    """
    qa, qb = _projected(a, projector), _projected(b, projector)
    if qa.shape[1] == 0 or qb.shape[1] == 0:
        return 0.0
    return float(np.linalg.svd(qa.T @ qb, compute_uv=False)[-1])


def _projected(c: Candidate, projector: Projector) -> FloatArray:
    rows = projector.rows(c.term)
    full = np.zeros((projector.residual.size, projector.weighted(c.term).shape[1]))
    full[rows] = projector.weighted(c.term)
    full -= projector.spanned(projector.inner(slice(0, len(full)), full))
    norm = np.linalg.norm(full, axis=0)
    u, s, _ = np.linalg.svd(full[:, norm > 1e-12] / norm[norm > 1e-12], full_matrices=False)
    return np.asarray(u[:, s > 1e-3], dtype=np.float64)


def twins(a: Candidate, b: Candidate, projector: Projector) -> bool:
    """Whether one effect's columns are the other's on such data, so that neither can be preferred.

    One on all joints is several on single joints; else they must explain as much, to a hundredth.
    """
    motion = projector.problem.motions[0]
    same = b.name in a.term.effect.twins(motion) or a.name in b.term.effect.twins(motion)
    if a.term.effect.jointless != b.term.effect.jointless:
        # a sensor has a coefficient for every channel; one of them may be a joint's effect
        same |= overlap(a, b, projector) > COINCIDE
    several = a.term.effect.whole_robot and not b.term.effect.whole_robot
    return same and (several or min(a.chi2, b.chi2) > 0.99 * max(a.chi2, b.chi2))


def weights(best: Candidate, rivals: list[Candidate], projector: Projector) -> dict[int, float]:
    """Probability of each of `best` and its rivals, by index (0 = best).

    exp(-delta / 2T) of the score difference, tempered by T = 1 + 1 % of the best chi2: real
    effects do not follow a library's equation exactly.  A richer rival (more coefficients) gets
    an eighth of that allowance if it explains less all the same, and none if it explains little
    more: then it merely contains the best one.  A rival whose columns coincide with the best
    one's to a cosine of 0.98 gets ten times the allowance: the data hardly see the difference.
    So does the simple effect of which the best one is the bent form, for no real part is straight.
    A twin, with the same columns by its equation, is as likely as the best one; a rival that
    contains another and cannot be put aside for its price is as likely as that one.
    """
    logs = [0.0]
    runs = projector.problem.runs
    for r in rivals:
        # what every run has anew is of one kind: it is no richer for that
        dof, copies = (_once(c, runs) for c in (r, best))
        spared = r.price * (1 - dof / r.dof) - best.price * (1 - copies / best.dof)
        delta = max(best.score - r.score - max(spared, 0.0), 0.0)
        if late(best, r):
            # a controller answers noise late: what lies below the floor does not count
            delta = max(delta - ECHO * best.spare, 0.0)
        if twins(best, r, projector):
            logs.append(0.0)
            continue
        share = TEMPER
        if dof > copies:
            share = RICHER if r.chi2 <= best.chi2 else 0.0
        elif late(best, r):
            share = TEMPER / 4  # their forms are those of real drives
        elif r.name == best.term.effect.limit or (
            dof == copies and overlap(best, r, projector) > COINCIDE
        ):
            share = 10 * TEMPER
        if mirrored(best, r):
            share = 1.0  # which of the two joints it is was decided by the base model's errors
        logs.append(-delta / (2 * (1.0 + share * best.chi2)))
    heads = [k for k, r in enumerate((best, *rivals)) if r.dof <= best.dof and logs[k] > LIKELY]
    for k, r in enumerate(rivals, start=1):
        logs[k] = max(
            logs[k],
            *(logs[h] for h in heads if begins((best, *rivals)[h], r, projector)), -np.inf,
        )  # fmt: skip
    p = np.exp(np.array(logs))
    return {k: float(x) for k, x in enumerate(p / p.sum())}


def _once(c: Candidate, runs: int) -> int:
    """Coefficients of a candidate in one run."""
    return max(c.dof // runs, 1) if c.term.per_run else c.dof


def begins(poorer: Candidate, richer: Candidate, projector: Projector) -> bool:
    """Whether the richer one contains the poorer one, and cannot be put aside for its price.

    Either its further coefficients explain more than chance, by the likelihood ratio of nested
    models, chi2_richer - chi2_poorer ~ chi2(dof_richer - dof_poorer) where the poorer one is the
    truth (Wilks, Ann. Math. Stat. 9, 1938, p. 60), tempered as a richer rival's score is; or what
    they do is absorbed by the base model, so that the data can neither see nor refute it: a
    spring against gravity is its offset alone.
    """
    more, dof = richer.chi2 - poorer.chi2, richer.dof - poorer.dof
    if dof <= 0 or poorer.term.joint != richer.term.joint or more < 0:
        return False
    unseen = seen(richer, projector) <= seen(poorer, projector)
    tempered = more / (1.0 + RICHER * poorer.chi2)
    if not unseen and chi2.sf(tempered, dof) > LEVEL:
        return False
    return overlap(poorer, richer, projector) > COINCIDE


def seen(c: Candidate, projector: Projector) -> int:
    """Directions of a candidate of which the base model leaves more than a hundredth."""
    columns = projector.weighted(c.term)
    norm = np.linalg.norm(columns, axis=0)
    unit, _ = np.linalg.qr(columns[:, norm > 0] / norm[norm > 0])
    known = projector.inner(projector.rows(c.term), unit)
    left = np.linalg.eigvalsh(np.eye(unit.shape[1]) - known.T @ known)
    return int(np.sum(left > UNSEEN))


def late(a: Candidate, b: Candidate) -> bool:
    """Whether two candidates are two forms of one lateness of a joint's effort."""
    return a.name in LATE and b.name in LATE and a.term.joint == b.term.joint


def mirrored(a: Candidate, b: Candidate) -> bool:
    """Whether two candidates are one effect on two joints, both nearly absorbed by the base.

    Of two torque gains, for example, only the ratio is determined: inertias absorb the rest.
    """
    same = a.name == b.name and a.term.joint != b.term.joint
    alike = min(a.chi2, b.chi2) > SIMILAR * max(a.chi2, b.chi2)
    return same and alike and min(a.absorbed, b.absorbed) > MIRROR
