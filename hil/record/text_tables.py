"""Text tables: which row names the columns, what stands between the cells, and their numbers.

Of a table that cannot be read the first bad cell is named.
"""

from __future__ import annotations

import bz2
import codecs
import contextlib
import csv
import gzip
import io
import itertools
import lzma
import math
import os
import re
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError
from hil.record.guess import with_units
from hil.userfile import open_regular

FloatArray = NDArray[np.float64]
#: Largest text table [byte], its longest row and column name [characters].
LARGEST_TEXT, LONGEST_ROW, LONGEST_NAME = 2**33, 2**20, 256
#: Rows that are looked at for a header after other lines.
_PREAMBLE = 60
#: A recording has some ten columns a joint; what has more is no table of samples.
MOST_COLUMNS = 4096
#: Ending of a packed file -> its first bytes, and what opens it.
_PACKERS: dict[str, tuple[bytes, Callable[[BinaryIO], BinaryIO]]] = {
    ".gz": (b"\x1f\x8b", lambda file: cast(BinaryIO, gzip.GzipFile(fileobj=file))),
    ".bz2": (b"BZh", lambda file: cast(BinaryIO, bz2.BZ2File(file))),
    ".xz": (b"\xfd7zXZ\0", lambda file: cast(BinaryIO, lzma.LZMAFile(file))),
}
PACKED = tuple(_PACKERS)
_LONGEST_MARK = 8
#: Bytes that a packed table may have: a sum, and so many times the file.  Numbers as text pack to
#: a third; what packs to a hundredth is no measurement.
_ROOM, _RATIO = 2**22, 64
#: Bytes that are unpacked at once.
_LARGEST_BLOCK = 2**20


@dataclass(frozen=True)
class TextTable:
    """Columns of a text table: names, reader, row of the first sample and its cells by column."""

    names: tuple[str, ...]
    read: Callable[[Sequence[str]], dict[str, FloatArray]]
    first_row: int
    first: Mapping[str, str]


def read_text_table(path: Path, header_row: int = 0, columns: Sequence[str] = ()) -> TextTable:
    """Open a text table: header row; comma, semicolon or tab between the cells.

    Parameters
    ----------
    path : Path
        The file; it may be packed by gzip, bzip2 or xz.
    header_row : int
        Row with the names of the columns, as an editor counts; 0 to find it.
    columns : sequence of str
        Names of the columns where no row has them; what stands before the first row of so many
        numbers is not read.

    Raises
    ------
    DataError
        If it is empty, not text, lacks a header row, or has rows, columns or names beyond
        `LONGEST_ROW`, `MOST_COLUMNS` and `LONGEST_NAME`.
    """
    if columns:
        return _bare(path, columns)
    head, header = _given_header(path, header_row) if header_row else _header_line(path)
    labview = not header_row and header.startswith(_LABVIEW)
    if labview:
        head, header = _labview(path)
    elif not header_row and not header.lstrip().startswith(("#", "%")):
        head, header = _after_preamble(path, head, header)
    header = header.lstrip("#% ")
    delimiter = max(";\t,", key=header.count)
    spaced = delimiter not in header and _spaced(path, head, header)
    header, delimiter = (",".join(header.split()), ",") if spaced else (header, delimiter)
    names = _header_names(path, head, header, delimiter)
    if labview and names[-1] == "Comment":  # of which rows have no cell
        names = names[:-1]
    body = _Body(path, head, spaced)
    first = list(itertools.islice(body, 100))
    if first and (units := _units_row(first[0][1], names, delimiter)):
        names, body, first = units, _Body(path, first[0][0], spaced), first[1:]
    if not first:
        raise DataError(f"table {path} has a header row but no samples")
    return _table(path, names, delimiter, body, first)


def _bare(path: Path, columns: Sequence[str]) -> TextTable:
    """Table whose columns a map names: its samples begin with the first row of so many numbers."""
    _refuse_columns(path, columns)
    seen = 0
    for number, line in itertools.islice(_Body(path, 0), _PREAMBLE):
        spaced = not any(mark in line for mark in ";\t,")
        delimiter = _between(",".join(line.split()) if spaced else line)
        cells = line.split() if spaced else [c.strip() for c in line.split(delimiter)]
        numbers = [_is_number(c.replace(",", ".")) or bool(_TIMED.match(c)) for c in cells]
        seen = seen or len(cells) * all(numbers)
        if all(numbers) and len(cells) == len(columns):
            body = _Body(path, number - 1, spaced)
            return _table(path, tuple(columns), delimiter, body, list(itertools.islice(body, 100)))
    rows = f"its rows hold {seen} numbers" if seen else "no row near its begin holds numbers alone"
    raise DataError(
        f"table {path}: the map names {len(columns)} columns ([table] columns), and {rows}"
    )


