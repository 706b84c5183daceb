"""Pages of the studies: the thesis' figure or number, ours over seeds, the difference and why.

Every number of a page comes from the runs; a sentence about them is made from them.  Each study
says in its own module what its page says; here is what all pages share, and the bars with
intervals that are their figures, as SVG.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

PageData = Mapping[str, Any]
#: A row's numbers by its name.
TableRows = dict[str, tuple[float, ...]]


@dataclass(frozen=True)
class SeedMean:
    """Mean over seeds, and half width of its 95 % interval by Student's t.

    Parameters
    ----------
    mean, half : float
        `half` is NaN for one seed.
    """

    mean: float
    half: float

    @classmethod
    def of(cls, values: Sequence[float]) -> SeedMean:
        """Mean of values, one a seed."""
        n = len(values)
        if n < 2:
            return cls(float(np.mean(values)), float("nan"))
        half = stats.t.ppf(0.975, n - 1) * np.std(values, ddof=1) / np.sqrt(n)
        return cls(float(np.mean(values)), float(half))

    def __str__(self) -> str:
        """E.g. ``0.041 +- 0.001``; as many digits as the interval, or four where there is none."""
        if not np.isfinite(self.mean):
            return "-"
        if not (np.isfinite(self.half) and self.half > 1e-4 * abs(self.mean)):
            return f"{self.mean:.4g}"
        digits = int(np.clip(1 - np.floor(np.log10(self.half)), 0, 6))
        return f"{self.mean:.{digits}f} +- {self.half:.{digits}f}"


Means = Mapping[str, Sequence[SeedMean]]


@dataclass(frozen=True)
class PageTest:
    """A statistical test over the runs of a page.

    Parameters
    ----------
    title : str
        What is tested, and how.
    head : tuple of str
        Heads of the columns.
    rows : list of list of str
        Cells.
    read : list of str
        Sentences: what it says, and what the thesis' says.
    """

    title: str
    head: tuple[str, ...]
    rows: list[list[str]]
    read: list[str]


@dataclass(frozen=True)
class StudyPage:
    """What a study's page says beside its numbers.

    Parameters
    ----------
    title, about : str
        Heading; what is done, in sentences.
    thesis : str
        What the thesis shows.
    head : tuple of str
        Heads of the columns, the rows' first.
    rows : callable
        Numbers of one run, a tuple a row.
    read : callable
        Sentences from the means: ours against the thesis', and why they differ.
    figure : str
        Title of the figure; empty for none.
    bars : tuple of int
        Columns of numbers that the figure shows.
    only : callable
        Which rows the figure shows, by name.
    test : callable
        A test over all runs, which the means do not tell; None where there is none.
    quick : str
        What ``--quick`` leaves out of a run; empty for nothing.
    """

    title: str
    about: str
    thesis: str
    head: tuple[str, ...]
    rows: Callable[[PageData], TableRows]
    read: Callable[[Means], list[str]]
    figure: str = ""
    bars: tuple[int, ...] = (0,)
    only: Callable[[str], bool] = lambda name: True
    test: Callable[[Sequence[PageData]], PageTest | None] = lambda runs: None
    quick: str = ""


def means(page: StudyPage, runs: Sequence[PageData]) -> dict[str, list[SeedMean]]:
    """Means of each row over the runs; a number that a run lacks counts for none of it."""
    tables = [page.rows(run) for run in runs]
    out = {}
    for name in tables[0]:
        columns = zip(*(t[name] for t in tables if name in t), strict=True)
        out[name] = [_mean(values) for values in columns]
    return out


def _mean(values: Sequence[float]) -> SeedMean:
    known = [float(v) for v in values if v is not None and np.isfinite(v)]
    return SeedMean.of(known) if known else SeedMean(float("nan"), float("nan"))


def cells(found: Means) -> list[list[str]]:
    """Rows of the table."""
    return [[name, *map(str, values)] for name, values in found.items()]


def picture(page: StudyPage, found: Means) -> str:
    """Figure of a page as SVG; empty where it has none."""
    if not page.figure:
        return ""
    groups = {
        name: [values[k] for k in page.bars] for name, values in found.items() if page.only(name)
    }
    return bars(page.figure, [page.head[k + 1] for k in page.bars], groups)


def made_with(name: str, report: str, seed: int, more: str = "") -> str:
    """The command that makes a page again, its figures and its picture."""
    first = f" --seed {seed}" if seed != 1 else ""
    return f"hil experiment {name}{more}{first} --report {Path(report).name}"


def text(
    page: StudyPage,
    found: Means,
    command: str,
    seeds: str,
    picture_name: str,
    tested: PageTest | None = None,
) -> str:
    """The page; `seeds` says how many there were, and which gave no number and why."""
    figure = ["", f"![{page.figure}]({picture_name})"] if page.figure else []
    lines = [
        f"# {page.title}",
        "",
        f"Printed by `{command}`: {seeds}; mean and 95 % interval of the mean.",
        "",
        page.about,
        *figure,
        "",
        *_table(page.head, cells(found)),
        "",
        *([tested.title, "", *_table(tested.head, tested.rows), ""] if tested else []),
        "## The thesis, and here",
        "",
        f"**Thesis.** {page.thesis}",
        "",
        *(f"- {line}" for line in [*page.read(found), *(tested.read if tested else [])]),
        "",
    ]
    return "\n".join(lines)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table in Markdown."""
    return [
        "| " + " | ".join(head) + " |",
        "|" + "---|" * len(head),
        *("| " + " | ".join(row) + " |" for row in rows),
    ]


