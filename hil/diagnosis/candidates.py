"""What may be added to a model: every effect of the catalogue on every joint, rated held out.

The shape of a candidate (a speed, a length, a frequency) is searched on all instants beside the
present model; its coefficients, and those of the model with it, are then solved anew for every
fold, so that its worth is what it predicts of blocks that it was not fitted to.

Unnamed competitors, free functions of the same variables, run in the same race.  A name says more
than that something is there: it says which law.  Where a free function predicts left-out data
better than the named law does, beyond chance and beyond what a library's law may miss, the name
does not stand.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.constants import BEATEN, BEYOND, DISCREPANCY, HALF, OPEN, SURE
from hil.diagnosis.evidence import try_all
from hil.diagnosis.floor import practical
from hil.diagnosis.grams import BlockErrors, GramTable, Group, Split
from hil.diagnosis.grams import split as dealt
from hil.diagnosis.types import Candidate
from hil.identify.design import Key, Term, block, comes_back, replaced
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.identify.solve import limits
from hil.models.effect import Trait, terms_of
from hil.models.kernels import lag
from hil.models.motion import Motion

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
        Its joint; of an effect that all joints feel, the one where it does most.
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
        found = rated(some, table, keys, now, practical(problem) * problem.rms(problem.effort))
        out |= dict(zip(map(id, some), found, strict=True))
    return [out[id(c)] for c in candidates]


def rate_together(
    result: FitResult, split: Split, some: Sequence[Candidate]
) -> tuple[BlockErrors, BlockErrors]:
    """Held-out errors of a fit, and with several candidates in it, judged as `rate` judges one."""
    problem, base = result.problem, model_groups(result)
    if split.by_run and any(c.term.per_run for c in some):
        split = dealt(problem, whole_runs=False)
    groups = [*base, *(candidate_group(problem, c) for c in some)]
    table = GramTable(problem, split, result.sigma, groups)
    gone = set().union(*(replaced(c.term) for c in some))
    keys: list[object] = [g.key for g in base]
    return table.errors(keys), table.errors([g.key for g in groups if g.key not in gone])


def held_out_residual(result: FitResult, split: Split) -> FloatArray:
    """Residual (d, n) of a fit on blocks that its coefficients were not fitted to."""
    groups = model_groups(result)
    table = GramTable(result.problem, split, result.sigma, groups)
    return table.left_out([g.key for g in groups])


def rated(
    some: Sequence[Candidate],
    table: GramTable,
    keys: Sequence[object],
    now: BlockErrors,
    matters: FloatArray,
) -> list[Rated]:
    """Candidates, each beside the groups `keys`, whose errors are `now`.

    What is less than `matters` (d,) [N m or N] is of no size on a joint.
    """
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
            j = _most(now.power, errors.power, matters)
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


def _most(before: FloatArray, after: FloatArray, matters: FloatArray) -> int:
    """The joint on which an effect takes the largest share of the error, if that is of size.

    Else where it is nearest to that.
    """
    size = (before - after) / np.maximum(matters**2, 1e-300)
    share = (before - after) / np.maximum(before, 1e-300)
    return int(np.argmax(np.where(size > 1.0, share, -np.inf) if np.any(size > 1.0) else size))


def simplest(rated: list[Rated], score: Callable[[Rated], float]) -> Rated:
    """Of the candidates that do as well as the best one, the one with the least to fit.

    As well: within what a library's law misses of its effect.
    """
    best = max(rated, key=score)
    alike = [r for r in rated if _alike(r, best)]
    return min([best, *alike], key=lambda r: (*_values(r.candidate), -score(r)))


def _alike(r: Rated, best: Rated) -> bool:
    """Whether a candidate does as well as the best: surely no worse, or with less to fit."""
    close = r.after - best.after <= DISCREPANCY * best.removed
    fewer = r.candidate.dof < best.candidate.dof
    return bool(close and (fewer or paired(best.fall - r.fall) < BEYOND))


def values_of(r: Rated) -> tuple[int, float]:
    """Values that a rated candidate fits, and what it leaves."""
    return r.candidate.dof, r.after


def _values(c: Candidate) -> tuple[int, int]:
    """Values that a candidate fits, and shape values that its law has."""
    return c.dof, len(c.term.shape)


#: Shrinkage of a free function's coefficients, in units of their own columns [1].
SHRINK = 1e-3
#: Centres and width of bumps over speed, in units of the rms speed.
_SPEEDS, _WIDTH = np.linspace(-2.1, 2.1, 9), 0.45
#: Bumps over the range of the position, and those that find a single detent.
_PLACES, _NARROW = 25, 100
#: Times in which something follows the position [s].
CREEPS = (0.1, 0.4, 1.6, 6.4)
#: Knots of a slow function of time, a run.
_KNOTS = 8
#: What a nearby law that the catalogue does not hold is called.
FOIL = "a law without a name"
#: What it is called where it takes in the whole robot.
ROBOT = "a change of the inertias of all links"
Columns = Callable[[Motion, int, FloatArray], FloatArray]


def _place(m: Motion, j: int, order: int) -> FloatArray:
    values = np.polynomial.chebyshev.chebvander(np.clip(m.scaled(j), -1.05, 1.05), order)
    return np.asarray(values, dtype=np.float64)


def _bumps(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    v = m.qd[:, j] / rms[j]
    return np.asarray(np.exp(-0.5 * ((v[:, None] - _SPEEDS) / _WIDTH) ** 2))


def _places(m: Motion, j: int, count: int = _PLACES) -> FloatArray:
    """Bumps over the position, `count` of them."""
    at = np.linspace(-1.0, 1.0, count)
    return np.exp(-0.5 * ((m.scaled(j)[:, None] - at) * (count - 1) / 2) ** 2)


def _position(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """Any function of the position, a narrow place included."""
    return np.concatenate([_place(m, j, 6)[:, 1:], _places(m, j)], axis=1)


def narrow(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """Any function of the position with single narrow places: a detent, a latch."""
    return _places(m, j, _NARROW)


def _inertia(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """An inertia that is any smooth function of the position: a linkage or a slider behind it.

    M(q) qdd + M'(q) qd^2 / 2, with the two functions free of each other.
    """
    place = _place(m, j, 4)
    quick = m.qdd[:, j : j + 1] * place[:, 1:]
    return np.concatenate([quick, m.qd[:, j : j + 1] ** 2 * place], axis=1)


def creep(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """What follows the position slowly: a hose or a cable that creeps."""
    q = np.ascontiguousarray(m.scaled(j))
    return np.stack([q - lag(q, m.dt, t) for t in CREEPS], axis=1)


def reversal(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """Friction that is another one where the joint speeds up than where it slows down."""
    size = max(float(np.sqrt(np.mean(m.qdd[:, j] ** 2))), 1e-12)
    side = np.tanh(3 * m.qdd[:, j] / size)[:, None]
    return np.concatenate([side * _bumps(m, j, rms), m.sign(j)[:, None] * side], axis=1)


def position_by_direction(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """Friction and viscous friction that are any smooth function of the position."""
    place, sign = _place(m, j, 9)[:, 1:], m.sign(j)
    return np.concatenate([sign[:, None] * place, m.qd[:, j : j + 1] * place], axis=1)


def _speed(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """Any smooth function of the speed, and of its sign."""
    sign = m.sign(j)[:, None]
    return np.concatenate([_bumps(m, j, rms), sign * np.abs(_bumps(m, j, rms))], axis=1)


def position_and_speed(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """Any smooth function of position and speed together."""
    out = _bumps(m, j, rms)[:, :, None] * _place(m, j, 4)[:, None, :]
    return np.asarray(out.reshape(m.n, out.shape[1] * out.shape[2]))


def _load(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """Any smooth function of the transmitted load, by direction."""
    size = max(float(np.sqrt(np.mean(m.load[:, j] ** 2))), 1e-300)
    x, sign = m.load[:, j] / size, m.sign(j)
    parts = [np.abs(x), x * x, x * np.abs(x), np.abs(x) ** 3]
    return np.stack([*parts, *(p * sign for p in parts)], axis=1)


def time(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """Any slow function of time: an offset, friction by direction and viscous friction."""
    x = 2 * m.since / max(float(m.since[-1]), 1e-12) - 1
    slow = np.polynomial.chebyshev.chebvander(x, _KNOTS)[:, 1:]
    sign, v = m.sign(j)[:, None], m.qd[:, j : j + 1]
    return np.concatenate([slow, sign * slow, v * slow[:, :3]], axis=1)


def other_joints(m: Motion, j: int, rms: FloatArray) -> FloatArray:
    """Smooth functions of the other joints' positions and speeds."""
    others = [k for k in range(m.d) if k != j]
    if not others:
        return np.zeros((m.n, 0))
    parts = []
    for k in others[:6]:
        v = m.qd[:, k] / max(rms[k], 1e-12)
        parts += [_place(m, k, 3)[:, 1:], np.stack([np.tanh(3 * v), v, v * np.abs(v)], axis=1)]
        parts.append(m.qd[:, j : j + 1] * _place(m, k, 2)[:, 1:])
    return np.concatenate(parts, axis=1)


