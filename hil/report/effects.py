"""Each learnt effect drawn over the data, against the variable that suits it; curves as data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.types import Finding
from hil.identify.design import Term
from hil.identify.result import FitResult
from hil.models.contact import penetration
from hil.models.effect import Over, Waves
from hil.models.model import base_model
from hil.report.data import Material, rounded
from hil.report.elements import AFTER, BEFORE, CLOUD, MEASURED, Figure, dots, line_trace, panel_grid
from hil.report.figures import window

FloatArray = NDArray[np.float64]


# ------------------------------------------------------------ what an effect contributes


@dataclass(frozen=True)
class Learnt:
    """A fitted effect on one joint.

    Parameters
    ----------
    term : Term
        With its shape.
    joint : int
        Joint that it is drawn for.
    effort : ndarray (n,)
        What it contributes.
    partial : ndarray (n,)
        Residual of the final model plus that contribution; NaN where an instant is left out.
    """

    term: Term
    joint: int
    effort: FloatArray
    partial: FloatArray


def learnt(result: FitResult, effect: str, joint: str | None) -> Learnt | None:
    """Contribution of a fitted effect; None if the final model does not hold it."""
    problem = result.problem
    x = result.x.reshape(problem.d, problem.n, -1)
    for term, where in zip(result.terms, result.slices, strict=True):
        if term.effect.name != effect or (joint and problem.joints[term.joint] != joint):
            continue
        effort = x[:, :, where] @ result.theta[where]
        j = term.joint
        if joint is None:
            j = int(np.argmax(np.sqrt(np.mean(effort**2, axis=1)) / result.sigma))
        left_out = np.where(problem.live[j], 0.0, np.nan)
        return Learnt(term, j, effort[j], result.residual[j] + effort[j] + left_out)
    return None


BoolArray = NDArray[np.bool_]


# ------------------------------------------------------------ variables


@dataclass(frozen=True)
class Variable:
    """What an effect is drawn against.

    Parameters
    ----------
    x : ndarray (n,)
        Values.
    label : str
        Axis label with unit.
    edges : ndarray
        Bins for averages.
    split : ndarray (n,) of bool or None
        Two groups that the effect treats differently.
    groups : tuple of str
        Their names, first that of ``split`` true.
    sign : ndarray (n,) or None
        Effort is multiplied by it, e.g. the direction of motion.
    log : bool
        Logarithmic axis.
    """

    x: FloatArray
    label: str
    edges: FloatArray
    split: BoolArray | None = None
    groups: tuple[str, str] = ("forward", "backward")
    sign: FloatArray | None = None
    log: bool = False


def variable_of(result: FitResult, fit: Learnt) -> Variable:
    """The variable that suits the effect; for a user's effect the one that orders it best."""
    over = fit.term.effect.doc.over
    if over is not None:
        return CHOICE[over](result, fit)
    options = [_speed(result, fit), _position(result, fit), _load(result, fit)]
    return max(options, key=lambda v: _ordered(v, fit.effort))


def _ordered(v: Variable, effort: FloatArray) -> float:
    """Share of the effort's variance that lies between the bins of a variable."""
    where = np.digitize(v.x, v.edges)
    count = np.maximum(np.bincount(where), 1)
    mean = np.bincount(where, effort) / count
    return float(1 - np.mean((effort - mean[where]) ** 2) / max(float(np.var(effort)), 1e-300))


def _unit(result: FitResult, j: int) -> str:
    return result.problem.robot.units[j]


def dense_at_zero(x: FloatArray, count: int = 41) -> FloatArray:
    """Bins over a signed variable, narrow near zero where friction changes fastest."""
    top = max(float(np.quantile(np.abs(x), 0.998)), 1e-12)
    u = np.linspace(-1, 1, count)
    edges: FloatArray = top * np.sign(u) * u**2
    return edges


def _even(x: FloatArray, count: int) -> FloatArray:
    low, high = np.quantile(x, [0.001, 0.999])
    return np.linspace(low, max(high, low + 1e-12), count + 1)


def _speed(result: FitResult, fit: Learnt) -> Variable:
    """Own speed."""
    x, j = result.problem.qd[fit.joint], fit.joint
    return Variable(
        x, f"speed of {result.problem.joints[j]} [{_unit(result, j)}/s]", dense_at_zero(x)
    )


