"""Evidence for every candidate effect on every joint, and whether it is beyond chance."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis import artefacts
from hil.diagnosis.constants import ADEQUATE, FLOOR_SHARE, MANY_SHAPES, WORTH
from hil.diagnosis.floor import noise_floor
from hil.diagnosis.residual_tests import changes, changes_somewhere
from hil.diagnosis.types import FLIPS, Candidate, Evidence, Floor, ranking
from hil.identify import screening
from hil.identify.design import Key, Term, block, replaced
from hil.identify.fit import time_blocks
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.regression import RANK_ROUNDING
from hil.identify.result import FitResult
from hil.identify.screening import screen
from hil.identify.shape_search import COARSE, best_shape
from hil.identify.slow_motion import real_delay
from hil.models import catalogue
from hil.models.effect import Effect, Lines, Trait
from hil.work import in_parallel

FloatArray = NDArray[np.float64]
#: What is sought: effects with a name; free functions for what none explains; a robot's geometry.
EFFECT, CORRECTION, GEOMETRY = "effect", "correction", "geometry"
#: Share of the squared length of columns of length one below which one is made of the others.
DEPENDENT = 1e-9


# ------------------------------------------------------------ what may be added


def _kind(effect: Effect) -> str:
    """Which search an effect belongs to; empty for what every model has."""
    if Trait.CORRECTION in effect.traits:
        return GEOMETRY if Trait.GEOMETRY in effect.traits else CORRECTION
    return EFFECT if Trait.GIVEN not in effect.traits else ""


def _in_model(result: FitResult) -> set[Key]:
    """Effects of a model by joint, also those that step back behind others."""
    number = {name: j for j, name in enumerate(result.problem.joints)}
    return {
        (u.type, number[name]) for u in result.model.effects for name in u.joints if name in number
    }


def terms_to_try(
    result: FitResult,
    joints: Collection[int] | None = None,
    without: Collection[Key] = (),
    kind: str = EFFECT,
) -> tuple[list[Term], list[tuple[str, str]]]:
    """Terms that may be added on some joints, and effects that cannot be tried, with the reason.

    Parameters
    ----------
    result : FitResult
        The present fit.
    joints : collection of int, optional
        Joints that are still open, by default all; effects of the whole robot are tried if there
        is one.
    without : collection of (effect, joint)
        Terms of the fit that count as absent, so that they are tried again.
    kind : str
        `EFFECT`, or `CORRECTION` or `GEOMETRY` without a name.
    """
    problem, explains = result.problem, result.model.explains
    motion, held = problem.motions[0], problem.holds
    joints = range(problem.d) if joints is None else joints
    present = {t.key for t in result.terms} - set(without)
    # one value for all runs leaves those of every run to be tried
    shared = {t.key for t in result.terms if not (t.per_run or t.effect.variation.relative)}
    own_values = present - shared
    # what steps back behind another effect has no term, and is in the model all the same
    behind = _in_model(result) - {t.key for t in result.terms} - set(without)
    present |= behind
    terms: list[Term] = []
    impossible: dict[str, str] = {}
    for effect in catalogue.table().values():
        if _kind(effect) != kind or explains not in effect.scope.explains:
            continue
        for j in range(1 if effect.scope.of_robot else problem.d):
            own = effect.variation.per_run and problem.runs > 1
            there = own_values if own else present
            if (effect.name, j) in there or (held[j] and not effect.scope.of_robot):
                continue
            beside = effect.relations.extends
            if beside and not any((other, j) in present for other in beside):
                continue
            reason = effect.scope.lacks(motion, j)
            if reason:
                impossible.setdefault(effect.name, reason)
            elif j in joints or (effect.scope.of_robot and joints):
                terms.append(Term(effect, j, () if own else effect.variation.single, per_run=own))
    tried = {t.effect.name for t in terms}
    return terms, [(n, why) for n, why in impossible.items() if n not in tried]


# ------------------------------------------------------------ candidates beside a fit


def try_all(projector: Projector, result: FitResult, terms: list[Term]) -> list[Candidate]:
    """Candidates for terms, without those that have no shape here, or nothing but zeros."""
    tried = in_parallel(lambda t: _try(projector, result, t), terms, projector.problem.instants)
    return [c for c in tried if c is not None]


def _try(projector: Projector, result: FitResult, term: Term) -> Candidate | None:
    reduced = _reduced(projector, result, term)
    if not term.shape:
        term = _shaped(projector, reduced, term)
    if not term.shape and term.effect.shape:
        return None
    gain, beta, inverse, qc = projector.score(term)
    columns = projector.weighted(term)
    size = float(np.sum(columns**2))
    if size == 0.0:
        return None
    absorbed = _absorbed(columns, qc)
    dof = _directions(columns) + _free(term, projector)
    net = _net(projector, reduced, term)
    parts = _parts(projector, term, net, columns @ beta, qc @ beta)
    return Candidate(
        term,
        gain,
        net,
        dof=dof,
        absorbed=absorbed,
        coefficients=tuple(map(float, beta)),
        errors=tuple(np.sqrt(np.maximum(np.diag(inverse), 0.0)).tolist()),
        joint=int(np.argmax(parts)) if term.effect.scope.whole else term.joint,
        parts=parts,
    )


def _shaped(projector: Projector, reduced: Projector, term: Term) -> Term:
    """The term with the shape that nets most: beside what it replaces or in its place."""
    found, _ = best_shape(projector, term, accuracy=COARSE)
    if reduced is projector:
        return found
    other, _ = best_shape(reduced, term, accuracy=COARSE)
    both = [t for t in (found, other) if t.shape or not t.effect.shape]
    return max(both, key=lambda t: reduced.gain(t), default=found)


def _absorbed(columns: FloatArray, known: FloatArray) -> float:
    """Share of the newest of columns (N, m) that the base takes, which is known (r, m) in Q.

    Column by column: each has its own unit, and a spring's stiffness over a stroke of a millimetre
    is small beside its rest.
    """
    size, taken = np.sum(columns**2, axis=0), np.sum(known**2, axis=0)
    live = size > RANK_ROUNDING**2 * float(size.max())
    return float(np.min(taken[live] / size[live]))


def _directions(columns: FloatArray) -> int:
    """Coefficients that columns (N, m) tell apart: of a body on a link of an arm hardly all ten."""
    gram = columns.T @ columns
    size = np.sqrt(np.diag(gram))
    live = size > RANK_ROUNDING * float(size.max())
    unit = gram[np.ix_(live, live)] / np.outer(size[live], size[live])
    return int(np.linalg.matrix_rank(unit, tol=DEPENDENT, hermitian=True))


def _free(term: Term, projector: Projector) -> int:
    """Shape values that were searched; a choice of a few forms is none, nor what is tuned later."""
    grid = projector.problem.grid(term.effect, term.joint)
    each = zip(term.effect.shape, zip(*grid, strict=True), strict=False)
    return sum(len(set(values)) > 2 and not (p.choice or p.tuned) for p, values in each)


def _parts(
    projector: Projector, term: Term, net: float, effort: FloatArray, known: FloatArray
) -> FloatArray:
    """Fall of every joint's squared residual (d,); `known`: what the base takes, in Q."""
    d = projector.problem.d
    if not term.effect.scope.whole:
        out = np.zeros(d)
        out[term.joint] = net
        return out
    new, r = effort - projector.spanned(known), projector.residual
    fall: FloatArray = (r**2 - (r - new) ** 2).reshape(d, -1).sum(axis=1)
    return np.where(projector.problem.holds, 0.0, fall)


