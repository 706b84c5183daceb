"""Jumps of a measured position that the joint cannot have made: counts that the decoder lost.

Wraps are no faults: a position that is told within one turn, or in a counter of so many bits,
starts again at the other end of it while the joint turns on.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter

FloatArray = NDArray[np.float64]
#: Samples before and after a step from which its size is foretold.
BESIDE = 8
#: Standard errors by which a step must stand out: of a million normal ones none does by 7; a
#: rounded one never does by more than two counts, or five standard errors of its own.
OUTLYING = 7.0
#: ... and times what any step near it does: a blow shakes the readings for many samples.
ALONE_FACTOR = 2.5
#: Samples around a step that tell how much readings stray there.
NEIGHBOURHOOD = 40
#: Share of the fastest steps that is no jump in any case: samples are not quite evenly spaced.
UNEVEN_SHARE = 0.05
#: Jumps that are listed one by one.
LISTED = 12
#: A position that comes in counts has fewer sizes of steps than so.
MAX_KINDS = 200
#: Rounds of the search, each without the jumps found before.
SEARCH_ROUNDS = 5
#: Samples beside a jump that do not tell how much readings stray there.
BACK_STEPS = 3
#: Share of a jump by which it stands out of the two steps beside it, and share that one of them
#: takes back where a reading came late.
ALL, LATE = 0.5, 0.35
#: More jumps a sample than so are how a position moves, not faults; and not worth a close look.
MOST, MANY = 2e-3, 0.05


@dataclass(frozen=True)
class Jumps:
    """Steps by which one position is shifted for good.

    Parameters
    ----------
    at : ndarray (k,) of int
        Samples after the jump: it lies between `at` - 1 and `at`.
    size : ndarray (k,)
        By how much the measured position jumps [rad or m].
    count : float
        Resolution of the encoder [rad or m]; 0 where the position is not in counts.
    """

    at: NDArray[np.intp]
    size: FloatArray
    count: float

    def shift(self, n: int) -> FloatArray:
        """Error (n,) that the jumps leave in the position [rad or m]."""
        out = np.zeros(n)
        np.add.at(out, self.at, self.size)
        return np.asarray(np.cumsum(out))


def described(t: FloatArray, found: Jumps) -> str:
    """Instants and sizes of jumps, in counts where there are any, as the rest of a sentence."""
    often = "once" if found.at.size == 1 else f"{found.at.size} times"
    sizes = [f"{x / (found.count or 1.0):+.4g}" for x in found.size]
    when = [f"{x} at {s:.6g} s" for x, s in zip(sizes, t[found.at], strict=True)]
    rest = f" and {len(when) - LISTED} more" if len(when) > LISTED else ""
    unit = f" (counts of {found.count:.4g})" if found.count else ""
    return (
        f"jumps {often} within a sample, with the same speed before and after: "
        f"{', '.join(when[:LISTED])}{rest}{unit}; lost counts, or lost samples: "
        "'missed-counts' decides by the effort"
    )


#: Part of a count by which multiples of it may be off in a table, and steps that show one.
OFF, FEW_STEPS = 0.1, 100
#: Share of steps that may be no multiples: of rows that were filled in, or of a count that a table
#: writes in two ways.
STRAY = 0.02


def resolution(x: FloatArray, exact: bool = False) -> float:
    """Smallest step of a position (n,) that comes in counts; 0 where it does not.

    `exact` asks that multiples of a count agree to the last digit, as a decoder gives them; a table
    with rounded numbers has counts where all its steps are near whole multiples of one.
    """
    steps = np.abs(np.diff(x[:20000]))
    steps = steps[steps > 1e-12]
    # what has too many kinds of steps mostly shows it in the first thousand
    for some in (steps[:1000], steps):
        kinds = np.unique(some if exact else np.round(some, 12)).size
        if not 0 < kinds < MAX_KINDS:
            return _multiples(steps) if exact else 0.0
    return _of_counts(steps)


def _of_counts(steps: FloatArray) -> float:
    """The largest step of which nearly all are multiples.

    The last digit of a table makes stray ones, and rows that were filled in make parts of a count.
    """
    # a count times a whole number has many last digits in binary: one kind of each
    _, first, often = np.unique(np.round(steps, 12), return_index=True, return_counts=True)
    kinds = steps[first]
    for one in kinds[::-1].tolist():
        whole = np.maximum(np.round(kinds / one), 1.0)
        if often[np.abs(kinds - whole * one) > OFF * one].sum() <= STRAY * steps.size:
            return float(one)
    return float(kinds[0])


def _multiples(steps: FloatArray) -> float:
    """The step of which all others are multiples but for `OFF` of it; 0 where there is none."""
    if steps.size < FEW_STEPS:
        return 0.0
    order = np.sort(steps)
    stray = int(STRAY * order.size)
    return _multiples_of(order, order[0], 0) or _multiples_of(order, order[stray], stray)


def _multiples_of(order: FloatArray, one: float, stray: int) -> float:
    """The step near one of which all of these (n,), the least first, are multiples but for some."""
    for part in (0.5, 1.0):  # the small ones say it well enough for the large ones
        some = order[: max(int(part * order.size), FEW_STEPS)]
        whole = np.maximum(np.round(some / one), 1.0)
        good = np.abs(some - whole * one) <= OFF * one
        if np.sum(~good) > stray:
            return 0.0
        one = float(some[good] @ whole[good]) / float(whole[good] @ whole[good])
    return one


def jumps(t: FloatArray, q: FloatArray) -> Jumps:
    """Steps of a position that neither the speed before them nor the one after them explains.

    A step of one sample is compared with two forecasts, straight lines through the steps before
    and through those after it; what lies outside both is a jump.  A blow changes the speed, so
    that one of the two forecasts holds; only lost counts move the position and leave the speed.

    Parameters
    ----------
    t : ndarray (n,)
        Time [s]; where samples are missing nothing is compared.
    q : ndarray (n,)
        Position as recorded [rad or m].

    Returns
    -------
    Jumps
        Empty where there are so many that they are the motion's.
    """
    count, dq = resolution(q), np.diff(q)
    none = Jumps(np.zeros(0, dtype=np.intp), np.zeros(0), count)
    if dq.size < 8 * BESIDE or not np.any(dq):
        return none
    step = np.zeros(dq.size)
    least = max(UNEVEN_SHARE * float(np.quantile(np.abs(dq), 0.99)), OUTLYING * count / np.sqrt(6))
    for _ in range(SEARCH_ROUNDS):
        found = _standing_out(dq - step, least)
        if np.any(found):
            found &= _whole(t)
        if not np.any(found):
            break
        # again from the neighbours without their own jumps
        step[found] = 0.0
        step[found] = (dq - np.mean(_forecasts(dq - step), axis=0))[found]
    at = np.flatnonzero(step)
    size = np.round(step[at] / count) * count if count else step[at]
    kept = _lasting(dq, at, size) & (size != 0.0) & ~_caught_up(dq, at, size)
    if not 0 < np.sum(kept) <= max(3.0, MOST * dq.size):
        return none
    return Jumps(at[kept] + 1, size[kept], count)


def _whole(t: FloatArray) -> NDArray[np.bool_]:
    """Steps (n - 1,) of a time (n,) across which no sample is missing."""
    dt = np.diff(t)
    return np.asarray(np.abs(dt / np.median(dt) - 1) < 0.5)


def _standing_out(dq: FloatArray, least: float) -> NDArray[np.bool_]:
    """Steps (n,) outside both forecasts by more than `least` and chance; the largest near it."""
    before, after = _forecasts(dq)
    size = np.abs(dq - np.clip(dq, np.minimum(before, after), np.maximum(before, after)))
    stray = np.abs(dq - (before + after) / 2)
    # 1.4826 median |x| is the standard deviation of a normal x
    limit = max(OUTLYING * 1.4826 * float(np.median(stray[::7])), least)
    at = np.flatnonzero((size > limit) & (size == maximum_filter1d(size, 2 * BESIDE + 1)))
    at = at[(at >= NEIGHBOURHOOD) & (at < dq.size - NEIGHBOURHOOD)]
    out = np.zeros(dq.size, dtype=np.bool_)
    if not 0 < at.size <= MANY * dq.size:
        return out
    near = at[:, None] + np.concatenate(
        [np.arange(-NEIGHBOURHOOD, -BACK_STEPS), np.arange(BACK_STEPS + 1, NEIGHBOURHOOD + 1)]
    )
    usual = 1.4826 * np.median(stray[near], axis=1)
    out[at] = size[at] > np.maximum(OUTLYING * usual, ALONE_FACTOR * np.max(size[near], axis=1))
    return out


def _forecasts(dq: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Each step (n,) as straight lines through `BESIDE` steps before and after it foretell it."""
    m = BESIDE
    k = np.arange(1.0, m + 1)
    # value at 0 of the least-squares line through points at 1..m
    line = np.concatenate([[0.0], (4 * m + 2 - 6 * k) / (m * (m - 1))])
    wide = np.pad(dq, m, mode="edge")
    before = np.convolve(wide, line)[m : m + dq.size]
    after = np.convolve(wide[::-1], line)[m : m + dq.size][::-1]
    return before, after


