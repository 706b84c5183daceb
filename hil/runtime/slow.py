"""The slow side: drains the ring into the session, in lockstep or in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Protocol

from hil.record.ring import Ring


class RowWriter(Protocol):
    """What the slow side needs of a session file."""

    def write(self, topic: str, tick: int, t_ns: int, values: Sequence[float]) -> None:
        """Write one message."""
        ...


class SlowSide:
    """Drains rows into messages.

    Parameters
    ----------
    ring : Ring
        Rows of the fast loop.
    writer : RowWriter
        Session file.
    topics : list of (str, slice)
        Which columns of a row go to which topic.
    """

    def __init__(self, ring: Ring, writer: RowWriter, topics: list[tuple[str, slice]]) -> None:
        self._ring, self._writer, self._topics = ring, writer, topics

    def step(self) -> None:
        """Write all rows that wait."""
        stamps, data = self._ring.take()
        write, topics = self._writer.write, self._topics
        for (tick, t_ns), row in zip(stamps.tolist(), data.tolist(), strict=True):
            for topic, columns in topics:
                write(topic, tick, t_ns, row[columns])


class SlowThread:
    """Steps a `SlowSide` every `period` seconds until stopped.

    An error in the thread ends it and is raised by `stop`; rows then pile up in the ring,
    which counts what it drops.
    """

    def __init__(self, side: SlowSide, period: float) -> None:
        self._side, self._period = side, period
        self._done = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="slow", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._done.wait(self._period):
                self._side.step()
        except BaseException as error:
            self._error = error

    def stop(self) -> None:
        """Stop, drain what is left, and raise what went wrong."""
        self._done.set()
        self._thread.join()
        if self._error is not None:
            raise self._error
        self._side.step()
