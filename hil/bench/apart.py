"""A session whose slow side is a process of its own, over a ring in shared memory: for measuring.

The process is forked before the loop is arranged, writes the same file, and takes no commands:
what it lacks would not make the loop later.
"""

from __future__ import annotations

import json
import mmap
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import DeviceError
from hil.record.ring import Ring
from hil.runtime import runner, session
from hil.runtime.realtime import arranged

#: Words that both processes see: rows in, rows out, time of tick 0, the loop has ended.
_HEAD, _TAIL, _EPOCH, _OVER, _WORDS = 0, 1, 2, 3, 8


class SharedRing(Ring):
    """A `Ring` whose rows and counters lie in memory that a forked process shares."""

    def __init__(self, rows: int, width: int) -> None:
        size = 8 * (_WORDS + rows * (2 + width))
        self._memory = mmap.mmap(-1, size)
        whole = np.frombuffer(self._memory, np.int64)
        self.words: NDArray[np.int64] = whole[:_WORDS]
        super().__init__(rows, width)
        stamps = whole[_WORDS : _WORDS + 2 * rows].reshape(rows, 2)
        self._stamps = stamps
        self._data = whole[_WORDS + 2 * rows :].view(np.float64).reshape(rows, width)

    @property
    def _head(self) -> int:
        return int(self.words[_HEAD])

    @_head.setter
    def _head(self, value: int) -> None:
        self.words[_HEAD] = value

    @property
    def _tail(self) -> int:
        return int(self.words[_TAIL])

    @_tail.setter
    def _tail(self, value: int) -> None:
        self.words[_TAIL] = value


class Apart(runner.Session):
    """`hil.runtime.runner.Session` with the slow side in a process."""

    ring_type = SharedRing

    def _real(self, progress: Callable[[int], None] | None) -> None:
        """Fast loop in this process, the slow side in a forked one."""
        words = self._words()
        told, tell = os.pipe()
        child = os.fork()
        if child == 0:
            self._child(words, tell)
        os.close(tell)
        self.writer.release()
        try:
            with arranged(self.config.loop.realtime) as self.arrangement:
                self._enable()
                words[_EPOCH] = self.timer.epoch_ns
                while not self.over():
                    self.loop.step()
        finally:
            try:
                self._release()
            finally:
                words[_OVER] = 1
                self._figures = _received(told, child)

    def _words(self) -> NDArray[np.int64]:
        ring: Any = self.ring
        return np.asarray(ring.words)

    def _child(self, words: NDArray[np.int64], tell: int) -> None:
        """Drain at the slow rate until the loop has ended, close the file, tell the figures."""
        code = 1
        try:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            others = os.sched_getaffinity(0)
            if len(others) > 1:
                os.sched_setaffinity(0, others - {max(others)})
            while not words[_EPOCH]:
                time.sleep(1e-3)
            self.slow.note(0, int(words[_EPOCH]), "enabled")
            while not words[_OVER]:
                time.sleep(1.0 / self.config.loop.slow_hz)
                self.slow.step(0.0)
            self.slow.step(0.0)
            session.conclude(self.writer, self.statistics, self.arrangement)
            self.writer.close()
            os.write(tell, json.dumps(self.statistics.figures().as_dict()).encode())
            code = 0
        finally:
            os._exit(code)

    def _finish(self, name: str, told: dict[str, object]) -> None:
        """The process has closed the file."""

    def figures(self) -> dict[str, float]:
        """As the process has counted them."""
        return self._figures


def _received(pipe: int, child: int) -> dict[str, float]:
    """Figures from the process, once it has ended."""
    with os.fdopen(pipe, "rb") as file:
        text = file.read()
    _, status = os.waitpid(child, 0)
    if status or not text:
        raise DeviceError(f"the process of the slow side ended with status {status}")
    return dict(json.loads(text))