def _table(
    path: Path,
    names: tuple[str, ...],
    delimiter: str,
    body: _Body,
    first: Sequence[tuple[int, str]],
) -> TextTable:
    """Table of a body, whose first rows show how its numbers are written."""
    cells = [c.strip() for _, line in first for c in line.split(delimiter)]
    comma = delimiter in (";", "\t") and not any(_is_number(c) and "." in c for c in cells)
    reader = _TextColumns(path, names, delimiter, body, comma)
    row = dict(zip(names, cells, strict=False))
    return TextTable(names, reader, first[0][0], row)


#: How a measurement file of LabVIEW begins, and what ends each of its headers.
_LABVIEW, _HEADER_ENDS = "LabVIEW Measurement", "***End_of_Header***"


def _labview(path: Path) -> tuple[int, str]:
    """Number and text of the row behind the last header of a measurement file of LabVIEW."""
    rows = list(itertools.islice(_Body(path, 0), _PREAMBLE))
    ends = [k for k, (_, line) in enumerate(rows) if line.startswith(_HEADER_ENDS)]
    if not ends or ends[-1] + 1 >= len(rows):
        raise DataError(f"table {path} begins as a file of LabVIEW, and has no {_HEADER_ENDS}")
    return rows[ends[-1] + 1]


def _header_names(path: Path, head: int, header: str, delimiter: str) -> tuple[str, ...]:
    try:
        names = tuple(n.strip() for n in next(csv.reader([header], delimiter=delimiter)))
    except csv.Error as error:
        raise DataError(f"table {path}, row {head}: {error}; expected column names") from error
    if all(_is_number(n) for n in names):
        raise DataError(
            f"table {path}: row {head} holds numbers; a header row with the names of the columns "
            f"is needed, or their {len(names)} names in a map: [table] columns = "
            '["t", "q1", "tau1", ..]'
        )
    _refuse_columns(path, names)
    twice = sorted(n for n, count in Counter(names).items() if count > 1)
    if twice:
        raise DataError(f"table {path}: column {twice[0]!r} stands twice in the header")
    return names


def _given_header(path: Path, row: int) -> tuple[int, str]:
    """Number and text of the row that a map names."""
    for number, line in _Body(path, row - 1):
        if number == row:
            return number, line
        break
    raise DataError(f"table {path}: header_row = {row} in [table], but that row is empty or absent")


def _after_preamble(path: Path, head: int, header: str) -> tuple[int, str]:
    """The header where other lines stand before it: the row of names next to the numbers.

    Raises
    ------
    DataError
        If two rows before the numbers could be it.
    """
    rows = [(head, header), *itertools.islice(_Body(path, head), _PREAMBLE)]
    at = next((k for k in range(len(rows) - 1) if _samples(rows[k : k + 2])), 0)
    if at < 2:
        return head, header
    delimiter = _between(rows[at][1])
    wide = len(rows[at][1].split(delimiter))
    names = [_names_in(line, delimiter, wide) for _, line in rows[:at]]
    last = at - 1
    if names[last - 1] and _units_row(rows[last][1], names[last - 1], delimiter):
        last -= 1
    if last == 0 or not names[last]:
        return head, header
    if names[last - 1]:
        one, two = rows[last - 1][0], rows[last][0]
        raise DataError(
            f"table {path}: the names of the columns may be in row {one} or in row {two}. If "
            f"in row {two}, say so in a map: [table] header_row = {two}; row {one} and its units "
            f"are then not read. Else delete row {two}; a second row may hold their units, e.g. s, "
            "deg, Nm"
        )
    return rows[last]


def _between(row: str) -> str:
    """What stands between the cells of a row of numbers; a comma may be their decimal point."""
    return next((d for d in ";\t" if d in row), ",")


def _samples(rows: Sequence[tuple[int, str]]) -> bool:
    """Whether rows hold numbers or times alone, two or more and as many in each."""
    cells = [[c.strip() for c in line.split(_between(line))] for _, line in rows]
    plain = [c.replace(",", ".") for row in cells for c in row]
    return (
        len({len(row) for row in cells}) == 1
        and len(cells[0]) > 1
        and all(not c or _is_number(c) or _TIMED.match(c) for c in plain)
        and all(any(map(str.strip, row)) for row in cells)
    )


