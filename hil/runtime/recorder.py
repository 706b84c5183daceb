"""The slow side: drains the ring into the files of a session, watches the state, takes commands.

In lockstep it is stepped in the same thread, in real time in one of its own.  That thread is locked
to the loop's grid, a little behind the tick, so that its work falls into the loop's sleep.

A session may lie in several files: a new one is begun by length or size, or where the one before is
gone.  Every part is a session of its own, with the same metadata, attached files and channels; its
metadata record ``part`` says which one it is, and why it was begun.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, HilError
from hil.record.mcap_write import SessionWriter
from hil.rig.safety import named_conditions, sentence
from hil.runtime.board import Ring
from hil.runtime.clock import Clock
from hil.runtime.commands import RECORD_WORDS, Workshop, parse_command
from hil.runtime.loop import Loop
from hil.runtime.statistics import Statistics
from hil.signals.device import FloatArray, OperatingState
from hil.signals.frame import FrameLayout

#: How often it is seen whether the file is still there [s].
LOOKED_S = 0.5

#: Opens a part: its file, and its metadata record ``part`` (empty: a session in one file).
OpenPart = Callable[[Path, Mapping[str, str]], SessionWriter]


def part_path(first: Path, number: int) -> Path:
    """File of part `number` (from 2 on) of a session; a file that is there is passed over."""
    while True:
        path = first.with_name(f"{first.stem}.part{number}{first.suffix}")
        if not path.exists():
            return path
        number += 1


class SessionParts:
    """The files of a session; what `RowWriter` asks for, and closing.

    Parameters
    ----------
    path : Path
        First file.
    open_part : callable
        Opens a file: (path, record ``part``) -> `SessionWriter`.
    seconds, megabytes : float
        Length and size after which a new file is begun; 0: never.
    say : callable
        Takes sentences for the operator.

    Attributes
    ----------
    paths : list of Path
        Files begun until now; absolute ones from when their folder was made anew.

    Raises
    ------
    ConfigError
        As `SessionWriter`, for the first file.
    """

    def __init__(
        self,
        path: Path,
        open_part: OpenPart,
        seconds: float = 0.0,
        megabytes: float = 0.0,
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._open, self._say = open_part, say
        self._length_ns, self._size = int(seconds * 1e9), int(megabytes * 1e6)
        split = seconds > 0.0 or megabytes > 0.0
        self.paths = [path]
        self._folder = path.absolute().parent
        self._writer = open_part(path, {"number": "1"} if split else {})
        self._begun_ns = self._looked_ns = -1

    def write(self, topic: str, tick: int, t_ns: int, values: Sequence[float]) -> None:
        """Write one message; see `SessionWriter.write`."""
        self._writer.write(topic, tick, t_ns, values)

    def write_rows(
        self,
        topics: Sequence[tuple[str, slice]],
        stamps: NDArray[np.int64],
        data: NDArray[np.float64],
    ) -> None:
        """Write messages of many rows, into a new file where it is time for one.

        See `SessionWriter.write_rows`.

        Raises
        ------
        OSError
            If the file takes no more, or no new one can be begun.
        """
        if len(stamps):
            self._turn(int(stamps[0, 0]), int(stamps[0, 1]))
        self._writer.write_rows(topics, stamps, data)

    def _turn(self, tick: int, t_ns: int) -> None:
        """Begin a new file before this row, where there is a reason to."""
        if self._begun_ns < 0:
            self._begun_ns = self._looked_ns = t_ns
        if t_ns - self._looked_ns >= LOOKED_S * 1e9:
            self._looked_ns = t_ns
            if self._writer.gone:
                self._close()  # renamed, it is a proper session
                self._next(tick, t_ns, "the file before was removed, renamed or shortened")
                return
        if 0 < self._length_ns <= t_ns - self._begun_ns:
            self._writer.close()
            self._next(tick, t_ns, "length")
        elif 0 < self._size <= self._writer.size:
            self._writer.close()
            self._next(tick, t_ns, "size")

    def _next(self, tick: int, t_ns: int, why: str) -> None:
        """Begin a new file."""
        number = len(self.paths) + 1
        if not self._folder.is_dir():  # deleted with the file
            self._folder.mkdir(parents=True, exist_ok=True)
            self._say(f"the folder {self._folder} was made anew")
            self.paths[0] = self._folder / self.paths[0].name
        path = part_path(self.paths[0], number)
        record = {
            "number": str(number),
            "first": self.paths[0].name,
            "before": self.paths[-1].name,
            "why": why,
        }
        try:
            self._writer = self._open(path, record)
        except ConfigError as error:
            raise OSError(str(error)) from error
        self.paths.append(path)
        self._begun_ns = t_ns
        self._writer.event(tick, t_ns, "part", record)
        self._say(f"the record goes on in {path}")

    def event(self, tick: int, t_ns: int, name: str, data: Mapping[str, object]) -> None:
        """Write a rare event; see `SessionWriter.event`."""
        self._writer.event(tick, t_ns, name, data)

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Add a metadata record to the last file."""
        self._writer.metadata(name, record)

    def abandon(self) -> None:
        """Give up after an error; see `SessionWriter.abandon`."""
        self._writer.abandon()

    def release(self) -> None:
        """Let go of the file without a byte more: another process writes it."""
        self._writer.release()

    def close(self) -> None:
        """Write the index of the last file and close it."""
        self._close()

    def _close(self) -> None:
        if self._writer.gone:
            self._say(f"{self.paths[-1]} is not there any more, or was shortened")
        self._writer.close()


