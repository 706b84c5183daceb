"""Who commands, what was commanded, and the program that runs the session.

The session is `hil run` in a process of its own: the page never stands between the loop and its
motors.  It is seen through a board in shared memory, and commanded by lines; where nobody writes
lines any more, the session pauses by itself.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.errors import ConfigError, unknown
from hil.runtime.board import read_board

#: Commands of the page; `stop` is everybody's.
WORDS = ("start", "pause", "resume", "home", "stop", "set", "note", "record")
#: Silence of who commands after which the session is paused and the place is free [s].
SILENCE = 2.0
#: Commands a second that one page may give.
RATE = 20
#: Characters of a command, and lines of the program that are kept.
LONGEST, LINES = 200, 200


class SessionProgram(threading.Thread):
    """A session as a program: lines in, sentences out.

    Parameters
    ----------
    words : sequence of str
        Command line of `hil run`.
    """

    def __init__(self, words: Sequence[str]) -> None:
        super().__init__(daemon=True)
        folder = Path(tempfile.mkdtemp(prefix="hil-board-"))
        self.board = folder / "board"
        self.said: deque[str] = deque(maxlen=LINES)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hil", "run", *words, "--board", str(self.board), "--operator"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )
        self.start()

    def run(self) -> None:
        """Keep what it says until it ends."""
        out = self._process.stdout
        if out is None:
            raise RuntimeError("the program has no output")
        for line in out:
            text = line.rpartition("\r")[2].strip()
            if text:
                self.said.append(text)

    def write(self, line: str) -> None:
        """Give it a line; nothing where it has ended."""
        pipe = self._process.stdin
        if pipe is None or self._process.poll() is not None:
            return
        try:
            pipe.write(line + "\n")
            pipe.flush()
        except OSError:  # it ended between the question and the line
            return

    @property
    def code(self) -> int | None:
        """Exit code; None while it runs."""
        return self._process.poll()

    def end(self) -> None:
        """Have it end: zero torque, file closed."""
        if self._process.poll() is None:
            self._process.terminate()

    def wait(self, seconds: float) -> None:
        """Wait for its end."""
        self._process.wait(seconds)
        self.join(seconds)  # it reads to the end
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def snapshot(self) -> tuple[int, dict[str, Any]]:
        """Number and content of its board."""
        return read_board(self.board)


@dataclass
class Seat:
    """Who commands: a page, when it was heard last, and its last command."""

    page: str = ""
    heard: float = -1e9
    number: int = 0
    times: deque[float] = field(default_factory=lambda: deque(maxlen=RATE))


class Desk:
    """Lease, commands and heartbeat of the pages, and the session behind them.

    Parameters
    ----------
    words : sequence of str
        Command line of `hil run` without its output.
    output : callable
        File of the next session.
    program : callable
        Starts a session from a command line; a test gives another.
    """

    def __init__(
        self,
        words: Sequence[str],
        output: Callable[[], Path],
        program: Callable[[Sequence[str]], Any] = SessionProgram,
    ) -> None:
        self._words, self._output, self._make = list(words), output, program
        self._lock = threading.Lock()
        self._seat = Seat()
        self._program: Any = None
        self._log: deque[str] = deque(maxlen=LINES)
        self.path: Path | None = None

    def view(self, page: str, now: float) -> dict[str, Any]:
        """What a page shows; the call is its heartbeat."""
        with self._lock:
            if page == self._seat.page:
                self._seat.heard = now
            number, snapshot = self._program.snapshot() if self._program else (0, {})
            code = self._program.code if self._program else None
            said = list(self._program.said) if self._program else []
            return {
                "number": number,
                "session": snapshot,
                "running": self._program is not None and code is None,
                "code": code,
                "record": str(self.path or ""),
                "said": said[-12:],
                "log": list(self._log)[-12:],
                "commands": page == self._seat.page,
                "free": not self._taken(now),
            }

    def take(self, page: str, now: float) -> None:
        """Give the command to a page.

        Raises
        ------
        ConfigError
            If another page has it and was heard.
        """
        with self._lock:
            if self._seat.page != page and self._taken(now):
                raise ConfigError("another page commands; it must be closed, or be silent, first")
            if self._seat.page != page:
                self._seat = Seat(page, now)
                self._log.append("this page commands now" if not self._program else "new page")

    def _taken(self, now: float) -> bool:
        return bool(self._seat.page) and now - self._seat.heard <= SILENCE

    def command(self, page: str, given: Mapping[str, Any], now: float) -> dict[str, Any]:
        """Pass on a numbered command once, however often it arrives.

        Raises
        ------
        ConfigError
            If the page does not command, the command is none, or there are too many.
        """
        text, number = given.get("text"), given.get("number")
        if not isinstance(text, str) or not isinstance(number, int) or isinstance(number, bool):
            raise ConfigError("a command has a number and a text")
        words = text.split()
        if not words or words[0] not in WORDS:
            raise ConfigError(unknown("command", words[0] if words else "", WORDS))
        if len(text) > LONGEST or not text.isprintable():
            raise ConfigError(f"a command has at most {LONGEST} characters, all of them printable")
        with self._lock:
            # an emergency asks nobody
            if words[0] != "stop":
                self._allowed(page, number, now)
            if page == self._seat.page:
                if number <= self._seat.number:
                    return {"done": self._seat.number}
                self._seat.number = number
            if self._program is None or self._program.code is not None:
                raise ConfigError("no session is running; begin one first")
            self._program.write(" ".join(words))
            self._log.append(" ".join(words))
        return {"done": number}

    def _allowed(self, page: str, number: int, now: float) -> None:
        """Refuse a page that does not command, and one that gives too many."""
        seat = self._seat
        if page != seat.page or not self._taken(now):
            raise ConfigError("this page does not command; press Take command first")
        if number <= seat.number:
            return
        if len(seat.times) == RATE and now - seat.times[0] < 1.0:
            raise ConfigError(f"more than {RATE} commands within a second")
        seat.times.append(now)

    def begin(self, page: str, now: float) -> None:
        """Begin a session that waits for start.

        Raises
        ------
        ConfigError
            If the page does not command, or a session is running.
        """
        with self._lock:
            if page != self._seat.page or not self._taken(now):
                raise ConfigError("this page does not command; press Take command first")
            if self._program is not None and self._program.code is None:
                raise ConfigError("a session is running; stop it first")
            self.path = self._output()
            self._program = self._make([*self._words, "--wait", "-o", str(self.path)])
            self._log.append(f"session {self.path}")

    def watch(self, now: float) -> None:
        """Pause a session whose page is silent; called a few times a second."""
        with self._lock:
            if not self._seat.page or self._taken(now):
                return
            self._seat = Seat()
            if self._program is not None and self._program.code is None:
                self._program.write("pause")
                self._log.append(f"paused: the page that commands was not heard for {SILENCE:g} s")

    def close(self) -> None:
        """End the session: zero torque, file closed."""
        with self._lock:
            if self._program is not None:
                self._program.end()
                self._program.wait(20.0)
