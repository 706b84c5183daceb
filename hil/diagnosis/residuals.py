"""Where a model fails: the residual over every variable that could carry a missing effect.

**Spectra**: orders over position, lines and octaves over time.  An amplitude over n instants of
noise with rms s and n / c independent values has in each of its two components the standard error
s sqrt(2 c / n);  the largest of N orders stays below

    band = s sqrt(2 c / n) sqrt(2 ln(N / 0.01))

with 99 % probability (Rayleigh amplitudes).

**Views** over one variable each.  Every view has its own noise band: the spread that block-wise
sign flips of the residual's own noise give.  A region is reported where its error stands above the
band.

**Seeming**: joints that are at their noise floor, and fail in places all the same.  A floor is
what no model at hand goes below; where effects are missing that hide each other it holds them,
too.

An interval in words that rounding does not close.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.diagnosis.constants import ADEQUATE, CERTAIN, LEVEL, NEAR_FLOOR
from hil.diagnosis.floor import practical
from hil.diagnosis.types import Floor
from hil.identify.problem import Problem
from hil.identify.result import FitResult


def interval(low: float, high: float, digits: int = 2) -> str:
    """E.g. ``2.35 to 2.41``: significant digits enough that a tenth of the width still shows.

    Parameters
    ----------
    low, high : float
        Ends, in the same unit.
    digits : int
        Significant digits at least.
    """
    largest, width = max(abs(low), abs(high)), abs(high - low)
    if 0.0 < width < largest and math.isfinite(largest):
        digits = max(digits, min(math.ceil(math.log10(largest / width)) + 2, 15))
    return f"{low:.{digits}g} to {high:.{digits}g}"


FloatArray = NDArray[np.float64]
#: Name, unit, values (n,) and edges of bins.
Feature = tuple[str, str, FloatArray, FloatArray]


# ------------------------------------------------------------ variables


def since_reversal(v: FloatArray, v0: float, t: FloatArray, run: NDArray[np.int_]) -> FloatArray:
    """How far `t` has come since the last change of direction, shape (n,).

    Speeds below v0 keep the old direction; `t` is time [s] or a path length [rad or m].
    """
    way = np.where(np.abs(v) > v0, np.sign(v), 0.0)
    fresh = np.concatenate([[True], np.diff(run) != 0])
    moving = np.flatnonzero((way != 0) | fresh)
    # the direction that holds at each instant: that of the last one above v0
    held = way[moving][np.searchsorted(moving, np.arange(v.size), side="right") - 1]
    turned = fresh | np.concatenate([[False], np.diff(held) != 0])
    last = np.maximum.accumulate(np.where(turned, np.arange(v.size), 0))
    out: FloatArray = t - t[last]
    return out


def motion_path(q: FloatArray, run: NDArray[np.int_]) -> FloatArray:
    """Length of the way gone so far [rad or m], shape (n,); runs follow one another."""
    step = np.concatenate([[0.0], np.abs(np.diff(q))])
    step[np.concatenate([[False], np.diff(run) != 0])] = 0.0
    out: FloatArray = np.cumsum(step)
    return out


def features(result: FitResult, j: int) -> list[Feature]:
    """Views of joint j."""
    problem = result.problem
    unit = problem.robot.units[j]
    v, q = problem.qd[j], problem.q[j]
    v0 = float(problem.motions[0].v0[j])
    fast = max(float(np.quantile(np.abs(v), 0.99)), 2 * v0)
    speeds = np.geomspace(max(v0, 0.01 * fast), fast, 7)
    out = [
        ("speed", f"{unit}/s", v, np.concatenate([-speeds[::-1], [0.0], speeds])),
        (
            "since-reversal",
            "s",
            since_reversal(v, v0, problem.t, problem.run),
            np.array([0, 0.03, 0.06, 0.1, 0.2, 0.4, 0.8, 1e3]),
        ),
        (
            "distance-since-reversal",
            unit,
            since_reversal(v, v0, motion_path(q, problem.run), problem.run),
            float(np.ptp(q)) * np.array([0, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 10.0]),
        ),
        ("position", unit, q, np.linspace(q.min(), q.max() + 1e-12, 13)),
        ("time", "s", problem.t, np.linspace(0, problem.t.max() + 1e-9, 7)),
    ]
    load = problem.filtered([m.load for m in problem.motions])[:, j]
    if np.ptp(load) > 0:
        out.append(
            ("load", "N" if unit == "m" else "N m", load, np.quantile(load, np.linspace(0, 1, 7)))
        )
    return out + [_of_other(problem, k) for k in range(problem.d) if k != j]


def _of_other(problem: Problem, k: int) -> Feature:
    """Another joint's speed."""
    top = max(float(np.quantile(np.abs(problem.qd[k]), 0.95)), 1e-9)
    edges = top * np.array([-1.5, -0.5, -0.1, 0, 0.1, 0.5, 1.5])
    return f"speed of {problem.joints[k]}", f"{problem.robot.units[k]}/s", problem.qd[k], edges