def _reduced(projector: Projector, result: FitResult, term: Term) -> Projector:
    """The projector without what a candidate replaces, e.g. presliding Coulomb friction."""
    gone = [t for t in result.terms if t.key in replaced(term)]
    if not gone:
        return projector
    key = ("without", *(t.key for t in gone))
    if key not in projector.memo:
        rest = [t for t in result.terms if t not in gone]
        projector.memo[key] = Projector(projector.problem, rest, projector.sigma)
    reduced: Projector = projector.memo[key]
    return reduced


def _net(projector: Projector, reduced: Projector, term: Term) -> float:
    """Gain when the candidate stands in the place of what it replaces."""
    return projector.rss - (reduced.rss - reduced.gain(term))


# ------------------------------------------------------------ detection


def detect(
    found: Sequence[Candidate], projector: Projector, floor: Floor, result: FitResult, seed: int
) -> None:
    """Family-wise p values: flip the signs of blocks of noise, take the maximum over all.

    The noise is the residual of the largest model; each candidate's gain, maximised over its
    shapes, is divided by its own 95 % null quantile, so that rich families have no advantage.
    """
    problem = result.problem
    correlation = float(np.max(floor.inflation)) / problem.rate
    seconds = float(np.clip(4 * correlation, 0.4, 2.0))
    blocks = time_blocks(problem, seconds)
    count = int(blocks.max()) + 1
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(FLIPS, count))
    ratio = floor.scale / np.maximum(problem.rms(floor.residual), 1e-300)
    noise = (floor.residual * ratio[:, None] / result.sigma[:, None]).reshape(-1)
    rows = np.tile(blocks, problem.d)
    each = zip(projector.parts, noise.reshape(problem.d, -1), strict=True)
    qb = np.asarray(sum(block_sums(q * x[:, None], blocks, count) @ u for (q, u), x in each))
    nulls = in_parallel(
        lambda c: _null(c, projector, noise, rows, signs, qb), found, problem.instants
    )
    for c, null in zip(found, nulls, strict=True):
        c.null = null
    quantile = {id(c): max(float(np.quantile(c.null, 0.95)), 1e-300) for c in found}
    usable = [c for c in found if c.absorbed < 1 - 1e-6]
    if not usable:
        return
    worst = np.max([c.null / quantile[id(c)] for c in usable], axis=0)
    for c in usable:
        c.p_value = (1 + int(np.sum(worst >= c.gain / quantile[id(c)]))) / (1 + FLIPS)


