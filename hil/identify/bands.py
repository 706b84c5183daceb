"""Where a recording says something: standstill, the filter band, and zero-phase derivatives.

A joint that sticks transmits any effort between minus and plus its break-away friction; that is
an inequality, not an equation, and least squares must not read it as one.  Left in, stiction
imitates a Stribeck peak, a delay or a ripple over position.  What counts as standing is decided
by the encoder: no displacement beyond its resolution for longer than any smooth reversal takes; and
by the speed, where an encoder resolves how a joint creeps while it sticks.

Source: Karnopp, J. Dyn. Syst. Meas. Control 107, 1985 (set-valued friction at zero speed).

Accelerations behind many low-pass filters at once, of which only the size is asked.

Each filter is that of `bands.derivatives`: a Butterworth cascade, forward and backward, and the
slope twice.  A cascade waits for its own last value; several side by side do not wait
for each other, which is what makes this quick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numba
import numpy as np
import scipy
import scipy.ndimage
from numpy.typing import NDArray

from hil.errors import DataError
from hil.models.kernels import slope
from hil.models.model import Band
from hil.record.jumps import resolution
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
#: Widest and narrowest effort filter that information alone chooses [Hz].  Wider than 25 the
#: resonances of the structure begin, which no joint model holds; narrower than 6 a reversal is no
#: longer told from a slow law (a seven-joint arm with lost rows: 10 to 12 % and no false name at
#: 6, 51 % and three at 25).  A doubled upper end adds noise of the counts, a halved lower one
#: takes what tells friction laws apart.
WIDEST, LEAST = 25.0, 6.0
#: Noise of the acceleration in units of its rms that is put up with, median of the joints that
#: move.  Halved, the band is a quarter narrower; doubled, a third wider (it goes as f^2.5).
ACCELERATION_NOISE = 0.05
#: Effort's power over its noise down to which a frequency is used: signal and noise alike (spectra
#: by Welch, IEEE Trans. Audio Electroacoustics 15, 1967).  Doubled, a cable arm's band goes from
#: 15 to 12 Hz, and the simulators' stay; halved, noise counts as signal.
ABOVE = 2.0
#: Times the motion's own bandwidth beyond which only the edges of reversals are left, and the
#: widest band that is not asked for it [Hz].  Halved, the clean simulators' bands shrink by half;
#: doubled, slow smooth motions are read to 25 Hz, where a sign's width is mistaken for physics.
HARMONICS, FREE = 8.0, 12.0
#: Length of the spectra's segments [s], bins that are averaged, and share of the rate from which
#: on a spectrum is taken for noise.
SEGMENT_S, AVERAGED, PLATEAU = 4.0, 9, 0.3
#: Highest effort and position cut-offs as shares of the rate at which things were truly measured:
#: the filter's skirt must end before half the rate.
HIGHEST_EFFORT, HIGHEST_POSITION = 0.2, 0.35
#: Rms speed in units of its noise from which names of what varies fast are not the noise's: a
#: clean joint of 2000 counts got them at 10 and 25, and none at 18 and 30 behind narrower filters.
CLEAR = 30.0
#: Noise of the acceleration, in units of itself, from which a joint does not move.
IDLE = 0.5
#: Narrowest effort filter that is chosen [Hz].
NARROWEST = 4.0
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
#: Rows of a recording in half a period of the effort filter below which so many steps without a
#: count are a standstill where the joint is turned sharply.  Half: sticks of slow recordings are
#: motion; double: so they are where rows are enough to tell.
FEW_ROWS, STUCK = 10.0, 2.0
#: A reversal with acceleration a stays within a band b for sqrt(8 b / a); and 1.5 times that.
_TURNS = 1.5**2 * 8
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


def white_noise(r: Recording, most: bool = True) -> FloatArray:
    """Standard deviation (d,) of the white noise of a recording's positions.

    That of their second differences or of their spectrum's upper end: the larger one, or the
    smaller one, for a fast motion is in both.
    """
    pick = np.maximum if most else np.minimum
    out: FloatArray = pick(position_noise(r.q), _plateau(r.q, r.rate))
    return out


def encoder_noise(r: Recording) -> FloatArray:
    """The same (d,) without the motion between two rows: the smaller one, or that of the counts."""
    out: FloatArray = np.maximum(white_noise(r, most=False), quanta(r.q) / np.sqrt(12))
    return out


def quanta(q: FloatArray) -> FloatArray:
    """Smallest step of each quantised column (d,); 0 where it is not quantised."""
    return np.array([resolution(q[:, j], exact=True) for j in range(q.shape[1])])


def standing(
    q: FloatArray,
    qd: FloatArray,
    qdd: FloatArray,
    fs: float,
    longest: float,
    cutoff: float,
    between: FloatArray | None = None,
) -> FloatArray:
    """Where each joint stands still: 1 there, 0 elsewhere, shape (n, d), or (m, d) of `between`.

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
    between : ndarray (m, d), optional
        Positions at instants between the rows too, where the rows are too far apart to tell for
        how long a joint creeps [rad or m]; m - 1 is a multiple of n - 1.
    """
    noise, quantum = position_noise(q), quanta(q)
    fine = q if between is None else between
    finer = (len(fine) - 1) // (len(q) - 1)
    out = np.zeros(fine.shape)
    for j in range(q.shape[1]):
        span = float(np.ptp(q[:, j]))
        band = max(
            PEAK_TO_PEAK * float(noise[j]) * (quantum[j] == 0), 1.01 * quantum[j], 1e-6 * span
        )
        typical = max(float(np.sqrt(np.mean(qdd[:, j] ** 2))), 1e-12)
        within = partial(_within, q[:, j], fs=fs, cutoff=cutoff)
        creeps = partial(_within, fine[:, j], fs=fs * finer, cutoff=cutoff)
        # a reversal with acceleration a stays within the band for sqrt(8 band / a)
        window = float(np.clip(np.sqrt(_TURNS * band / typical), 5 / fs, longest))
        speed = CREEP * float(np.sqrt(np.mean(qd[:, j] ** 2)))
        # w = 1.5 sqrt(8 c v w / a): for so long a reversal is slower than the share c of v
        slow = max(longest, _TURNS * speed / typical)
        rests, moves = within(band, window), creeps(speed * slow, slow)
        # for a shorter time where it is sharply accelerated before or after
        near = 2 * int(np.ceil(longest * fs)) + 1
        sharp = scipy.ndimage.maximum_filter1d(np.abs(qdd[:, j]), near)
        if slow > longest:
            quick = nearest((sharp > _TURNS * speed / longest).astype(float), 1 / finer)
            moves = np.maximum(moves, creeps(speed * longest, longest) * quick)
        brief = STUCK / fs
        if fs * longest < FEW_ROWS and brief < window:
            rests = np.maximum(rests, within(band, brief) * (sharp > _TURNS * band / brief**2))
        out[:, j] = np.maximum(nearest(rests, 1 / finer), moves)
    return out


def _within(x: FloatArray, band: float, window: float, *, fs: float, cutoff: float) -> FloatArray:
    """1 where x (n,) stays within a band for a time [s], and where a filter smears that."""
    edge = 2 * int(np.ceil(SMEAR / cutoff * fs))
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


@dataclass(frozen=True)
class Rates:
    """Cut-offs and rates of one identification [Hz].

    Parameters
    ----------
    position : float
        Cut-off of the position filter (4th order Butterworth, forward and backward).
    effort : float
        Cut-off of the filter that effort and every column pass.
    why : str
        What set the effort's cut-off.
    """

    position: float
    effort: float
    why: str = field(default="", compare=False)


def motion_bandwidth(recording: Recording) -> float:
    """Frequency below which 99.5 % of the speed's power lies, median of the joints [Hz]."""
    fs, found = recording.rate, [0.0] * recording.d
    for j in range(recording.d):
        speed = np.diff(recording.q[:, j]) * fs
        f, power = scipy.signal.welch(speed, fs, nperseg=min(speed.size, int(8 * fs)))
        # quantisation gives a flat-to-rising floor: take what stands above the median level
        power = np.maximum(power - 3 * np.median(power), 0.0)
        total = np.cumsum(power)
        if total[-1] > 0:
            found[j] = float(f[np.searchsorted(total, 0.995 * total[-1])])
    moving = [x for x in found if x > 0]
    return float(np.median(moving)) if moving else 0.0