#: Highest order, in periods over the span; what is faster meets fewer than five instants.
HIGHEST_ORDER = 80.0


# ------------------------------------------------------------ spectra


@dataclass(frozen=True)
class Spectrum:
    """One spectrum of one joint's residual.

    Parameters
    ----------
    feature : str
        ``order``, ``friction-order``, ``line`` or ``frequency``.
    unit : str
        Unit of `x`.
    x, amplitude, band : ndarray (m,)
        Order or frequency, amplitude of the residual there [N m or N], and its noise band.
    """

    feature: str
    unit: str
    x: FloatArray
    amplitude: FloatArray
    band: FloatArray


@dataclass(frozen=True)
class Line:
    """One place of a spectrum above its band."""

    feature: str
    low: float
    high: float
    unit: str
    amplitude: float
    strength: float
    share: float
    text: str


def order_spectra(result: FitResult, floor: Floor, j: int) -> list[Spectrum]:
    """Amplitude over the order of position, of the residual and of its friction-like part."""
    problem, live = result.problem, result.problem.live[j]
    q, v, r = problem.q[j, live], problem.qd[j, live], result.residual[j, live]
    span = float(np.ptp(q))
    if span <= 0 or q.size < 50:
        return []
    # an instant moves by |v| / rate: orders faster than five instants a period are not seen
    top = min(
        HIGHEST_ORDER, span * problem.rate / (5 * max(float(np.quantile(np.abs(v), 0.5)), 1e-12))
    )
    orders = np.arange(1.5, max(top, 2.0), 0.25) / span
    noise = floor.scale[j] * np.sqrt(2 * floor.inflation[j] / q.size)
    band = np.full(orders.size, noise * np.sqrt(2 * np.log(orders.size / LEVEL)))
    wave = np.exp(-2j * np.pi * orders[:, None] * q)
    unit = f"1/{problem.robot.units[j]}"
    return [
        Spectrum(name, unit, orders, 2 * np.abs(wave @ (part - part.mean())) / q.size, band)
        for name, part in (("order", r), ("friction-order", r * np.sign(v)))
    ]