def _names_in(line: str, delimiter: str, wide: int) -> tuple[str, ...]:
    """Cells of a row that may hold the names of so many columns; empty where it cannot."""
    cells = tuple(c.strip() for c in line.split(delimiter))
    fits = len(cells) == wide == len(set(cells))
    return cells if fits and not any(not c or _is_number(c) for c in cells) else ()


def _units_row(row: str, names: Sequence[str], delimiter: str) -> tuple[str, ...]:
    """Names with the units of a second header row; empty where the row is none."""
    try:
        cells = [c.strip() for c in next(csv.reader([row], delimiter=delimiter))]
    except csv.Error:
        return ()
    return with_units(names, cells)


def _refuse_columns(path: Path, names: Sequence[str]) -> None:
    if len(names) > MOST_COLUMNS:
        raise DataError(
            f"table {path} has {len(names)} columns; at most {MOST_COLUMNS} are read. Are rows and "
            "columns exchanged?"
        )
    longest = max(names, key=len, default="")
    if len(longest) > LONGEST_NAME:
        raise DataError(
            f"table {path}: a column has a name of {len(longest)} characters "
            f"({longest[:20]!r}...); at most {LONGEST_NAME} are read"
        )


def _spaced(path: Path, head: int, header: str) -> bool:
    """Whether spaces stand between the cells: as many words in the first row as in the header."""
    first = next(iter(_Body(path, head)), (0, ""))[1]
    return 1 < len(header.split()) == len(first.split())


@dataclass(frozen=True)
class _Body:
    """Rows of a text table that are not blank, each with its number, from after a row on."""

    path: Path
    head: int
    #: Whether spaces stand between the cells; commas stand for them then.
    spaced: bool = False

    def __iter__(self) -> Iterator[tuple[int, str]]:
        number = 0
        try:
            with (
                _open(self.path) as raw,
                io.TextIOWrapper(raw, encoding=_encoding(raw), errors=_LATIN) as file,
            ):
                while line := file.readline(LONGEST_ROW):
                    number += 1
                    if len(line) == LONGEST_ROW:
                        raise DataError(
                            f"table {self.path}, row {number}: more than {LONGEST_ROW} characters; "
                            "expected one sample a row"
                        )
                    if number > self.head and line.strip():
                        line = line.rstrip("\n")
                        yield number, ",".join(line.split()) if self.spaced else line
        except UnicodeError as error:
            raise DataError(
                f"table {self.path} is not a text file: behind row {number} are bytes that are "
                "no letters; export it as CSV in UTF-8"
            ) from error
        except (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile) as error:
            raise DataError(
                f"table {self.path} cannot be unpacked behind row {number}: {error}. Unpack what "
                "is left of it, and give that"
            ) from error


@contextlib.contextmanager
def _open(path: Path) -> Iterator[BinaryIO]:
    """A text table's bytes, unpacked where it is packed, whatever it is called."""
    with open_regular(path, LARGEST_TEXT) as raw:
        start = raw.read(_LONGEST_MARK)
        raw.seek(0)
        opener = next((o for mark, o in _PACKERS.values() if start.startswith(mark)), None)
        if opener is None:
            yield raw
            return
        with opener(raw) as packed:
            most = _ROOM + _RATIO * os.fstat(raw.fileno()).st_size
            yield cast(BinaryIO, io.BufferedReader(_Bounded(packed, most, path)))


def _refuse_claim(path: Path) -> None:
    """Refuse a packed table that unpacks to too much, before memory is taken for its rows."""
    with (
        contextlib.suppress(EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile),  # told later
        _open(path) as file,
    ):
        while isinstance(file, io.BufferedReader) and isinstance(file.raw, _Bounded):
            if not file.read(_LARGEST_BLOCK):
                return


class _Bounded(io.RawIOBase):
    """What is unpacked, up to so many bytes: a small file may claim any amount."""

    def __init__(self, packed: BinaryIO, most: int, path: Path):
        self._packed, self._most, self._path = packed, most, path

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, to: int, whence: int = 0) -> int:
        return self._packed.seek(to, whence)

    def tell(self) -> int:
        return self._packed.tell()

    def readinto(self, buffer: Any) -> int:
        data = self._packed.read(len(buffer))
        if self._packed.tell() > self._most:
            raise DataError(
                f"table {self._path} unpacks to more than {self._most / 2**20:.4g} MiB; unpack it "
                "first, if it is a recording"
            )
        buffer[: len(data)] = data
        return len(data)


