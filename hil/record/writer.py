"""Writes a session: metadata first, then chunks of at most 64 KiB or 100 ms."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from io import BufferedWriter
from pathlib import Path
from types import TracebackType

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer

from hil.errors import ConfigError
from hil.record.recording import Recording
from hil.record.schema import EVENT_SCHEMA, Channel, encoder

LIBRARY = "hil"
CHUNK_BYTES = 64 * 1024
CHUNK_NS = 100_000_000


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

    Raises
    ------
    ConfigError
        If the file cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        channels: Sequence[Channel],
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        try:
            self._file: BufferedWriter = Path(path).open("wb")
        except OSError as error:
            raise ConfigError(f"cannot write session {path}: {error.strerror}") from error
        self._writer = Writer(
            self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD,
            index_types=IndexType.ALL, enable_data_crcs=True,
        )  # fmt: skip
        self._writer.start(profile="ros2", library=LIBRARY)
        for name, record in metadata.items():
            self._writer.add_metadata(name, dict(record))
        for name, data in (attachments or {}).items():
            self._writer.add_attachment(0, 0, name, "application/octet-stream", data)
        self._encode: dict[str, tuple[int, int, Callable[[int, Sequence[float]], bytes]]] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        for channel in channels:
            self._register(channel)
        self._events = 0
        self._chunk_start = 0
        self.messages = 0
        self._writer.flush()  # type: ignore[no-untyped-call]

    def _register(self, channel: Channel) -> None:
        name, text = channel.schema()
        if (name, text) not in self._schemas:
            self._schemas[name, text] = self._writer.register_schema(name, "ros2msg", text.encode())
        number = self._writer.register_channel(channel.topic, "cdr", self._schemas[name, text])
        self._encode[channel.topic] = (number, channel.width, encoder(channel))

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
        """
        number, width, encode = self._encode[topic]
        if len(values) != width:
            raise ConfigError(f"topic {topic} takes {width} values, got {len(values)}")
        self._writer.add_message(number, t_ns, encode(t_ns, values), t_ns, tick)
        self.messages += 1
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

    def flush(self) -> None:
        """Close the open chunk and hand everything to the operating system."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Write the index and close the file."""
        if not self._file.closed:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()

    def __enter__(self) -> SessionWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self.close()


def robot_record(recording: Recording) -> dict[str, str]:
    """Metadata record ``robot/<arm>`` of a recording."""
    return {
        "preset": recording.robot.preset,
        "tip": recording.robot.tip,
        "joints": json.dumps(list(recording.joints)),
        "unit": recording.metadata.get("unit", "rad"),
        "name": recording.name,
    }


def write_recordings(
    path: str | Path,
    recordings: Sequence[Recording],
    metadata: Mapping[str, Mapping[str, str]] | None = None,
) -> None:
    """Write recordings (one an arm, same run) as one session.

    Parameters
    ----------
    path : str or Path
        Output.
    recordings : sequence of Recording
        One a distinct arm.
    metadata : mapping, optional
        Further metadata records.
    """
    records = {f"robot/{r.arm}": robot_record(r) for r in recordings}
    urdf = {f"robot/{r.arm}.urdf": r.robot.urdf.encode() for r in recordings if r.robot.urdf}
    plans = [p for r in recordings for p in _plan(r)]
    with SessionWriter(path, [c for c, _, _ in plans], {**(metadata or {}), **records}, urdf) as w:
        # one pass in time order over all channels
        stamps = [np.round(t * 1e9).astype(np.int64) for _, t, _ in plans]
        rows = [x.tolist() for _, _, x in plans]
        order = np.argsort(np.concatenate(stamps), kind="stable")
        which = np.repeat(np.arange(len(plans)), [len(s) for s in stamps])[order]
        index = np.concatenate([np.arange(len(s)) for s in stamps])[order]
        topics = [c.topic for c, _, _ in plans]
        for p, k in zip(which.tolist(), index.tolist(), strict=True):
            w.write(topics[p], k + 1, int(stamps[p][k]), rows[p][k])


def _plan(r: Recording) -> list[tuple[Channel, np.ndarray, np.ndarray]]:
    """Channel, times and values of everything a recording holds."""
    parts = ("position",) if r.qd is None else ("position", "velocity")
    state = r.q if r.qd is None else np.concatenate([r.q, r.qd], axis=1)
    out = [
        (Channel(f"/{r.arm}/measured_js", "joint_state", r.joints, parts), r.t, state),
        (Channel(f"/{r.arm}/setpoint_jf", "joint_state", r.joints, ("effort",)), r.t, r.tau),
    ]
    if r.wrench is not None:
        out.append((Channel(f"/{r.arm}/measured_cf", "wrench", frame="base"), r.t, r.wrench))
    for name, values in (("external_jf", r.tau_ext),):
        if values is not None:
            channel = Channel(f"/{r.arm}/{name}", "joint_state", r.joints, ("effort",))
            out.append((channel, r.t, values))
    for name, unit, values in (
        ("motor_current", "A", r.current), ("motor_temperature", "degC", r.temperature)
    ):  # fmt: skip
        if values is not None:
            fields = tuple(f"j{k + 1}" for k in range(r.d))
            message = "hil_msgs/msg/" + name.title().replace("_", "")
            units = (unit,) * r.d
            topic = f"/{r.arm}/{name}"
            out.append(
                (Channel(topic, "fields", fields, units=units, message=message), r.t, values)
            )
    return out