def _direction(result: FitResult, j: int) -> BoolArray:
    forward: BoolArray = result.problem.qd[j] > 0
    return forward


def _position(result: FitResult, fit: Learnt) -> Variable:
    """Own position; bins fine enough for the effect's period where it has one."""
    x, j = result.problem.q[fit.joint], fit.joint
    periods = fit.term.shape[0] * float(np.ptp(x)) if _periodic(fit.term) else 4.0
    edges = _even(x, int(np.clip(12 * periods, 40, 300)))
    label = f"position of {result.problem.joints[j]} [{_unit(result, j)}]"
    split = _direction(result, j) if fit.term.effect.family == "friction" else None
    return Variable(x, label, edges, split)


def _periodic(term: Term) -> bool:
    return isinstance(term.effect.search, Waves) and term.shape[0] > 0


def phase(result: FitResult, fit: Learnt) -> Variable | None:
    """Position within one period of a periodic effect; None for the others."""
    if not _periodic(fit.term):
        return None
    j, length = fit.joint, 1 / fit.term.shape[0]
    x = np.mod(result.problem.q[j], length)
    label = f"position within one period of {length:.3g} {_unit(result, j)} [{_unit(result, j)}]"
    v = _position(result, fit)
    return Variable(x, label, np.linspace(0, length, 25), v.split)


def _load(result: FitResult, fit: Learnt) -> Variable:
    """Transmitted load."""
    problem, j = result.problem, fit.joint
    x = problem.filtered([m.load for m in problem.motions])[:, j]
    split = _direction(result, j) if fit.term.effect.family == "friction" else None
    unit = "N" if _unit(result, j) == "m" else "N m"
    return Variable(x, f"load on {problem.joints[j]} [{unit}]", _even(x, 40), split)


def other_speed(result: FitResult, fit: Learnt) -> Variable:
    """Speed of the other joint, alone or combined with the own one."""
    problem, j = result.problem, fit.term.joint
    k, mode = int(fit.term.shape[0]) - 1, float(fit.term.shape[1])
    own, other = problem.joints[j], problem.joints[k]
    unit = f"[{_unit(result, k)}/s]"
    if not mode:
        return Variable(problem.qd[k], f"speed of {other} {unit}", dense_at_zero(problem.qd[k]))
    x = problem.qd[j] + mode * problem.qd[k]
    label = f"speed of {own} {_times(mode)}speed of {other} {unit}"
    return Variable(x, label, dense_at_zero(x))


def _times(r: float) -> str:
    """Sign and size of a ratio in a sum."""
    sign, size = "+" if r > 0 else "\u2212", f"{abs(r):.3g} x " if abs(r) != 1.0 else ""
    return f"{sign} {size}"


def stretch(result: FitResult, fit: Learnt) -> Variable:
    """The own position and r times the other joint's."""
    problem, j, k = result.problem, fit.term.joint, fit.term.other
    named = zip(fit.term.effect.shape, fit.term.shape, strict=True)
    r = next(float(x) for p, x in named if p.name == "r")
    label = f"position of {problem.joints[j]} {_times(r)}position of {problem.joints[k]}"
    x = problem.q[j] + r * problem.q[k]
    return Variable(x, f"{label} [{_unit(result, j)}]", _even(x, 40))


def depth(result: FitResult, fit: Learnt) -> Variable:
    """Penetration; pressing and releasing apart."""
    problem, j = result.problem, fit.joint
    if not np.isfinite(problem.motions[0].contact[j]).all():
        return _position(result, fit)
    parts = [penetration(m, j)[0][:, None] for m in problem.motions]
    x, side = problem.filtered(parts)[:, 0], float(problem.motions[0].contact[j, 1])
    edges = np.linspace(0, max(float(x.max()), 1e-12), 19)
    edges[0] = 0.01 * edges[-1]
    split = side * problem.qd[j] > 0
    return Variable(x, f"penetration [{_unit(result, j)}]", edges, split, ("pressing", "releasing"))


