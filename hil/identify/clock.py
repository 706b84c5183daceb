"""Irregular time made even: the clock behind the stamps, and rows on its grid.

A stamp says when a row was logged, which is not always when it was measured.  Three readings are
tried: rows are as late as their stamps say; rows are even and the stamps stray; and, where rows
repeat their predecessor in every channel, that such a row was written in excess.  Which one holds
is decided by the positions themselves: how well each sample is foretold by its four neighbours,

    e_k = q_k - sum_i L_i(t_k) q_i,    i = k - 2, k - 1, k + 1, k + 2   (Lagrange, cubic),

as no arm leaves a cubic within four samples, while a wrong instant throws it off by its speed.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.record.consistency import arrivals, spikes
from hil.record.jumps import resolution
from hil.record.recording import COLUMNS, Recording

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
#: Periods from one row to the next from which rows are missing between them (half-way).
MISSING = 1.5
#: Straying of the stamps, in periods rms, that is rounding: nothing is resampled for it.
EVEN = 2e-3
#: Share by which a reading must foretell the positions better than even rows to be taken.
BETTER = 0.05
#: Rows within which a late stamp has come right again.
LATE = 6
#: Channels that a measured row brings anew.
WATCHED = ("q", "tau", "qd", "tau_ext", "wrench")
#: Rows missing in a row that a cubic spline fills; longer gaps are bridged by a straight line,
#: which does not swing, and left out of the equations in any case.
FILLED = 8
#: Longest hold of a channel whose holds are alike, in its median: more is a standstill.
LONGEST_HOLD = 1.6
#: Default gap that splits a run [s]: an arm's friction, servo and load have another state after
#: it (ten periods of the slowest filter chosen).  Halved or doubled only changes how much of the
#: bridge is computed in vain: neither way it enters the equations.
SPLIT_S = 1.0
#: A part shorter than so [s] does not stand alone (edges of the filters take a second of it): it
#: stays with its neighbour behind a bridge, unless the gap is longer than `FAR` [s].
ALONE_S, FAR_S = 5.0, 60.0


@dataclass(frozen=True)
class Gap:
    """Rows that are missing.

    Parameters
    ----------
    after : float
        Instant of the last row before it [s], of the recording's own stamps.
    length : float
        From that row to the next [s].
    rows : int
        Rows missing.
    split : bool
        Whether the run is split there; else it is bridged.
    """

    after: float
    length: float
    rows: int
    split: bool = False


@dataclass(frozen=True)
class Timing:
    """The clock of one run, and what was done to its rows.

    Parameters
    ----------
    period, error : float
        Period of the rows and its standard error [s].
    jitter : float
        Straying of the stamps from one row to the next, rms [s].
    reading : str
        ``"even"`` (rows are even, stamps taken as counted) or ``"stamps"`` (resampled by them).
    repeated : int
        Rows with the stamp and the values of the one before; left out.
    stale : int
        Rows with another stamp but every value of the row before; left out.
    excess : bool
        Whether such rows were written in excess (else in the place of a lost one).
    held : dict of str to int
        Rows for which a channel (``"q"``, ``"tau"``, ...) holds each value, where more than one.
    gaps : tuple of Gap
        Where rows are missing.
    wrong : int
        Single values that stood out of their neighbours and were put right.
    dropped : float
        Time in parts too short to stand alone, beyond a long gap [s].
    late, drift : float
        How late efforts were at the start against the positions [s], and by how much more with
        every second [s/s], where their clocks differ; they are put right by it.
    queued : int
        Rows that came at once from a queue, at most; 0 where stamps are none of a queue.
    """

    period: float
    error: float = 0.0
    jitter: float = 0.0
    reading: str = "even"
    repeated: int = 0
    stale: int = 0
    excess: bool = False
    held: dict[str, int] = field(default_factory=dict)
    gaps: tuple[Gap, ...] = ()
    wrong: int = 0
    dropped: float = 0.0
    queued: int = 0
    late: float = 0.0
    drift: float = 0.0

    @property
    def rate(self) -> float:
        """Rate of the rows [Hz]."""
        return 1.0 / self.period

    @property
    def source(self) -> float:
        """Rate at which the slowest of positions and efforts was truly measured [Hz]."""
        return self.rate / max([1, *(self.held.get(k, 1) for k in ("q", "tau", "tau_ext"))])

    @property
    def even(self) -> bool:
        """Whether the recording is used as it is."""
        touched = self.repeated or self.stale or self.held or self.gaps or self.wrong or self.queued
        return not touched and self.jitter <= EVEN * self.period


@dataclass(frozen=True)
class Even:
    """A part of a run on an even grid.

    Parameters
    ----------
    recording : Recording
        Its samples, evenly spaced.
    bridges : ndarray (k, 2) of int
        First and last-but-one samples of each stretch that was not recorded.
    start : float
        Its start after that of the run [s].
    """

    recording: Recording
    bridges: IntArray
    start: float = 0.0


def even(r: Recording, rate_hz: float = 0.0, gap_s: float = 0.0) -> tuple[list[Even], Timing]:
    """Parts of a run on an even grid, and what was found of its clock.

    Parameters
    ----------
    r : Recording
        As recorded; time not running backward.
    rate_hz : float
        Rate of the rows where it is known [Hz]; 0 = from the stamps.
    gap_s : float
        Gap from which a run is split [s]; 0 = `SPLIT_S`.
    """
    none = np.zeros((0, 2), dtype=np.intp)
    if r.n < 20 or not r.t[-1] > r.t[0]:
        return [Even(r, none)], Timing(max(r.period, 1e-9) if r.n > 1 else 1.0)
    r, wrong = _mended(r)
    rows, repeated = _once(r)
    t, queued = arrivals(r, 1 / rate_hz if rate_hz else 0.0)
    r = replace(r, t=t) if queued else r
    r, held = _released(r, rows)
    rows, stale, own = _changed(r, rows)
    if own > 1:
        held = {**held, "q": own, "tau": own}
    found = _clock(r, rows, stale, rate_hz)
    held = {k: v for k, v in held.items() if v > 1}
    timing = replace(found.timing, repeated=repeated, wrong=wrong, held=held, queued=queued)
    if own > 1:
        # the rows themselves are the slow channel's: what is left has its rate
        timing = replace(timing, held={k: v for k, v in timing.held.items() if v != own})
    if timing.even and rows.size == r.n:
        return [Even(r, none)], timing
    return _parts(r, found, timing, gap_s or SPLIT_S)


@dataclass(frozen=True)
class _Found:
    """Rows that count, their places on the grid, and their instants in periods."""

    rows: IntArray
    place: IntArray
    instant: FloatArray
    timing: Timing


def _mended(r: Recording) -> tuple[Recording, int]:
    """Single wrong values put on the cubic through the two on either side of them."""
    count = 0
    changes: dict[str, Any] = {}
    for key in ("q", "tau", "tau_ext"):
        values = getattr(r, key)
        for k in range(0 if values is None else values.shape[1]):
            at = spikes(values[:, k])
            at = at[(at > 1) & (at < r.n - 2)]
            if at.size:
                x = changes.setdefault(key, values.copy(order="F"))[:, k]
                x[at] = (4 * (x[at - 1] + x[at + 1]) - x[at - 2] - x[at + 2]) / 6
                count += at.size
    return (replace(r, **changes) if count else r), count


def _once(r: Recording) -> tuple[IntArray, int]:
    """Rows without those that repeat stamp and values of the one before, and how many do."""
    again = np.concatenate([[False], (np.diff(r.t) <= 0) & ~_differs(r, WATCHED)])
    return np.flatnonzero(~again), int(np.sum(again))


def _differs(r: Recording, keys: tuple[str, ...]) -> NDArray[np.bool_]:
    """Steps (n - 1,) at which any of these channels changes."""
    values = [x for key in keys if (x := getattr(r, key)) is not None]
    each = [np.any(np.diff(x, axis=0) != 0, axis=1) for x in values]
    return np.asarray(np.any(each, axis=0), dtype=np.bool_)


def _hold(changes: NDArray[np.bool_]) -> int:
    """Rows for which values are held, where all holds are alike; else 1."""
    at = np.flatnonzero(changes)
    if at.size < 10:
        return 1
    length = np.diff(at)
    usual = float(np.median(length))
    low, high = np.quantile(length, (0.05, 0.9))
    # a slow joint's counts change at all intervals, and a standstill is longer than any
    alike = usual >= 2 and low > usual / LONGEST_HOLD and high < usual * LONGEST_HOLD
    return round(usual) if alike else 1


def _measured(values: FloatArray, changes: NDArray[np.bool_], hold: int) -> IntArray:
    """Rows of a held channel (n, d) at which it was measured: where it changes, and in its rests.

    A joint that rests is measured once a hold, too, and found where it was; a spline without these
    rows swings through the rest.  Where a value was lost, the next step is one of several: such
    holds, and those alone, are left to the spline.
    """
    fresh = np.concatenate([[0], 1 + np.flatnonzero(changes)])
    count = np.rint(np.diff(fresh) / hold).astype(np.intp)
    step = np.pad(np.abs(np.diff(values[fresh], axis=0)), ((1, 1), (0, 0)))
    lost = np.any(step[1:-1] > MISSING * np.maximum(step[:-2], step[2:]), axis=1)
    rests = np.flatnonzero((count > 1) & ~(lost & (count <= FILLED)))
    more = [fresh[k] + hold * np.arange(1, count[k]) for k in rests]
    return np.sort(np.concatenate([fresh, *more])).astype(np.intp)


def _released(r: Recording, rows: IntArray) -> tuple[Recording, dict[str, int]]:
    """Channels that hold values which others do not: a spline through where they change."""
    held: dict[str, int] = {}
    for key in ("q", "tau", "tau_ext"):
        if getattr(r, key) is not None:
            held[key] = _hold(_differs(r, (key,)))
    if len(set(held.values())) <= 1 and _hold(_differs(r, WATCHED)) > 1:
        return r, {}
    changes: dict[str, Any] = {}
    for key, hold in held.items():
        if hold > 1:
            fresh = _measured(getattr(r, key), _differs(r, (key,)), hold)
            known = scipy.interpolate.CubicSpline(r.t[fresh], getattr(r, key)[fresh], axis=0)
            changes[key] = np.asarray(known(np.minimum(r.t, r.t[fresh[-1]])))
    return (replace(r, **changes) if changes else r), held


def _changed(r: Recording, rows: IntArray) -> tuple[IntArray, NDArray[np.bool_], int]:
    """Rows that bring something new, whether stale ones lie before each, and rows of one hold."""
    part = r.slice(0, r.n) if rows.size == r.n else _picked(r, rows)
    changes = _differs(part, WATCHED)
    hold = _hold(changes)
    if hold > 1:
        fresh = _measured(part.q, changes, hold)
        return rows[fresh], np.zeros(fresh.size, dtype=np.bool_), hold
    fresh = np.concatenate([[0], 1 + np.flatnonzero(changes)])
    before = np.diff(fresh, prepend=0) - 1
    # everything exactly the same for one or two rows: at a standstill it is so for many more
    short = (before > 0) & (before <= 2)
    if np.sum(short) <= 3 + 3 * _by_chance(part):
        short = np.zeros_like(short)
    keep = np.ones(part.n, dtype=np.bool_)
    for k in np.flatnonzero(short):
        keep[fresh[k] - before[k] : fresh[k]] = False
    kept = np.flatnonzero(keep)
    stale = np.zeros(part.n, dtype=np.bool_)
    stale[fresh[short]] = True
    return rows[kept], stale[kept], 1


def _by_chance(r: Recording) -> float:
    """Rows that would repeat the one before if every column did so by itself, as counts do."""
    values = [x for key in WATCHED if (x := getattr(r, key)) is not None]
    share = [float(np.prod(np.mean(np.diff(x, axis=0) == 0, axis=0))) for x in values]
    return (r.n - 1) * float(np.prod(share))


def _picked(r: Recording, rows: IntArray) -> Recording:
    arrays: dict[str, Any] = {
        k: v[rows] for k in ("t", *COLUMNS) if (v := getattr(r, k)) is not None
    }
    return replace(r, **arrays)


def _clock(r: Recording, rows: IntArray, stale: NDArray[np.bool_], rate_hz: float) -> _Found:
    """The reading of the stamps that foretells the positions best."""
    t, q = r.t[rows] - r.t[rows[0]], r.q[rows]
    period = 1 / rate_hz if rate_hz else _period(np.diff(t))
    place = _places(t, period)
    if not rate_hz:
        period = _refined(t, place, period)
        place = _places(t, period)
    readings = {"even": (place.astype(np.float64), place)}
    step = np.diff(t) - np.diff(place) * period
    jitter = float(np.sqrt(np.mean(step**2) / 2))
    if jitter > EVEN * period:
        stamps = np.maximum.accumulate(t / period)
        readings["stamps"] = (stamps, np.rint(stamps).astype(np.intp))
    if np.any(stale):
        fewer = place - np.cumsum(np.where(stale, np.diff(place, prepend=0) - 1, 0))
        readings["excess"] = (fewer.astype(np.float64), fewer)
    score = {
        k: _strayed(x, q) * (1.0 if k == "even" else 1 + BETTER) for k, (x, _) in readings.items()
    }
    best = min(score, key=lambda k: score[k])
    instant, place = readings[best]
    if best == "excess" and not rate_hz:
        period = _refined(t, place, float(t[-1] / place[-1]))
    error = jitter / period / np.sqrt(12.0 / rows.size) / rows.size if rows.size else 0.0
    gaps = tuple(
        Gap(float(r.t[rows[k]]), float(t[k + 1] - t[k]), int(place[k + 1] - place[k] - 1))
        for k in _holes(instant, place)
    )
    timing = Timing(
        period,
        error * period,
        jitter,
        "stamps" if best == "stamps" else "even",
        stale=int(np.sum(stale)),
        excess=best == "excess",
        gaps=gaps,
    )
    return _Found(rows, place, instant, timing)


def _period(dt: FloatArray) -> float:
    """Period of the stamps: their median step; their mean one where many are the same."""
    many = np.mean(dt <= 0) > 0.1
    return float(np.mean(dt) if many else np.median(dt[dt > 0]))


def _places(t: FloatArray, period: float) -> IntArray:
    """Place of each row on the grid: one on, or more where a step stays too long."""
    dt = np.diff(t)
    steps = np.maximum(np.rint(dt / period), 1).astype(np.intp)
    for k in np.flatnonzero(dt > MISSING * period):
        if dt[k] < LATE * period and _comes_right(dt, int(k), period):
            steps[k] = 1
    return np.concatenate([[0], np.cumsum(steps)])


def _comes_right(dt: FloatArray, k: int, period: float) -> bool:
    """Whether a long step is a late stamp: with its neighbours the rows are all there."""
    for size in range(2, LATE + 1):
        for first in (k, k - size + 1):
            if 0 <= first and first + size <= dt.size:
                span = dt[first : first + size]
                if np.sum(span) < (size + 0.5) * period and np.max(span) == dt[k]:
                    return True
    return False


def _holes(instant: FloatArray, place: IntArray) -> IntArray:
    """Rows behind which some are missing.

    Two rows of an uneven clock may lie next to one place of the grid: another one is empty then.
    """
    return np.flatnonzero((np.diff(place) > 1) & (np.diff(instant) > MISSING)).astype(np.intp)


def _refined(t: FloatArray, place: IntArray, period: float) -> float:
    """Slope of the stamps over the places; as it was where that is no better."""
    k = place - place.mean()
    slope = float(np.sum(k * t) / max(np.sum(k**2), 1e-300))
    return slope if abs(slope / period - 1) < 0.05 else period


def _strayed(x: FloatArray, q: FloatArray) -> float:
    """Geometric mean over the joints of rms (q_k - its neighbours' cubic), time x in periods."""
    x = np.asarray(x, dtype=np.float64)
    n = x.size
    if n < 10:
        return 0.0
    at = x[2:-2]
    near = np.stack([x[:-4], x[1:-3], x[3 : n - 1], x[4:]])
    usable = (near[3] - near[0] < 2.5 * 4) & (np.min(np.diff(near, axis=0), axis=0) > 0.1)
    foretold = np.zeros((n - 4, q.shape[1]))
    values = (q[:-4], q[1:-3], q[3 : n - 1], q[4:])
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in range(4):
            weight = np.prod(
                [(at - near[m]) / (near[i] - near[m]) for m in range(4) if m != i], axis=0
            )
            foretold += weight[:, None] * values[i]
        error = (q[2:-2] - foretold)[usable]
    if len(error) < 10:
        return np.inf
    rms = np.sqrt(np.mean(error**2, axis=0))
    rms = rms[rms > 0]
    return float(np.exp(np.mean(np.log(rms)))) if rms.size else 0.0


# ------------------------------------------------------------ two clocks

#: Largest drift of the efforts' clock against that of the positions [s/s], and largest lateness at
#: its start [s].  Half: drifts of 2 % stay; double: twice the time, and more motions that repeat.
DRIFT, START_S = 0.03, 0.5
#: Band [Hz] of the motion by which drifts are told, and rate [Hz] in it.  Half: quick strokes tell
#: nothing; double: lateness is sought in twice as many steps.
TOLD_HZ, TOLD_RATE = 5.0, 100.0
#: Rate [Hz] at which many ways are ranked: five times the band.  Half: lateness is told by aliases;
#: double: twice the time.
RANKED_HZ = 25.0
#: Steps [s] by which lateness is sought, and length [s] of the first stretch; each next one is
#: twice as long.  Half: more time; double: strokes of 2 Hz are passed over.
LATE_STEP, FIRST_S = 0.025, 8.0
#: Ways that are followed from one stretch to the next.  Half: a motion that repeats may lead
#: astray; double: twice the time.
FOLLOWED = 24
#: Share of the efforts' square, left by a lateness that does not grow, below which none is sought.
#: Half: more time; double: small drifts stay where a fit of one run finds them.
WELL = 0.02
#: Share of the squared error that a drift must leave at most, of that of the best lateness that
#: does not grow; and growth [s] over a run below which a fit tells it (`hil.identify.timing`).
#: Half: drifts beside a missing effect stay; double: what only looks so is taken for one.
TAKES, GROWS_S = 0.6, 0.02


@dataclass(frozen=True)
class _Told:
    """What tells a drift of a run: time since its start, columns by joint, efforts."""

    since: FloatArray
    columns: list[FloatArray]
    efforts: FloatArray

    def within(self, way: FloatArray) -> _Left:
        """What is left where efforts that are late by about so much were recorded."""
        late = self.since + way[0] + way[1] * self.since
        return self._of((late > self.since[0] + LATE_STEP) & (late < self.since[-1] - LATE_STEP))

    def left(self, end: float, start: float = -np.inf) -> _Left:
        """What is left in the time from `start` up to `end` [s]."""
        return self._of((self.since >= start) & (self.since <= end))

    def roughly(self, end: float) -> _Left:
        """The same of no more instants than the band asks for, by which many ways are ranked."""
        at = self.since <= end
        step = max(int(1.0 / (RANKED_HZ * float(self.since[1] - self.since[0]))), 1)
        at[np.arange(at.size) % step != 0] = False
        return self._of(at)

    def _of(self, at: NDArray[np.bool_]) -> _Left:
        bases = [np.linalg.qr(x[at])[0] for x in self.columns]
        return _Left(self.since[at], bases, self.since, self.efforts)


@dataclass(frozen=True)
class _Left:
    """What is left of the efforts of a stretch if they are late by s + c t."""

    since: FloatArray
    bases: list[FloatArray]
    whole: FloatArray
    efforts: FloatArray

    def __call__(self, way: FloatArray) -> float:
        """Mean over the joints of the log of the share of the square that is left."""
        return float(self.each(way[None])[0])

    def each(self, ways: FloatArray) -> FloatArray:
        """The same of several ways (m, 2), (m,)."""
        at = self.since + ways[:, :1] + ways[:, 1:] * self.since
        out = np.zeros(len(ways))
        for basis, effort in zip(self.bases, self.efforts.T, strict=True):
            y = np.interp(at, self.whole, effort)
            y -= y.mean(axis=1, keepdims=True)
            square = np.maximum(np.einsum("ij,ij->i", y, y), 1e-300)
            out += np.log(np.maximum(1.0 - np.sum((y @ basis) ** 2, axis=1) / square, 1e-12))
        return out / len(self.bases)


#: What was found of a run that is in memory, by its identity: a reference to it, and by its grid.
_FOUND: dict[int, tuple[weakref.ref[Recording], dict[tuple[int, float], FloatArray | None]]] = {}


def _way(run: Recording, parts: list[Even], timing: Timing) -> FloatArray | None:
    """Lateness and drift of a run, sought once for each grid that it is put on."""
    key = id(run)
    known = _FOUND.get(key)
    if known is None or known[0]() is not run:
        known = (weakref.ref(run, lambda _: _FOUND.pop(key, None)), {})
        _FOUND[key] = known
    grid = (len(parts), timing.period)
    if grid not in known[1]:
        told = _told(parts)
        known[1][grid] = _drift(told) if told is not None else None
    return known[1][grid]


def on_one_clock(run: Recording, parts: list[Even], timing: Timing) -> tuple[list[Even], Timing]:
    """Parts of a run with the efforts on the clock of the positions, where the two differ.

    Efforts r that are late by s + c t acted as tau(t) = r(t + s + c t).  The two numbers are sought
    by how well what a joint's own motion explains of its effort, whatever its coefficients:
    acceleration, speed, direction and posture.  A first stretch leaves some pairs, each next one
    fewer.  What lies beyond the recorded efforts is cut off.
    """
    way = _way(run, parts, timing)
    if way is None:
        return parts, timing
    each = (_told(parts), _told(parts, rates=False))
    way = _refined_way(way, [x for x in each if x is not None])
    out = []
    for part in parts:
        r = part.recording
        t = r.t + way[0] + way[1] * (part.start + r.t - r.t[0])
        inside = np.flatnonzero((t >= r.t[0]) & (t <= r.t[-1]))
        if inside.size < 20:
            continue
        first, last = int(inside[0]), int(inside[-1]) + 1
        changes: dict[str, Any] = {}
        for key in ("tau", "current"):
            if (values := getattr(r, key)) is not None:
                spline = scipy.interpolate.CubicSpline(r.t, values, axis=0)
                changes[key] = spline(np.clip(t, r.t[0], r.t[-1]))
        bridges = np.clip(part.bridges - first, 0, last - first)
        bridges = bridges[bridges[:, 1] > bridges[:, 0]]
        start = part.start + float(r.t[first] - r.t[0])
        out.append(Even(replace(r, **changes).slice(first, last), bridges, start))
    if not out:
        return parts, timing
    return out, replace(timing, late=float(way[0]), drift=float(way[1]))


def _told(parts: list[Even], rates: bool = True) -> _Told | None:
    """What tells a drift of a run; None where it is too short, or nothing moves.

    `rates`: of all of it the rates, in which gravity's slow pull does not hide the rest.
    """
    first, last = parts[0].recording, parts[-1]
    length = last.start + float(last.recording.t[-1] - last.recording.t[0])
    if length < 2 * FIRST_S or first.rate < 4 * TOLD_HZ or min(p.recording.n for p in parts) < 100:
        return None
    spans = [np.ptp(np.concatenate([getattr(p.recording, k) for p in parts]), 0) for k in _BOTH]
    moves = np.flatnonzero((spans[0] > 0) & (spans[1] > 0))
    if not moves.size:
        return None
    step = max(int(first.rate / TOLD_RATE), 1)
    rate = first.rate / step
    since, made = [], []
    for p in parts:
        q, tau = (_low(getattr(p.recording, k), first.rate, 2)[::step] for k in _BOTH)
        speed = np.gradient(q, 1 / rate, axis=0)
        slow = 0.1 * np.sqrt(np.mean(speed**2, axis=0)) + 1e-300
        sign = np.tanh(speed / slow)
        shared = [np.gradient(speed, 1 / rate, axis=0), np.sin(q), np.cos(q)]
        by_joint = [np.stack([q[:, j], speed[:, j], sign[:, j]], axis=1) for j in moves]
        every = [*(x[:, moves] for x in shared), *by_joint, tau[:, moves]]
        low = _low(np.concatenate([*every[:-1], np.ones((len(q), 1)), every[-1]], axis=1), rate, 1)
        made.append(np.gradient(low, axis=0) if rates else low)
        since.append(p.start + np.arange(len(q)) / rate)
    columns, n = np.concatenate(made), moves.size
    columns = columns / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    common, own = columns[:, : 3 * n], columns[:, 3 * n : -n - 1]
    one = columns[:, [] if rates else [-n - 1]]
    each = [np.concatenate([one, common, own[:, 3 * k : 3 * k + 3]], axis=1) for k in range(n)]
    return _Told(np.concatenate(since), each, columns[:, -n:])


#: What tells a drift.
_BOTH = ("q", "tau")


def _low(x: FloatArray, rate: float, times: int) -> FloatArray:
    """Columns (n, m) below so many times the band, of a rate that is high enough."""
    cutoff = min(times * TOLD_HZ, 0.4 * rate)
    sos = scipy.signal.butter(2, cutoff, fs=rate, output="sos")
    return np.asarray(scipy.signal.sosfiltfilt(sos, x, axis=0))


def _drift(told: _Told) -> FloatArray | None:
    """Lateness at the start [s] and its growth [s/s]; None where the clocks do not differ."""
    length, end = float(told.since[-1]), FIRST_S
    whole = told.left(length)
    starts = np.arange(-START_S, START_S + LATE_STEP, LATE_STEP)
    steps = np.stack([starts, np.zeros(starts.size)], axis=1)
    near = starts[np.argmin(told.roughly(length).each(steps))]
    steady = scipy.optimize.minimize_scalar(
        lambda s: whole(np.array([s, 0.0])),
        bounds=(near - LATE_STEP, near + LATE_STEP),
        method="bounded",
    )
    alone = np.array([steady.x, 0.0])
    if steady.fun < np.log(WELL):
        return None
    rates = np.arange(-DRIFT, DRIFT + 1e-9, LATE_STEP / end)
    ways = np.stack(np.meshgrid(starts, rates), axis=-1).reshape(-1, 2)
    while True:
        ways = ways[np.argsort(told.roughly(end).each(ways))[:FOLLOWED]]
        if end >= length:
            break
        longer = min(2 * end, length)
        offset = np.arange(-2, 3) * LATE_STEP / longer
        late = np.array([-LATE_STEP / 2, 0.0, LATE_STEP / 2])
        near = np.stack(np.meshgrid(late, offset), axis=-1).reshape(-1, 2)
        ways = np.unique(np.round((ways[:, None] + near).reshape(-1, 2), 9), axis=0)
        end = longer
    best: FloatArray = ways[0]
    best = _least(whole, best, length)
    # no shift may do better for what it shifts out of the run: a jolt at its end
    edge = max(abs(best[0]), abs(best[0] + best[1] * length)) + LATE_STEP
    if abs(best[1]) * length <= GROWS_S or 2 * edge > length / 3:
        return None
    # a clock runs on: what is late in the middle is late the other way round at either end
    spans = (edge, length - edge), (edge, length / 3), (2 * length / 3, length - edge)
    parts = [told.left(end, start) for start, end in spans]
    return best if all(x(best) < x(alone) + np.log(TAKES) for x in parts) else None


def _refined_way(way: FloatArray, told: Sequence[_Told]) -> FloatArray:
    """The same to the full, where efforts were recorded."""
    each = [x.within(way) for x in told]
    return _least(lambda w: sum(left(w) for left in each), way, float(told[0].since[-1]))


def _least(left: Callable[[FloatArray], float], way: FloatArray, length: float) -> FloatArray:
    """Lateness at the start and its growth that leave least, from near."""
    simplex = way + np.array([[0, 0], [LATE_STEP / 2, 0], [0, LATE_STEP / length]])
    options: Any = {"initial_simplex": simplex, "xatol": 1e-7, "fatol": 1e-7}
    found = scipy.optimize.minimize(left, way, method="Nelder-Mead", options=options)
    return np.asarray(found.x, dtype=np.float64)


def _parts(r: Recording, found: _Found, timing: Timing, gap_s: float) -> tuple[list[Even], Timing]:
    """Parts of a run between long gaps, each on its grid; what was split or left out is said."""
    at: FloatArray = found.place * np.float64(timing.period)
    holes = _holes(found.instant, found.place)
    cuts = holes[np.diff(at)[holes] > gap_s]
    edges = [0, *(int(c) + 1 for c in cuts), found.rows.size]
    ranges = list(pairwise(edges))
    ranges, dropped = _merged(ranges, at)
    starts = {a for a, _ in ranges}
    ends = {b for _, b in ranges}
    gaps = []
    for gap, k in zip(timing.gaps, holes, strict=True):
        gaps.append(replace(gap, split=k + 1 in starts or k + 1 in ends))
    parts = [_part(r, found, timing, a, b) for a, b in ranges]
    return parts, replace(timing, gaps=tuple(gaps), dropped=dropped)


def _merged(ranges: list[tuple[int, int]], t: FloatArray) -> tuple[list[tuple[int, int]], float]:
    """Parts that are too short joined to the nearer neighbour, or left out beyond a long gap."""
    dropped = 0.0
    while len(ranges) > 1:
        length = [t[b - 1] - t[a] for a, b in ranges]
        k = int(np.argmin(length))
        if length[k] >= ALONE_S:
            break
        a, b = ranges[k]
        left = t[a] - t[a - 1] if k else np.inf
        right = t[b] - t[b - 1] if k + 1 < len(ranges) else np.inf
        if min(left, right) > FAR_S:
            dropped += float(length[k])
            del ranges[k]
        elif left <= right:
            ranges[k - 1 : k + 1] = [(ranges[k - 1][0], b)]
        else:
            ranges[k : k + 2] = [(a, ranges[k + 1][1])]
    return ranges, dropped


def _part(r: Recording, found: _Found, timing: Timing, first: int, last: int) -> Even:
    """Rows first..last of those that count, on the grid; stretches that were not recorded."""
    rows = found.rows[first:last]
    place = found.place[first:last] - found.place[first]
    x = found.instant[first:last] - found.place[first]
    n = int(place[-1]) + 1
    start = float(found.place[first]) * timing.period
    t = r.t[found.rows[0]] + start + np.arange(n) * timing.period
    arrays: dict[str, Any] = {"t": t}
    whole = timing.reading == "stamps"
    for key in COLUMNS:
        if (values := getattr(r, key)) is not None:
            fill = _resampled if whole else _filled
            arrays[key] = fill(x, place, values[rows], n)
    if not whole:
        arrays["q"] = _counted(arrays["q"], r.q[rows], place)
    holes = _holes(x, place)
    bridges = np.stack([place[holes] + 1, place[holes + 1]], axis=1) if holes.size else None
    none = np.zeros((0, 2), dtype=np.intp)
    return Even(replace(r, **arrays), none if bridges is None else bridges, start)


def _filled(x: FloatArray, place: IntArray, values: FloatArray, n: int) -> FloatArray:
    """Values (k, m) at their places on a grid of n; splines where a few are missing."""
    out = np.empty((n, values.shape[1]))
    out[place] = values
    step = np.diff(place)
    if not np.any(step > 1):
        return out
    missing = np.ones(n, dtype=np.bool_)
    missing[place] = False
    at = np.flatnonzero(missing)
    spline = scipy.interpolate.CubicSpline(place, values, axis=0)(at)
    wide = step[np.searchsorted(place, at) - 1] > FILLED + 1
    for k in range(values.shape[1]):
        line = np.interp(at, place, values[:, k])
        out[at, k] = np.where(wide, line, spline[:, k])
    return out


def _resampled(x: FloatArray, place: IntArray, values: FloatArray, n: int) -> FloatArray:
    """Values (k, m) at instants x on a grid of n, by splines; straight lines over wide gaps."""
    keep = np.concatenate([[True], np.diff(x) > 0.2])
    x, values = x[keep], values[keep]
    grid = np.clip(np.arange(n, dtype=np.float64), x[0], x[-1])
    out = np.asarray(scipy.interpolate.CubicSpline(x, values, axis=0)(grid))
    after = np.clip(np.searchsorted(x, grid), 1, x.size - 1)
    wide = x[after] - x[after - 1] > FILLED + 1
    for k in range(values.shape[1]):
        out[wide, k] = np.interp(grid[wide], x, values[:, k])
    return out


def _counted(q: FloatArray, recorded: FloatArray, place: IntArray) -> FloatArray:
    """Filled positions rounded to the encoder's counts, where the recorded ones come in counts."""
    filled = np.ones(len(q), dtype=np.bool_)
    filled[place] = False
    for k in range(q.shape[1]):
        count = resolution(recorded[:, k], exact=True)
        if count and np.any(filled):
            origin = recorded[0, k]
            q[filled, k] = origin + np.round((q[filled, k] - origin) / count) * count
    return q
