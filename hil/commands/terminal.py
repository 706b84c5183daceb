"""What the program prints, whoever wrote the names in it: nothing that a terminal obeys.

The one place is the streams themselves.  A file can hold a name with escape sequences, or with
marks that turn the direction of text; on the terminal they would move the cursor, hide the rest
of a message or show another one.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import threading
from collections.abc import Iterable, Iterator
from typing import Any, TextIO

from tqdm import tqdm

from hil import progress
from hil.errors import printable

#: What is shorter shows no progress [s]; how often a bar is drawn anew [s].
_SHORT, _EVERY = 1.0, 0.5
_BAR = "{desc} {percentage:3.0f} %|{bar:20}| {elapsed}, about {remaining} left"


class Settings:
    """What the command line said of all output.

    Parameters
    ----------
    quiet : bool
        Whether only results and errors are printed: no notes, no progress.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet


settings = Settings()


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Print no notes, within."""
    before, settings.quiet = settings.quiet, True
    try:
        yield
    finally:
        settings.quiet = before


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


@contextlib.contextmanager
def working(shown: bool = True) -> Iterator[None]:
    """Show on a terminal how far the work within has come, where it takes more than a second.

    Parameters
    ----------
    shown : bool
        Whether to show it at all.
    """
    if settings.quiet or not shown or not _is_terminal(sys.stderr):
        yield
        return
    bar = tqdm(total=1.0, bar_format=_BAR, leave=False, delay=1e9, smoothing=0, file=sys.stderr)
    over = threading.Event()

    def told(what: str, done: float) -> None:
        bar.desc = what
        bar.n = max(bar.n, min(done, 0.99))

    def drawn() -> None:
        wait = _SHORT
        while not over.wait(wait):
            wait = _EVERY
            if bar.desc:
                bar.delay = 0.0  # drawn from now on, so that its end clears it
                bar.refresh()

    thread = threading.Thread(target=drawn, name="progress", daemon=True)
    thread.start()
    try:
        with progress.listening(told):
            yield
    finally:
        over.set()
        thread.join()
        bar.close()


def _is_terminal(stream: TextIO) -> bool:
    try:
        return stream.isatty()
    except (AttributeError, ValueError):  # no stream, or a closed one
        return False
