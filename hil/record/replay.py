"""A recording in place of a device: its answers in their order, at their time.

An answer also waits until the driver has asked as often as it had then; where the driver now asks
something else, that is noted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from hil.record.frames import RX, SILENCE, START, TX, Frame

#: Steps of time in which background work is done [ns].
STEP_NS = 1_000_000
#: Stream whose frames come without being asked for.
STREAMED = "bulk"
#: Differences that are kept as text.
MOST_TEXTS = 20


class Replay:
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