def reversals(result: FitResult, j: int) -> tuple[FloatArray, NDArray[np.int_]]:
    """Direction of motion and instant of the last reversal, for every instant.

    A reversal counts when the speed exceeds its resolution again; it took place where the
    speed last had the old sign.
    """
    problem = result.problem
    v, v0 = problem.qd[j], float(problem.motions[0].v0[j])
    direction, start = np.sign(v), np.zeros(v.size, dtype=int)
    begin, now = 0, 0.0
    for k in range(v.size):
        if k and problem.run[k] != problem.run[k - 1]:
            begin, now = k, 0.0
        if abs(v[k]) > v0 and np.sign(v[k]) != now:
            new = float(np.sign(v[k]))
            first = k
            while first > begin and np.sign(v[first - 1]) == new:
                first -= 1
            begin, now = first, new
            direction[first:k], start[first:k] = now, first
        direction[k], start[k] = now or direction[k], begin
    return direction, start


def displacement(result: FitResult, fit: Learnt) -> Variable:
    """Displacement since the last reversal, effort along the motion; logarithmic."""
    problem, j = result.problem, fit.joint
    q, direction, start = problem.q[j], *reversals(result, j)
    x = np.abs(q - q[start])
    low = max(float(fit.term.shape[0]), 1e-3 * float(x.max()), 1e-12)
    edges = np.geomspace(low, max(float(x.max()), 2 * low), 25)
    label = f"displacement since reversal [{_unit(result, j)}]"
    return Variable(np.where(x < low, np.nan, x), label, edges, sign=direction, log=True)


def effort_rate(result: FitResult, fit: Learnt) -> Variable:
    """Rate of change of the motor effort."""
    problem, j = result.problem, fit.joint
    x = problem.filtered([np.gradient(m.tau[:, j], m.dt)[:, None] for m in problem.motions])[:, 0]
    unit = "N/s" if _unit(result, j) == "m" else "N m/s"
    return Variable(x, f"rate of the motor effort [{unit}]", dense_at_zero(x, 31))


def elapsed(result: FitResult, fit: Learnt) -> Variable:
    """Time since the start of the run; friction along the motion."""
    problem, j = result.problem, fit.joint
    along = fit.term.effect.family == "friction"
    sign = np.sign(problem.qd[j]) if along else None
    return Variable(
        problem.t, "time since the start of the run [s]", _even(problem.t, 40), sign=sign
    )


def _turn(result: FitResult, fit: Learnt) -> Variable:
    """Time within one period of a disturbance, of the longest run."""
    problem, length = result.problem, 1.0 / max(float(fit.term.shape[0]), 1e-9)
    run = np.argmax(np.bincount(problem.run))
    x = np.where(problem.run == run, np.mod(problem.t, length), np.nan)
    label = f"time within one period of {length:.3g} s [s]"
    return Variable(x, label, np.linspace(0, length, 25))


CHOICE: dict[Over, Callable[[FitResult, Learnt], Variable]] = {
    Over.SPEED: _speed,
    Over.POSITION: _position,
    Over.DEPTH: depth,
    Over.LOAD: _load,
    Over.OTHER_SPEED: other_speed,
    Over.STRETCH: stretch,
    Over.TIME: elapsed,
    Over.PERIOD: _turn,
    Over.DISPLACEMENT: displacement,
    Over.EFFORT_RATE: effort_rate,
}
_CLOUD_POINTS, FEWEST, _SECONDS = 2500, 6, 3.0
#: How to read the figure.
READING = (
    "Dots: what the rest of the final model leaves over, i.e. its residual plus the effect's "
    "own part. Circles: their mean in bins (bars: the middle half of the dots). Line: the "
    "fitted effect, after the same filter. The line should run through the circles."
)


# ------------------------------------------------------------ figure


def effect_figure(m: Material, finding: Finding, name: str) -> Figure | None:
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
        return None
    v, second = variable_of(result, fit), phase(result, fit)
    loop = fit.term.effect.doc.over is Over.DISPLACEMENT
    right = "folded on one period" if second else "loop over position" if loop else "over time"
    seen = f" on {finding.joint}" if finding.joint else f" (seen on {m.joints[fit.joint]})"
    fig = panel_grid(1, 2, [finding.effect + seen, right], 330, sideways=0.1)
    _over(fig, v, fit, 1, True)
    if second:
        _over(fig, second, fit, 2, False)
    else:
        _over_time(fig, result, fit, loop)
    along = "effort along the motion" if v.sign is not None else "effort"
    fig.update_yaxes(title_text=f"{along} [{m.effort_unit(fit.joint)}]", col=1)
    fig.update_yaxes(title_text=f"effort [{m.effort_unit(fit.joint)}]", col=2)
    return Figure(fig, name, READING)


