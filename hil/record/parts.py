"""A session in several files: a new one by length or size, or where the one before is gone.

Every part is a session of its own, with the same metadata, attached files and channels; its
metadata record ``part`` says which one it is, and why it was begun.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.record.mcap_write import SessionWriter

#: How often it is seen whether the file is still there [s].
LOOKED_S = 0.5

#: Opens a part: its file, and its metadata record ``part`` (empty: a session in one file).
OpenPart = Callable[[Path, Mapping[str, str]], SessionWriter]


def part_path(first: Path, number: int) -> Path:
    """File of part `number` (from 2 on) of a session; a file that is there is passed over."""
    while True:
        path = first.with_name(f"{first.stem}.part{number}{first.suffix}")
        if not path.exists():
            return path
        number += 1


class SessionParts:
    """The files of a session; what `hil.runtime.slow.RowWriter` asks for, and closing.

    Parameters
    ----------
    path : Path
        First file.
    open_part : callable
        Opens a file: (path, record ``part``) -> `SessionWriter`.
    seconds, megabytes : float
        Length and size after which a new file is begun; 0: never.
    say : callable
        Takes sentences for the operator.

    Attributes
    ----------
    paths : list of Path
        Files begun until now.

    Raises
    ------
    ConfigError
        As `SessionWriter`, for the first file.
    """

    def __init__(
        self,
        path: Path,
        open_part: OpenPart,
        seconds: float = 0.0,
        megabytes: float = 0.0,
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._open, self._say = open_part, say
        self._length_ns, self._size = int(seconds * 1e9), int(megabytes * 1e6)
        split = seconds > 0.0 or megabytes > 0.0
        self.paths = [path]
        self._writer = open_part(path, {"number": "1"} if split else {})
        self._begun_ns = self._looked_ns = -1

    def write(self, topic: str, tick: int, t_ns: int, values: Sequence[float]) -> None:
        """Write one message; see `SessionWriter.write`."""
        self._writer.write(topic, tick, t_ns, values)

    def write_rows(
        self,
        topics: Sequence[tuple[str, slice]],
        stamps: NDArray[np.int64],
        data: NDArray[np.float64],
    ) -> None:
        """Write messages of many rows, into a new file where it is time for one.

        See `SessionWriter.write_rows`.

        Raises
        ------
        OSError
            If the file takes no more, or no new one can be begun.
        """
        if len(stamps):
            self._turn(int(stamps[0, 0]), int(stamps[0, 1]))
        self._writer.write_rows(topics, stamps, data)

    def _turn(self, tick: int, t_ns: int) -> None:
        """Begin a new file before this row, where there is a reason to."""
        if self._begun_ns < 0:
            self._begun_ns = self._looked_ns = t_ns
        if t_ns - self._looked_ns >= LOOKED_S * 1e9:
            self._looked_ns = t_ns
            if self._writer.gone:
                self._close()  # renamed, it is a proper session
                self._next(tick, t_ns, "the file before was removed, renamed or shortened")
                return
        if 0 < self._length_ns <= t_ns - self._begun_ns:
            self._writer.close()
            self._next(tick, t_ns, "length")
        elif 0 < self._size <= self._writer.size:
            self._writer.close()
            self._next(tick, t_ns, "size")

    def _next(self, tick: int, t_ns: int, why: str) -> None:
        """Begin a new file."""
        number = len(self.paths) + 1
        path = part_path(self.paths[0], number)
        record = {
            "number": str(number),
            "first": self.paths[0].name,
            "before": self.paths[-1].name,
            "why": why,
        }
        try:
            self._writer = self._open(path, record)
        except ConfigError as error:
            raise OSError(str(error)) from error
        self.paths.append(path)
        self._begun_ns = t_ns
        self._writer.event(tick, t_ns, "part", record)
        self._say(f"the record goes on in {path}")

    def event(self, tick: int, t_ns: int, name: str, data: Mapping[str, object]) -> None:
        """Write a rare event; see `SessionWriter.event`."""
        self._writer.event(tick, t_ns, name, data)

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Add a metadata record to the last file."""
        self._writer.metadata(name, record)

    def abandon(self) -> None:
        """Give up after an error; see `SessionWriter.abandon`."""
        self._writer.abandon()

    def release(self) -> None:
        """Let go of the file without a byte more: another process writes it."""
        self._writer.release()

    def close(self) -> None:
        """Write the index of the last file and close it."""
        self._close()

    def _close(self) -> None:
        if self._writer.gone:
            self._say(f"{self.paths[-1]} is not there any more, or was shortened")
        self._writer.close()
