"""The learnt effect drawn over the data."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.compare.findings import Finding
from hil.compare.learnt import Learnt, learnt
from hil.compare.material import Material
from hil.compare.plots import AFTER, BEFORE, CLOUD, MEASURED, dots, embed, grid, line
from hil.compare.traces import window
from hil.compare.variables import Variable, phase, variable_of
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
CLOUD_POINTS, FEWEST, SECONDS = 2500, 6, 3.0
#: How to read the figure.
READING = (
    "Dots: what the rest of the final model leaves over, i.e. its residual plus the effect's "
    "own part. Circles: their mean in bins (bars: the middle half of the dots). Line: the "
    "fitted effect, after the same filter. The line should run through the circles."
)


def effect_figure(m: Material, finding: Finding, name: str) -> str:
    """Partial residual against the variable that suits the effect, the fitted effect on top.

    Parameters
    ----------
    m : Material
        The report's material.
    finding : Finding
        Accepted (or partial) effect.
    name : str
        Identifier of the figure.
    """
    result = m.after.result
    fit = learnt(result, finding.effect, finding.joint)
    if fit is None:
        return ""
    v, second = variable_of(result, fit), phase(result, fit)
    loop = finding.effect == "presliding"
    right = "folded on one period" if second else "loop over position" if loop else "over time"
    seen = f" on {finding.joint}" if finding.joint else f" (seen on {m.joints[fit.joint]})"
    fig = grid(1, 2, [finding.effect + seen, right], 330, sideways=0.1)
    _over(fig, v, fit, 1, True)
    if second:
        _over(fig, second, fit, 2, False)
    else:
        _over_time(fig, result, fit, loop)
    along = "effort along the motion" if v.sign is not None else "effort"
    fig.update_yaxes(title_text=f"{along} [{m.effort_unit(fit.joint)}]", col=1)
    fig.update_yaxes(title_text=f"effort [{m.effort_unit(fit.joint)}]", col=2)
    return embed(fig, name, READING)


def _over(fig: Any, v: Variable, fit: Learnt, column: int, legend: bool) -> None:
    put = fig.add_trace
    sign = 1.0 if v.sign is None else v.sign
    y, curve = fit.partial * sign, fit.effort * sign
    inside = np.flatnonzero((v.x >= v.edges[0]) & (v.x <= v.edges[-1]))
    pick = np.random.default_rng(0).permutation(inside)[:CLOUD_POINTS]
    put(dots(v.x[pick], y[pick], "data", CLOUD, opacity=0.3, showlegend=legend), row=1, col=column)
    everything = np.ones(v.x.size, dtype=bool)
    groups = [(everything, "", AFTER)]
    if v.split is not None:
        groups = [(v.split, f" {v.groups[0]}", AFTER), (~v.split, f" {v.groups[1]}", BEFORE)]
    for which, name, color in groups:
        _binned(put, v, which, y, curve, (f"mean of data{name}", f"fitted effect{name}"), color,
                column, legend)  # fmt: skip
    low, high = np.quantile(y[inside], [0.002, 0.998])
    pad = 0.12 * (high - low)
    axes = {"type": "log", "exponentformat": "power", "dtick": 1} if v.log else {}
    fig.update_xaxes(title_text=v.label, **axes, row=1, col=column)
    fig.update_yaxes(range=[low - pad, high + pad], row=1, col=column)


def _binned(
    put: Any, v: Variable, which: NDArray[np.bool_], y: FloatArray, curve: FloatArray,
    names: tuple[str, str], color: str, column: int, legend: bool,
) -> None:  # fmt: skip
    """Mean, quartiles and fitted curve in bins."""
    where = np.digitize(v.x, v.edges) - 1
    rows = []
    for k in range(v.edges.size - 1):
        own = which & (where == k)
        if np.sum(own) >= FEWEST:
            q1, q3 = np.quantile(y[own], [0.25, 0.75])
            rows.append((v.x[own].mean(), y[own].mean(), q1, q3, curve[own].mean()))
    if not rows:
        return
    x, mean, q1, q3, fitted = np.array(rows).T
    wide = {"type": "data", "symmetric": False, "array": np.maximum(q3 - mean, 0),
            "arrayminus": np.maximum(mean - q1, 0), "thickness": 0.9, "width": 0,
            "color": MEASURED}  # fmt: skip
    points = dots(x, mean, names[0], MEASURED, size=5.5, opacity=1, showlegend=legend, error_y=wide)
    if which.all() or names[0].endswith(("forward", "pressing")):
        points["marker"]["symbol"] = "circle-open"
    else:
        points["marker"]["symbol"] = "square-open"
    put(points, row=1, col=column)
    put(line(x, fitted, names[1], color, width=3, showlegend=legend), row=1, col=column)


def _over_time(fig: Any, result: FitResult, fit: Learnt, loop: bool) -> None:
    """A few seconds of the partial residual and the effect: over time, or a loop over position."""
    problem, put = result.problem, fig.add_trace
    weight = fit.effort**2
    if loop:
        turns = np.diff(np.sign(problem.qd[fit.joint]), prepend=0.0) != 0
        weight = np.where(turns, 1.0, 0.0)
    part = window(weight, problem.run, int(SECONDS * problem.rate))
    time = np.arange(part.stop - part.start) / problem.rate
    x = problem.q[fit.joint, part] if loop else time
    put(line(x, fit.partial[part], "data over time", CLOUD, width=1.6), row=1, col=2)
    put(
        line(x, fit.effort[part], "fitted effect over time", AFTER, width=2.4, showlegend=False),
        row=1,
        col=2,
    )
    label = f"position of {problem.joints[fit.joint]} [{problem.robot.units[fit.joint]}]"
    fig.update_xaxes(title_text=label if loop else "time [s]", row=1, col=2)