def _over(fig: Any, v: Variable, fit: Learnt, column: int, legend: bool) -> None:
    put = fig.add_trace
    sign = 1.0 if v.sign is None else v.sign
    y, curve = fit.partial * sign, fit.effort * sign
    inside = np.flatnonzero((v.x >= v.edges[0]) & (v.x <= v.edges[-1]) & np.isfinite(y))
    pick = np.random.default_rng(0).permutation(inside)[:_CLOUD_POINTS]
    put(dots(v.x[pick], y[pick], "data", CLOUD, opacity=0.3, showlegend=legend), row=1, col=column)
    everything = np.ones(v.x.size, dtype=bool)
    groups = [(everything, "", AFTER)]
    if v.split is not None:
        groups = [(v.split, f" {v.groups[0]}", AFTER), (~v.split, f" {v.groups[1]}", BEFORE)]
    for which, name, color in groups:
        _binned(
            put,
            v,
            which,
            y,
            curve,
            (f"mean of data{name}", f"fitted effect{name}"),
            color,
            column,
            legend,
        )
    low, high = np.quantile(y[inside], [0.002, 0.998])
    pad = 0.12 * (high - low)
    axes = {"type": "log", "exponentformat": "power", "dtick": 1} if v.log else {}
    fig.update_xaxes(title_text=v.label, **axes, row=1, col=column)
    fig.update_yaxes(range=[low - pad, high + pad], row=1, col=column)


def _binned(
    put: Any,
    v: Variable,
    which: NDArray[np.bool_],
    y: FloatArray,
    curve: FloatArray,
    names: tuple[str, str],
    color: str,
    column: int,
    legend: bool,
) -> None:
    """Mean and quartiles in bins that hold enough; the fitted curve in all that hold anything."""
    where = np.where(np.isfinite(y), np.digitize(v.x, v.edges) - 1, -1)
    rows, drawn = [], []
    for k in range(v.edges.size - 1):
        own = which & (where == k)
        # a curve ends where nothing is, and goes on behind it
        drawn.append((v.x[own].mean(), curve[own].mean()) if own.any() else (np.nan, np.nan))
        if np.sum(own) >= FEWEST:
            q1, q3 = np.quantile(y[own], [0.25, 0.75])
            rows.append((v.x[own].mean(), y[own].mean(), q1, q3))
    if not rows:
        return
    x, mean, q1, q3 = np.array(rows).T
    at, fitted = np.array(drawn).T
    wide = {
        "type": "data",
        "symmetric": False,
        "array": np.maximum(q3 - mean, 0),
        "arrayminus": np.maximum(mean - q1, 0),
        "thickness": 0.9,
        "width": 0,
        "color": MEASURED,
    }
    points = dots(x, mean, names[0], MEASURED, size=5.5, opacity=1, showlegend=legend, error_y=wide)
    if which.all() or names[0].endswith(("forward", "pressing")):
        points["marker"]["symbol"] = "circle-open"
    else:
        points["marker"]["symbol"] = "square-open"
    put(points, row=1, col=column)
    put(line_trace(at, fitted, names[1], color, width=3, showlegend=legend), row=1, col=column)


def _over_time(fig: Any, result: FitResult, fit: Learnt, loop: bool) -> None:
    """A few seconds of the partial residual and the effect: over time, or a loop over position."""
    problem, put = result.problem, fig.add_trace
    weight = fit.effort**2
    if loop:
        turns = np.diff(np.sign(problem.qd[fit.joint]), prepend=0.0) != 0
        weight = np.where(turns, 1.0, 0.0)
    part = window(weight, problem.run, int(_SECONDS * problem.rate))
    time = np.arange(part.stop - part.start) / problem.rate
    x = problem.q[fit.joint, part] if loop else time
    put(line_trace(x, fit.partial[part], "data over time", CLOUD, width=1.6), row=1, col=2)
    drawn = np.where(np.isfinite(fit.partial[part]), fit.effort[part], np.nan)
    put(
        line_trace(x, drawn, "fitted effect over time", AFTER, width=2.4, showlegend=False),
        row=1,
        col=2,
    )
    label = f"position of {problem.joints[fit.joint]} [{problem.robot.units[fit.joint]}]"
    fig.update_xaxes(title_text=label if loop else "time [s]", row=1, col=2)


