"""Held-out errors: the one splitter, and the errors of many models from one pass over the rows.

Which instants are tested, and on which others is the model fitted then? A recording is cut into
many short blocks.  The ends of a block are a guard of the filter's length that is neither fitted
nor tested while the block is held out, so that no filtered sample is on both sides.  Blocks are
dealt to folds so that each fold is spread over the whole recording; with three runs or more a fold
is whole runs.  An instant counts as tested only where every joint is within positions, and moves in
a direction, that the other folds have seen: the rest would be extrapolation and is counted apart.

Source: Roberts et al., Ecography 40, 2017 (blocked cross-validation); Racine, J. Econometrics 99,
2000 (guards).

With the rows of a block b as X_b and y_b, the products X_b'X_b, X_b'y_b and y_b'y_b are all that a
linear model needs: the coefficients of a fold are solved from the sum over the other folds, and
the squared error of a block is  y_b'y_b - 2 theta'X_b'y_b + theta'X_b'X_b theta.  No row is read
again for another subset of the columns.  Of columns that enter a model one group at a time only the
products with those of the model and with themselves are made.

Source: Shao, J. Am. Stat. Assoc. 88, 1993 (cross-validation of linear models).
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.constants import BINS, FEWEST, FOLDS, GUARD, LEVELS, MOST, PARTS, PERIODS
from hil.identify.problem import Problem
from hil.identify.regression import least_squares
from hil.identify.result import FitResult
from hil.identify.solve import factors
from hil.models.model import BASE_EFFECTS

FloatArray = NDArray[np.float64]
#: Rounds in which coefficients beyond a bound are put on it.
BOUND_ROUNDS = 8


@dataclass(frozen=True)
class Split:
    """Blocks of time and the folds they are dealt to.

    Parameters
    ----------
    block : ndarray (n,)
        Block of each instant; blocks are contiguous and within one run.
    fold : ndarray (blocks,)
        Fold of each block.
    tested : ndarray (n,)
        Whether an instant is tested: no guard, and not beyond what the other folds have seen.
    extrapolated : ndarray (n,)
        Whether an instant is left out of the test because it is beyond what they have seen.
    by_run : bool
        Whether folds are whole runs.
    """

    block: NDArray[np.int_]
    fold: NDArray[np.int_]
    tested: NDArray[np.bool_]
    extrapolated: NDArray[np.bool_]
    by_run: bool

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.fold.size)

    @property
    def folds(self) -> int:
        """Number of folds."""
        return int(self.fold.max()) + 1

    def edges(self) -> list[tuple[int, int]]:
        """First instant of every block and the one after its last."""
        starts = np.flatnonzero(np.diff(self.block, prepend=-1))
        ends = [*starts[1:].tolist(), self.block.size]
        return list(zip(starts.tolist(), ends, strict=True))


def split(problem: Problem, seed: int = 0, whole_runs: bool = True) -> Split:
    """Deal the instants of a problem.

    Parameters
    ----------
    problem : Problem
        The runs.
    seed : int
        Of the order in which neighbouring blocks go to the folds.
    whole_runs : bool
        Whether folds may be whole runs; not where a run has coefficients of its own, which no
        other run determines.
    """
    block, inner = _blocks(problem)
    first = np.flatnonzero(np.diff(block, prepend=-1))
    run = np.asarray(problem.whole)[problem.run[first]]
    by_run = whole_runs and problem.runs >= 3
    fold = run % FOLDS if by_run else _dealt(first.size, seed)
    beyond = inner & _beyond(problem, fold[block])
    return Split(block, np.asarray(fold), inner & ~beyond, beyond, by_run)


def parts(dealt: Split) -> Split:
    """The same blocks in `PARTS` folds, each of which is one piece of the recording."""
    fold = np.arange(dealt.blocks) * PARTS // dealt.blocks
    return replace(dealt, fold=fold, tested=dealt.tested | dealt.extrapolated, by_run=False)


def levels(problem: Problem, dealt: Split) -> Split | None:
    """The same blocks in `LEVELS` folds: runs of little effort, and of much; None with few runs."""
    if problem.runs < 2 * LEVELS:
        return None
    whole = np.asarray(problem.whole)
    size = np.maximum(problem.rms(problem.effort), 1e-300)
    power = np.sum((problem.effort / size[:, None]) ** 2, axis=0)
    run = whole[problem.run]
    mean = np.bincount(run, power, problem.runs) / np.maximum(np.bincount(run), 1)
    order = np.argsort(np.argsort(mean))
    first = np.flatnonzero(np.diff(dealt.block, prepend=-1))
    fold = order[run[first]] * LEVELS // problem.runs
    return replace(dealt, fold=fold, tested=dealt.tested | dealt.extrapolated, by_run=False)


def _blocks(problem: Problem) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
    """Block of each instant, and whether it lies between the guards of its block."""
    period = problem.rate / problem.rates.effort
    sizes = np.bincount(problem.run)
    length = int(np.clip(sizes.sum() / MOST, PERIODS * period, max(sizes.sum() / FEWEST, 1)))
    guard = int(np.ceil(GUARD * period))
    if length < 4 * guard:
        guard = length // 4
    block, inner, count = [], [], 0
    for size in sizes:
        pieces = max(1, round(size / max(length, 1)))
        own = np.minimum(np.arange(size) * pieces // size, pieces - 1)
        block.append(own + count)
        inner.append(_inner(own, guard))
        count += pieces
    return np.concatenate(block), np.concatenate(inner)


def _inner(block: NDArray[np.int_], guard: int) -> NDArray[np.bool_]:
    """Whether instants of one run are `guard` away from the next block; ends of a run need none."""
    out = np.ones(block.size, dtype=bool)
    for edge in np.flatnonzero(np.diff(block)) + 1:
        out[max(edge - guard, 0) : edge + guard] = False
    return out


def _dealt(count: int, seed: int) -> NDArray[np.int_]:
    """Fold of each block: every FOLDS neighbours go to different folds, in random order."""
    folds, rng = max(2, min(FOLDS, count)), np.random.default_rng(seed)
    rounds = -(-count // folds)
    return np.concatenate([rng.permutation(folds) for _ in range(rounds)])[:count]


def _beyond(problem: Problem, fold: NDArray[np.int_]) -> NDArray[np.bool_]:
    """Instants at which a joint that moves is where no other fold has been in that direction."""
    out = np.zeros(problem.n, dtype=bool)
    folds = int(fold.max()) + 1
    for j in np.flatnonzero(~problem.holds):
        low, high = problem.q[j].min(), problem.q[j].max()
        place = np.clip((problem.q[j] - low) / max(high - low, 1e-12) * BINS, 0, BINS - 1)
        cell = place.astype(int) + BINS * (problem.qd[j] > 0)
        cells = np.zeros((folds, 2 * BINS))
        np.add.at(cells, (fold, cell), 1.0)
        rest = _neighbours(cells.sum(axis=0) - cells)
        out |= rest[fold, cell] == 0
    return out


def _neighbours(cells: FloatArray) -> FloatArray:
    """Counts (folds, 2 BINS) with those of the bins on either side, direction by direction."""
    wide = np.pad(cells.reshape(len(cells), 2, BINS), ((0, 0), (0, 0), (1, 1)))
    out: FloatArray = (wide[:, :, :-2] + wide[:, :, 1:-1] + wide[:, :, 2:]).reshape(len(cells), -1)
    return out


# ------------------------------------------------------------ errors without another look at a row


@dataclass(frozen=True)
class Group:
    """Columns that enter or leave a model together.

    Parameters
    ----------
    key : hashable
        Its name.
    joint : int or None
        The joint it acts on, None for all of them.
    columns : ndarray (n, m), or (d, n, m) where `joint` is None
        Filtered columns.
    lower, upper, prior : ndarray (m,)
        Bounds of the coefficients, and where they stay if no row determines them.
    """

    key: Hashable
    joint: int | None
    columns: FloatArray
    lower: FloatArray
    upper: FloatArray
    prior: FloatArray
    #: Added to the products of its columns, in units of their own: a free function is held small.
    shrink: float = 0.0
    #: Precision (m, m) with which its coefficients are known beforehand to lie at `prior`.
    precision: FloatArray | None = None


@dataclass(frozen=True)
class BlockErrors:
    """Squared held-out errors of one model.

    Parameters
    ----------
    squared : ndarray (blocks, d)
        Sum of squares over the tested instants of each block [(N m)^2 or N^2].
    count : ndarray (blocks, d)
        Tested instants at which the joint moves.
    """

    squared: FloatArray
    count: FloatArray

    @property
    def power(self) -> FloatArray:
        """Mean square by joint (d,)."""
        total = np.maximum(self.count.sum(axis=0), 1.0)
        out: FloatArray = self.squared.sum(axis=0) / total
        return out

    @property
    def rms(self) -> FloatArray:
        """Root mean square by joint (d,)."""
        return np.sqrt(self.power)

    def fall(self, after: BlockErrors, weight: FloatArray) -> FloatArray:
        """By how much `after` is lower, block by block (blocks,), joints weighted (d,)."""
        out: FloatArray = (self.squared - after.squared) @ weight
        return out


@dataclass(frozen=True)
class _Apart:
    """Products of a group that enters a model alone, X the model's p columns, C its own m.

    Parameters
    ----------
    cross, own, right : ndarray (folds, p, m), (folds, m, m), (folds, m)
        X'C, C'C and C'y of every fold, joints weighted and summed.
    tested : dict of int to (ndarray (blocks, p_j + 1, m), ndarray (blocks, m, m))
        [X_j, y_j]'C and C'C over the tested instants of each block, by joint.
    """

    cross: FloatArray
    own: FloatArray
    right: FloatArray
    tested: dict[int, tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class _Chosen:
    """Normal equations of some of the model's columns.

    Parameters
    ----------
    ids : ndarray (p,)
        The columns.
    every, both : ndarray (p, p), (p,)
        X'X and X'y of all instants.
    gram, right : ndarray (folds, p, p), (folds, p)
        The same without one fold.
    """

    ids: NDArray[np.int_]
    every: FloatArray
    both: FloatArray
    gram: FloatArray
    right: FloatArray


class GramTable:
    """Block-wise products of the columns of a model and of what may be added to it.

    Parameters
    ----------
    problem : Problem
        The runs.
    split : Split
        Blocks and folds.
    sigma : ndarray (d,)
        Scale of each joint's error, for joints that share coefficients.
    groups : iterable of Group
        Columns of the model, of which any may be chosen.
    apart : iterable of Group
        Columns of which one group at a time may be added.
    """

    def __init__(
        self,
        problem: Problem,
        split: Split,
        sigma: FloatArray,
        groups: Iterable[Group],
        apart: Iterable[Group] = (),
    ) -> None:
        self.split, self.d, self._y = split, problem.d, problem.y
        own = {g.key: g for g in groups}
        self.groups = own | {g.key: g for g in apart}
        self._weight = 1.0 / sigma**2
        self._place: dict[Hashable, slice] = {}
        start = 0
        for g in self.groups.values():
            self._place[g.key] = slice(start, start + g.lower.size)
            start += g.lower.size
        self._width = sum(g.lower.size for g in own.values())
        self._joint_columns = [self._ids(j, own.values()) for j in range(self.d)]
        self._scale = self._scales(start)
        p = self._width
        self._gram = np.zeros((split.folds, p, p))
        self._right = np.zeros((split.folds, p))
        self._test: list[FloatArray] = []
        self._apart = {k: self._nothing(g) for k, g in self.groups.items() if k not in own}
        self.count = np.zeros((split.blocks, self.d))
        signal = 0.0
        for j in range(self.d):
            self._products(j, split.tested & problem.live[j])
            signal += float(self._y[j] @ self._y[j]) * float(self._weight[j])
        #: Ridge in units of a column of length one: a direction that moves the effort by less than
        #: one noise unit stays at its prior.
        self.ridge = 1.0 / max(signal, 1.0)
        self._known: dict[tuple[Hashable, ...], _Chosen] = {}

    def _ids(self, j: int, groups: Iterable[Group]) -> NDArray[np.int_]:
        """Columns of some groups that act on joint j."""
        own = [g for g in groups if g.joint in (None, j)]
        parts = [np.arange(self._place[g.key].start, self._place[g.key].stop) for g in own]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=int)

    def _scales(self, size: int) -> FloatArray:
        """Weighted length of each column over all joints (p,), 1 where it is zero.

        Zero is what is rounding beside the columns of the model: a candidate whose state runs away
        says nothing of the other candidates.
        """
        power = np.zeros(size)
        for g in self.groups.values():
            for j in _joints(g, self.d):
                x = _rows(g, j)
                power[self._place[g.key]] += self._weight[j] * np.einsum("ij,ij->j", x, x)
        length = np.sqrt(power)
        known = length[: self._width] if self._width else length
        least = 1e-11 * float(known.max(initial=0.0))
        self._live = length > max(least, 1e-300)
        return np.where(self._live, length, 1.0)

    def _nothing(self, g: Group) -> _Apart:
        """Products of a group before any joint's are added."""
        folds, p, m = self.split.folds, self._width, g.lower.size
        cross, own = np.zeros((folds, p, m)), np.zeros((folds, m, m))
        return _Apart(cross, own, np.zeros((folds, m)), {})

    def _products(self, j: int, tested: NDArray[np.bool_]) -> None:
        """Products of joint j's rows, of which some are tested (n,)."""
        core = [g for k, g in self.groups.items() if k not in self._apart and g.joint in (None, j)]
        more = [self.groups[k] for k in self._apart if self.groups[k].joint in (None, j)]
        x = [_rows(g, j) / self._scale[self._place[g.key]] for g in (*core, *more)]
        x.insert(len(core), self._y[j][:, None])
        rows = np.concatenate(x, axis=1)
        edges = np.cumsum([0, *(part.shape[1] for part in x)])[len(core) + 1 :].tolist()
        train, test, self.count[:, j] = _by_block(rows, self.split, tested, edges)
        self._test.append(test[0])
        ids, w = self._joint_columns[j], float(self._weight[j])
        self._gram[:, ids[:, None], ids] += w * train[0][:, :-1, :-1]
        self._right[:, ids] += w * train[0][:, :-1, -1]
        first = edges[0]
        for g, a, b, inner, outer in zip(more, edges, edges[1:], train[2], test[2], strict=False):
            mine, cut = self._apart[g.key], slice(a - first, b - first)
            mine.cross[:, ids] += w * train[1][:, :-1, cut]
            mine.right[:] += w * train[1][:, -1, cut]
            mine.own[:] += w * inner
            mine.tested[j] = test[1][:, :, cut], outer

    def hold(self, key: Hashable, values: FloatArray) -> None:
        """Keep the coefficients (m,) of a group at these values in all folds."""
        self.groups[key] = replace(self.groups[key], lower=values, upper=values)

    def errors(self, keys: Sequence[Hashable]) -> BlockErrors:
        """Held-out errors of the model that consists of some groups."""
        return self.each([keys])[0]

    def each(self, models: Sequence[Sequence[Hashable]]) -> list[BlockErrors]:
        """Held-out errors of several models, each of some groups: products read once for all."""
        full = np.zeros((len(models), self.split.folds, self._width))
        added: list[tuple[Hashable, FloatArray] | None] = []
        same: dict[int, BlockErrors] = {}
        for out, keys in zip(full, models, strict=True):
            theta, chosen = self.solutions(keys)
            alone = self._alone(keys)
            own = chosen.size - (0 if alone is None else self.groups[alone].lower.size)
            if alone is not None and not np.any(theta[:, own:]):
                # nothing of it: not even rounding is to tell the two models apart
                same[len(added)], alone = self.errors([k for k in keys if k != alone]), None
            out[:, chosen[:own]] = theta[:, :own]
            added.append(None if alone is None else (alone, theta[self.split.fold, own:]))
        squared = np.zeros((len(models), self.split.blocks, self.d))
        for j in range(self.d):
            ids = self._joint_columns[j]
            v = np.concatenate([full[:, :, ids], np.full((*full.shape[:2], 1), -1.0)], axis=2)
            for k in range(self.split.folds):
                own_blocks = np.flatnonzero(self.split.fold == k)
                # v' M v of every model and block of the fold
                x = v[:, k].T
                squared[:, own_blocks, j] = np.sum((self._test[j][own_blocks] @ x) * x, axis=1).T
            for n, some in enumerate(added):
                if some is not None and j in self._apart[some[0]].tested:
                    (cross, inner), u = self._apart[some[0]].tested[j], some[1]
                    squared[n, :, j] += 2 * _forms(v[n, self.split.fold], cross, u)
                    squared[n, :, j] += _forms(u, inner, u)
        every = [BlockErrors(np.maximum(x, 0.0), self.count) for x in squared]
        return [same.get(k, x) for k, x in enumerate(every)]

    def left_out(self, keys: Sequence[Hashable]) -> FloatArray:
        """Residual (d, n) of the model of some groups, each block by the fit to the other folds.

        Zero where an instant is not tested.
        """
        theta, chosen = self.solutions(keys)
        full = np.zeros((self.split.folds, self._scale.size))
        full[:, chosen] = theta
        full /= self._scale
        fold = self.split.fold[self.split.block]
        out = self._y.copy()
        for key in keys:
            g, own = self.groups[key], full[:, self._place[key]]
            for j in range(self.d) if g.joint is None else [g.joint]:
                columns = g.columns if g.joint is not None else g.columns[j]
                out[j] -= np.einsum("nm,nm->n", columns, own[fold])
        return np.asarray(np.where(self.split.tested, out, 0.0))

    def coefficients(self, keys: Sequence[Hashable]) -> dict[Hashable, FloatArray]:
        """Coefficients of some groups fitted to all instants, by key."""
        theta, chosen = self._solved(keys, whole=True)
        full = np.zeros(self._scale.size)
        full[chosen] = theta[0]
        return {k: full[self._place[k]] / self._scale[self._place[k]] for k in keys}

    def residual(self, keys: Sequence[Hashable], j: int) -> FloatArray:
        """What the model of some groups leaves of joint j, fitted to all instants (n,)."""
        left: FloatArray = self._y[j].copy()
        for key, theta in self.coefficients(keys).items():
            g = self.groups[key]
            if g.joint in (None, j):
                left -= (g.columns if g.joint == j else g.columns[j]) @ theta
        return left

    def solutions(self, keys: Sequence[Hashable]) -> tuple[FloatArray, NDArray[np.int_]]:
        """Scaled coefficients of each fold (folds, p), fitted to the others, and their columns."""
        return self._solved(keys, whole=False)

    def _alone(self, keys: Sequence[Hashable]) -> Hashable | None:
        """The group among these that is not the model's; None if there is none."""
        found = [k for k in keys if k in self._apart]
        if len(found) > 1:
            raise ValueError(f"groups {found} are apart: one at a time may be added, not several")
        return found[0] if found else None

    def _of_model(self, keys: Sequence[Hashable]) -> _Chosen:
        """Normal equations of those of the groups that are the model's; made once."""
        own = tuple(k for k in keys if k not in self._apart)
        if own not in self._known:
            parts = [np.arange(self._place[k].start, self._place[k].stop) for k in own]
            ids = np.sort(np.concatenate([*parts, np.zeros(0, dtype=int)]))
            gram, right = self._gram[:, ids[:, None], ids], self._right[:, ids]
            every, both = gram.sum(axis=0), right.sum(axis=0)
            self._known[own] = _Chosen(ids, every, both, every - gram, both - right)
        return self._known[own]

    def _equations(self, keys: Sequence[Hashable]) -> _Chosen:
        """Normal equations of some groups."""
        c, alone = self._of_model(keys), self._alone(keys)
        if alone is None:
            return c
        a, place = self._apart[alone], self._place[alone]
        cross, p = a.cross[:, c.ids], c.ids.size
        ids = np.concatenate([c.ids, np.arange(place.start, place.stop)])
        gram = np.empty((len(cross) + 1, ids.size, ids.size))
        right = np.empty((len(cross) + 1, ids.size))
        gram[0, :p, :p], gram[1:, :p, :p] = c.every, c.gram
        right[0, :p], right[1:, :p] = c.both, c.right
        for out, x in ((gram[:, :p, p:], cross), (gram[:, p:, p:], a.own), (right[:, p:], a.right)):
            out[0] = x.sum(axis=0)
            out[1:] = out[0] - x
        gram[:, p:, :p] = gram[:, :p, p:].transpose(0, 2, 1)
        return _Chosen(ids, gram[0], right[0], gram[1:], right[1:])

    def _solved(self, keys: Sequence[Hashable], whole: bool) -> tuple[FloatArray, NDArray[np.int_]]:
        c = self._equations(keys)
        gram, right = (c.every[None], c.both[None]) if whole else (c.gram, c.right)
        return self._bounded(keys, gram, right, c), c.ids

    def _bounded(
        self, keys: Sequence[Hashable], gram: FloatArray, right: FloatArray, c: _Chosen
    ) -> FloatArray:
        """Solutions (k, p); coefficients that the whole data put beyond a bound lie on it."""
        chosen, every, both = c.ids, c.every, c.both
        parts = [self.groups[k] for k in sorted(keys, key=lambda k: self._place[k].start)]
        low, high, prior = (
            np.concatenate([getattr(g, name) for g in parts]) * self._scale[chosen]
            for name in ("lower", "upper", "prior")
        )
        shrink = np.concatenate([np.full(g.lower.size, g.shrink) for g in parts])
        ridge = np.diag(self.ridge + shrink * np.diag(every)) + self._precision(parts, chosen)
        held = np.where(self._live[chosen], np.nan, prior)
        held = np.where(low == high, low, held)
        for _ in range(BOUND_ROUNDS):
            theta = _ridge(every[None], both[None], prior, held, ridge)[0]
            slack = 1e-9 * np.maximum(np.abs(theta), 1e-300)
            beyond = np.maximum(low - theta, theta - high)
            worst = beyond > slack
            if not np.any(worst & np.isnan(held)):
                break
            # the worst first: the others may come back
            k = int(np.argmax(np.where(np.isnan(held), beyond, -np.inf)))
            held[k] = low[k] if theta[k] < low[k] else high[k]
        return _ridge(gram, right, prior, held, ridge)

    def _precision(self, parts: Sequence[Group], chosen: NDArray[np.int_]) -> FloatArray:
        """What is known beforehand of the scaled coefficients of some groups (p, p)."""
        out, end = np.zeros((chosen.size, chosen.size)), 0
        for g in parts:
            start, end = end, end + g.lower.size
            if g.precision is not None:
                length = self._scale[chosen[start:end]]
                out[start:end, start:end] = g.precision / length[:, None] / length
        return out