def choose(
    recordings: list[Recording],
    band: Band,
    moving: bool = False,
    source: Sequence[float] | None = None,
) -> Rates:
    """Filter band for a set of runs: given, or what the data hold information in.

    Where the model is of what moves (`moving`) the effort's cut-off is the frequency up to which
    the acceleration stands clear of the positions' noise (`ACCELERATION_NOISE`) and the effort's
    spectrum above its own (`ABOVE`), median of the joints that move, and no more than `HARMONICS`
    times the motion's bandwidth and `WIDEST`, beyond which only the motion itself counts (a chirp
    through the resonances of a structure); else six times the bandwidth of the motion in 12..25 Hz.
    The position filter is three times wider, so that what remains of a reversal is sharp against
    the effort filter and the acceleration noise is still bounded.
    Where no joint's speed stands clear of its noise (`CLEAR`) both are narrower, down to
    `NARROWEST`.

    Parameters
    ----------
    recordings : list of Recording
        Evenly sampled runs.
    band : Band
        What was asked for; zeros = choose.
    moving : bool
        Whether the model explains the motor's effort.
    source : sequence of float, optional
        Rates at which the runs were truly measured [Hz]; those of the rows by default.
    """
    slowest = min(source or [r.rate for r in recordings])
    if band.effort_hz:
        effort, why = band.effort_hz, "given"
    elif moving:
        effort, why = _informed(recordings)
    else:
        effort = float(np.clip(6 * max(motion_bandwidth(r) for r in recordings), 12.0, WIDEST))
        why = "six times the bandwidth of the motion"
    if moving and not (band.effort_hz or band.position_hz):
        widest = max(clear(r, 3 * effort) for r in recordings)
        if widest < 3 * effort:
            effort, why = max(widest / 3, NARROWEST), "speed against the counts of the encoder"
    if effort > HIGHEST_EFFORT * slowest:
        effort, why = HIGHEST_EFFORT * slowest, "rate at which it was measured"
    position = band.position_hz or min(3 * effort, HIGHEST_POSITION * slowest)
    return Rates(min(position, 0.45 * slowest), effort, why)


