"""Figures of a report: error ladder, where the model fails, candidates."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.compare.localise import View, views
from hil.compare.material import Material
from hil.compare.page import escape, number
from hil.compare.plots import (
    AFTER,
    BAND,
    BEFORE,
    FLOOR,
    TOP,
    bar,
    embed,
    grid,
    line,
    rung_colors,
    scatter,
)
from hil.identify.validity import QUANTITIES, limits

FloatArray = NDArray[np.float64]
#: Colour of what lies outside the range that a model was identified on.
OUTSIDE = "#E69F00"
#: Views drawn per joint, and bins with fewer instants than this are left out.
VIEWS, FEWEST = 9, 10
ONE_STEP = (
    "How to read: one group of bars a joint, one bar a model. The dashed line at 1 is the measured "
    "noise floor: what all effects of the catalogue together leave, without its chance gain. A bar "
    "at the line leaves nothing for them to explain; an effect of your own may still go below it."
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
UNEVEN = ("speed", "since-reversal", "distance-since-reversal", "load")


def ladder_figure(m: Material) -> str:
    """Held-out error over the noise floor, and the simulated position error beside it."""
    multi = np.array([r.multi_step.relative for r in m.rungs])
    both = not m.external and bool(np.isfinite(multi).any())
    titles = ["one-step: error of the predicted effort"]
    titles += [f"multi-step: position error in {m.rungs[0].multi_step.horizon:g} s simulations"]
    fig = grid(1, 2 if both else 1, titles[: 1 + both], 300, sideways=0.1)
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
    return embed(fig, "ladder", ONE_STEP + (MULTI_STEP if both else ""))


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
                x=[escape(j) for j in joints], y=y, name=escape(label), legendgroup=escape(label),
                marker_color=color, text=text, textposition="outside", cliponaxis=False,
                showlegend=column == 1,
            ),
            row=1, col=column,
        )  # fmt: skip


def view_figures(m: Material) -> list[str]:
    """Mean residual over speed, reversal, position, ... with its noise band, joint by joint."""
    before = views(m.before.result, m.last.floor)
    after = views(m.after.result, m.last.floor) if len(m.rungs) > 1 else None
    out = []
    for j in m.concerned():
        own = [k for k, v in enumerate(before) if v.joint == m.joints[j]]
        own.sort(key=lambda k: -_strength(before[k]))
        chosen = sorted(own[:VIEWS])
        pairs = [(before[k], after[k] if after else None) for k in chosen]
        if pairs:
            out.append(_views(m, j, pairs))
    return out


def _strength(view: View) -> float:
    used = view.count >= FEWEST
    return float(np.max(np.abs(view.mean[used]) / np.maximum(view.band[used], 1e-300), initial=0))


def _views(m: Material, j: int, pairs: list[tuple[View, View | None]]) -> str:
    rows = -(-len(pairs) // 3)
    columns = min(3, len(pairs))
    fig = grid(rows, columns, [_title(v) for v, _ in pairs], 180, sideways=0.055)
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
    return embed(fig, f"views-{j + 1}", text)


def _beyond(fig: Any, m: Material, view: View, row: int, column: int) -> None:
    """Shade what the given model was not identified on."""
    known = next((r for r in m.valid if r.joint == view.joint), None)
    if known is None or view.feature not in QUANTITIES:
        return
    low, high = limits(known, view.feature)
    if view.feature.startswith(UNEVEN):
        at = np.arange(view.edges.size, dtype=float)
        low, high = (float(np.interp(x, view.edges, at)) for x in (low, high))
        ends = (0.0, float(at[-1]))
    else:
        ends = (float(view.edges[0]), float(view.edges[-1]))
    for a, b in ((ends[0], low), (high, ends[1])):
        if b > a + 1e-9 * (ends[1] - ends[0]):
            look = {"fillcolor": OUTSIDE, "opacity": 0.15, "line_width": 0, "layer": "below"}
            fig.add_vrect(x0=a, x1=b, **look, row=row, col=column)


def _reach(view: View) -> float:
    used = view.count >= FEWEST
    if not used.any():
        return 1e-12
    return max(float(np.max(np.abs(view.mean[used]))), 1.3 * float(np.median(view.band[used])))


def _title(view: View) -> str:
    return f"over {_AXES.get(view.feature, view.feature)}".replace("transmitted ", "")


def _one_view(fig: Any, old: View, new: View | None, row: int, column: int, legend: bool) -> None:
    uneven = old.feature.startswith(UNEVEN)
    edges = np.arange(old.edges.size, dtype=float) if uneven else old.edges
    used = old.count >= FEWEST
    band = np.where(used, old.band, 0.0)
    fig.add_trace(
        bar(
            x=(edges[1:] + edges[:-1]) / 2, y=2 * band, base=(-band).tolist(), width=np.diff(edges),
            marker={"color": BAND, "line_width": 0}, name="noise band", legendgroup="noise band",
            showlegend=legend, hoverinfo="skip",
        ),
        row=row, col=column,
    )  # fmt: skip
    for view, name, color, dash in (
        (old, "before" if new else "model", BEFORE, "dot"),
        (new, "after", AFTER, "solid"),
    ):
        if view is not None:
            y = np.repeat(np.where(used, view.mean, np.nan), 2)
            trace = line(np.repeat(edges, 2)[1:-1], y, name, color, dash=dash, width=2.2,
                         showlegend=legend)  # fmt: skip
            fig.add_trace(trace, row=row, col=column)
    ticks = {"title_text": f"{escape(_axis(old.feature))} [{old.unit}]", "nticks": 6}
    if uneven:
        count = 3 if old.feature == "load" else 5
        at = np.unique(np.round(np.linspace(0, edges.size - 1, count)).astype(int))
        labels = [number(float(x), 2) if abs(x) < 999 else "" for x in old.edges[at]]
        ticks |= {"tickmode": "array", "tickvals": at, "ticktext": labels}
    fig.update_xaxes(**ticks, row=row, col=column)


def _axis(feature: str) -> str:
    return _AXES.get(feature, feature)