# ------------------------------------------------------------ figures

_COLOURS = ("#c2c8d0", "#6f9bd1", "#1f5fa8", "#e0a458", "#8a4f7d")
_WIDE, _HIGH, _LEFT, _TOP, _LINE = 900, 340, 60, 40, 15


def bars(title: str, series: Sequence[str], groups: Mapping[str, Sequence[SeedMean]]) -> str:
    """Bar chart as SVG.

    Parameters
    ----------
    title : str
        What is shown, with its unit.
    series : sequence of str
        Names of the bars of a group.
    groups : mapping of str to sequence of SeedMean
        A value for each bar, by the name of the group.
    """
    tops = [s.mean + (s.half if s.half == s.half else 0.0) for g in groups.values() for s in g]
    most = max([t for t in tops if t == t], default=1.0) * 1.05 or 1.0
    step = (_WIDE - _LEFT - 20) / len(groups)
    below, under = _labels(list(groups), step)
    parts = _begun(title, below + 40, most)
    for i, values in enumerate(groups.values()):
        w = (step - 24) / len(series)
        for k, s in enumerate(values):
            parts += _bar(
                _LEFT + step * i + 12 + k * w, w - 4, s, most, _COLOURS[k % len(_COLOURS)]
            )
    parts += under
    x = float(_LEFT)
    for k, name in enumerate(series):
        colour = _COLOURS[k % len(_COLOURS)]
        parts.append(f'<rect x="{x:.0f}" y="{below + 8}" width="14" height="14" fill="{colour}"/>')
        parts.append(f'<text x="{x + 20:.0f}" y="{below + 20}">{_safe(name)}</text>')
        x += 50 + 7.5 * len(name)
    return "\n".join([*parts, "</svg>", ""])


#: Of lines, beside each other (Okabe & Ito, with grey).
_STROKES = (
    "#888888", "#000000", "#0072B2", "#56B4E9", "#D55E00", "#E69F00", "#009E73", "#CC79A7",
)  # fmt: skip


