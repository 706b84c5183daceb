"""Which orders over position and lines over time deserve an exact fit: all are tried at once.

For columns c(p) = w [sin 2 pi p q, cos 2 pi p q] that pass a linear filter F, the product with a
residual r is c' F' r: the filter is applied once, to r, and not to every column.  The columns'
length follows from the filter's gain g at the frequency p |v| at which they oscillate,

    |F c|^2 = n / 2  mean[w^2 g(p |v|)^2],      gain = |c' F' r|^2 / |F c|^2,

which leaves out only what the other columns take away.  Exact fits follow for the best orders.

Over time a filtered sinusoid keeps its frequency, so the filter's gain cancels: over n moving
instants, by one Fourier transform,

    gain(f) = |sum_k r_k exp(-2 pi i f t_k)|^2 / (n / 2).

Runs add up, each with its own phase.  A line at a multiple of the rate at which the motion repeats
itself could as well be the motion's own: those frequencies are not proposed.  So it is looked
whether a motion repeats itself, and after how long.

Which shapes of a grid are tried, what is left by them, and which of equals is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.fft
import scipy.ndimage
from numpy.typing import NDArray

from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.regression import period
from hil.models.effect import Lines, Waves, terms_of

FloatArray = NDArray[np.float64]
#: Frequencies that are fitted exactly.
EXACT_LINES = 12
#: Zero padding: how much finer the transform is than the run resolves.
FINE = 4
#: Neighbours on either side out of which a line must stand, in grid steps.
LINE_NEIGHBOURS = 30
#: A line of the motion exceeds its neighbourhood by this factor.
PROMINENT = 6.0
#: Values that are transformed at once, so that they stay in the processor's cache.
LINE_BATCH = 2**17
#: A servo answers a disturbance with at most this multiple of it, resonance included.
ANSWER = 3.0


def frequencies(problem: Problem, term: Term) -> FloatArray:
    """The term's grid [Hz], less what the effort filter hardly passes."""
    grid = problem.grid(term.effect, term.joint)
    f = np.array([s[0] for s in grid])
    return f[f <= problem.rates.effort]


