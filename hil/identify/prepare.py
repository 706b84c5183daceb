"""Recordings made ready: an even grid, filtered motion, external effort, and what is left out.

What was done is said in data (`Prepared`), in sentences and as JSON; `[signal]` of a model file
overrules it.

The effort filter: one linear operator that low-passes and decimates.

Of N instants only the lowest frequencies are wanted.  With N = p M, instants d, d + p, d + 2 p ...
have a transform X_d of their own of length M, and

    X[k] = sum_d exp(-2 pi i k d / N) X_d[k],    k <= M / 2

(decimation in time: Cooley, Tukey, Mathematics of Computation 19, 1965).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numba
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError, plural
from hil.identify import bands
from hil.identify.clock import EVEN, FILLED, GROWS_S, Even, Timing, even, on_one_clock
from hil.models.model import Band
from hil.models.motion import Motion
from hil.models.robots import Robot
from hil.record.recording import EFFORT_STEP, SIGNAL, Recording

FloatArray = NDArray[np.float64]
#: Shortest run, in periods of the effort filter.
SHORTEST_RUN = 6.0
#: Periods of the position filter's cut-off within which a bridge is as exact as the noise: a cubic
#: over h = x / fc misses a wave of fc by (2 pi x)^4 / 384 of its amplitude, 2e-3 at 0.15 and less
#: for what lies below.  Doubled, a bridge of 4 rows at 1 kHz counts as measured; halved, none of 2.
EXACT_BRIDGE = 0.15
#: Error of a bridge, tried where rows are there, in units of the noise up to which it counts as
#: measured, too: a cubic through four noisy rows strays by 1.3 from a fifth.  Doubled, bridges of a
#: row more count; halved, none does.
BRIDGE_STRAY = 2.0
#: Periods of the position filter's cut-off by which the errors of a bridge reach beyond it: the
#: 4th order Butterworth's slowest pole pair decays as exp(-2 pi fc t sin(22.5 deg)), to 1 % after
#: 2 periods.  Halved it leaves 10 % in; doubled it costs as much data again.
FILTER_REACH = 2.0
#: Motion in units of the encoder's noise below which a joint is said to move little.
LITTLE_EXCITATION = 100.0


@dataclass(frozen=True)
class Excitation:
    """How much a joint moved.

    Parameters
    ----------
    joint : str
        Joint.
    span : float
        Range of its position [rad or m].
    grains : float
        Range in units of the encoder's resolution or noise.
    clear : float
        Rms acceleration over its noise behind the position filter.
    held : bool
        Whether it only holds its place.
    """

    joint: str
    span: float
    grains: float
    clear: float
    held: bool


@dataclass(frozen=True)
class Prepared:
    """What the analysis makes of one recording.

    Parameters
    ----------
    name : str
        Name of the run.
    timing : Timing
        Clock, jitter, repeats, holds and gaps.
    rates : Rates
        Band and why.
    parts : int
        Parts into which it is split.
    left_out : float
        Time around bridged gaps that enters no equation [s].
    excitation : tuple of Excitation
        By joint.
    """

    name: str
    timing: Timing
    rates: bands.Rates
    parts: int
    left_out: float
    excitation: tuple[Excitation, ...]

    @property
    def warnings(self) -> list[tuple[str, str]]:
        """What was done that a user should know: (code, sentence)."""
        return [*timing_notes(self.timing), *_excitation_notes(self.excitation)]

    @property
    def sentences(self) -> list[str]:
        """The same in full, as `hil info` prints it."""
        t = self.timing
        out = [
            f"analysed at {t.rate:.6g} Hz (period {t.period * 1e3:.6g} ms"
            + (f" +- {t.error * 1e3:.1g} ms" if t.error > 1e-9 * t.period else "")
            + (f", time stamps vary by {t.jitter * 1e3:.2g} ms rms)" if _strays(t) else ")"),
            f"band: positions to {self.rates.position:.3g} Hz, efforts to "
            f"{self.rates.effort:.3g} Hz ({self.rates.why}); to change it, set position_hz and "
            "effort_hz under [signal] in the model file",
        ]
        if self.parts > 1 or self.left_out:
            out.append(
                f"{plural(self.parts, 'part')}, {self.left_out:.3g} s left out near interpolated "
                "gaps"
            )
        return out + [text for _, text in self.warnings]

    def as_dict(self) -> dict[str, object]:
        """For JSON: numbers in SI."""
        t = self.timing
        return {
            "period_s": t.period,
            "period_error_s": t.error,
            "jitter_s": t.jitter,
            "reading": t.reading,
            "repeated": t.repeated,
            "stale": t.stale,
            "excess": t.excess,
            "wrong": t.wrong,
            "held": {k: t.rate / v for k, v in t.held.items()},
            "gaps": [
                {"after_s": g.after, "length_s": g.length, "rows": g.rows, "split": g.split}
                for g in t.gaps
            ],
            "dropped_s": t.dropped,
            "queued": t.queued,
            "effort_late_s": t.late,
            "effort_drift": t.drift,
            "parts": self.parts,
            "left_out_s": self.left_out,
            "band": {
                "position_hz": self.rates.position,
                "effort_hz": self.rates.effort,
                "why": self.rates.why,
            },
            "excitation": [
                {
                    "joint": x.joint,
                    "span": x.span,
                    "grains": x.grains,
                    "clear": x.clear,
                    "held": x.held,
                }
                for x in self.excitation
            ],
            "warnings": [{"code": c, "text": x} for c, x in self.warnings],
        }


def prepared(recording: Recording, band: Band | None = None, moving: bool = True) -> Prepared:
    """What the analysis makes of a recording, without fitting anything.

    Parameters
    ----------
    recording : Recording
        As recorded.
    band : Band, optional
        ``[signal]`` of a model.
    moving : bool
        Whether the motor's effort is to be explained (else the external one).
    """
    band = signal(band or Band(), recording)
    parts, timing = on_grid(recording, band, moving)
    runs = [p.recording for p in parts]
    rates = bands.choose(runs, band, moving, [min(timing.source, r.rate) for r in runs])
    left = sum(float(np.sum(bridged(p, rates.position))) / p.recording.rate for p in parts)
    return Prepared(recording.name, timing, rates, len(parts), left, _excitation(runs, rates))


def on_grid(r: Recording, band: Band, moving: bool = True) -> tuple[list[Even], Timing]:
    """Parts of a run on an even grid, efforts and positions on one clock, and what was done.

    Where a map states how late the efforts are, or `band` how fast two clocks differ, that holds.

    Parameters
    ----------
    r : Recording
        As recorded.
    band : Band
        Its [signal], as `signal` has it.
    moving : bool
        Whether the motor's effort is to be explained (else the external one).
    """
    parts, timing = even(r, band.rate_hz, band.gap_s)
    stated = any(SIGNAL + key in r.metadata for key in ("shift_s", "clock_ppm"))
    stated = stated or abs(band.clock_ppm) * 1e-6 * float(np.ptp(r.t)) > GROWS_S / 2
    return (parts, timing) if stated or not moving else on_one_clock(r, parts, timing)


def signal(band: Band, recording: Recording) -> Band:
    """A model's [signal], and where it is silent the one of the map that a run came through."""
    said = {f.name: recording.metadata.get(SIGNAL + f.name, "") for f in fields(Band)}
    own: dict[str, Any] = {key: json.loads(text) for key, text in said.items() if text}
    if EFFORT_STEP in own:
        own[EFFORT_STEP] = tuple(own[EFFORT_STEP])
    return band.beside(replace(Band(), **own))