# ------------------------------------------------------------ as data, for a page that draws

#: Points of a view over speed, position or effort; pairs of extremes of a curve over time.
POINTS, PAIRS = 1500, 800


def learnt_json(result: FitResult) -> list[dict[str, Any]]:
    """Every effect beside the base over its own variable: data and law in bins, and points."""
    out = []
    t, pick = result.problem.t, _picked(result.problem.n)
    plain = set(base_model(result.model.robot).names())
    for use in result.model.effects:
        if use.type in plain:
            continue
        for joint in result.problem.joints if use.joints == ("*",) else use.joints:
            fit = learnt(result, use.type, joint)
            if fit is None:
                continue
            v = variable_of(result, fit)
            sign = 1.0 if v.sign is None else v.sign
            out.append(
                {
                    "effect": use.type,
                    "joint": joint,
                    "label": v.label,
                    **_means(v.x, fit.partial * sign, fit.effort * sign, v.edges),
                    "points": {
                        "t": _short(t, pick),
                        "x": _short(v.x, pick),
                        "y": _short(fit.partial * sign, pick),
                    },
                }
            )
    return out


def _means(x: Any, data: Any, law: Any, edges: Any) -> dict[str, list[float | None]]:
    """Means over bins: of the law where any instant is, of the data where enough are; else None."""
    k = np.digitize(x, edges)
    count = np.bincount(k, minlength=edges.size + 1)[1:-1]
    some = np.flatnonzero(count)
    if not some.size:
        return {"x": [], "data": [], "law": []}
    used = slice(some[0], some[-1] + 1)
    total = {
        name: np.bincount(k, y, minlength=edges.size + 1)[1:-1]
        for name, y in (("x", x), ("data", data), ("law", law))
    }
    with np.errstate(invalid="ignore"):
        mean = {name: (y / count)[used] for name, y in total.items()}
    middle = ((edges[:-1] + edges[1:]) / 2)[used]
    mean["x"] = np.where(count[used] > 0, mean["x"], middle)
    mean["data"] = np.where(count[used] >= FEWEST, mean["data"], np.nan)
    return {name: [rounded(float(v), 4) for v in y] for name, y in mean.items()}


def _picked(n: int) -> Any:
    """Samples of n that are drawn as points."""
    return np.arange(0, n, max(1, -(-n // POINTS)))


def _short(values: Any, pick: Any) -> list[float | None]:
    return [rounded(float(v), 4) for v in values[pick]]


def series_json(result: FitResult, floor: FloatArray) -> dict[str, Any]:
    """Residual and motion of every joint on the fitted runs, thinned for drawing."""
    p = result.problem
    pick = _picked(p.n)
    return {
        "t": _short(p.t, pick),
        "run": p.run[pick].tolist(),
        "joints": [
            {
                "trace": trace_json(p.t, p.run, result.residual[j]),
                "residual": _short(result.residual[j], pick),
                "effort": _short(p.effort[j], pick),
                "position": _short(p.q[j], pick),
                "speed": _short(p.qd[j], pick),
                "floor": rounded(float(floor[j])),
            }
            for j in range(p.d)
        ],
    }


def trace_json(t: Any, run: Any, y: Any) -> dict[str, list[Any]]:
    """A curve over time by the extremes of each stretch, so that no peak is lost."""
    wide = max(1, -(-y.size // PAIRS))
    whole = np.append(y, np.full(-y.size % wide, y[-1])).reshape(-1, wide)
    begin = np.arange(whole.shape[0]) * wide
    ends = [begin + whole.argmin(axis=1), begin + whole.argmax(axis=1)]
    pick = np.unique(np.minimum(np.concatenate(ends), y.size - 1))
    return {
        "t": [rounded(float(v), 6) for v in t[pick]],
        "y": [rounded(float(v), 4) for v in y[pick]],
        "run": np.asarray(run)[pick].tolist(),
    }
