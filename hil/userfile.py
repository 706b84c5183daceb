"""A user's text file read and written without harm.

Reading bounds its size and how deep it nests; writing leaves it whole or as it was.  Every refusal
is an error that a reader of such files expects anyway: `OSError` for the file,
`tomllib.TOMLDecodeError` for what stands in it.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import stat
import tomllib
from pathlib import Path
from typing import Any, BinaryIO

#: Rig, model, map, trajectory and robot files are far below that [byte].
LARGEST_TEXT = 4 * 2**20
#: Any file that is read whole: a session, a table [byte].
LARGEST = 2**48
#: Tables within tables; the deepest of the package has five.
_DEEPEST = 32
#: What TOML promises to hold: integers of 64 bits.
LARGEST_NUMBER = 2**63
#: A key of many parts: the parser of the library takes memory with the square of their number.
_LONG_KEY = re.compile(
    r"""(?<![\w"'-])(?>[\w"'-]++[ \t]*+\.[ \t]*+){%d}""" % _DEEPEST  # noqa: UP031
)


def open_regular(path: str | Path, most: int) -> BinaryIO:
    """Open a regular file; a pipe or device is refused before it is read.

    Parameters
    ----------
    path : str or Path
        The file.
    most : int
        Largest size [byte].

    Raises
    ------
    OSError
        If it is not there, no regular file, or larger.
    """
    if "\0" in str(path):  # a file of TOML may name another so
        raise OSError(errno.EINVAL, "a name with a zero byte is no file's", str(path))
    # without O_NONBLOCK, opening a pipe waits for a writer
    number = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    state = os.fstat(number)
    if stat.S_ISREG(state.st_mode) and state.st_size <= most:
        return os.fdopen(number, "rb")
    os.close(number)
    if stat.S_ISDIR(state.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if stat.S_ISREG(state.st_mode):
        raise _too_large(path, state.st_size, most)
    raise OSError(errno.EINVAL, "it is a device or a pipe, not a regular file", str(path))


def read_bytes(path: str | Path, most: int) -> bytes:
    """Whole content of a regular file; parameters and errors as of `open_regular`."""
    with open_regular(path, most) as file:
        # the size of a file of the kernel is 0, and a file may grow while it is read
        most = min(most, max(os.fstat(file.fileno()).st_size, LARGEST_TEXT))
        data = file.read(most + 1)
    if len(data) > most:
        raise _too_large(path, len(data), most)
    return data


def _too_large(path: str | Path, size: int, most: int) -> OSError:
    text = f"it has {size / 2**20:.4g} MiB; at most {most / 2**20:.4g} MiB are read"
    return OSError(errno.EFBIG, text, str(path))


def read_text(path: str | Path, most: int = LARGEST_TEXT) -> str:
    """Whole text of a small file in UTF-8, line ends as they stand in Python.

    Raises
    ------
    OSError
        If it is not there, no regular file, or larger than `most` bytes.
    UnicodeDecodeError
        If it is not text.
    """
    return read_bytes(path, most).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


def write_text(path: str | Path, text: str) -> None:
    """Put a text file into its place, whole or not at all; what was there stays where it fails.

    A full disk or an interruption leaves no stub and takes no file away.  Devices and pipes are
    written to as they are.

    Raises
    ------
    OSError
        With the name of the file, if it cannot be written.
    """
    place, data = Path(path).resolve(), text.encode()
    try:
        if place.exists() and not place.is_file():
            place.write_bytes(data)
            return
        new = place.with_name(f".{place.name[:200]}.{os.getpid()}.new")
        try:
            new.write_bytes(data)
            if place.exists():
                shutil.copymode(place, new)
            new.replace(place)
        finally:
            new.unlink(missing_ok=True)
    except OSError as error:
        error.filename, error.filename2 = str(path), None
        raise


def parse_toml(text: str) -> dict[str, Any]:
    """Tables of a TOML file.

    Raises
    ------
    tomllib.TOMLDecodeError
        If it is not TOML, nests deeper than `_DEEPEST`, or holds an integer of more than 64 bits.
    """
    if _LONG_KEY.search(text):
        raise tomllib.TOMLDecodeError(_deep())
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise tomllib.TOMLDecodeError(_deep()) from None
    except ValueError as error:  # a number of thousands of digits
        raise tomllib.TOMLDecodeError(str(error)) from None
    waiting: list[tuple[Any, int]] = [(table, 0)]
    while waiting:
        value, depth = waiting.pop()
        if isinstance(value, dict | list):
            if depth > _DEEPEST:
                raise tomllib.TOMLDecodeError(_deep())
            inner = value.values() if isinstance(value, dict) else value
            waiting += [(x, depth + 1) for x in inner]
        elif type(value) is int and not -LARGEST_NUMBER <= value < LARGEST_NUMBER:
            raise tomllib.TOMLDecodeError("it holds an integer of more than 64 bits")
    return table


def _deep() -> str:
    return f"tables or lists nest deeper than {_DEEPEST}"


def is_dataset(path: Path) -> bool:
    """Whether a folder holds a LeRobot data set (format 2 or 3)."""
    return path.is_dir() and (path / "meta" / "info.json").is_file()
