"""Raw wire frames: kept while a session runs, written into it, and read again.

A frame is what went over a bus at a moment of the loop's time; `FrameLog` collects them from any
thread.
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from hil.errors import DataError, unknown
from hil.record.container import read

TOPIC = "/frames/"
SCHEMA_NAME = "hil_msgs/msg/WireFrame"
SCHEMA = (
    "builtin_interfaces/Time stamp\n"
    "uint64 loop_ns  # time of the loop that the driver was told last [ns]\n"
    "string kind  # tx to the device, rx from it, start of the loop's time, silence (no answer)\n"
    "string key  # e.g. the identifier on CAN\n"
    "uint8[] data\n" + "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
TX, RX, START, SILENCE = "tx", "rx", "start", "silence"
#: Frames that wait for the slow side at most; then they are dropped and counted.
MOST_WAITING = 500_000


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame.

    Parameters
    ----------
    t_ns : int
        Time of the loop that the driver was told last [ns].
    kind : str
        ``tx``, ``rx``, ``start``, or ``silence`` where the driver waited and nothing came.
    key : str
        What tells frames of one bus apart, e.g. the identifier on CAN.
    data : bytes
        Payload.
    """

    t_ns: int
    kind: str
    key: str = ""
    data: bytes = b""


class FrameLog:
    """Frames of one bus since the last `take`.

    Attributes
    ----------
    dropped : int
        Frames that found the log full.
    """

    def __init__(self) -> None:
        self._frames: deque[Frame] = deque()
        self._now_ns = -1
        self.dropped = 0

    def advance(self, t_ns: int) -> None:
        """It is `t_ns` now."""
        if self._now_ns < 0:
            self._frames.append(Frame(t_ns, START))
        self._now_ns = t_ns

    def add(self, kind: str, key: str, data: bytes) -> None:
        """A frame went over the bus."""
        if len(self._frames) < MOST_WAITING:
            self._frames.append(Frame(max(self._now_ns, 0), kind, key, data))
        else:
            self.dropped += 1

    def take(self) -> list[Frame]:
        """All frames that wait, oldest first."""
        return [self._frames.popleft() for _ in range(len(self._frames))]


def encode(frame: Frame, t_ns: int) -> bytes:
    """CDR of one frame with the session's stamp `t_ns`."""
    out = bytearray(struct.pack("<4siIQ", b"\x00\x01\x00\x00", t_ns // 10**9, t_ns % 10**9,
                                frame.t_ns))  # fmt: skip
    for text in (frame.kind, frame.key):
        raw = text.encode() + b"\x00"
        out += bytes(-(len(out) - 4) % 4) + struct.pack("<I", len(raw)) + raw
    out += bytes(-(len(out) - 4) % 4) + struct.pack("<I", len(frame.data)) + frame.data
    return bytes(out)


def decode(data: bytes) -> Frame:
    """Frame of a message.

    Raises
    ------
    DataError
        If the bytes are no such message.
    """
    try:
        (t_ns,) = struct.unpack_from("<Q", data, 12)
        at, parts = 20, []
        for _ in range(3):
            at += -(at - 4) % 4
            (size,) = struct.unpack_from("<I", data, at)
            parts.append(data[at + 4 : at + 4 + size])
            at += 4 + size
        if at > len(data):
            raise DataError(f"a wire frame says it has {at} bytes, and has {len(data)}")
        kind, key = (p[:-1].decode() for p in parts[:2])
    except (struct.error, UnicodeDecodeError) as error:
        raise DataError(f"not a wire frame: {error}") from error
    return Frame(t_ns, kind, key, parts[2])


def read_frames(path: str | Path, box: str) -> list[Frame]:
    """Frames of a box in a session.

    Raises
    ------
    DataError
        If the session has none of it.
    """
    topics = read(path).topics
    if TOPIC + box not in topics:
        there = [t.removeprefix(TOPIC) for t in topics if t.startswith(TOPIC)]
        hint = "" if there else " It was recorded without [record] frames = true."
        raise DataError(f"session {path}: {unknown('box with frames', box, there)}{hint}")
    return [decode(data) for data in topics[TOPIC + box].data]
