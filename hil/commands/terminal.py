"""What the program prints, whoever wrote the names in it: nothing that a terminal obeys.

The one place is the streams themselves.  A file can hold a name with escape sequences, or with
marks that turn the direction of text; on the terminal they would move the cursor, hide the rest
of a message or show another one.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
from collections.abc import Iterable, Iterator
from typing import Any, TextIO

from hil.errors import printable


class Quoting:
    """Text stream that shows control, bidirectional and invisible characters as escapes.

    A carriage return at either end of one write stays: progress bars begin and end with it.

    Parameters
    ----------
    stream : TextIO
        Where to; all else is asked of it.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def write(self, text: str) -> int:
        """Write text; what the encoding of the stream lacks becomes an escape too."""
        body = text.strip("\r")
        begin, _, end = text.partition(body) if body else (text, "", "")
        shown = begin + printable(body) + end
        try:
            self.stream.write(shown)
        except UnicodeEncodeError:
            self.stream.write(shown.encode("ascii", "backslashreplace").decode("ascii"))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write lines one by one."""
        for line in lines:
            self.write(line)


@contextlib.contextmanager
def quoted() -> Iterator[None]:
    """Standard output and error quote what they print, within."""
    before = sys.stdout, sys.stderr
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, Quoting):
            setattr(sys, name, Quoting(stream))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def width() -> int | None:
    """Characters in a line of the terminal; None where the output goes into a file or a pipe."""
    try:
        return shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    except (AttributeError, ValueError):  # no stream, or a closed one
        return None
