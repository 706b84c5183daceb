"""The program that runs a session, and who commands it: from a page, or from the live screen.

The session is `hil run` in a process of its own: neither page nor screen stands between the loop
and its motors.  It is seen through a board in shared memory, and commanded by lines; where nobody
writes lines any more, the session pauses by itself.
"""

from __future__ import annotations

import glob
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard

from hil.errors import ConfigError, unknown
from hil.revision import PROGRAM
from hil.runtime.board import read_board
from hil.runtime.commands import OPERATOR_COMMANDS

#: Commands of the page; `stop` is everybody's, and has a way of its own.
_WORDS = ("start", "pause", "resume", "home", "stop", "set", "note", "record")
#: Silence of who commands after which the session is paused and the place is free [s].
SILENCE_S = 2.0
#: Commands a second that one page may give.
COMMAND_RATE = 20
#: Characters of a command, and lines of the program that are kept.
_LONGEST, _LINES = 200, 200


class SessionProgram(threading.Thread):
    """A session as a program: lines in, sentences out.

    Parameters
    ----------
    words : sequence of str
        Command line of `hil run`.
    """

    def __init__(self, words: Sequence[str]) -> None:
        super().__init__(daemon=True)
        self.board = Path(tempfile.mkdtemp(prefix="hil-board-")) / "board"
        self.said: deque[str] = deque(maxlen=_LINES)
        self._process = subprocess.Popen(
            [*PROGRAM, "run", *words, "--board", str(self.board), "--operator"],
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
        if self.board.parent.exists():
            shutil.rmtree(self.board.parent)

    def snapshot(self) -> tuple[int, dict[str, Any]]:
        """Number and content of its board; nothing once it was waited for."""
        return read_board(self.board)


@dataclass
class Seat:
    """Who commands: a page, when it was heard last, and its last command."""

    page: str = ""
    heard: float = -1e9
    number: int = 0
    times: deque[float] = field(default_factory=lambda: deque(maxlen=COMMAND_RATE))


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
        self._log: deque[str] = deque(maxlen=_LINES)
        self._silent = ""
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
                "disk": _disk(self.path),
                "silent": self._silent,
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
                self._seat, self._silent = Seat(page, now), ""
                self._log.append(f"{'another' if self._program else 'a'} page commands")

    def _taken(self, now: float) -> bool:
        return bool(self._seat.page) and now - self._seat.heard <= SILENCE_S

    def command(self, page: str, given: Mapping[str, Any], now: float) -> dict[str, Any]:
        """Pass on a numbered command once, however often it arrives; a stop always.

        Raises
        ------
        ConfigError
            If the page does not command, the command is none, or there are too many.
        """
        text, number = given.get("text"), given.get("number")
        if isinstance(text, str) and text.split()[:1] == ["stop"]:
            return self._stop(page, number)
        if not isinstance(text, str) or not _is_whole(number):
            raise ConfigError("a command has a number and a text")
        words = text.split()
        if not words or words[0] not in _WORDS:
            raise ConfigError(unknown("command", words[0] if words else "", _WORDS))
        if len(text) > _LONGEST or not text.isprintable():
            raise ConfigError(f"a command has at most {_LONGEST} characters, all of them printable")
        with self._lock:
            self._allowed(page, number, now)
            if number <= self._seat.number:
                return {"done": self._seat.number}
            self._seat.number = number
            if self._program is None or self._program.code is not None:
                raise ConfigError("no session is running; begin one first")
            self._tell(" ".join(words))
        return {"done": number}

    def _stop(self, page: str, number: Any) -> dict[str, Any]:
        """Stop the session: from every page, with every number, as often as it arrives.

        A first try may be lost and overtaken, so its number says nothing; a second stop does no
        harm.  What the same page said before it and what arrives after it is not done any more.
        """
        with self._lock:
            if self._program is None:
                raise ConfigError("no session is running; begin one first")
            if page == self._seat.page and _is_whole(number):
                self._seat.number = max(self._seat.number, number)
            if self._program.code is None:
                self._tell("stop")
        return {"done": number}

    def _tell(self, line: str) -> None:
        self._program.write(line)
        self._log.append(line)

    def _allowed(self, page: str, number: int, now: float) -> None:
        """Refuse a page that does not command, and one that gives too many."""
        seat = self._seat
        if page != seat.page or not self._taken(now):
            raise ConfigError("this page does not command; press Take command first")
        if number <= seat.number:
            return
        if len(seat.times) == COMMAND_RATE and now - seat.times[0] < 1.0:
            raise ConfigError(f"more than {COMMAND_RATE} commands within a second")
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
            if self._program is not None:
                self._program.wait(_PATIENCE)
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
                self._silent = f"The page that commands was not heard for {SILENCE_S:g} s"
                self._log.append(f"paused: {self._silent}")

    def close(self) -> None:
        """End the session: zero torque, file closed."""
        with self._lock:
            if self._program is not None:
                self._program.end()
                self._program.wait(20.0)


def _is_whole(number: Any) -> TypeGuard[int]:
    return isinstance(number, int) and not isinstance(number, bool)


def _disk(path: Path | None) -> dict[str, int]:
    """Bytes of a record with all its parts, and bytes that its disk has left."""
    if path is None:
        return {}
    size = 0
    for part in (path, *path.parent.glob(f"{glob.escape(path.stem)}.part*{path.suffix}")):
        try:
            size += part.stat().st_size
        except FileNotFoundError:  # it has not begun, or was taken away
            continue
    return {"record": size, "free": shutil.disk_usage(path.parent).free}


#: How often the screen is drawn, and how long a session may take to end [s].
EVERY, _PATIENCE = 0.2, 10.0
#: Part of a line: style and text.
StyledText = tuple[str, str]
_STATES = {"ENABLED": "ansigreen", "PAUSED": "ansiyellow", "FAULT": "ansired"}
HELP = "help lists the commands, the arrow keys repeat them, Ctrl-C ends the session properly"


def is_terminal() -> bool:
    """Whether a person sits before both ends of the program."""
    try:
        return all(s.isatty() for s in (sys.stdin, sys.stdout, sys.stderr))
    except (AttributeError, ValueError):  # no stream, or a closed one
        return False


def run_behind_screen(words: Sequence[str]) -> int:
    """Run `hil run` with these words behind a live screen; its exit code.

    Parameters
    ----------
    words : sequence of str
        Command line of the session, without the command itself.
    """
    from prompt_toolkit import PromptSession
    from prompt_toolkit.history import InMemoryHistory
    from prompt_toolkit.patch_stdout import patch_stdout

    program = SessionProgram(words)
    prompt: PromptSession[str] = PromptSession(
        history=InMemoryHistory(),
        completer=_completer(program),
        bottom_toolbar=lambda: formatted(
            wrapped(screen_lines(program.snapshot()[1]), shutil.get_terminal_size().columns)
        ),
        refresh_interval=EVERY,
        style=_style(),
    )
    over = threading.Event()
    watch = threading.Thread(target=_watch, args=(program, prompt, over), daemon=True)
    try:
        with patch_stdout():
            watch.start()
            _commanded(program, prompt)
            _ended(program, over)
            over.set()
            watch.join()
    finally:
        program.end()
        program.wait(_PATIENCE)
    _say(program)
    return program.code or 0


def _commanded(program: SessionProgram, prompt: Any) -> None:
    """Pass lines on until the session ends or is to end."""
    while program.code is None:
        try:
            line = prompt.prompt("hil> ").strip()
        except (KeyboardInterrupt, EOFError):
            return
        if line in ("help", "?"):
            sys.stdout.write(command_lines(program.snapshot()[1]) + "\n")
        elif line:
            program.write(line)


def _ended(program: SessionProgram, over: threading.Event) -> None:
    """Have the session end as the command stop does: zero torque, file closed, summary printed."""
    program.write("stop")
    for _ in range(int(_PATIENCE / EVERY)):
        if program.code is not None:
            return
        over.wait(EVERY)


def _watch(program: SessionProgram, prompt: Any, over: threading.Event) -> None:
    """Print what the session says; leave the line where the session has ended.

    Its summary is not for the line: it is printed when the line is gone.
    """
    while not over.wait(EVERY):
        waiting = len(program.said)
        if program.code is None:
            _say(program, waiting)
        app = prompt.app
        if program.code is not None and app.is_running and app.loop is not None:
            app.loop.call_soon_threadsafe(_leave, app)


def _leave(app: Any) -> None:
    if app.is_running and not app.future.done():
        app.exit(exception=EOFError)


def _say(program: SessionProgram, count: int | None = None) -> None:
    """Print what the session has said, or the first lines of it."""
    for _ in range(len(program.said) if count is None else count):
        sys.stdout.write(program.said.popleft() + "\n")


def _style() -> Any:
    from prompt_toolkit.styles import Style

    return Style.from_dict({"bottom-toolbar": "noreverse"})


def _completer(program: SessionProgram) -> Any:
    from prompt_toolkit.completion import Completer, Completion

    class Words(Completer):
        """Commands, and behind `set` what may be set."""

        def get_completions(self, document: Any, event: Any) -> Iterable[Any]:
            text = document.text_before_cursor
            for word in completions(text, program.snapshot()[1]):
                yield Completion(word, -len(text.rpartition(" ")[2]))

    return Words()


def completions(text: str, snapshot: Mapping[str, Any]) -> list[str]:
    """Words that may follow what is typed.

    Parameters
    ----------
    text : str
        The line up to the cursor.
    snapshot : mapping
        Of the session.
    """
    first, space, rest = text.partition(" ")
    if not space:
        return [w for w in (*OPERATOR_COMMANDS, "help") if w.startswith(first)]
    if first == "set" and " " not in rest:
        return [w for w in snapshot.get("settable", {}) if w.startswith(rest)]
    return []


def command_lines(snapshot: Mapping[str, Any]) -> str:
    """Commands, and what may be set, a line each."""
    rows = [f"  {text}" for text, _ in OPERATOR_COMMANDS.values()]
    for name, r in snapshot.get("settable", {}).items():
        count = f"{r['entries']} numbers, " if r["entries"] > 1 else ""
        rows.append(f"  set {name}: {count}{r['low']:g} to {r['high']:g} {r['unit']}".rstrip())
    return "\n".join(["commands", *rows])


def formatted(rows: Sequence[Sequence[StyledText]]) -> Any:
    """Lines as the terminal library takes them."""
    return [part for row in rows for part in (*row, ("", "\n"))][:-1]


#: Where a line of the screen may go on below: before a quantity, or behind a comma.
_BREAK = re.compile(r"(?<=\S)(?=   [a-z])|(?<=,)(?= [A-Za-z])")
#: How far to the right it goes on.
_FURTHER = 10


def wrapped(rows: Sequence[Sequence[StyledText]], wide: int) -> list[list[StyledText]]:
    """Lines that end within a terminal of so many columns; what is beyond goes on below."""
    out: list[list[StyledText]] = []
    for row in rows:
        line, used = list[StyledText](), 0
        for style, text in row:
            for piece in _BREAK.split(text):
                if used > _FURTHER and used + len(piece) > wide:
                    out.append(line)
                    line, used, piece = [("", " " * _FURTHER)], _FURTHER, piece.lstrip()
                line.append((style, piece))
                used += len(piece)
        out.append(line)
    return out


def screen_lines(snapshot: Mapping[str, Any]) -> list[list[StyledText]]:
    """The screen of a session: state, arms, tracking, loop, record.

    Parameters
    ----------
    snapshot : mapping
        As `hil.runtime.runner` publishes it; empty before the first one.
    """
    if "state" not in snapshot:
        return [
            [
                (
                    "",
                    "starting ... (compiling for up to a minute, once per installation)",
                )
            ]
        ]
    state = str(snapshot["state"])
    why = f"  {snapshot['why']}" if snapshot["why"] else ""
    rows = [
        [
            (f"bold {_STATES.get(state, '')}".strip(), f"{state}{why}"),
            ("", f"   {snapshot['seconds']:.1f} s   law {snapshot['controller']}"),
        ]
    ]
    arms = snapshot["arms"]
    wide = max([len(name) for name in arms] + [8])
    rows += [_arm(f"{name:{wide}}", arm) for name, arm in arms.items()]
    if len(arms) == 2:
        rows.append([("", f"{'tracking':{wide}}  {_tracking(list(arms.values()))}")])
    rows.append([("", f"{'loop':{wide}}  "), *_loop(snapshot)])
    off = "  OFF: record on" if snapshot.get("recording") is False else ""
    size = _size(snapshot["record"])
    rows.append([("", f"{'record':{wide}}  {snapshot['record']}  {size}{off}")])
    return [*rows, [("ansibrightblack", HELP)]]


def _arm(name: str, arm: Mapping[str, Any]) -> list[StyledText]:
    force = math.hypot(*(_number(x) for x in arm["force"]))
    yellow, red = arm["lamps"]
    level = ""
    if yellow or red:
        level = "ansigreen"
        level = "ansiyellow" if yellow and force >= yellow else level
        level = "ansired" if red and force >= red else level
    places, efforts = (
        " ".join(f"{_number(x):7.3f}" for x in arm[k]) for k in ("position", "effort")
    )
    return [
        ("", f"{name}  force "),
        (level, f"{force:7.2f} N"),
        ("", f"   position {places}   effort {efforts}"),
    ]


def _row(values: Sequence[float | None]) -> str:
    return " ".join(f"{_number(x):7.3f}" for x in values)


def _number(x: float | None) -> float:
    return math.nan if x is None else x


def _tracking(arms: Sequence[Mapping[str, Any]]) -> str:
    """Largest difference of the positions of two arms."""
    pairs = zip(arms[0]["position"], arms[1]["position"], strict=False)
    apart = [abs(_number(a) - _number(b)) for a, b in pairs]
    worst = max(range(len(apart)), key=lambda j: apart[j])
    return f"error {apart[worst]:.4f}, largest of joint {worst + 1}"


def _loop(s: Mapping[str, Any]) -> list[StyledText]:
    """Latency, misses and the ring; what must be 0 and is not stands out."""
    bad = [("missed", "missed"), ("dropped", "dropped"), ("not written", "unwritten")]
    out: list[StyledText] = [("", f"late p99 {s['late_p99_us']:.1f} us")]
    for name, key in bad:
        out += [("", "   "), ("ansired" if s[key] else "", f"{name} {s[key]}")]
    return [*out, ("", f"   ring {s['ring']:.0f}   winding {s['winding']:.0f} degC")]


def _size(path: str) -> str:
    try:
        return f"{Path(path).stat().st_size * 1e-6:.1f} MB"
    except OSError:
        return ""