def _joints(g: Group, d: int) -> Sequence[int]:
    """Joints that a group acts on."""
    return range(d) if g.joint is None else (g.joint,)


def _rows(g: Group, j: int) -> FloatArray:
    """Columns of a group on joint j (n, m)."""
    return g.columns[j] if g.joint is None else g.columns


#: [X, y]'[X, y], [X, y]'C and the parts of C'C, each for several folds or blocks at once.
_Parts = tuple[FloatArray, FloatArray, list[FloatArray]]


def _by_block(
    rows: FloatArray, split: Split, tested: NDArray[np.bool_], edges: Sequence[int]
) -> tuple[_Parts, _Parts, FloatArray]:
    """Products of rows [X, y, C] (n, p) by fold, those of tested ones by block, and their number.

    `edges`: where the groups of C begin, and where the last one ends.
    """
    test = _together(rows, split.block, tested, split.blocks, edges)
    train = _together(rows, split.fold[split.block], ~tested, split.folds, edges)
    for k in range(split.folds):
        own = split.fold == k
        for into, x in zip(_flat(train), _flat(test), strict=True):
            into[k] += x[own].sum(axis=0)
    return train, test, np.bincount(split.block[tested], minlength=split.blocks).astype(float)


def _together(
    rows: FloatArray,
    label: NDArray[np.int_],
    some: NDArray[np.bool_],
    count: int,
    edges: Sequence[int],
) -> _Parts:
    """Products of some of the rows, those of one label (of `count`) together."""
    first = edges[0]
    x = _padded(rows, label, some, count)
    known = x[:, :, :first].transpose(0, 2, 1) @ x
    own = [x[:, :, a:b].transpose(0, 2, 1) @ x[:, :, a:b] for a, b in pairwise(edges)]
    return known[:, :, :first], known[:, :, first:], own