def line_chart(title: str, places: Sequence[str], series: Mapping[str, Sequence[float]]) -> str:
    """Line chart as SVG; a line has a gap where there is no number, and is cut off below 0.

    Parameters
    ----------
    title : str
        What is shown, with its unit.
    places : sequence of str
        Names along the axis.
    series : mapping of str to sequence of float
        A value at each place, by the name of the line.
    """
    tops = [v for values in series.values() for v in values if v == v]
    most = max(tops, default=1.0) * 1.05 or 1.0
    step = (_WIDE - _LEFT - 20) / len(places)
    below, under = _labels(places, step)
    rows = -(-len(series) // 2)
    high = below + 24 + 20 * rows
    parts = [*_begun(title, high, most), *under]
    for k, (name, values) in enumerate(series.items()):
        colour = _STROKES[k % len(_STROKES)]
        run: list[str] = []
        for i, value in enumerate([*values, float("nan")]):
            if value == value:
                y = _HIGH - (_HIGH - _TOP) * max(value, 0.0) / most
                run.append(f"{_LEFT + step * (i + 0.5):.1f},{y:.1f}")
                spot = run[-1].partition(",")
                parts.append(f'<circle cx="{spot[0]}" cy="{spot[2]}" r="4" fill="{colour}"/>')
            elif run:
                parts.append(
                    f'<polyline points="{" ".join(run)}" fill="none" stroke="{colour}" '
                    'stroke-width="2"/>'
                )
                run = []
        x, y = _LEFT + (k % 2) * (_WIDE - _LEFT) / 2, below + 8 + 20 * (k // 2)
        parts.append(f'<rect x="{x:.0f}" y="{y}" width="14" height="14" fill="{colour}"/>')
        parts.append(f'<text x="{x + 20:.0f}" y="{y + 12}">{_safe(name)}</text>')
    return "\n".join([*parts, "</svg>", ""])


def _grid(most: float) -> list[str]:
    steps = [d * 10.0**k for k in range(-6, 7) for d in (1, 2, 5)]
    tick = next(x for x in steps if most / x <= 6)
    out = []
    for value in np.arange(0.0, most, tick):
        y = _TOP + (_HIGH - _TOP) * (1 - value / most)
        out.append(
            f'<line x1="{_LEFT}" x2="{_WIDE - 10}" y1="{y:.0f}" y2="{y:.0f}" stroke="#ddd"/>'
        )
        out.append(f'<text x="{_LEFT - 8}" y="{y + 4:.0f}" text-anchor="end">{value:.3g}</text>')
    return out


def _bar(x: float, wide: float, s: SeedMean, most: float, colour: str) -> list[str]:
    if not np.isfinite(s.mean):
        return []
    h = (_HIGH - _TOP) * max(s.mean, 0.0) / most
    out = [
        f'<rect x="{x:.1f}" y="{_HIGH - h:.1f}" width="{wide:.1f}" height="{h:.1f}" '
        f'fill="{colour}"/>'
    ]
    if s.half == s.half:
        e, c = (_HIGH - _TOP) * s.half / most, x + wide / 2
        out.append(
            f'<line x1="{c:.1f}" x2="{c:.1f}" y1="{max(_HIGH - h - e, _TOP):.1f}" '
            f'y2="{min(_HIGH - h + e, _HIGH):.1f}" stroke="#222"/>'
        )
    return out


def _begun(title: str, high: int, most: float) -> list[str]:
    """Head of a chart of this height: sheet, title, and a grid up to `most`."""
    return [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDE} {high}" '
        'font-family="sans-serif" font-size="13">',
        f'<path d="M0 0H{_WIDE}V{high}H0z" fill="#fff"/>',
        f'<text x="{_LEFT}" y="20">{_safe(title)}</text>',
        *_grid(most),
    ]


#: Width of a letter, about.
_LETTER = 7.0


def _labels(names: Sequence[str], step: float) -> tuple[int, list[str]]:
    """Lowest line below the names of groups, and their texts; aslant where words do not fit."""
    middle = [_LEFT + step * (k + 0.5) for k in range(len(names))]
    if any(_LETTER * len(word) > step for name in names for word in name.split()):
        slant = [
            f'<text transform="translate({x + 5:.1f} {_HIGH + 16}) rotate(-50)" '
            f'text-anchor="end">{_safe(name)}</text>'
            for x, name in zip(middle, names, strict=True)
        ]
        return _HIGH + 30 + round(0.77 * _LETTER * max(map(len, names))), slant
    rows = [_wrapped(name, step) for name in names]
    told = [
        f'<text x="{x:.1f}" y="{_HIGH + 20 + _LINE * k}" text-anchor="middle">{_safe(line)}</text>'
        for x, row in zip(middle, rows, strict=True)
        for k, line in enumerate(row)
    ]
    return _HIGH + 20 + _LINE * max(map(len, rows)), told


def _wrapped(name: str, step: float) -> list[str]:
    """A name in lines that fit its group."""
    lines = [""]
    for word in name.split():
        longer = f"{lines[-1]} {word}".strip()
        if len(longer) * _LETTER > step and lines[-1]:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _safe(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
