"""Columns of a table by name, whatever they mean: text, arrays, Parquet, sheets, data sets."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError, unknown
from hil.record.binary_tables import BINARY, Array, Arrays, read_arrays
from hil.record.readers import NUMBERS
from hil.record.text_tables import MOST_COLUMNS, PACKED, is_text, read_text_table
from hil.userfile import is_dataset

FloatArray = NDArray[np.float64]
#: Endings that tables usually have; any other text is one, too.
FORMATS = (".csv", ".tsv", ".txt", ".lvm", ".asc", *BINARY)
#: Endings of sessions and bags, which are not tables.
_NOT_TABLES = (".mcap", ".bag", ".db3")


@dataclass(frozen=True)
class ForeignTable:
    """Named columns of one file, or of what a program holds.

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
    in_memory : bool
        Whether there is no file: what to do about a fault is then an argument, not an option.
    times : mapping of str to str
        Column of the time of each column that was logged at times of its own.
    """

    path: Path
    names: tuple[str, ...]
    read: Callable[[Sequence[str]], dict[str, FloatArray]]
    first_row: int = 0
    run: str = ""
    in_memory: bool = False
    times: Mapping[str, str] = field(default_factory=dict)
    #: Cells of the first row of a text table, by column.
    first: Mapping[str, str] = field(default_factory=dict)
    #: What was read otherwise than it stands there, a sentence each.
    notes: tuple[str, ...] = ()

    def option(self, name: str, value: str) -> str:
        """What a person types, e.g. ``--unit rad``, or ``unit="rad"``."""
        return f'{name}="{value}"' if self.in_memory else f"--{name} {value}"

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


def ending(path: str | Path) -> str:
    """Ending of a file's name in small letters; of one that is packed, of what is in it."""
    name = Path(path)
    packed = name.suffix.lower() in PACKED
    return Path(name.stem if packed else name.name).suffix.lower()


def text_table(path: Path, header_row: int = 0, columns: Sequence[str] = ()) -> ForeignTable:
    """Open a text table; parameters and errors as of `read_text_table`."""
    found = read_text_table(path, header_row, columns)
    run = Path(path.stem).stem if path.suffix.lower() in PACKED else path.stem
    return ForeignTable(path, found.names, found.read, found.first_row, run, first=found.first)


def open_table(
    path: str | Path,
    array: str = "",
    columns: Sequence[str] = (),
    run: str = "",
    header_row: int = 0,
) -> ForeignTable:
    """Open a table.

    Parameters
    ----------
    path : str or Path
        Text of any ending (comma, semicolon, tab or space; header row), also packed; NPY, NPZ,
        MAT, HDF5, Parquet, Feather, XLSX or JSON file, or the folder of a LeRobot data set.
    array : str
        The 2-D array (n, k), structured array or struct of a binary file that holds the columns.
    columns : sequence of str
        Names of the columns of a 2-D array, or of text without a header row; with no `array`,
        every array of so many columns is a run.  Without `columns`, every structured array is one.
    run : str
        Run to choose.
    header_row : int
        As of `text_table`.

    Raises
    ------
    DataError
        If the file is missing, empty, of another format, or the run is not there.
    """
    path = Path(path)
    if is_dataset(path):
        return _episode(path, run)
    try:
        if path.stat().st_size == 0 and path.is_file():
            raise DataError(f"table {path} is empty (0 bytes); a header row and samples are needed")
        if path.suffix.lower() in BINARY:
            return _arrays(path, array, columns, run)
        kind = ending(path)
        _refuse_own(path, kind)
        known = kind in (".csv", ".tsv", ".txt")
        if kind in (*_NOT_TABLES, *BINARY) or not (known or is_text(path)):
            raise DataError(
                f"table {path}: format {kind!r}; expected text of any ending (also packed by gzip, "
                f"bzip2 or xz), or {', '.join(BINARY)}{_unpack(path)}"
            )
        if run:
            raise DataError(f"table {path}: a text table holds one run; leave --run {run!r} out")
        return text_table(path, header_row, columns)
    except OSError as error:
        raise DataError(f"table {path}: {error.strerror or error}") from error


