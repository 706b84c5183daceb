"""Elements of one self-contained HTML page: sections, tables, figures.

Plotly's own Python classes check every property again at every change, which takes longer than the
whole diagnosis; here a figure is a list of traces and a layout, plain data for plotly's script.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import printable

FloatArray = NDArray[np.float64]
CSS = """
:root { color-scheme: light dark; --page: #fff; --ink: #1c1c1c; --quiet: #555; --line: #ddd;
  --band: #f6f7f9; --code: #f1f3f5; --strong: #e8f1f8; --warn: #fff8e8; --link: #0060a0; }
@media screen and (prefers-color-scheme: dark) { :root { --page: #12161d; --ink: #e6eaf1;
  --quiet: #a3adbd; --line: #323b49; --band: #1a2029; --code: #25303f; --strong: #22344a;
  --warn: #3a2f14; --link: #6cabf0; } }
body { background: var(--page); color: var(--ink); margin: 0; line-height: 1.5;
  font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1040px; margin: 0 auto; padding: 24px 20px 60px; }
h1 { font-size: 17px; font-weight: 600; color: var(--quiet); margin: 0 0 10px; }
h2 { font-size: 21px; margin: 44px 0 8px; padding-top: 10px; border-top: 2px solid var(--line); }
h3 { font-size: 16px; margin: 24px 0 4px; }
p, ul { margin: 8px 0; max-width: 860px; }
.verdict { border-left: 8px solid var(--tone); background: var(--band); padding: 14px 20px; }
.verdict .head { font-size: 23px; line-height: 1.35; font-weight: 600; margin: 0 0 6px;
  max-width: none; }
.equation { font: italic 17px/1.6 "STIX Two Text", "Cambria Math", Georgia, serif;
  margin-left: 24px; }
.equation b { font-weight: normal; font-style: normal; }
.next { margin: 14px 0; padding: 10px 20px; border: 1px solid var(--line); }
.note { color: var(--quiet); font-size: 13.5px; }
.warning { border-left: 5px solid #E69F00; background: var(--warn); padding: 6px 14px; }
code, pre { font: 13px/1.45 ui-monospace, Consolas, Menlo, monospace; background: var(--code); }
code { padding: 1px 4px; overflow-wrap: anywhere; }
pre { padding: 8px 12px; white-space: pre-wrap; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: 10px 0; font-size: 13.5px; }
th, td { padding: 4px 12px 4px 6px; text-align: right; vertical-align: top;
  border-bottom: 1px solid var(--line); font-variant-numeric: tabular-nums; }
th { border-bottom: 2px solid #999; font-weight: 600; vertical-align: bottom;
  max-width: 150px; }
th.text, td.text { text-align: left; }
td.text { overflow-wrap: break-word; max-width: 620px; }
tr.strong td { background: var(--strong); font-weight: 600; }
figure { margin: 14px 0; break-inside: avoid; }
figcaption { color: var(--quiet); font-size: 13.5px; max-width: 860px; margin: 0 0 4px; }
figure > div { overflow-x: auto; overflow-y: hidden; max-width: 100%; background: #fff; }
summary { cursor: pointer; color: var(--link); margin: 8px 0; }
@page { size: A4 portrait; margin: 12mm 11mm; }
@media print {
  body { zoom: 0.67; -webkit-print-color-adjust: exact; print-color-adjust: exact; }
  main { padding: 0; } h2, h3 { break-after: avoid; } tr { break-inside: avoid; }
  .scroll, figure > div { overflow: visible; max-width: none; }
  .modebar-container { display: none; }
}
"""
SCRIPT = """
window.addEventListener('beforeprint', function () {
  document.querySelectorAll('details').forEach(function (d) { d.open = true; });
});
document.querySelectorAll('script.figure').forEach(function (s) {
  Plotly.newPlot.apply(Plotly, JSON.parse(s.textContent));
});
"""


# ------------------------------------------------------------ page


def escape(text: object) -> str:
    """Text for HTML and for plotly's labels, which read HTML too."""
    return html.escape(printable(str(text)), quote=True)


def html_table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    text: Sequence[int] = (0,),
    strong: Sequence[int] = (),
) -> str:
    """Table of plain strings, escaped here.

    Parameters
    ----------
    head, rows : sequence of str
        Cells.
    text : sequence of int
        Columns that hold words (left), the others hold numbers (right).
    strong : sequence of int
        Rows to set off.
    """

    def line(cells: Sequence[str], tag: str) -> str:
        kind = [' class="text"' if k in text else "" for k in range(len(cells))]
        return "".join(f"<{tag}{c}>{escape(x)}</{tag}>" for c, x in zip(kind, cells, strict=True))

    body = "".join(
        f'<tr class="strong">{line(r, "td")}</tr>' if k in strong else f"<tr>{line(r, 'td')}</tr>"
        for k, r in enumerate(rows)
    )
    top = f"<thead><tr>{line(head, 'th')}</tr></thead>"
    return f'<div class="scroll"><table>{top}<tbody>{body}</tbody></table></div>'


def _words(text: str) -> str:
    """Escaped text that never breaks the line before a percent sign, at or within an arrow."""
    return escape(text).replace(" %", "\u00a0%").replace(" -&gt; ", "\u00a0\u2192\u00a0")


def paragraph(text: str, kind: str = "") -> str:
    """One paragraph of plain text."""
    return f'<p class="{kind}">{_words(text)}</p>' if kind else f"<p>{_words(text)}</p>"


def items(texts: Sequence[str]) -> str:
    """Bullet list of plain texts, with commands on lines of their own; empty if there are none."""
    each = []
    for text in texts:
        said, *commands = text.split("\n")
        typed = "".join(f"<br><code>{escape(line)}</code>" for line in commands)
        each.append(f"<li>{_words(said)}{typed}</li>")
    return f"<ul>{''.join(each)}</ul>" if each else ""


def verdict_box(headline: str, lines: Sequence[str], tone: str) -> str:
    """What a page says first: a sentence, and what it rests on.

    Parameters
    ----------
    headline : str
        The verdict.
    lines : sequence of str
        Sentences below it.
    tone : str
        Colour of the bar at its side.
    """
    said = "".join(paragraph(t) for t in lines)
    return (
        f'<div class="verdict" style="--tone: {tone}">'
        f'<p class="head">{escape(headline)}</p>{said}</div>'
    )


#: Names of one letter and an index, and products; other names of several letters are words.
_INDEXED = frozenset("fc fv fs fd fk fl da dv dc vs vk ia ak xk ck es ec Lrms".split())
_PRODUCTS = frozenset("kq kl dd dq dz dt".split())
#: Names that are written with a sign of their own.
_SIGNS = {
    "sum": "\u2211",
    "pi": "\u03c0",
    "tau": "\u03c4",
    "psi": "\u03c8",
    "kappa": "\u03ba",
    "theta": "\u03b8",
    "omega": "\u03c9",
    "alpha": "\u03b1",
    "beta": "\u03b2",
    "qd": "q\u0307",
    "qdd": "q\u0308",
    "mu": "\u03bc",
    "zeta": "\u03b6",
    "sqrt": "\u221a",
}
_TOKEN = re.compile(r"[A-Za-z]+[0-9]*|[0-9]+(?:\.[0-9]+)?|<-|>=|<=|\s+|.", re.DOTALL)
#: What stands below or above the line: in braces, in parentheses (powers), or one word.
_SCRIPT = re.compile(r"([_^])(?:\{([^}]*)\}|\(([^()]*)\)|([A-Za-z0-9]+))")


def typeset(equation: str) -> str:
    """An equation of the catalogue as HTML: variables slanted, indices below, powers above.

    Parameters
    ----------
    equation : str
        As `hil effects` prints it, e.g. ``tau = fs exp(-|v / vs|^n) tanh(v / v0)``.
    """
    out, at = [], 0
    for found in _SCRIPT.finditer(equation):
        tag = "sub" if found[1] == "_" else "sup"
        out.append(_symbols(equation[at : found.start()]))
        out.append(f"<{tag}>{_symbols(found[2] or found[3] or found[4])}</{tag}>")
        at = found.end()
    return "".join([*out, _symbols(equation[at:])])


def _symbols(text: str) -> str:
    return "".join(_symbol(token) for token in _TOKEN.findall(text))


def _symbol(token: str) -> str:
    """One name, number or sign of an equation."""
    name = re.fullmatch(r"([A-Za-z]+)([0-9]*)", token)
    if name is None:
        plain = {"-": "\u2212", "*": "\u00b7", "<-": "\u2190", ">=": "\u2265", "<=": "\u2264"}
        shown = escape(plain.get(token, token))
        return f"<b>{shown}</b>" if token[:1].isdigit() else shown
    word, index = name[1], name[2]
    if word in _INDEXED:
        return f"{word[0]}<sub>{word[1:]}{index}</sub>"
    shown = _SIGNS.get(word, word)
    if word not in _SIGNS and len(word) > 1 and word not in _PRODUCTS:
        shown = f"<b>{escape(word)}</b>"
    return f"{shown}<sub>{index}</sub>" if index else shown


def warnings(texts: Sequence[str]) -> str:
    """Warnings, one box each."""
    return "".join(paragraph(f"Warning: {t}", "warning") for t in texts)


def expandable(title: str, content: str) -> str:
    """Part that opens on a click, and on printing."""
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def section(title: str, *content: str) -> str:
    """Heading and content; nothing at all where there is no content."""
    body = "".join(content)
    return f"<section><h2>{escape(title)}</h2>{body}</section>" if body else ""


def document(title: str, body: str, figures: bool = True) -> str:
    """The whole file; plotly's script is inlined once, only where there are figures.

    Parameters
    ----------
    title : str
        Title of the window.
    body : str
        HTML of the page.
    figures : bool
        Whether the page draws anything.
    """
    plotly = _plotly_script() if figures else ""
    script = f"<script>{plotly}</script>" if figures else ""
    policy = _policy([plotly, SCRIPT] if figures else [SCRIPT])
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{CSS}</style>{script}</head>\n<body><main>"
        "<noscript><p>The figures need JavaScript; the tables do not.</p></noscript>"
        f"{body}</main><script>{SCRIPT}</script></body></html>\n"
    )


@cache
def _plotly_script() -> str:
    """Plotly's script for lines and bars, "basic": a quarter of the whole one, for a smaller page.

    ``static/plotly-basic.min.js`` is the file of the package plotly.js-basic-dist-min 4.1.1, of the
    MIT license, unchanged.
    """
    file = resources.files("hil.report").joinpath("static", "plotly-basic.min.js")
    return file.read_text(encoding="utf-8")


def _policy(scripts: Sequence[str]) -> str:
    """Content security policy: these scripts run, no other one, and nothing is fetched or sent.

    Figures are data that the page's own script draws.  Text of a session that got into the page
    as markup after all could therefore do nothing.
    """
    digests = (hashlib.sha256(s.encode("utf-8")).digest() for s in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(d).decode('ascii')}'" for d in digests)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


#: Properties whose parts may be named with an underscore, e.g. ``title_text``.
NESTED = ("title", "marker", "line", "margin", "legend", "font")
#: Number types that plotly's script reads as binary.
_BINARY = {"float32": "f4", "float64": "f8"}
FigureSpec = dict[str, Any]


# ------------------------------------------------------------ panels


def nested(properties: Mapping[str, Any]) -> FigureSpec:
    """Properties as a tree: ``title_text`` is ``text`` within ``title``."""
    out: FigureSpec = {}
    for name, value in properties.items():
        head, _, rest = name.partition("_")
        if rest and head in NESTED:
            _merge(out, {head: nested({rest: value})})
        else:
            _merge(out, {name: nested(value) if isinstance(value, dict) else value})
    return out


def _merge(tree: FigureSpec, more: Mapping[str, Any]) -> None:
    """Put more into a tree; what is there already is replaced leaf by leaf."""
    for name, value in more.items():
        if isinstance(value, dict) and isinstance(tree.get(name), dict):
            _merge(tree[name], value)
        else:
            tree[name] = value


def _plain(value: Any) -> Any:
    """A value as JSON: long rows of numbers in binary, others as lists."""
    if isinstance(value, np.ndarray):
        if value.size and value.dtype.name in _BINARY:
            data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode("ascii")
            return {"dtype": _BINARY[value.dtype.name], "bdata": data}
        return value.tolist()
    return value.item()


def _known(value: Any) -> Any:
    """A tree as JSON has it: arrays as `_plain` says, a number that is none as null, a gap."""
    if isinstance(value, dict):
        return {k: _known(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_known(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, str | bool | int | float):
        return value
    return _known(_plain(value))


class Panels:
    """Rows and columns of axes; the heights of the rows are given in pixels."""

    def __init__(
        self,
        heights: Sequence[float],
        columns: int,
        gap: float,
        sideways: float,
        titles: Sequence[str],
    ) -> None:
        self.rows, self.columns = len(heights), columns
        self.data: list[FigureSpec] = []
        self.layout: FigureSpec = {"annotations": [], "shapes": []}
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
            {
                "text": text,
                "x": x,
                "y": y,
                "xanchor": "center",
                "yanchor": "bottom",
                "xref": "paper",
                "yref": "paper",
                "showarrow": False,
                "font": {"size": 13},
            }
        )

    def _names(self, row: int, column: int) -> tuple[str, str]:
        k = (row - 1) * self.columns + column
        return (f"x{k}", f"y{k}") if k > 1 else ("x", "y")

    def _axes(self, kind: int, row: int | None, column: int | None) -> Iterator[FigureSpec]:
        for r in range(1, self.rows + 1) if row is None else (row,):
            for c in range(1, self.columns + 1) if column is None else (column,):
                name = self._names(r, c)[kind]
                yield self.layout[f"{name[0]}axis{name[1:]}"]

    def add_trace(self, trace: FigureSpec, row: int = 1, col: int = 1) -> None:
        """Draw a trace in one panel."""
        x, y = self._names(row, col)
        self.data.append({**nested(trace), "xaxis": x, "yaxis": y})

    def add_hline(self, y: float, line: FigureSpec, row: int = 1, col: int = 1) -> None:
        """Horizontal line across one panel."""
        across, axis = self._names(row, col)
        self.layout["shapes"].append(
            {
                "type": "line",
                "x0": 0,
                "x1": 1,
                "xref": f"{across} domain",
                "y0": y,
                "y1": y,
                "yref": axis,
                "line": line,
            }
        )

    def add_vrect(self, x0: float, x1: float, row: int = 1, col: int = 1, **look: Any) -> None:
        """Rectangle over the whole height of one panel."""
        axis, up = self._names(row, col)
        self.layout["shapes"].append(
            {
                "type": "rect",
                "x0": x0,
                "x1": x1,
                "xref": axis,
                "y0": 0,
                "y1": 1,
                "yref": f"{up} domain",
                **nested(look),
            }
        )

    def update_xaxes(self, row: int | None = None, col: int | None = None, **more: Any) -> None:
        """Change the horizontal axes of a panel, a row, a column, or all."""
        for axis in self._axes(0, row, col):
            _merge(axis, nested(more))

    def update_yaxes(self, row: int | None = None, col: int | None = None, **more: Any) -> None:
        """Change the vertical axes of a panel, a row, a column, or all."""
        for axis in self._axes(1, row, col):
            _merge(axis, nested(more))

    def update_layout(self, **more: Any) -> None:
        """Change what belongs to the whole figure."""
        _merge(self.layout, nested(more))

    def html(self, name: str, config: FigureSpec) -> str:
        """Division with a script that draws the figure into it."""
        # no "<" within a script: it could end it
        parts = [
            json.dumps(_known(x), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
            for x in (name, self.data, self.layout, config)
        ]
        size = f"height:{self.layout['height']}px; width:{self.layout['width']}px;"
        return (
            f'<div style="{size}"><div id="{name}" class="plotly-graph-div" '
            'style="height:100%; width:100%;"></div>'
            f'<script type="application/json" class="figure">[{",".join(parts)}]</script></div>'
        )


#: Okabe and Ito's colours, which colour-blind readers tell apart.
BEFORE, AFTER, MEASURED = "#D55E00", "#0072B2", "#222222"
RUNGS = (BEFORE, "#E69F00", "#56B4E9", "#009E73", "#CC79A7", "#999999")
CLOUD, FLOOR, BAND_COLOUR = "#9a9a9a", "#444444", "rgba(110,110,110,0.24)"
FONT = "system-ui, Segoe UI, Helvetica, Arial, sans-serif"
WIDTH, TOP, _BOTTOM, LEFT = 1040, 76, 56, 78
#: Look of every axis.
_AXIS: dict[str, Any] = {
    "gridcolor": "#ebebeb",
    "zerolinecolor": "#b5b5b5",
    "linecolor": "#888",
    "showline": True,
    "ticks": "outside",
    "ticklen": 4,
    "automargin": False,
    "title_standoff": 6,
    "title_font_size": 12,
    "exponentformat": "power",
}
LEGEND = {
    "orientation": "h",
    "x": 0,
    "xanchor": "left",
    "yanchor": "bottom",
    "itemsizing": "constant",
}
LAYOUT: dict[str, Any] = {
    "template": {"data": {"scatter": [{"type": "scatter"}]}},
    "width": WIDTH,
    "margin": {"l": LEFT, "r": 20, "t": TOP, "b": _BOTTOM},
    "font": {"family": FONT, "size": 12, "color": "#222"},
    "bargap": 0.25,
    "paper_bgcolor": "white",
    "plot_bgcolor": "white",
    "hovermode": "closest",
}


# ------------------------------------------------------------ look


def panel_grid(
    rows: int,
    columns: int,
    titles: Sequence[str],
    panel: Sequence[float] | float = 190.0,
    gap: float = 84.0,
    sideways: float = 0.08,
) -> Panels:
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
    fig.update_layout(**LAYOUT, height=area + TOP + _BOTTOM, legend=legend)
    fig.update_xaxes(**_AXIS)
    fig.update_yaxes(**_AXIS, nticks=6)
    return fig


def scatter(**more: Any) -> FigureSpec:
    """Trace of points or lines."""
    return {"type": "scatter", **more}


def bar(**more: Any) -> FigureSpec:
    """Trace of bars."""
    return {"type": "bar", **more}


def line_trace(x: FloatArray, y: FloatArray, name: str, color: str, **more: Any) -> FigureSpec:
    """Line trace in single precision; names that were seen before belong with ``showlegend``."""
    dash, width = more.pop("dash", "solid"), more.pop("width", 1.8)
    return scatter(
        x=np.asarray(x, dtype=np.float32),
        y=np.asarray(y, dtype=np.float32),
        mode="lines",
        name=escape(name),
        legendgroup=escape(name),
        line={"color": color, "width": width, "dash": dash},
        **more,
    )


def dots(x: FloatArray, y: FloatArray, name: str, color: str, **more: Any) -> FigureSpec:
    """Point trace in single precision."""
    marker = {"color": color, "size": more.pop("size", 3), "opacity": more.pop("opacity", 0.35)}
    return scatter(
        x=np.asarray(x, dtype=np.float32),
        y=np.asarray(y, dtype=np.float32),
        mode="markers",
        name=escape(name),
        legendgroup=escape(name),
        marker=marker,
        **more,
    )


@dataclass(frozen=True)
class Figure:
    """A drawing with its name and what it says.

    Parameters
    ----------
    panels : Panels
        What is drawn.
    name : str
        Unique identifier in the page.
    caption : str
        What it shows and how to read it.
    """

    panels: Panels
    name: str
    caption: str

    def html(self) -> str:
        """The figure with its caption; the page holds plotly's script."""
        config = {
            "displaylogo": False,
            "responsive": False,
            "displayModeBar": "hover",
            "modeBarButtonsToRemove": ["lasso2d", "select2d"],
        }
        inner = self.panels.html(self.name, config)
        return f"<figure><figcaption>{escape(self.caption)}</figcaption>{inner}</figure>"

    def plotly(self) -> Any:
        """The same as a figure of the plotly library, to show, change or save."""
        from plotly.graph_objects import Figure as PlotlyFigure

        return PlotlyFigure({"data": self.panels.data, "layout": self.panels.layout})


def rung_colors(count: int) -> list[str]:
    """Colours of a ladder: first and last are the same in every figure of the report."""
    if count == 1:
        return [BEFORE]
    middle = [RUNGS[1 + k % (len(RUNGS) - 1)] for k in range(count - 2)]
    return [BEFORE, *middle, AFTER]