def time_spectra(result: FitResult, floor: Floor, j: int) -> list[Spectrum]:
    """Lines over the time's frequency, and rms by octave beside the noise's."""
    problem = result.problem
    run = np.argmax(np.bincount(problem.run))
    r = result.residual[j, problem.run == run]
    noise = floor.residual[j, problem.run == run]
    if r.size < 64:
        return []
    window: FloatArray = np.hanning(r.size)
    f = np.asarray(np.fft.rfftfreq(r.size, 1 / problem.rate), dtype=np.float64)
    size: FloatArray = 2 * np.abs(np.fft.rfft(r * window)) / window.sum()
    near = 2 * (max(r.size // 60, 5) // 2) + 1
    # a line stands out of its own neighbourhood: 1.18 turns a Rayleigh median into sigma
    local = scipy.signal.medfilt(size, near) / 1.18
    band = np.asarray(local * np.sqrt(2 * np.log(f.size / LEVEL)), dtype=np.float64)
    seen = (f > 0) & (f <= problem.rates.effort)
    line = Spectrum("line", "Hz", f[seen], size[seen], band[seen])
    edges: FloatArray = problem.rates.effort * np.exp2(np.arange(-6.0, 1.0))
    power = np.abs(np.fft.rfft(r)) ** 2, np.abs(np.fft.rfft(noise)) ** 2
    parts = [(f > a) & (f <= b) for a, b in zip([0.0, *edges[:-1]], edges, strict=True)]
    total = [np.array([np.sqrt(2 * p[part].sum()) / r.size for part in parts]) for p in power]
    scale = float(floor.scale[j]) / max(float(np.sqrt(np.mean(noise**2))), 1e-300)
    count = np.array([max(int(part.sum()), 1) for part in parts])
    octave = Spectrum("frequency", "Hz", edges, total[0], scale * total[1] * (1 + 3 / count**0.5))
    return [line, octave]


def spectral_lines(result: FitResult, floor: Floor, j: int) -> list[Line]:
    """The strongest place above its band in each spectrum of joint j, as a sentence."""
    joint, units = result.problem.joints[j], result.problem.robot.units
    effort, rms = "N" if units[j] == "m" else "N m", result.problem.rms(result.problem.effort)
    excess = max(float(result.rms[j] ** 2 - floor.rms[j] ** 2), 1e-300)
    out = []
    for s in [*order_spectra(result, floor, j), *time_spectra(result, floor, j)]:
        strength = s.amplitude / np.maximum(s.band, 1e-300)
        k = int(np.argmax(strength))
        if strength[k] <= 1:
            continue
        low = float(s.x[k - 1] if s.feature == "frequency" and k else s.x[k])
        power = float(s.amplitude[k] ** 2) / (1 if s.feature == "frequency" else 2)
        share = _of_effort(float(s.amplitude[k]), float(rms[j]))
        size = f"{s.amplitude[k]:.2g} {effort}{share}, {strength[k]:.1f} times its noise band"
        out.append(
            Line(
                s.feature,
                low,
                float(s.x[k]),
                s.unit,
                float(s.amplitude[k]),
                float(strength[k]),
                min(power / excess, 1.0),
                f"{joint}: {_what(s, k, low, result, j)} {size}",
            )
        )
    return out


def _what(s: Spectrum, k: int, low: float, result: FitResult, j: int) -> str:
    x = float(s.x[k])
    if s.feature == "frequency":
        return f"at {interval(low, x) if low < x else f'{x:.3g}'} Hz the error is"
    if s.feature == "line":
        where = "which the motion has too," if _in_motion(result, j, x) else "not in the motion,"
        return f"the residual has a line at {x:.3g} Hz, {where} of"
    kind = "the residual" if s.feature == "order" else "the friction"
    return f"over position {kind} ripples with a period of {1 / x:.3g} {s.unit[2:]}, amplitude"


def _in_motion(result: FitResult, j: int, f: float) -> bool:
    """Whether the speed's spectrum has a line within one bin of f [Hz]."""
    problem = result.problem
    run = np.argmax(np.bincount(problem.run))
    v = problem.qd[j, problem.run == run]
    size = np.abs(np.fft.rfft((v - v.mean()) * np.hanning(v.size)))
    k = round(f * v.size / problem.rate)
    near = size[max(k - 2, 0) : k + 3].max(initial=0.0)
    wide = np.median(size[max(k - 40, 0) : k + 41])
    return bool(near > 6 * wide)


# ------------------------------------------------------------ regions


@dataclass(frozen=True)
class Region:
    """One region of one view.

    Parameters
    ----------
    joint : str
        Joint.
    feature : str
        ``speed``, ``since-reversal``, ``distance-since-reversal``, ``position``, ``order``,
        ``friction-order``, ``load``, ``speed of <joint>``, ``time``, ``frequency``, ``line``.
    low, high : float
        Range of the feature in its unit.
    unit : str
        Unit of the range.
    rms : float
        Rms residual in the region [N m or N].
    mean : float
        Mean residual there, the systematic part.
    share : float
        Share of the joint's squared error above the floor that lies here.
    strength : float
        How far the mean stands above its noise band (1 = at the edge).
    text : str
        One sentence.
    """

    joint: str
    feature: str
    low: float
    high: float
    unit: str
    rms: float
    mean: float
    share: float
    strength: float
    text: str


@dataclass(frozen=True)
class View:
    """A whole view, for plots: bins with mean, rms and noise band."""

    joint: str
    feature: str
    unit: str
    edges: FloatArray
    mean: FloatArray
    rms: FloatArray
    band: FloatArray
    count: NDArray[np.int_]
    effort: str = ""
    #: Rms effort of the joint.
    size: float = 0.0


def views(result: FitResult, floor: Floor) -> list[View]:
    """All views of all joints."""
    out, sizes = [], result.problem.rms(result.problem.effort)
    for j, joint in enumerate(result.problem.joints):
        if result.problem.holds[j]:
            continue  # nothing is judged there
        r, size = result.residual[j], float(sizes[j])
        for name, unit, values, edges in features(result, j):
            edges = np.unique(edges)
            if edges.size < 3:
                continue
            where = np.clip(np.digitize(values, edges) - 1, 0, edges.size - 2)
            inside = (values >= edges[0]) & (values <= edges[-1]) & result.problem.live[j]
            count = np.bincount(where[inside], minlength=edges.size - 1)
            n = np.maximum(count, 1)
            mean = np.bincount(where[inside], r[inside], minlength=edges.size - 1) / n
            power = np.bincount(where[inside], r[inside] ** 2, minlength=edges.size - 1) / n
            # three standard errors of a mean of n / inflation independent values
            band = 3 * floor.scale[j] * np.sqrt(floor.inflation[j] / n)
            effort, rms = "N" if result.problem.robot.units[j] == "m" else "N m", np.sqrt(power)
            out.append(View(joint, name, unit, edges, mean, rms, band, count, effort, size))
    return out


def _of_effort(value: float, size: float) -> str:
    """A value in percent of the joint's rms effort; empty where that is none."""
    return f" ({100 * value / size:.2g} % of the rms effort)" if size > 0 else ""


def regions(result: FitResult, floor: Floor, most: int = 6) -> dict[str, list[Region]]:
    """Regions where the model fails, per joint, strongest first (at most `most`)."""
    return {joint: _strongest(items, most) for joint, items in _found(result, floor).items()}


def that_matter(result: FitResult, floor: Floor, most: int = 6) -> dict[str, list[Region]]:
    """The same without what is below the practical size, unless all of it together is not.

    Nor what is above its noise band by no more than bands and floors are known to.
    """
    problem, found = result.problem, _found(result, floor)
    least = practical(problem) * problem.rms(problem.effort)
    excess = result.rms**2 - floor.rms**2
    met = (excess <= least**2) | (result.rms <= ADEQUATE * floor.rms)
    for j, joint in enumerate(problem.joints):
        clear = [r for r in found[joint] if r.strength > NEAR_FLOOR]
        large = [r for r in clear if abs(r.mean) > least[j]]
        if large or met[j]:
            found[joint] = large
    return {joint: _strongest(items, most) for joint, items in found.items()}


def _found(result: FitResult, floor: Floor) -> dict[str, list[Region]]:
    """Everything above its band, per joint."""
    found: dict[str, list[Region]] = {joint: [] for joint in result.problem.joints}
    for view in views(result, floor):
        j = result.problem.joints.index(view.joint)
        excess = max(
            result.problem.count[j] * float(result.rms[j] ** 2 - floor.rms[j] ** 2), 1e-300
        )
        for k in range(view.mean.size):
            if view.count[k] < 10:
                continue
            strength = float(abs(view.mean[k]) / max(view.band[k], 1e-300))
            above = view.count[k] * max(view.rms[k] ** 2 - float(floor.rms[j]) ** 2, 0.0)
            if strength > 1:
                found[view.joint].append(_region(view, k, strength, min(above / excess, 1.0)))
    for j, joint in enumerate(result.problem.joints):
        if not result.problem.holds[j]:
            found[joint] += [_of_line(joint, x) for x in spectral_lines(result, floor, j)]
    return found


def nowhere(problem: Problem) -> str:
    """What is said where there is no region."""
    return (
        f"nowhere above the noise band by more than {100 * practical(problem):g} % of the rms "
        f"effort and {100 * (NEAR_FLOOR - 1):.0f} % of the band; smaller errors are ignored"
    )


def _of_line(joint: str, x: Line) -> Region:
    return Region(
        joint,
        x.feature,
        x.low,
        x.high,
        x.unit,
        x.amplitude,
        x.amplitude,
        x.share,
        x.strength,
        x.text,
    )


def _strongest(items: list[Region], most: int) -> list[Region]:
    """Best region of each view first, so that one view does not fill the list."""
    items = sorted(items, key=lambda x: -x.strength)
    heads: list[Region] = []
    tail: list[Region] = []
    seen: set[str] = set()
    for item in items:
        (tail if item.feature in seen else heads).append(item)
        seen.add(item.feature)
    return (heads + tail)[:most]


def _since(low: float, high: float, unit: str, bounded: bool) -> str:
    """How long or how far after a reversal."""
    if bounded:
        return f"{interval(low, high)} {unit} after a reversal"
    where = f"more than {low:.2g}" if low > 0 else f"up to {high:.2g}"
    return f"{where} {unit} after a reversal"


def _region(view: View, k: int, strength: float, share: float) -> Region:
    low, high = float(view.edges[k]), float(view.edges[k + 1])
    between = interval(low, high)
    what = {
        "speed": f"at speeds from {between} {view.unit}",
        "since-reversal": _since(low, high, "s", high < 100),
        "distance-since-reversal": _since(low, high, view.unit, high < 5 * low),
        "position": f"at positions from {between} {view.unit}",
        "load": f"at transmitted loads from {between} {view.unit}",
        "time": f"from {between} s into the run",
    }.get(view.feature, f"when the {view.feature} is {between} {view.unit}")
    side = "too little" if view.mean[k] > 0 else "too much"
    text = (
        f"{view.joint}: {what} the model predicts {side} effort by "
        f"{abs(view.mean[k]):.2g} {view.effort} on average"
        f"{_of_effort(abs(view.mean[k]), view.size)}, {strength:.1f} times its noise band"
    )
    return Region(
        view.joint,
        view.feature,
        low,
        high,
        view.unit,
        float(view.rms[k]),
        float(view.mean[k]),
        float(share),
        strength,
        text,
    )


SEEMING = "seeming"


# ------------------------------------------------------------ at the floor, and wrong in places


def seeming(
    ratio: Mapping[str, float], where: Mapping[str, Sequence[Region]]
) -> list[tuple[str, str]]:
    """Warnings (code, sentence) on joints that only seem to be right.

    Parameters
    ----------
    ratio : mapping of str to float
        Error over the noise floor, by joint.
    where : mapping of str to sequence of Region
        Where the model fails, by joint.
    """
    most = {j: max((r.strength for r in where.get(j, ())), default=0.0) for j in ratio}
    return [
        (
            SEEMING,
            f"{joint}: the error is near the noise floor, but {most[joint]:.1f} times its noise "
            "band in "
            "places: the floor itself holds something systematic. 'hil diagnose' estimates it "
            "again after each effect that it adds",
        )
        for joint, x in ratio.items()
        if x <= NEAR_FLOOR and most[joint] > CERTAIN
    ]