def converted(recording: Recording, steps: Sequence[float]) -> Recording:
    """A run with the efforts that a converter sends in whole steps (d,) of those recorded.

    Raises
    ------
    ConfigError
        If there is not one step a joint.
    """
    if not any(steps):
        return recording
    if len(steps) != len(recording.joints):
        raise ConfigError(
            f"effort_step = {list(steps)!r}: expected one step for each of the "
            f"{len(recording.joints)} joints {', '.join(recording.joints)}; 0 = none"
        )
    tau = recording.tau.copy()
    for j, step in enumerate(steps):
        if step:
            tau[:, j] = step * np.round(tau[:, j] / step)
    return replace(recording, tau=tau)


def _excitation(runs: Sequence[Recording], rates: bands.Rates) -> tuple[Excitation, ...]:
    """How much each joint moved in any of the parts."""
    first = runs[0]
    noise = np.min([bands.position_noise(r.q) for r in runs], axis=0) * np.sqrt(12)
    held = np.all([bands.holding(r.q, noise) for r in runs], axis=0)
    low = np.min([r.q.min(axis=0) for r in runs], axis=0)
    span = np.max([r.q.max(axis=0) for r in runs], axis=0) - low
    clear = np.max([1 / np.maximum(bands.noise_share(r, rates.position), 1e-9) for r in runs], 0)
    return tuple(
        Excitation(
            name,
            float(span[j]),
            float(span[j] / max(noise[j], 1e-300)),
            float(clear[j]),
            bool(held[j]),
        )
        for j, name in enumerate(first.joints)
    )


