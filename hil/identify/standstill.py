"""Standstill: where dry friction balances whatever acts, and no model can say how much.

A joint that sticks transmits any effort between minus and plus its break-away friction; that is
an inequality, not an equation, and least squares must not read it as one.  Left in, stiction
imitates a Stribeck peak, a delay or a ripple over position.  What counts as standing is decided
by the encoder: no displacement beyond its resolution for longer than any smooth reversal takes; and
by the speed, where an encoder resolves how a joint creeps while it sticks.

Source: Karnopp, J. Dyn. Syst. Meas. Control 107, 1985 (set-valued friction at zero speed).
"""

from __future__ import annotations

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from hil.record.jumps import resolution

FloatArray = NDArray[np.float64]
#: Share of the filter's window that may stand before an instant is left out.
TOLERATED = 0.7
#: Peak-to-peak noise of an encoder in standard deviations.
PEAK_TO_PEAK = 7.0
#: Periods of the position filter's cut-off by which each edge of a standstill is widened.
SMEAR = 0.35
#: Share of the rms speed below which a joint creeps within the stiffness of its friction, however
#: fine its encoder is.  Half: a dwell under integral action is motion; double: the slowest of
#: the strokes that show a Stribeck curve are none.
CREEP = 0.01
#: A joint with less than this share of its instants left keeps them all: poses are all there is.
SCARCE = 0.1
#: Resolutions within which a joint stays for nine tenths of the time that only holds its place.
HELD = 20.0


def position_noise(q: FloatArray) -> FloatArray:
    """Standard deviation of white noise in columns of positions (n, d), quantisation included."""
    second = np.diff(q, 2, axis=0)
    # white noise of variance s^2 in q gives 6 s^2 in its second difference; take the quiet half
    sigma = np.sqrt(np.median(second**2, axis=0) / 6 / 0.455)
    out: FloatArray = np.maximum(sigma, quanta(q) / np.sqrt(12))
    return out


def quanta(q: FloatArray) -> FloatArray:
    """Smallest step of each quantised column (d,); 0 where it is not quantised."""
    return np.array([resolution(q[:, j], exact=True) for j in range(q.shape[1])])


def standing(
    q: FloatArray, qd: FloatArray, qdd: FloatArray, fs: float, longest: float, cutoff: float
) -> FloatArray:
    """Where each joint stands still: 1 there, 0 elsewhere, shape (n, d).

    Parameters
    ----------
    q : ndarray (n, d)
        Positions as recorded [rad or m].
    qd, qdd : ndarray (n, d)
        Filtered velocities [rad/s or m/s] and accelerations [rad/s^2 or m/s^2].
    fs : float
        Sample rate [Hz].
    longest : float
        Longest window asked for [s]; standing for longer always counts.
    cutoff : float
        Of the position filter [Hz], which smears the edges of a standstill.
    """
    noise, quantum = position_noise(q), quanta(q)
    out = np.zeros(q.shape)
    for j in range(q.shape[1]):
        span = float(np.ptp(q[:, j]))
        band = max(
            PEAK_TO_PEAK * float(noise[j]) * (quantum[j] == 0), 1.01 * quantum[j], 1e-6 * span
        )
        typical = max(float(np.sqrt(np.mean(qdd[:, j] ** 2))), 1e-12)
        # a reversal with acceleration a stays within the band for sqrt(8 band / a)
        window = float(np.clip(1.5 * np.sqrt(8 * band / typical), 5 / fs, longest))
        speed = float(np.sqrt(np.mean(qd[:, j] ** 2)))
        # w = 1.5 sqrt(8 c v w / a): for so long a reversal is slower than the share c of v
        slow = max(longest, 1.5**2 * 8 * CREEP * speed / typical)
        edge = 2 * int(np.ceil(SMEAR / cutoff * fs))
        for within, time in ((band, window), (CREEP * speed * slow, slow)):
            out[:, j] = np.maximum(out[:, j], _within(q[:, j], within, time, fs, edge))
    return out


def _within(x: FloatArray, band: float, window: float, fs: float, edge: int) -> FloatArray:
    """1 where x (n,) stays within a band for a time [s], and `edge` samples around that."""
    size = 2 * int(np.ceil(window * fs / 2)) + 1
    high = scipy.ndimage.maximum_filter1d(x, size)
    still = (high - scipy.ndimage.minimum_filter1d(x, size) <= band).astype(np.float64)
    wide: FloatArray = scipy.ndimage.maximum_filter1d(still, size + (edge if np.any(still) else 0))
    return wide


def live(share: FloatArray) -> NDArray[np.bool_]:
    """Instants to keep, from the filtered standing share (n, d)."""
    keep = np.abs(share) <= TOLERATED
    return np.asarray(keep | (np.mean(keep, axis=0) < SCARCE))


def holding(q: FloatArray, grain: FloatArray) -> NDArray[np.bool_]:
    """Which joints only hold their place (d,): all but a tenth of q (n, d) within 20 grains (d,).

    What they do is the servo answering its encoder's steps: it says nothing of their mechanics.
    """
    low, high = np.quantile(q, (0.05, 0.95), axis=0)
    return np.asarray(high - low <= HELD * grain)
