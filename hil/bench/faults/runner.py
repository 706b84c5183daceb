"""Faults struck, judged by what the records say, and the campaign as a table.

Those of device, data and law strike lockstep sessions here; those of the process and its disk
strike in real time, each in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from hil import terminal, trusted_code
from hil.bench.faults import cases
from hil.bench.faults.cases import Fault, FaultySession
from hil.errors import DataError, HilError
from hil.record.container import Container, read
from hil.record.mcap_write import SessionWriter
from hil.record.schema import decode_numbers
from hil.rig.config import load_rig
from hil.rig.cut import proven
from hil.rig.safety import BITS, named_conditions
from hil.rigs import rig_path
from hil.runtime import runner
from hil.runtime.guard import Watchdog
from hil.runtime.watchdog import report_path, tripped
from hil.signals.device import OperatingState, Status
from hil.signals.frame import TIMING, FrameLayout
from hil.terminal import Found

#: After the strike [s].
_SECONDS = 0.6
_AT = {name: k for k, name in enumerate(TIMING)}


@dataclass(frozen=True)
class Outcome:
    """What a fault led to, read from the session.

    Parameters
    ----------
    name, expected, state : str
        The fault, the state that should follow, and the state that did.
    ticks : int or None
        From the strike to that state, the tick of the strike included; None where it goes on.
    conditions : list of str
        What the record names from the strike on.
    zero : bool
        All DAC codes were zero from that state on.
    ended : str
        Last event of the session.
    lost : int
        Rows missing in the record.
    right : bool
        All as expected.
    note : str
        For the reader.
    """

    name: str
    expected: str
    state: str
    ticks: int | None
    conditions: list[str]
    zero: bool
    ended: str
    lost: int
    right: bool
    note: str = ""


def _run_fault(
    faults: Iterable[Fault], folder: Path, report: Callable[[Outcome], None] = lambda o: None
) -> list[Outcome]:
    """Run faults one after the other; sessions are written into `folder`."""
    done = []
    for fault in faults:
        done.append(one(fault, folder / "fault.mcap"))
        report(done[-1])
    return done


def one(fault: Fault, path: Path) -> Outcome:
    """Run one fault."""
    loop = {"seconds": fault.at * 1e-3 + _SECONDS, **fault.over.get("loop", {})}
    over: dict[str, Any] = {**fault.over, "loop": loop}
    if fault.wire:
        over["backend"] = "sim-wire"
    faulty = FaultySession(fault.strike, fault.at, fault.steered)
    config = load_rig(rig_path(fault.rig), over)
    # a run that wrote nothing must not be judged by the one before
    path.unlink(missing_ok=True)
    try:
        runner.run_session(
            config, None, 1, "lockstep", path, opener=faulty.open, timer=faulty.timer
        )
    except (HilError, ZeroDivisionError):
        pass  # the record, which `_judged` needs, tells how it ended
    return _judged(fault, faulty.struck, path)


def _judged(fault: Fault, struck: int, path: Path) -> Outcome:
    """What the session says, against what was expected."""
    box = read(path)
    topic = box.topics["/loop/timing"]
    ticks = np.array(topic.sequence)
    timing = decode_numbers(topic)
    raw = decode_numbers(box.topics["/rig/raw"]).reshape(len(ticks), -1, FrameLayout(1, 0).words)
    state, mask = timing[:, _AT["state"]].astype(int), timing[:, _AT["conditions"]].astype(int)
    after = ticks >= struck
    changed = np.flatnonzero(after & (state != OperatingState.ENABLED))
    first = int(changed[0]) if changed.size else None
    found = "ENABLED" if first is None else OperatingState(state[first]).name
    taken = None if first is None else int(after[: first + 1].sum())
    said = [c.name for c in named_conditions(int(np.bitwise_or.reduce(mask[after], initial=0)))]
    codes = raw[:, :, 3:6]
    zero = first is None or not codes[first:].any()
    last = json.loads(box.topics["/events"].data[-1])
    lost = int(timing[-1, _AT["dropped"]])
    right = bool(
        found == fault.state
        and (taken is None or taken <= fault.within)
        and zero
        and (not fault.condition or fault.condition in said)
        and last["name"] == fault.ends
        and np.all(np.diff(topic.times) > 0)
        and not box.truncated
        and (not fault.condition or fault.condition in BITS)
    )
    return Outcome(
        fault.name, fault.state, found, taken, said, zero, last["name"], lost, right, fault.note
    )


# ------------------------------------------------------------ faults of the process and its disk

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


def _in_the_way(path: Path) -> None:
    """Files of the names of modules lie in the working directory: who imports them is gone."""
    folder = path.with_suffix(".cwd")
    folder.mkdir(exist_ok=True)
    for name in ("json", "mmap", "subprocess", "struct", "hil", "sitecustomize"):
        (folder / f"{name}.py").write_text("raise SystemExit(0)\n")
    os.chdir(folder)


@dataclass(frozen=True)
class ProcessCase:
    """A fault of a process.

    Parameters
    ----------
    act : callable
        What the child does to itself before its session, given the path of the record.
    number, code : int
        Signal of the parent, and exit code that must follow.
    seconds : float
        Length of the session [s].
    must : str
        What must hold: ``"cut"``, ``"zero"``, ``"all"``, ``"whole"``, or a condition of
        `hil.rig.safety` that must lead to FAULT.
    watchdog : bool
        The signal strikes the watchdog, not the loop.
    wakes : bool
        The loop goes on after the cut.
    cut : str
        Shell text of the cut program; ``{path}`` is the record.
    """

    act: Callable[[Path], None]
    number: int
    code: int
    seconds: float
    must: str
    watchdog: bool = False
    wakes: bool = False
    cut: str = "true"


_KILL, _STOP = signal.SIGKILL, signal.SIGSTOP
PROCESS_CASES: dict[str, ProcessCase] = {
    "process killed (-9)": ProcessCase(_nothing, _KILL, -_KILL, SECONDS, "cut"),
    "process hangs": ProcessCase(_nothing, _STOP, -_KILL, SECONDS, "cut"),
    "process hangs until the cut": ProcessCase(
        _nothing, _STOP, 3, SECONDS, "power-cut", wakes=True
    ),
    "killed, json.py in its folder": ProcessCase(_in_the_way, _KILL, -_KILL, SECONDS, "cut"),
    "killed, cut fails at first": ProcessCase(
        _nothing, _KILL, -_KILL, SECONDS, "cut", cut="test -e {path}.on || ! touch {path}.on"
    ),
    "watchdog killed (-9)": ProcessCase(
        _nothing, _KILL, 3, SECONDS, "watchdog-lost", watchdog=True
    ),
    "watchdog hangs": ProcessCase(_nothing, _STOP, 3, SECONDS, "watchdog-lost", watchdog=True),
    "process terminated": ProcessCase(_nothing, signal.SIGTERM, 143, SECONDS, "zero"),
    "terminal closed": ProcessCase(_nothing, signal.SIGHUP, 129, SECONDS, "zero"),
    "Ctrl-C": ProcessCase(_nothing, signal.SIGINT, 130, SECONDS, "zero"),
    "disk full": ProcessCase(_limit_file, 0, 2, _ENOUGH, "whole"),
    "disk slow (0.4 s a write)": ProcessCase(_slow_disk, 0, 0, 2.0, "all"),
    "logger dies": ProcessCase(_dead_logger, 0, 1, _ENOUGH, "whole"),
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


class _Telling(runner.Session):
    """A session that prints the process of its watchdog."""

    def run(self, progress: Callable[[int], None] | None, watchdog: Watchdog | None) -> None:
        """As it is, the process first."""
        sys.stdout.write(f"watchdog {watchdog.pid if watchdog else 0}\n")
        sys.stdout.flush()
        super().run(progress, watchdog)


def child(name: str, path: Path) -> int:
    """The session of a case; prints every tenth tick, and the power as it goes off."""
    case = PROCESS_CASES[name]
    # a job in the background of a script ignores it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    words = ["sh", "-c", case.cut.format(path=path)]
    config = load_rig(rig_path("teleop"), {"safety": {"watchdog": _TIMEOUT, "cut": words}})
    # the words of this file; what is remembered is in the folder of the bench
    trusted_code.give(trusted_code.cut_program(proven(config.safety)))
    faulty = FaultySession(lambda t: None)
    case.act(path)
    faulty.js = _every_tenth()
    arranged: dict[str, Any] = {"opener": faulty.open, "operator": runner.Operator(say=_say)}
    try:
        done = runner.run_session(config, case.seconds, 1, "real", path, kind=_Telling, **arranged)
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


def in_child(name: str, folder: Path) -> Outcome:
    """Run one case in a child, strike, and look at what is left."""
    case, path = PROCESS_CASES[name], folder / "process.mcap"
    report_path(path).unlink(missing_ok=True)
    path.with_name(path.name + ".on").unlink(missing_ok=True)
    words = [sys.executable, "-m", "hil.bench.faults.runner", name, str(path)]
    last, lines, struck, guard = 0, [], 0, 0
    with tempfile.TemporaryDirectory(dir=folder) as state:
        process = subprocess.Popen(
            words,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, trusted_code.STATE_VARIABLE: state},
        )
        assert process.stdout is not None  # noqa: S101  (asked for above)
        for line in process.stdout:
            lines.append(line.strip())
            last = int(line) if line.strip().isdigit() else last
            guard = int(line.split()[1]) if line.startswith("watchdog ") else guard
            if case.number and last >= _LONG and not struck:
                struck = last
                os.kill(guard if case.watchdog else process.pid, case.number)
                if case.must == "cut" or case.wakes:
                    _await(report_path(path))
                    process.send_signal(signal.SIGCONT if case.wakes else _KILL)
        _, said = process.communicate()
    return _judge_child(name, path, last, struck, lines, said, process.returncode == case.code)


def _await(report: Path) -> None:
    until = time.monotonic() + 20.0
    while not report.exists() and time.monotonic() < until:
        time.sleep(0.01)


def _judge_child(
    name: str, path: Path, last: int, struck: int, lines: list[str], said: str, ended: bool
) -> Outcome:
    """Whether the motors were off, and how much is lost."""
    must = PROCESS_CASES[name].must
    try:
        box = read(path)
        sequence, torque = _rows(box)
        timing = decode_numbers(box.topics["/loop/timing"])
        missed = int(timing[-1, TIMING.index("missed")])
    except DataError:
        sequence, torque, missed = np.zeros(0, np.int64), False, 0
        timing = np.zeros((0, len(TIMING)))
    reached = max(int(sequence[-1]) - missed if sequence.size else 0, last)
    lost = reached - int(sequence.size)
    off, note, ticks = "off True" in lines, "", None
    # a busy machine skips ticks; what counts is how far the record reaches
    fine = lost == 0 if must == "all" else lost <= 100
    if must == "cut":
        told = tripped(report_path(path))
        off = told.get("cut") == "sh returned 0" and told.get("worked") is True
        ticks = round(1e3 * told["silent_s"]) if told.get("silent_s") else None
        note = f"watchdog: {told.get('why', 'silent')}"
    if must in BITS:
        first = _faulted(timing, sequence, must)
        ticks = None if first is None else first - struck
        note = "the record names no fault" if first is None else must
        wrote = json.loads(box.topics["/events"].data[-1])["name"] if first is not None else ""
        fine = fine and wrote == "fault" and (must != "power-cut" or "watchdog" in box.metadata)
    if must == "whole":
        about = [line for line in said.strip().splitlines() if "record" in line]
        lost = max([lost, *map(int, re.findall(r"(\d+) rows are lost", said))])
        note = about[0][:90] if about else "nothing was said of the record"
        fine = bool(sequence.size) and int(sequence[-1]) > 300 and bool(about)
    if not ended and said.strip():
        note = said.strip().splitlines()[-1][:160]
    right = off and ended and fine and torque
    state = "off" if off else "POWERED"
    how = "as it should" if ended else "wrong exit code"
    return Outcome(name, "off", state, ticks, [], off, how, lost, right, note)


def _faulted(
    timing: NDArray[np.float64], sequence: NDArray[np.int64], condition: str
) -> int | None:
    """First tick in FAULT that names the condition."""
    mask = timing[:, TIMING.index("conditions")].astype(int) & BITS[condition] != 0
    found = np.flatnonzero(mask & (timing[:, TIMING.index("state")] == OperatingState.FAULT))
    return int(sequence[found[0]]) if found.size else None


def _rows(box: Container) -> tuple[NDArray[np.int64], bool]:
    """Ticks that the record holds, and whether the motors had torque in it."""
    topic = box.topics["/rig/raw"]
    raw = decode_numbers(topic).reshape(len(topic.times), -1, FrameLayout(1, 0).words)
    return np.array(topic.sequence, np.int64), bool(raw[:, :, 3:6].any())


# ------------------------------------------------------------ the campaign

_HEAD = ("fault", "must lead to", "led to", "after", "record says", "motors", "rows lost", "")


def fault_row(o: Outcome) -> list[str]:
    """One line."""
    taken = "-" if o.ticks is None else f"{o.ticks} ms"
    said = ", ".join(o.conditions) or "-"
    note = f"; {o.note}" if o.note else ""
    verdict = "as expected" if o.right else "WRONG"
    return [
        o.name,
        o.expected,
        o.state,
        taken,
        said + note,
        "zero" if o.zero else "NOT ZERO",
        str(o.lost),
        verdict,
    ]


def verdict(outcomes: Sequence[Outcome]) -> str:
    """Sentence over all."""
    right = sum(o.right for o in outcomes)
    soon = [o.ticks for o in outcomes if o.ticks is not None and o.state in ("PAUSED", "FAULT")]
    two = sum(t <= 2 for t in soon)
    later = [
        f"{o.name} ({o.ticks})"
        for o in outcomes
        if o.state in ("PAUSED", "FAULT") and o.ticks is not None and o.ticks > 2
    ]
    return (
        f"{right} of {len(outcomes)} faults lead to the expected state; of {len(soon)} that stop "
        f"the motors in lockstep {two} do so within two ticks of the strike"
        + (f"; later, in ticks: {', '.join(later)}." if later else ".")
    )


def _fault_page(outcomes: Sequence[Outcome], command: str) -> str:
    """Page for the documentation."""
    lines = [
        "# Injected faults",
        "",
        f"Printed by `{command}`.  Every fault strikes a session with torque on the motors; state,",
        "time and conditions are read from the session that it leaves.  One tick is 1 ms; the tick",
        "of the strike counts.  `ENABLED`: the loop must go on.  `motors`: every DAC code in the",
        "record from that state on; for faults of the process, the codes and the power that its",
        "devices had when it was gone, or the watchdog that cut it (time since the last tick).",
        "The faults of encoders, law and clock strike ideal wires, those of boxes and boards",
        "simulated USB, HID and CAN, through the drivers.",
        "",
        "| " + " | ".join(_HEAD) + " |",
        "|" + "---|" * len(_HEAD),
        *("| " + " | ".join(fault_row(o)) + " |" for o in outcomes),
        "",
        verdict(outcomes),
        "",
    ]
    return "\n".join(lines)


def command(args: argparse.Namespace) -> Found:
    """Every fault of device, data and process, and the state each leads to."""
    terminal.check_page(args.report)
    live = [] if args.quick else list(PROCESS_CASES)
    total = len(cases.FAULTS) + len(live)
    with (
        tempfile.TemporaryDirectory() as folder,
        tqdm(total=total, unit="fault", disable=not sys.stderr.isatty()) as bar,
    ):
        found = _run_fault(cases.FAULTS, Path(folder), lambda _: bar.update() and None)
        for name in live:
            found.append(in_child(name, Path(folder)))
            bar.update()
    terminal.write_page(
        args.report,
        _fault_page(found, f"hil bench faults{' --quick' if args.quick else ''}"),
    )
    text = terminal.table(list(_HEAD), [fault_row(o) for o in found])
    return f"{text}\n\n{verdict(found)}", {"faults": [asdict(o) for o in found]}


if __name__ == "__main__":
    raise SystemExit(child(sys.argv[1], Path(sys.argv[2])))
