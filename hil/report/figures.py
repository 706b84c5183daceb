"""Figures of a report: error ladder, where the model fails, spectra, candidates, traces."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.residuals import Spectrum, View, order_spectra, time_spectra, views
from hil.diagnosis.types import Candidate
from hil.identify.fit import QUANTITIES, range_limits
from hil.report.data import Material, readable_number
from hil.report.elements import (
    AFTER,
    BAND_COLOUR,
    BEFORE,
    FLOOR,
    MEASURED,
    TOP,
    Figure,
    bar,
    escape,
    html_table,
    line_trace,
    panel_grid,
    rung_colors,
    scatter,
)

FloatArray = NDArray[np.float64]
#: Colour of what lies outside the range that a model was identified on.
_OUTSIDE = "#E69F00"
#: Views drawn per joint, and bins with fewer instants than this are left out.
_VIEWS, _FEWEST = 9, 10
ONE_STEP = (
    "How to read: one group of bars a joint, one bar a model. The dashed line at 1 is the measured "
    "noise floor: the error that all effects of the catalogue together leave, corrected for "
    "chance. "
    "A bar at the line leaves nothing for them to explain. An effect of your own may go below it."
)
MULTI_STEP = (
    " Right: the model is started from measured states, driven with the measured effort and "
    "compared with where the robot went; lower is better."
)
#: What axes are called where a feature's own name would not say it.
_AXES = {
    "since-reversal": "time since reversal",
    "distance-since-reversal": "distance since reversal",
    "load": "transmitted load",
}
#: Views over unevenly spaced bins, drawn with bins of equal width.
UNEVEN_AXES = ("speed", "since-reversal", "distance-since-reversal", "load")


# ------------------------------------------------------------ ladder and views


def ladder_figure(m: Material) -> Figure:
    """Held-out error over the noise floor, and the simulated position error beside it."""
    multi = np.array([r.multi_step.relative for r in m.rungs])
    both = not m.external and bool(np.isfinite(multi).any())
    titles = ["error of the predicted effort"]
    titles += [f"simulated: position error in {m.rungs[0].multi_step.horizon:g} s simulations"]
    fig = panel_grid(1, 2 if both else 1, titles[: 1 + both], 300, sideways=0.1)
    values = np.array([m.ratio(r.step) for r in m.rungs])
    labels = [r.step.label for r in m.rungs]
    _bars(fig, m.joints, values, labels, 1)
    _floor_line(fig, m)
    # a long legend needs more room above
    more = 22 * max(0, len(labels) - 3)
    fig.update_layout(margin_t=TOP + more, height=fig.layout["height"] + more)
    top = 1.18 * max(float(values.max()), 1.2)
    fig.update_yaxes(title_text="held-out rms error / noise floor", range=[0, top], col=1)
    if both:
        _bars(fig, m.joints, multi, labels, 2)
        top = 1.18 * float(np.max(multi[np.isfinite(multi)]))
        fig.update_yaxes(title_text="rms error / rms displacement [%]", range=[0, top], col=2)
    if len("".join(m.joints)) > 40:
        fig.update_xaxes(tickangle=-35, automargin=True)
        fig.update_layout(height=fig.layout["height"] + 60)
    return Figure(fig, "ladder", ONE_STEP + (MULTI_STEP if both else ""))


def _floor_line(fig: Any, m: Material) -> None:
    """Dashed line at 1, named in the legend with its origin."""
    look = {"color": FLOOR, "width": 2, "dash": "dash"}
    fig.add_hline(y=1, line=look, row=1, col=1)
    origin = {"repeats": "repeated motion", "largest-model": "largest model on left-out data"}
    method = m.last.floor.method
    name = f"noise floor (from {escape(origin.get(method, method))})"
    fig.add_trace(scatter(x=[None], y=[None], mode="lines", line=look, name=name), row=1, col=1)


def _bars(
    fig: Any, joints: tuple[str, ...], values: FloatArray, labels: list[str], column: int
) -> None:
    few = values.size <= 10
    for k, (label, color) in enumerate(zip(labels, rung_colors(len(labels)), strict=True)):
        y = [float(v) if np.isfinite(v) else None for v in values[k]]
        text = [f"{v:.3g}" if few and v is not None else "" for v in y]
        fig.add_trace(
            bar(
                x=[escape(j) for j in joints],
                y=y,
                name=escape(label),
                legendgroup=escape(label),
                marker_color=color,
                text=text,
                textposition="outside",
                cliponaxis=False,
                showlegend=column == 1,
            ),
            row=1,
            col=column,
        )


def view_figures(m: Material) -> list[Figure]:
    """Mean residual over speed, reversal, position, ... with its noise band, joint by joint."""
    before = views(m.before.result, m.last.floor)
    after = views(m.after.result, m.last.floor) if len(m.rungs) > 1 else None
    out = []
    for j in m.concerned():
        own = [k for k, v in enumerate(before) if v.joint == m.joints[j]]
        own.sort(key=lambda k: -_strength(before[k]))
        chosen = sorted(own[:_VIEWS])
        pairs = [(before[k], after[k] if after else None) for k in chosen]
        if pairs:
            out.append(_views(m, j, pairs))
    return out


def _strength(view: View) -> float:
    used = view.count >= _FEWEST
    return float(np.max(np.abs(view.mean[used]) / np.maximum(view.band[used], 1e-300), initial=0))


def _views(m: Material, j: int, pairs: list[tuple[View, View | None]]) -> Figure:
    rows = -(-len(pairs) // 3)
    columns = min(3, len(pairs))
    fig = panel_grid(rows, columns, [_title(v) for v, _ in pairs], 180, sideways=0.055)
    top = 1.25 * max(_reach(v) for pair in pairs for v in pair if v is not None)
    for k, (old, new) in enumerate(pairs):
        row, column = k // 3 + 1, k % 3 + 1
        _one_view(fig, old, new, row, column, k == 0)
        _beyond(fig, m, old, row, column)
        fig.update_yaxes(range=[-top, top], row=row, col=column)
        fig.update_yaxes(showticklabels=column == 1, row=row, col=column)
        if column == 1:
            fig.update_yaxes(title_text=f"mean residual [{m.effort_unit(j)}]", row=row, col=column)
    text = (
        f"{m.joints[j]}: measured minus predicted effort, averaged in bins. Grey: what noise alone "
        "would give (three standard errors). A line outside the grey is a systematic error of the "
        "model; positive means that the model predicts too little. Bins over speed, reversal and "
        "load are drawn equally wide, whatever they span."
        + (" Orange: outside the range that the given model was identified on." if m.valid else "")
    )
    return Figure(fig, f"views-{j + 1}", text)


def _beyond(fig: Any, m: Material, view: View, row: int, column: int) -> None:
    """Shade what the given model was not identified on."""
    known = next((r for r in m.valid if r.joint == view.joint), None)
    if known is None or view.feature not in QUANTITIES:
        return
    low, high = range_limits(known, view.feature)
    if view.feature.startswith(UNEVEN_AXES):
        at = np.arange(view.edges.size, dtype=float)
        low, high = (float(np.interp(x, view.edges, at)) for x in (low, high))
        ends = (0.0, float(at[-1]))
    else:
        ends = (float(view.edges[0]), float(view.edges[-1]))
    for a, b in ((ends[0], low), (high, ends[1])):
        if b > a + 1e-9 * (ends[1] - ends[0]):
            look = {"fillcolor": _OUTSIDE, "opacity": 0.15, "line_width": 0, "layer": "below"}
            fig.add_vrect(x0=a, x1=b, **look, row=row, col=column)


def _reach(view: View) -> float:
    used = view.count >= _FEWEST
    if not used.any():
        return 1e-12
    return max(float(np.max(np.abs(view.mean[used]))), 1.3 * float(np.median(view.band[used])))


def _title(view: View) -> str:
    return f"over {_AXES.get(view.feature, view.feature)}".replace("transmitted ", "")


def _one_view(fig: Any, old: View, new: View | None, row: int, column: int, legend: bool) -> None:
    uneven = old.feature.startswith(UNEVEN_AXES)
    edges = np.arange(old.edges.size, dtype=float) if uneven else old.edges
    used = old.count >= _FEWEST
    band = np.where(used, old.band, 0.0)
    fig.add_trace(
        bar(
            x=(edges[1:] + edges[:-1]) / 2,
            y=2 * band,
            base=(-band).tolist(),
            width=np.diff(edges),
            marker={"color": BAND_COLOUR, "line_width": 0},
            name="noise band",
            legendgroup="noise band",
            showlegend=legend,
            hoverinfo="skip",
        ),
        row=row,
        col=column,
    )
    for view, name, color, dash in (
        (old, "before" if new else "model", BEFORE, "dot"),
        (new, "after", AFTER, "solid"),
    ):
        if view is not None:
            y = np.repeat(np.where(used, view.mean, np.nan), 2)
            trace = line_trace(
                np.repeat(edges, 2)[1:-1], y, name, color, dash=dash, width=2.2, showlegend=legend
            )
            fig.add_trace(trace, row=row, col=column)
    ticks = {"title_text": f"{escape(_axis(old.feature))} [{old.unit}]", "nticks": 6}
    if uneven:
        count = 3 if old.feature == "load" else 5
        at = np.unique(np.round(np.linspace(0, edges.size - 1, count)).astype(int))
        labels = [readable_number(float(x), 2) for x in old.edges[at]]
        if old.feature.endswith("since-reversal"):
            labels[-1] = "more"  # the last bin has no end
        ticks |= {"tickmode": "array", "tickvals": at, "ticktext": labels}
    fig.update_xaxes(**ticks, row=row, col=column)


def _axis(feature: str) -> str:
    return _AXES.get(feature, feature)


TITLES = {
    "order": "ripple over position",
    "friction-order": "ripple of the friction over position",
    "line": "lines over time",
    "frequency": "by octave of frequency",
}


# ------------------------------------------------------------ spectra


def spectra_figures(m: Material) -> list[Figure]:
    """Spectra of the residual before and after, with their bands, joint by joint."""
    out = []
    for j in m.concerned():
        rungs = [m.before, m.after] if len(m.rungs) > 1 else [m.before]
        found = [
            [*order_spectra(r.result, m.last.floor, j), *time_spectra(r.result, m.last.floor, j)]
            for r in rungs
        ]
        if found[0]:
            out.append(_figure(m, j, found))
    return out


def _figure(m: Material, j: int, found: list[list[Spectrum]]) -> Figure:
    titles = [TITLES[s.feature] for s in found[0]]
    fig = panel_grid(-(-len(titles) // 2), 2, titles, 190)
    names = ("before", "after") if len(found) > 1 else ("model",)
    for k, s in enumerate(found[0]):
        row, column = k // 2 + 1, k % 2 + 1
        fig.add_trace(
            line_trace(s.x, s.band, "noise band", BAND_COLOUR, width=5, showlegend=k == 0),
            row=row,
            col=column,
        )
        for own, name, color in zip(found, names, (BEFORE, AFTER), strict=False):
            trace = line_trace(own[k].x, own[k].amplitude, name, color, showlegend=k == 0)
            fig.add_trace(trace, row=row, col=column)
        unit = "Hz" if s.unit == "Hz" else f"periods per {s.unit[2:]}"
        low, high = np.log10([s.x[s.x > 0].min(), s.x.max()])
        ticks = _ticks(float(low), float(high))
        fig.update_xaxes(
            title_text=unit,
            type="log",
            range=[low, high],
            tickmode="array",
            tickvals=ticks,
            ticktext=[f"{x:g}" for x in ticks],
            row=row,
            col=column,
        )
        fig.update_yaxes(tickformat="~g", row=row, col=column)
        if column == 1:
            fig.update_yaxes(title_text=f"amplitude [{m.effort_unit(j)}]", row=row, col=column)
    text = (
        f"{m.joints[j]}: spectra of measured minus predicted effort. Grey: the limit for "
        "noise alone. A peak over position points to a wheel, a screw or the poles of a motor. A "
        "line over time points to a vibration that does not depend on the arm's motion."
    )
    return Figure(fig, f"spectra-{j + 1}", text)


def _ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 of every decade between two powers of ten; every decade alone over many."""
    steps = (1.0, 2.0, 5.0) if high - low < 2.5 else (1.0,)
    decades = range(int(np.floor(low)), int(np.ceil(high)) + 1)
    every = [round(s * 10.0**k, 9) for k in decades for s in steps]
    return [x for x in every if 10**low <= x <= 10**high]


