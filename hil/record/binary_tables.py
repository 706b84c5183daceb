"""Arrays of a binary table (NPY to HDF5), JSON or a ROS bag, read in a process with limits.

The readers of these formats trust what a file says of itself: of a damaged one they claim any
amount of memory, and the reader of MAT files crashes.  Here they run in a process that may take
memory and time in proportion to the file; what comes back is plain numbers, checked again.

This file is both ends: `read_arrays` starts ``python -m hil.record.binary_tables`` on one file.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError
from hil.record import bag_messages
from hil.record.readers import DEEPEST, MOST_ARRAYS, NUMBERS
from hil.userfile import open_regular

Array = NDArray[np.generic]
#: What a file of arrays holds: arrays, and structs of arrays, by name.
Arrays = dict[str, "Array | dict[str, Array]"]
#: Largest file [byte]; and what its arrays may take: a sum, and so many times the file.
LARGEST = 2**33
ROOM, RATIO = 2**26, 64
#: Bytes of what is told of the arrays of a file.
LARGEST_HEAD = 2**22
#: Working memory of a reader, in multiples of what the arrays may take.
WORKING = 3
#: Time for a file [s], and bytes a second beyond that.
PATIENCE_S, SPEED = 20.0, 2e6
#: The reader; a file of its name in the working directory is not run.
_WORDS = (sys.executable, "-P", "-m", "hil.record.binary_tables")
#: Threads, and heaps of threads, take address space, which is limited.
_SPARING = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"}
#: Endings of ROS bags; a folder is one, too.
_BAGS = (".bag", ".db3", ".mcap")
_BAG = "hil.record.bag_messages:messages"


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
        most -= array.nbytes if array.dtype.kind in NUMBERS else 0
        parts.append((name, field, array))
    return _named(parts)


def _array(answer: IO[bytes], kind: np.dtype[Any], shape: tuple[int, ...], most: int) -> Array:
    if kind.kind not in NUMBERS:
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


#: Ending -> its reader, what a file of it is called, library that the reader needs.
READERS: dict[str, tuple[str, str, str]] = {
    ".npz": ("hil.record.readers:npz", "an NPZ", ""),
    ".npy": ("hil.record.readers:npy", "an NPY", ""),
    ".mat": ("hil.record.readers:mat", "a MAT", "scipy.io"),
    ".parquet": ("hil.record.readers:parquet", "a Parquet", "pyarrow.parquet"),
    ".pq": ("hil.record.readers:parquet", "a Parquet", "pyarrow.parquet"),
    ".feather": ("hil.record.readers:feather", "a Feather", "pyarrow.feather"),
    ".arrow": ("hil.record.readers:feather", "an Arrow", "pyarrow.feather"),
    ".xlsx": ("hil.record.readers:xlsx", "an XLSX", "openpyxl"),
    ".h5": ("hil.record.readers:hdf5", "an HDF5", "h5py"),
    ".hdf5": ("hil.record.readers:hdf5", "an HDF5", "h5py"),
    ".json": ("hil.record.readers:json_table", "a JSON", ""),
    ".jsonl": ("hil.record.readers:json_table", "a JSON", ""),
    ".ndjson": ("hil.record.readers:json_table", "a JSON", ""),
}
#: Endings of tables that are read in a process of their own.
BINARY = tuple(READERS)


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


#: Structs of a list of them that are looked into.
MOST_LISTED = 99


def _within(path: str, value: Array, deeper: int) -> Iterator[tuple[str, Array]]:
    """A field of a struct, or by dotted path the fields of the structs in it."""
    names = value.dtype.names
    if not names or not value.dtype.hasobject or not deeper or value.size > MOST_LISTED:
        if value.ndim == 3 and value.shape[2] > 1 and value.dtype.kind in NUMBERS:
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


def _reader(path: str) -> tuple[str, str, str]:
    """Place of the reader, what the file is called, and what it needs; a folder is a bag."""
    ending = os.path.splitext(path)[1].lower()
    if os.path.isdir(path) or ending in _BAGS:
        return (_BAG, "a ROS bag", "rosbags")
    if ending == ".mat" and _is_hdf5(path):
        return (READERS[".h5"][0], "a MAT (version 7.3)", "h5py")
    return READERS[ending]


def _answer(path: str, limited: bool = True) -> dict[str, Any]:
    """Read a file and write its arrays; what could not be read becomes a sentence."""
    place, kind, needed = _reader(path)
    module, _, name = place.partition(":")
    reader: Callable[[str, int], Iterator[Any]] = getattr(importlib.import_module(module), name)
    bag = place == _BAG
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
        (n, f, _native(a.dtype) if a.dtype.kind in NUMBERS else _other(a.dtype), a.shape)
        for n, f, a in parts
    ]
    head = json.dumps(told or {"arrays": arrays}).encode()
    out.write(len(head).to_bytes(8, "little") + head)
    for (_, _, kind, _), (_, _, a) in zip(arrays, parts, strict=True):
        if a.dtype.kind in NUMBERS:
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