def _strays(t: Timing) -> bool:
    return t.jitter > EVEN * t.period


def _excitation_notes(excitation: Sequence[Excitation]) -> list[tuple[str, str]]:
    """Joints of which little is to be learnt."""
    out = []
    for x in excitation:
        if x.held:
            text = f"{x.joint} holds its place ({x.span:.2g}): the recording says nothing about it"
            out.append(("excitation", text))
        elif x.grains < LITTLE_EXCITATION:
            text = (
                f"{x.joint} moves by only {x.span:.2g}, {x.grains:.0f} times its position noise: "
                "friction and inertia are hardly determined"
            )
            out.append(("excitation", text))
    return out


def timing_notes(t: Timing) -> list[tuple[str, str]]:
    """What was done to the rows: (code, sentence)."""
    out = [*_of_rows(t), *_of_stamps(t)]
    if t.gaps:
        out.append(("gap", _gaps(t)))
    if t.drift:
        out.append(("two-clocks", _clocks(t)))
    if t.dropped:
        out.append(("gap", f"{t.dropped:.3g} s left out: parts too short to use alone"))
    return out


def _of_rows(t: Timing) -> Iterator[tuple[str, str]]:
    """Rows that came twice, values that were held, and spikes: (code, sentence)."""
    if t.repeated:
        text = f"{_rows(t.repeated)} left out: same time and values as the row before"
        yield "time-repeated", text
    if t.stale:
        text = f"{_rows(t.stale)} repeat all values of the row before"
        extra = (
            " and the motion continues without them: left out as extra; the period is "
            f"{t.period * 1e3:.5g} ms"
        )
        yield "stale-rows", text + (extra if t.excess else ": taken as missing")
    for name, hold in t.held.items():
        text = (
            f"{name} holds each value for {hold} rows: it was measured at {t.rate / hold:.4g} Hz "
            "and is used at that rate"
        )
        yield "held-samples", text
    if t.wrong:
        many = plural(t.wrong, "spike")
        yield "spike", f"{many} of one row replaced by interpolation of the neighbours"


def _of_stamps(t: Timing) -> Iterator[tuple[str, str]]:
    """Stamps that come at once, or vary: (code, sentence)."""
    if t.queued:
        text = (
            f"up to {t.queued} rows come at once, as from a queue, so that their stamps are those "
            "of their arrival: rows are taken as evenly spaced, with a period of "
            f"{t.period * 1e3:.5g} ms"
        )
        yield "irregular-time", text
    followed = t.reading == "stamps"
    if followed or t.jitter > 0.02 * t.period:
        how = (
            "positions follow them: resampled to an even grid"
            if followed
            else "positions do not follow them: rows are taken as evenly spaced"
        )
        yield "irregular-time", f"time stamps vary by {t.jitter * 1e3:.2g} ms rms and the {how}"


