"""What may be added to a model: every effect of the catalogue on every joint, rated held out.

The shape of a candidate (a speed, a length, a frequency) is searched on all instants beside the
present model; its coefficients, and those of the model with it, are then solved anew for every
fold, so that its worth is what it foretells of blocks that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.evidence import try_all
from hil.diagnosis.folds import Split
from hil.diagnosis.folds import split as dealt
from hil.diagnosis.grams import BlockErrors, GramTable, Group
from hil.diagnosis.types import Candidate
from hil.identify.design import Key, Term, block, replaced
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.identify.solve import limits
from hil.models.effect import Trait, terms_of

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Rated:
    """A candidate beside a model, with what it is worth on held-out blocks.

    Parameters
    ----------
    candidate : Candidate
        With its shape.
    now, errors : Errors
        Of the model without it and with it.
    fall : ndarray (blocks,)
        Fall of the squared error of its joint, block by block [(N m)^2 or N^2].
    before, after : float
        Mean square error of its joint without it and with it.
    joint : int
        Its joint; of an effect of the whole robot, the one where it does most.
    """

    candidate: Candidate
    now: BlockErrors
    errors: BlockErrors
    fall: FloatArray
    before: float
    after: float
    joint: int
    #: What the model with it leaves of joint j, and without it, fitted to all instants (n,).
    residual: Callable[[int], FloatArray]
    given: Callable[[int], FloatArray]

    @property
    def removed(self) -> float:
        """Fall of the mean square error of its joint."""
        return self.before - self.after

    @property
    def sureness(self) -> float:
        """Fall in standard errors, from the spread over blocks."""
        return paired(self.fall)


def paired(fall: FloatArray) -> float:
    """Sum of block-wise differences (blocks,) in standard errors."""
    spread = float(np.sqrt(np.sum((fall - fall.mean()) ** 2)))
    return float(fall.sum()) / max(spread, 1e-300)


def key_of(c: Candidate) -> tuple[str, str, int]:
    """Key of a candidate's columns beside those of the model."""
    return ("+", *c.term.key)


def model_groups(result: FitResult, without: Collection[Key] = ()) -> list[Group]:
    """Columns of a fitted model, one group a term."""
    problem = result.problem
    low, high = limits(result.terms, problem)
    out = []
    for t, where in zip(result.terms, result.slices, strict=True):
        if t.key in without:
            continue
        held = result.theta[where]
        # what acts at one instant is not to be learnt from the others: it is kept as it is
        kept = t.fixed or t.effect.variation.dated(t.shape)
        lower, upper = (held, held) if kept else (low[where], high[where])
        joint = None if t.effect.scope.whole else t.joint
        group = Group(t.key, joint, block(problem, t), lower, upper, result.prior[where])
        if result.pull is not None and Trait.BODY in t.effect.traits:
            group = replace(group, precision=result.pull.precision(where))
        out.append(group)
    return out


def candidate_group(problem: Problem, c: Candidate) -> Group:
    """Columns of a candidate."""
    t, columns = c.term, block(problem, c.term)
    m = columns.shape[-1]
    each = terms_of(t.effect, problem.motions[0], t.joint)
    params = [each[k % len(each)] for k in range(m)]
    lower = np.array([p.lower for p in params], dtype=np.float64)
    upper = np.array([p.upper for p in params], dtype=np.float64)
    joint = None if t.effect.scope.whole else t.joint
    return Group(key_of(c), joint, columns, lower, upper, np.zeros(m))


def tried(
    result: FitResult,
    terms: Sequence[Term],
    without: Collection[Key] = (),
    projector: Projector | None = None,
) -> tuple[Projector, list[Candidate]]:
    """Candidates with their best shapes beside a fit, and what they were projected off.

    `projector` is that of the fit, if it was made already.
    """
    if projector is None:
        rest = [t for t in result.terms if t.key not in without]
        projector = Projector(result.problem, rest, result.sigma)
    with result.problem.aside():
        return projector, try_all(projector, result, list(terms))


def rate(
    result: FitResult,
    split: Split,
    candidates: Sequence[Candidate],
    without: Collection[Key] = (),
) -> list[Rated]:
    """Held-out worth of candidates beside a fit, in their order.

    What has coefficients in every run is judged on blocks of all runs: no run determines those of
    another one.
    """
    problem, base = result.problem, model_groups(result, without)
    keys: list[object] = [g.key for g in base]
    out: dict[int, Rated] = {}
    for own in (False, True):
        some = [c for c in candidates if (c.term.per_run and split.by_run) == own]
        if not some and own:
            continue
        folds = dealt(problem, whole_runs=False) if own else split
        more = [candidate_group(problem, c) for c in some]
        table = GramTable(problem, folds, result.sigma, base, more)
        now = table.errors(keys)
        out |= dict(zip(map(id, some), rated(some, table, keys, now), strict=True))
    return [out[id(c)] for c in candidates]


def held_out(result: FitResult, split: Split) -> FloatArray:
    """Residual (d, n) of a fit on blocks that its coefficients were not fitted to."""
    groups = model_groups(result)
    table = GramTable(result.problem, split, result.sigma, groups)
    return table.left_out([g.key for g in groups])


def rated(
    some: Sequence[Candidate], table: GramTable, keys: Sequence[object], now: BlockErrors
) -> list[Rated]:
    """Candidates, each beside the groups `keys`, whose errors are `now`."""
    models = []
    for c in some:
        gone = replaced(c.term)
        chosen = [k for k in keys if k not in gone] + [key_of(c)]
        if c.term.effect.variation.dated(c.term.shape):
            table.hold(key_of(c), table.coefficients(chosen)[key_of(c)])
        models.append(chosen)
    out = []
    for c, chosen, errors in zip(some, models, table.each(models), strict=True):
        j = c.term.joint
        if c.term.effect.scope.whole:
            j = int(np.argmax((now.power - errors.power) / np.maximum(now.power, 1e-300)))
        out.append(
            Rated(
                c,
                now,
                errors,
                now.squared[:, j] - errors.squared[:, j],
                float(now.power[j]),
                float(errors.power[j]),
                j,
                partial(table.residual, chosen),
                partial(table.residual, keys),
            )
        )
    return out