def _outcome(text: str, before: OperatingState, now: OperatingState) -> str:
    """What a command came to, for the operator."""
    if text == "home" and now is OperatingState.PAUSED:
        return f"{now.name}, as before: resume first, home does not leave a pause of the safety"
    kept = text.startswith(("set ", "record "))
    done = kept or (text == "home" and now is OperatingState.ENABLED)
    if done or before is not now:
        return f"done, {now.name}"
    return f"{now.name}, as before"


class RowWriter(Protocol):
    """What the slow side needs of a session file."""

    def write(self, topic: str, tick: int, t_ns: int, values: Sequence[float]) -> None:
        """Write one message."""
        ...

    def write_rows(
        self,
        topics: Sequence[tuple[str, slice]],
        stamps: NDArray[np.int64],
        data: NDArray[np.float64],
    ) -> None:
        """Write messages of several topics for many rows: stamps (n, 2), data (n, width)."""
        ...

    def event(self, tick: int, t_ns: int, name: str, data: Mapping[str, object]) -> None:
        """Write a rare event."""
        ...

    def abandon(self) -> None:
        """Give up, keeping what is whole."""
        ...


class SlowSide:
    """Drains rows into messages, and carries commands to the loop.

    Parameters
    ----------
    loop : Loop
        The fast loop.
    ring : Ring
        Its rows.
    writer : RowWriter
        Session file.
    topics, slow_topics : list of (str, slice)
        Which columns of every row, and of the last row of a burst, go to which topic.
    layout : FrameLayout
        Of the rows.
    statistics : Statistics
        Takes the timing.
    shop : Workshop
        Makes what commands need.
    schedule : list of (float, str)
        Commands and their times [s].
    say : callable
        Takes sentences for the operator.
    stamp : callable
        Time of a tick [ns].

    Attributes
    ----------
    shop : Workshop
        Makes what commands need.
    inbox : deque of str
        Lines of the operator.
    unwritten : int
        Rows that came from the loop but not into the file.
    trouble : OSError or None
        Why nothing is written any more.
    recording : bool
        Whether rows are written; events are, always.
    left_out : int
        Rows that the operator did not want recorded.
    """

    def __init__(
        self,
        loop: Loop,
        ring: Ring,
        writer: RowWriter,
        topics: list[tuple[str, slice]],
        slow_topics: list[tuple[str, slice]],
        layout: FrameLayout,
        statistics: Statistics,
        shop: Workshop,
        schedule: Sequence[tuple[float, str]] = (),
        say: Callable[[str], None] = lambda text: None,
        stamp: Callable[[int], int] = lambda tick: 0,
    ) -> None:
        self._loop, self._ring, self._writer, self._say = loop, ring, writer, say
        self._topics, self._slow_topics = topics, slow_topics
        self._timing = layout.part("timing")
        self.statistics, self.shop = statistics, shop
        self._schedule = deque(schedule)
        self.inbox: deque[str] = deque()
        self.unwritten = self.left_out = 0
        self.trouble: OSError | None = None
        self.recording = True
        self._state, self._mask = 0, 0
        self._stamp = stamp
        #: Last row that came from the loop; empty before the first.
        self.row: FloatArray = np.zeros(0)
        self._noted: deque[tuple[int, int, str]] = deque()

    def note(self, tick: int, t_ns: int, name: str) -> None:
        """Have an event written ahead of the next rows."""
        self._noted.append((tick, t_ns, name))

    def rehearse(self) -> None:
        """Do what a step does with rows, without any, before there is power.

        Loads compiled code, which the loop of a lockstep session would be kept waiting for.
        """
        self._writer.write_rows(self._topics, *self._ring.take())

    def step(self, seconds: float) -> None:
        """Write all rows that wait, then pass on commands that are due at `seconds`."""
        stamps, data = self._ring.take()
        timing = data[:, self._timing]
        if len(data):
            self.row = data[-1].copy()
        self.statistics.add(stamps[:, 0], timing)
        try:
            while self._noted and self.trouble is None:
                self._writer.event(*self._noted.popleft(), {})
            self._write(stamps, data)
            self._changes(stamps.tolist(), timing)
        except OSError as error:
            self._give_up(error, len(data))
        while self._schedule and self._schedule[0][0] <= seconds:
            self.inbox.append(self._schedule.popleft()[1])
        while self.inbox:
            self._pass_on(self.inbox.popleft())

    def _write(self, stamps: NDArray[np.int64], data: FloatArray) -> None:
        if self.trouble is not None:
            self.unwritten += len(stamps)
            return
        if not len(stamps):
            return
        if not self.recording and not np.any(data[:, self._timing][:, 5] == OperatingState.FAULT):
            self.left_out += len(stamps)
            return
        self._writer.write_rows(self._topics, stamps, data)
        tick, t_ns = int(stamps[-1, 0]), int(stamps[-1, 1])
        for topic, columns in self._slow_topics:
            self._writer.write(topic, tick, t_ns, data[-1, columns].tolist())

    def _changes(self, stamps: list[list[int]], timing: FloatArray) -> None:
        """Events for new states and conditions, and for commands that the loop has obeyed."""
        found: list[tuple[int, int, str, dict[str, object]]] = []
        if not self._loop.applied and np.all(timing[:, 5:7] == (self._state, self._mask)):
            return
        for k in np.flatnonzero(
            np.any(np.diff(timing[:, 5:7], axis=0, prepend=[[self._state, self._mask]]), axis=1)
        ).tolist():
            state, mask = int(timing[k, 5]), int(timing[k, 6])
            names = [c.name for c in named_conditions(mask)]
            found.append(
                (
                    *stamps[k],
                    "state",
                    {  # type: ignore[arg-type]
                        "state": OperatingState(state).name,
                        "conditions": names,
                    },
                )
            )
            if state != self._state and state > OperatingState.ENABLED and mask:
                self._say(f"tick {stamps[k][0]}: {OperatingState(state).name}: {sentence(mask)}")
            self._state, self._mask = state, mask
        while self._loop.applied:
            tick, text, before, now = self._loop.applied.popleft()
            found.append((tick, self._stamp(tick), "command", {"text": text}))
            if text.startswith("record "):
                self.recording = RECORD_WORDS[text.split()[1]]
            self._say(f"tick {tick}: {text}: {_outcome(text, before, now)}")
        for event in found if self.trouble is None else ():
            self._writer.event(*event)

    def _pass_on(self, text: str) -> None:
        """One line of the operator: made ready here, applied by the loop between two ticks."""
        try:
            self._loop.mailbox.append(parse_command(text, self.shop))
        except HilError as error:
            self._say(str(error))

    def died(self, error: BaseException) -> None:
        """Tell the operator that this side is dead, while the loop goes on."""
        self._say(
            f"the slow side died ({type(error).__name__}: {error}); the loop goes on without "
            "record and without commands, and the ring counts what it drops"
        )

    def _give_up(self, error: OSError, rows: int) -> None:
        """The file takes no more: say so, keep what is whole, let the loop go on."""
        self.trouble = error
        self.unwritten += rows
        self._say(
            f"the session is not recorded any more ({error.strerror or error}); the loop goes on "
            "and every row lost is counted"
        )
        self._writer.abandon()


