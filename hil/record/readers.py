"""Readers of binary tables and of JSON: each gives the arrays of one file, by name.

They run in the process of `hil.record.binary_tables`, which limits memory and time; each takes the
path and the bytes that its arrays may take.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError
from hil.record.guess import with_units

Array = NDArray[np.generic]
#: Arrays in a file.
MOST_ARRAYS = 4096
#: Structs within structs that are looked into.
DEEPEST = 6
#: Kinds of numbers that are handed over.
NUMBERS = "biuf"


def npz(path: str, most: int) -> Iterator[tuple[str, Array]]:
    """Members of a NPZ file that are arrays; every claim is looked at before memory is taken."""
    import zipfile

    with zipfile.ZipFile(path) as box:
        members = [m for m in box.infolist() if m.filename.endswith(".npy")]
        if not members:
            raise DataError("holds no arrays")
        if len(members) > MOST_ARRAYS:
            raise DataError(f"holds {len(members)} arrays; at most {MOST_ARRAYS} are read")
        total = sum(m.file_size for m in members)
        if total > most:
            raise DataError(
                f"claims {total / 2**20:.4g} MiB of arrays; a file of its size may hold "
                f"{most / 2**20:.4g} MiB"
            )
        for member in members:
            name = member.filename.removesuffix(".npy")
            with box.open(member) as file:
                version = np.lib.format.read_magic(file)
                old = version == (1, 0)
                read = np.lib.format.read_array_header_1_0
                read = read if old else np.lib.format.read_array_header_2_0
                shape, _, kind = read(file)
            if kind.hasobject:  # they would be pickled, which is never read
                yield name, np.broadcast_to(np.zeros((), object), shape)
                continue
            claimed = math.prod(shape) * kind.itemsize
            if claimed > member.file_size or min(shape, default=0) < 0:
                raise DataError(f"array {name!r} claims {claimed} bytes and has {member.file_size}")
            with box.open(member) as file:
                yield name, np.lib.format.read_array(file, allow_pickle=False)


def npy(path: str, most: int) -> Iterator[tuple[str, Array]]:
    """The array of an NPY file, by the name of the file."""
    try:
        yield Path(path).stem, np.load(path, mmap_mode="r", allow_pickle=False)
    except ValueError as error:
        with open(path, "rb") as file:
            other = file.read(6) != np.lib.format.MAGIC_PREFIX
        if other or not re.search("pickle|Python objects", str(error)):
            raise
        raise DataError(
            "holds Python objects, which are never read: save an array of numbers, "
            "e.g. np.save(file, array.astype(float))"
        ) from None


def mat(path: str, most: int) -> Iterator[tuple[str, Array]]:
    """Variables of a MAT file before version 7.3."""
    import warnings

    from scipy.io import loadmat

    warnings.simplefilter("ignore")
    for name, value in loadmat(path).items():
        if not name.startswith("__"):
            yield name, np.asarray(value)


def parquet(path: str, most: int) -> Iterator[tuple[str, Array]]:
    """Columns of a Parquet file."""
    from pyarrow import parquet as library

    file = library.ParquetFile(path, memory_map=True)
    head = file.metadata
    if head.num_columns > MOST_ARRAYS:
        raise DataError(f"holds {head.num_columns} arrays; at most {MOST_ARRAYS} are read")
    sizes = (head.row_group(k).total_byte_size for k in range(head.num_row_groups))
    if (total := sum(sizes)) > most:
        raise DataError(
            f"claims {total / 2**20:.4g} MiB; a file of its size may hold {most / 2**20:.4g} MiB"
        )
    yield from _arrow(file.read(use_threads=False))


def feather(path: str, most: int) -> Iterator[tuple[str, Array]]:
    """Columns of a Feather or Arrow file."""
    from pyarrow import feather as library

    yield from _arrow(library.read_table(path, use_threads=False))


def _arrow(table: Any) -> Iterator[tuple[str, Array]]:
    """Columns of an Arrow table; lists of one length become (n, k), times seconds since 1970."""
    for name, column in zip(table.column_names, table.columns, strict=True):
        yield name, _arrow_column(column.combine_chunks(), table.num_rows)


#: Units of times of Arrow [s].
_TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def _arrow_column(column: Any, n: int) -> Array:
    import pyarrow as pa

    kind = column.type
    if pa.types.is_timestamp(kind):
        whole = column.cast(pa.timestamp("ns", kind.tz), safe=False).cast(pa.int64())
        return np.asarray(whole.to_numpy(zero_copy_only=False)) / 1e9
    if pa.types.is_duration(kind) or pa.types.is_time(kind):  # a span, or of day
        ticks = column.cast(pa.int32() if kind.bit_width == 32 else pa.int64()).cast(pa.float64())
        return np.asarray(ticks.to_numpy(zero_copy_only=False)) * _TICKS[kind.unit]
    listed = pa.types.is_list(kind) or pa.types.is_large_list(kind)
    if (listed or pa.types.is_fixed_size_list(kind)) and n and not column.null_count:
        flat = _arrow_column(column.flatten(), len(column.flatten()))
        if flat.ndim == 1 and flat.size % n == 0 and flat.dtype.kind in NUMBERS:
            lengths = np.asarray(column.value_lengths()) if not _fixed(kind) else np.zeros(1)
            if np.ptp(lengths) == 0:
                return flat.reshape(n, -1)
    number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
    if not number:
        return np.broadcast_to(np.zeros((), object), (n,))
    if column.null_count or pa.types.is_boolean(kind):
        column = column.cast(pa.float64(), safe=False)
    return np.asarray(column.to_numpy(zero_copy_only=False))


def _fixed(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_fixed_size_list(kind))


def xlsx(path: str, most: int) -> Iterator[tuple[str, Array]]:
    """Sheets whose first row names their columns; one alone is the table, several are runs."""
    from openpyxl import load_workbook

    sheets = {}
    with open(path, "rb") as file:  # opened here: a workbook that is damaged leaves its own open
        for sheet in load_workbook(file, read_only=True, data_only=True).worksheets:
            found = _sheet(sheet.iter_rows(values_only=True))
            if found:
                sheets[sheet.title] = found
    for title, found in sheets.items():
        kind = np.dtype([(n, object) for n in found])
        record = np.empty(1, kind)
        record[0] = tuple(found.values())
        yield title, record


def _sheet(rows: Iterator[tuple[Any, ...]]) -> dict[str, Array]:
    """Columns of a sheet by the names above its numbers; nothing where it has no numbers."""
    first = list(itertools.islice(rows, _ABOVE))
    names, start = _head(first)
    columns: list[list[float]] = [[] for _ in names]
    for row in itertools.chain(first[start:], rows):
        if any(x is not None for x in row):
            for k in range(len(names)):
                columns[k].append(_cell(row[k] if k < len(row) else None))
    if not any(columns):
        return {}
    return {n: np.array(c) for n, c in zip(names, columns, strict=True) if n}


#: Rows of a sheet among which its first numbers are sought.
_ABOVE = 60


def _head(rows: Sequence[tuple[Any, ...]]) -> tuple[list[str], int]:
    """Names of the columns of a sheet, and the first row behind them.

    They stand in the row above the numbers, or above their units; before them may stand titles.
    """
    numbers = [_numbers_in(row) for row in rows]
    pairs = enumerate(itertools.pairwise(numbers))
    at = next((k for k, (one, two) in pairs if one > 1 and two > 1), 0)
    filled = [k for k in range(at) if any(x is not None for x in rows[k])]
    if not filled:
        return [_word(x) for x in rows[0]] if rows else [], 1
    names = [_word(x) for x in rows[filled[-1]]]
    above = [_word(x) for x in rows[filled[-2]]] if len(filled) > 1 else []
    if above and (units := with_units(above, names)):
        return list(units), at
    return names, at


def _numbers_in(row: tuple[Any, ...]) -> int:
    """How many cells of a row are numbers or times, where no other cell is words."""
    cells = [x for x in row if x is not None and _word(x)]
    values = [x for x in cells if not isinstance(x, str) or math.isfinite(_cell(x))]
    return len(values) if len(values) == len(cells) else 0


def _word(value: Any) -> str:
    return "" if value is None else str(value).strip()


def _cell(value: Any) -> float:
    """Number of a cell; a date as seconds since 1970, a time of day since midnight, else NaN."""
    if isinstance(value, datetime):
        return (value if value.tzinfo else value.replace(tzinfo=UTC)).timestamp()
    if isinstance(value, timedelta):
        return value.total_seconds()
    if isinstance(value, time):  # of day
        return timedelta(
            hours=value.hour,
            minutes=value.minute,
            seconds=value.second,
            microseconds=value.microsecond,
        ).total_seconds()
    if isinstance(value, bool | int | float):
        return float(value)
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def hdf5(path: str, most: int) -> Iterator[tuple[str, Array]]:
    """Data sets of an HDF5 file; groups of the same data sets beside each other are runs.

    Links to other places are not followed.  MATLAB writes its arrays transposed, structs as groups.
    """
    import h5py

    with h5py.File(path, "r") as file:
        matlab = any("MATLAB_class" in x.attrs for x in _children(file).values())
        top: Any = file
        within = _children(top)
        while len(within) == 1 and isinstance(only := next(iter(within.values())), h5py.Group):
            top, within = only, _children(only)
        room = [most]
        groups = {n: x for n, x in within.items() if isinstance(x, h5py.Group)}
        alike = len({frozenset(_children(x)) for x in groups.values()}) == 1
        runs = groups if len(groups) > 1 and (alike or matlab) else {}
        for name, group in runs.items():
            found = dict(_datasets(group, "", matlab, room, DEEPEST))
            record = np.empty(1, np.dtype([(n, object) for n in found]))
            record[0] = tuple(found.values())
            yield name, record
        for name, x in within.items():
            if name not in runs:
                yield from _datasets({name: x}, "", matlab, room, DEEPEST)


def _children(group: Any) -> dict[str, Any]:
    """What a group holds itself; none that a link to another place or file names."""
    import h5py

    if isinstance(group, dict):
        return group
    own = [n for n in group if isinstance(group.get(n, getlink=True), h5py.HardLink)]
    return {n: group[n] for n in own if not n.startswith("#")}  # MATLAB's cells and its own


def _datasets(
    group: Any, path: str, matlab: bool, room: list[int], deeper: int
) -> Iterator[tuple[str, Array]]:
    """Data sets below a group by dotted path; `room` is what they may still take [byte]."""
    import h5py

    for name, x in _children(group).items():
        if isinstance(x, h5py.Group):
            if deeper:
                yield from _datasets(x, f"{path}{name}.", matlab, room, deeper - 1)
        elif isinstance(x, h5py.Dataset) and x.shape is not None:
            if x.external or x.is_virtual:  # its numbers stand in other files
                yield path + name, np.broadcast_to(np.zeros((), object), x.shape)
                continue
            text = matlab and x.attrs.get("MATLAB_class", b"double") in (b"char", b"cell")
            if x.dtype.kind not in NUMBERS + "V" or text:
                yield path + name, np.broadcast_to(np.zeros((), object), x.shape)
                continue
            room[0] -= int(x.size) * x.dtype.itemsize
            if room[0] < 0:
                raise MemoryError
            value = np.asarray(x[()])
            yield path + name, value.T if matlab else value


#: Longest line of JSON lines [byte].
LONGEST_LINE = 2**24


def json_table(path: str, most: int) -> Iterator[tuple[str, Array]]:
    """Samples as JSON: an object a line, a list of objects, or an object of lists.

    What stands in an object within is a column by dotted path.  Objects of the same lists beside
    each other are runs.
    """
    with open(path, encoding="utf-8-sig") as file:
        first = file.readline(LONGEST_LINE)
        try:
            json.loads(first)
            lines = bool(file.readline(1))
        except ValueError:
            lines = False
        file.seek(0)
        found = list(_json_lines(file)) if lines else json.load(file, parse_constant=float)
    if isinstance(found, dict) and not any(isinstance(x, list | dict) for x in found.values()):
        found = [found]
    if isinstance(found, list):
        yield from _columns(found).items()
        return
    if not isinstance(found, dict):
        raise DataError("holds no objects of JSON")
    runs = {n: x for n, x in found.items() if isinstance(x, dict)}
    alike = len({frozenset(x) for x in runs.values()}) == 1 and len(runs) > 1
    for name, value in found.items():
        if alike and name in runs:
            flat = dict(_flat(value, "", DEEPEST))
            record = np.empty(1, np.dtype([(n, object) for n in flat]))
            record[0] = tuple(_listed(x) for x in flat.values())
            yield name, record
        else:
            yield from ((n, _listed(x)) for n, x in _flat({name: value}, "", DEEPEST))


def _json_lines(file: Iterator[str]) -> Iterator[Any]:
    """Objects of the lines that are not blank; a last line that is cut off is left out."""
    torn = 0
    for number, line in enumerate(file, 1):
        if not line.strip():
            continue
        if torn:
            raise DataError(f"holds no JSON in line {torn}; expected an object a line")
        if len(line) > LONGEST_LINE:
            raise DataError(f"line {number}: more than {LONGEST_LINE} characters")
        try:
            yield json.loads(line, parse_constant=float)
        except ValueError:
            torn = number


def _columns(rows: Sequence[Any]) -> dict[str, Array]:
    """Columns of a list of objects; NaN where an object lacks one."""
    out: dict[str, list[Any]] = {}
    for number, row in enumerate(rows):
        if not isinstance(row, dict):
            raise DataError(f"sample {number + 1} is no object of JSON: {str(row)[:40]!r}")
        for name, value in _flat(row, "", DEEPEST):
            if name not in out:
                if len(out) == MOST_ARRAYS:
                    raise DataError(f"holds more than {MOST_ARRAYS} columns")
                out[name] = []
            column = out[name]
            column.extend([None] * (number - len(column)))
            column.append(value)
    for column in out.values():
        column.extend([None] * (len(rows) - len(column)))
    return {name: _listed(column) for name, column in out.items()}


def _flat(row: Mapping[str, Any], path: str, deeper: int) -> Iterator[tuple[str, Any]]:
    """Values of an object by dotted path."""
    for name, value in row.items():
        if isinstance(value, dict):
            if deeper:
                yield from _flat(value, f"{path}{name}.", deeper - 1)
        else:
            yield path + name, value


def _listed(column: Any) -> Array:
    """Numbers of a column (n,), or (n, k) of lists of one length; else what stands for none.

    A text that is a date and time is seconds since 1970, any other one no number.
    """
    if not isinstance(column, list):
        return np.asarray(column if isinstance(column, int | float) else None)
    wide = {len(x) for x in column if isinstance(x, list)}
    if len(wide) == 1:
        (k,) = wide
        rows = [x if isinstance(x, list) else [x] * k for x in column]
        return np.array([[_json_number(x) for x in row] for row in rows], np.float64)
    if wide or all(isinstance(x, str) and math.isnan(_json_number(x)) for x in column):
        return np.broadcast_to(np.zeros((), object), (len(column),))
    return np.array([_json_number(x) for x in column], np.float64)


def _json_number(value: Any) -> float:
    if isinstance(value, str):
        try:
            when = datetime.fromisoformat(value)
        except ValueError:
            return _cell(value)
        return _cell(when)
    return _cell(value)
