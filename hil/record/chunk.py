"""Blocks of messages into the open chunk of an MCAP file, with its index and statistics."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import Writer
from numpy.typing import NDArray

from hil.record.block import HEAD, Block

#: Writes messages of a block from number `first` on, until the chunk is full or a time is
#: reached: (block, bytes, times, first, time) -> (next message, whether the time was reached).
Append = Callable[
    ["Block", NDArray[np.uint8], NDArray[np.int64], int, int], tuple[int, bool]
]  # fmt: skip


class _Pieces:
    """Where the messages of a block stand in the open chunk.

    A piece ends within a row only where the chunk ends too, so that all rows are whole but,
    maybe, the first and the last one.
    """

    def __init__(self, block: Block) -> None:
        self.block = block
        self._times: list[NDArray[np.int64]] = []
        self._places: list[NDArray[np.int64]] = []
        self._skipped = self._left = 0
        self._made: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None

    def add(self, times: NDArray[np.int64], first: int, stop: int, base: int, width: int) -> None:
        """Messages `first` to `stop` - 1; row r begins at byte ``base + r * width``."""
        n = self.block.topics
        if not self._times:
            self._skipped = first % n
        self._left = stop % n
        rows = slice(first // n, (stop + n - 1) // n)
        self._times.append(times[rows])
        self._places.append(np.arange(rows.start, rows.stop) * width + base)

    def __len__(self) -> int:
        """Pieces."""
        return len(self._times)

    def pairs(self, k: int) -> bytes:
        """Times and places of the messages of topic k."""
        if self._made is None:
            self._made = np.concatenate(self._times), np.concatenate(self._places)
        times, places = self._made
        rows = slice(int(k < self._skipped), len(times) - int(0 < self._left <= k))
        found = np.empty((len(times[rows]), 2), np.int64)
        found[:, 0] = times[rows]
        found[:, 1] = places[rows]
        found[:, 1] += self.block.starts[k]
        return found.tobytes()


class _Index(MessageIndex):
    """Index of a channel's messages in a chunk, made when the chunk is closed."""

    def __init__(self, channel: int, topic: int, pieces: _Pieces) -> None:
        super().__init__(channel, [])
        self.topic, self.pieces = topic, pieces

    def write(self, stream: Any) -> None:
        """Write the record."""
        packed = self.pieces.pairs(self.topic)
        packed += b"".join(struct.pack("<QQ", *pair) for pair in self.records)
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(packed))
        stream.write(packed)
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
        _, _, number, tick, t_ns, _ = HEAD.unpack_from(message)
        writer.add_message(number, t_ns, message[HEAD.size :], t_ns, tick)
        return first + 1, t_ns >= until

    return append


class _Chunk:
    """The open chunk of an MCAP writer."""

    def __init__(
        self, writer: Writer, builder: Any, statistics: Any, close: Callable[[], None], full: int
    ) -> None:
        self._builder, self._statistics, self._close, self._full = builder, statistics, close, full
        self._pieces: dict[int, _Pieces] = {}

    def append(
        self, block: Block, raw: NDArray[np.uint8], times: NDArray[np.int64], first: int,
        until: int,
    ) -> tuple[int, bool]:  # fmt: skip
        """See `Append`."""
        width, n = raw.shape[1], block.topics
        row, topic = divmod(first, n)
        begin = row * width + int(block.starts[topic])
        base = int(self._builder.record_writer.count) - begin
        # the message that makes the chunk longer than `full`, the first one of a late row, or all
        stop, due = len(raw) * n, False
        over: int = self._full - base
        if base + len(raw) * width > self._full:
            r = over // width
            fits = int(np.searchsorted(block.ends, over - r * width, "right"))
            stop = min(stop, r * n + fits + 1)
        late = int(np.searchsorted(times, until))
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
        if builder.num_messages == 0:
            builder.message_start_time, self._pieces = t0, {}
        builder.message_start_time = min(t0, builder.message_start_time)
        builder.message_end_time = max(builder.message_end_time, t1)
        builder.num_messages += stop - first
        if statistics.message_count == 0:
            statistics.message_start_time = t0
        statistics.message_start_time = min(t0, statistics.message_start_time)
        statistics.message_end_time = max(statistics.message_end_time, t1)
        statistics.message_count += stop - first
        counts, whole, rest = statistics.channel_message_counts, *divmod(stop - first, n)
        for k, number in enumerate(block.numbers):
            counts[number] += whole + ((k - first) % n < rest)
        known = builder.message_indices
        pieces = self._pieces.get(id(block))
        if pieces is None:
            pieces = self._pieces[id(block)] = _Pieces(block)
        if len(pieces) < 2:  # every topic has come by then
            for k in range(first, min(stop, first + n)):
                number = block.numbers[k % n]
                before = known.get(number)
                if not isinstance(before, _Index):
                    known[number] = _Index(number, k % n, pieces)
                    known[number].records += before.records if before else []
        pieces.add(times, first, stop, base, width)
