"""Many rows into an MCAP chunk at once: all messages of a burst are laid out in one array.

Message by message, the format's own library takes two thirds of a session's time.  Here the
constant bytes of a row's messages, frames included, are a template; a compiled loop puts in the
numbers.  What arrives in the file is the same to the byte.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

import numba as nb
import numpy as np
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import Writer
from numpy.typing import NDArray

from hil.record.schema import Channel, encoder, places

#: Of a message record: opcode, length, channel, sequence, log and publish time.
_HEAD = struct.Struct("<BQHIQQ")
_SEQUENCE, _LOG, _PUBLISH, _STAMP = 11, 15, 23, _HEAD.size + 4

#: Writes messages of a block from number `first` on, until the chunk is full or a time is
#: reached: (block, bytes, times, first, time) -> (next message, whether the time was reached).
Append = Callable[
    ["Block", NDArray[np.uint8], NDArray[np.int64], int, int], tuple[int, bool]
]  # fmt: skip


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
        template, starts, ends, at, column = b"", [], [], [], []
        for (number, channel), first in rows:
            body = encoder(channel)(0, [0.0] * channel.width)
            length = _HEAD.size - 9 + len(body)
            start = len(template)
            starts.append(start)
            template += _HEAD.pack(Opcode.MESSAGE, length, number, 0, 0, 0) + body
            ends.append(len(template))
            at += [start + _HEAD.size + p for p in places(channel)]
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


class _Index(MessageIndex):
    """Index of a channel's messages in a chunk, packed a block at a time."""

    def __init__(self, channel: int) -> None:
        super().__init__(channel, [])
        self.packed = bytearray()

    def write(self, stream: Any) -> None:
        """Write the record."""
        for pair in self.records:
            self.packed += struct.pack("<QQ", *pair)
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(self.packed))
        stream.write(self.packed)
        stream.finish_record()


def appender(writer: Writer, full: int) -> Append:
    """How blocks get into the open chunk of a writer.

    Parameters
    ----------
    writer : mcap.writer.Writer
        Started.
    full : int
        A chunk with more bytes than these is closed.
    """
    parts = [getattr(writer, f"_Writer__{p}", None) for p in ("chunk_builder", "statistics")]
    close = getattr(writer, "_Writer__maybe_finalize_chunk", None)
    if None in parts or close is None:
        return _one_by_one(writer)
    return _Chunk(writer, parts[0], parts[1], close, full).append


def _one_by_one(writer: Writer) -> Append:
    """The way of a release of mcap that is laid out otherwise."""

    def append(
        block: Block, raw: NDArray[np.uint8], times: NDArray[np.int64], first: int, until: int
    ) -> tuple[int, bool]:
        row, topic = divmod(first, block.topics)
        message = raw[row, block.starts[topic] : block.ends[topic]].tobytes()
        _, _, number, tick, t_ns, _ = _HEAD.unpack_from(message)
        writer.add_message(number, t_ns, message[_HEAD.size :], t_ns, tick)
        return first + 1, t_ns >= until

    return append


class _Chunk:
    """The open chunk of an MCAP writer."""

    def __init__(
        self, writer: Writer, builder: Any, statistics: Any, close: Callable[[], None], full: int
    ) -> None:
        self._builder, self._statistics, self._close, self._full = builder, statistics, close, full

    def append(
        self, block: Block, raw: NDArray[np.uint8], times: NDArray[np.int64], first: int,
        until: int,
    ) -> tuple[int, bool]:  # fmt: skip
        """See `Append`."""
        width, n = raw.shape[1], block.topics
        row, topic = divmod(first, n)
        begin = row * width + int(block.starts[topic])
        base = self._builder.record_writer.count - begin
        # the message that makes the chunk longer than `full`, the first one of a late row, or all
        stop, due = len(raw) * n, False
        over = self._full - base
        if base + len(raw) * width > self._full:
            r = over // width
            stop = min(stop, r * n + int(np.searchsorted(block.ends, over - r * width, "right")) + 1)
        late = np.searchsorted(times, until)
        if late < len(times) and max(late * n, first) + 1 <= stop:
            stop, due = max(late * n, first) + 1, True
        last, topic = divmod(stop - 1, n)
        end = last * width + int(block.ends[topic])
        self._builder.record_writer.write(raw.reshape(-1)[begin:end].data)
        self._enter(block, times, first, stop, base, width)
        self._close()
        return stop, due

    def _enter(
        self, block: Block, times: NDArray[np.int64], first: int, stop: int, base: int, width: int
    ) -> None:
        """Index and statistics of messages first to stop - 1."""
        n, builder, statistics = block.topics, self._builder, self._statistics
        t0, t1 = int(times[first // n]), int(times[(stop - 1) // n])
        builder.message_start_time = min(t0, builder.message_start_time or t0)
        if builder.num_messages == 0:
            builder.message_start_time = t0
        builder.message_end_time = max(builder.message_end_time, t1)
        builder.num_messages += stop - first
        if statistics.message_count == 0:
            statistics.message_start_time = t0
        statistics.message_start_time = min(t0, statistics.message_start_time)
        statistics.message_end_time = max(statistics.message_end_time, t1)
        statistics.message_count += stop - first
        for k, number in sorted(enumerate(block.numbers), key=lambda p: (p[0] - first) % n):
            rows = np.arange((first - k + n - 1) // n, (stop - k + n - 1) // n)
            if not rows.size:
                continue
            index = builder.message_indices.get(number)
            if not isinstance(index, _Index):
                index = builder.message_indices[number] = _Index(number)
            pairs = np.empty((rows.size, 2), np.uint64)
            pairs[:, 0] = times[rows]
            pairs[:, 1] = base + rows * width + block.starts[k]
            index.packed += pairs.tobytes()
            statistics.channel_message_counts[number] += rows.size
