"""Arrays of a binary table (NPZ, MAT) or a ROS bag, read in a process of its own with limits.

The readers of these formats trust what a file says of itself: of a damaged one they claim any
amount of memory, and the reader of MAT files crashes.  Here they run in a process that may take
memory and time in proportion to the file; what comes back is plain numbers, checked again.

This file is both ends: `read_arrays` starts ``python -m hil.record.foreign`` on one file.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
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
#: Endings of ROS bags; a folder is one, too.
_BAGS = (".bag", ".db3", ".mcap")
#: Kinds of numbers that are handed over.
_NUMBERS = "biuf"


def allowed(size: int) -> int:
    """Bytes that the arrays of a file of so many bytes may take."""
    return ROOM + RATIO * size


def read_arrays(path: Path) -> Arrays:
    """Arrays of a NPZ or MAT file or a bag by name; what holds no real numbers has zeros.

    Raises
    ------
    DataError
        If the file is not what its name says, damaged, or claims more than its size can hold.
    OSError
        If it is not there, no regular file, or too large.
    """
    size = _size(path)
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
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
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
    out: Arrays = {}
    for name, field, kind, shape in told["arrays"]:
        array = _array(answer, np.dtype(kind), tuple(shape), most)
        most -= array.nbytes if array.dtype.kind in _NUMBERS else 0
        if field is None:
            out[name] = array
        else:
            struct = out.setdefault(name, {})
            if not isinstance(struct, dict):
                raise ValueError(f"{name!r} stands twice")
            struct[field] = array
    return out


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


def _mat(path: str, most: int) -> Iterator[tuple[str, Array]]:
    import warnings

    from scipy.io import loadmat

    warnings.simplefilter("ignore")
    for name, value in loadmat(path).items():
        if not name.startswith("__"):
            yield name, np.asarray(value)


def _parts(name: str, value: Array) -> Iterator[tuple[str, str | None, Array]]:
    """An array, or the fields of a structured array or of a MAT struct."""
    names = value.dtype.names
    if not names:
        yield name, None, value
        return
    fields: Any = value
    one = value.size == 1 and value.dtype.hasobject
    for field in names:
        yield name, field, np.asarray(fields[field].ravel()[0] if one else fields[field])


_Parts = Iterator[tuple[str, str | None, Array]]


def _npz_parts(path: str, most: int) -> _Parts:
    return (p for name, value in _npz(path, most) for p in _parts(name, value))


def _mat_parts(path: str, most: int) -> _Parts:
    return (p for name, value in _mat(path, most) for p in _parts(name, value))


def _nothing() -> None:
    """Nothing is to be loaded."""


def _load_mat() -> None:
    import scipy.io  # noqa: F401


#: By ending: what a file should be, what is loaded before memory is limited, and the reader.
_READERS: dict[str, tuple[str, Callable[[], None], Callable[[str, int], _Parts]]] = {
    ".npz": ("an NPZ file of plain arrays", _nothing, _npz_parts),
    ".mat": ("a MAT file of plain arrays", _load_mat, _mat_parts),
    **dict.fromkeys(
        _BAGS, ("a ROS bag that rosbags reads", bag_messages.prepare, bag_messages.messages)
    ),
}


def _answer(path: str) -> dict[str, Any]:
    """Read a file and write its arrays; what could not be read becomes a sentence."""
    ending = ".bag" if os.path.isdir(path) else os.path.splitext(path)[1].lower()
    kind, load, reader = _READERS[ending]
    try:
        load()
    except DataError as error:
        return {"error": str(error)}
    most = allowed(_size(Path(path)))
    _limit(most)
    try:
        parts = list(reader(path, most))
    except DataError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": f"claims more memory than a file of its size may ({most >> 20} MiB)"}
    except NotImplementedError:
        return {"error": "is a MAT file of version 7.3; save it with save(..., '-v7')"}
    except Exception as error:  # the readers raise many kinds on a damaged file
        return {"error": f"is not {kind}: {error}"[:1000]}
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