def _latin(error: UnicodeError) -> tuple[str, int]:
    """The letters and signs of Latin-1 (degree, micro, umlauts) where a byte is no UTF-8.

    Older programs and spreadsheets write them so; any other byte is none of a text.
    """
    if isinstance(error, UnicodeDecodeError) and error.encoding == "utf-8":
        found = error.object[error.start : error.end]
        if min(found) >= _FIRST_LETTER:
            return found.decode("latin-1"), error.end
    raise error


_LATIN, _FIRST_LETTER = "hil.latin", 0xA0
codecs.register_error(_LATIN, _latin)


def is_text(path: Path) -> bool:
    """Whether a file begins as text does: without zeros, but for the wide letters of UTF-16."""
    try:
        with _open(path) as file:
            start = file.read(4096)
    except (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile):
        return True  # what is wrong with it is said where it is read
    return b"\0" not in start or _wide(start) != ""


def _encoding(file: BinaryIO) -> str:
    """UTF-16 where a file begins like that, as some spreadsheets write it; else UTF-8."""
    start = file.read(64)
    file.seek(0)
    return _wide(start) or "utf-8-sig"


def _wide(start: bytes) -> str:
    """UTF-16 where a text begins with its mark, or each second byte is zero; empty if not."""
    if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    even, odd = set(start[:64:2]), set(start[1:64:2])
    if len(start) > 1 and 0 not in even and odd == {0}:
        return "utf-16-le"
    return "utf-16-be" if len(start) > 1 and 0 not in odd and even == {0} else ""


def _header_line(path: Path) -> tuple[int, str]:
    """Number and text of the header: the first row, or the last comment if numbers follow it."""
    comment: tuple[int, str] | None = None
    for number, line in _Body(path, 0):
        if line.lstrip().startswith(("#", "%")):
            comment = number, line
        else:
            first = line.replace(";", ",").replace("\t", ",").split(",", 1)[0]
            return comment if comment is not None and _is_number(first) else (number, line)
    raise DataError(f"table {path} is empty; a header row and samples are needed")


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
    body: _Body
    #: Whether a comma stands for the decimal point.
    comma: bool

    def __call__(self, wanted: Sequence[str]) -> dict[str, FloatArray]:
        use = [self.names.index(n) for n in wanted]
        if not use:
            return {}
        _refuse_claim(self.path)
        try:
            rows = self._even()
            block = np.loadtxt(rows, delimiter=self.delimiter, usecols=use, ndmin=2, comments=None)
        except DataError:  # a row without end, or bytes that are no text
            raise
        except ValueError:
            block = self._slowly(wanted, use)
        return {name: block[:, k] for k, name in enumerate(wanted)}

    def _even(self) -> Iterator[str]:
        """Rows of as many cells as there are names; any other one is read slowly, and told."""
        between = len(self.names) - 1
        for _, line in self._lines():
            more = line.count(self.delimiter) - between
            if more and not (more == 1 and line.rstrip().endswith(self.delimiter)):
                raise ValueError
            yield line

    def _lines(self) -> Iterator[tuple[int, str]]:
        """Rows of cells; one that begins with # is a remark."""
        rows = ((number, line) for number, line in self.body if not self._remark(line))
        if not self.comma:
            return rows
        return ((number, line.replace(",", ".")) for number, line in rows)

    def _remark(self, line: str) -> bool:
        """Whether a row is a remark, and no sample whose first cell is #N/A."""
        if line[0] not in "# ":
            return False
        first = line.partition(self.delimiter)[0].strip().lower()
        return first.startswith("#") and first not in _NOTHING

    def _slowly(self, wanted: Sequence[str], use: list[int]) -> FloatArray:
        """Row by row: empty cells become NaN, the first bad cell is named."""
        number = 0

        def lines() -> Iterator[str]:
            nonlocal number
            for at, line in self._lines():
                number = at
                yield line

        out = array("d")
        cells = csv.reader(lines(), delimiter=self.delimiter)
        try:
            for row in cells:
                out.extend(self._row(row, number, wanted, use))
        except csv.Error as error:
            raise DataError(f"table {self.path}, row {number}: {error}") from error
        return np.frombuffer(out, np.float64).reshape(-1, len(use))

    def _row(
        self, row: Sequence[str], number: int, wanted: Sequence[str], use: Sequence[int]
    ) -> Iterator[float]:
        where = f"table {self.path}, row {number}"
        if len(row) not in (len(self.names), len(self.names) + (row[-1].strip() == "")):
            both = ""
            if self.delimiter == "," and len(row) > len(self.names):
                both = (
                    ". Where a comma is the decimal mark, too, no program can tell which is which: "
                    "export it with semicolons or tabs between the cells"
                )
            raise DataError(f"{where}: {len(row)} cells; expected {len(self.names)}{both}")
        for name, column in zip(wanted, use, strict=True):
            text = row[column].strip()
            try:
                yield math.nan if text.lower() in _NOTHING else float(text)
            except ValueError:
                if (seconds := _seconds(text, where, name)) is not None:
                    yield seconds
                    continue
                if _MINUTES.fullmatch(text):
                    raise DataError(
                        f"{where}: column {name!r} holds {text!r}, minutes and seconds as a "
                        "spreadsheet shows a time; expected hours, too, or a number. Give its "
                        "cells the format hh:mm:ss.000 and export it again"
                    ) from None
                shown = text if len(text) <= LONGEST_NAME else f"{text[:LONGEST_NAME]}..."
                raise DataError(
                    f"{where}: column {name!r} holds {shown!r}; expected a number. The names of "
                    "the columns must be in one row, directly above the numbers or above a row of "
                    "units. If other lines come first, set header_row = N in [table] of a map, or "
                    "begin these lines with #"
                ) from None


