"""The look of all figures: palette for colour-blind readers, grids of panels, embedding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.compare.page import escape
from hil.compare.panels import Panels, Tree

FloatArray = NDArray[np.float64]
#: Okabe and Ito's colours, which colour-blind readers tell apart.
BEFORE, AFTER, MEASURED = "#D55E00", "#0072B2", "#222222"
RUNGS = (BEFORE, "#E69F00", "#56B4E9", "#009E73", "#CC79A7", "#999999")
CLOUD, FLOOR, BAND = "#9a9a9a", "#444444", "rgba(110,110,110,0.24)"
FONT = "system-ui, Segoe UI, Helvetica, Arial, sans-serif"
WIDTH, TOP, BOTTOM, LEFT = 1040, 76, 56, 78

#: Look of every axis.
AXIS: dict[str, Any] = {"gridcolor": "#ebebeb", "zerolinecolor": "#b5b5b5", "linecolor": "#888",
        "showline": True, "ticks": "outside", "ticklen": 4, "automargin": False,
        "title_standoff": 6, "title_font_size": 12, "exponentformat": "power"}  # fmt: skip

LEGEND = {
    "orientation": "h",
    "x": 0,
    "xanchor": "left",
    "yanchor": "bottom",
    "itemsizing": "constant",
}
LAYOUT: dict[str, Any] = {
    "template": {"data": {"scatter": [{"type": "scatter"}]}}, "width": WIDTH,
    "margin": {"l": LEFT, "r": 20, "t": TOP, "b": BOTTOM},
    "font": {"family": FONT, "size": 12, "color": "#222"}, "bargap": 0.25,
    "paper_bgcolor": "white", "plot_bgcolor": "white", "hovermode": "closest",
}  # fmt: skip


def grid(
    rows: int, columns: int, titles: Sequence[str], panel: Sequence[float] | float = 190.0,
    gap: float = 84.0, sideways: float = 0.08,
) -> Panels:  # fmt: skip
    """Figure of panels whose heights and gaps are given in pixels.

    Parameters
    ----------
    rows, columns, titles : int, int, sequence of str
        Panels and one title each, escaped here.
    panel, gap : float
        Height of a row (or of each), and space between rows [px].
    sideways : float
        Space between columns as a share of the width.
    """
    heights = [float(panel)] * rows if isinstance(panel, float | int) else list(panel)
    area = sum(heights) + gap * (rows - 1)
    fig = Panels(heights, columns, gap, sideways, [escape(t) for t in titles])
    # the legend stands above the panels' titles and grows upwards
    legend = {**LEGEND, "y": 1 + 28 / area}
    fig.update_layout(**LAYOUT, height=area + TOP + BOTTOM, legend=legend)
    fig.update_xaxes(**AXIS)
    fig.update_yaxes(**AXIS, nticks=6)
    return fig


def scatter(**more: Any) -> Tree:
    """Trace of points or lines."""
    return {"type": "scatter", **more}


def bar(**more: Any) -> Tree:
    """Trace of bars."""
    return {"type": "bar", **more}


def line(x: FloatArray, y: FloatArray, name: str, color: str, **more: Any) -> Tree:
    """Line trace in single precision; names that were seen before belong with ``showlegend``."""
    dash, width = more.pop("dash", "solid"), more.pop("width", 1.8)
    return scatter(
        x=np.asarray(x, dtype=np.float32), y=np.asarray(y, dtype=np.float32), mode="lines",
        name=escape(name), legendgroup=escape(name),
        line={"color": color, "width": width, "dash": dash}, **more,
    )  # fmt: skip


def dots(x: FloatArray, y: FloatArray, name: str, color: str, **more: Any) -> Tree:
    """Point trace in single precision."""
    marker = {"color": color, "size": more.pop("size", 3), "opacity": more.pop("opacity", 0.35)}
    return scatter(
        x=np.asarray(x, dtype=np.float32), y=np.asarray(y, dtype=np.float32), mode="markers",
        name=escape(name), legendgroup=escape(name), marker=marker, **more,
    )  # fmt: skip


def embed(fig: Panels, name: str, caption: str) -> str:
    """HTML of a figure with its caption; the page holds plotly's script.

    Parameters
    ----------
    fig : Panels
        What to draw.
    name : str
        Unique identifier in the page.
    caption : str
        What it shows and how to read it.
    """
    config = {"displaylogo": False, "responsive": False, "displayModeBar": "hover",
              "modeBarButtonsToRemove": ["lasso2d", "select2d"]}  # fmt: skip
    inner = fig.html(name, config)
    return f"<figure><figcaption>{escape(caption)}</figcaption>{inner}</figure>"


def rung_colors(count: int) -> list[str]:
    """Colours of a ladder: first and last are the same in every figure of the report."""
    if count == 1:
        return [BEFORE]
    middle = [RUNGS[1 + k % (len(RUNGS) - 1)] for k in range(count - 2)]
    return [BEFORE, *middle, AFTER]
