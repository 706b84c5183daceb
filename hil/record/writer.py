"""Writes a session: metadata first, then chunks of at most 64 KiB or 100 ms."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.record.block import Block
from hil.record.chunk import appender
from hil.record.frames import SCHEMA, SCHEMA_NAME, TOPIC, FrameLog, encode
from hil.record.schema import EVENT_SCHEMA, Channel, encoder
from hil.record.sessionfile import CHUNK_BYTES, FRAME, chunk_closer, create, mcap_writer

#: With the ring's 10 ms, what a killed process loses stays below 100 ms.
CHUNK_NS = 80_000_000


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

    Raises
    ------
    ConfigError
        If the file cannot be created, or two channels have one topic; the file is not touched
        before everything else is known to be right.
    """

    def __init__(
        self,
        path: str | Path,
        channels: Sequence[Channel],
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Mapping[str, bytes] | None = None,
        overwrite: bool = True,
    ) -> None:
        encoders = {c.topic: encoder(c) for c in channels}
        if len(encoders) < len(channels):
            raise ConfigError(f"session {path}: two channels have one topic: {list(encoders)}")
        largest = max((len(encoders[c.topic](0, [0.0] * c.width)) for c in channels), default=0)
        self._file = create(path, overwrite)
        self._writer = mcap_writer(self._file, largest)
        self._end_chunk = chunk_closer(self._writer)
        self._describe(metadata, attachments or {})
        self._encode: dict[str, tuple[int, int, Callable[[int, Sequence[float]], bytes]]] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        for channel in channels:
            self._register(channel, encoders[channel.topic])
        self._channels = {c.topic: c for c in channels}
        self._blocks: dict[tuple[tuple[str, int, int], ...], Block] = {}
        self._append = appender(self._writer, CHUNK_BYTES - FRAME - largest)
        self._events = 0
        self._logs: list[tuple[int, FrameLog]] = []
        self._at_the_end: Callable[[], Mapping[str, Mapping[str, str]]] = dict
        self._origin_ns, self._period_ns, self._epoch_ns = 0, 0, -1
        self._chunk_start = 0
        self.messages = 0
        self.flush()

    def _describe(
        self, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]
    ) -> None:
        """What the session is, before its first message."""
        for name, record in metadata.items():
            self._writer.add_metadata(name, dict(record))
        for name, data in attachments.items():
            self._writer.add_attachment(0, 0, name, "application/octet-stream", data)

    def _register(self, channel: Channel, encode: Callable[[int, Sequence[float]], bytes]) -> None:
        name, text = channel.schema()
        if (name, text) not in self._schemas:
            self._schemas[name, text] = self._writer.register_schema(name, "ros2msg", text.encode())
        number = self._writer.register_channel(channel.topic, "cdr", self._schemas[name, text])
        self._encode[channel.topic] = (number, channel.width, encode)

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
        self._writer.add_message(number, t_ns, encode(t_ns, values), t_ns, tick)
        self.messages += 1
        self._keep_up(t_ns)

    def write_rows(
        self, topics: Sequence[tuple[str, slice]], stamps: NDArray[np.int64],
        data: NDArray[np.float64],
    ) -> None:  # fmt: skip
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
        block, done = self._blocks[key], 0
        raw, times = block.encode(stamps, data), stamps[:, 1]
        self.messages += len(raw) * block.topics
        while done < len(raw) * block.topics:
            done, due = self._append(block, raw, times, done, self._chunk_start + CHUNK_NS)
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

    def _keep_up(self, t_ns: int) -> None:
        if t_ns - self._chunk_start >= CHUNK_NS:
            self.flush()
            self._chunk_start = t_ns

    def event(self, tick: int, t_ns: int, name: str, data: Mapping[str, object]) -> None:
        """Write a rare event as JSON on `/events`."""
        if not self._events:
            schema = self._writer.register_schema("hil_event", "jsonschema", EVENT_SCHEMA.encode())
            self._events = self._writer.register_channel("/events", "json", schema)
        text = json.dumps({"tick": tick, "name": name, "data": dict(data)}, sort_keys=True)
        self._writer.add_message(self._events, t_ns, text.encode(), t_ns, tick)
        self._keep_up(t_ns)

    def frames(self, logs: Mapping[str, FrameLog], origin_ns: int, period_ns: int) -> None:
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
            schema = schema or self._writer.register_schema(SCHEMA_NAME, "ros2msg", SCHEMA.encode())
            number = self._writer.register_channel(TOPIC + box, "cdr", schema)
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

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Add a record that was not known at the beginning."""
        self._end_chunk()
        self._writer.add_metadata(name, dict(record))

    def flush(self) -> None:
        """Close the open chunk and hand everything to the operating system."""
        self._write_frames()
        self._end_chunk()
        self._file.flush()

    def abandon(self) -> None:
        """Give up after an error: cut the file off behind its last whole chunk, and close it."""
        self._file.cut()
        self._file.close()

    def release(self) -> None:
        """Let go of the file without a byte more: another process writes it."""
        self._file.close()

    def close(self) -> None:
        """Write the index and close the file."""
        if not self._file.closed:
            try:
                self._write_frames(last=True)
                for name, record in self._at_the_end().items():
                    self.metadata(name, record)
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.flush()
            finally:
                self._file.close()

    def __enter__(self) -> SessionWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self.close()
