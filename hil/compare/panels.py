"""A figure of panels as plain data for plotly's script.

Plotly's own Python classes check every property again at every change, which takes longer than
the whole diagnosis; here a figure is a list of traces and a layout, written as they are.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

#: Properties whose parts may be named with an underscore, e.g. ``title_text``.
NESTED = ("title", "marker", "line", "margin", "legend", "font")
#: Number types that plotly's script reads as binary.
BINARY = {"float32": "f4", "float64": "f8"}
Tree = dict[str, Any]


def nested(properties: Mapping[str, Any]) -> Tree:
    """Properties as a tree: ``title_text`` is ``text`` within ``title``."""
    out: Tree = {}
    for name, value in properties.items():
        head, _, rest = name.partition("_")
        if rest and head in NESTED:
            merge(out, {head: nested({rest: value})})
        else:
            merge(out, {name: nested(value) if isinstance(value, dict) else value})
    return out


def merge(tree: Tree, more: Mapping[str, Any]) -> None:
    """Put more into a tree; what is there already is replaced leaf by leaf."""
    for name, value in more.items():
        if isinstance(value, dict) and isinstance(tree.get(name), dict):
            merge(tree[name], value)
        else:
            tree[name] = value


def plain(value: Any) -> Any:
    """A value as JSON: long rows of numbers in binary, others as lists."""
    if isinstance(value, np.ndarray):
        if value.size and value.dtype.name in BINARY:
            data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode("ascii")
            return {"dtype": BINARY[value.dtype.name], "bdata": data}
        return value.tolist()
    return value.item()


class Panels:
    """Rows and columns of axes; the heights of the rows are given in pixels."""

    def __init__(
        self, heights: Sequence[float], columns: int, gap: float, sideways: float,
        titles: Sequence[str],
    ) -> None:  # fmt: skip
        self.rows, self.columns = len(heights), columns
        self.data: list[Tree] = []
        self.layout: Tree = {"annotations": [], "shapes": []}
        area = sum(heights) + gap * (self.rows - 1)
        wide = (1.0 - sideways * (columns - 1)) / columns
        top = 1.0
        for r, height in enumerate(heights):
            for c in range(columns):
                x, y = self._names(r + 1, c + 1)
                left, bottom = c * (wide + sideways), max(top - height / area, 0.0)
                self.layout["xaxis" + x[1:]] = {"anchor": y, "domain": [left, left + wide]}
                self.layout["yaxis" + y[1:]] = {"anchor": x, "domain": [bottom, top]}
                text = titles[r * columns + c] if r * columns + c < len(titles) else ""
                if text:
                    self._title(text, left + wide / 2, top)
            top -= (height + gap) / area

    def _title(self, text: str, x: float, y: float) -> None:
        self.layout["annotations"].append(
            {"text": text, "x": x, "y": y, "xanchor": "center", "yanchor": "bottom",
             "xref": "paper", "yref": "paper", "showarrow": False, "font": {"size": 13}}
        )  # fmt: skip

    def _names(self, row: int, column: int) -> tuple[str, str]:
        k = (row - 1) * self.columns + column
        return (f"x{k}", f"y{k}") if k > 1 else ("x", "y")

    def _axes(self, kind: int, row: int | None, column: int | None) -> Iterator[Tree]:
        for r in range(1, self.rows + 1) if row is None else (row,):
            for c in range(1, self.columns + 1) if column is None else (column,):
                name = self._names(r, c)[kind]
                yield self.layout[f"{name[0]}axis{name[1:]}"]

    def add_trace(self, trace: Tree, row: int = 1, col: int = 1) -> None:
        """Draw a trace in one panel."""
        x, y = self._names(row, col)
        self.data.append({**nested(trace), "xaxis": x, "yaxis": y})

    def add_hline(self, y: float, line: Tree, row: int = 1, col: int = 1) -> None:
        """Horizontal line across one panel."""
        across, axis = self._names(row, col)
        self.layout["shapes"].append(
            {"type": "line", "x0": 0, "x1": 1, "xref": f"{across} domain", "y0": y, "y1": y,
             "yref": axis, "line": line}
        )  # fmt: skip

    def add_vrect(self, x0: float, x1: float, row: int = 1, col: int = 1, **look: Any) -> None:
        """Rectangle over the whole height of one panel."""
        axis, up = self._names(row, col)
        self.layout["shapes"].append(
            {"type": "rect", "x0": x0, "x1": x1, "xref": axis, "y0": 0, "y1": 1,
             "yref": f"{up} domain", **nested(look)}
        )  # fmt: skip

    def update_xaxes(self, row: int | None = None, col: int | None = None, **more: Any) -> None:
        """Change the horizontal axes of a panel, a row, a column, or all."""
        for axis in self._axes(0, row, col):
            merge(axis, nested(more))

    def update_yaxes(self, row: int | None = None, col: int | None = None, **more: Any) -> None:
        """Change the vertical axes of a panel, a row, a column, or all."""
        for axis in self._axes(1, row, col):
            merge(axis, nested(more))

    def update_layout(self, **more: Any) -> None:
        """Change what belongs to the whole figure."""
        merge(self.layout, nested(more))

    def html(self, name: str, config: Tree) -> str:
        """Division with a script that draws the figure into it."""
        # no "<" within a script: it could end it
        parts = [
            json.dumps(x, default=plain, separators=(",", ":")).replace("<", "\\u003c")
            for x in (name, self.data, self.layout, config)
        ]
        size = f"height:{self.layout['height']}px; width:{self.layout['width']}px;"
        return (
            f'<div style="{size}"><div id="{name}" class="plotly-graph-div" '
            'style="height:100%; width:100%;"></div>'
            f"<script>Plotly.newPlot({','.join(parts)})</script></div>"
        )