#: What a competitor is a function of, in words, and its columns.
COMPETITORS: dict[str, Columns] = {
    "position": _position,
    "a narrow place": narrow,
    "position and acceleration": _inertia,
    "position, by direction": position_by_direction,
    "speed": _speed,
    "position and speed": position_and_speed,
    "speed and its change": reversal,
    "slow memory of the position": creep,
    "load": _load,
    "time": time,
    "the other joints": other_joints,
}


def competitor(problem: Problem, j: int, what: str) -> Group | None:
    """Columns of one competitor on joint j; None where it has none."""
    rms = np.sqrt(np.mean(np.concatenate([m.qd for m in problem.motions]) ** 2, axis=0))
    rms = np.maximum(rms, 1e-12)
    raw = [COMPETITORS[what](m, j, rms) for m in problem.motions]
    if not raw[0].shape[1]:
        return None
    columns = problem.gated(raw, j)
    free = np.full(columns.shape[1], np.inf)
    return Group(("free", what, j), j, columns, -free, free, np.zeros(free.size), SHRINK)


def competitor_in_words(what: str) -> str:
    """A competitor in a sentence: a law, or a function of some variables."""
    return what if what in (FOIL, ROBOT) else f"a function of {what} without a name"


def foils(problem: Problem, term: Term) -> list[Group]:
    """Columns of laws without a name that come close to a term's effect (`Relations.foils`)."""
    effect, j = term.effect, term.joint
    laws = [effect.relations.foils(m, j, term.shape) for m in problem.motions]
    joint = None if effect.scope.whole else j
    words = FOIL if joint is not None or effect.scope.tip else ROBOT
    out = []
    for k, raw in enumerate(zip(*laws, strict=True)):
        columns = problem.acting(list(raw), joint)
        if term.per_run:
            columns = problem.by_run(columns, int(effect.variation.relative))
        free = np.full(columns.shape[-1], np.inf)
        key = ("free", words, j, effect.name, k)
        columns = np.moveaxis(columns, 0, 1) if effect.scope.whole else columns
        out.append(Group(key, joint, columns, -free, free, np.zeros(free.size)))
    return out


