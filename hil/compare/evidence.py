"""Evidence for every candidate effect on every joint: how much of the residual it explains."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.compare import blur, denoise
from hil.compare.candidate import Candidate, ranking, try_all
from hil.compare.changes import Change, changes
from hil.compare.detect import detect
from hil.compare.floor import Floor, measure
from hil.identify.design import Term
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.identify.timing import LATE, real_delay
from hil.models import catalogue

__all__ = [
    "NOTHING", "Candidate", "Evidence", "floor_of", "gather", "in_time", "possible_terms", "priced",
]  # fmt: skip

FloatArray = NDArray[np.float64]
#: Shapes from which on the best of them is a pick, and the share of the residual it then needs.
MANY, LITTLE = 24, 0.02
#: The same for a line over time: what is less leaves an error within 1.1 of the floor.
LINE = 1 - 1 / 1.1**2


@dataclass(frozen=True)
class Evidence:
    """All candidates beside one fit, best first, with the floor they were judged against."""

    candidates: list[Candidate]
    floor: Floor
    projector: Projector | None
    impossible: list[tuple[str, str]]
    changes: tuple[Change, ...] = ()


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
                own = effect.per_run and problem.runs > 1
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
    changed = changes(result, projector)
    if not changed:
        terms = [t for t in terms if not t.effect.sudden]
    found = try_all(projector, result, terms)
    floor = _floor(found, projector, result)
    priced(found, floor, result)
    detect(found, projector, floor, result, seed)
    denoise.mark(found, projector)
    blur.mark(found, result, projector)
    found.sort(key=ranking)
    return Evidence(found, floor, projector, impossible, changed)


def floor_of(result: FitResult, evidence: Evidence) -> Floor:
    """Noise floor of another fit of the same model, with the shapes of candidates found before.

    Only lines over time are sought anew: they belong to a run.
    """
    projector = Projector(result.problem, result.terms, result.sigma)
    known = {c.term.key: c.term.shape for c in evidence.candidates if not c.term.effect.spectral}
    terms = [
        replace(t, shape=known.get(t.key, ())) for t in possible_terms(result)[0]
        if t.key in known or not t.effect.sudden
    ]  # fmt: skip
    return _floor(try_all(projector, result, terms), projector, result)


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
    own = projector.rows(c.term)
    many = len(projector.problem.grid(c.term.effect, c.term.joint)) > MANY
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


def priced(found: list[Candidate], floor: Floor, result: FitResult) -> None:
    """Put chi2, standard errors and price of candidates in units of the floor's noise."""
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
