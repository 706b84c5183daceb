"""Raw wire frames: kept while a session runs, written into it, and read again.

A frame is what went over a bus at a moment of the loop's time; `BoundedFrameLog` collects them from
any thread.

Played back, a recording takes the place of a device: its answers come in their order, at their
time.  An answer also waits until the driver has asked as often as it had then; where the driver now
asks something else, that is noted.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Sequence
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


class BoundedFrameLog:
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
    out = bytearray(
        struct.pack("<4siIQ", b"\x00\x01\x00\x00", t_ns // 10**9, t_ns % 10**9, frame.t_ns)
    )
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


#: Steps of time in which background work is done [ns].
STEP_NS = 1_000_000
#: Stream whose frames come without being asked for.
STREAMED = "bulk"
#: Differences that are kept as text.
MOST_TEXTS = 20


class RecordedAnswers:
    """Answers of a recording.

    Keys of one bus may name streams, ``stream:rest``: an answer waits for the questions of its
    own stream alone.

    Parameters
    ----------
    box : str
        Name for messages.
    frames : sequence of Frame
        In their order.

    Attributes
    ----------
    asked, other : int
        Frames that the driver has sent, and those that differ from the recording.
    differences : list of str
        The first of them in words.
    """

    def __init__(self, box: str, frames: Sequence[Frame]) -> None:
        self.box = box
        self.asked = self.other = 0
        self.differences: list[str] = []
        self._due_ns = self._paused_ns = 0
        self._start = next((f.t_ns for f in frames if f.kind == START), 0)
        self._offset: int | None = None
        self._steps: dict[str, Callable[[], object]] = {}
        self._sent: dict[str, list[Frame]] = {}
        self._put: dict[str, int] = {}
        self._answers: dict[str, deque[tuple[int, int, Frame]]] = {}
        for k, frame in enumerate(frames):
            name = stream(frame.key)
            before = self._sent.setdefault(name, [])
            if frame.kind == TX:
                before.append(frame)
            elif frame.kind in (RX, SILENCE):
                self._answers.setdefault(name, deque()).append((k, len(before), frame))

    @property
    def now_ns(self) -> int:
        """Time of the recording, and what the driver has paused [ns]."""
        return self._due_ns + self._paused_ns

    def advance(self, t_ns: int) -> None:
        """It is `t_ns` by the loop of now, which starts where that of the recording did."""
        if self._offset is None:
            self._offset, self._due_ns = self._start - t_ns, self._start
            self._work()
        end = t_ns + self._offset
        while self._due_ns < end:
            self._due_ns = min(self._due_ns + STEP_NS, end)
            self._work()

    def pause(self, seconds: float) -> None:
        """The driver waits outside of the loop."""
        self._paused_ns += round(seconds * 1e9)
        self._work()

    def run(self, name: str, step: Callable[[], object]) -> Callable[[], None]:
        """Background work of the driver: done once a step of time, and while answers are due."""
        self._steps[name] = step
        return lambda: self._steps.pop(name, None) and None

    def _work(self) -> None:
        """Background work: once, and on while more of a stream is due and is taken."""
        waiting = self._answers.get(STREAMED, ())
        for step in list(self._steps.values()):
            left = -1
            while True:
                step()
                if not self.due(STREAMED) or len(waiting) == left:
                    break
                left = len(waiting)

    def put(self, key: str, data: bytes) -> None:
        """The driver sends a frame."""
        name = stream(key)
        count, sent = self._put.get(name, 0), self._sent.get(name, [])
        if count < len(sent) and (sent[count].key, sent[count].data) != (key, data):
            then = sent[count]
            self.other += 1
            if len(self.differences) < MOST_TEXTS:
                self.differences.append(
                    f"frame {count + 1} to {self.box}: {key} {data.hex()} now, {then.key} "
                    f"{then.data.hex()} in the recording"
                )
        self._put[name] = count + 1
        self.asked += 1

    def due(self, name: str) -> bool:
        """Whether an answer of this stream is due."""
        answers = self._answers.get(name)
        if not answers:
            return False
        _, after, frame = answers[0]
        return after <= self._put.get(name, 0) and frame.t_ns <= self._due_ns

    def take(self, wait: bool, name: str = "") -> Frame | None:
        """Next answer of a stream that is due; with `wait`, that comes next at all."""
        answers = self._answers.get(name)
        while answers:
            _, after, frame = answers[0]
            if after > self._put.get(name, 0) or (frame.t_ns > self._due_ns and not wait):
                return None
            answers.popleft()
            if frame.kind == RX:
                return frame
            if wait:
                return None
        return None

    def take_any(self) -> Frame | None:
        """Next answer of whatever stream that is due."""
        ready = [(q[0][0], name) for name, q in self._answers.items() if q and self.due(name)]
        return self.take(False, min(ready)[1]) if ready else None

    @property
    def over(self) -> bool:
        """Whether every answer has been given."""
        return not any(self._answers.values())


def stream(key: str) -> str:
    """Stream of a key ``stream:rest``; empty where it has none."""
    head, colon, _ = key.partition(":")
    return head if colon else ""