# ------------------------------------------------------------ candidates against each other

#: Draws of the bootstrap.
DRAWS = 400


def drawn_best(
    own: Candidate, rated: list[Rated], moves: NDArray[np.bool_]
) -> list[tuple[Rated, float]]:
    """How often each effect does best, with weights of blocks drawn from Dirichlet(1, .., 1).

    One that is as good as the best, within what a law may miss, and has no more to fit, is best.

    Source: Rubin, Ann. Statist. 9, 1981; Yao, Vehtari, Simpson, Gelman, Bayesian Analysis 13, 2018
    (pseudo-BMA+).
    """
    mine = next(r for r in rated if r.candidate is own)
    near = [r for r in rated if r.joint == mine.joint and r.fall.size == mine.fall.size]
    # over all joints: what a law of two joints takes on the other one is its own, too
    noise = np.minimum.reduce([r.errors.power for r in near])
    weight = moves / np.maximum(noise, 1e-300)
    falls = np.stack([(r.now.squared - r.errors.squared) @ weight for r in near])
    draws = np.random.default_rng(0).dirichlet(np.ones(falls.shape[1]), DRAWS)
    total = draws @ falls.T
    top = total.max(axis=1)
    order = sorted(
        range(len(near)), key=lambda k: (near[k].candidate is not own, near[k].candidate.dof)
    )
    good = total >= (top * (1 - DISCREPANCY))[:, None]
    first = np.argmax(good[:, order], axis=1)
    share = np.bincount(first, minlength=len(near)) / DRAWS
    return [(near[k], float(share[n])) for n, k in enumerate(order)]


