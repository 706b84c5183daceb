"""What one side of a running session gives to another without a lock: rows, and snapshots.

A ring takes rows from the fast loop to the slow side: one writer, one reader.  The writer fills a
row before it publishes the new head; the reader copies rows out before it publishes the new tail.
A full ring drops the new row and counts it.

A board shows the last snapshot to other processes, in shared memory: one writer, the slow side; any
number of readers.  A reader never holds the writer up: the writer counts up before and after it
writes, and who reads an odd or a changed count reads again.
"""

from __future__ import annotations

import json
import mmap
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

#: Bytes of a board: count and length, then text.
SIZE = 1 << 16
_HEAD = struct.Struct("<QI")


class Ring:
    """Preallocated rows of `width` numbers with tick and time.

    Parameters
    ----------
    rows : int
        Capacity.
    width : int
        Numbers per row.

    Attributes
    ----------
    dropped : int
        Rows that found the ring full.
    """

    def __init__(self, rows: int, width: int) -> None:
        self._stamps = np.zeros((rows, 2), np.int64)
        self._data = np.zeros((rows, width))
        self._rows = rows
        self._head = 0
        self._tail = 0
        self.dropped = 0

    def __len__(self) -> int:
        """Rows that wait."""
        return self._head - self._tail

    def push(self, tick: int, t_ns: int, row: NDArray[np.float64]) -> bool:
        """Store one row (width,); False if it was dropped."""
        if self._head - self._tail >= self._rows:
            self.dropped += 1
            return False
        k = self._head % self._rows
        stamp = self._stamps[k]
        stamp[0] = tick
        stamp[1] = t_ns
        self._data[k] = row
        self._head += 1
        return True

    def take(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """All waiting rows, oldest first: stamps (n, 2) = tick, time [ns]; data (n, width)."""
        head, first = self._head, self._tail % self._rows
        n = head - self._tail
        if first + n <= self._rows:
            stamps = self._stamps[first : first + n].copy()
            data = self._data[first : first + n].copy()
        else:
            index = np.arange(first, first + n) % self._rows
            stamps, data = self._stamps[index], self._data[index]
        self._tail = head
        return stamps, data

    def before(self, tick: int, n: int) -> NDArray[np.float64]:
        """Rows of the n ticks before `tick` that are still there, oldest first: (up to n, width).

        For looking back at why the loop let go, when nothing is written any more.
        """
        first = max(self._head - self._rows, 0)
        index = np.arange(first, self._head) % self._rows
        ticks = self._stamps[index, 0]
        found: NDArray[np.float64] = self._data[index[(ticks < tick) & (ticks >= tick - n)]]
        return found


class BoardWriter:
    """Writes snapshots into a file that readers map.

    Parameters
    ----------
    path : str or Path
        The file; it is made, or taken over.

    Raises
    ------
    ConfigError
        If it cannot be made.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            with open(path, "w+b") as file:
                os.ftruncate(file.fileno(), SIZE)
                self._map = mmap.mmap(file.fileno(), SIZE)
        except OSError as error:
            raise ConfigError(f"cannot write board {path}: {error.strerror}") from error
        self._count = 0

    def publish(self, snapshot: Mapping[str, Any]) -> None:
        """Show a snapshot; one that is too long is cut to an error that says so."""
        text = json.dumps(snapshot).encode()
        if b"NaN" in text or b"Infinity" in text:  # no JSON: shown as missing
            text = json.dumps(json.loads(text, parse_constant=lambda name: None)).encode()
        if len(text) > SIZE - _HEAD.size:
            text = b'{"error": "the snapshot is too long"}'
        _HEAD.pack_into(self._map, 0, self._count + 1, 0)
        self._map[_HEAD.size : _HEAD.size + len(text)] = text
        self._count += 2
        _HEAD.pack_into(self._map, 0, self._count, len(text))

    def close(self) -> None:
        """Let go of the memory; the file stays with the last snapshot."""
        self._map.close()

    def __enter__(self) -> BoardWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


#: Tries before a reader gives up for this time.
_TRIES = 50


def read_board(path: str | Path) -> tuple[int, dict[str, Any]]:
    """Last snapshot of a board and its number, from 1 on; 0 and nothing where there is none."""
    try:
        with open(path, "rb") as file:
            for _ in range(_TRIES):
                file.seek(0)
                raw = file.read(SIZE)
                if len(raw) < _HEAD.size:
                    return 0, {}
                count, length = _HEAD.unpack_from(raw)
                file.seek(0)
                again, _ = _HEAD.unpack(file.read(_HEAD.size))
                if count and count % 2 == 0 and count == again:
                    return count // 2, json.loads(raw[_HEAD.size : _HEAD.size + length])
    except OSError:
        return 0, {}
    return 0, {}