def _informed(recordings: list[Recording]) -> tuple[float, str]:
    """Effort cut-off [Hz] from signal against noise, and what set it."""
    each = [information(r) for r in recordings]
    smooth_to, loud_to = (np.concatenate(x) for x in zip(*each, strict=True))
    if not smooth_to.size:
        return 12.0, "nothing moves"
    acceleration, effort = float(np.median(smooth_to)), float(np.median(loud_to))
    motion = float(np.median([motion_bandwidth(r) for r in recordings]))
    widest = min(max(HARMONICS * motion, FREE), WIDEST)
    least = min(acceleration, effort)
    if min(least, motion) > WIDEST:
        return min(least, motion), "the motion itself; the signals stand clear of their noise"
    if least >= widest:
        return widest, "the motion's harmonics; the signals stand clear of their noise"
    why = "noise of the acceleration" if acceleration <= effort else "noise of the effort"
    return max(least, LEAST), why if least > LEAST else f"{why}; the narrowest that is used"


def information(r: Recording) -> tuple[FloatArray, FloatArray]:
    """Up to which frequency [Hz] acceleration and effort stand clear of noise, moving joints (k,).

    White noise s_q of the positions gives  s_a = s_q (2 pi)^2 sqrt(2 f^5 / (5 fs))  behind a
    cut-off f; s_q is that of the second differences, or of the spectrum's plateau, if more.
    """
    noise = white_noise(r)
    held = holding(r.q, position_noise(r.q) * np.sqrt(12))
    used = np.flatnonzero(~held & (np.ptp(r.q, axis=0) > 0))
    tried = np.geomspace(NARROWEST, max(2 * WIDEST, 2 * NARROWEST), 20)
    tried = tried[tried < 0.45 * r.rate]
    if not used.size or not tried.size:
        return np.zeros(0), np.zeros(0)
    share = _shares(r, noise, tried)[:, used]
    level = np.log(np.maximum(np.maximum.accumulate(share, axis=0), 1e-300))
    clean = [np.exp(np.interp(np.log(ACCELERATION_NOISE), x, np.log(tried))) for x in level.T]
    return np.array(clean), np.array([_loud(r.tau[:, j], r.rate) for j in used])