#: Files of the program by what their schema says, and what to do with them.
_OWN = {
    "rig": "a rig file: 'hil run {} -o SESSION.mcap' records a session of it",
    "model": "a model file: give it with --model, beside a recording",
    "map": "a map file: give it with --map, beside a table",
    "trajectory": "a motion: give it to 'hil run' with --trajectory",
}
_SCHEMA = re.compile(rb'^schema[ \t]*=[ \t]*"hil\.([a-z]+)/', re.MULTILINE)


def _refuse_own(path: Path, kind: str) -> None:
    """Refuse files that the program knows as something else, and descriptions of robots."""
    what = ""
    if kind == ".mcap":
        what = f"a session already (or a damaged one): 'hil info {path}' shows it"
    elif path.is_file():
        with path.open("rb") as file:
            head = file.read(4096)
        if found := _SCHEMA.search(head):
            what = _OWN.get(found[1].decode(), "a file of the program").format(path)
        elif head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"<?xml", b"<!--", b"<robot")):
            what = "XML, as a robot's description: give that with --robot, beside a recording"
    if what:
        raise DataError(f"{path} is no table, it is {what}")


def _unpack(path: Path) -> str:
    """What to do about a packed file that holds no text."""
    return "; unpack the file first" if path.suffix.lower() in PACKED else ""


def run_names(path: str | Path, columns: Sequence[str] = ()) -> list[str]:
    """Names of the runs of a binary table, or of the episodes of a LeRobot data set.

    They are its 2-D arrays of so many columns; without `columns`, its structured arrays.

    Raises
    ------
    DataError
        If the file cannot be read.
    """
    if is_dataset(Path(path)):
        return list(_episodes(Path(path)))
    if Path(path).suffix.lower() not in BINARY:
        return []
    data = _load(Path(path))
    return _runs(data, columns) if columns else [k for k, v in data.items() if isinstance(v, dict)]


def _runs(data: Arrays, columns: Sequence[str]) -> list[str]:
    wide = len(columns)
    plain, _ = _upright(_plain(data), wide)
    return [k for k, v in plain.items() if columns and v.ndim == 2 and v.shape[1] == wide]