#: A time without its hour.
_MINUTES = re.compile(r"[0-5]?[0-9]:[0-5][0-9](?:[.,][0-9]+)?")
#: What stands in a cell without a value, in small letters.
_NOTHING = frozenset(("", "-", "--", "n/a", "na", "#n/a", "null", "none", "nil"))


def is_clock(text: str) -> bool:
    """Whether a cell holds a time of day."""
    return _CLOCK.fullmatch(_american(text)) is not None


def _seconds(text: str, where: str, name: str) -> float | None:
    """Seconds since 1970 of a date and time (ISO 8601, 31.12.2024 23:59:59,5, or
    12/31/2024 11:59:59.5 PM; UTC where it says none), or since midnight of a time of day; None
    where a text is neither.
    """
    plain = _GERMAN.sub(r"\3-\2-\1 ", text).replace(",", ".") if _GERMAN.match(text) else text
    plain = _american(plain)
    if _CLOCK.fullmatch(plain):
        hours, minutes, seconds = plain.replace(",", ".").split(":")
        return 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds)
    if not _DATE.match(plain):
        return None
    try:
        when = datetime.fromisoformat(plain)
    except ValueError as error:
        raise DataError(f"{where}: column {name!r} holds {text!r}: {error}") from None
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def _american(text: str) -> str:
    """A date as month/day/year and twelve hours, in the form of ISO; any other text as it is.

    Which of two numbers is the month matters to nobody who needs the seconds between samples; the
    second one is where the first is above twelve.
    """
    found = _AMERICAN.fullmatch(text)
    if not found:
        return text
    hour, half = int(found["hour"]), (found["half"] or "").upper()
    hour = hour % 12 + (12 if half == "PM" else 0) if half else hour
    clock = f"{hour:02d}:{found['rest']}"
    if not found["year"]:
        return clock
    one, two = int(found["one"]), int(found["two"])
    month, day = (two, one) if one > 12 else (one, two)
    return f"{found['year']}-{month:02d}-{day:02d} {clock}"


#: Begin of a cell that holds a date and a time of day.
_DATE = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}[T ][0-9]{2}:")
_GERMAN = re.compile(r"([0-9]{2})\.([0-9]{2})\.([0-9]{4}) +(?=[0-9]{2}:)")
_AMERICAN = re.compile(
    r"(?:(?P<one>[0-9]{1,2})/(?P<two>[0-9]{1,2})/(?P<year>[0-9]{4}),? +)?"
    r"(?P<hour>[0-9]{1,2}):(?P<rest>[0-5][0-9]:[0-5][0-9](?:\.[0-9]+)?) ?(?P<half>[AaPp][Mm])?"
)
#: Begin of a date or time of day.
_TIMED = re.compile(
    r"[0-9]{4}-[0-9]{2}-[0-9]{2}|[0-9]{2}\.[0-9]{2}\.[0-9]{4} |[0-9]{1,2}/[0-9]{1,2}/[0-9]{4},? |"
    r"[0-2]?[0-9]:[0-5]"
)
#: A time of day; a recording over midnight runs backward, and is refused for that.
_CLOCK = re.compile(r"[0-2]?[0-9]:[0-5][0-9]:[0-5][0-9](?:[.,][0-9]+)?")
