"""Arrays of a binary table (NPY to HDF5) or a ROS bag, read in a process with limits.

The readers of these formats trust what a file says of itself: of a damaged one they claim any
amount of memory, and the reader of MAT files crashes.  Here they run in a process that may take
memory and time in proportion to the file; what comes back is plain numbers, checked again.

This file is both ends: `read_arrays` starts ``python -m hil.record.foreign`` on one file.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
import json
import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import UTC, datetime, time, timedelta
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError
from hil.record import bag_messages
from hil.userfile import open_regular

Array = NDArray[np.generic]
#: What a file of arrays holds: arrays, and structs of arrays, by name.
Arrays = dict[str, "Array | dict[str, Array]"]
#: Largest file [byte]; and what its arrays may take: a sum, and so many times the file.
LARGEST = 2**33
ROOM, RATIO = 2**26, 64
#: Arrays in a file, and bytes of what is told of them.
MOST_ARRAYS, LARGEST_HEAD = 4096, 2**22
#: Working memory of a reader, in multiples of what the arrays may take.
WORKING = 3
#: Time for a file [s], and bytes a second beyond that.
PATIENCE_S, SPEED = 20.0, 2e6
#: The reader; a file of its name in the working directory is not run.
_WORDS = (sys.executable, "-P", "-m", "hil.record.foreign")
#: Threads, and heaps of threads, take address space, which is limited.
_SPARING = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"}
#: Endings of ROS bags; a folder is one, too.
_BAGS = (".bag", ".db3", ".mcap")
#: Kinds of numbers that are handed over.
_NUMBERS = "biuf"


def allowed(size: int) -> int:
    """Bytes that the arrays of a file of so many bytes may take."""
    return ROOM + RATIO * size


def read_arrays(path: Path) -> Arrays:
    """Arrays of a table or a bag by name; what holds no real numbers has its type, and zeros.

    Raises
    ------
    DataError
        If the file is not what its name says, damaged, or claims more than its size can hold.
    OSError
        If it is not there, no regular file, or too large.
    """
    size = _size(path)
    if _here:
        told = _answer(str(path), limited=False)
        if "error" in told:
            raise DataError(f"{path} {told['error']}")
        return _named(told["parts"])
    what = "bag" if path.is_dir() or path.suffix.lower() in _BAGS else "table"
    with tempfile.TemporaryFile() as answer:
        words = [*_WORDS, str(path.resolve())]
        seconds = PATIENCE_S + size / SPEED
        try:
            done = subprocess.run(
                words,
                stdin=subprocess.DEVNULL,
                stdout=answer,
                stderr=subprocess.DEVNULL,
                timeout=seconds,
                check=False,
                env={**os.environ, **_SPARING},
                start_new_session=True,  # Ctrl-C is for the process that waits here
            )
        except subprocess.TimeoutExpired:
            raise DataError(
                f"{what} {path} was not read within {seconds:.0f} s; it is damaged, or export it "
                "as CSV"
            ) from None
        answer.seek(0)
        try:
            return _received(answer, allowed(size))
        except DataError as error:
            raise DataError(f"{what} {path} {error}") from None
        except ValueError as error:
            how = f"signal {-done.returncode}" if done.returncode < 0 else str(error)
            raise DataError(
                f"{what} {path} cannot be read: the reader of {path.suffix} files failed on it "
                f"({how}); it is damaged: export it again, or as CSV"
            ) from None


#: Whether files are read in this process; not empty within `reading_here`.
_here: list[bool] = []


@contextlib.contextmanager
def reading_here() -> Iterator[None]:
    """Read within without a process of its own, for a fuzzer that has limits itself."""
    _here.append(True)
    try:
        yield
    finally:
        _here.pop()


def _named(parts: Iterable[tuple[str, str | None, Array]]) -> Arrays:
    """Arrays by name; fields of one name make a struct.  `ValueError` if a name stands twice."""
    out: Arrays = {}
    for name, field, array in parts:
        if field is None:
            out[name] = array
            continue
        struct = out.setdefault(name, {})
        if not isinstance(struct, dict):
            raise ValueError(f"{name!r} stands twice")
        struct[field] = array
    return out


def _size(path: Path) -> int:
    """Bytes of a file, or of the files of a bag's folder, each a regular one."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    total = 0
    for one in files:
        if one is path or one.suffix.lower() in (".yaml", *_BAGS):
            with open_regular(one, LARGEST) as file:
                total += os.fstat(file.fileno()).st_size
    return total