def _clocks(t: Timing) -> str:
    """How the clock of the efforts differs from that of the positions, and what was done."""
    size, side = abs(t.late), "late" if t.late > 0 else "early"
    start = f"{size * 1e3:.3g} ms {side}" if size > t.period else "in time"
    more = "later" if t.drift > 0 else "earlier"
    return (
        f"the efforts are {start} against the positions at the start, and by "
        f"{abs(t.drift) * 1e3:.4g} ms {more} with every second: two clocks that differ by "
        f"{abs(t.drift):.2%}. Efforts are taken by the clock of the positions, and what "
        "lies beyond them is left out. To use other values, set clock_ppm and shift_s "
        "under [signal] of a map and import again"
    )


def _gaps(t: Timing) -> str:
    """What is missing, and what was done about it."""
    rows, longest = sum(g.rows for g in t.gaps), max(t.gaps, key=lambda g: g.length)
    split = sum(g.split for g in t.gaps)
    done = f"; the run is split at {split} of them; the others" if split else "; they"
    lost = "missing or taken as missing" if t.stale and not t.excess else "missing"
    return (
        f"{_rows(rows)} {lost} in {plural(len(t.gaps), 'gap')}, the longest {longest.length:.3g} "
        f"s after {longest.after:.6g} s{done} are interpolated, and samples near an inexact "
        "interpolation are not used"
    )


def _rows(n: int) -> str:
    return plural(n, "row")


def bridged(part: Even, cutoff: float) -> NDArray[np.bool_]:
    """Samples (n,) of a part that a bridge spoils behind a position filter of this cut-off [Hz].

    And those that are to be left out.
    """
    r = part.recording
    out = np.zeros(r.n, dtype=np.bool_)
    reach = int(np.ceil(FILTER_REACH / cutoff / r.period))
    exact: dict[int, bool] = {}
    for first, last in part.bridges:
        rows = int(last - first)
        if (rows + 1) * r.period <= EXACT_BRIDGE / cutoff:
            continue
        if rows not in exact:
            exact[rows] = rows <= FILLED and _as_measured(r, rows)
        if not exact[rows]:
            out[max(first - reach, 0) : last + reach] = True
    for begin, end in r.left_out:
        out |= (begin <= r.t) & (r.t <= end)
    return out


def _as_measured(r: Recording, rows: int) -> bool:
    """Whether bridges over so many rows are as near to what was measured as its noise is.

    Tried at every instant: the cubic through two rows on either side of a hole, in its middle.
    """
    half = rows // 2 + 1  # an even number has no middle row: as the next odd one
    near = np.array([-half - 1, -half, half, half + 1])
    weight = [-np.prod(near[near != x]) / np.prod(x - near[near != x]) for x in near.astype(float)]
    reach = half + 1
    size = r.n - 2 * reach
    for x in (r.q, r.tau):
        parts = [w * x[reach + k : reach + k + size] for w, k in zip(weight, near, strict=True)]
        error = np.sqrt(np.mean((x[reach : reach + size] - np.sum(parts, axis=0)) ** 2, axis=0))
        if np.any(error > BRIDGE_STRAY * bands.position_noise(x)):
            return False
    return True


#: Motion of a part, where joints stand (n, d) and bridges are (n,), and its effort filter.
Filtered = tuple[Motion, FloatArray, FloatArray, "Decimator"]


