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

from hil import progress
from hil.errors import ConfigError, HilError
from hil.interrupt import held_back
from hil.studio.session import VERBS, StudioSession
from hil.studio.workbench import Inputs, StudioRung

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
    table : str
        Table whose columns are being picked.
    written, effects : tuple of str
        Files of own effects, and names of these.
    """

    inputs: Inputs | None
    stack: tuple[StudioRung, ...] = ()
    at: int = 0
    table: str = ""
    written: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reached:
    """How far a request has come.

    Parameters
    ----------
    what : str
        What is done now.
    share : float
        Share of the work that is done, 0 to 1.
    """

    what: str
    share: float


@dataclass(frozen=True)
class FirstLook:
    """What can be shown before a request is done.

    Parameters
    ----------
    ladder : list of dict
        Rungs with the new model, over the noise floor of the one before.
    """

    ladder: list[dict[str, Any]]


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
    stack = [replace(r, found=None) for r in kept.stack]
    session = StudioSession(kept.inputs, stack, kept.at, kept.table, kept.written, kept.effects)
    session.early = lambda rows: pipe.send(FirstLook(rows))
    with progress.listening(lambda what, share: pipe.send(Reached(what, share))):
        while True:
            try:
                verb, given = pipe.recv()
            except EOFError:
                return
            try:
                data, error = session.ask(verb, given), ""
            except HilError as failed:
                data, error = None, str(failed)
            pipe.send((data, error, _kept(session)))


def _kept(session: StudioSession) -> BenchState:
    """What a new process would need."""
    of_files = session.table, session.written, session.effects
    bench = session.bench
    if bench is None:
        return BenchState(None, (), 0, *of_files)
    stack = tuple(replace(r, found=None) for r in bench.stack)
    return BenchState(bench.inputs, stack, bench.at, *of_files)


class Worker:
    """Computes requests in a process of its own, one after the other.

    Parameters
    ----------
    inputs : Inputs or None
        What the studio was opened with; None: sessions come through the page.
    table : str
        Table whose columns are to be picked.
    """

    def __init__(self, inputs: Inputs | None, table: str = "") -> None:
        self._kept = BenchState(inputs, table=table)
        self._lock = threading.Lock()
        self._process: Any = None
        self._verb, self._since, self._number = "", 0.0, 0
        self._error, self._note = "", ""
        self._state: dict[str, Any] | None = None
        self._intake: dict[str, Any] | None = None
        self._preview: dict[str, Any] | None = None
        self._reached, self._look = Reached("", 0.0), FirstLook([])

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
            self._reached, self._look = Reached("", 0.0), FirstLook([])
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
        with held_back():  # an interruption is for the server, which ends this process
            self._process.start()
        theirs.close()
        self._pipe = ours

    def _wait(self, pipe: Connection, number: int, words: dict[str, str]) -> None:
        """Send the request and take its answer, unless it was broken off."""
        try:
            pipe.send((self._verb, words))
            while isinstance(answer := pipe.recv(), Reached | FirstLook):
                if isinstance(answer, FirstLook):
                    self._look = answer
                else:
                    self._reached = answer
            data, error, kept = answer
        except (EOFError, OSError):
            data, error, kept = None, "the computation ended before its answer", self._kept
            with self._lock:
                if number == self._number:
                    self._process = None
        with self._lock:
            if number != self._number or not self._verb:
                return
            self._verb, self._error, self._kept = "", error, kept
            if data is not None:
                self._take(data)

    def _take(self, data: dict[str, Any]) -> None:
        """Keep an answer where the page looks for it."""
        if "saved" in data:
            self._note = ". ".join([f"written: {data['saved']}", *data.get("notes", ())])
        elif "intake" in data:
            self._intake, self._preview = data["intake"], None
        elif "preview" in data:
            self._preview = data["preview"]
        else:
            self._state, self._intake, self._preview = data, None, None

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
                "doing": self._reached.what,
                "share": self._reached.share,
                "ladder": self._look.ladder if self._verb else [],
                "error": self._error,
                "note": self._note,
            }

    @property
    def state(self) -> dict[str, Any] | None:
        """Last answer for the page."""
        with self._lock:
            return self._state

    @property
    def files(self) -> dict[str, Any]:
        """The table whose columns are being picked, and what its last picks would give."""
        with self._lock:
            return {"intake": self._intake, "preview": self._preview}

    def close(self) -> None:
        """End the process."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
                self._process = None
