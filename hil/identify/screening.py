"""Which orders over position deserve an exact fit: all of them tried at once, approximately.

For columns c(p) = w [sin 2 pi p q, cos 2 pi p q] that pass a linear filter F, the product with a
residual r is c' F' r: the filter is applied once, to r, and not to every column.  The columns'
length follows from the filter's gain g at the frequency p |v| at which they oscillate,

    |F c|^2 = n / 2  mean[w^2 g(p |v|)^2],      gain = |c' F' r|^2 / |F c|^2,

which leaves out only what the other columns take away.  Exact fits follow for the best orders.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.models.effect import Waves, terms_of

FloatArray = NDArray[np.float64]
#: Instants beyond which the screening uses every second, third, ... one.
ENOUGH = 8000
#: Orders that are fitted exactly, how many of them first, and from how many on it pays to choose.
EXACT, FIRST, MANY = 10, 3, 24
#: Exact over approximate gain: in 95 of 100 orders that promise much it is less than this.
SURE = 1.7


@dataclass(frozen=True)
class Screen:
    """Waves of one periodic term over its whole grid.

    Parameters
    ----------
    wave : ndarray (orders, n) of complex
        exp(2 pi i p q), at the evaluation rate.
    twice : ndarray (orders, n) of complex
        The same at twice the order.
    size : ndarray (2, orders)
        Squared length of each filtered column, of both harmonics.
    carrier : ndarray (n,)
        Factor w of the columns, times the stride.
    stride : int
        Every how many-th instant is used.
    """

    wave: NDArray[np.complex64]
    twice: NDArray[np.complex64]
    size: FloatArray
    carrier: FloatArray
    stride: int

    def gains(self, back: FloatArray) -> FloatArray:
        """Approximate gains (orders,) of back-projected rows (n,)."""
        b = (back[:: self.stride] * self.carrier).astype(np.float32)
        out: FloatArray = (
            np.abs(self.wave @ b) ** 2 / self.size[0] + np.abs(self.twice @ b) ** 2 / self.size[1]
        )
        return out

    def flipped(self, back: FloatArray, blocks: NDArray[np.int_], signs: FloatArray) -> FloatArray:
        """Largest gain over all orders for each row of block signs (flips,)."""
        b = (back[:: self.stride] * self.carrier).astype(np.float32)
        number = blocks[:: self.stride]
        starts = np.flatnonzero(np.diff(number, prepend=-1))
        total = np.zeros((len(self.size[0]), len(signs)))
        for wave, size in ((self.wave, self.size[0]), (self.twice, self.size[1])):
            parts = _stretches(wave, b.astype(np.complex64), starts)
            total += _turned(parts, signs[:, number[starts]]) / size[:, None]
        return np.asarray(total.max(axis=0))


@dataclass(frozen=True)
class Ripples:
    """Waves over position whose size changes with their order: sum_m k^m w_m exp(i k q).

    Parameters
    ----------
    wave : ndarray (orders, n) of complex
        exp(2 pi i p q).
    k : ndarray (orders,)
        Wave numbers 2 pi p.
    size : ndarray (orders,)
        Squared length of each filtered column.
    factors : ndarray (n, m) of complex
        w_m, times the stride.
    stride : int
        Every how many-th instant is used.
    overtones : list of ndarray of int
        Place of twice, three times, ... each order, as the term has columns for them; the number
        of orders where the grid ends before.
    """

    wave: NDArray[np.complex64]
    k: FloatArray
    size: FloatArray
    factors: NDArray[np.complex128]
    stride: int
    overtones: list[NDArray[np.int_]]

    def _sums(self, b: FloatArray, starts: NDArray[np.int_]) -> NDArray[np.complex128]:
        """sum_m k^m wave w_m b over the stretches that begin at `starts`, (orders, stretches)."""
        own = (self.factors * b[:, None]).astype(np.complex64)
        powers = self.k[:, None] ** np.arange(self.factors.shape[1])
        return np.asarray(np.einsum("om,osm->os", powers, _stretches(self.wave, own, starts)))

    def gains(self, back: FloatArray) -> FloatArray:
        """Approximate gains (orders,) of back-projected rows (n,), overtones and all."""
        total = self._sums(back[:: self.stride], np.zeros(1, dtype=int))[:, 0]
        own = np.append(np.abs(total) ** 2 / self.size, 0.0)
        return np.asarray(own[:-1] + sum(own[k] for k in self.overtones))

    def flipped(self, back: FloatArray, blocks: NDArray[np.int_], signs: FloatArray) -> FloatArray:
        """Largest gain over all orders for each row of block signs (flips,)."""
        number = blocks[:: self.stride]
        starts = np.flatnonzero(np.diff(number, prepend=-1))
        parts = self._sums(back[:: self.stride], starts)
        gains = _turned(parts, signs[:, number[starts]]) / self.size[:, None]
        return np.asarray(gains.max(axis=0))


def _stretches(
    wave: NDArray[np.complex64], x: NDArray[np.complex64], starts: NDArray[np.int_]
) -> NDArray[np.complex64]:
    """Products (orders, stretches, ...) with x (n, ...), over the stretches that begin there."""
    edges = [*starts.tolist(), len(x)]
    return np.stack([wave[:, s:e] @ x[s:e] for s, e in pairwise(edges)], axis=1)


def _turned(parts: NDArray[np.complexfloating], signs: FloatArray) -> FloatArray:
    """|sum over stretches of sign times part|^2, (orders, flips), in the precision of the parts."""
    turns = np.ascontiguousarray(signs.T, dtype=parts.real.dtype)
    # the signs are real: two real products cost half of a complex one
    real, imaginary = (np.ascontiguousarray(x) @ turns for x in (parts.real, parts.imag))
    return np.asarray(real**2 + imaginary**2, dtype=np.float64)


def _ripples(problem: Problem, term: Term, grid: list[tuple[float, ...]]) -> Ripples | None:
    """Screen of a term with `powers`; None for any other."""
    j = term.joint
    search = term.effect.search
    if not isinstance(search, Waves):
        return None
    powers = [search.powers(m, j) for m in problem.motions]
    if any(w is None for w in powers):
        return None
    w = np.concatenate([x for x in powers if x is not None])
    q = np.concatenate([m.q[:, j] for m in problem.motions])
    v = np.concatenate([m.qd[:, j] for m in problem.motions])
    orders = np.array([s[0] for s in grid])
    stride, few = max(1, q.size // ENOUGH), slice(None, None, max(1, q.size // 400))
    k = 2 * np.pi * orders
    bent = np.sum(k[:, None, None] ** np.arange(w.shape[1]) * w[few], axis=2)
    gain = 1.0 / (1.0 + (np.abs(orders[:, None] * v[few]) / problem.rates.effort) ** 8)
    size = problem.count[j] / 2 * np.mean(np.abs(bent * gain) ** 2, axis=1)
    size = np.maximum(size, 1e-3 * max(float(size.max()), 1e-300))
    columns = len(terms_of(term.effect, problem.motions[0], j))
    return Ripples(
        _waves(problem, j, orders, q[::stride])[0], k, size, w[::stride] * stride, stride,
        [_overtone(orders, m) for m in range(2, columns // 2 + 1)],
    )  # fmt: skip


def _overtone(orders: FloatArray, m: int) -> NDArray[np.int_]:
    """Index of m times each order, the nearest there is; their number beyond the last one."""
    near = np.searchsorted((orders[1:] + orders[:-1]) / 2, m * orders)
    return np.where(m * orders > orders[-1], orders.size, near).astype(np.int_)


def screen(problem: Problem, term: Term, grid: list[tuple[float, ...]]) -> Screen | Ripples | None:
    """Screen of a term whose columns are harmonics over position; None for any other."""
    if len(grid) < MANY:
        return None
    key = ("screen", *term.key)
    known = problem.memo.get(key)
    if known is None or known[0] is not problem.motions or known[1] != grid:
        made = _ripples(problem, term, grid) or _screen(problem, term, grid)
        known = problem.memo[key] = (problem.motions, grid, made)
    found: Screen | Ripples | None = known[2]
    return found


def _screen(problem: Problem, term: Term, grid: list[tuple[float, ...]]) -> Screen | None:
    """Screen of a term with a `carrier`; None for any other."""
    j, search = term.joint, term.effect.search
    if not isinstance(search, Waves):
        return None
    carriers = [search.carrier(m, j) for m in problem.motions]
    if any(c is None for c in carriers):
        return None
    w = np.concatenate([c for c in carriers if c is not None])
    q = np.concatenate([m.q[:, j] for m in problem.motions])
    v = np.concatenate([m.qd[:, j] for m in problem.motions])
    orders = np.array([s[0] for s in grid])
    stride = max(1, q.size // ENOUGH)
    wave, twice = _waves(problem, j, orders, q[::stride])
    few = slice(None, None, max(1, q.size // 400))
    size = np.empty((2, orders.size))
    for k, p in enumerate((orders, 2 * orders)):
        gain = 1.0 / (1.0 + (np.abs(p[:, None] * v[few]) / problem.rates.effort) ** 8)
        size[k] = problem.count[j] / 2 * np.mean((w[few] * gain) ** 2, axis=1)
    # an order that the filter takes out altogether has no evidence
    size = np.maximum(size, 1e-3 * size.max())
    return Screen(wave, twice, size, w[::stride] * stride, stride)


def _waves(
    problem: Problem, j: int, orders: FloatArray, q: FloatArray
) -> tuple[NDArray[np.complex64], NDArray[np.complex64]]:
    """exp(2 pi i p q) and its square, (orders, n); made once, for they hold the motion alone."""
    key = ("waves", j, orders.size, float(orders[-1]))
    if key not in problem.memo:
        wave = np.empty((orders.size, q.size), dtype=np.complex64)
        steps = np.diff(orders)
        # equal steps: exp(i (a + h)) = exp(i a) exp(i h)
        now, turn = np.exp(2j * np.pi * orders[0] * q), np.exp(2j * np.pi * steps[0] * q)
        even = bool(np.ptp(steps) < 1e-9 * steps[0])
        for k in range(orders.size):
            wave[k] = now if even else np.exp(2j * np.pi * orders[k] * q)
            now *= turn
        problem.memo[key] = (wave, wave**2)
    wave, twice = problem.memo[key]
    return wave, twice


def promising(gains: FloatArray, count: int = EXACT) -> list[int]:
    """Indices of the best orders with their neighbours, in the order of the grid."""
    best = np.argsort(-gains)[:count]
    near = {int(k) + step for k in best[:3] for step in (-1, 0, 1)}
    return sorted({k for k in near | set(map(int, best)) if 0 <= k < gains.size})
