"""A rig for hours in real time with recording, and a thousand starts: memory, latency, lost rows.

The session is the program's own, `hil run --clock real`, in a process of its own; its memory is
read from outside once a minute.  The latency of every minute comes from the session afterwards, a
message at a time.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from tqdm import tqdm

from hil import terminal
from hil.errors import ConfigError, DeviceError
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.runtime.statistics import Histogram
from hil.terminal import Found

_RIG, _TIMING = "teleop", "/loop/timing"
#: Length of one start and stop [s], and after how many memory is read.
_SHORT, _EVERY = 0.05, 100
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Minute:
    """One part of the session.

    Parameters
    ----------
    at : float
        Its end [min].
    memory : float
        Resident memory of the process at its end [10^6 byte].
    late_p50, late_p99 : float
        Lateness of the wake-ups within it [us].
    """

    at: float
    memory: float
    late_p50: float
    late_p99: float


@dataclass(frozen=True)
class Soak:
    """Result of both parts.

    Parameters
    ----------
    hours : float
        Length of the session [h].
    parts : list of Minute
        In order.
    ticks, missed, dropped, unwritten : int
        Ticks run, periods skipped, rows that the ring did not take, rows that the disk did not.
    megabytes : float
        Size of the session [10^6 byte].
    starts : int
        Sessions started and stopped in one process.
    start_memory : list of float
        Resident memory [10^6 byte] after the first one and after each hundred.
    files, threads : tuple of int
        Open files and threads after the first start and after the last.
    """

    hours: float
    parts: list[Minute]
    ticks: int
    missed: int
    dropped: int
    unwritten: int
    megabytes: float
    starts: int
    start_memory: list[float]
    files: tuple[int, int]
    threads: tuple[int, int]


def soak(hours: float, starts: int, done: Callable[[], object] = lambda: None) -> Soak:
    """Run the rig for `hours` in real time, then start and stop it `starts` times in lockstep.

    Raises
    ------
    DeviceError
        If the session does not end well.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "soak.mcap"
        seconds = 3600.0 * hours
        part = min(60.0, seconds / 4)
        memory, summary = _session(path, seconds, part, done)
        late = _latencies(path, part, len(memory))
        size = path.stat().st_size * 1e-6
        grown, files, threads = _starts(starts, Path(folder), done)
    parts = [
        Minute((k + 1) * part / 60.0, m, h.quantile(0.5) * 1e-3, h.quantile(0.99) * 1e-3)
        for k, (m, h) in enumerate(zip(memory, late, strict=True))
    ]
    ticks, missed, dropped, unwritten = (
        int(summary[k]) for k in ("ticks", "missed", "dropped", "unwritten")
    )
    record = (ticks, missed, dropped, unwritten, size)
    return Soak(hours, parts, *record, starts, grown, files, threads)


