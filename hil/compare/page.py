"""One self-contained HTML page: sections, tables, figures; nothing is loaded from elsewhere."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence

from plotly.offline import get_plotlyjs

CSS = """
:root { color-scheme: light; }
body { background: #fff; color: #1c1c1c; margin: 0; line-height: 1.5;
  font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1040px; margin: 0 auto; padding: 24px 20px 60px; }
h1 { font-size: 17px; font-weight: 600; color: #555; margin: 0 0 10px; }
h2 { font-size: 21px; margin: 44px 0 8px; padding-top: 10px; border-top: 2px solid #ddd; }
h3 { font-size: 16px; margin: 24px 0 4px; }
p, ul { margin: 8px 0; max-width: 860px; }
.verdict { border-left: 8px solid var(--tone); background: #f6f7f9; padding: 14px 20px; }
.verdict .head { font-size: 23px; line-height: 1.35; font-weight: 600; margin: 0 0 6px;
  max-width: none; }
.next { margin: 14px 0; padding: 10px 20px; border: 1px solid #ccd3da; }
.note { color: #555; font-size: 13.5px; }
.warning { border-left: 5px solid #E69F00; background: #fff8e8; padding: 6px 14px; }
code, pre { font: 13px/1.45 ui-monospace, Consolas, Menlo, monospace; background: #f1f3f5; }
code { padding: 1px 4px; overflow-wrap: anywhere; }
pre { padding: 8px 12px; white-space: pre-wrap; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: 10px 0; font-size: 13.5px; }
th, td { padding: 4px 12px 4px 6px; text-align: right; vertical-align: top;
  border-bottom: 1px solid #e4e4e4; font-variant-numeric: tabular-nums; }
th { border-bottom: 2px solid #999; font-weight: 600; vertical-align: bottom;
  max-width: 150px; }
th.text, td.text { text-align: left; }
td.text { overflow-wrap: break-word; max-width: 620px; }
tr.strong td { background: #e8f1f8; font-weight: 600; }
figure { margin: 14px 0; break-inside: avoid; }
figcaption { color: #444; font-size: 13.5px; max-width: 860px; margin: 0 0 4px; }
figure > div { overflow-x: auto; overflow-y: hidden; }
summary { cursor: pointer; color: #0060a0; margin: 8px 0; }
@page { size: A4 portrait; margin: 12mm 11mm; }
@media print {
  body { zoom: 0.67; -webkit-print-color-adjust: exact; print-color-adjust: exact; }
  main { padding: 0; } h2, h3 { break-after: avoid; } tr { break-inside: avoid; }
  .scroll, figure > div { overflow: visible; } .modebar-container { display: none; }
}
"""
SCRIPT = """
window.addEventListener('beforeprint', function () {
  document.querySelectorAll('details').forEach(function (d) { d.open = true; });
});
"""


def escape(text: object) -> str:
    """Text for HTML and for plotly's labels, which read HTML too."""
    return html.escape(str(text), quote=True)


def number(x: float, digits: int = 3) -> str:
    """A number for people: significant digits, a dash where there is none."""
    if not math.isfinite(x):
        return "-"
    text = f"{x:.{digits}g}"
    if "e+" in text and abs(x) < 1e6:
        text = f"{x:.0f}"
    return text.replace("-", "\u2212")


def table(
    head: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int] = (0,),
    strong: Sequence[int] = (),
) -> str:  # fmt: skip
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
    """Escaped text that never breaks the line before a percent sign."""
    return escape(text).replace(" %", "\u00a0%")


def paragraph(text: str, kind: str = "") -> str:
    """One paragraph of plain text."""
    return f'<p class="{kind}">{_words(text)}</p>' if kind else f"<p>{_words(text)}</p>"


def items(texts: Sequence[str]) -> str:
    """Bullet list of plain texts; empty if there are none."""
    return "<ul>" + "".join(f"<li>{_words(t)}</li>" for t in texts) + "</ul>" if texts else ""


def warnings(texts: Sequence[str]) -> str:
    """Warnings, one box each."""
    return "".join(paragraph(f"Warning: {t}", "warning") for t in texts)


def folded(title: str, content: str) -> str:
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
    script = f"<script>{get_plotlyjs()}</script>" if figures else ""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{CSS}</style>{script}</head>\n<body><main>"
        "<noscript><p>The figures need JavaScript; the tables do not.</p></noscript>"
        f"{body}</main><script>{SCRIPT}</script></body></html>\n"
    )