def _received(answer: IO[bytes], most: int) -> Arrays:
    """Arrays that a reader has written; `ValueError` if it did not come to an end."""
    head = answer.read(8)
    size = int.from_bytes(head, "little")
    if len(head) < 8 or size > LARGEST_HEAD:
        raise ValueError("it wrote nothing")
    told = json.loads(answer.read(size))
    if "error" in told:
        raise DataError(str(told["error"]))
    parts = []
    for name, field, kind, shape in told["arrays"]:
        array = _array(answer, np.dtype(kind), tuple(shape), most)
        most -= array.nbytes if array.dtype.kind in _NUMBERS else 0
        parts.append((name, field, array))
    return _named(parts)


def _array(answer: IO[bytes], kind: np.dtype[Any], shape: tuple[int, ...], most: int) -> Array:
    if kind.kind not in _NUMBERS:
        return np.broadcast_to(np.zeros((), kind), shape)
    size = math.prod(shape) * kind.itemsize
    if min(shape, default=0) < 0 or size > most:
        raise ValueError("it wrote too much")
    data = answer.read(size)
    if len(data) < size:
        raise ValueError("it wrote too little")
    return np.frombuffer(data, kind).reshape(shape)


# ------------------------------------------------------------ within the process


def _limit(most: int) -> None:
    """Let this process take so much memory beyond what it has, and write no file but its answer."""
    import resource

    with open("/proc/self/statm", "rb") as file:
        now = int(file.read().split()[0]) * resource.getpagesize()
    memory = now + ROOM + WORKING * most
    for what, value in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, most + LARGEST_HEAD + 8),
        (resource.RLIMIT_CPU, int(PATIENCE_S + most / SPEED)),
    ):
        hard = resource.getrlimit(what)[1]
        least = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(what, (least, hard))


def _npz(path: str, most: int) -> Iterator[tuple[str, Array]]:
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


def _npy(path: str, most: int) -> Iterator[tuple[str, Array]]:
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


def _mat(path: str, most: int) -> Iterator[tuple[str, Array]]:
    import warnings

    from scipy.io import loadmat

    warnings.simplefilter("ignore")
    for name, value in loadmat(path).items():
        if not name.startswith("__"):
            yield name, np.asarray(value)


def _parquet(path: str, most: int) -> Iterator[tuple[str, Array]]:
    from pyarrow import parquet

    file = parquet.ParquetFile(path, memory_map=True)
    head = file.metadata
    if head.num_columns > MOST_ARRAYS:
        raise DataError(f"holds {head.num_columns} arrays; at most {MOST_ARRAYS} are read")
    sizes = (head.row_group(k).total_byte_size for k in range(head.num_row_groups))
    if (total := sum(sizes)) > most:
        raise DataError(
            f"claims {total / 2**20:.4g} MiB; a file of its size may hold {most / 2**20:.4g} MiB"
        )
    yield from _arrow(file.read(use_threads=False))


def _feather(path: str, most: int) -> Iterator[tuple[str, Array]]:
    from pyarrow import feather

    yield from _arrow(feather.read_table(path, use_threads=False))


def _arrow(table: Any) -> Iterator[tuple[str, Array]]:
    """Columns of an Arrow table; lists of one length become (n, k), times seconds since 1970."""
    for name, column in zip(table.column_names, table.columns, strict=True):
        yield name, _arrow_column(column.combine_chunks(), table.num_rows)