def _upright(data: Mapping[str, Array], wide: int = 0) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Arrays with a sample a row, and what is said of those that have a sample a column.

    The arrays of one recording agree in its length.  With `wide`, an array has so many columns.
    """
    lengths = {k: max(v.shape) for k, v in data.items() if v.ndim in (1, 2) and v.size > 1}
    longest = max(lengths.values(), default=0)
    alone = sum(n == longest for n in lengths.values()) < min(2, len(lengths))
    flat = {k: v for k, v in data.items() if v.ndim == 2 and min(v.shape) > 1}
    lying = [k for k, v in flat.items() if v.shape[0] < v.shape[1] == longest]
    if wide:
        lying = [k for k in lying if data[k].shape[0] == wide]
    elif alone or any(v.shape[0] == longest for v in flat.values()):
        lying = []
    shapes = ", ".join("{} ({} x {})".format(k, *data[k].shape) for k in lying)
    said = (f"read with rows and columns exchanged, a sample is a column: {shapes}",)
    return {k: v.T if k in lying else v for k, v in data.items()}, said if lying else ()


def _plain(data: Arrays) -> dict[str, Array]:
    return {k: v for k, v in data.items() if not isinstance(v, dict)}


def _load(path: Path) -> Arrays:
    return _load_once(path, path.stat().st_mtime_ns)


@functools.lru_cache(maxsize=1)  # a file of many runs is read once for all of them
def _load_once(path: Path, _: int) -> Arrays:
    return _by_run(read_arrays(path))


#: Last words of names that say what a run is for, where runs have the same length.
_FOR = frozenset("train training test testing val valid validation est estimation ident".split())


def _by_run(data: Arrays) -> Arrays:
    """Arrays of several runs by run: ``y_train`` and ``y_test`` are ``y`` of *train* and *test*.

    So it is where every array has such an ending, every run has the same arrays, all of one length,
    and the lengths differ from run to run or the endings say what the runs are for.
    """
    series = {k: v for k, v in _plain(data).items() if v.ndim in (1, 2) and v.size > 1}
    if len(series) < 4 or len(_plain(data)) < len(data):
        return data
    runs: dict[str, dict[str, Array]] = {}
    for name, values in series.items():
        head, cut, run = name.rpartition("_")
        if not (head and cut and run):
            return data
        runs.setdefault(run, {})[head] = values
    lengths = [{max(v.shape) for v in run.values()} for run in runs.values()]
    whole = all(len(n) == 1 for n in lengths) and len(set(map(frozenset, runs.values()))) == 1
    apart = len(set().union(*lengths)) == len(runs) or {r.lower() for r in runs} <= _FOR
    return dict(runs) if len(runs) > 1 and whole and apart else data


def _arrays(path: Path, array: str, columns: Sequence[str], run: str) -> ForeignTable:
    data = _load(path)
    if not data:
        raise DataError(f"table {path} holds no arrays")
    records = {key: value for key, value in data.items() if isinstance(value, dict)}
    if any(_times(value) for value in records.values()):  # signals with times, not runs
        flat = {f"{key}.{n}": v for key, value in records.items() for n, v in value.items()}
        return _named(path, {**flat, **_plain(data)}, path.stem)
    if array in records:
        return _named(path, records[array], array)
    if array or columns:
        name = array or _choose(path, _runs(data, columns), run, _lacks(data, len(columns)))
        return _matrix(path, _plain(data), name, columns)
    if len(records) > 1 or (run and records):
        filled = [key for key, value in records.items() if _of_samples(value)]
        only = filled[0] if len(filled) == 1 else ""
        name = run or only or _choose(path, list(records), run)
        found = _named(path, records[_choose(path, list(records), name)], name)
        left = ", ".join(k for k in records if k != name)
        said = () if run or not only else (f"read is {name!r}; no samples are in {left}",)
        return replace(found, notes=(*found.notes, *said))
    if run:
        raise DataError(
            f"table {path}: --run {run!r}, but no runs are declared; "
            "name the columns of its arrays in a map: [table] columns = [...]"
        )
    inner = next(iter(records.values()), {})
    return _named(path, {**inner, **_plain(data)}, path.stem)


def _of_samples(data: Mapping[str, Array]) -> bool:
    """Whether arrays can be a run: two columns of numbers; a sheet of notes has none."""
    return sum(v.dtype.kind in NUMBERS and v.size > 1 for v in data.values()) > 1


def _named(path: Path, data: Mapping[str, Array], run: str) -> ForeignTable:
    data, said = _upright(data)
    found = _by_key(path, data)
    if not found:
        raise DataError(f"table {path} holds no columns; it has {', '.join(data) or 'nothing'}")
    pick = _picker(path, found)
    return ForeignTable(path, tuple(found), pick, 1, run, times=_times(found), notes=said)


#: How a logged signal calls its time, and how the last part of its values is called.
_SIGNAL = re.compile(r"(?:(?P<head>.*)\.)?(?:data|signals(?:\([0-9]+\))?\.values)[0-9]*", re.I)


def _times(data: Mapping[str, Array]) -> dict[str, str]:
    """Time of each signal that has one of its own: ``pos.Time`` of ``pos.Data``.

    So are a timeseries as a struct, and a "structure with time" (``time``, ``signals.values``).
    """
    out: dict[str, str] = {}
    for name in data:
        if found := _SIGNAL.fullmatch(name):
            head = f"{found['head']}." if found["head"] else ""
            own = [t for t in (f"{head}Time", f"{head}time") if t in data]
            if own:
                out[name] = own[0]
    return out


def _lacks(data: Arrays, width: int) -> str:
    """What a file lacks that has no array of so many columns, and what it has."""
    have = [f"{k} {v.shape}" for k, v in _plain(data).items()]
    return f"no 2-D array of {width} columns, as the map names them; it has {', '.join(have)}"


def _choose(path: Path, runs: list[str], run: str, lacks: str = "no runs") -> str:
    if not runs:
        raise DataError(f"table {path} has {lacks}")
    if not run and len(runs) > 1:
        raise DataError(
            f"table {path} holds {len(runs)} runs; choose one with --run: {', '.join(runs)}"
        )
    if run and run not in runs:
        raise DataError(f"table {path}: " + unknown("run", run, runs))
    return run or runs[0]


def _matrix(
    path: Path, data: Mapping[str, Array], name: str, columns: Sequence[str]
) -> ForeignTable:
    if name not in data:
        raise DataError(f"table {path}: " + unknown("array", name, data))
    data, said = _upright({name: data[name]}, len(columns))
    values = data[name]
    width = values.shape[1] if values.ndim == 2 else 0
    if not width or (columns and width != len(columns)):
        want = f"(n, {len(columns)})" if columns else "two dimensions"
        raise DataError(f"table {path}: array {name!r} has shape {values.shape}; expected {want}")
    if width > MOST_COLUMNS:
        raise _too_wide(path, name, width)
    names = tuple(columns) or tuple(f"c{k + 1}" for k in range(width))
    found = {n: values[:, k] for k, n in enumerate(names)}
    return ForeignTable(path, names, _picker(path, found), 1, name, notes=said)


def _too_wide(path: Path, name: str, width: int) -> DataError:
    return DataError(
        f"table {path}: array {name!r} has {width} columns; at most {MOST_COLUMNS} are read. Are "
        "rows and columns exchanged?"
    )


def _by_key(path: Path, data: Mapping[str, Array]) -> dict[str, Array]:
    """Columns by key: ``q`` of shape (n, d) becomes ``q1`` to ``qd``; scalars are left out."""
    out: dict[str, Array] = {}
    for key, value in data.items():
        flat = value.ravel() if value.ndim == 2 and 1 in value.shape else value
        if flat.ndim == 1 and flat.size > 1:
            out[key] = flat
        elif flat.ndim == 2:
            if len(out) + flat.shape[1] > MOST_COLUMNS:
                raise _too_wide(path, key, flat.shape[1])
            out |= {f"{key}{k + 1}": flat[:, k] for k in range(flat.shape[1])}
    return out


def _picker(
    path: Path, found: Mapping[str, Array]
) -> Callable[[Sequence[str]], dict[str, FloatArray]]:
    def pick(wanted: Sequence[str]) -> dict[str, FloatArray]:
        out: dict[str, FloatArray] = {}
        for name in wanted:
            if found[name].dtype.kind not in NUMBERS:
                raise DataError(
                    f"table {path}: column {name!r} is of type {found[name].dtype}; "
                    "expected numbers, real ones"
                )
            out[name] = found[name].astype(np.float64)
        return out

    return pick


# ------------------------------------------------------------ data sets of LeRobot


def _episodes(folder: Path) -> dict[str, tuple[Path, int]]:
    """File and number of every episode, by name."""
    out: dict[str, tuple[Path, int]] = {}
    for file in sorted((folder / "data").glob("*/*.parquet")):
        alone = re.fullmatch(r"episode_([0-9]+)", file.stem)
        if alone:
            out[file.stem] = (file, int(alone[1]))
            continue
        number = _load(file).get("episode_index")
        if isinstance(number, np.ndarray):
            out |= {f"episode_{k:06d}": (file, int(k)) for k in np.unique(number).tolist()}
    if not out:
        raise DataError(f"LeRobot data set {folder} has no episodes: no data/*/*.parquet in it")
    return out


def _episode(folder: Path, run: str) -> ForeignTable:
    """One episode as a table; lists such as ``observation.state`` are columns with numbers."""
    episodes = _episodes(folder)
    if not run and len(episodes) > 1:
        some = ", ".join(list(episodes)[:5])
        raise DataError(
            f"LeRobot data set {folder} holds {len(episodes)} episodes ({some}, ...); choose one "
            f"with --run, or make a session of each: hil import {folder} --all-runs -o SESSIONS"
        )
    # its number stands for its name
    called = (n for n, (_, k) in episodes.items() if run.isdecimal() and k == int(run))
    name = next(called, run) or next(iter(episodes))
    if name not in episodes:
        raise DataError(f"LeRobot data set {folder}: " + unknown("episode", name, episodes))
    file, number = episodes[name]
    data = _plain(_load(file))
    index = data.get("episode_index")
    if index is not None:
        mine = np.asarray(index) == number
        data = {key: value[mine] for key, value in data.items() if value.shape[:1] == mine.shape}
    return _named(folder / file.name, data, name)