def _null(
    c: Candidate,
    projector: Projector,
    noise: FloatArray,
    rows: NDArray[np.int_],
    signs: FloatArray,
    qb: FloatArray,
) -> FloatArray:
    """Gains of a candidate on sign-flipped noise, the best over its grid, shape (FLIPS,)."""
    best = np.zeros(len(signs))
    grid = projector.problem.grid(c.term.effect, c.term.joint)
    if not grid or c.term.shape == c.term.effect.variation.single:
        grid = [c.term.shape]
    if isinstance(c.term.effect.search, Lines):
        own = projector.rows(c.term)
        return screening.flipped(projector.problem, c.term, noise[own], rows[own], signs)
    waves = screen(projector.problem, c.term, grid)
    if waves is not None:
        n, j = projector.problem.n, c.term.joint
        back = projector.problem.back(noise[j * n : (j + 1) * n], j)
        return waves.flipped(back, projector.problem.spread(rows[: projector.problem.n]), signs)
    where = projector.rows(c.term)
    for s in projector.scores(c.term, grid[:: max(1, len(grid) // 40)]):
        g, m = s.beta.shape
        weighted = s.columns.reshape(-1, g * m) * noise[where, None]
        part = block_sums(weighted, rows[where], signs.shape[1])
        flipped = (signs @ (part - qb @ s.qc.reshape(-1, g * m))).reshape(-1, g, m)
        # c' G^+ c of each shape
        each = flipped.transpose(1, 0, 2)
        best = np.maximum(best, np.sum((each @ s.inverse) * each, axis=2).max(axis=0))
    return best


def block_sums(x: FloatArray, labels: NDArray[np.int_], count: int) -> FloatArray:
    """Sums (count, m) of the rows of x (n, m) by label; labels come in long stretches."""
    starts = np.flatnonzero(np.diff(labels, prepend=-1))
    out = np.zeros((count, x.shape[1]))
    np.add.at(out, labels[starts], np.add.reduceat(x, starts, axis=0))
    return out


# ------------------------------------------------------------ all evidence


def gather(result: FitResult, seed: int = 0) -> Evidence:
    """Try every candidate beside a fitted model.

    Parameters
    ----------
    result : FitResult
        The present fit.
    seed : int
        Of the sign flips.
    """
    with result.problem.aside():
        return _gathered(result, seed)


def _gathered(result: FitResult, seed: int) -> Evidence:
    projector = Projector(result.problem, result.terms, result.sigma)
    terms, impossible = terms_to_try(result)
    changed = changes(result, projector)
    if not changes_somewhere(result, projector, changed):
        terms = [t for t in terms if not t.effect.variation.sudden]
    found = try_all(projector, result, terms)
    floor = measured_floor(found, projector, result)
    priced(found, floor, result)
    detect(found, projector, floor, result, seed)
    artefacts.mark([c for c in found if c.detected], result, projector)
    found.sort(key=ranking)
    return Evidence(found, floor, projector, impossible, changed)


def floor_of(result: FitResult, evidence: Evidence) -> Floor:
    """Noise floor of another fit of the same model, with the shapes of candidates found before.

    Only lines over time are sought anew: they belong to a run.
    """
    projector = Projector(result.problem, result.terms, result.sigma)
    known = {
        c.term.key: c.term.shape
        for c in evidence.candidates
        if not isinstance(c.term.effect.search, Lines)
    }
    terms = [
        replace(t, shape=known.get(t.key, ()))
        for t in terms_to_try(result)[0]
        if t.key in known or not t.effect.variation.sudden
    ]
    with result.problem.aside():
        return measured_floor(try_all(projector, result, terms), projector, result)


def measured_floor(found: list[Candidate], projector: Projector, result: FitResult) -> Floor:
    """Noise floor beside candidates that were tried, with their columns in the largest model.

    Free functions of the recording (corrections) are in it as well: what they predict is no noise.
    """
    extra: list[list[FloatArray]] = [[] for _ in result.problem.joints]
    # a law that takes the place of another one has its columns
    held = {(name, c.term.joint) for c in found for name in c.term.effect.relations.replaces}
    for c in [*found, *_free_functions(projector, result)]:
        # what answers noise would take it out of the floor
        news = c.absorbed < 1 - 1e-6 and c.term.key not in held
        if news and not _picked(c, projector) and in_time(c, result):
            _collect(c.term, result.problem, extra)
    return noise_floor(result, extra)


def _free_functions(projector: Projector, result: FitResult) -> list[Candidate]:
    """Corrections without a name, on every joint that moves."""
    problem, explains = result.problem, result.model.explains
    present = {t.key for t in result.terms}
    terms = [
        Term(e, j)
        for e in catalogue.table().values()
        if Trait.CORRECTION in e.traits and explains in e.scope.explains
        for j in np.flatnonzero(~problem.holds).tolist()
        if (e.name, j) not in present and not e.scope.lacks(problem.motions[0], j)
    ]
    with problem.aside():
        return try_all(projector, result, terms)


def _picked(c: Candidate, projector: Projector) -> bool:
    """Whether a candidate is a little of the residual, picked among many shapes.

    What was found on all rows predicts the left-out ones, too: it would lower the floor for
    nothing.
    """
    own = projector.rows(c.term)
    many = len(projector.problem.grid(c.term.effect, c.term.joint)) > MANY_SHAPES
    least = FLOOR_SHARE if isinstance(c.term.effect.search, Lines) else WORTH
    return many and c.gain < least * float(np.sum(projector.residual[own] ** 2))


def in_time(c: Candidate, result: FitResult) -> bool:
    """False for a lateness of the effort that the slow motion does not confirm."""
    traits = c.term.effect.traits
    whole = Trait.WHOLE in traits
    return Trait.LATE not in traits or real_delay(result, c.term.joint, c.late, whole)


def _collect(term: Term, problem: Problem, extra: list[list[FloatArray]]) -> None:
    """Add a term's columns to those of the joints that feel it."""
    columns = block(problem, term)
    for j in range(problem.d) if columns.ndim == 3 else [term.joint]:
        part = columns[j] if columns.ndim == 3 else columns
        if np.any(part):
            extra[j].append(part)


def priced(found: list[Candidate], floor: Floor, result: FitResult) -> None:
    """Put chi2, standard errors and price of candidates in units of the floor's noise."""
    effective = floor.effective(result.problem)
    noise = np.maximum((floor.scale / result.sigma) ** 2 * floor.inflation, 1e-300)
    for c in found:
        j = c.joint
        instead = len(replaced(c.term))
        c.chi2 = float(np.sum(c.parts / noise))
        # so far for noise of variance 1 in the weighted rows
        c.errors = tuple(float(e * np.sqrt(noise[j])) for e in c.errors)
        c.spare = float(effective[j] * (ADEQUATE**2 - 1) * (floor.rms[j] / floor.scale[j]) ** 2)
        c.price = max(c.dof - instead, 1) * float(np.log(max(effective[j], 2.0)))
