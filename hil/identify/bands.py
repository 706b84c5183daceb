"""Choice of the filter band, and zero-phase derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from hil.errors import DataError
from hil.identify.standstill import position_noise
from hil.models.model import Band
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
#: Rms speed in units of its noise from which names of what varies fast are not the noise's: a
#: clean joint of 2000 counts got them at 10 and 25, and none at 18 and 30 behind narrower filters.
CLEAR = 30.0
#: Noise of the acceleration, in units of itself, from which the band is narrowed, and to which:
#: a model's effort holds it times the inertia.  From a half on the joint does not move.
NOISY, QUIET, IDLE = 0.125, 0.03, 0.5
#: Narrowest effort filter that is chosen [Hz].
NARROWEST = 4.0


@dataclass(frozen=True)
class Rates:
    """Cut-offs and rates of one identification [Hz].

    Parameters
    ----------
    position : float
        Cut-off of the position filter (4th order Butterworth, forward and backward).
    effort : float
        Cut-off of the filter that effort and every column pass.
    stride : dict of str to int
        Samples per evaluation instant, by run name.
    """

    position: float
    effort: float


def motion_bandwidth(recording: Recording) -> float:
    """Frequency below which 99.5 % of the speed's power lies, worst joint [Hz]."""
    fs, best = recording.rate, 0.0
    for j in range(recording.d):
        speed = np.diff(recording.q[:, j]) * fs
        f, power = scipy.signal.welch(speed, fs, nperseg=min(speed.size, int(8 * fs)))
        # quantisation gives a flat-to-rising floor: take what stands above the median level
        power = np.maximum(power - 3 * np.median(power), 0.0)
        total = np.cumsum(power)
        if total[-1] > 0:
            best = max(best, float(f[np.searchsorted(total, 0.995 * total[-1])]))
    return best


def choose(recordings: list[Recording], band: Band, moving: bool = False) -> Rates:
    """Filter band for a set of runs: given, or six times the motion's bandwidth in 12..25 Hz.

    The position filter is three times wider, so that what remains of a reversal is sharp
    against the effort filter and the acceleration noise is still bounded.  Where the model is of
    what moves (`moving`) and the positions are so coarse that no joint's speed stands clear of
    their noise, or that it is a good part of any moving joint's acceleration, both are narrower,
    down to `NARROWEST`.
    """
    slowest = min(r.rate for r in recordings)
    effort = band.effort_hz or float(
        np.clip(6 * max(motion_bandwidth(r) for r in recordings), 12.0, 25.0)
    )
    if moving and not (band.effort_hz or band.position_hz):
        widest = max(clear(r, 3 * effort) for r in recordings)
        if widest < 3 * effort:
            effort = max(widest / 3, NARROWEST)
        noise = max(shaken(r, effort) for r in recordings)
        if noise > NOISY:
            effort = max(effort * (QUIET / noise) ** 0.4, NARROWEST)
    effort = min(effort, slowest / 6)
    position = band.position_hz or min(3 * effort, 0.35 * slowest)
    return Rates(min(position, 0.45 * slowest), effort)


def clear(r: Recording, cutoff: float) -> float:
    """Largest cut-off up to this one [Hz] behind which a joint's speed is `CLEAR` of its noise.

    The noise of white steps s_q behind a filter of f is s_v = s_q 2 pi f sqrt(2 f / (3 fs)), so

        f = (v / CLEAR / (2 pi s_q) sqrt(3 fs / 2))^(2/3)

    for an rms speed v, of the joint where it is largest.
    """
    speed = np.sqrt(np.mean(derivatives(r.q, r.rate, min(cutoff, 0.35 * r.rate))[1] ** 2, axis=0))
    noise = np.maximum(position_noise(r.q), 1e-300)
    most = (speed / CLEAR / (2 * np.pi * noise) * np.sqrt(1.5 * r.rate)) ** (2 / 3)
    return min(cutoff, float(np.max(most)))


def shaken(r: Recording, cutoff: float) -> float:
    """Noise of the acceleration behind a cut-off, in units of its rms; worst joint that moves.

    White noise s_q of positions gives  s_a = s_q (2 pi)^2 sqrt(2 f^5 / (5 fs)).
    """
    noise = position_noise(r.q) * (2 * np.pi) ** 2 * np.sqrt(0.4 * cutoff**5 / r.rate)
    rms = np.sqrt(np.mean(derivatives(r.q, r.rate, min(cutoff, 0.35 * r.rate))[2] ** 2, axis=0))
    share = noise / np.maximum(rms, 1e-300)
    return float(np.max(share[share < IDLE], initial=0.0))


def derivatives(q: FloatArray, fs: float, cutoff: float) -> tuple[FloatArray, ...]:
    """Filtered position and its central differences, all (n, d).

    4th order Butterworth, forward and backward (zero phase), then central differences, as
    Gautier's inverse dynamic identification does.

    Raises
    ------
    DataError
        If the run is too short for the filter.
    """
    if len(q) < 60:
        raise DataError(f"a run of {len(q)} samples is too short to differentiate; record longer")
    sos = scipy.signal.butter(4, cutoff / (fs / 2), output="sos")
    smooth = scipy.signal.sosfiltfilt(sos, q, axis=0)
    speed = np.gradient(smooth, 1 / fs, axis=0)
    return smooth, speed, np.gradient(speed, 1 / fs, axis=0)


def smooth(x: FloatArray, fs: float, cutoff: float) -> FloatArray:
    """Zero-phase Butterworth filter of columns (n, ...)."""
    sos = scipy.signal.butter(4, cutoff / (fs / 2), output="sos")
    out: FloatArray = scipy.signal.sosfiltfilt(sos, x, axis=0)
    return out
