"""Held-out errors of many models from one pass over the rows.

With the rows of a block b as X_b and y_b, the products X_b'X_b, X_b'y_b and y_b'y_b are all that a
linear model needs: the coefficients of a fold are solved from the sum over the other folds, and
the squared error of a block is  y_b'y_b - 2 theta'X_b'y_b + theta'X_b'X_b theta.  No row is read
again for another subset of the columns.

Source: Shao, J. Am. Stat. Assoc. 88, 1993 (cross-validation of linear models).
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.folds import Split
from hil.identify.problem import Problem

FloatArray = NDArray[np.float64]
#: Rounds in which coefficients beyond a bound are put on it.
ROUNDS = 8


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


@dataclass(frozen=True)
class Errors:
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

    def fall(self, after: Errors, weight: FloatArray) -> FloatArray:
        """By how much `after` is lower, block by block (blocks,), joints weighted (d,)."""
        out: FloatArray = (self.squared - after.squared) @ weight
        return out


class Table:
    """Block-wise products of the columns of a model and of everything that may be added to it.

    Parameters
    ----------
    problem : Problem
        The runs.
    split : Split
        Blocks and folds.
    sigma : ndarray (d,)
        Scale of each joint's error, for joints that share coefficients.
    groups : iterable of Group
        All columns.
    """

    def __init__(
        self, problem: Problem, split: Split, sigma: FloatArray, groups: Iterable[Group]
    ) -> None:
        self.split, self.d, self._y = split, problem.d, problem.y
        self.groups = {g.key: g for g in groups}
        self._weight = 1.0 / sigma**2
        self._place: dict[Hashable, slice] = {}
        start = 0
        for g in self.groups.values():
            self._place[g.key] = slice(start, start + g.lower.size)
            start += g.lower.size
        self._joint_columns = [self._ids(j) for j in range(self.d)]
        self._scale = self._scales(problem, start)
        self._train: list[FloatArray] = []
        self._test: list[FloatArray] = []
        self.count = np.zeros((split.blocks, self.d))
        for j in range(self.d):
            self._products(problem, j)
        signal = sum(
            float(m[:, -1, -1].sum()) * w for m, w in zip(self._train, self._weight, strict=True)
        )
        #: Ridge in units of a column of length one: a direction that moves the effort by less than
        #: one noise unit stays at its prior.
        self.ridge = 1.0 / max(signal, 1.0)

    def _ids(self, j: int) -> NDArray[np.int_]:
        """Columns that act on joint j."""
        own = [g for g in self.groups.values() if g.joint in (None, j)]
        parts = [np.arange(self._place[g.key].start, self._place[g.key].stop) for g in own]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=int)

    def _rows(self, j: int) -> FloatArray:
        """Columns of joint j side by side (n, p)."""
        own = [g for g in self.groups.values() if g.joint in (None, j)]
        return np.concatenate([g.columns if g.joint == j else g.columns[j] for g in own], axis=1)

    def _scales(self, problem: Problem, size: int) -> FloatArray:
        """Weighted length of each column over all joints (p,), 1 where it is zero."""
        power = np.zeros(size)
        for j in range(self.d):
            x = self._rows(j)
            power[self._joint_columns[j]] += self._weight[j] * np.einsum("ij,ij->j", x, x)
        length = np.sqrt(power)
        least = 1e-11 * float(length.max(initial=0.0))
        self._live = length > max(least, 1e-300)
        return np.where(self._live, length, 1.0)

    def _products(self, problem: Problem, j: int) -> None:
        ids = self._joint_columns[j]
        rows = np.concatenate([self._rows(j) / self._scale[ids], problem.y[j][:, None]], axis=1)
        tested = self.split.tested & problem.live[j]
        train = np.zeros((self.split.folds, rows.shape[1], rows.shape[1]))
        test = np.zeros((self.split.blocks, rows.shape[1], rows.shape[1]))
        for b, (start, end) in enumerate(self.split.edges()):
            part, keep = rows[start:end], tested[start:end]
            train[self.split.fold[b]] += part.T @ part
            inner = part[keep]
            test[b] = inner.T @ inner
            self.count[b, j] = keep.sum()
        self._train.append(train)
        self._test.append(test)

    def errors(self, keys: Sequence[Hashable]) -> Errors:
        """Held-out errors of the model that consists of some groups."""
        theta, chosen = self.solutions(keys)
        squared = np.zeros((self.split.blocks, self.d))
        for j in range(self.d):
            ids, at = self._own(j, chosen)
            m = self._test[j][:, at[:, None], at]
            v = np.concatenate([theta[:, ids], -np.ones((len(theta), 1))], axis=1)
            each = v[self.split.fold]
            squared[:, j] = np.einsum("bi,bij,bj->b", each, m, each, optimize=True)
        return Errors(np.maximum(squared, 0.0), self.count)

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
        left = self._y[j].copy()
        for key, theta in self.coefficients(keys).items():
            g = self.groups[key]
            if g.joint in (None, j):
                left -= (g.columns if g.joint == j else g.columns[j]) @ theta
        return left

    def solutions(self, keys: Sequence[Hashable]) -> tuple[FloatArray, NDArray[np.int_]]:
        """Scaled coefficients of each fold (folds, p), fitted to the others, and their columns."""
        return self._solved(keys, whole=False)

    def _own(self, j: int, chosen: NDArray[np.int_]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """Which of the chosen columns act on joint j, and where they and y are in its products."""
        place = np.searchsorted(self._joint_columns[j], chosen)
        place = np.minimum(place, max(self._joint_columns[j].size - 1, 0))
        mine = np.flatnonzero(
            self._joint_columns[j][place] == chosen if self._joint_columns[j].size else []
        )
        return mine, np.append(place[mine], self._joint_columns[j].size)

    def _solved(self, keys: Sequence[Hashable], whole: bool) -> tuple[FloatArray, NDArray[np.int_]]:
        chosen = np.sort(
            np.concatenate([np.arange(self._place[k].start, self._place[k].stop) for k in keys])
        )
        p, folds = chosen.size, self.split.folds
        gram, right = np.zeros((folds, p, p)), np.zeros((folds, p))
        for j in range(self.d):
            ids, at = self._own(j, chosen)
            m = self._train[j][:, at[:, None], at] * self._weight[j]
            gram[:, ids[:, None], ids] += m[:, :-1, :-1]
            right[:, ids] += m[:, :-1, -1]
        every, both = gram.sum(axis=0), right.sum(axis=0)
        gram, right = (every[None], both[None]) if whole else (every - gram, both - right)
        return self._bounded(gram, right, every, both, chosen), chosen

    def _bounded(
        self, gram: FloatArray, right: FloatArray, every: FloatArray, both: FloatArray,
        chosen: NDArray[np.int_],
    ) -> FloatArray:  # fmt: skip
        """Solutions (k, p); coefficients that the whole data put beyond a bound lie on it."""
        parts = [self.groups[k] for k in self.groups]
        low, high, prior = (
            np.concatenate([getattr(g, name) for g in parts])[chosen] * self._scale[chosen]
            for name in ("lower", "upper", "prior")
        )
        shrink = np.concatenate([np.full(g.lower.size, g.shrink) for g in parts])[chosen]
        ridge = self.ridge + shrink * np.diag(every)
        held = np.where(self._live[chosen], np.nan, prior)
        for _ in range(ROUNDS):
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


def _ridge(
    gram: FloatArray, right: FloatArray, prior: FloatArray, held: FloatArray, ridge: FloatArray
) -> FloatArray:
    """Solutions (k, p) of several normal equations; `held` values are kept, NaN is free."""
    free = np.flatnonzero(np.isnan(held))
    start = np.where(np.isnan(held), prior, held)
    out = np.repeat(start[None], len(gram), axis=0)
    if free.size:
        left = right - gram @ start
        a = gram[:, free[:, None], free] + np.diag(ridge[free])
        out[:, free] += np.linalg.solve(a, left[:, free, None])[:, :, 0]
    return out