def gains(problem: Problem, j: int, rows: NDArray[np.floating], f: FloatArray) -> FloatArray:
    """Approximate gain of a sinusoid at each frequency, shape (..., f) for rows (..., n)."""
    out = np.zeros((*rows.shape[:-1], f.size))
    for k in range(len(problem.recordings)):
        own = rows[..., problem.run == k]
        moving = max(float(np.sum(problem.live[j, problem.run == k])), 1.0)
        size = scipy.fft.next_fast_len(FINE * own.shape[-1], real=True)
        # the nearest of the transform's frequencies, a fraction of the run's resolution away
        where = np.rint(f * size / problem.rate).astype(int)
        lines = scipy.fft.rfft(own, size, axis=-1)[..., np.minimum(where, size // 2)]
        out += (lines.real**2 + lines.imag**2) / (moving / 2)
    return out


def promising_lines(
    problem: Problem, term: Term, rows: FloatArray, effort: FloatArray
) -> list[tuple[float, ...]]:
    """Frequencies that deserve an exact fit to the residual rows (n,) of the joint; may be none.

    A line of the motion is its own where the effort (n,), in the unit of the rows, does far more
    there than answer the residual: a disturbance shakes the robot, too, but the servo's answer
    to it is hardly larger than itself.
    """
    f = frequencies(problem, term)
    f = f[~locked(problem, f)]
    if not f.size:
        return []
    answered = ANSWER**2 * gains(problem, term.joint, rows, f)
    f = f[~(moved(problem, f) & (gains(problem, term.joint, effort, f) > answered))]
    if not f.size:
        return []
    power = gains(problem, term.joint, rows, f)
    best = np.argsort(-power)[:EXACT_LINES]
    best = best[power[best] > band(power)[best]]
    return [(float(x),) for x in np.sort(f[best])]


def band(power: FloatArray) -> FloatArray:
    """What noise reaches with one percent probability, from the median of the neighbourhood.

    The power of noise is exponentially distributed, its median ln 2 of its mean; the largest of
    N stays below  mean ln(N / 0.01).
    """
    near = min(2 * LINE_NEIGHBOURS + 1, 2 * ((power.size - 1) // 2) + 1)
    mean = scipy.ndimage.median_filter(power, near, mode="nearest") / np.log(2.0)
    out: FloatArray = mean * np.log(power.size / 0.01)
    return out


def locked(problem: Problem, f: FloatArray) -> NDArray[np.bool_]:
    """Frequencies within the resolution of a multiple of the motion's own repetition."""
    out = np.zeros(f.size, dtype=bool)
    for k in range(len(problem.recordings)):
        lag = period(problem, k)
        if lag:
            turns = f * lag / problem.rate
            length = float(np.sum(problem.run == k)) / lag
            out |= np.abs(turns - np.rint(turns)) < 1.0 / length
    return out


def moved(problem: Problem, f: FloatArray) -> NDArray[np.bool_]:
    """Frequencies at which the motion itself has a line: whatever is missing may show there.

    The speed's amplitude within two steps of the run's resolution, against its neighbourhood's.
    """
    out = np.zeros(f.size, dtype=bool)
    for k in range(len(problem.recordings)):
        lines = _lines(problem, k)
        where = np.rint(f * np.sum(problem.run == k) / problem.rate).astype(int)
        out |= lines[np.minimum(where, lines.size - 1)]
    return out


def _lines(problem: Problem, k: int) -> NDArray[np.bool_]:
    """Frequencies of run k at which the motion has a line; made once."""
    if ("lines", k) not in problem.memo:
        v = problem.qd[:, problem.run == k]
        window = np.hanning(v.shape[1])
        size = np.abs(scipy.fft.rfft((v - v.mean(axis=1, keepdims=True)) * window, axis=1))
        near = scipy.ndimage.maximum_filter1d(size, 5, axis=1)
        wide = scipy.ndimage.median_filter(size, (1, 2 * LINE_NEIGHBOURS + 1), mode="nearest")
        problem.memo["lines", k] = np.any(near > PROMINENT * wide, axis=0)
    out: NDArray[np.bool_] = problem.memo["lines", k]
    return out


def flipped(
    problem: Problem, term: Term, noise: FloatArray, blocks: NDArray[np.int_], signs: FloatArray
) -> FloatArray:
    """Largest gain over all frequencies for each row of block signs, shape (flips,).

    Parameters
    ----------
    noise : ndarray (n,)
        Weighted noise on the joint's rows.
    blocks : ndarray (n,)
        Block of each row.
    signs : ndarray (flips, blocks)
        Signs of the blocks.
    """
    f = frequencies(problem, term)
    best = np.zeros(len(signs))
    if not f.size:
        return best
    # single precision: an error of 1e-7 of what the luckiest line of noise explains
    single = noise.astype(np.float32)
    turns = signs.astype(np.float32)
    for part in np.array_split(
        np.arange(len(signs)), max(1, len(signs) * noise.size // LINE_BATCH)
    ):
        rows = single * turns[part][:, blocks]
        best[part] = gains(problem, term.joint, rows, f).max(axis=-1)
    return best


#: Instants beyond which the screening uses every second, third, ... one.
ENOUGH = 8000
#: Orders that are fitted exactly, how many of them first, and from how many on it pays to choose.
EXACT_FEW, FIRST, MANY = 10, 3, 24
#: Exact over approximate gain: in 95 of 100 orders that promise much it is less than this.
GAIN_RATIO = 1.7


@dataclass(frozen=True)
class Screen:
    """Waves of one periodic term over its whole grid.

    Parameters
    ----------
    wave : ndarray (orders, n) of complex
        exp(2 pi i p q), at the evaluation rate.
    size : ndarray (2, orders)
        Squared length of each filtered column, of both harmonics.
    carrier : ndarray (n,)
        Factor w of the columns, times the stride.
    stride : int
        Every how many-th instant is used.
    """

    wave: NDArray[np.complex64]
    size: FloatArray
    carrier: FloatArray
    stride: int

    @property
    def twice(self) -> NDArray[np.complex64]:
        """The same at twice the order; made when asked, for it is as large."""
        return self.wave**2

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
        for power, size in enumerate(self.size, start=1):
            wave = self.wave if power == 1 else self.twice
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
        _waves(problem, j, orders, q[::stride]),
        k,
        size,
        w[::stride] * stride,
        stride,
        [_overtone(orders, m) for m in range(2, columns // 2 + 1)],
    )


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
    wave = _waves(problem, j, orders, q[::stride])
    few = slice(None, None, max(1, q.size // 400))
    size = np.empty((2, orders.size))
    for k, p in enumerate((orders, 2 * orders)):
        gain = 1.0 / (1.0 + (np.abs(p[:, None] * v[few]) / problem.rates.effort) ** 8)
        size[k] = problem.count[j] / 2 * np.mean((w[few] * gain) ** 2, axis=1)
    # an order that the filter takes out altogether has no evidence
    size = np.maximum(size, 1e-3 * size.max())
    return Screen(wave, size, w[::stride] * stride, stride)


def _waves(problem: Problem, j: int, orders: FloatArray, q: FloatArray) -> NDArray[np.complex64]:
    """exp(2 pi i p q), (orders, n); made once, for it holds the motion alone."""
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
        problem.memo[key] = wave
    found: NDArray[np.complex64] = problem.memo[key]
    return found


def promising(gains: FloatArray, count: int = EXACT_FEW) -> list[int]:
    """Indices of the best orders with their neighbours, in the order of the grid."""
    best = np.argsort(-gains)[:count]
    near = {int(k) + step for k in best[:3] for step in (-1, 0, 1)}
    return sorted({k for k in near | set(map(int, best)) if 0 <= k < gains.size})


#: Difference of gains that is none, relative to the gain, and to what it leaves: the first of a
#: grid's equals is taken.  Where hardly anything is left, much of it is little of the gain.
FLAT, REST = 5e-4, 0.1
#: What is left, in units of the least, from which a simpler shape will do.
CLOSE = 1.01


def grid_of(problem: Problem, term: Term) -> list[tuple[float, ...]]:
    """The effect's grid, from its least value on where one is known."""
    grid = problem.grid(term.effect, term.joint)
    least = problem.least.get(term.key)
    if least is None:
        return grid
    return [(least,), *(shape for shape in grid if shape[0] > least)]


def tried(
    projector: Projector, term: Term, grid: list[tuple[float, ...]]
) -> dict[tuple[float, ...], float]:
    """Gains of the part of a long grid that deserves an exact fit; of other grids, of all.

    Of orders over position those that promise most come first, with their neighbours; the others
    follow where they could still leave less than the best of these.
    """
    if isinstance(term.effect.search, Lines):
        rows, j = projector.rows(term), term.joint
        effort = projector.problem.effort[j] / projector.sigma[j]
        grid = promising_lines(projector.problem, term, projector.residual[rows], effort)
    waves = None if isinstance(term.effect.search, Lines) else screen(projector.problem, term, grid)
    if waves is None:
        return _gains(projector, term, grid)
    n, j = projector.problem.n, term.joint
    back = projector.problem.back(projector.residual[j * n : (j + 1) * n], j)
    near = waves.gains(back)
    out = _gains(projector, term, [grid[k] for k in promising(near, FIRST)])
    most = max(out.values())
    more = [k for k in promising(near) if GAIN_RATIO * near[k] > most and grid[k] not in out]
    out |= _gains(projector, term, [grid[k] for k in more])
    return dict(sorted(out.items()))


def _gains(
    projector: Projector, term: Term, shapes: list[tuple[float, ...]]
) -> dict[tuple[float, ...], float]:
    """Gains by shape."""
    if not shapes:
        return {}
    return dict(zip(shapes, projector.gains(term, shapes).tolist(), strict=True))


#: Share of the best gain from which a more usual form of an effect is taken.
USUAL = 0.99


def simplest(grid: list[tuple[float, ...]], gains: list[float], rest: list[float]) -> int:
    """Best index of the first form (all shape values but the first) with `USUAL` of the best gain.

    A grid lists its forms from the usual to the unusual one.
    """
    top = max(gains)
    for form in dict.fromkeys(shape[1:] for shape in grid):
        own = [k for k, shape in enumerate(grid) if shape[1:] == form]
        most = max(gains[k] for k in own)
        if most >= USUAL * top:
            none = next(flat(most, rest[k]) for k in own if gains[k] == most)
            return next(k for k in own if gains[k] >= most - none)
    return int(np.argmax(gains))


def flat(gain: float, rest: float) -> float:
    """Difference from a gain that is none."""
    return min(FLAT * abs(gain), REST * abs(rest))


def left(projector: Projector, term: Term, gain: float = 0.0) -> float:
    """What a gain leaves on a joint of the term, each joint having its share of the residual.

    Joints are weighted by their own residuals, so that these are alike; of the sum over all of
    them one joint's loss would seem small on a robot with many.
    """
    joints = 1 if term.effect.scope.whole else projector.problem.d
    return (projector.rss - gain) / joints