def prepare(
    part: Even,
    robot: Robot,
    rates: bands.Rates,
    span: FloatArray,
    explains: str,
    finely: bool = True,
) -> Filtered:
    """Motion of a part, where joints stand (n, d) and bridges are (n,), and its effort filter.

    Where it was recorded slowly the motion is interpolated between its rows (`finely`).

    Raises
    ------
    DataError
        If the run is too short for the filter, or lacks the effort that is to be explained.
    """
    r = part.recording
    fs = r.rate
    q, qd, qdd = bands.derivatives(r.q, fs, rates.position)
    rows = bands.apart(fs, rates.position)
    rows = rows if finely else max(rows, 1.0)
    between = bands.every(q, rows) if rows < bands.AS_RECORDED else None
    still = bands.standing(r.q, qd, qdd, fs, 0.5 / rates.effort, rates.position, between)
    q, qd, qdd = (bands.every(x, rows) for x in (q, qd, qdd))
    step = rows / fs
    t = np.arange(len(q), dtype=np.float64) * step
    if t.size * step * rates.effort < SHORTEST_RUN:
        raise DataError(
            f"run {r.name!r} of {r.n / fs:.3g} s is too short for a filter of "
            f"{rates.effort:.3g} Hz; record {SHORTEST_RUN / rates.effort:.2g} s or more"
        )
    motion = Motion(
        t=t,
        q=q,
        qd=qd,
        qdd=qdd,
        tau=bands.every(bands.smooth(r.tau, fs, rates.position), rows),
        tau_ext=_external(r, q, rows, robot, rates, explains),
        load=np.zeros_like(q),
        static=np.zeros_like(q),
        v0=_resolution(r, rates),
        resolution=np.zeros(r.d),
        span=span,
        contact=np.full((r.d, 2), np.nan),
        robot=robot,
        average=max(step, r.period),
        wrench=_slow(None if r.tau_ext is not None else r.wrench, 6, rows, r.rate, rates),
        temperature=_slow(r.temperature, r.d, rows, r.rate, rates),
        grain=bands.position_noise(r.q) * np.sqrt(12),
        slips=_slips(r, rows, rates),
        began=part.start,
        band=rates.effort,
    )
    spoilt = bridged(part, rates.position).astype(np.float64)
    still = still if between is not None else bands.nearest(still, rows)
    return motion, still, bands.nearest(spoilt, rows), Decimator(t.size, 1 / step, rates.effort)


def _slips(r: Recording, rows: float, rates: bands.Rates) -> FloatArray:
    """What jumps of the positions add to q, qd and qdd after the filter, (3, n, d) or (3, 0, 0)."""
    error = np.stack([found.shift(r.n) for found in r.jumps], axis=1)
    if not np.any(error):
        return np.zeros((3, 0, 0))
    return np.stack(
        [bands.every(x, rows) for x in bands.derivatives(error, r.rate, rates.position)]
    )


def _slow(
    x: FloatArray | None, width: int, rows: float, fs: float, rates: bands.Rates
) -> FloatArray:
    """A measured channel after the position filter; no rows where it was not recorded."""
    if x is None:
        return np.zeros((0, width))
    return bands.every(bands.smooth(x, fs, rates.position), rows)


def _external(
    r: Recording, q: FloatArray, rows: float, robot: Robot, rates: bands.Rates, explains: str
) -> FloatArray:
    """External effort (n, d), measured at the joints or from the wrench at the tip."""
    if r.tau_ext is not None:
        return bands.every(bands.smooth(r.tau_ext, r.rate, rates.position), rows)
    if r.wrench is not None:
        wrench = bands.every(bands.smooth(r.wrench, r.rate, rates.position), rows)
        return robot.external(q, wrench)
    if explains == "external":
        raise DataError(
            f"recording {r.name!r} has no external effort (tauext or fx, fy, fz) to explain"
        )
    return np.zeros_like(q)


#: Samples on each side of a reversal on which its effort is looked at: four numbers are fitted to
#: them.  Half: as many numbers as samples; double: more than a parabola.
AROUND = 4
#: Reversals from which on they may tell how efforts were sampled, and standard errors of a test at
#: one percent.  Half as many: noise of few reversals decides; double: short runs of clean efforts
#: count as averages.
TURNS, SURE = 24, 2.33


