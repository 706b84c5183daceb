"""Weighted least squares that says what the data determine.

Columns are scaled to unit norm; directions of the parameter space whose effect on the
effort stays below one noise unit are left at the prior instead of fitted.

Blocks of time, within which residuals may depend on each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from hil.errors import FitError
from hil.identify.problem import Problem

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
#: Columns below this share of the largest are zero but for rounding.
RANK_ROUNDING = 1e-11


@dataclass(frozen=True)
class Basis:
    """Orthonormal basis of a regressor's determined directions.

    Parameters
    ----------
    q : ndarray (N, r)
        Orthonormal columns that span the determined part of the (weighted) regressor.
    s : ndarray (r,)
        Singular values of the column-scaled regressor.
    v : ndarray (p, r)
        Right singular vectors.
    scale : ndarray (p,)
        Column norms; 1 where a column is zero.
    """

    q: FloatArray
    s: FloatArray
    v: FloatArray
    scale: FloatArray

    @property
    def rank(self) -> int:
        """Number of determined directions."""
        return int(self.s.size)

    @property
    def condition(self) -> float:
        """Condition number of the column-scaled regressor over its determined directions."""
        return float(self.s[0] / self.s[-1]) if self.s.size else float("inf")

    def solve(self, y: FloatArray, prior: FloatArray, xprior: FloatArray) -> FloatArray:
        """Parameters closest to the prior among those that minimise |y - X theta|.

        `xprior` is X @ prior.
        """
        delta = self.v @ ((self.q.T @ (y - xprior)) / self.s)
        out: FloatArray = prior + delta / self.scale
        return out

    def identifiable(self, tolerance: float = 1e-4) -> BoolArray:
        """Parameters that lie in the determined directions, shape (p,)."""
        missing = 1.0 - np.sum(self.v**2, axis=1)
        out: BoolArray = missing < tolerance
        return out


def basis(x: FloatArray, noise_to_signal: float = 1e-9) -> Basis:
    """Basis of a weighted regressor.

    Parameters
    ----------
    x : ndarray (N, p)
        Weighted regressor.
    noise_to_signal : float
        Singular values of the column-scaled regressor below this are not determined;
        1 / |y / sigma| leaves out what moves the effort by less than one noise unit.
    """
    scale, live = unit_scale(np.linalg.norm(x, axis=0))
    q0, r = scipy.linalg.qr(x * live / scale, mode="economic", check_finite=False)
    return _determined(np.asarray(q0), np.asarray(r), scale, noise_to_signal)


def unit_scale(norm: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Scales (p,) of columns of some length (p,), 1 where they are zero; and which are not."""
    # a column that is nothing but rounding must not be scaled up to a direction of its own
    live = norm > max(1e-300, RANK_ROUNDING * float(norm.max(initial=0.0)))
    return np.where(live, norm, 1.0), live


def of_factors(q: Sequence[FloatArray], r: Sequence[FloatArray], least: float = 1e-9) -> Basis:
    """Basis of X = diag(Q_1 .. Q_d) [R_1; ..; R_d], each Q_j orthonormal (n_j, k_j)."""
    small = np.concatenate(r)
    b = basis(small, least)
    edges = np.cumsum([len(x) for x in r])[:-1]
    parts = [x @ y for x, y in zip(q, np.split(b.q, edges), strict=True)]
    return Basis(np.concatenate(parts), b.s, b.v, b.scale)


def _determined(q: FloatArray, r: FloatArray, scale: FloatArray, least: float) -> Basis:
    """Basis of Q R D without the directions whose singular value is below `least`."""
    u, s, vt = decomposed(r)
    keep = s > max(1e-9, least) * (s[0] if s.size else 1.0)
    k = int(np.sum(keep))
    return Basis(q @ u[:, :k], s[:k], vt[:k].T, scale)


