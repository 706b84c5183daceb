"""Attribution: of the candidates that explain the residual, which is it, and how sure.

An effect's coefficients must differ from zero beyond chance, all of them together.  With
coefficients b (m,) and their covariance V from the scatter over G blocks of time,

    T^2 = b' V^-1 b,    T^2 (G - m) / (m (G - 1)) ~ F(m, G - m)

where all of them are zero.  Detection asks how much of the residual a candidate explains; a wave
that is there in a few blocks and not in the others explains much, and is no law.

Source: Hotelling, Ann. Math. Stat. 2, 1931; Liang and Zeger, Biometrika 73, 1986 (covariance).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from hil.diagnosis.constants import (
    ABSORBED,
    ALLOWANCE,
    DISCREPANCY,
    FEW,
    HALF,
    LEVEL,
    LITTLE,
    RIVAL,
    SAME_COSINE,
    TENTH,
    WHOLE,
    WHOLE_ORDER,
)
from hil.diagnosis.types import Candidate, Evidence
from hil.identify.design import Term, coefficients, head
from hil.identify.problem import Problem
from hil.identify.projector import Projector, within
from hil.identify.regression import cluster_covariance, decomposed, time_blocks
from hil.identify.result import FitResult
from hil.identify.solve import ERRORS, colouring, described
from hil.models.effect import (
    BOUNDS,
    Fitted,
    Lines,
    Trait,
    Waves,
    are_twins,
    broken,
    strict,
)
from hil.models.model import Use, Value
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]


# ------------------------------------------------------------ rivals


def overlap(a: Candidate, b: Candidate, projector: Projector) -> float:
    """How well the poorer candidate is imitated by the richer one, after projection off the base.

    Smallest canonical correlation over the poorer one's directions: 1 means that whatever it
    does, the other can do too with these data.
    """
    qa, qb = _projected(a, projector), _projected(b, projector)
    if qa.shape[1] == 0 or qb.shape[1] == 0:
        return 0.0
    return float(decomposed(qa.T @ qb)[1][-1])


def _projected(c: Candidate, projector: Projector) -> FloatArray:
    rows = projector.rows(c.term)
    full = np.zeros((projector.residual.size, projector.weighted(c.term).shape[1]))
    full[rows] = projector.weighted(c.term)
    size = np.linalg.norm(full, axis=0)
    full -= projector.spanned(projector.inner(slice(0, len(full)), full))
    norm = np.linalg.norm(full, axis=0)
    # a column that the base holds leaves rounding, which is no direction of the candidate
    new = norm > 1e-3 * size
    u, s, _ = decomposed(full[:, new] / norm[new])
    return np.asarray(u[:, s > 1e-3], dtype=np.float64)


def twins(a: Candidate, b: Candidate, projector: Projector) -> bool:
    """Whether one effect's columns are the other's on such data, so that neither can be preferred.

    One on all joints is several on single joints; else they must explain as much, to a hundredth.
    """
    motion = projector.problem.motions[0]
    same = are_twins(a.term.effect, b.term.effect, motion)
    if a.term.effect.scope.tip != b.term.effect.scope.tip:
        # a sensor has a coefficient for every channel; one of them may be a joint's effect
        same |= overlap(a, b, projector) > SAME_COSINE
    several = a.term.effect.scope.whole and not b.term.effect.scope.whole
    return same and (several or min(a.chi2, b.chi2) > (1 - DISCREPANCY) * max(a.chi2, b.chi2))


def ripples(t: Term, problem: Problem) -> bool:
    """Whether an effect is a wave over the position that turns round `FEW` times at least."""
    if not isinstance(t.effect.search, Waves):
        return False
    low, high = problem.span[t.joint]
    return bool(2 * t.shape[0] * (high - low) >= FEW)


def pliable(t: Term, problem: Problem) -> bool:
    """Whether an effect follows any smooth law of its variable: a series, or a wave of few turns.

    The values of a series are no law, so that it is no evidence that they fit by little better.
    """
    few = isinstance(t.effect.search, Waves) and not ripples(t, problem)
    return few or Trait.SERIES in t.effect.traits


def weights(best: Candidate, rivals: list[Candidate], projector: Projector) -> dict[int, float]:
    """Probability of each of `best` and its rivals, by index (0 = best).

    exp(-delta / 2T) of the score difference, tempered by T = 1 + DISCREPANCY of the best chi2:
    real effects do not follow a library's equation exactly.  No law misses more than it leaves
    above the noise floor, which bounds the allowance of rivals that are no simpler.  A richer
    rival (more values) gets an eighth of that allowance if it explains less all the same, and none
    if it explains little more: then it merely contains the best one.  A rival whose columns
    coincide with the best one's to a cosine of 0.98 gets eight times the allowance: the data hardly
    see the difference.  Beside a best one that follows any smooth law every rival has the whole
    allowance.  So does the simple effect of which the best one is the bent form, for no
    real part is straight.  A twin, with the same columns by its equation, is as likely as the best
    one; a rival that contains another and cannot be put aside for its price is as likely as that
    one.
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
            delta = max(delta - best.spare, 0.0)
        if twins(best, r, projector):
            logs.append(0.0)
            continue
        share, most = DISCREPANCY, best.missed if dof >= copies else np.inf
        if dof > copies:
            share = DISCREPANCY / ALLOWANCE if r.chi2 <= best.chi2 else 0.0
        elif late(best, r):
            share = DISCREPANCY / ALLOWANCE  # their forms are those of real drives
        elif r.name == best.term.effect.relations.limit or (
            dof == copies and overlap(best, r, projector) > SAME_COSINE
        ):
            share = ALLOWANCE * DISCREPANCY
        if pliable(best.term, projector.problem):
            share, most = DISCREPANCY, np.inf
        if mirrored(best, r, projector):
            # which of the two joints it is was decided by the base model's errors
            share, most = 1.0, np.inf
        logs.append(-delta / (2 * (1.0 + min(share * best.chi2, most))))
    heads = [
        k for k, r in enumerate((best, *rivals)) if r.dof <= best.dof and logs[k] > np.log(RIVAL)
    ]
    for k, r in enumerate(rivals, start=1):
        logs[k] = max(
            logs[k],
            *(logs[h] for h in heads if begins((best, *rivals)[h], r, projector)),
            -np.inf,
        )
    p = np.exp(np.array(logs))
    return {k: float(x) for k, x in enumerate(p / p.sum())}


