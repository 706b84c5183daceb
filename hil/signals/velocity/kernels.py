"""Compiled steps of the velocity estimators; counts of one tick in, counts per period out.

Every kernel takes the counts of several channels and `steps`, the periods since the last call
(1 unless ticks were missed), and works on one row of state per channel.
"""

from __future__ import annotations

from math import fabs, pow
from typing import Any

import numba as nb


@nb.njit(cache=True, nogil=True)
def first_difference(counts: Any, state: Any, steps: int, out: Any) -> None:
    """V = (y_k - y_(k-1)) / T; state: last count."""
    for i in range(counts.size):
        out[i] = (counts[i] - state[i, 0]) / steps
        state[i, 0] = counts[i]


@nb.njit(cache=True, nogil=True)
def filtered_difference(counts: Any, state: Any, steps: int, beta: float, out: Any) -> None:
    """First-order low-pass of the first difference; state: last count, last output."""
    # v += (1 - (1 - beta)^steps) (difference - v), beta = 1 - exp(-2 pi f_c T)
    share = 1.0 - pow(1.0 - beta, steps)
    for i in range(counts.size):
        difference = (counts[i] - state[i, 0]) / steps
        state[i, 0] = counts[i]
        state[i, 1] += share * (difference - state[i, 1])
        out[i] = state[i, 1]


@nb.njit(cache=True, nogil=True)
def remember(counts: Any, past: Any, steps: int) -> None:
    """Move `counts` (n,) into `past` (n, window), in which the newest comes first.

    What lies between the last call and this one is filled in by a line.
    """
    window = past.shape[1]
    for i in range(counts.size):
        row, now = past[i], float(counts[i])
        last = row[0] if steps < window else now
        for k in range(window - 1, steps - 1, -1):
            row[k] = row[k - steps]
        for k in range(min(steps, window)):
            row[k] = now - (now - last) * k / steps


@nb.njit(cache=True, nogil=True)
def end_fit(counts: Any, past: Any, steps: int, noise: float, out: Any) -> None:
    """Counts per period through the two ends of the longest window that the noise allows.

    b_n = (y_k - y_(k-n)) / n; accept n while |y_k - b_n j - y_(k-j)| <= noise, 0 < j < n
    """
    remember(counts, past, steps)
    window = past.shape[1]
    for i in range(past.shape[0]):
        row = past[i]
        now, best = row[0], 0.0
        for n in range(1, window):
            b = (now - row[n]) / n
            if not _within(row, n, now, b, noise):
                break
            best = b
        out[i] = best


@nb.njit(cache=True, nogil=True)
def best_fit(counts: Any, past: Any, steps: int, noise: float, out: Any) -> None:
    """Counts per period of the least-squares line of the longest window that the noise allows.

    b_n = 6 sum_(i=0..n) (n - 2 i) y_(k-i) / (n (n + 1) (n + 2)); accepted as in `end_fit`
    """
    remember(counts, past, steps)
    window = past.shape[1]
    for i in range(past.shape[0]):
        row = past[i]
        now, best = row[0], 0.0
        plain, moment = 0.0, 0.0
        for n in range(1, window):
            # from the newest count on, for the weights sum to zero
            y = row[n] - now
            plain += y
            moment += n * y
            # sum (n - 2 i) y = n sum y - 2 sum i y
            b = 6.0 * (n * plain - 2.0 * moment) / (n * (n + 1.0) * (n + 2.0))
            if not _within(row, n, now, b, noise):
                break
            best = b
        out[i] = best


@nb.njit(cache=True, nogil=True)
def _within(row: Any, n: int, now: float, b: float, noise: float) -> bool:
    """Whether the line of slope b through the newest count passes all between within noise."""
    outside = 0
    for j in range(1, n):  # without a way out of the loop, so that it takes several at once
        outside += int(fabs(now - b * j - row[j]) > noise)
    return outside == 0


@nb.njit(cache=True, nogil=True)
def kalman(
    counts: Any, state: Any, spread: Any, steps: int, noise: float, drive: float, out: Any
) -> None:
    """Constant-velocity Kalman filter in counts and periods.

    Parameters
    ----------
    state : ndarray (n, 2)
        Position [counts] and velocity [counts per period].
    spread : ndarray (3,)
        Covariance p00, p01, p11, the same for all channels.
    noise, drive : float
        Variance of a count [counts^2], and of the acceleration per period [counts^2].
    """
    h = float(steps)
    p00, p01, p11 = spread[0], spread[1], spread[2]
    # P = F P F^T + Q, F = [[1, h], [0, 1]], Q = drive [[h^3/3, h^2/2], [h^2/2, h]]
    p00 += h * (2.0 * p01 + h * p11) + drive * h * h * h / 3.0
    p01 += h * p11 + drive * h * h / 2.0
    p11 += drive * h
    # K = P H^T / (H P H^T + R), H = [1, 0]
    k0, k1 = p00 / (p00 + noise), p01 / (p00 + noise)
    spread[2] = p11 - k1 * p01
    spread[1] = (1.0 - k0) * p01
    spread[0] = (1.0 - k0) * p00
    for i in range(counts.size):
        # count n stands for the interval n..n+1: take its middle
        ahead = state[i, 0] + h * state[i, 1]
        gap = counts[i] + 0.5 - ahead
        state[i, 0] = ahead + k0 * gap
        state[i, 1] += k1 * gap
        out[i] = state[i, 1]


@nb.njit(cache=True, nogil=True)
def low_passed_slope(
    value: Any, state: Any, steps: int, beta: float, period: float, out: Any
) -> None:
    """Low-pass of the first difference of `value`; state: last value, last output."""
    # a += beta ((v_k - v_(k-1)) / T - a)
    share = 1.0 - pow(1.0 - beta, steps)
    for i in range(value.size):
        slope = (value[i] - state[i, 0]) / (steps * period)
        state[i, 0] = value[i]
        state[i, 1] += share * (slope - state[i, 1])
        out[i] = state[i, 1]
