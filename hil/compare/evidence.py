"""Evidence for every candidate effect on every joint: how much of the residual it explains."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.compare.detect import FLIPS, detect
from hil.compare.floor import Floor, measure
from hil.identify.design import Term, coefficients
from hil.identify.projector import Projector
from hil.identify.refine import COARSE
from hil.identify.result import FitResult
from hil.identify.shapes import best_shape
from hil.identify.timing import LATE, real_delay
from hil.models import catalogue

FloatArray = NDArray[np.float64]
#: Shapes from which on the best of them is a pick, and the share of the residual it then needs.
MANY, LITTLE = 24, 0.02
#: The same for a line over time: what is less leaves an error within 1.1 of the floor.
LINE = 1 - 1 / 1.1**2


@dataclass
class Candidate:
    """One effect on one joint, tried beside the present model.

    Parameters
    ----------
    term : Term
        With the best shape.
    gain : float
        Fall of the weighted residual sum of squares if it is added.
    net : float
        The same if it takes the place of what it replaces.
    chi2 : float
        `net` in units of the noise, for the effective number of instants.
    dof : int
        Coefficients and shape values spent.
    price : float
        dof * log(effective instants).
    spare : float
        What a rival may lack in chi2 and still leave less than 1.1 times the noise floor.
    absorbed : float
        Share of its columns that the base model imitates (1 = indistinguishable from it).
    p_value : float
        Family-wise, by sign flips of noise blocks.
    coefficients, errors : tuple of float
        Its coefficients if it is added, and their standard errors.
    joint : int
        Its joint; of an effect of the whole robot, the joint where it explains most.
    parts : ndarray (d,)
        `net` by joint.
    """

    term: Term
    gain: float
    net: float
    chi2: float = 0.0
    dof: int = 1
    price: float = 0.0
    spare: float = 0.0
    absorbed: float = 0.0
    p_value: float = 1.0
    coefficients: tuple[float, ...] = (0.0,)
    errors: tuple[float, ...] = ()
    joint: int = 0
    parts: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    null: FloatArray = field(default_factory=lambda: np.zeros(FLIPS), repr=False)

    @property
    def late(self) -> float:
        """How late it says that the effort acts [s], for effects that say so."""
        return self.coefficient * float(np.prod(self.term.shape))

    @property
    def coefficient(self) -> float:
        """First coefficient if it is added."""
        return self.coefficients[0]

    @property
    def name(self) -> str:
        """Effect's name."""
        return self.term.effect.name

    @property
    def score(self) -> float:
        """chi2 less its price (BIC, up to sign)."""
        return self.chi2 - self.price


@dataclass(frozen=True)
class Evidence:
    """All candidates beside one fit, best first, with the floor they were judged against."""

    candidates: list[Candidate]
    floor: Floor
    projector: Projector | None
    impossible: list[tuple[str, str]]


_NONE = np.zeros(0)
#: No evidence: a recording that was not analysed.
NOTHING = Evidence([], Floor(_NONE, "none", np.zeros((0, 0)), _NONE, _NONE), None, [])


def possible_terms(
    result: FitResult, per_run: bool = False
) -> tuple[list[Term], list[tuple[str, str]]]:
    """Candidate terms for these data, and the effects that cannot be tried, with the reason."""
    problem, explains = result.problem, result.model.explains
    motion, held = problem.motions[0], problem.holds
    present = {t.key for t in result.terms}
    terms: list[Term] = []
    impossible: dict[str, str] = {}
    for effect in catalogue.table().values():
        if not effect.candidate or explains not in effect.explains:
            continue
        for j in range(1 if effect.of_robot else problem.d):
            if (effect.name, j) in present or (held[j] and not effect.of_robot):
                continue
            reason = effect.available(motion, j)
            if reason:
                impossible.setdefault(effect.name, reason)
            else:
                own = effect.per_run and len(problem.recordings) > 1
                terms.append(Term(effect, j, per_run=own))
    tried = {t.effect.name for t in terms}
    return terms, [(n, why) for n, why in impossible.items() if n not in tried]


def gather(result: FitResult, seed: int = 0) -> Evidence:
    """Try every candidate beside a fitted model.

    Parameters
    ----------
    result : FitResult
        The present fit.
    seed : int
        Of the sign flips.
    """
    projector = Projector(result.problem, result.terms, result.sigma)
    terms, impossible = possible_terms(result)
    found = _tried(projector, result, terms)
    floor = _floor(found, projector, result)
    _judge(found, floor, result)
    detect(found, projector, floor, result, seed)
    # scores that agree to four digits keep the order of the catalogue
    found.sort(key=lambda c: -float(f"{c.score:.4g}"))
    return Evidence(found, floor, projector, impossible)


def floor_of(result: FitResult, evidence: Evidence) -> Floor:
    """Noise floor of another fit of the same model, with the shapes of candidates found before.

    Only lines over time are sought anew: they belong to a run.
    """
    projector = Projector(result.problem, result.terms, result.sigma)
    known = {c.term.key: c.term.shape for c in evidence.candidates if not c.term.effect.spectral}
    terms = [replace(t, shape=known.get(t.key, ())) for t in possible_terms(result)[0]]
    return _floor(_tried(projector, result, terms), projector, result)


