"""The process in which the studio computes: one request at a time, which can be broken off.

A broken-off request ends the process; a new one begins with the models of the old one's last
answer, so that nothing that was shown is lost.
"""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

from hil.errors import ConfigError, HilError
from hil.studio.workbench import VERBS, Inputs, StudioRung, Workbench

_SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True)
class BenchState:
    """What a new process needs to go on.

    Parameters
    ----------
    inputs : Inputs
        Sessions and first model.
    stack : tuple of StudioRung
        Models, without their comparisons.
    at : int
        Current one.
    """

    inputs: Inputs
    stack: tuple[StudioRung, ...] = ()
    at: int = 0


def checked(verb: str, given: Mapping[str, Any]) -> dict[str, str]:
    """Arguments of a request, all of them text.

    Raises
    ------
    ConfigError
        If the request is none, or has other arguments.
    """
    if verb not in VERBS:
        raise ConfigError(f"no request {verb!r}; there are {', '.join(VERBS)}")
    names = VERBS[verb]
    if set(given) != set(names) or not all(isinstance(v, str) for v in given.values()):
        wanted = ", ".join(names) or "nothing"
        raise ConfigError(f"request {verb!r} takes {wanted}, as text; got {', '.join(given)}")
    return {n: str(given[n]) for n in names}


def _serve(pipe: Connection, kept: BenchState) -> None:
    """The process: requests in, answers and what must be kept out."""
    bench = Workbench(kept.inputs, [replace(r, found=None) for r in kept.stack], kept.at)
    while True:
        try:
            verb, given = pipe.recv()
        except EOFError:
            return
        try:
            data, error = getattr(bench, verb)(**given), ""
        except HilError as failed:
            data, error = None, str(failed)
        stack = tuple(replace(r, found=None) for r in bench.stack)
        pipe.send((data, error, replace(kept, stack=stack, at=bench.at)))


class Worker:
    """Computes requests in a process of its own, one after the other.

    Parameters
    ----------
    inputs : Inputs
        What the studio was opened with.
    """

    def __init__(self, inputs: Inputs) -> None:
        self._kept = BenchState(inputs)
        self._lock = threading.Lock()
        self._process: Any = None
        self._verb, self._since, self._number = "", 0.0, 0
        self._error, self._note = "", ""
        self._state: dict[str, Any] | None = None

    def ask(self, verb: str, given: Mapping[str, Any]) -> int:
        """Begin a request; its number.

        Raises
        ------
        ConfigError
            If another one is running, or the request is none.
        """
        words = checked(verb, given)
        with self._lock:
            if self._verb:
                raise ConfigError(f"{self._verb} is running; wait for it, or cancel it")
            self._verb, self._since, self._error, self._note = verb, time.monotonic(), "", ""
            self._number += 1
            number = self._number
            if self._process is None:
                self._start()
            pipe = self._pipe
        threading.Thread(target=self._wait, args=(pipe, number, words), daemon=True).start()
        return number

    def _start(self) -> None:
        ours, theirs = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=_serve, args=(theirs, self._kept), daemon=True)
        self._process.start()
        theirs.close()
        self._pipe = ours

    def _wait(self, pipe: Connection, number: int, words: dict[str, str]) -> None:
        """Send the request and take its answer, unless it was broken off."""
        try:
            pipe.send((self._verb, words))
            data, error, kept = pipe.recv()
        except (EOFError, OSError):
            data, error, kept = None, "the computation ended before its answer", self._kept
            with self._lock:
                if number == self._number:
                    self._process = None
        with self._lock:
            if number != self._number or not self._verb:
                return
            self._verb, self._error, self._kept = "", error, kept
            if data is not None and "saved" in data:
                self._note = f"written: {data['saved']}"
            elif data is not None:
                self._state = data

    def cancel(self) -> None:
        """Break off what is running; the last answer stays."""
        with self._lock:
            if not self._verb:
                return
            self._verb, self._error = "", "cancelled"
            self._number += 1
            self._process.kill()
            self._process = None

    def status(self) -> dict[str, Any]:
        """What is running and since when [s]; number, error and note of the last request."""
        with self._lock:
            return {
                "running": self._verb,
                "seconds": time.monotonic() - self._since if self._verb else 0.0,
                "number": self._number,
                "error": self._error,
                "note": self._note,
            }

    @property
    def state(self) -> dict[str, Any] | None:
        """Last answer for the page."""
        with self._lock:
            return self._state

    def close(self) -> None:
        """End the process."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
                self._process = None