def _lasting(dq: FloatArray, at: NDArray[np.intp], size: FloatArray) -> NDArray[np.bool_]:
    """Which jumps (k,) stand alone, and are not taken back beside them as a late reading's is."""
    out = np.zeros(at.size, dtype=np.bool_)
    for k, here in enumerate(at):
        first, last = dq[here - 1], dq[here + 1]
        bend = dq[here] - (first + last) / 2
        back = (
            first - np.median(dq[here - 5 : here - 1]),
            last - np.median(dq[here + 2 : here + 6]),
        )
        out[k] = bend / size[k] > ALL and min(x / size[k] for x in back) > -LATE
    return out


def _caught_up(dq: FloatArray, at: NDArray[np.intp], size: FloatArray) -> NDArray[np.bool_]:
    """Which jumps (k,) make good for samples that stood still just before."""
    after = _forecasts(dq)[1]
    out = np.zeros(at.size, dtype=np.bool_)
    for k, here in enumerate(at):
        moved = np.flatnonzero(dq[:here])
        frozen = here - 1 - (moved[-1] if moved.size else -1)
        out[k] = frozen > 1 and frozen * after[here] / size[k] > 0.5
    return out


# ------------------------------------------------------------ wraps

#: Share of a period by which a step may differ from it, beyond what the speed beside it says.
NEAR = 0.02
#: Steps around a wrap whose median is the speed there.
AROUND = 9
#: Bits of a counter of a drive or a single-turn encoder.
BITS = range(8, 33)