#: Candidates listed, and where their numbers end on the axis [%].
CANDIDATES, NUMBERS_END = 14, 114


# ------------------------------------------------------------ candidates


def top_candidates(m: Material) -> list[Candidate]:
    """The candidates worth listing: the best by score, accepted ones always."""
    ranked = [c for c in m.first.candidates if c.absorbed < 1 - 1e-6]
    named = {(f.effect, f.joint) for f in (*m.findings, *m.partial)}
    chosen = ranked[:CANDIDATES]
    return chosen + [c for c in ranked[CANDIDATES:] if (c.name, _place(m, c)) in named]


def _place(m: Material, c: Candidate) -> str | None:
    """Joint of a candidate, None for one of the whole robot."""
    whole = c.term.effect.scope.of_robot
    return None if whole else m.joints[c.term.joint]


def explained(m: Material, c: Candidate) -> float:
    """Share of the joint's squared residual that a candidate takes away beside the first model."""
    result, j = m.before.result, c.joint
    power = float(c.parts[j]) * float(result.sigma[j]) ** 2 / m.problem.count[j]
    return float(np.clip(power / max(float(result.rms[j]) ** 2, 1e-300), 0.0, 1.0))


def candidates_figure(m: Material) -> Figure | None:
    """Share of the squared residual that each candidate explains, and what there is to explain."""
    chosen = top_candidates(m)
    if not chosen:
        return None
    labels = [escape(f"{c.name} on {_place(m, c)}" if _place(m, c) else c.name) for c in chosen]
    fig = panel_grid(1, 1, [""], 25.0 * len(chosen) + 20)
    _share_bars(fig, m, chosen, labels)
    share = [100 * explained(m, c) for c in chosen]
    numbers = [f"{x:.0f} %" if x >= 0.95 else f"{x:.1f} %" for x in share]
    look = {"mode": "text", "textposition": "middle left", "showlegend": False, "hoverinfo": "skip"}
    # beyond every bar and marker, so that none of them covers a number
    fig.add_trace(scatter(x=[NUMBERS_END] * len(share), y=labels, text=numbers, **look))
    ratio = m.floor / np.maximum(m.before.result.rms, 1e-300)
    whole = [100 * max(0.0, 1 - float(ratio[c.joint]) ** 2) for c in chosen]
    mark = {"symbol": "diamond", "size": 9, "color": FLOOR}
    name = "all error above the noise floor of the joint"
    fig.add_trace(scatter(x=whole, y=labels, mode="markers", marker=mark, name=name))
    order: dict[str, Any] = {"categoryorder": "array", "categoryarray": labels[::-1]}
    fig.update_yaxes(**order, tickmode="array", tickvals=labels, showgrid=False)
    steps: dict[str, Any] = {"tickmode": "array", "tickvals": [0, 20, 40, 60, 80, 100]}
    title = "share of the joint's squared residual [%]"
    fig.update_xaxes(title_text=title, range=[0, NUMBERS_END], **steps)
    fig.update_layout(margin={"l": 270}, barmode="overlay", legend_traceorder="normal")
    text = (
        "Each candidate was tried alone beside the first model, its coefficients fitted jointly "
        "with all others. A bar that reaches its diamond explains all error above the noise "
        "floor. A full refit, which also adapts the nonlinear parameters of the first model, may "
        "explain more. Best first, by evidence less a penalty for the number of parameters."
    )
    return Figure(fig, "candidates", text)


