"""Accelerations behind many low-pass filters at once, of which only the size is asked.

Each filter is that of `bands.derivatives`: a Butterworth cascade, forward and backward, and twice
the central difference.  A cascade waits for its own last value; several side by side do not wait
for each other, which is what makes this quick.
"""

from __future__ import annotations

import numba
import numpy as np
import scipy
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
#: Filters side by side, as `_cascade` has them.
ABREAST = 4
#: Coefficients b0, b1, b2, a1, a2 of a section, and its two states.
Section = tuple[float, float, float, float, float]
State = tuple[float, float]


def acceleration_power(q: FloatArray, fs: float, cutoffs: FloatArray) -> FloatArray:
    """Mean square of the filtered acceleration (cutoffs, d) of positions q (n, d).

    Parameters
    ----------
    q : ndarray (n, d)
        Evenly sampled positions [rad or m].
    fs : float
        Their rate [Hz].
    cutoffs : ndarray (cutoffs,)
        Cut-offs of a fourth order Butterworth filter, forward and backward [Hz].
    """
    filters = [scipy.signal.butter(4, f / (fs / 2), output="sos") for f in cutoffs]
    rests = [scipy.signal.sosfilt_zi(x) for x in filters]
    out = np.empty((len(cutoffs), q.shape[1]))
    for k in range(0, len(cutoffs), ABREAST):
        # the last ones again, where they are no multiple
        own = np.minimum(np.arange(k, k + ABREAST), len(cutoffs) - 1)
        sos, rest = (np.stack([x[i] for i in own], axis=1) for x in (filters, rests))
        edge = _edge(sos)
        for j in range(q.shape[1]):
            out[own, j] = _power(_odd(q[:, j], edge), sos, rest, edge, fs)
    return out


def _edge(sos: FloatArray) -> int:
    """Samples by which `scipy.signal.sosfiltfilt` extends a signal at either end."""
    zeros = (int(np.sum(sos[:, 0, k] == 0)) for k in (2, 5))
    return 3 * (2 * len(sos) + 1 - min(zeros))


def _odd(x: FloatArray, edge: int) -> FloatArray:
    """A signal with its ends turned round their last values."""
    return np.concatenate([2 * x[0] - x[edge:0:-1], x, 2 * x[-1] - x[-2 : -edge - 2 : -1]])


@numba.njit(cache=True, nogil=True)
def _section(sos: FloatArray, s: int, k: int) -> Section:
    c = sos[s, k]
    return c[0], c[1], c[2], c[4], c[5]


@numba.njit(cache=True, nogil=True)
def _next(u: float, c: Section, z: State) -> tuple[float, State]:
    """One value through a section (transposed direct form II)."""
    y = c[0] * u + z[0]
    return y, (c[1] * u - c[3] * y + z[1], c[2] * u - c[4] * y)


@numba.njit(cache=True, nogil=True)
def _cascade(x: FloatArray, sos: FloatArray, rest: FloatArray, start: int, step: int) -> None:
    """Sections (s, lanes, 6) in place over signals (n, lanes), from `start` on.

    `rest` (s, lanes, 2): states of a signal that has been one all the time.
    """
    for s in range(sos.shape[0]):
        if s == 0:
            first = x[start].copy()
        a, b = _section(sos, s, 0), _section(sos, s, 1)
        c, d = _section(sos, s, 2), _section(sos, s, 3)
        p = (rest[s, 0, 0] * first[0], rest[s, 0, 1] * first[0])
        q = (rest[s, 1, 0] * first[1], rest[s, 1, 1] * first[1])
        r = (rest[s, 2, 0] * first[2], rest[s, 2, 1] * first[2])
        t = (rest[s, 3, 0] * first[3], rest[s, 3, 1] * first[3])
        at = start
        for _ in range(x.shape[0]):
            x[at, 0], p = _next(x[at, 0], a, p)
            x[at, 1], q = _next(x[at, 1], b, q)
            x[at, 2], r = _next(x[at, 2], c, r)
            x[at, 3], t = _next(x[at, 3], d, t)
            at += step


@numba.njit(cache=True, nogil=True)
def _power(wide: FloatArray, sos: FloatArray, rest: FloatArray, edge: int, fs: float) -> FloatArray:
    """Mean square acceleration (lanes,) of one extended signal (n + 2 edge,)."""
    lanes, n = sos.shape[1], wide.size - 2 * edge
    x = np.empty((wide.size, lanes))
    for k in range(lanes):
        x[:, k] = wide
    _cascade(x, sos, rest, 0, 1)
    _cascade(x, sos, rest, wide.size - 1, -1)
    total, v = np.zeros(lanes), np.empty(n)
    for k in range(lanes):
        for i in range(n):
            low, high = max(i - 1, 0), min(i + 1, n - 1)
            v[i] = (x[edge + high, k] - x[edge + low, k]) * (fs / (high - low))
        for i in range(n):
            low, high = max(i - 1, 0), min(i + 1, n - 1)
            a = (v[high] - v[low]) * (fs / (high - low))
            total[k] += a * a
    return total / n
