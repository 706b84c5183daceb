"""Writes a session: metadata first, then chunks of at most 64 KiB or 100 ms, index and statistics.

Message by message, the format's own library takes two thirds of a session's time.  Here many rows
become messages at once: the constant bytes of a row's messages, frames included, are a template; a
compiled loop puts in the numbers.  What arrives in the file is the same to the byte.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar, cast

import numba as nb
import numpy as np
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import Writer
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.interrupt import interrupts
from hil.record.frames import SCHEMA, SCHEMA_NAME, TOPIC, BoundedFrameLog, encode
from hil.record.recovery import (
    CHUNK_BYTES,
    FRAME,
    chunk_closer,
    copy_metadata,
    create,
    define_channel,
    define_schema,
    describe,
    mcap_writer,
)
from hil.record.schema import EVENT_SCHEMA, Channel, encoder, places

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


#: Writes messages of a block from number `first` on, until the chunk is full or a time is
#: reached: (block, bytes, times, first, time) -> (next message, whether the time was reached).
Append = Callable[["Block", NDArray[np.uint8], NDArray[np.int64], int, int], tuple[int, bool]]


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
        self,
        block: Block,
        raw: NDArray[np.uint8],
        times: NDArray[np.int64],
        first: int,
        until: int,
    ) -> tuple[int, bool]:
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


#: With the ring's 10 ms, what a killed process loses stays below 100 ms.
CHUNK_NS = 80_000_000
#: For so long [ns] every drain of the ring, a hundred a second, is handed to the system at once:
#: what goes wrong at the start of a session is on record.
START_NS, START_CHUNK_NS = 200_000_000, 10_000_000


Method = TypeVar("Method", bound=Callable[..., Any])


def _whole(function: Method) -> Method:
    """A function that no Ctrl-C leaves half done: the index would point beside the chunks."""

    @wraps(function)
    def done(*args: Any, **kwargs: Any) -> Any:
        with interrupts:
            return function(*args, **kwargs)

    return cast(Method, done)


class SessionWriter:
    """An open session file.

    Parameters
    ----------
    path : str or Path
        Where to; its folder must exist.
    channels : sequence of Channel
        Topics, in the order in which they get their numbers.
    metadata : mapping of str to mapping of str to str
        Metadata records; written first, so that they survive a crash.
    attachments : mapping of str to bytes
        Attached files.
    overwrite : bool
        False refuses a file that exists.
    sync : float
        At most so much of the record [s] is not on the disk when the power fails; 0 leaves it to
        the operating system when it writes, usually within half a minute.

    Raises
    ------
    ConfigError
        If the file cannot be created, another process writes it, or two channels have one topic;
        the file is not touched before everything else is known to be right.  If not even the
        head fits on the disk; then no file is left.
    """

    def __init__(
        self,
        path: str | Path,
        channels: Sequence[Channel],
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Mapping[str, bytes] | None = None,
        overwrite: bool = True,
        sync: float = 0.0,
    ) -> None:
        encoders = {c.topic: encoder(c) for c in channels}
        if len(encoders) < len(channels):
            raise ConfigError(f"session {path}: two channels have one topic: {list(encoders)}")
        largest = max((len(encoders[c.topic](0, [0.0] * c.width)) for c in channels), default=0)
        self._file = create(path, overwrite)
        self._writer = mcap_writer(self._file, largest)
        self._end_chunk = chunk_closer(self._writer)
        self._records = {name: dict(record) for name, record in metadata.items()}
        self._late = False
        describe(self._writer, metadata, attachments or {})
        self._encode: dict[str, tuple[int, int, Callable[[int, Sequence[float]], bytes]]] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        for channel in channels:
            self._register(channel, encoders[channel.topic])
        self._channels = {c.topic: c for c in channels}
        self._blocks: dict[tuple[tuple[str, int, int], ...], Block] = {}
        self._append = appender(self._writer, CHUNK_BYTES - FRAME - largest)
        self._events = 0
        self._logs: list[tuple[int, BoundedFrameLog]] = []
        self._at_the_end: Callable[[], Mapping[str, Mapping[str, str]]] = dict
        self._origin_ns, self._period_ns, self._epoch_ns = 0, 0, -1
        self._first_ns, self._until_ns = -1, 0
        self._sync_ns, self._synced_ns = int(sync * 1e9), 0
        self.messages = 0
        try:
            self.flush()
        except OSError as error:
            self._file.discard()
            raise ConfigError(
                f"cannot write session {path}: {error.strerror}; no file is left"
            ) from error
        self._head = self._file.tell()

    def _register(self, channel: Channel, encode: Callable[[int, Sequence[float]], bytes]) -> None:
        name, text = channel.schema()
        if (name, text) not in self._schemas:
            self._schemas[name, text] = define_schema(self._writer, name, "ros2msg", text.encode())
        number = define_channel(self._writer, channel.topic, "cdr", self._schemas[name, text])
        self._encode[channel.topic] = (number, channel.width, encode)

    @_whole
    def write(self, topic: str, tick: int, t_ns: int, values: Sequence[float]) -> None:
        """Write one message.

        Parameters
        ----------
        topic : str
            A registered topic.
        tick : int
            Tick number, from 1.
        t_ns : int
            Time of the tick [ns]; log and publish time.
        values : sequence of float
            As many as the channel holds.

        Raises
        ------
        ConfigError
            If the topic is not registered, or takes another number of values.
        """
        if topic not in self._encode:
            raise ConfigError(unknown("topic", topic, self._encode))
        number, width, encode = self._encode[topic]
        if len(values) != width:
            raise ConfigError(f"topic {topic} takes {width} values, got {len(values)}")
        self._begin(t_ns)
        self._writer.add_message(number, t_ns, encode(t_ns, values), t_ns, tick)
        self.messages += 1
        self._keep_up(t_ns)

    @_whole
    def write_rows(
        self,
        topics: Sequence[tuple[str, slice]],
        stamps: NDArray[np.int64],
        data: NDArray[np.float64],
    ) -> None:
        """Write messages of several topics for many rows at once, to the byte as `write` would.

        Parameters
        ----------
        topics : sequence of (str, slice)
            Which columns of a row go to which topic, in the order of the messages.
        stamps : ndarray (n, 2)
            Tick and time [ns] of every row.
        data : ndarray (n, width)
            Rows.

        Raises
        ------
        ConfigError
            As `write`.
        """
        if self._epoch_ns < 0 and len(stamps):
            self._epoch_ns = int(stamps[0, 1] - stamps[0, 0] * self._period_ns)
        key = tuple((topic, s.start, s.stop) for topic, s in topics)
        if key not in self._blocks:
            rows = [(self._channel(t, s.stop - s.start), s.start) for t, s in topics]
            self._blocks[key] = Block(rows)
        if len(stamps):
            self._begin(int(stamps[0, 1]))
        block, done = self._blocks[key], 0
        raw, times = block.encode(stamps, data), stamps[:, 1]
        self.messages += len(raw) * block.topics
        while done < len(raw) * block.topics:
            done, due = self._append(block, raw, times, done, self._until_ns)
            if due:
                self._keep_up(int(times[(done - 1) // block.topics]))

    def _channel(self, topic: str, width: int) -> tuple[int, Channel]:
        """Number and declaration of a topic."""
        if topic not in self._encode:
            raise ConfigError(unknown("topic", topic, self._encode))
        number, needed, _ = self._encode[topic]
        if width != needed:
            raise ConfigError(f"topic {topic} takes {needed} values, got {width}")
        return number, self._channels[topic]

    def _begin(self, t_ns: int) -> None:
        """The first message's time: the first chunk holds whole rows from there on."""
        if self._first_ns < 0:
            self._first_ns, self._until_ns = t_ns, t_ns + START_CHUNK_NS

    def _keep_up(self, t_ns: int) -> None:
        if t_ns < self._until_ns:
            return
        self.flush()
        begins = t_ns - self._first_ns < START_NS
        self._until_ns = t_ns + (START_CHUNK_NS if begins else CHUNK_NS)
        if self._sync_ns and t_ns - self._synced_ns >= self._sync_ns:
            self._file.sync()
            self._synced_ns = t_ns

    @_whole
    def event(self, tick: int, t_ns: int, name: str, data: Mapping[str, object]) -> None:
        """Write a rare event as JSON on `/events`."""
        if not self._events:
            schema = define_schema(self._writer, "hil_event", "jsonschema", EVENT_SCHEMA.encode())
            self._events = define_channel(self._writer, "/events", "json", schema)
        self._begin(t_ns)
        text = json.dumps({"tick": tick, "name": name, "data": dict(data)}, sort_keys=True)
        self._writer.add_message(self._events, t_ns, text.encode(), t_ns, tick)
        self._keep_up(t_ns)

    def frames(self, logs: Mapping[str, BoundedFrameLog], origin_ns: int, period_ns: int) -> None:
        """Write the frames of these boxes from now on, at every `flush`.

        Parameters
        ----------
        logs : mapping of str to FrameLog
            Box -> its frames.
        origin_ns, period_ns : int
            Loop's time of tick 0, and length of a tick [ns].  The first row tells the log time
            of tick 0; frames from before tick 0 get that too.
        """
        schema = 0
        for box, log in logs.items():
            schema = schema or define_schema(self._writer, SCHEMA_NAME, "ros2msg", SCHEMA.encode())
            number = define_channel(self._writer, TOPIC + box, "cdr", schema)
            self._logs.append((number, log))
        self._origin_ns, self._period_ns = origin_ns, period_ns

    def at_the_end(self, told: Callable[[], Mapping[str, Mapping[str, str]]]) -> None:
        """Metadata records that are asked for when the session is closed."""
        self._at_the_end = told

    def _write_frames(self, last: bool = False) -> None:
        """Frames that wait; before the first row there is no log time for them."""
        if self._epoch_ns < 0 and not last:
            return
        for number, log in self._logs:
            for frame in log.take():
                t_ns = max(frame.t_ns - self._origin_ns, 0) + max(self._epoch_ns, 0)
                self._writer.add_message(number, t_ns, encode(frame, t_ns), t_ns, 0)

    @_whole
    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Add a record that was not known at the beginning."""
        self._end_chunk()
        self._writer.add_metadata(name, dict(record))
        self._records[name], self._late = dict(record), True

    @_whole
    def flush(self) -> None:
        """Close the open chunk and hand everything to the operating system."""
        self._write_frames()
        self._end_chunk()
        self._file.flush()

    def abandon(self) -> None:
        """Give up after an error: cut the file off behind its last whole chunk, and close it.

        A file without a message is removed; one that is closed stays as it is.
        """
        if self._file.closed:
            return
        if self._file.kept <= self._head:
            self._file.discard()
            return
        self._file.cut()
        self._file.close()

    @property
    def size(self) -> int:
        """Bytes of the file, those that wait included."""
        return self._file.tell()

    @property
    def gone(self) -> bool:
        """Whether the file was removed, renamed or shortened while it is written."""
        return not self._file.closed and self._file.gone

    def release(self) -> None:
        """Let go of the file without a byte more: another process writes it."""
        self._file.close()

    @_whole
    def close(self) -> None:
        """Write the index and close the file."""
        if not self._file.closed:
            try:
                self._write_frames(last=True)
                for name, record in self._at_the_end().items():
                    self.metadata(name, record)
                if self._late:
                    copy_metadata(self._writer, self._records)
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.flush()
                if self._sync_ns:
                    self._file.sync()
            finally:
                self._file.close()

    def __enter__(self) -> SessionWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