def _share_bars(fig: Any, m: Material, chosen: list[Candidate], labels: list[str]) -> None:
    share = 100 * np.array([explained(m, c) for c in chosen])
    seen = np.array([c.detected and c.score > 0 for c in chosen])
    kinds = (
        (seen, "detected (above noise)", AFTER),
        (~seen, "not detected", "#bdbdbd"),
    )
    for which, name, color in kinds:
        bars = bar(
            x=share[which],
            y=np.array(labels)[which],
            orientation="h",
            name=name,
            marker_color=color,
        )
        fig.add_trace(bars)


def candidates_table(m: Material) -> str:
    """The same in numbers; accepted effects set off."""
    chosen = top_candidates(m)
    named = {(f.effect, f.joint) for f in (*m.findings, *m.partial)}
    strong = [k for k, c in enumerate(chosen) if (c.name, _place(m, c)) in named]
    rows = [
        [
            c.name,
            _place(m, c) or "whole robot",
            f"{100 * explained(m, c):.1f} %",
            readable_number(c.chi2, 4),
            readable_number(c.price),
            readable_number(c.score, 4),
            readable_number(c.p_value, 2),
            f"{100 * c.absorbed:.1f} %",
        ]
        for c in chosen
    ]
    head = ["effect", "joint", "explains", "chi2", "penalty", "chi2 - penalty", "p value"]
    head.append("imitated by the model")
    return html_table(head, rows, (0, 1), strong) if rows else ""


