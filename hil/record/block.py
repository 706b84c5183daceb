"""Many rows as MCAP messages at once: all messages of a burst are laid out in one array.

Message by message, the format's own library takes two thirds of a session's time.  Here the
constant bytes of a row's messages, frames included, are a template; a compiled loop puts in the
numbers.  What arrives in the file is the same to the byte.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numba as nb
import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from hil.record.schema import Channel, encoder, places

#: Of a message record: opcode, length, channel, sequence, log and publish time.
HEAD = struct.Struct("<BQHIQQ")
_SEQUENCE, _LOG, _PUBLISH, _STAMP = 11, 15, 23, HEAD.size + 4


@nb.njit(cache=True, nogil=True)
def _fill(
    out: Any, template: Any, starts: Any, stamps: Any, bits: Any, at: Any, column: Any
) -> None:
    """Rows of bytes (n, width) from stamps (n, 2) and the bits (n, columns) of the numbers."""
    for r in range(out.shape[0]):
        row = out[r]
        row[:] = template
        tick, t = stamps[r, 0], stamps[r, 1]
        second, nano = t // 1_000_000_000, t % 1_000_000_000
        for s in starts:
            for k in range(4):
                row[s + _SEQUENCE + k] = (tick >> (8 * k)) & 0xFF
                row[s + _STAMP + k] = (second >> (8 * k)) & 0xFF
                row[s + _STAMP + 4 + k] = (nano >> (8 * k)) & 0xFF
            for k in range(8):
                byte = (t >> (8 * k)) & 0xFF
                row[s + _LOG + k] = byte
                row[s + _PUBLISH + k] = byte
        for i in range(at.size):
            word = bits[r, column[i]]
            for k in range(8):
                row[at[i] + k] = (word >> (8 * k)) & 0xFF


class Block:
    """Layout of the messages that one row becomes.

    Parameters
    ----------
    rows : sequence of ((int, Channel), int)
        Number and declaration of every channel, in order, and its first column.

    Attributes
    ----------
    topics : int
        Messages a row.
    numbers : list of int
        Channels of the messages.
    ends : ndarray (topics,) of int
        Where each message ends in a row of bytes.
    """

    def __init__(self, rows: Sequence[tuple[tuple[int, Channel], int]]) -> None:
        template, starts, ends = b"", [], []
        at: list[int] = []
        column: list[int] = []
        for (number, channel), first in rows:
            body = encoder(channel)(0, [0.0] * channel.width)
            length = HEAD.size - 9 + len(body)
            start = len(template)
            starts.append(start)
            template += HEAD.pack(Opcode.MESSAGE, length, number, 0, 0, 0) + body
            ends.append(len(template))
            at += [start + HEAD.size + p for p in places(channel)]
            column += range(first, first + channel.width)
        self.topics, self.numbers = len(rows), [number for (number, _), _ in rows]
        self.ends = np.array(ends)
        self.starts = np.array(starts)
        self._template = np.frombuffer(template, np.uint8)
        self._at, self._column = np.array(at, np.int64), np.array(column, np.int64)

    def encode(self, stamps: NDArray[np.int64], data: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Bytes (n, width) of n rows."""
        out = np.empty((len(stamps), self._template.size), np.uint8)
        bits = np.ascontiguousarray(data).view(np.uint64)
        _fill(out, self._template, self.starts, stamps, bits, self._at, self._column)
        return out