@dataclass(frozen=True)
class Wraps:
    """A position that starts again at the other end of a period.

    Parameters
    ----------
    period : float
        The period, in the unit of the position.
    name : str
        What a person calls it, e.g. ``"2 pi"``.
    count : int
        How often it wraps.
    values : ndarray (n,)
        The position as it would be without.
    """

    period: float
    name: str
    count: int
    values: FloatArray

    def text(self, column: str, done: bool = True) -> str:
        """E.g. ``q1 wraps at 2 pi, 53 times: unwrapped``."""
        often = "once" if self.count == 1 else f"{self.count} times"
        return f"{column} wraps at {self.name}, {often}: {'unwrapped' if done else 'left so'}"


#: A turn of a joint that turns [rad], and its name.
TURN = (2 * math.pi, "2 pi")


def periods(x: FloatArray, scale: float = 1.0) -> Iterator[tuple[float, str]]:
    """Periods at which a column (n,) may wrap, and their names; `scale` is that to radians."""
    yield TURN
    yield 360.0, "360 deg"
    yield 1.0, "1 turn"
    span = float(np.ptp(x))
    if whole_numbers(x):
        yield from ((2.0**n, f"{2**n} counts") for n in BITS if span > 2.0 ** (n - 1))
    if scale:
        yield 2 * math.pi / abs(scale), f"{2 * math.pi / abs(scale):.6g} (a turn)"


def whole_numbers(x: FloatArray) -> bool:
    """Whether a column (n,) holds whole numbers, more than a few of them."""
    return bool(np.all(x == np.round(x))) and np.unique(x[:2000]).size > FEW_LEVELS


#: Fewer levels than so are a switch or a flag, no count.
FEW_LEVELS = 5


def wraps(t: FloatArray, x: FloatArray, known: Iterable[tuple[float, str]]) -> Wraps | None:
    """The period at which a position wraps; None where it does not.

    All values lie within one period, and a step of nearly a period is a wrap where, without it, the
    speed is what it is before and after.  A jump of another size, or out of the period, is left to
    `jumps`.

    Parameters
    ----------
    t : ndarray (n,)
        Time, in any unit; what does not increase counts as even.
    x : ndarray (n,)
        Position in any unit, finite.
    known : iterable of (float, str)
        Periods and their names; the first that fits is taken.
    """
    dx = np.diff(x)
    if dx.size < AROUND:
        return None
    span, most = float(np.ptp(x)), float(np.abs(dx).max())
    if not most > span / 2:  # within a period, a wrap goes through more than half of all values
        return None
    dt = np.diff(t)
    dt = dt / (float(np.median(dt)) or 1.0)
    dt = np.where((dt > 0) & np.isfinite(dt), dt, 1.0)
    for period, name in known:
        if not period / 2 < most <= span <= period * (1 + NEAR / 20):
            continue
        rate = (dx - period * np.round(dx / period)) / dt
        usual = median_filter(rate, AROUND, mode="nearest")
        turns = np.round((usual * dt - dx) / period)
        rest = np.abs(dx + turns * period - usual * dt)
        calm = np.where(turns == 0.0, rest, 0.0)
        limit = NEAR * period + 2.0 * maximum_filter1d(calm, AROUND)
        found = (turns != 0.0) & (rest <= np.minimum(limit, period / 4))
        count, far = int(found.sum()), int(np.sum(np.abs(dx) > period / 2))
        if count and 2 * count >= far:
            shift = np.concatenate([[0.0], np.cumsum(np.where(found, turns, 0.0))])
            return Wraps(period, name, count, x + period * shift)
    return None