def _arrow_column(column: Any, n: int) -> Array:
    import pyarrow as pa

    kind = column.type
    if pa.types.is_timestamp(kind):
        whole = column.cast(pa.timestamp("ns", kind.tz), safe=False).cast(pa.int64())
        return np.asarray(whole.to_numpy(zero_copy_only=False)) / 1e9
    listed = pa.types.is_list(kind) or pa.types.is_large_list(kind)
    if (listed or pa.types.is_fixed_size_list(kind)) and n and not column.null_count:
        flat = _arrow_column(column.flatten(), len(column.flatten()))
        if flat.ndim == 1 and flat.size % n == 0 and flat.dtype.kind in _NUMBERS:
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


def _xlsx(path: str, most: int) -> Iterator[tuple[str, Array]]:
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
    from hil.record.guess import with_units

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


#: Ending -> name of the reader here, what a file of it is called, module that the reader needs.
_READERS: dict[str, tuple[str, str, str]] = {
    ".npz": ("_npz", "an NPZ", ""),
    ".npy": ("_npy", "an NPY", ""),
    ".mat": ("_mat", "a MAT", "scipy.io"),
    ".parquet": ("_parquet", "a Parquet", "pyarrow.parquet"),
    ".pq": ("_parquet", "a Parquet", "pyarrow.parquet"),
    ".feather": ("_feather", "a Feather", "pyarrow.feather"),
    ".arrow": ("_feather", "an Arrow", "pyarrow.feather"),
    ".xlsx": ("_xlsx", "an XLSX", "openpyxl"),
    ".h5": ("_hdf5", "an HDF5", "h5py"),
    ".hdf5": ("_hdf5", "an HDF5", "h5py"),
}
#: Endings of binary tables.
BINARY = tuple(_READERS)


def _parts(name: str, value: Array) -> Iterator[tuple[str, str | None, Array]]:
    """An array, or the fields of a structured array or of a MAT struct."""
    names = value.dtype.names
    if not names:
        yield name, None, value
        return
    fields: Any = value
    one = value.size == 1 and value.dtype.hasobject
    for field in names:
        inner = np.asarray(fields[field].ravel()[0] if one else fields[field])
        yield from ((name, *part) for part in _within(field, inner, DEEPEST))


#: Structs within structs of a MAT file that are looked into, and of a list of them so many.
DEEPEST, MOST_LISTED = 6, 99


def _within(path: str, value: Array, deeper: int) -> Iterator[tuple[str, Array]]:
    """A field of a struct, or by dotted path the fields of the structs in it."""
    names = value.dtype.names
    if not names or not value.dtype.hasobject or not deeper or value.size > MOST_LISTED:
        if value.ndim == 3 and value.shape[2] > 1 and value.dtype.kind in _NUMBERS:
            value = value.reshape(-1, value.shape[2]).T  # a sample a page, as Simulink logs it
        yield path, value
        return
    fields: Any = value
    for k in range(value.size):
        own = path if value.size == 1 else f"{path}({k + 1})"
        for name in names:
            inner = np.asarray(fields[name].ravel()[k])
            yield from _within(f"{own}.{name}", inner, deeper - 1)


#: First bytes of HDF5, and where they may stand: a MAT file of version 7.3 has 512 bytes before.
_HDF5, _STARTS = b"\x89HDF\r\n\x1a\n", (0, 512)


def _is_hdf5(path: str) -> bool:
    """Whether a file holds HDF5, whatever it is called."""
    try:
        with open_regular(path, LARGEST) as file:
            start = file.read(_STARTS[-1] + len(_HDF5))
    except OSError:
        return False
    return any(start[at : at + len(_HDF5)] == _HDF5 for at in _STARTS)