def noise_share(r: Recording, cutoff: float) -> FloatArray:
    """Noise of the acceleration behind a cut-off [Hz] in units of its rms (d,)."""
    return _share(r, white_noise(r), cutoff)


def _share(r: Recording, noise: FloatArray, cutoff: float) -> FloatArray:
    """Noise of the acceleration behind a cut-off in units of its rms (d,)."""
    out: FloatArray = _shares(r, noise, np.array([cutoff]))[0]
    return out


def _shares(r: Recording, noise: FloatArray, cutoffs: FloatArray) -> FloatArray:
    """The same behind several cut-offs (cutoffs, d)."""
    s_a = noise * (2 * np.pi) ** 2 * np.sqrt(0.4 * cutoffs[:, None] ** 5 / r.rate)
    _long_enough(r.q)
    power = acceleration_power(r.q, r.rate, np.minimum(cutoffs, 0.35 * r.rate))
    out: FloatArray = s_a / np.maximum(np.sqrt(power), 1e-300)
    return out


def _plateau(q: FloatArray, fs: float) -> FloatArray:
    """Standard deviation (d,) of white noise with the power of a spectrum's upper end."""
    f, power = _spectrum(q, fs)
    out: FloatArray = np.sqrt(np.median(power[f > PLATEAU * fs], axis=0) * fs / 2)
    return out


def effort_noise(r: Recording, cutoff: float) -> FloatArray:
    """White noise of the efforts that is left behind a cut-off [Hz], rms (d,) [N m or N]."""
    white = _plateau(r.tau, r.rate)
    return np.asarray(white * np.sqrt(min(2 * cutoff / r.rate, 1.0)))