_SECONDS, _POINTS = 5.0, 700


# ------------------------------------------------------------ traces


def window(weight: FloatArray, run: NDArray[np.int_], length: int) -> slice:
    """Stretch of `length` instants within one run where `weight` is largest.

    Parameters
    ----------
    weight : ndarray (n,)
        What to collect.
    run : ndarray (n,)
        Run of each instant.
    length : int
        Instants wanted; less if no run is that long.
    """
    length = max(2, min(length, int(np.bincount(run).max())))
    total = np.concatenate([[0.0], np.cumsum(weight)])
    gain = total[length:] - total[:-length]
    whole = run[length - 1 :] == run[: run.size - length + 1]
    start = int(np.argmax(np.where(whole, gain, -np.inf)))
    return slice(start, start + length)


def trace_figure(m: Material) -> Figure:
    """Measured against predicted effort of every joint, before and after, on held-out data."""
    old, new = m.before.heldout, m.after.heldout
    run = old.run if old.run.size else np.zeros(old.effort.shape[1], dtype=int)
    scale = np.maximum(m.floor**2, 1e-300)[:, None]
    weight = np.sum(
        (old.residual**2 - (new.residual**2 if len(m.rungs) > 1 else 0)) / scale, axis=0
    )
    part = window(weight, run, int(_SECONDS * m.problem.rate))
    step = max(1, (part.stop - part.start) // _POINTS)
    part = slice(part.start, part.stop, step)
    titles = [t for joint in m.joints for t in (joint, "")]
    heights = [170.0, 100.0] * len(m.joints)
    fig = panel_grid(2 * len(m.joints), 1, titles, heights, gap=54)
    time = np.arange(part.start, part.stop, step) / m.problem.rate
    time = time - time[0]
    for j in range(len(m.joints)):
        _joint(fig, m, j, part, time)
    fig.update_xaxes(title_text="time [s]", row=2 * len(m.joints), col=1)
    fig.update_xaxes(range=[0, float(time[-1])])
    most = "the models differ most" if len(m.rungs) > 1 else "the model errs most"
    text = (
        f"The part of the held-out data where {most}. Per joint: measured and predicted "
        "effort, and below it the residual (grey: plus and minus the rms of the noise floor). "
        "Gaps: the joint stands still, or the samples are left out of the fit."
    )
    return Figure(fig, "traces", text)


def _joint(fig: Any, m: Material, j: int, part: slice, time: FloatArray) -> None:
    old, new = m.before.heldout, m.after.heldout
    top, below, first = 2 * j + 1, 2 * j + 2, j == 0
    put = fig.add_trace
    # what the filter or a standstill leaves out is zero in the sums, and no curve
    there = np.where(old.effort[j, part] != 0.0, 0.0, np.nan)
    y = old.effort[j, part] + there
    put(line_trace(time, y, "measured", MEASURED, width=2.4, showlegend=first), row=top, col=1)
    floor = float(m.floor[j])
    band = scatter(
        x=[0, time[-1], time[-1], 0],
        y=[floor, floor, -floor, -floor],
        fill="toself",
        mode="none",
        fillcolor=BAND_COLOUR,
        name="noise floor",
        legendgroup="floor",
        showlegend=first,
        hoverinfo="skip",
    )
    put(band, row=below, col=1)
    single = len(m.rungs) == 1
    name = f"{'predicted' if single else 'before'} ({m.before.label})"
    cases = [(old, name, BEFORE, "dot")]
    if not single:
        cases.append((new, after_name(m), AFTER, "solid"))
    for held, name, color, dash in cases:
        r = held.residual[j, part] + there
        put(line_trace(time, y - r, name, color, dash=dash, showlegend=first), row=top, col=1)
        put(
            line_trace(time, r, name, color, dash=dash, width=1.4, showlegend=False),
            row=below,
            col=1,
        )
    unit, axes = m.effort_unit(j), fig.update_yaxes
    fig.update_xaxes(showticklabels=False, ticks="", row=top, col=1)
    axes(title_text=f"effort [{unit}]", row=top, col=1)
    axes(title_text=f"residual [{unit}]", nticks=4, row=below, col=1)


def after_name(m: Material) -> str:
    """Legend of the last model."""
    return f"after ({m.after.label})" if len(m.rungs) == 2 else "after (all effects added)"
