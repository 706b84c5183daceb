"""Columns of a CSV, NPZ or MAT file by name, whatever they mean.

Text tables: columns by name, the first bad cell named.
"""

from __future__ import annotations

import csv
import functools
import math
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError, unknown


@dataclass(frozen=True)
class ForeignTable:
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


def text_table(path: Path) -> ForeignTable:
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
    return ForeignTable(path, names, reader, body[0][0], path.stem)


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


FloatArray = NDArray[np.float64]
__all__ = ["FORMATS", "ForeignTable", "open_table", "run_names"]

FORMATS = (".csv", ".tsv", ".txt", ".npz", ".mat")


def open_table(
    path: str | Path,
    array: str = "",
    columns: Sequence[str] = (),
    run: str = "",
) -> ForeignTable:
    """Open a table.

    Parameters
    ----------
    path : str or Path
        CSV (comma, semicolon or tab; header row), NPZ or MAT file.
    array : str
        The 2-D array (n, k), structured array or struct of an NPZ or MAT file that holds the
        columns.
    columns : sequence of str
        Names of the columns of a 2-D array; with no `array`, every array of so many columns
        is a run.  Without `columns`, every structured array is one.
    run : str
        Run to choose.

    Raises
    ------
    DataError
        If the file is missing, empty, of another format, or the run is not there.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise DataError(f"table {path}: format {path.suffix!r}; expected {', '.join(FORMATS)}")
    try:
        if path.stat().st_size == 0:
            raise DataError(f"table {path} is empty (0 bytes); a header row and samples are needed")
        if path.suffix.lower() in (".npz", ".mat"):
            return _arrays(path, array, columns, run)
        if run:
            raise DataError(f"table {path}: a text table holds one run; leave --run {run!r} out")
        return text_table(path)
    except OSError as error:
        raise DataError(f"table {path}: {error.strerror or error}") from error


def run_names(path: str | Path, columns: Sequence[str] = ()) -> list[str]:
    """Names of the runs of an NPZ or MAT file.

    They are its 2-D arrays of so many columns; without `columns`, its structured arrays.

    Raises
    ------
    DataError
        If the file cannot be read.
    """
    if Path(path).suffix.lower() not in (".npz", ".mat"):
        return []
    data = _load(Path(path))
    return _runs(data, columns) if columns else [k for k, v in data.items() if _fields(v)]


def _runs(data: dict[str, NDArray[Any]], columns: Sequence[str]) -> list[str]:
    return [k for k, v in data.items() if columns and v.ndim == 2 and v.shape[1] == len(columns)]


def _load(path: Path) -> dict[str, NDArray[Any]]:
    return _load_once(path, path.stat().st_mtime_ns)


@functools.lru_cache(maxsize=1)  # a file of many runs is read once for all of them
def _load_once(path: Path, _: int) -> dict[str, NDArray[Any]]:
    if path.suffix.lower() == ".npz":
        try:
            with np.load(path, allow_pickle=False) as data:
                return {key: data[key] for key in data.files}
        except (zipfile.BadZipFile, ValueError, EOFError) as error:
            raise DataError(f"table {path} is not an NPZ file of plain arrays: {error}") from error
    from scipy.io import loadmat

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            data = loadmat(path)
    except NotImplementedError as error:
        raise DataError(
            f"table {path} is a MAT file of version 7.3; save it with save(..., '-v7')"
        ) from error
    except Exception as error:  # SciPy raises many kinds on a damaged file
        raise DataError(f"table {path} is not a MAT file: {error}") from error
    return {key: np.asarray(value) for key, value in data.items() if not key.startswith("__")}


def _arrays(path: Path, array: str, columns: Sequence[str], run: str) -> ForeignTable:
    data = _load(path)
    if not data:
        raise DataError(f"table {path} holds no arrays")
    records = {key: fields for key, value in data.items() if (fields := _fields(value))}
    if array in records:
        return _named(path, records[array], array)
    if array or columns:
        name = array or _choose(path, _runs(data, columns), run, len(columns))
        return _matrix(path, data, name, columns)
    if len(records) > 1 or (run and records):
        name = _choose(path, list(records), run)
        return _named(path, records[name], name)
    if run:
        raise DataError(
            f"table {path}: --run {run!r}, but no runs are declared; "
            "name the columns of its arrays in a map: [table] columns = [...]"
        )
    inner = next(iter(records.values()), {})
    return _named(path, {**inner, **{k: v for k, v in data.items() if k not in records}}, path.stem)


def _named(path: Path, data: Mapping[str, NDArray[Any]], run: str) -> ForeignTable:
    found = _by_key(data)
    if not found:
        raise DataError(f"table {path} holds no columns; it has {', '.join(data) or 'nothing'}")
    return ForeignTable(path, tuple(found), _picker(path, found), 1, run)


def _fields(value: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Fields of a structured array or of a MAT struct; empty for a plain array."""
    names = value.dtype.names or ()
    one = value.size == 1 and value.dtype.hasobject
    return {n: np.asarray(value[n].ravel()[0] if one else value[n]) for n in names}


def _choose(path: Path, runs: list[str], run: str, width: int = 0) -> str:
    if not runs:
        raise DataError(f"table {path} has no 2-D array of {width} columns")
    if not run and len(runs) > 1:
        raise DataError(
            f"table {path} holds {len(runs)} runs; choose one with --run: {', '.join(runs)}"
        )
    if run and run not in runs:
        raise DataError(f"table {path}: " + unknown("run", run, runs))
    return run or runs[0]


def _matrix(
    path: Path, data: dict[str, NDArray[Any]], name: str, columns: Sequence[str]
) -> ForeignTable:
    if name not in data:
        raise DataError(f"table {path}: " + unknown("array", name, data))
    values = data[name]
    width = values.shape[1] if values.ndim == 2 else 0
    if not width or (columns and width != len(columns)):
        want = f"(n, {len(columns)})" if columns else "two dimensions"
        raise DataError(f"table {path}: array {name!r} has shape {values.shape}; expected {want}")
    names = tuple(columns) or tuple(f"c{k + 1}" for k in range(width))
    found = {n: values[:, k] for k, n in enumerate(names)}
    return ForeignTable(path, names, _picker(path, found), 1, name)


def _by_key(data: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Columns by key: ``q`` of shape (n, d) becomes ``q1`` to ``qd``; scalars are left out."""
    out: dict[str, NDArray[Any]] = {}
    for key, value in data.items():
        flat = value.ravel() if value.ndim == 2 and 1 in value.shape else value
        if flat.ndim == 1 and flat.size > 1:
            out[key] = flat
        elif flat.ndim == 2:
            out |= {f"{key}{k + 1}": flat[:, k] for k in range(flat.shape[1])}
    return out


def _picker(
    path: Path, found: dict[str, NDArray[Any]]
) -> Callable[[Sequence[str]], dict[str, FloatArray]]:
    def pick(wanted: Sequence[str]) -> dict[str, FloatArray]:
        out: dict[str, FloatArray] = {}
        for name in wanted:
            try:
                out[name] = np.asarray(found[name]).astype(np.float64)
            except (ValueError, TypeError):
                raise DataError(
                    f"table {path}: column {name!r} is of type {found[name].dtype}; "
                    "expected numbers"
                ) from None
        return out

    return pick