def _spectrum(x: FloatArray, fs: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies (k,) and one-sided power densities (k, ...) of columns."""
    straight = scipy.signal.detrend(x, axis=0)
    f, power = scipy.signal.welch(straight, fs, nperseg=min(len(x), int(SEGMENT_S * fs)), axis=0)
    return np.asarray(f), np.asarray(power)


def _loud(tau: FloatArray, fs: float) -> float:
    """Frequency from the effort's strongest one on up to which it stands above its noise [Hz]."""
    f, power = _spectrum(tau, fs)
    noise = float(np.median(power[f > PLATEAU * fs]))
    size = np.convolve(power, np.full(AVERAGED, 1 / AVERAGED), "same")
    first = int(np.argmax(size))
    below = np.flatnonzero(size[first:] <= ABOVE * noise)
    return float(f[first + below[0]]) if below.size and noise > 0 else float(fs / 2)


def clear(r: Recording, cutoff: float) -> float:
    """Largest cut-off up to this one [Hz] behind which a joint's speed is `CLEAR` of its noise.

    The noise of white steps s_q behind a filter of f is s_v = s_q 2 pi f sqrt(2 f / (3 fs)), so

        f = (v / CLEAR / (2 pi s_q) sqrt(3 fs / 2))^(2/3)

    for an rms speed v, of the joint where it is largest.
    """
    speed = np.sqrt(np.mean(derivatives(r.q, r.rate, min(cutoff, 0.35 * r.rate))[1] ** 2, axis=0))
    noise = np.maximum(encoder_noise(r), 1e-300)
    most = (speed / CLEAR / (2 * np.pi * noise) * np.sqrt(1.5 * r.rate)) ** (2 / 3)
    return min(cutoff, float(np.max(most)))


def shaken(r: Recording, cutoff: float) -> float:
    """Noise of the acceleration behind a cut-off, in units of its rms; worst joint that moves."""
    share = _share(r, position_noise(r.q), cutoff)
    return float(np.max(share[share < IDLE], initial=0.0))


def derivatives(q: FloatArray, fs: float, cutoff: float) -> tuple[FloatArray, ...]:
    """Filtered position, its speed and its acceleration, all (n, d).

    4th order Butterworth, forward and backward (zero phase), then differences, as Gautier's inverse
    dynamic identification does; of eighth order, as those of two neighbours take a fifth of the
    inertia's effort at 6 Hz in a recording of 50 Hz.

    Raises
    ------
    DataError
        If the run is too short for the filter.
    """
    _long_enough(q)
    sos = scipy.signal.butter(4, cutoff / (fs / 2), output="sos")
    smooth = scipy.signal.sosfiltfilt(sos, q, axis=0)
    speed = _slopes(smooth, fs)
    return smooth, speed, _slopes(speed, fs)


def _slopes(x: FloatArray, fs: float) -> FloatArray:
    """Time derivatives of columns (n, d)."""
    return np.stack([slope(np.ascontiguousarray(each), fs) for each in x.T], axis=1)


def _long_enough(q: FloatArray) -> None:
    if len(q) < 60:
        raise DataError(f"a run of {len(q)} samples is too short to differentiate; record longer")


def smooth(x: FloatArray, fs: float, cutoff: float) -> FloatArray:
    """Zero-phase Butterworth filter of columns (n, ...)."""
    sos = scipy.signal.butter(4, cutoff / (fs / 2), output="sos")
    out: FloatArray = scipy.signal.sosfiltfilt(sos, x, axis=0)
    return out


#: Instants at which a motion is evaluated per period of the position filter's cut-off.  Half: a
#: sign turns between two of them within what the filter passes; double: the same fits at twice the
#: cost.
EVALUATED = 5.0
#: Rows per such period below which instants between them are evaluated too.  Half: none ever are;
#: double: runs of 250 Hz take twice the time and answer the same.
FEW = 3.0
#: Rows from instant to instant above which none lies between two rows.
AS_RECORDED = 0.9
#: Rows to either side from which a value between two rows is interpolated, and the shape of their
#: window: 80 dB from 4 % below half the rate on (Kaiser 1974).  Half: a tenth of what the widest
#: position filter passes is lost; double: no more is passed, and ends are mirrored further.
AROUND, WINDOW = 64, ("kaiser", 8.0)


def apart(fs: float, cutoff: float) -> float:
    """Rows from one instant of a motion to the next: a whole number, or one over a whole number.

    What acts turns within less than a row where a run was recorded slowly: dry friction at a
    reversal.  There the filtered motion is interpolated, which its filter's band allows.

    Parameters
    ----------
    fs : float
        Sample rate [Hz].
    cutoff : float
        Of the position filter [Hz].
    """
    rows = fs / (EVALUATED * cutoff)
    if fs >= FEW * cutoff:
        return float(max(int(rows), 1))
    return 1.0 / int(np.ceil(1.0 / rows - 1e-9))


def every(x: FloatArray, rows: float) -> FloatArray:
    """Columns (n, ...) of a filtered signal at every `rows`-th row, between rows if below one.

    Band-limited interpolation by a windowed sinc; mirrored at the ends, about their values.
    """
    if rows > AS_RECORDED or not x.size:
        return x[:: max(round(rows), 1)]
    more = round(1.0 / rows)
    reach = min(AROUND, len(x) - 1)
    before, after = 2 * x[:1] - x[reach:0:-1], 2 * x[-1:] - x[-2 : -reach - 2 : -1]
    wide = np.concatenate([before, x, after])
    taps = scipy.signal.firwin(2 * AROUND * more + 1, 1.0 / more, window=WINDOW)
    out: FloatArray = scipy.signal.upfirdn(more * taps, wide, more, axis=0)[AROUND * more :]
    return out[reach * more :][: (len(x) - 1) * more + 1]


def nearest(x: FloatArray, rows: float) -> FloatArray:
    """The same of what has no value between rows: that of the nearer row."""
    if rows > AS_RECORDED:
        return x[:: max(round(rows), 1)]
    more = round(1.0 / rows)
    return np.asarray(x[(np.arange((len(x) - 1) * more + 1) + more // 2) // more])


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


def compiled() -> bool:
    """Whether the compiled loops of this installation are there; the first analysis makes them."""
    place = _cascade.stats.cache_path
    return place is not None and any(Path(place).glob("*.nbi"))


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
    total = np.zeros(lanes)
    for k in range(lanes):
        acceleration = slope(slope(x[edge : edge + n, k].copy(), fs), fs)
        total[k] = np.sum(acceleration**2)
    return total / n