def _hdf5(path: str, most: int) -> Iterator[tuple[str, Array]]:
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
            text = matlab and x.attrs.get("MATLAB_class", b"double") in (b"char", b"cell")
            if x.dtype.kind not in _NUMBERS + "V" or text:
                yield path + name, np.broadcast_to(np.zeros((), object), x.shape)
                continue
            room[0] -= int(x.size) * x.dtype.itemsize
            if room[0] < 0:
                raise MemoryError
            value = np.asarray(x[()])
            yield path + name, value.T if matlab else value


def _bag(path: str, most: int) -> Iterator[tuple[str, str | None, Array]]:
    """Messages of a ROS bag."""
    return bag_messages.messages(path, most)


def _reader(path: str) -> tuple[str, str, str]:
    """Name of the reader, what the file is called, and what it needs; a folder is a bag."""
    ending = os.path.splitext(path)[1].lower()
    if os.path.isdir(path) or ending in _BAGS:
        return ("_bag", "a ROS bag", "rosbags")
    if ending == ".mat" and _is_hdf5(path):
        return ("_hdf5", "a MAT (version 7.3)", "h5py")
    return _READERS[ending]


def _answer(path: str, limited: bool = True) -> dict[str, Any]:
    """Read a file and write its arrays; what could not be read becomes a sentence."""
    name, kind, needed = _reader(path)
    reader: Callable[[str, int], Iterator[Any]] = globals()[name]
    bag = name == "_bag"
    try:
        if bag:
            bag_messages.prepare()
        elif needed:
            importlib.import_module(needed)  # before memory is limited
    except DataError as error:
        return {"error": str(error)}
    except ImportError:
        return {
            "error": f"is {kind} file, which needs {needed.partition('.')[0]}: "
            "pip install 'hil-teleop[tables]'"
        }
    if needed.startswith("pyarrow"):
        import pyarrow

        pyarrow.set_memory_pool(pyarrow.system_memory_pool())
        pyarrow.set_cpu_count(1)
        pyarrow.set_io_thread_count(1)  # a thread takes address space, which is limited
    most = allowed(_size(Path(path)))
    if limited:
        _limit(most)
    try:
        found = reader(path, most)
        parts = list(found) if bag else [p for n, value in found for p in _parts(n, value)]
    except DataError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": f"claims more memory than a file of its size may ({most >> 20} MiB)"}
    except Exception as error:  # the readers raise many kinds on a damaged file
        what = (
            "is not a ROS bag that rosbags reads" if bag else f"is not {kind} file of plain arrays"
        )
        return {"error": f"{what}: {error}"[:1000]}
    if len(parts) > MOST_ARRAYS:
        return {"error": f"holds {len(parts)} arrays; at most {MOST_ARRAYS} are read"}
    return {"parts": parts}


def main(path: str) -> int:
    """Write the arrays of a file on the standard output: what there is, then the numbers."""
    out = sys.stdout.buffer
    told = _answer(path)
    parts: list[tuple[str, str | None, Array]] = told.pop("parts", [])
    arrays = [
        (n, f, _native(a.dtype) if a.dtype.kind in _NUMBERS else _other(a.dtype), a.shape)
        for n, f, a in parts
    ]
    head = json.dumps(told or {"arrays": arrays}).encode()
    out.write(len(head).to_bytes(8, "little") + head)
    for (_, _, kind, _), (_, _, a) in zip(arrays, parts, strict=True):
        if a.dtype.kind in _NUMBERS:
            out.write(np.ascontiguousarray(a, np.dtype(kind)).tobytes())
    out.flush()
    return 0


def _native(kind: np.dtype[Any]) -> str:
    """Name of a number type in this machine's byte order."""
    return kind.newbyteorder("=").str


def _other(kind: np.dtype[Any]) -> str:
    """Type that stands for one that holds no real numbers."""
    return {"c": "complex128", "O": "object", "U": "U1", "S": "S1"}.get(kind.kind, "V1")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
