"""Faults of the process and its disk, in real time: each in a process of its own."""

from __future__ import annotations

import json
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.bench.faults.fault_injection import FaultySession
from hil.bench.faults.runner import Outcome
from hil.errors import DataError
from hil.record.container import Container, read
from hil.record.decode import decode_numbers
from hil.record.mcap_write import SessionWriter
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.runtime.watchdog import beside
from hil.signals.device import Status
from hil.signals.frame import TIMING, WORDS

#: When the parent strikes [ticks], and the watchdog's time-out [s].
_LONG, _TIMEOUT = 800, 0.25
SECONDS = 20.0
#: How long a session goes on that nobody strikes [s]: a busy machine may skip most of its ticks.
_ENOUGH = 6.0


def _limit_file(path: Path) -> None:
    """No file may grow above 150 kB, as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))


def _slow_disk(path: Path) -> None:
    """Every write takes 0.4 s."""
    flush = SessionWriter.flush

    def slow(self: SessionWriter) -> None:
        time.sleep(0.4)
        flush(self)

    SessionWriter.flush = slow  # type: ignore[method-assign]


def _dead_logger(path: Path) -> None:
    """The slow side dies of an error of its own after 400 ticks."""
    write = SessionWriter.write

    def dying(self: SessionWriter, topic: str, tick: int, *rest: object) -> None:
        if tick > 400:
            raise KeyError("the slow side dies")
        write(self, topic, tick, *rest)  # type: ignore[arg-type]

    SessionWriter.write = dying  # type: ignore[method-assign, assignment]


def _nothing(path: Path) -> None:
    """The parent does it."""


#: Name -> what the child does to itself, signal of the parent, exit code, seconds, what must hold.
CASES: dict[str, tuple[Callable[[Path], None], int, int, float, str]] = {
    "process killed (-9)": (_nothing, signal.SIGKILL, -signal.SIGKILL, SECONDS, "cut"),
    "process hangs": (_nothing, signal.SIGSTOP, -signal.SIGKILL, SECONDS, "cut"),
    "process terminated": (_nothing, signal.SIGTERM, 143, SECONDS, "zero"),
    "terminal closed": (_nothing, signal.SIGHUP, 129, SECONDS, "zero"),
    "Ctrl-C": (_nothing, signal.SIGINT, 130, SECONDS, "zero"),
    "disk full": (_limit_file, 0, 2, _ENOUGH, "whole"),
    "disk slow (0.4 s a write)": (_slow_disk, 0, 0, 2.0, "all"),
    "logger dies": (_dead_logger, 0, 1, _ENOUGH, "whole"),
}


def _every_tenth() -> Callable[..., Status]:
    """A hook on the encoders, read in any state, that prints the number of every tenth tick."""
    # the self-test reads them once before the first tick
    ticks = [-1]

    def read_out(position: object, velocity: object, status: Status) -> Status:
        ticks[0] += 1
        if ticks[0] % 10 == 0 and ticks[0]:
            sys.stdout.write(f"{ticks[0]}\n")
            sys.stdout.flush()
        return status

    return read_out


def _say(text: str) -> None:
    sys.stderr.write(text + "\n")


def child(name: str, path: Path) -> int:
    """The session of a case; prints every tenth tick, and the power as it goes off."""
    act, _, _, seconds, _ = CASES[name]
    # a job in the background of a script ignores it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    safety = {"watchdog": _TIMEOUT, "cut": ["true"]}
    config = load_rig(rig_path("teleop"), {"safety": safety})
    faulty = FaultySession(lambda t: None)
    act(path)
    faulty.js = _every_tenth()
    try:
        operator = runner.Operator(say=_say)
        done = runner.run(config, seconds, 1, "real", path, opener=faulty.open, operator=operator)
        sys.stdout.write(f"end {done.ticks + done.missed}\n")
    except KeyboardInterrupt:
        return 130
    except Exception as error:
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
        return int(getattr(error, "exit_code", 1))
    finally:
        bench = faulty.rig.bench
        off = not bench.codes.any() and bool(bench.state["parked"].all())
        sys.stdout.write(f"off {off}\n")
    return 0


def one(name: str, folder: Path) -> Outcome:
    """Run one case in a child, strike, and look at what is left."""
    _, number, code, _, must = CASES[name]
    path = folder / "process.mcap"
    beside(path).unlink(missing_ok=True)
    words = [sys.executable, "-m", "hil.bench.faults.process", name, str(path)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None  # noqa: S101  (asked for above)
    last, lines = 0, []
    for line in process.stdout:
        lines.append(line.strip())
        last = int(line) if line.strip().isdigit() else last
        if number and last >= _LONG:
            process.send_signal(number)
            number = 0
            if must == "cut":
                _await(beside(path))
                process.kill()
    _, said = process.communicate()
    return _judge(name, path, last, lines, said, process.returncode == code, must)


def _await(report: Path) -> None:
    until = time.monotonic() + 20.0
    while not report.exists() and time.monotonic() < until:
        time.sleep(0.01)


def _judge(
    name: str, path: Path, last: int, lines: list[str], said: str, ended: bool, must: str
) -> Outcome:
    """Whether the motors were off, and how much is lost."""
    try:
        box = read(path)
        sequence, torque = _rows(box)
        missed = int(decode_numbers(box.topics["/loop/timing"])[-1, TIMING.index("missed")])
    except DataError:
        sequence, torque, missed = np.zeros(0, np.int64), False, 0
    reached = max(int(sequence[-1]) - missed if sequence.size else 0, last)
    lost = reached - int(sequence.size)
    off, note, ticks = "off True" in lines, "", None
    if must == "cut":
        told = json.loads(beside(path).read_text()) if beside(path).exists() else {}
        off = told.get("cut") == "true returned 0"
        ticks = round(1e3 * told["silent_s"]) if told.get("silent_s") else None
        note = f"watchdog: {told.get('why', 'silent')}"
    fine = {
        "cut": lost <= 100,
        "zero": lost <= 100,
        "all": lost == 0,
        # a busy machine skips ticks; what counts is how far the record reaches
        "whole": bool(sequence.size) and int(sequence[-1]) > 300,
    }[must]
    if must == "whole":
        about = [line for line in said.strip().splitlines() if "record" in line]
        lost = max([lost, *map(int, re.findall(r"(\d+) rows are lost", said))])
        note = about[0][:90] if about else "nothing was said of the record"
        fine = fine and bool(about)
    if not ended and said.strip():
        note = said.strip().splitlines()[-1][:160]
    right = off and ended and fine and torque
    state = "off" if off else "POWERED"
    how = "as it should" if ended else "wrong exit code"
    return Outcome(name, "off", state, ticks, [], off, how, lost, right, note)


def _rows(box: Container) -> tuple[NDArray[np.int64], bool]:
    """Ticks that the record holds, and whether the motors had torque in it."""
    topic = box.topics["/rig/raw"]
    raw = decode_numbers(topic).reshape(len(topic.times), -1, WORDS)
    return np.array(topic.sequence, np.int64), bool(raw[:, :, 3:6].any())


if __name__ == "__main__":
    raise SystemExit(child(sys.argv[1], Path(sys.argv[2])))
