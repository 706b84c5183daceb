"""Lines over time: every frequency of a residual tried at once, by one Fourier transform.

A filtered sinusoid keeps its frequency, so the filter's gain cancels: over n moving instants

    gain(f) = |sum_k r_k exp(-2 pi i f t_k)|^2 / (n / 2),

which leaves out only what the other columns take away.  Runs add up, each with its own phase.
A line at a multiple of the rate at which the motion repeats itself could as well be the
motion's own: those frequencies are not proposed.

Whether a motion repeats itself, and after how long.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
import scipy.ndimage
from numpy.typing import NDArray

from hil.identify.design import Term
from hil.identify.problem import Problem

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


def promising(
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


def period(problem: Problem, run: int) -> int:
    """Instants after which the motion of a run repeats itself; 0 if it does not.

    The shortest shift at which all positions agree to 2 % of their variation (rms) and
    speeds to 5 %, over at least half of the run.
    """
    if ("period", run) not in problem.memo:
        problem.memo["period", run] = _period(problem, run)
    return int(problem.memo["period", run])


def _period(problem: Problem, run: int) -> int:
    where = problem.run == run
    low, n = int(1.0 * problem.rate), int(np.sum(where))
    if n // 2 < low:
        return 0
    worst = np.zeros(n // 2 + 1 - low)
    for x, tolerance in ((problem.q[:, where], 0.02), (problem.qd[:, where], 0.05)):
        size = np.std(x, axis=1) + 1e-12
        apart = np.stack([_apart(row)[low:] for row in x]) / size[:, None]
        worst = np.maximum(worst, apart.max(axis=0) / tolerance)
    good = np.flatnonzero(worst < 1)
    if not good.size:
        return 0
    # the first valley, to its bottom
    first = good[good <= good[0] + 5]
    return low + int(first[np.argmin(worst[first])])


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