def _padded(
    rows: FloatArray, label: NDArray[np.int_], some: NDArray[np.bool_], count: int
) -> FloatArray:
    """Some of the rows (n, p) by label: (count, k, p), zeros after the last one of a label."""
    at = np.flatnonzero(some)
    at = at[np.argsort(label[at], kind="stable")]
    sizes = np.bincount(label[at], minlength=count)
    out = np.zeros((count, int(sizes.max(initial=0)), rows.shape[1]))
    within = np.arange(at.size) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    out[label[at], within] = rows[at]
    return out


def _flat(parts: _Parts) -> list[FloatArray]:
    return [parts[0], parts[1], *parts[2]]


def _forms(a: FloatArray, m: FloatArray, b: FloatArray) -> FloatArray:
    """Forms a' M b of several (k,): a (k, p), M (k, p, q), b (k, q)."""
    out: FloatArray = np.einsum("kp,kp->k", a, (m @ b[:, :, None])[:, :, 0])
    return out


def _ridge(
    gram: FloatArray, right: FloatArray, prior: FloatArray, held: FloatArray, ridge: FloatArray
) -> FloatArray:
    """Solutions (k, p) of several normal equations, drawn to `prior` by `ridge` (p, p).

    `held` values are kept, NaN is free.
    """
    free = np.flatnonzero(np.isnan(held))
    start = np.where(np.isnan(held), prior, held)
    out = np.repeat(start[None], len(gram), axis=0)
    if free.size:
        left = right - gram @ start - ridge @ (start - prior)
        a = gram[:, free[:, None], free] + ridge[free[:, None], free]
        out[:, free] += np.linalg.solve(a, left[:, free, None])[:, :, 0]
    return out


