"""Tables of plain text, aligned, within the width there is.

A table that is too wide first breaks the lines of its words; where that is not enough it goes on
below, with its first column again, as those of the data-frame libraries do.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

#: Spaces before a table, and between its columns.
INDENT, GAP = 2, 2
#: No column of words gets narrower than this [characters].
NARROW = 16
Row = list[str]


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    left: Sequence[int] = (0,),
    width: int | None = None,
) -> str:
    """Aligned text table.

    Parameters
    ----------
    head, rows : sequence of str
        Cells; line breaks in them are shown as such.
    left : sequence of int
        Columns of words, to the left; the others hold numbers, to the right.
    width : int, optional
        Characters there are in a line; without it the table is as wide as it is.
    """
    cells = [[c.replace("\n", "\\n") for c in r] for r in (head, *rows)]
    wide = [max(len(r[k]) for r in cells) for k in range(len(head))]
    if width is None or _total(wide) <= width:
        return _lines(cells, wide, left)
    wide = _narrowed(wide, left, width)
    if _total(wide) <= width:
        return _lines(cells, wide, left)
    parts = []
    for part in _parts(wide, width):
        own = [[r[k] for k in part] for r in cells]
        words = [i for i, k in enumerate(part) if k in left]
        parts.append(_lines(own, [wide[k] for k in part], words))
    return "\n\n".join(parts)


def _total(wide: Sequence[int]) -> int:
    return INDENT + sum(wide) + GAP * (len(wide) - 1)


def _narrowed(wide: Sequence[int], left: Sequence[int], width: int) -> list[int]:
    """Widths with the columns of words made narrower, the widest first."""
    out = list(wide)
    over = _total(out) - width
    for k in sorted((k for k in left if k < len(out)), key=lambda k: -out[k]):
        cut = min(max(over, 0), max(out[k] - NARROW, 0))
        out[k] -= cut
        over -= cut
    return out


def _parts(wide: Sequence[int], width: int) -> list[list[int]]:
    """Columns of each part of a table, the first one in all."""
    parts = [[0]]
    for k in range(1, len(wide)):
        if len(parts[-1]) > 1 and _total([wide[i] for i in (*parts[-1], k)]) > width:
            parts.append([0])
        parts[-1].append(k)
    return parts


def _lines(cells: Sequence[Sequence[str]], wide: Sequence[int], left: Sequence[int]) -> str:
    head, *rows = ([_broken(c, w) for c, w in zip(r, wide, strict=True)] for r in cells)
    rule = "  ".join("-" * w for w in wide)
    lines = [*_row(head, wide, left), rule]
    for row in rows:
        lines += _row(row, wide, left)
    return "\n".join(" " * INDENT + x.rstrip() for x in lines)


def _broken(cell: str, width: int) -> Row:
    if len(cell) <= width:
        return [cell]
    return textwrap.wrap(cell, max(width, 1), break_on_hyphens=False) or [""]


def _row(cells: Sequence[Row], wide: Sequence[int], left: Sequence[int]) -> list[str]:
    """Lines of one row, as many as its highest cell has."""
    high = max(map(len, cells))
    full = [c + [""] * (high - len(c)) for c in cells]
    return [
        (" " * GAP).join(
            c[i].ljust(w) if k in left else c[i].rjust(w)
            for k, (c, w) in enumerate(zip(full, wide, strict=True))
        )
        for i in range(high)
    ]