# ------------------------------------------------------------ names against free functions


def shares(
    result: FitResult,
    split: Split,
    found: Sequence[Candidate],
    first: FloatArray,
    floor: FloatArray,
) -> dict[Key, tuple[float, str]]:
    """What each name takes of all that it and any free function take, and that one's variables.

        share = D / (D + G),

    D the fall of the held-out mean square error by the name, and G by how much a free function
    does better: in its place, against the fall by that name; or beside all names of the joint,
    against the fall by them together.  Only what is sure of G counts.  Where one function in the
    place of several names takes most of what all of them leave, they stand for it: none is shown.

    Parameters
    ----------
    result : FitResult
        The last model.
    split : Split
        Blocks and folds.
    found : sequence of Candidate
        Its names.
    first : ndarray (d,)
        Held-out mean square errors of the model that names are judged against.
    floor : ndarray (d,)
        Noise floor, rms [N m or N].
    """
    problem, out = result.problem, dict[Key, tuple[float, str]]()
    if result.model.explains != "motor" or not found:
        return out
    base = model_groups(result)
    for j in sorted({c.joint for c in found}):
        free = [g for what in COMPETITORS if (g := competitor(problem, j, what)) is not None]
        for c in (c for c in found if c.joint == j):
            free += foils(problem, c.term)
        race = _Race(GramTable(problem, split, result.sigma, base, free), free, j)
        every = [g.key for g in base]
        taken = float(first[j]) - race.power(every)
        beside = race.best(every, every)
        instead = race.proxies(every, [c.term.key for c in found if c.joint == j], floor[j] ** 2)
        for c in (c for c in found if c.joint == j):
            if instead:
                out[c.term.key] = (HALF, instead)
                continue
            rest = [k for k in every if k != c.term.key]
            own = race.power(rest) - race.power(every)
            gain, words = beside
            out[c.term.key] = (taken / (taken + gain) if taken > 0 else 0.0, words)
            # what it took the place of is not there to be put back
            if not comes_back(c.term, result.model, problem.joints):
                gain, words = race.best(rest, every)
                stands = own > 0 and gain <= (0.0 if words == FOIL else BEATEN) * own
                out[c.term.key] = min(
                    out[c.term.key], (own / (own + gain) if stands else 0.0, words)
                )
    return out


@dataclass(frozen=True)
class _Race:
    """A model of one joint, and free functions that run against its names."""

    table: GramTable
    free: list[Group]
    joint: int

    def power(self, keys: Sequence[Hashable]) -> float:
        """Held-out mean square error of the joint."""
        return float(self.table.errors(keys).power[self.joint])

    def proxies(self, every: Sequence[Hashable], names: Sequence[Key], floor: float) -> str:
        """The function that several names stand for; nothing where they do not, or reach the floor.

        By itself it leaves less than `OPEN` of the power that all of them leave above the floor.
        """
        left = self.power(every)
        if len(names) < 2 or HALF * left < floor:
            return ""
        gain, words = self.best([k for k in every if k not in names], every)
        return words if left - gain - floor < OPEN * (left - floor) else ""

    def best(self, keys: Sequence[Hashable], against: Sequence[Hashable]) -> tuple[float, str]:
        """What is sure of how much the best function with `keys` does better than `against`.

        Sure by the fall of the squared error of blocks, or by that of its logarithm: where a few
        blocks hold most of the error, the first says little of the rest.
        """
        start, j = self.table.errors(against), self.joint
        gain, words = 0.0, ""
        for g in self.free:
            after = self.table.errors([*keys, g.key])
            fall = start.squared[:, j] - after.squared[:, j]
            sure = float(start.power[j] - after.power[j])
            size = max(float(after.squared[:, j].mean()), 1e-300)
            ratio = np.log((start.squared[:, j] + size) / (after.squared[:, j] + size))
            certain = max(paired(fall), paired(ratio), 1e-9)
            sure *= max(1.0 - SURE / certain, 0.0)
            if sure > gain:
                gain, words = sure, str(g.key[1])  # type: ignore[index]
        return gain, words