#: Behind the tick, in periods of the loop: after its work, before its next wake-up.
PHASE = 0.3


class SlowThread:
    """Steps a `SlowSide` on the loop's grid until stopped.

    An error in the thread ends it and is raised by `stop`; rows then pile up in the ring,
    which counts what it drops.

    Parameters
    ----------
    side : SlowSide
        What it steps.
    clock : Clock
        Its grid is that of the loop.
    period, tick : float
        Of this thread and of the loop [s].
    duties : callable
        Called with the time [s] at every step.
    prepare : callable
        Called once in the thread, first.
    """

    def __init__(
        self,
        side: SlowSide,
        clock: Clock,
        period: float,
        tick: float,
        duties: Callable[[float], None] = lambda seconds: None,
        prepare: Callable[[], None] = lambda: None,
    ) -> None:
        self._duties, self._prepare = duties, prepare
        self._side, self._clock, self._period, self._phase = side, clock, period, PHASE * tick
        self._done, self._going = threading.Event(), threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="slow", daemon=True)

    def start(self) -> None:
        """Start the thread, before the clock: it gets ready and waits for `go`."""
        self._thread.start()

    def go(self) -> None:
        """The clock runs."""
        self._going.set()

    def _run(self) -> None:
        try:
            self._prepare()
            self._going.wait()
            while not self._done.is_set():
                now = self._clock.since_start() * 1e-9 - self._phase
                time.sleep(self._period - now % self._period)
                self._duties(now)
                self._side.step(now)
        except BaseException as error:
            self._error = error
            self._side.died(error)

    def stop(self) -> None:
        """Stop, drain what is left, and raise what went wrong."""
        self._done.set()
        self._going.set()
        if self._thread.ident is not None:
            self._thread.join()
        if self._error is not None:
            raise self._error
        self._side.step(self._clock.since_start() * 1e-9)
