"""The live screen of `hil run`: what a session is doing, and a line to type commands.

The session runs in a process of its own, as behind the operator's page: drawing never stands
between the loop and its motors.  It is seen through a board in shared memory and commanded by
lines; where the screen is gone, it pauses by itself.
"""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.runtime.commands import COMMANDS
from hil.ui.desk import SessionProgram

#: How often the screen is drawn, and how long a session may take to end [s].
EVERY, PATIENCE = 0.2, 10.0
#: Part of a line: style and text.
Part = tuple[str, str]
_STATES = {"ENABLED": "ansigreen", "PAUSED": "ansiyellow", "FAULT": "ansired"}
HELP = "help lists the commands, the arrow keys repeat them, Ctrl-C ends the session properly"


def is_terminal() -> bool:
    """Whether a person sits before both ends of the program."""
    try:
        return all(s.isatty() for s in (sys.stdin, sys.stdout, sys.stderr))
    except (AttributeError, ValueError):  # no stream, or a closed one
        return False


def show(words: Sequence[str]) -> int:
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
        bottom_toolbar=lambda: formatted(lines(program.snapshot()[1])),
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
        program.wait(PATIENCE)
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
            sys.stdout.write(usage(program.snapshot()[1]) + "\n")
        elif line:
            program.write(line)


def _ended(program: SessionProgram, over: threading.Event) -> None:
    """Have the session end as the command stop does: zero torque, file closed, summary printed."""
    program.write("stop")
    for _ in range(int(PATIENCE / EVERY)):
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
        return [w for w in (*COMMANDS, "help") if w.startswith(first)]
    if first == "set" and " " not in rest:
        return [w for w in snapshot.get("settable", {}) if w.startswith(rest)]
    return []


def usage(snapshot: Mapping[str, Any]) -> str:
    """Commands, and what may be set, a line each."""
    rows = [f"  {text}" for text, _ in COMMANDS.values()]
    for name, r in snapshot.get("settable", {}).items():
        count = f"{r['entries']} numbers, " if r["entries"] > 1 else ""
        rows.append(f"  set {name}: {count}{r['low']:g} to {r['high']:g} {r['unit']}".rstrip())
    return "\n".join(["commands", *rows])


def formatted(rows: Sequence[Sequence[Part]]) -> Any:
    """Lines as the terminal library takes them."""
    return [part for row in rows for part in (*row, ("", "\n"))][:-1]


def lines(snapshot: Mapping[str, Any]) -> list[list[Part]]:
    """The screen of a session: state, arms, tracking, loop, record.

    Parameters
    ----------
    snapshot : mapping
        As `hil.runtime.runner` publishes it; empty before the first one.
    """
    if "state" not in snapshot:
        return [[("", "starting ...")]]
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


def _arm(name: str, arm: Mapping[str, Any]) -> list[Part]:
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


def _loop(s: Mapping[str, Any]) -> list[Part]:
    """Latency, misses and the ring; what must be 0 and is not stands out."""
    bad = [("missed", "missed"), ("dropped", "dropped"), ("not written", "unwritten")]
    out: list[Part] = [("", f"late p99 {s['late_p99_us']:.1f} us")]
    for name, key in bad:
        out += [("", "   "), ("ansired" if s[key] else "", f"{name} {s[key]}")]
    return [*out, ("", f"   ring {s['ring']:.0f}   winding {s['winding']:.0f} degC")]


def _size(path: str) -> str:
    try:
        return f"{Path(path).stat().st_size * 1e-6:.1f} MB"
    except OSError:
        return ""
