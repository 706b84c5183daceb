"""What the program prints: results, notes, tables and progress, and nothing that a terminal obeys.

The streams themselves see to the last, whoever wrote the names in a text.  A file can hold a name
with escape sequences, or with marks that turn the direction of text; on the terminal they would
move the cursor, hide the rest of a message or show another one.

A table that is too wide first breaks the lines of its words; where that is not enough it goes on
below, with its first column again, as those of the data-frame libraries do.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import shutil
import sys
import textwrap
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

from tqdm import tqdm

from hil import work
from hil.errors import ConfigError, printable
from hil.userfile import write_text

#: What is shorter shows no progress [s]; how often a bar is drawn anew [s].
_SHORT, _EVERY = 1.0, 0.5
_BAR = "{desc} {percentage:3.0f} %|{bar:20}| {elapsed}, about {remaining} left"


class Settings:
    """What the command line said of all output.

    Parameters
    ----------
    quiet : bool
        Whether only results and errors are printed: no notes, no progress.

    Attributes
    ----------
    broken : dict of str to str
        Parts of names on the command line that hold line breaks, and how they are shown.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet
        self.broken: dict[str, str] = {}

    def name(self, words: Iterable[str]) -> None:
        """Take note of the words of the command line.

        A line break in the name of a file would begin a line of its own wherever the name, or
        that of a file beside it, is printed.
        """
        held = [w for w in words if "\n" in w]
        parts = [p for w in held for p in re.split("[/=,']", w)]
        # what is made beside x.mcap is x.1.mcap; a break at an end is like those of any text
        within = {p for x in parts for p in (x, x.rpartition(".")[0]) if p == p.strip("\n")}
        within |= {w for w in held if len(w) > _NARROW or w == w.strip("\n")}
        longest = sorted((p for p in within if "\n" in p), key=len, reverse=True)
        self.broken = {p: p.replace("\n", "\\n") for p in longest}

    def unbroken(self, text: str) -> str:
        """Text in which no such name breaks a line."""
        for part, shown in self.broken.items():
            text = text.replace(part, shown)
        return text


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
    stream : TextIO or None
        Where to; all else is asked of it.  None: it was closed (``>&-``), and takes it nowhere.
    """

    def __init__(self, stream: TextIO | None) -> None:
        # the next file that is opened would be in its place
        self.stream = open(os.devnull, "w") if stream is None else stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def write(self, text: str) -> int:
        """Write text; what the encoding of the stream lacks becomes an escape too."""
        text, given = settings.unbroken(text), len(text)
        body = text.strip("\r")
        begin, _, end = text.partition(body) if body else (text, "", "")
        shown = begin + printable(body) + end
        try:
            self.stream.write(shown)
        except UnicodeEncodeError:
            self.stream.write(shown.encode("ascii", "backslashreplace").decode("ascii"))
        return given

    def writelines(self, lines: Iterable[str]) -> None:
        """Write lines one by one."""
        for line in lines:
            self.write(line)


@contextlib.contextmanager
def quoted(words: Iterable[str] = ()) -> Iterator[None]:
    """Standard output and error quote what they print, within; a closed one takes it nowhere.

    Parameters
    ----------
    words : iterable of str
        What stands on the command line; line breaks in it are shown as such.
    """
    before = sys.stdout, sys.stderr
    settings.name(words)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, Quoting):
            setattr(sys, name, Quoting(stream))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def width(stream: TextIO | None = None) -> int | None:
    """Characters in a line of the terminal; None where the output goes into a file or a pipe."""
    try:
        shown = (sys.stdout if stream is None else stream).isatty()
        return shutil.get_terminal_size().columns if shown else None
    except (AttributeError, ValueError):  # no stream, or a closed one
        return None


#: The line of progress, while there is one.
_bars: list[tqdm] = []


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
    over, compilation, stage = threading.Event(), Compilation(), [""]

    def told(what: str, done: float) -> None:
        stage[0] = what.replace("\n", "\\n")
        bar.n = max(bar.n, min(done, 0.99))

    def drawn() -> None:
        wait = _SHORT
        while not over.wait(wait):
            wait = _EVERY
            compilation.watch()
            bar.desc = COMPILES if compilation.depth else stage[0]
            if bar.desc:
                bar.delay = 0.0  # drawn from now on, so that its end clears it
                bar.refresh()

    thread = threading.Thread(target=drawn, name="progress", daemon=True)
    thread.start()
    _bars.append(bar)
    try:
        with work.listening(told):
            yield
    finally:
        over.set()
        thread.join()
        compilation.end()
        _bars.remove(bar)
        bar.close()


@contextlib.contextmanager
def _room() -> Iterator[None]:
    """Take the line of progress away while whole lines are written; it is drawn again below."""
    if not _bars:
        yield
        return
    with tqdm.get_lock():  # the thread that draws it waits
        for bar in _bars:
            if not bar.delay:  # it is drawn
                bar.clear(nolock=True)
        yield


#: What is said while kernels are compiled; the machine code is kept for later runs.
COMPILES = "compiling (once per installation)"


class Compilation:
    """Whether the compiler of kernels is at work, as its own events say.

    A kernel that was kept by an earlier run is loaded, and not compiled.  The compiler is not
    loaded for this: a command that needs none pays nothing.

    Parameters
    ----------
    begun : callable
        Called when it begins.

    Attributes
    ----------
    depth : int
        Kernels that are being compiled, one within the other.
    """

    def __init__(self, begun: Callable[[], None] = lambda: None) -> None:
        self.depth, self._begun = 0, begun
        self._end: Callable[[], None] | None = None

    def watch(self) -> None:
        """Listen from now on, if the compiler is loaded."""
        events: Any = sys.modules.get("numba.core.event")
        # what another thread is still loading has not all of its names
        if self._end is not None or not hasattr(events, "install_recorder"):
            return

        class Listener(events.Listener):  # type: ignore[misc]
            def on_start(_, event: Any) -> None:  # noqa: N805
                self.depth += 1
                if self.depth == 1:
                    self._begun()

            def on_end(_, event: Any) -> None:  # noqa: N805
                self.depth = max(self.depth - 1, 0)

        listener = Listener()
        events.register("numba:compile", listener)
        self._end = lambda: events.unregister("numba:compile", listener)

    def end(self) -> None:
        """Listen no longer."""
        if self._end is not None:
            self._end()
            self._end = None


def _is_terminal(stream: TextIO) -> bool:
    try:
        return stream.isatty()
    except (AttributeError, ValueError):  # no stream, or a closed one
        return False


def log(text: str) -> None:
    """One line to stderr, unless it is to be quiet."""
    if settings.quiet:
        return
    with _room():
        sys.stderr.write(sentences(text, sys.stderr) + "\n")


def out(text: str) -> None:
    """Text to stdout, its sentences within the terminal."""
    write_stdout(sentences(text) + "\n")


def write_stdout(text: str) -> None:
    """Text to stdout as it is: whole lines."""
    with _room():
        sys.stdout.write(text)


#: Lines that somebody copies, or a program reads: commands, JSON, comments and keys of TOML.
_AS_IT_IS = re.compile(r"\s*(hil (?![\w-]+:)|\$ |[\[\]{}\"#]|[\w.*\"-]+ = )")


def sentences(text: str, stream: TextIO | None = None) -> str:
    """Text whose lines are broken between words where the terminal ends; else as it is.

    Parameters
    ----------
    text : str
        Lines; a broken one goes on below, further to the right.
    stream : TextIO, optional
        Where it is written to; default the standard output.
    """
    wide, text = width(stream), settings.unbroken(text)
    if wide is None:
        return text
    return "\n".join(_within(line, wide) for line in text.split("\n"))


def _within(line: str, wide: int) -> str:
    if len(line) <= wide or _AS_IT_IS.match(line):
        return line
    indent = " " * (len(line) - len(line.lstrip(" ")))
    return textwrap.fill(
        line.lstrip(" "),
        max(wide, len(indent) + _NARROW),
        initial_indent=indent,
        subsequent_indent=indent + " " * _INDENT,
        break_long_words=False,
        break_on_hyphens=False,
    )


def emit(data: dict[str, Any]) -> None:
    """JSON to stdout."""
    write_stdout(json.dumps(data, indent=2, allow_nan=False) + "\n")


def json_value(value: Any) -> Any:
    """`value` with null in place of what JSON cannot hold."""
    if isinstance(value, dict):
        return {k: json_value(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_value(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


#: Text for the terminal, and data for JSON.
Found = tuple[str, dict[str, object]]


def check_page(path: str | None) -> None:
    """Refuse a page that is not Markdown by its name.

    Raises
    ------
    ConfigError
        Names the path.
    """
    if path and Path(path).suffix != ".md":
        raise ConfigError(f"--report {path}: a file that ends in .md is needed")


def write_page(path: str | None, text: str) -> None:
    """Write the page, if one is asked for."""
    if path:
        write_text(path, text)


# ------------------------------------------------------------ tables

#: Spaces before a table, and between its columns.
_INDENT, _GAP = 2, 2
#: No column of words gets narrower than this [characters].
_NARROW = 16
TextRow = list[str]


def table(head: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> str:
    """Aligned text table, no wider than the terminal; words stand in the columns `left`."""
    return aligned(head, rows, left, width())


#: With more joints than this, and than there are models, joints are rows.
_FEW = 3


def of_joints(
    what: str,
    joints: Sequence[str],
    rows: Sequence[tuple[str, Sequence[Sequence[str]]]],
    kinds: Sequence[str] = ("%",),
) -> str:
    """Values of every joint for several models; the rows are joints where these are many.

    Parameters
    ----------
    what : str
        What the values are.
    joints : sequence of str
        Names, length d.
    rows : sequence of (label, values)
        A model, and for each kind d values.
    kinds : sequence of str
        What stands behind a joint's or a model's name, e.g. ``%`` and ``simulated %``.
    """
    if len(joints) <= max(_FEW, len(rows)):
        head = [what, *(f"{j} {kind}" for kind in kinds for j in joints)]
        return table(head, [[label, *(x for v in values for x in v)] for label, values in rows])
    head = [what, *(f"{label} {kind}" for kind in kinds for label, _ in rows)]
    cells = [
        [joint, *(values[k][j] for k in range(len(kinds)) for _, values in rows)]
        for j, joint in enumerate(joints)
    ]
    return table(head, cells)


def aligned(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    left: Sequence[int] = (0,),
    width: int | None = None,
) -> str:
    """Aligned text table.

    Parameters
    ----------
    head, rows : sequence of str
        Cells; line breaks in them are shown as such.
    left : sequence of int
        Columns of words, to the left; the others hold numbers, to the right.
    width : int, optional
        Characters there are in a line; without it the table is as wide as it is.
    """
    cells = [[c.replace("\n", "\\n") for c in r] for r in (head, *rows)]
    wide = [max(len(r[k]) for r in cells) for k in range(len(head))]
    if width is None or _total(wide) <= width:
        return _lines(cells, wide, left)
    wide = _narrowed(wide, left, width)
    if _total(wide) <= width:
        return _lines(cells, wide, left)
    parts = []
    for part in _parts(wide, width):
        own = [[r[k] for k in part] for r in cells]
        words = [i for i, k in enumerate(part) if k in left]
        parts.append(_lines(own, [wide[k] for k in part], words))
    return "\n\n".join(parts)


def _total(wide: Sequence[int]) -> int:
    return _INDENT + sum(wide) + _GAP * (len(wide) - 1)


def _narrowed(wide: Sequence[int], left: Sequence[int], width: int) -> list[int]:
    """Widths with the columns of words made narrower, the widest first."""
    out = list(wide)
    over = _total(out) - width
    for k in sorted((k for k in left if k < len(out)), key=lambda k: -out[k]):
        cut = min(max(over, 0), max(out[k] - _NARROW, 0))
        out[k] -= cut
        over -= cut
    return out


def _parts(wide: Sequence[int], width: int) -> list[list[int]]:
    """Columns of each part of a table, the first one in all."""
    parts = [[0]]
    for k in range(1, len(wide)):
        if len(parts[-1]) > 1 and _total([wide[i] for i in (*parts[-1], k)]) > width:
            parts.append([0])
        parts[-1].append(k)
    return parts


def _lines(cells: Sequence[Sequence[str]], wide: Sequence[int], left: Sequence[int]) -> str:
    head, *rows = ([_broken(c, w) for c, w in zip(r, wide, strict=True)] for r in cells)
    rule = "  ".join("-" * w for w in wide)
    lines = [*_row(head, wide, left), rule]
    for row in rows:
        lines += _row(row, wide, left)
    return "\n".join(" " * _INDENT + x.rstrip() for x in lines)


def _broken(cell: str, width: int) -> TextRow:
    if len(cell) <= width:
        return [cell]
    return textwrap.wrap(cell, max(width, 1), break_on_hyphens=False) or [""]


def _row(cells: Sequence[TextRow], wide: Sequence[int], left: Sequence[int]) -> list[str]:
    """Lines of one row, as many as its highest cell has."""
    high = max(map(len, cells))
    full = [c + [""] * (high - len(c)) for c in cells]
    return [
        (" " * _GAP).join(
            c[i].ljust(w) if k in left else c[i].rjust(w)
            for k, (c, w) in enumerate(zip(full, wide, strict=True))
        )
        for i in range(high)
    ]
