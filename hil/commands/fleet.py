"""`hil bench fleet`: what it costs to diagnose ten thousand sessions, each alone.

It measures `hil diagnose --by session` itself, and so stands beside that command.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

from hil import terminal
from hil.bench import hidden
from hil.commands import diagnose, many_sessions
from hil.errors import DeviceError, plural
from hil.experiments.parallel_runs import LostRun, computer, counted, spread
from hil.record.mcap_read import load
from hil.record.sources import robot_of
from hil.revision import machine, peak
from hil.rigs import rig_path
from hil.terminal import Found

#: Sessions of a fleet for which the cost is told, and the processors that share it.
FLEET, CORES = 10_000, (2, 16, 128)


def command(args: argparse.Namespace) -> Found:
    """What it costs to diagnose ten thousand sessions, measured on eleven of them."""
    who, count = computer(args), args.seeds or 1
    with tempfile.TemporaryDirectory() as folder:
        terminal.log(f"recording {plural(count * (len(hidden.EFFECTS) + 1), 'session')}")
        paths = [
            hidden.identification_session(
                Path(rig_path("identify")), Path(folder), seed, seed, effect, joint
            )
            for seed in range(1, count + 1)
            for effect, joint in (*hidden.EFFECTS, ("", "joint1"))
        ]
        size = sum(p.stat().st_size for p in paths) / len(paths)
        began = time.perf_counter()
        for path in paths:
            robot_of(path, "follower")
        naming = (time.perf_counter() - began) / len(paths)
        for warm in spread(_timed, [str(paths[-1])] * who.workers, who):
            del warm  # each process imports and compiles once
        began = time.perf_counter()
        results = spread(_timed, list(map(str, paths)), who)
        found = [cost for _, cost in counted(results, len(paths), "session")]
        costs = [cost for cost in found if not isinstance(cost, LostRun)]
        wall = time.perf_counter() - began
    if not costs:
        raise DeviceError(f"no session was diagnosed: {LostRun().text}")
    return _fleet_text(costs, size, naming, wall)


def _timed(path: str) -> dict[str, float]:
    """Cost of one diagnosis in this process, as `hil diagnose --by session` does it."""
    args = many_sessions.one_arm(path, "follower")
    began, wall = time.process_time(), time.perf_counter()
    with terminal.silent():
        found = diagnose.group_answer(args)
    return {
        "processor_s": time.process_time() - began,
        "wall_s": time.perf_counter() - wall,
        "peak_mib": peak() / 2**20,
        "answer_kb": len(json.dumps(found)) / 1e3,
        "recorded_s": float(load(path, "follower").t[-1]),
    }


def _fleet_text(costs: list[dict[str, float]], size: float, naming: float, wall: float) -> Found:
    """The table of a session, and what it makes of ten thousand."""
    cpu = sorted(c["processor_s"] for c in costs)
    mean = sum(cpu) / len(cpu)
    rows = [
        ["length", f"{costs[0]['recorded_s']:.0f} s, 3 joints, two arms at 1 kHz"],
        ["size", f"{size / 1e6:.1f} MB"],
        ["to see whose it is", f"{1e3 * naming:.1f} ms"],
        ["to diagnose one arm", f"{mean:.1f} processor s ({cpu[0]:.1f} to {cpu[-1]:.1f})"],
        ["largest memory of a process", f"{max(c['peak_mib'] for c in costs):.0f} MiB"],
        ["answer that is kept", f"{sum(c['answer_kb'] for c in costs) / len(costs):.0f} kB"],
    ]
    text = f"{plural(len(costs), 'session')}, each diagnosed alone, on a {machine()}\n"
    text += terminal.table(["a session", ""], rows)
    text += f"\n  all {len(costs)} took {wall:.0f} s, with whatever else the machine did\n\n"
    hours = FLEET * mean / 3600
    total = [
        ["sessions", f"{FLEET * size / 1e9:.0f} GB"],
        ["answers", f"{FLEET * sum(c['answer_kb'] for c in costs) / len(costs) / 1e6:.1f} GB"],
        ["to see whose they are, in one process", f"{FLEET * naming / 60:.1f} min"],
        ["to diagnose them", f"{hours:.1f} processor hours"],
        *([f"  on {n} processors", f"{hours / n:.1f} h"] for n in CORES),
    ]
    text += terminal.table([f"{FLEET} of them", ""], total)
    return text, {"sessions": costs, "bytes": size, "naming_s": naming, "wall_s": wall}