def resident(pid: int | str = "self") -> float:
    """Resident memory of a process [10^6 byte]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE * 1e-6


def _session(
    path: Path, seconds: float, part: float, done: Callable[[], object]
) -> tuple[list[float], dict[str, float]]:
    """Memory at the end of every part, and the summary that the program printed."""
    words = ["run", _RIG, "--clock", "real", "--seconds", f"{seconds:g}", "--json", "-o", str(path)]
    with subprocess.Popen(
        [sys.executable, "-m", "hil", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as run:
        memory: list[float] = []
        while not path.exists() and run.poll() is None:
            time.sleep(0.05)
        began = time.monotonic()
        for k in range(int(seconds / part)):
            time.sleep(max(0.0, began + (k + 1) * part - 0.1 - time.monotonic()))
            if run.poll() is not None:
                break
            memory.append(resident(run.pid))
            done()
        said, trouble = run.communicate()
    if run.returncode:
        raise DeviceError(
            f"the session of {seconds:g} s ended with exit code {run.returncode}: {trouble.strip()}"
        )
    summary: dict[str, float] = json.loads(said)
    return memory, summary


def _latencies(path: Path, part: float, parts: int) -> list[Histogram]:
    """Lateness of the wake-ups [ns] in every part; a message at a time, whatever the length."""
    out = [Histogram() for _ in range(parts)]
    waiting: list[list[float]] = [[] for _ in range(parts)]
    with path.open("rb") as file:
        first = None
        for _, _, message in make_reader(file).iter_messages(topics=[_TIMING]):
            first = message.log_time if first is None else first
            k = min(int((message.log_time - first) * 1e-9 / part), parts - 1)
            # CDR: header (4), stamp (8), then the row of `hil.signals.frame.TIMING`
            waiting[k].append(float(np.frombuffer(message.data, "<f8", 1, 12)[0]))
            if len(waiting[k]) >= 60_000:
                out[k].add(np.array(waiting[k]))
                waiting[k] = []
    for histogram, rest in zip(out, waiting, strict=True):
        histogram.add(np.array(rest))
    return out


def _starts(
    starts: int, folder: Path, done: Callable[[], object]
) -> tuple[list[float], tuple[int, int], tuple[int, int]]:
    """Memory after the first start and each hundred; open files and threads, first and last."""
    config, path = load_rig(rig_path(_RIG)), folder / "start.mcap"
    runner.run_session(config, _SHORT, 1, "lockstep", path)
    memory, files, threads = [resident()], _open_files(), threading.active_count()
    for k in range(1, starts):
        runner.run_session(config, _SHORT, 1, "lockstep", path)
        if (k + 1) % _EVERY == 0:
            memory.append(resident())
            done()
    return memory, (files, _open_files()), (threads, threading.active_count())


def _open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


def steps(hours: float, starts: int) -> int:
    """How often `soak` says that a part is done."""
    seconds = 3600.0 * hours
    return int(seconds / min(60.0, seconds / 4)) + starts // _EVERY


_HEAD = ("minute", "memory MB", "late p50 us", "late p99 us")


def rows(found: Soak) -> list[list[str]]:
    """Rows of the table: every part of a short session, about twenty of a long one."""
    stride = max(1, len(found.parts) // 20)
    chosen = [m for k, m in enumerate(found.parts) if k % stride == 0 or m is found.parts[-1]]
    return [
        [f"{m.at:.3g}", f"{m.memory:.1f}", f"{m.late_p50:.1f}", f"{m.late_p99:.0f}"] for m in chosen
    ]


def verdict(found: Soak) -> str:
    """What came out, in sentences."""
    minutes = np.array([m.at for m in found.parts])
    memory = np.array([m.memory for m in found.parts])
    # after the first quarter: imports and compiled code are loaded by then
    late = slice(len(minutes) // 4, None)
    growth = "Too short a session to say how memory grows."
    if len(minutes) > 4:
        slope = float(np.polyfit(minutes[late], memory[late], 1)[0])
        growth = f"Memory grows by {slope:.2f} MB a minute after the first quarter."
    grown = found.start_memory
    return "\n".join(
        [
            f"{found.ticks} ticks in {found.hours:g} h: {found.missed} missed, {found.dropped} "
            f"rows dropped by the ring, {found.unwritten} not written; session of "
            f"{found.megabytes:.0f} MB.",
            growth,
            f"{found.starts} starts and stops: memory {grown[0]:.1f} to {grown[-1]:.1f} MB, open "
            f"files {found.files[0]} to {found.files[1]}, threads {found.threads[0]} to "
            f"{found.threads[1]}.",
        ]
    )


def page(found: Soak, command: str) -> str:
    """Page for the documentation."""
    table = [
        "| " + " | ".join(_HEAD) + " |",
        "|" + "---|" * len(_HEAD),
        *("| " + " | ".join(r) + " |" for r in rows(found)),
    ]
    title = [
        "# Hours in real time",
        "",
        f"Printed by `{command}`: the teleoperation rig with ideal",
    ]
    title += ["wires, in real time with full recording; then starts and stops in one process.", ""]
    return "\n".join([*title, *table, "", verdict(found), ""])


def as_dict(found: Soak) -> dict[str, object]:
    """For JSON."""
    return asdict(found)


def command(args: argparse.Namespace) -> Found:
    """Hours in real time with recording, then starts and stops: memory, latency, lost rows."""
    terminal.check_page(args.report)
    if not (args.hours > 0.0 and args.starts > 0):
        raise ConfigError(f"--hours {args.hours:g} --starts {args.starts}: both must be above zero")
    total = steps(args.hours, args.starts)
    with tqdm(total=total, unit="part", disable=not sys.stderr.isatty()) as bar:
        found = soak(args.hours, args.starts, bar.update)
    command = f"hil bench soak --hours {args.hours:g} --starts {args.starts}"
    terminal.write_page(args.report, page(found, command))
    text = terminal.table(list(_HEAD), rows(found))
    return f"{text}\n\n{verdict(found)}", as_dict(found)
