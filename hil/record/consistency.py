"""Data faults that only the laws of motion show: steps, clipping, scales, signs, single spikes.

All of them are warnings, and each is given only on strong evidence: a false alarm costs more
trust than a missed one.  A spike is a sample that stands out of its neighbours, as after an error
of transmission or a loose contact.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d

from hil.record.jumps import whole_numbers
from hil.record.recording import Recording, queue, spacing, usual_step
from hil.record.urdf_checks import UrdfJoint

FloatArray = NDArray[np.float64]

#: Angles [rad] that a joint does not swing through and back: one of which nothing is known, and
#: one that its URDF says to be continuous.
TWO_TURNS, MANY_TURNS = 4 * math.pi, 32 * math.pi


@dataclass(frozen=True)
class Clipping:
    """A column that stays at its extreme value: level, share of the samples [-]."""

    level: float
    share: float


#: Bursts on either side of a step by whose least late one missing rows are told.  Half: stamps that
#: are cut to whole units look like missing rows now and then; double: an error of the first period
#: does.
BURSTS = 50


def arrivals(r: Recording, period: float = 0.0) -> tuple[FloatArray, int]:
    """Time of rows that were stamped as they were taken from a queue, on the even clock behind it.

    Of such rows many come at once, and then none for as long as they took to be measured.  The last
    row of a burst is the least late.  Where all rows are later for good by m periods behind a step,
    m rows are missing there.

    Parameters
    ----------
    r : Recording
        Time not running backward.
    period : float
        Period of the rows where it is known [s].

    Returns
    -------
    t : ndarray (n,)
        The stamps, or instants on that clock.
    burst : int
        Rows that came at once, at most; 0 of other stamps, which stay.
    """
    channels = (r.q, r.tau, r.qd, r.tau_ext, r.wrench)
    values = [x for x in channels if x is not None]
    new = np.any([np.any(np.diff(x, axis=0) != 0, axis=1) for x in values], axis=0)
    rows = np.flatnonzero(np.concatenate([[True], new | (np.diff(r.t) > 0)]))
    t = r.t[rows]
    dt = np.diff(t)
    typical, at_once = queue(dt)
    if not typical:
        return r.t, 0
    edges = np.flatnonzero(~np.concatenate([[False], at_once, [False]]))
    burst = int(np.max(np.diff(edges)))
    given, period = period, period or usual_step(dt)
    for _ in range(3):
        place = _left_queue(t / period)
        period = given or spacing(t, place, typical)
    least = float(np.min(t - place * period))
    return np.interp(np.arange(r.n), rows, least + place * period), burst


def _left_queue(t: FloatArray) -> NDArray[np.intp]:
    """Place of each row (n,) on the clock of a queue, by its stamps in periods.

    Rows are missing before a burst where the least late one from there on is later than before.
    """
    last = np.append(np.flatnonzero(np.diff(t) > 1.5), t.size - 1)
    late = (t - np.arange(t.size))[last].tolist()
    missing, lost = np.zeros(t.size, dtype=np.intp), 0
    level = deque(late[:1], maxlen=BURSTS)
    for k in range(1, len(late)):
        more = round(min(late[k : k + BURSTS]) - lost - min(level))
        if more > 0:
            missing[last[k - 1] + 1], lost = more, lost + more
        level.append(late[k] - lost)
    return np.arange(t.size) + np.cumsum(missing)


def steps(t: FloatArray, q: FloatArray) -> NDArray[np.intp]:
    """Samples after which a position (n,) jumps by itself, the velocity before and after alike.

    Parameters
    ----------
    t : ndarray (n,)
        Time [s]; steps across a gap are not counted.
    q : ndarray (n,)
        Position.

    Returns
    -------
    ndarray of int
        Indices k with a jump from k to k + 1; empty where there are too many to be faults.
    """
    dt, dq = np.diff(t), np.diff(q)
    none = np.empty(0, dtype=np.intp)
    if dq.size < 50 or not np.any(dq):
        return none
    dq = np.where(dt > 1.5 * float(np.median(dt)), 0.0, dq)
    # a step is at most twice the largest from its neighbours' median, and must be 3 times `fastest`
    if reached(np.abs(dq), 2 / 3 * float(np.abs(dq).max())):
        return none
    size = np.abs(dq - median_filter(dq, 9))
    count = float(np.min(np.abs(dq[dq != 0])))
    before = np.concatenate(([0.0], maximum_filter1d(size, 25, origin=12)[:-1]))
    after = np.concatenate((maximum_filter1d(size, 25, origin=-12)[1:], [0.0]))
    around = np.maximum(before, after)
    fastest = float(np.quantile(np.abs(dq), 0.99))
    limit = np.maximum(8 * around, max(6 * count, 3 * fastest, 1e-4 * float(np.ptp(q))))
    found = np.flatnonzero(size > limit)
    return found if found.size <= max(20, dq.size // 1000) else found[:0]


def reached(size: FloatArray, level: float) -> bool:
    """Whether a count alone says that the 99 % quantile of sizes (n,) is a level or more."""
    return bool(np.count_nonzero(size >= level) > 0.01 * size.size + 2)


def clipping(values: FloatArray, moving: Callable[[], NDArray[np.bool_]]) -> list[Clipping]:
    """Extremes at which a column (n,) is cut off while the joint moves.

    A cut-off extreme is visited at least twice, each time for several samples, and holds far more
    samples than the levels next to it.

    Parameters
    ----------
    values : ndarray (n,)
        Effort or force.
    moving : callable
        Gives where the joint moves, (n,) of bool; asked only where an extreme is held at all.
    """
    out: list[Clipping] = []
    span, n = float(np.ptp(values)), values.size
    least = max(20, 0.002 * n)
    for level in (float(values.max()), float(values.min())):
        away = np.abs(values - level)
        at = away <= 1e-9 * span
        if np.count_nonzero(at) < least:
            continue
        at &= moving()
        edges = np.flatnonzero(np.diff(np.concatenate(([False], at, [False])).astype(np.int8)))
        lengths = edges[1::2] - edges[::2]
        held = int(lengths[lengths >= 4].sum())
        visits = int(np.count_nonzero(lengths >= 4))
        if held < least or visits < 2 or abs(level) <= 0.05 * span:
            continue
        near = np.count_nonzero((away > 1e-9 * span) & (away <= 0.01 * span))
        if held > 3 * near:
            out.append(Clipping(level, held / n))
    return [] if out and _coarse(values, span) else out


def _coarse(values: FloatArray, span: float) -> bool:
    """Whether a column (n,) has so few levels that its extremes are held without being cut off."""
    levels = np.unique(values)
    return levels.size < 30 or float(np.median(np.diff(levels))) > 0.002 * span


def smooth(values: FloatArray, width: int) -> FloatArray:
    """Moving average (twice) of so many samples along time."""
    once = uniform_filter1d(values, max(width, 1), axis=0, mode="nearest")
    return np.asarray(uniform_filter1d(once, max(width, 1), axis=0, mode="nearest"))


def rate_of(t: FloatArray, x: FloatArray, width: int) -> FloatArray:
    """Rate of change of a smoothed signal (n,); times are smoothed alike.

    It is a mean of the rates between rows, with positive weights: never beyond the fastest of
    them, however irregular the times are and wherever rows are lost.
    """
    return np.asarray(
        np.gradient(smooth(x, width)) / np.gradient(smooth(t - t[0], width)), dtype=np.float64
    )


def velocity_factor(t: FloatArray, q: FloatArray, qd: FloatArray) -> tuple[float, float]:
    """Measured velocity over derivative of the position: factor and correlation.

    Parameters
    ----------
    t, q, qd : ndarray (n,)
        Time [s], position, measured velocity.

    Returns
    -------
    factor, correlation : float
        NaN where the joint hardly moves, or most times repeat.
    """
    period = float(np.median(np.diff(t)))
    if not period > 0:
        return float("nan"), float("nan")
    width = max(int(0.05 / period), 3)
    trim = slice(2 * width, -2 * width or None)
    derivative = rate_of(t, q, width)[trim]
    measured = smooth(qd, width)[trim]
    steps_q = np.abs(np.diff(q))
    count = float(np.min(steps_q[steps_q > 0], initial=np.inf))
    if derivative.size < 50 or np.ptp(q) < 50 * count or not np.any(measured):
        return float("nan"), float("nan")
    # in phase up to a lag of 20 ms: take the better of a few shifts
    best = (float("nan"), 0.0)
    for lag in range(-int(0.02 / period), int(0.02 / period) + 1, max(int(0.005 / period), 1)):
        shifted = np.roll(measured, lag)
        norm = float(np.sqrt(np.mean(derivative**2) * np.mean(shifted**2)))
        correlation = float(np.mean(derivative * shifted)) / norm if norm else 0.0
        if abs(correlation) > abs(best[1]):
            ratio = float(np.mean(derivative * shifted) / np.mean(derivative**2))
            best = (ratio, correlation)
    return best


def moves(t: FloatArray, q: FloatArray) -> NDArray[np.bool_]:
    """Where a joint moves at a changing speed, (n,).

    At constant speed a constant effort is nothing strange.
    """
    width = max(int(0.02 / float(np.median(np.diff(t)))), 3)
    speed = rate_of(t, q, width)
    rate = np.abs(rate_of(t, speed, width))
    fast = np.abs(speed) > 0.01 * float(np.abs(speed).max())
    return np.asarray(fast & (rate > 0.01 * float(rate.max())))


def swings(q: FloatArray) -> int:
    """How often a joint crosses the middle of its range."""
    centred = q - 0.5 * (float(q.max()) + float(q.min()))
    side = np.sign(centred[np.abs(centred) > 0.1 * float(np.ptp(q))])
    return int(np.count_nonzero(np.diff(side)))


def unit_doubt(q: FloatArray, joint: UrdfJoint, described: bool) -> bool:
    """Whether positions (n,) are degrees or millimetres rather than rad or m.

    Parameters
    ----------
    q : ndarray (n,)
        Position.
    joint : UrdfJoint
        The joint with its limits, infinite if there are none.
    described : bool
        Whether a URDF describes it: then a joint without limits is a continuous one.
    """
    span = float(np.ptp(q))
    if not (math.isfinite(joint.lower) and math.isfinite(joint.upper)):
        if joint.unit == "m":
            return span > 20.0
        turns = MANY_TURNS if described else TWO_TURNS
        return turns < span < 800.0 and float(np.abs(np.diff(q)).sum()) > 1.5 * span
    scale = math.pi / 180 if joint.unit == "rad" else 1e-3
    room = joint.upper - joint.lower
    outside = max(q.max() - joint.upper, joint.lower - q.min()) > max(room, 0.5)
    high, low = joint.upper + 0.1 * room, joint.lower - 0.1 * room
    return bool(outside and q.max() * scale < high and q.min() * scale > low)


def other_units(q: FloatArray, joint: UrdfJoint) -> dict[str, float]:
    """Units that positions (n,) in doubt may be in, with their size in that of the joint.

    Lengths are in centimetres or millimetres; a joint's limits may leave millimetres alone.
    """
    if joint.unit == "rad":
        return {"degrees": math.pi / 180}
    lengths, reach = {"centimetres": 0.01, "millimetres": 0.001}, 0.1 * (joint.upper - joint.lower)
    low, high = joint.lower - reach, joint.upper + reach
    if not (math.isfinite(low) and math.isfinite(high)):
        return lengths
    fit = {k: x for k, x in lengths.items() if q.max() * x < high and q.min() * x > low}
    return fit or lengths


#: A position in whole numbers over a longer range [rad or m] is in counts.
COUNTED = 100.0


def counts_doubt(q: FloatArray) -> bool:
    """Whether positions (n,) are encoder counts rather than rad or m."""
    return float(np.ptp(q)) > COUNTED and whole_numbers(q)


def stuck(t: FloatArray, q: FloatArray) -> Iterator[tuple[float, float]]:
    """Start and length [s] of intervals in which a fast position (n,) freezes, then catches up."""
    dq = np.abs(np.diff(q))
    edges = np.flatnonzero(np.diff(np.concatenate(([False], dq == 0, [False])).astype(np.int8)))
    starts, stops = edges[::2], edges[1::2]
    long = (stops - starts >= 5) & (starts > 0) & (stops < dq.size)
    if not np.any(long):
        return
    usual, period = float(np.quantile(dq, 0.9)), float(np.median(np.diff(t)))
    for start, stop in zip(starts[long].tolist(), stops[long].tolist(), strict=True):
        length = stop - start
        if length * period >= 0.02:
            before = float(np.median(dq[max(start - 5, 0) : start]))
            catch_up = float(dq[stop])
            if before > 0.3 * usual and catch_up > 0.5 * length * before:
                yield float(t[start]), length * period


@dataclass(frozen=True)
class DataFault:
    """One fault of a recording.

    Parameters
    ----------
    code : str
        Stable name, e.g. ``"gap"``.
    severity : str
        ``"error"`` (any fit would be worthless) or ``"warning"``.
    joint : str
        Joint concerned, or ``""``.
    text : str
        What was found, and what to do.
    said : Note or None
        The note that it says, where it is one.
    """

    code: str
    severity: str
    joint: str
    text: str
    said: Note | None = None

    @property
    def sentence(self) -> str:
        """What was found, with the joint in front where there is one."""
        return f"{self.joint}: {self.text}" if self.joint else self.text

    @property
    def note(self) -> Note:
        """The same beside a verdict."""
        return self.said or Note(self.code, self.sentence, self.joint)


class Note(tuple[str, str]):
    """What a user should know, a pair of code and sentence; what it is of need not be parsed.

    Parameters
    ----------
    code : str
        Stable name.
    text : str
        The sentence, without its full stop.
    joint : str
        Joint that it is of; ``""`` where it is of several or of none.
    size : str
        How much it is, in words, where others say it too.
    kind : str
        Which of several causes it tells of.
    """

    joint: str
    size: str
    kind: str

    def __new__(cls, code: str, text: str, joint: str = "", size: str = "", kind: str = "") -> Note:
        """A pair with attributes."""
        out = super().__new__(cls, (code, text))
        out.joint, out.size, out.kind = joint, size, kind
        return out

    def __getnewargs__(self) -> tuple[str, str, str, str, str]:  # copied and sent to processes
        return (*self, self.joint, self.size, self.kind)

    def saying(self, text: str) -> Note:
        """The same in other words."""
        return Note(self[0], text, self.joint, self.size, self.kind)


def notes_of(notes: Iterable[tuple[str, str]], *codes: str) -> list[Note]:
    """Those of some codes that say what they are of."""
    return [n for n in notes if isinstance(n, Note) and n[0] in codes]


#: Times the largest bend of an ordinary sample (99 % of all) from which one is a spike.
OUT_OF_SCALE = 20.0
#: Bend that the value may keep behind a spike; more is a step.
BACK_SHARE = 0.2


def spikes(x: FloatArray) -> NDArray[np.intp]:
    """Samples of a signal (n,) that leave it for one sample and come back.

    b_k = x_k - (x_{k-1} + x_{k+1}) / 2

    Parameters
    ----------
    x : ndarray (n,)
        Signal.

    Returns
    -------
    ndarray of int
        Indices; empty below 1000 samples, where the ordinary bend is not known.
    """
    none = np.empty(0, dtype=np.intp)
    if x.size < 1000:
        return none
    bend = np.abs(x[1:-1] - (x[:-2] + x[2:]) / 2)
    if reached(bend, float(bend.max()) / OUT_OF_SCALE):
        return none
    usual = float(np.quantile(bend, 0.99))
    moved = np.abs(np.diff(x))
    if not np.any(moved):
        return none
    count = float(np.min(moved[moved > 0]))
    limit = max(
        OUT_OF_SCALE * usual, 5 * count, 0.02 * float(np.subtract(*np.quantile(x, [0.99, 0.01])))
    )
    found: NDArray[np.intp] = 1 + np.flatnonzero(bend > limit)
    back = np.abs(x[found + 1] - x[found - 1]) < BACK_SHARE * bend[found - 1]
    return found[back]


def check_spikes(r: Recording) -> Iterator[DataFault]:
    """A warning for every column with spikes."""
    for k, joint in enumerate(r.joints):
        for name, values in (("q", r.q), ("tau", r.tau), ("tauext", r.tau_ext)):
            if values is None:
                continue
            at = spikes(values[:, k])
            if at.size:
                first = int(at[0])
                count = "once" if at.size == 1 else f"{at.size} times"
                yield DataFault(
                    "spike",
                    "warning",
                    joint,
                    f"{name}{k + 1} leaves its neighbours for a single sample {count}, first at "
                    f"{r.t[first]:.6g} s ({values[first, k]:.4g} between "
                    f"{values[first - 1, k]:.4g} and {values[first + 1, k]:.4g}): an analysis "
                    "puts there what its neighbours say",
                )