def at_instants(parts: Sequence[tuple[Recording, Motion]]) -> bool:
    """Whether efforts are values of the instants that they were recorded at, and no averages.

    Dry friction turns between two samples, after the part f of the time between them.  An effort of
    an instant has turned as a whole in the next one.  One that is averaged from the middle between
    two samples to the next has, in the nearer one, turned by a part:

        s = -1 + 2 max(0, 1/2 - f)  before,    s = 1 - 2 max(0, f - 1/2)  after.

    About each reversal a parabola and s times a level are fitted to the recorded efforts.  What the
    one form leaves less than the other, over both, counts; only where it is sure, so that noise of
    positions or efforts that hides f leaves them averages.
    """
    each = [
        x
        for r, m in parts
        if m.n >= r.n and np.any(r.tau)
        for j in range(r.d)
        for x in _turned(r.tau[:, j], m.qd[:: round(1 / (m.dt * r.rate)), j], float(m.v0[j]))
    ]
    if len(each) < TURNS:
        return False
    return float(np.mean(each)) > SURE * float(np.std(each)) / math.sqrt(len(each))


def _turned(tau: FloatArray, v: FloatArray, slow: float) -> list[float]:
    """How much less a sign at instants leaves than an average, reversal by reversal: -1 to 1."""
    before = np.flatnonzero(np.sign(v[1:]) != np.sign(v[:-1]))
    before = before[(before >= AROUND) & (before < v.size - AROUND - 1)]
    offset, out = np.arange(1 - AROUND, AROUND + 1), []
    for k in before:
        speeds, y = v[k + offset], tau[k + offset]
        sign = np.where(offset <= 0, -1.0, 1.0) * np.sign(speeds[-1])
        if np.any(speeds * sign <= 0) or min(abs(speeds[0]), abs(speeds[-1])) < slow:
            continue  # no reversal, or a rest
        f = speeds[AROUND - 1] / (speeds[AROUND - 1] - speeds[AROUND])
        mean = sign.copy()
        mean[AROUND - 1] *= 1 - 2 * max(0.0, 0.5 - f)
        mean[AROUND] *= 1 - 2 * max(0.0, f - 0.5)
        bent = np.stack([np.ones(offset.size), offset, offset**2])
        left = [_left(y, np.vstack([bent, s])) for s in (mean, sign)]
        out.append((left[0] - left[1]) / max(left[0] + left[1], 1e-300))
    return out


def _left(y: FloatArray, x: FloatArray) -> float:
    """Sum of squares that rows x (k, n) leave of y (n,)."""
    return float(np.sum((y - x.T @ np.linalg.lstsq(x.T, y, rcond=None)[0]) ** 2))


def _resolution(r: Recording, rates: bands.Rates) -> FloatArray:
    """Speed noise after the position filter, at least 0.2 % of the rms speed (d,)."""
    fs, cutoff = r.rate, rates.position
    sigma_q = bands.encoder_noise(r)
    # s_v = s_q 2 pi fc sqrt(2 fc / (3 fs)) for white noise up to fc
    sigma_v = sigma_q * 2 * np.pi * cutoff * np.sqrt(2 * cutoff / (3 * fs))
    rms = np.sqrt(np.mean(np.diff(r.q, axis=0) ** 2, axis=0)) * fs
    out: FloatArray = np.maximum(np.maximum(sigma_v, 0.002 * rms), 1e-9)
    return out


ComplexArray = NDArray[np.complex128]


@numba.njit(cache=True, nogil=True)
def _joined(parts: ComplexArray, turns: ComplexArray, out: ComplexArray) -> None:
    """Sum over d of turns (k, d) and parts (columns, M, d), to out (k, columns)."""
    for j in range(out.shape[1]):
        for k in range(out.shape[0]):
            real, imag = 0.0, 0.0
            for d in range(turns.shape[1]):
                x, turn = parts[j, k, d], turns[k, d]
                real += x.real * turn.real - x.imag * turn.imag
                imag += x.real * turn.imag + x.imag * turn.real
            out[k, j] = complex(real, imag)