# ------------------------------------------------------------ other efforts of the same motion


class Reach:
    """Least errors of the base model over the motion of a fit.

    Parameters
    ----------
    result : FitResult
        The fit; of one with other terms than the base model's nothing is known.
    """

    def __init__(self, result: FitResult) -> None:
        self._known = all(t.effect.name in BASE_EFFECTS for t in result.terms)
        if self._known:
            problem = result.problem
            grids = ((t, problem.grid(t.effect, t.joint) or [t.shape]) for t in result.terms)
            terms = [replace(t, shape=s) for t, grid in grids for s in grid]
            with problem.aside():
                self._q, self._r = factors(problem, terms, np.ones(problem.d))

    def by_joint(self, y: FloatArray, effort: FloatArray) -> FloatArray:
        """Least relative error (d,) [%] for other efforts over the same motion.

        Joint by joint, as the least over all joints has it; 0 where nothing is known.

        Parameters
        ----------
        y, effort : ndarray (d, n)
            What the model is to explain of the efforts, and the efforts.

        Returns
        -------
        ndarray (d,)
            Shares of the rms effort [%].
        """
        if not self._known or any(len(q) != y.shape[1] for q in self._q):
            return np.zeros(len(y))
        size = np.sqrt(np.sum(effort**2, axis=1))
        weight = 100.0 / np.maximum(size, 1e-300)
        parts = zip(self._q, self._r, y, weight, strict=True)
        each = [(w * (q.T @ x), w * r, w * w * float(x @ x)) for q, r, x, w in parts]
        right = np.concatenate([c for c, _, _ in each])
        rows = np.concatenate([r for _, r, _ in each])
        theta = least_squares(rows, right)
        # what no column of its joint reaches, and what not all joints reach at once
        left = [whole - float(c @ c) + np.sum((c - r @ theta) ** 2) for c, r, whole in each]
        return np.sqrt(np.maximum(left, 0.0))