def _once(c: Candidate, runs: int) -> int:
    """Coefficients of a candidate in one run; differences to the first run are one set less."""
    sets = max(runs - int(c.term.effect.variation.relative), 1)
    return max(c.dof // sets, 1) if c.term.per_run else c.dof


def likelier(one: Candidate, other: Candidate) -> float:
    """Probability of one of two explanations of which each is several values, by these weights.

    They share no columns that could be compared, so that neither is a form of the other.
    """
    best, r = (one, other) if one.score >= other.score else (other, one)
    share, most = DISCREPANCY, np.inf
    if r.dof > best.dof:
        share = DISCREPANCY / ALLOWANCE if r.chi2 <= best.chi2 else 0.0
    if r.dof >= best.dof:
        most = best.missed
    odds = (best.score - r.score) / (2 * (1.0 + min(share * best.chi2, most)))
    less = float(np.exp(-min(odds, 700.0)))
    return 1.0 / (1.0 + less) if best is one else less / (1.0 + less)


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
    tempered = more / (1.0 + DISCREPANCY / ALLOWANCE * poorer.chi2)
    if not unseen and chdtrc(dof, tempered) > LEVEL:
        return False
    return overlap(poorer, richer, projector) > SAME_COSINE


def seen(c: Candidate, projector: Projector) -> int:
    """Directions of a candidate of which the base model leaves more than a hundredth."""
    columns = projector.weighted(c.term)
    norm = np.linalg.norm(columns, axis=0)
    unit, _ = np.linalg.qr(columns[:, norm > 0] / norm[norm > 0])
    known = projector.inner(projector.rows(c.term), unit)
    left = np.linalg.eigvalsh(np.eye(unit.shape[1]) - known.T @ known)
    return int(np.sum(left > LITTLE))


def late(a: Candidate, b: Candidate) -> bool:
    """Whether two candidates are two forms of one lateness of a joint's effort."""
    both = a.term.effect.traits & b.term.effect.traits
    return Trait.LATE in both and a.term.joint == b.term.joint


def mirrored(a: Candidate, b: Candidate, projector: Projector) -> bool:
    """Whether two candidates are one effect on two joints that the base model makes look alike.

    Of two torque gains, for example, only the ratio is determined: inertias absorb the rest, and
    what is left of one is on the other joint, too.  Friction of two joints shares no parameters.
    """
    same = a.name == b.name and a.term.joint != b.term.joint
    near = same and min(a.chi2, b.chi2) > HALF * max(a.chi2, b.chi2)
    return near and overlap(a, b, projector) > HALF


# ------------------------------------------------------------ choice


def variance_share(c: Candidate, evidence: Evidence, result: FitResult) -> float:
    """Variance that the candidate removes on its joint, in units of the noise floor's."""
    j = c.joint
    removed = c.parts[j] * result.sigma[j] ** 2 / result.problem.count[j]
    return float(removed / max(evidence.floor.rms[j] ** 2, 1e-300))


def where_acts(problem: Problem, term: Term, beta: Sequence[float]) -> Motion:
    """The run in which a term acts most: a stop that one run does not reach is judged in another.

    The first one where every run has values of its own.
    """
    motions = problem.motions
    if len(motions) == 1 or term.per_run or not beta:
        return motions[0]
    raw = problem.raw(term.effect, term.joint, term.shape)
    each = [x.reshape(-1, x.shape[-1]) for x in raw]
    if any(x.shape[1] != len(beta) for x in each):
        return motions[0]
    return motions[int(np.argmax([float(np.sum((x @ np.array(beta)) ** 2)) for x in each]))]


def physical(c: Candidate, problem: Problem) -> bool:
    """Whether the coefficients can be: a negative Stribeck peak cannot, nor an unseen bias."""
    return not why_not(c, problem)


def may_be(c: Candidate, problem: Problem) -> bool:
    """Whether the coefficients are physical, but for being too small to be told by these data."""
    values = _fitted(c, problem)
    broken_ones = [limit for limit in c.term.effect.limits if not limit.met(values)]
    return all(limit.unseen for limit in broken_ones) and _bounded(c)


def why_not(c: Candidate, problem: Problem) -> str:
    """Why the coefficients cannot be; empty where they can."""
    if (limit := broken(c.term.effect, _fitted(c, problem))) is not None:
        return limit.says
    return "" if _bounded(c) else BOUNDS.says


def _fitted(c: Candidate, problem: Problem) -> Fitted:
    """What the limits of its effect are asked of a candidate."""
    term, motion = c.term, where_acts(problem, c.term, c.coefficients)
    return Fitted(term.effect, motion, term.joint, term.shape, c.coefficients, c.errors)


def _bounded(c: Candidate) -> bool:
    """Whether a single coefficient, or all of a strict effect, lie within their bounds."""
    effect = c.term.effect
    if len(effect.params) != 1 and not strict(effect):
        return True
    return bool(within(effect, np.array(c.coefficients)))


def alone(c: Candidate, evidence: Evidence, result: FitResult) -> bool:
    """Whether a line over time is most of what stands above the floor on its joint now.

    Any missing effect leaves lines at sums of the motion's frequencies: one among many is its
    shadow, and only a line that stands by itself is a disturbance.
    """
    if not isinstance(c.term.effect.search, Lines):
        return True
    j = c.term.joint
    noise = min(evidence.floor.rms[j], evidence.floor.scale[j])
    excess = float(result.rms[j] ** 2 - noise**2)
    removed = c.parts[j] * result.sigma[j] ** 2 / result.problem.count[j]
    return bool(removed > WHOLE * excess)


def possible(evidence: Evidence, result: FitResult) -> list[Candidate]:
    """Candidates that are detected and pay their price, so that they may be a rival; best first."""
    return [
        c
        for c in evidence.candidates
        if c.detected
        and physical(c, result.problem)
        and c.score > 0
        and not c.artefact
        and c.absorbed < ABSORBED
        and alone(c, evidence, result)
    ]


def plausible(evidence: Evidence, result: FitResult) -> list[Candidate]:
    """Those of them that matter, so that they may be named."""
    return [c for c in possible(evidence, result) if variance_share(c, evidence, result) >= TENTH]


def kindred(a: Candidate, b: Candidate) -> bool:
    """Whether two candidates are forms of one physical cause, as the motor sees it, on one joint.

    Beside one of them the other is no news.
    """
    causes = (set(c.term.effect.relations.causes) for c in (a, b))
    return a.term.joint == b.term.joint and bool(set.intersection(*causes))


def choose(
    candidates: list[Candidate], projector: Projector
) -> tuple[Candidate, float, list[tuple[Candidate, float]]]:
    """Best candidate, its confidence, and the rivals that keep at least 5 % each, with that.

    Rivals on another joint compete for the same residual only through the shared rigid-body
    parameters; they are retested after the best one is in, so only rivals on the same joint
    (or of the whole robot) count here, and the same effect elsewhere where the shared parameters
    make the two one (of two torque gains only the ratio is determined).
    """
    best = candidates[0]
    anywhere = best.term.effect.scope.whole
    same = [
        c
        for c in candidates[1:]
        if anywhere
        or c.term.joint == best.term.joint
        or c.term.effect.scope.whole
        or mirrored(best, c, projector)
    ]
    p = weights(best, same[:12], projector)
    rivals = [(c, p[k]) for k, c in enumerate(same[:12], start=1) if p[k] >= RIVAL]
    return best, p[0], rivals


# ------------------------------------------------------------ coefficients beyond chance


def by_chance(result: FitResult, key: tuple[str, int]) -> bool:
    """Whether an effect (name, joint) of a fit may as well be none."""
    return chance(result, key) > LEVEL


def chance(result: FitResult, key: tuple[str, int]) -> float:
    """Probability that coefficients that are zero would look as large.

    Shape values are taken as they are: a share and a delay trade off, and the effect is there all
    the same.

    Parameters
    ----------
    result : FitResult
        The fit.
    key : (str, int)
        Effect and joint.

    Returns
    -------
    float
        0 where the fit has no such term, or fewer blocks than the test needs.
    """
    number = next((k for k, t in enumerate(result.terms) if t.key == key), None)
    blocks = time_blocks(result.problem)
    if number is None:
        return 0.0
    where = result.slices[number]
    count, m = int(blocks.max()) + 1, where.stop - where.start
    if count - m < FEW:
        return 0.0
    weighted = (result.residual / result.sigma[:, None]).reshape(-1)
    every = cluster_covariance(weighted, result.basis, np.tile(blocks, result.problem.d))
    own, b = every[where, where], result.theta[where]
    size = np.sqrt(np.diag(own))
    if result.terms[number].effect.scope.whole:
        # coefficients that no row sees are none
        seen = size > 0
        own, b, size, m = own[np.ix_(seen, seen)], b[seen], size[seen], int(seen.sum())
    if not (m and np.all(size > 0)):
        return 0.0
    inverse = np.linalg.pinv(own / np.outer(size, size), hermitian=True)
    # T^2 = b' V^-1 b
    square = float((b / size) @ inverse @ (b / size))
    return float(fdtrc(m, count - m, square * (count - m) / (m * (count - 1))))


def effort(result: FitResult, key: tuple[str, int]) -> float:
    """Rms effort of a term (effect, joint) of a fit, weighted, over all joints."""
    number = next(k for k, t in enumerate(result.terms) if t.key == key)
    where = result.slices[number]
    rows = result.x[:, where] @ result.theta[where]
    return float(np.linalg.norm(rows))


def beyond(result: FitResult, key: tuple[str, int], instead: FloatArray) -> tuple[float, float]:
    """Size of a term's effort that some columns cannot take over, and its standard error."""
    where = result.slices[next(k for k, t in enumerate(result.terms) if t.key == key)]
    scale = np.repeat(result.sigma, result.problem.n)[:, None]
    x, q = result.x[:, where] / scale, np.linalg.qr(instead / scale)[0]
    x = x - q @ (q.T @ x)
    blocks = np.tile(time_blocks(result.problem), result.problem.d)
    weighted = (result.residual / result.sigma[:, None]).reshape(-1)
    own = cluster_covariance(weighted, result.basis, blocks)[where, where]
    return (
        float(np.linalg.norm(x @ result.theta[where])),
        float(np.sqrt(max(float(np.sum((x @ own) * x)), 0.0))),
    )


# ------------------------------------------------------------ values that can be physics


def impossible_values(result: FitResult, effect: str) -> list[str]:
    """Sentences on an effect's values that its own law does not allow, joint by joint."""
    joints = result.problem.joints
    said = []
    for t in result.terms:
        if t.effect.name == effect and (why := forbidden(result, t)):
            where = "" if t.effect.scope.of_robot else f" on {joints[t.joint]}"
            said.append(f"{effect}{where}: {why}; 'hil diagnose' would not name it")
    return said


def forbidden(result: FitResult, term: Term) -> str:
    """Why the effect's own law does not allow its values, in a run that has its own; or nothing."""
    values = [result.values[n] for n, _ in coefficients(term, result.problem)]
    runs = result.problem.runs if term.per_run else 1
    each = np.array([[v.value, v.stderr] for v in values]).reshape(-1, 2)
    if not len(each):
        return ""
    # differences to one run belong together
    one = term.effect.variation.relative or not term.per_run
    parts = [each] if one else np.array_split(each, runs)
    motion = where_acts(result.problem, term, parts[0][:, 0].tolist())
    for part in parts:
        beta, errors = part[:, 0].tolist(), part[:, 1].tolist()
        found = Fitted(term.effect, motion, term.joint, term.shape, beta, errors)
        if (limit := broken(term.effect, found)) is not None:
            return limit.says
    return ""


def as_use(c: Candidate, problem: Problem) -> Use:
    """A candidate as a part of a model, its shape as the starting value."""
    effect = c.term.effect
    start = head(effect, c.term.joint)
    values = {
        f"{start}.{p.name}": Value(v, unit=p.unit)
        for p, v in zip(effect.shape, c.term.shape, strict=True)
    }
    options: dict[str, object] = {"per_run": True} if c.term.per_run else {}
    joints = ("*",) if effect.scope.of_robot else (problem.joints[c.term.joint],)
    return Use(effect.name, joints, options, values)


# ---------------------------------------------------------------------- overtones

#: Multiples of a named wave's order of which its law, two harmonics each, is tried beside it.
_FURTHER = (2, 3, 5)


def harmonic(c: Candidate, found: Sequence[Candidate], motion: Motion, projector: Projector) -> str:
    """Why a wave over position is no effect beside a named one; empty where it may be one.

    Real cogging, ripple and tight spots have more harmonics than their laws here.  The order of
    another cause is a whole multiple by chance only; and where the motion goes through little more
    than a period, a wave is a shape and has hardly an order: then it is a part of the named one
    if the second to tenth harmonics of that lower the error as much.

    Parameters
    ----------
    c : Candidate
        What may be another effect.
    found : sequence of Candidate
        What is named.
    motion : Motion
        The first run.
    projector : Projector
        The present model.
    """
    for wave in found:
        if wave.term.joint != c.term.joint or not (_wave(c, motion) and _wave(wave, motion)):
            continue
        ratio = c.term.shape[0] / wave.term.shape[0]
        times = round(ratio)
        if 2 <= times <= FEW and abs(ratio - times) < WHOLE_ORDER * times:
            return f"the remainder repeats {times} times in a period of its {wave.name}: a harmonic"
        if _more(wave, projector) >= c.parts[c.joint]:
            return f"further harmonics of its {wave.name} explain the remainder as well: a part"
    return ""


def _more(wave: Candidate, projector: Projector) -> float:
    """Gain of further harmonics of a named wave, all at once."""
    order, *rest = wave.term.shape
    shapes = [(k * order, *rest) for k in _FURTHER]
    columns = [projector.weighted(wave.term.reshaped(shape)) for shape in shapes]
    return projector.gain_of(wave.term, np.concatenate(columns, axis=1))


def _wave(c: Candidate, motion: Motion) -> bool:
    """Whether a candidate repeats over position, with an order for its first shape value."""
    search, j = c.term.effect.search, c.term.joint
    if not isinstance(search, Waves):
        return False
    waves = search.carrier(motion, j) is not None or search.powers(motion, j) is not None
    return waves and bool(c.term.shape) and c.term.shape[0] > 0


# ------------------------------------------------------------ the robot's description


def described_odds(one: FitResult, others: Sequence[FitResult]) -> list[float]:
    """Log odds of a model over others that explain as much, by the robot's description.

    A law whose place another takes leaves the masses to make up the difference.  With bodies
    pi ~ N(pi_0, rho^2 (R'R)^-1) (see `hil.identify.solve`), k directions of them that the data
    determine, and rho of each model where its bodies are likeliest,

        log p(pi_1) / p(pi_2) = k log(rho_2 / rho_1),    rho^2 = |R (pi - pi_0)|^2 / k.

    Zero without a description.

    Parameters
    ----------
    one, others : FitResult, sequence of FitResult
        The models, fitted to the same runs.
    """
    if not others:
        return []
    near, own = _off_description(one)
    far = [_off_description(other) for other in others]
    return [min(own, k) * float(np.log(rho / near)) for rho, k in far]


def _off_description(result: FitResult) -> tuple[float, int]:
    """Relative error rho that a model's bodies ascribe to the description; determined directions.

    A direction counts that the data know better than a body can be drawn and weighed.
    """
    problem, rows = result.problem, described(result.problem, result.terms, result.slices)
    bodies = [
        where
        for t, where in zip(result.terms, result.slices, strict=True)
        if Trait.BODY in t.effect.traits and rows[:, where].any()
    ]
    if not bodies:
        return float(ERRORS[0]), 0
    where = bodies[0]
    metric = rows[:, where]
    weighed = result.x[:, where] * np.repeat(1.0 / result.sigma, problem.n)[:, None]
    # in coordinates w = R pi
    _, size, ways = decomposed(weighed @ np.linalg.pinv(metric))
    known = size**2 * ERRORS[0] ** 2 > colouring(problem, result.residual)
    off = ways[known] @ metric @ (result.theta[where] - problem.robot.prior)
    k = int(known.sum())
    return max(float(np.linalg.norm(off)) / max(k, 1) ** 0.5, float(ERRORS[0])), k


# ------------------------------------------------------------ how sure a name is


@dataclass
class Named:
    """An effect of the last model, and how sure its name is.

    Parameters
    ----------
    candidate : Candidate
        The effect.
    confidence : float
        Weight of the models that hold it, among those that cannot be told apart.
    rivals : list of Candidate
        Effects that take its place in the others.
    odds : list of (float, float)
        Weight of each rival by the likelihood, and share of the draws that it wins; empty where
        there are none.
    own : (float, float)
        The same of the effect: its confidence is the lesser one.
    """

    candidate: Candidate
    confidence: float
    rivals: list[Candidate]
    odds: list[tuple[float, float]] = field(default_factory=list)
    own: tuple[float, float] = (HALF, HALF)

    def among(self, rivals: Sequence[Candidate]) -> Named:
        """The same among fewer rivals."""
        kept = [k for k, r in enumerate(self.rivals) if any(r is x for x in rivals)]
        gone = [x for k, x in enumerate(self.odds) if k not in kept]
        left = (1.0 - sum(x[way] for x in gone) for way in (0, 1))
        own = tuple(min(p / max(x, p, 1e-300), 1.0) for p, x in zip(self.own, left, strict=True))
        return Named(
            self.candidate,
            min(own),
            [self.rivals[k] for k in kept],
            [self.odds[k] for k in kept],
            (own[0], own[1]),
        )

    def against(self, others: Sequence[Candidate], own: tuple[float, float]) -> Named:
        """The same with another explanation, whose effects go together; `own`: weight against it.

        They are rivals where it keeps the weight of one.
        """
        keys = {r.term.key for r in others}
        if any(r.term.key in keys for r in self.rivals):  # alone it is no other explanation
            apart = self.among([r for r in self.rivals if r.term.key not in keys])
            return apart.against(others, own)
        odds = [(1.0 - p) / max(p, 1e-300) for p in own]
        scale = [1.0 / (1.0 + p * x) for p, x in zip(self.own, odds, strict=True)]
        mine = (self.own[0] * scale[0], self.own[1] * scale[1])
        theirs = (mine[0] * odds[0], mine[1] * odds[1])
        more = [r for r in others if max(theirs) >= RIVAL]
        known = [(a * scale[0], b * scale[1]) for a, b in self.odds]
        rivals = [*self.rivals, *more]
        return Named(self.candidate, min(mine), rivals, [*known, *[theirs] * len(more)], mine)

    def told(self, odds: Sequence[float]) -> Named:
        """The same where something else is known: log odds of the effect over each rival.

        A rival that is likelier leaves the name undecided: which one is named the search decides.
        """
        own, rivals = np.array(self.own), np.array(self.odds).reshape(-1, 2)
        weight = rivals * np.exp(np.clip(np.negative(odds), -_OVERFLOW, _OVERFLOW))[:, None]
        # what is neither the effect nor a rival that is listed keeps its weight
        left = np.maximum(1.0 - own - rivals.sum(axis=0), 0.0)
        whole = np.maximum(own + weight.sum(axis=0) + left, 1e-300)
        own, weight = np.maximum(own / whole, np.minimum(own, HALF)), weight / whole
        kept = [k for k in range(len(self.rivals)) if weight[k].max() >= RIVAL]
        return Named(
            self.candidate,
            float(own.min()),
            [self.rivals[k] for k in kept],
            [(float(weight[k, 0]), float(weight[k, 1])) for k in kept],
            (float(own[0]), float(own[1])),
        )


#: Largest log odds that is told apart from certainty.
_OVERFLOW = 50.0