class Decimator:
    """The one linear operator that every column and the effort pass: low-pass and decimate.

    Done in the frequency domain, so that it is exactly linear, exactly zero-phase and the
    same for all: y = X theta before it means y = X theta after it.

    Parameters
    ----------
    n : int
        Instants before.
    fs : float
        Their rate [Hz].
    cutoff : float
        Cut-off (half power) [Hz]; output rate is about three times that.
    """

    def __init__(self, n: int, fs: float, cutoff: float) -> None:
        self._good = int(scipy.fft.next_fast_len(n, real=True))
        duration = self._good / fs
        # a length without large prime factors, so that the transform back is quick
        wanted = scipy.fft.next_fast_len(max(int(duration * 1.5 * cutoff), 8), real=True)
        self._keep = min(int(wanted), self._good // 2) + 1
        f = np.arange(self._keep) / duration
        # |H|^2 of a 4th order Butterworth, forward and backward
        self._gain = 1.0 / (1.0 + (f / cutoff) ** 8)
        self._out = 2 * (self._keep - 1)
        most = self._good // max(2 * (self._keep - 1), 1)
        self._parts = next(p for p in range(max(most, 1), 0, -1) if self._good % p == 0)
        # exp(-2 pi i k d / N) times the gain, and what the shorter transform back asks for
        phase = np.outer(np.arange(self._keep), np.arange(self._parts)) / self._good
        size = self._gain[:, None] * (self._out / self._good)
        self._turns = size * np.exp(-2j * np.pi * phase)
        self._n = n
        self.rate = self._out / duration
        edge = max(2, int(np.ceil(1.5 / cutoff * self.rate)))
        last = int(np.floor((n - 1) / fs * self.rate)) - edge
        self._slice = slice(edge, max(last, edge + 1))
        self.times = np.arange(self._out)[self._slice] / self.rate

    def __call__(self, x: FloatArray, weight: FloatArray | None = None) -> FloatArray:
        """Filter and decimate along axis 0; (n, ...) to (n_out, ...), `weight` (n,) before it."""
        flat = x.reshape(self._n, -1).T
        wide = np.empty((len(flat), self._good))
        inside, pad = wide[:, : self._n], self._good - self._n
        if weight is None:
            inside[:] = flat
        else:
            np.multiply(flat, weight, out=inside)
        if pad:
            # pad by a straight line back to the start: linear in x, and without a step
            ramp = np.arange(1, pad + 1) / (pad + 1)
            last = inside[:, -1:]
            wide[:, self._n :] = last + (inside[:, :1] - last) * ramp
        # every p-th instant has a spectrum of its own: short, and at hand at once
        parts = scipy.fft.rfft(wide.reshape(len(flat), -1, self._parts), axis=1)
        spectrum = np.empty((self._keep, len(flat)), dtype=np.complex128)
        _joined(parts, self._turns, spectrum)
        out = scipy.fft.irfft(spectrum, n=self._out, axis=0)
        result: FloatArray = out[self._slice].reshape(-1, *x.shape[1:])
        return result

    def adjoint(self, y: FloatArray) -> FloatArray:
        """Transpose of the operator but for the padding: x'(F' y) = (F x)' y; (n_out,) to (n,)."""
        full = np.zeros(self._out)
        full[self._slice] = y
        spectrum = np.zeros(self._good // 2 + 1, dtype=np.complex128)
        spectrum[: self._keep] = scipy.fft.rfft(full)[: self._keep] * self._gain
        spectrum[self._keep - 1] *= 0.5  # the highest frequency has no mirror image after it
        out: FloatArray = scipy.fft.irfft(spectrum, n=self._good)[: self._n]
        return out
