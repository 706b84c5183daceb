"""Where a model fails: the residual against every variable that could carry a missing effect.

Every view has its own noise band: the spread that block-wise sign flips of the residual's own
noise give.  A region is reported where its error stands above the band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.compare.features import features
from hil.compare.floor import Floor
from hil.compare.spectra import Line, lines
from hil.identify.result import FitResult
from hil.interval import interval

FloatArray = NDArray[np.float64]


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


def views(result: FitResult, floor: Floor) -> list[View]:
    """All views of all joints."""
    out = []
    for j, joint in enumerate(result.problem.joints):
        if result.problem.holds[j]:
            continue  # nothing is judged there
        r = result.residual[j]
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
            effort = "N" if result.problem.robot.units[j] == "m" else "N m"
            out.append(View(joint, name, unit, edges, mean, np.sqrt(power), band, count, effort))
    return out


def regions(result: FitResult, floor: Floor, most: int = 6) -> dict[str, list[Region]]:
    """Regions where the model fails, per joint, strongest first (at most `most`)."""
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
            found[joint] += [_of_line(joint, x) for x in lines(result, floor, j)]
    return {joint: _strongest(items, most) for joint, items in found.items()}


def _of_line(joint: str, x: Line) -> Region:
    return Region(
        joint, x.feature, x.low, x.high, x.unit, x.amplitude, x.amplitude, x.share, x.strength,
        x.text,
    )  # fmt: skip


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
        f"{abs(view.mean[k]):.2g} {view.effort} on average, {strength:.1f} times its noise band"
    )
    return Region(
        view.joint, view.feature, low, high, view.unit, float(view.rms[k]), float(view.mean[k]),
        float(share), strength, text,
    )  # fmt: skip
