"""Text tables: columns by name, the first bad cell named."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError, unknown

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Table:
    """Named columns of one file.

    Parameters
    ----------
    path : Path
        The file, for messages.
    names : tuple of str
        Columns there are.
    read : callable
        From wanted names to their values, each (n,).
    first_row : int
        Row number of the first sample as an editor counts, for messages.
    run : str
        Name of the run.
    """

    path: Path
    names: tuple[str, ...]
    read: Callable[[Sequence[str]], dict[str, FloatArray]]
    first_row: int = 0
    run: str = ""

    def columns(self, wanted: Sequence[str]) -> dict[str, FloatArray]:
        """Values of some columns.

        Raises
        ------
        DataError
            If one is missing or holds something that is not a number.
        """
        for name in wanted:
            if name not in self.names:
                raise DataError(f"table {self.path}: " + unknown("column", name, self.names))
        return self.read(wanted)


def text_table(path: Path) -> Table:
    """Open a text table: header row; comma, semicolon or tab between the cells.

    Raises
    ------
    DataError
        If it is empty, not text, or lacks a header row.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise DataError(f"table {path} is not a text file: {error}") from error
    head = _header_line(lines)
    if head is None:
        raise DataError(f"table {path} is empty; a header row and samples are needed")
    header = lines[head].lstrip("#% ")
    delimiter = max(";\t,", key=header.count)
    names = tuple(n.strip() for n in next(csv.reader([header], delimiter=delimiter)))
    body = [(i + 1, line) for i, line in enumerate(lines) if i > head and line.strip()]
    if all(_is_number(n) for n in names):
        raise DataError(
            f"table {path}: row {head + 1} holds numbers; a header row with column names is needed"
        )
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise DataError(f"table {path}: column {twice[0]!r} stands twice in the header")
    if not body:
        raise DataError(f"table {path} has a header row but no samples")
    reader = _TextColumns(path, names, delimiter, body)
    return Table(path, names, reader, body[0][0], path.stem)


def _header_line(lines: Sequence[str]) -> int | None:
    """Index of the header: the first row, or the last comment if numbers follow it."""
    comment: int | None = None
    for i, line in enumerate(lines):
        if line.lstrip().startswith(("#", "%")):
            comment = i
        elif line.strip():
            first = line.replace(";", ",").replace("\t", ",").split(",")[0]
            return comment if comment is not None and _is_number(first) else i
    return None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@dataclass(frozen=True)
class _TextColumns:
    path: Path
    names: tuple[str, ...]
    delimiter: str
    body: list[tuple[int, str]]

    def __call__(self, wanted: Sequence[str]) -> dict[str, FloatArray]:
        use = [self.names.index(n) for n in wanted]
        if not use:
            return {}
        rows = [line for _, line in self.body]
        if self.delimiter == ";" and not any("." in line for line in rows[:100]):
            rows = [line.replace(",", ".") for line in rows]
        try:
            block = np.loadtxt(rows, delimiter=self.delimiter, usecols=use, ndmin=2, comments=None)
        except ValueError:
            block = self._slowly(wanted, use, rows)
        return {name: block[:, k] for k, name in enumerate(wanted)}

    def _slowly(self, wanted: Sequence[str], use: list[int], rows: list[str]) -> FloatArray:
        """Row by row: empty cells become NaN, the first bad cell is named."""
        out = np.empty((len(rows), len(use)))
        cells = csv.reader(rows, delimiter=self.delimiter)
        for i, row in enumerate(cells):
            where = f"table {self.path}, row {self.body[i][0]}"
            if len(row) not in (len(self.names), len(self.names) + (row[-1].strip() == "")):
                raise DataError(f"{where}: {len(row)} cells; expected {len(self.names)}")
            for k, column in enumerate(use):
                text = row[column].strip()
                try:
                    out[i, k] = float(text) if text else math.nan
                except ValueError:
                    raise DataError(
                        f"{where}: column {wanted[k]!r} holds {text!r}; expected a number"
                    ) from None
        return out