def _tried(projector: Projector, result: FitResult, terms: list[Term]) -> list[Candidate]:
    """Candidates for terms, without those that have no shape here, or nothing but zeros."""
    tried = [_try(projector, result, t) for t in terms]
    return [c for c in tried if c is not None]


def _floor(found: list[Candidate], projector: Projector, result: FitResult) -> Floor:
    extra: list[list[FloatArray]] = [[] for _ in result.problem.joints]
    for c in found:
        # what answers noise would take it out of the floor
        if c.absorbed < 1 - 1e-6 and not _picked(c, projector) and in_time(c, result):
            _collect(result.problem.d, c.term, result.problem, extra)
    return measure(result, extra)


def _picked(c: Candidate, projector: Projector) -> bool:
    """Whether a candidate is a little of the residual, picked among many shapes.

    What was found on all rows predicts the left-out ones, too: it would lower the floor for
    nothing.
    """
    motion, own = projector.problem.motions[0], projector.rows(c.term)
    many = len(c.term.effect.grid(motion, c.term.joint)) > MANY
    least = LINE if c.term.effect.spectral else LITTLE
    return many and c.gain < least * float(np.sum(projector.residual[own] ** 2))


def in_time(c: Candidate, result: FitResult) -> bool:
    """False for a lateness of the effort that the slow motion does not confirm."""
    whole = c.name == "filter-lag"
    return c.name not in LATE or real_delay(result, c.term.joint, c.late, whole)


def _collect(d: int, term: Term, problem: object, extra: list[list[FloatArray]]) -> None:
    from hil.identify.design import block
    from hil.identify.problem import Problem

    if not isinstance(problem, Problem):
        return
    columns = block(problem, term)
    for j in range(d) if columns.ndim == 3 else [term.joint]:
        part = columns[j] if columns.ndim == 3 else columns
        if np.any(part):
            extra[j].append(part)


def _try(projector: Projector, result: FitResult, term: Term) -> Candidate | None:
    if not term.shape:
        term, _ = best_shape(projector, term, accuracy=COARSE)
    if not term.shape and term.effect.shape:
        return None
    gain, beta, inverse, qc = projector.score(term)
    columns = projector.weighted(term)
    size = float(np.sum(columns**2))
    if size == 0.0:
        return None
    absorbed = float(np.sum(qc**2)) / size
    dof = columns.shape[1] + _free(term, projector)
    net = _net(projector, result, term, gain)
    parts = _parts(projector, term, net, columns @ beta, qc @ beta)
    return Candidate(
        term,
        gain,
        net,
        dof=dof,
        absorbed=absorbed,
        coefficients=tuple(map(float, beta)),
        errors=tuple(np.sqrt(np.maximum(np.diag(inverse), 0.0)).tolist()),
        joint=int(np.argmax(parts)) if term.effect.of_robot else term.joint,
        parts=parts,
    )


def _free(term: Term, projector: Projector) -> int:
    """Shape values that were searched; a choice of two forms is none."""
    grid = term.effect.grid(projector.problem.motions[0], term.joint)
    return sum(len(set(values)) > 2 for values in zip(*grid, strict=True))


def _parts(
    projector: Projector, term: Term, net: float, effort: FloatArray, known: FloatArray
) -> FloatArray:
    """Fall of every joint's squared residual (d,); `known`: what the base takes, in Q."""
    d = projector.problem.d
    if not term.effect.whole_robot:
        out = np.zeros(d)
        out[term.joint] = net
        return out
    new, r = effort - projector.spanned(known), projector.residual
    fall: FloatArray = (r**2 - (r - new) ** 2).reshape(d, -1).sum(axis=1)
    return np.where(projector.problem.holds, 0.0, fall)


def _net(projector: Projector, result: FitResult, term: Term, gain: float) -> float:
    """Gain when the candidate replaces what it stands for, e.g. presliding for Coulomb."""
    gone = [
        t for t in result.terms if t.joint == term.joint and t.effect.name in term.effect.replaces
    ]
    if not gone:
        return gain
    rest = [t for t in result.terms if t not in gone]
    reduced = Projector(projector.problem, rest, projector.sigma)
    return projector.rss - (reduced.rss - reduced.gain(term))


def _judge(found: list[Candidate], floor: Floor, result: FitResult) -> None:
    effective = floor.effective(result.problem)
    noise = np.maximum((floor.scale / result.sigma) ** 2 * floor.inflation, 1e-300)
    for c in found:
        j = c.joint
        replaced = len(c.term.effect.replaces)
        c.chi2 = float(np.sum(c.parts / noise))
        # so far for noise of variance 1 in the weighted rows
        c.errors = tuple(float(e * np.sqrt(noise[j])) for e in c.errors)
        c.spare = float(effective[j] * (1.1**2 - 1) * (floor.rms[j] / floor.scale[j]) ** 2)
        c.price = max(c.dof - replaced, 1) * float(np.log(max(effective[j], 2.0)))


def labels(c: Candidate, result: FitResult) -> list[str]:
    """Full names of a candidate's coefficients."""
    return [n for n, _ in coefficients(c.term, result.problem)]