def decomposed(a: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Thin singular value decomposition U, s, V' of a finite matrix (n, p).

    The usual algorithm of LAPACK (divide and conquer) gives up on some finite matrices; the
    slower one by QR steps decomposes them too.

    Raises
    ------
    FitError
        If the matrix is not finite.
    """
    _refuse_not_finite(a)  # LAPACK would print a line of its own
    try:
        u, s, vt = np.linalg.svd(a, full_matrices=False)
    except np.linalg.LinAlgError:
        u, s, vt = scipy.linalg.svd(a, full_matrices=False, lapack_driver="gesvd")
    return u, s, vt


def least_squares(a: FloatArray, y: FloatArray, rcond: float | None = None) -> FloatArray:
    """Solution of least norm of A x = y, (p,) or (p, k); algorithms as in `decomposed`."""
    _refuse_not_finite(a, y)
    try:
        x = np.linalg.lstsq(a, y, rcond=rcond)[0]
    except np.linalg.LinAlgError:
        x = scipy.linalg.lstsq(a, y, cond=rcond, lapack_driver="gelss")[0]
    return np.asarray(x, dtype=np.float64)


def _refuse_not_finite(*arrays: FloatArray) -> None:
    if not all(np.isfinite(a).all() for a in arrays):
        raise FitError(
            "the equations of the fit hold numbers that are infinite or none; values of the "
            "recording or of the model are out of any physical range: look at them with 'hil info'"
        )


def extended(b: Basis, columns: FloatArray, noise_to_signal: float = 1e-9) -> Basis:
    """Basis of [X, C] from the basis of X and k more weighted columns C (N, k).

    Zero columns have no part in it.
    """
    scale, live = unit_scale(np.linalg.norm(columns, axis=0))
    c = columns * live / scale
    # [X D^-1, C] = [Q, P] [S V', Q'C; 0, T]
    inner = b.q.T @ c
    p, t = scipy.linalg.qr(c - b.q @ inner, mode="economic", check_finite=False)
    top = np.concatenate([b.s[:, None] * b.v.T, inner], axis=1)
    bottom = np.concatenate([np.zeros((len(t), b.v.shape[0])), t], axis=1)
    both = np.concatenate([b.scale, scale])
    q = np.concatenate([b.q, p], axis=1)
    return _determined(q, np.concatenate([top, bottom]), both, noise_to_signal)


def cluster_covariance(residual: FloatArray, b: Basis, blocks: NDArray[np.int_]) -> FloatArray:
    """Covariance of the parameters that respects coloured and heteroscedastic residuals.

    Sandwich over blocks of time: (X'X)^-1 (sum_b X_b' r_b r_b' X_b) (X'X)^-1, times
    B / (B - 1) for B blocks; directions that are not determined have no part in it.

    Source: Liang and Zeger, Biometrika 73, 1986.

    Parameters
    ----------
    residual : ndarray (N,)
        Weighted residual.
    b : Basis
        Basis of the weighted regressor X.
    blocks : ndarray (N,)
        Block number of each row.
    """
    count = int(blocks.max()) + 1
    scores = np.zeros((count, b.rank))
    np.add.at(scores, blocks, b.q * residual[:, None])
    half = (b.v / b.s) / b.scale[:, None] @ scores.T
    out: FloatArray = half @ half.T * (count / max(count - 1, 1))
    return out


def inflation(
    residual: FloatArray, run: NDArray[np.int_], effort: FloatArray | None = None
) -> float:
    """Factor by which coloured residuals carry less information: 1 + 2 sum rho_k, at least 1.

    The sum stops at the first lag whose autocorrelation is below 0.05 (or after 5 % of the
    samples).  About a coefficient whose column makes a certain effort they carry
    1 + 2 sum rho_k sigma_k times less, sigma the autocorrelation of that effort: a slow remainder
    says little of a slow law and hardly disturbs a fast one.

    Source: Newey and West, Econometrica 55, 1987 (long-run variance of x r).

    Parameters
    ----------
    residual : ndarray (n,)
        Residual of one joint, runs one after the other.
    run : ndarray (n,)
        Run index.
    effort : ndarray (n,), optional
        What the coefficient explains; none: a constant.
    """
    r = residual - residual.mean()
    x = np.ones(r.size) if effort is None else effort - effort.mean()
    var, size = float(r @ r), float(x @ x)
    if var <= 0 or size <= 0:
        return 1.0
    total = 1.0
    for lag in range(1, max(2, r.size // 20)):
        same = run[lag:] == run[:-lag]
        rho = float((r[lag:] * r[:-lag])[same].sum() / var)
        if rho < 0.05:
            break
        own = 1.0 if effort is None else float((x[lag:] * x[:-lag])[same].sum() / size)
        total += 2 * rho * own
    return max(total, 1.0)


def period(problem: Problem, run: int) -> int:
    """Instants after which the motion of a run repeats itself; 0 if it does not, or between two.

    The shortest shift at which all positions agree to 2 % of their variation (rms) and
    speeds to 5 %, over at least half of the run.
    """
    return round(_repeats(problem, run)[0])


def _repeats(problem: Problem, run: int) -> tuple[float, float]:
    """That shift in whole instants, and between them; each 0 where there is none."""
    if ("period", run) not in problem.memo:
        problem.memo["period", run] = _shifts(problem, run)
    found: tuple[float, float] = problem.memo["period", run]
    return found


def _shifts(problem: Problem, run: int) -> tuple[float, float]:
    where = problem.run == run
    low, n = int(1.0 * problem.rate), int(np.sum(where))
    if n // 2 < low:
        return 0.0, 0.0
    each = []
    for x, tolerance in ((problem.q[:, where], 0.02), (problem.qd[:, where], 0.05)):
        size = (np.std(x, axis=1) + 1e-12) * tolerance
        each += [_apart(row) / s for row, s in zip(x, size, strict=True)]
    apart = np.stack(each)
    return _first_valley(apart, np.zeros_like(apart), low), _first_valley(*_valley(apart), low)


def _first_valley(apart: FloatArray, away: FloatArray, low: int) -> float:
    """First shift from `low` on at which all distances (k, shifts) are below one; 0 if none is."""
    joint, shift = np.argmax(apart, axis=0), np.arange(apart.shape[1])
    worst, offset = apart[joint, shift][low:], away[joint, shift][low:]
    good = np.flatnonzero(worst < 1)
    if not good.size:
        return 0.0
    # the first valley, to its bottom
    first = good[good <= good[0] + 5]
    at = int(first[np.argmin(worst[first])])
    return low + at + float(offset[at])


def _valley(apart: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least distance within half a shift of each one, and where: the square is a parabola there."""
    y = apart**2
    before, after = np.roll(y, 1, axis=1), np.roll(y, -1, axis=1)
    bend = before + after - 2 * y
    away = np.divide(before - after, 2 * bend, out=np.zeros_like(y), where=bend > 0)
    within = np.abs(away) <= 0.6  # half, and what rounding adds
    within[:, [0, -1]] = False
    away = np.where(within, away, 0.0)
    return np.sqrt(np.maximum(y - bend * away**2 / 2, 0.0)), away


def _apart(x: FloatArray) -> FloatArray:
    """Rms of x[l:] - x[:-l] for every shift l from 0 to n // 2, by one Fourier transform."""
    n = x.size
    x = x - x.mean()
    spectrum = np.abs(np.fft.rfft(x, 2 * n)) ** 2
    product = np.fft.irfft(spectrum)[: n // 2 + 1]
    power = np.concatenate([[0.0], np.cumsum(x**2)])
    shift = np.arange(n // 2 + 1)
    both = power[n - shift] + power[n] - power[shift]
    out: FloatArray = np.sqrt(np.maximum(both - 2 * product, 0.0) / (n - shift))
    return out


#: Blocks within one repetition of a motion from which on they are told by their phase.  Half: of
#: few blocks nothing is beyond chance; double: ten seconds that are repeated count as new ones.
PHASES = 12


def phases(problem: Problem, run: int, length: int) -> tuple[float, int]:
    """Instants of a repetition of a run's motion, and blocks in it; (0, 0) where there are few.

    A motion that repeats itself brings the same rounding of an encoder, the same instants between
    two samples at which friction turns, and the same places: what a model lacks there comes again.
    """
    lag = _repeats(problem, run)[1]
    count = int(lag // max(length, 1))
    return (lag, count) if count >= PHASES else (0.0, 0)


def time_blocks(problem: Problem, seconds: float = 1.0) -> NDArray[np.int_]:
    """Number of the time block of each instant, runs kept apart; shape (n,).

    Where a run's motion repeats itself all instants of one phase are one block.
    """
    length = max(1, round(seconds * problem.rate))
    out = np.empty(problem.n, dtype=int)
    offset = 0
    for k in range(len(problem.recordings)):
        where = np.flatnonzero(problem.run == k)
        lag, count = phases(problem, k, length)
        at = np.arange(where.size)
        own = (at % lag * count // lag if lag else at // length).astype(int)
        out[where] = offset + own
        offset += int(own.max()) + 1
    return out


#: Length of a direction, in columns of length one, below which it is rounding.
NOTHING = 1e-9


@dataclass(frozen=True)
class Nearness:
    """Which of the solutions that fit equally well is taken.

    Parameters
    ----------
    metric : ndarray (m, p)
        Rows R that measure a distance; zero for coefficients of which nothing is known.
    centre : ndarray (p,)
        What is known beforehand.
    moves : ndarray (p,)
        Coefficients that may be others.
    low, high : ndarray (p,)
        Bounds of the coefficients.
    """

    metric: FloatArray
    centre: FloatArray
    moves: NDArray[np.bool_]
    low: FloatArray
    high: FloatArray

    def __call__(self, theta: FloatArray, b: Basis) -> FloatArray:
        """Coefficients (p,) with the efforts of `theta`, within their bounds, nearest to these.

            argmin |R (pi - pi_0)|^2,    pi = theta + D^-1 N z,

        N (p, k) the directions that a basis leaves open, D its scales.  What nothing is known of
        takes what the others would have to leave the centre for.  A coefficient that comes to its
        bound stays there, and the others go on.

        Source: Nocedal, Wright, Numerical Optimization, 2006, 16.5 (bounds one after the other).
        """
        ways = _open(b, self.moves) if len(self.metric) else np.zeros((theta.size, 0))
        # what moves no body but for rounding (two offsets against each other) stays
        least = NOTHING * float(np.linalg.norm(self.metric @ ways))
        for _ in range(theta.size):
            rows = self.metric @ ways
            size = float(np.linalg.norm(rows))
            if size <= least:
                break
            # z = -(R D^-1 N)^+ R (theta - pi_0)
            z = least_squares(rows, self.metric @ (self.centre - theta), least / size)
            step = ways @ z
            part, first = _room(theta, step, self.low, self.high)
            theta = np.clip(theta + part * step, self.low, self.high)
            if part >= 1.0:
                break
            theta[first] = (self.high if step[first] > 0.0 else self.low)[first]
            ways = ways @ _beside(ways[first][:, None] / np.linalg.norm(ways[first]))
            ways[first] = 0.0
        return theta


def _open(b: Basis, moves: NDArray[np.bool_]) -> FloatArray:
    """D^-1 N (p, k): changes of coefficients that the data leave open.

    A column that no row sees, or that is held, stays.
    """
    seen = np.flatnonzero(np.linalg.norm(b.v, axis=1) > NOTHING)
    out = np.zeros((b.scale.size, max(seen.size - b.rank, 0)))
    if not out.size:
        return out
    ways = _beside(b.v[seen])
    if not np.all(moves[seen]):
        ways = ways @ scipy.linalg.null_space(ways[~moves[seen]], rcond=NOTHING)
        out = out[:, : ways.shape[1]]
    ways[np.linalg.norm(ways, axis=1) < NOTHING] = 0.0
    out[seen] = ways / b.scale[seen, None]
    return out


def _beside(v: FloatArray) -> FloatArray:
    """Orthonormal columns (k, k - r) orthogonal to some orthonormal ones (k, r)."""
    return np.asarray(np.linalg.qr(v, mode="complete")[0][:, v.shape[1] :])


def _room(
    theta: FloatArray, step: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[float, int]:
    """Largest part of a step within bounds, at most 1, and which coefficient comes to its own."""
    ahead = np.where(step > 0.0, high - theta, theta - low)
    ratio = np.full(theta.size, np.inf)
    np.divide(np.maximum(ahead, 0.0), np.abs(step), out=ratio, where=step != 0.0)
    first = int(np.argmin(ratio))
    return min(1.0, float(ratio[first])), first


def left_open(theta: FloatArray, start: FloatArray, b: Basis) -> FloatArray:
    """Where the directions that a basis leaves open stay, given their end `theta`: (p,)."""
    moved = (theta - start) * b.scale
    return np.asarray(start + (moved - b.v @ (b.v.T @ moved)) / b.scale)


#: Rms of a block over the middle one from which on it counts less.  Half: the same pushes are found
#: on simulated arms; double: one in six of the faintest is lost.
OUTLYING = 2.0
#: Rounds of reweighting.  Half or double: the same pushes are found.
ROUNDS = 10


def reweighted(x: FloatArray, r: FloatArray, blocks: NDArray[np.int_]) -> FloatArray:
    """What is left of residuals if blocks of rows that are far above the others count less.

    Least squares over and over, in which the rows of block b of joint j are multiplied by

        w_jb = min(1, k m_j / s_jb),    s_jb: rms of what is left in it, m_j: the median of s_jb.

    A squared error, which counts all alike, bends the fit toward what acts for a moment, and hides
    it.  Source: Huber, Robust Statistics, 1981, 7.8, who multiplies by the root: a push that is far
    above all others still counts there.

    Parameters
    ----------
    x : ndarray (d, n, p)
        Columns, in units of the noise; zero rows do not count.
    r : ndarray (d, n)
        Residuals in the same units.
    blocks : ndarray (n,) of int
        Block of each row, in long stretches.

    Returns
    -------
    ndarray (d, n)
        r - x theta with the weighted theta.
    """
    label = np.unique(blocks, return_inverse=True)[1]
    live = np.any(x != 0.0, axis=2) | (r != 0.0)
    count = np.stack([np.bincount(label, own) for own in live])
    full = count > 0.5 * count.max(axis=1, keepdims=True)
    weight, left = np.ones(count.shape), r
    for _ in range(ROUNDS):
        gram, right = np.zeros(2 * x.shape[2:]), np.zeros(x.shape[2])
        for columns, y, w in zip(x, r, weight[:, label], strict=True):
            weighted = columns * w[:, None]
            gram += weighted.T @ weighted
            right += weighted.T @ (y * w)
        left = r - x @ least_squares(gram, right)
        power = np.stack([np.bincount(label, y**2) for y in left]) / np.maximum(count, 1.0)
        middle = [
            float(np.median(p[f])) if f.any() else 1.0 for p, f in zip(power, full, strict=True)
        ]
        size = np.sqrt(power / np.maximum(middle, 1e-300)[:, None])
        weight = np.minimum(1.0, OUTLYING / np.maximum(size, 1e-300))
    return left
