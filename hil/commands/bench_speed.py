"""`hil bench identify`, `fleet`, `velocity`, `ukf`, `redesign` and `wire`: how long things take.

The tables of `hil bench identify`, for the terminal and for a page.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from hil.bench import hidden, identify, ukf, velocity, wire
from hil.bench.diagnose_once import peak
from hil.bench.identify import DATA, Report
from hil.commands import common, diagnose, groups, outputs, terminal
from hil.commands.common import Found
from hil.errors import DeviceError, plural
from hil.experiments.replicate import LostRun, counted, spread
from hil.record.mcap_read import load
from hil.record.sources import robot_of
from hil.rigs import rig_path
from hil.runtime.realtime import arranged
from hil.teleop import optimise
from hil.teleop.architecture import Realisation
from hil.teleop.hybrid import Impedance
from hil.teleop.optimise import DesignProblem
from hil.userfile import write_text

COMMAND = "hil bench identify"
TITLE = "# Speed of identification and diagnosis"
#: Most that a peer may take, in units of the reference, without and with the missing effect.
GOALS = (
    ("hil.fit", False, 0.8),
    ("hil.fit", True, 0.8),
    ("hil diagnose", False, 6.0),
    ("hil diagnose", True, 15.0),
)
#: Most memory of the longest recording [MiB].
PEAK_MIB = 1024.0


def text(r: Report) -> str:
    """Both tables with what they were measured on."""
    lines = [
        f"3 joints, {r.recorded:g} s at 1 kHz, 42 parameters, on a {machine()}",
        f"processor seconds on one thread, median of {r.repeats} after a warm-up; ratio to the "
        "reference of the same run",
        "",
        _peers(r),
        "",
        "held-out / floor: rms error on the second motion, at 1 kHz, over the effort's noise of "
        "5 mN m;\nof hil diagnose: in its own band, over the floor that it measured itself. The "
        "reference and\nFIGAROH get the exact motion, hil only positions.",
    ]
    if r.lengths:
        lines += [
            "",
            "hil diagnose, one cold run each in a process of its own, as a user runs it",
            "",
            _lengths(r),
        ]
    return "\n".join(lines)


def _peers(r: Report) -> str:
    """Times of all peers on the same data."""
    rows = [
        [
            row.peer,
            row.data,
            _number(row.seconds),
            _number(row.ratio),
            " ".join(f"{x:.3f}" for x in row.floor) or "-",
            row.note,
        ]
        for row in r.rows
    ]
    return common.table(["peer", "data", "seconds", "ratio", "held-out / floor", ""], rows)


def _lengths(r: Report) -> str:
    """Time and memory of the diagnosis over the length of the recording."""
    grown = [
        [
            f"{x.recorded:g}",
            x.data,
            f"{x.wall:.2f}",
            f"{x.seconds:.2f}",
            f"{x.peak_mib:.0f}",
            f"{1e3 * x.wall / x.recorded:.0f}",
            x.verdict,
        ]
        for x in r.lengths
    ]
    names = [
        "recorded s",
        "data",
        "wall s",
        "processor s",
        "peak MiB",
        "wall ms per s",
        "verdict",
    ]
    return common.table(names, grown)


def _number(x: float) -> str:
    return "-" if math.isnan(x) else f"{x:.2f}"


def data(r: Report) -> dict[str, Any]:
    """The same as JSON; what did not run is null."""
    rows: list[dict[str, Any]] = [asdict(row) for row in r.rows]
    for row in rows:
        for key in ("seconds", "wall", "ratio"):
            row[key] = None if math.isnan(row[key]) else row[key]
    return {
        "machine": machine(),
        "recorded_s": r.recorded,
        "repeats": r.repeats,
        "rows": rows,
        "lengths": [asdict(x) for x in r.lengths],
    }


def machine() -> str:
    """Class of this machine, without its name."""
    info = Path("/proc/cpuinfo")
    guest = info.exists() and " hypervisor" in info.read_text(encoding="utf-8")
    return f"{os.cpu_count()}-core {'virtual ' if guest else ''}machine"


def page(r: Report) -> str:
    """Markdown page with the printed result."""
    return (
        f"{TITLE}\n\n"
        f"Printed by `{COMMAND} --figaroh PYTHON --report docs/bench/identify.md`, where\n"
        "PYTHON is an interpreter that has `figaroh` (the extra `bench`). It measures speed: the\n"
        "data come from the same rigid-body equations that are fitted.\n\n"
        f"```\n{text(r)}\n```\n\n"
        f"{goals(r)}\n"
    )


def goals(r: Report) -> str:
    """Which goals hold in this run, a line each."""
    ratios = {(row.peer, row.data): row.ratio for row in r.rows}
    found = [
        (f"{peer}, {DATA[missing]}", ratios.get((peer, DATA[missing]), float("nan")), most)
        for peer, missing, most in GOALS
    ]
    rows = [
        f"- {what}: {ratio:.2f} times the reference, goal {most:g}" for what, ratio, most in found
    ]
    met = [ratio <= most for _, ratio, most in found]
    if r.lengths:
        longest = max(r.lengths, key=lambda x: (x.recorded, x.peak_mib))
        rows.append(f"- {longest.recorded:g} s: {longest.peak_mib:.0f} MiB, goal {PEAK_MIB:g}")
        met.append(longest.peak_mib <= PEAK_MIB)
    said = (f"{row}: {'met' if ok else 'missed'}" for row, ok in zip(rows, met, strict=True))
    return "Goals:\n\n" + "\n".join(said)


def is_page(path: Path) -> bool:
    """Whether a file is such a page, or empty."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False
    return not text.strip() or text.startswith(TITLE)


def _identify(args: argparse.Namespace) -> Found:
    """How long identification and diagnosis take, beside peers."""
    outputs.check(args.report, ".md", (), is_page, "a page of this benchmark")
    report = identify.run(figaroh=args.figaroh, report=lambda what: common.log(f"measuring {what}"))
    if args.report:
        with outputs.writing(args.report):
            write_text(args.report, page(report))
    return text(report), data(report)


#: Sessions of a fleet for which the cost is told, and the processors that share it.
FLEET, CORES = 10_000, (2, 16, 128)


def _fleet(args: argparse.Namespace) -> Found:
    """What it costs to diagnose ten thousand sessions, measured on eleven of them."""
    where, count = common.where(args), args.seeds or 1
    with tempfile.TemporaryDirectory() as folder:
        common.log(f"recording {plural(count * (len(hidden.EFFECTS) + 1), 'session')}")
        paths = [
            hidden.session(Path(rig_path("identify")), Path(folder), seed, seed, effect, joint)
            for seed in range(1, count + 1)
            for effect, joint in (*hidden.EFFECTS, ("", "joint1"))
        ]
        size = sum(p.stat().st_size for p in paths) / len(paths)
        began = time.perf_counter()
        for path in paths:
            robot_of(path, "follower")
        naming = (time.perf_counter() - began) / len(paths)
        for warm in spread(_timed, [str(paths[-1])] * where.workers, where):
            del warm  # each process imports and compiles once
        began = time.perf_counter()
        results = spread(_timed, list(map(str, paths)), where)
        found = [cost for _, cost in counted(results, len(paths), "session")]
        costs = [cost for cost in found if not isinstance(cost, LostRun)]
        wall = time.perf_counter() - began
    if not costs:
        raise DeviceError(f"no session was diagnosed: {LostRun().text}")
    return _fleet_text(costs, size, naming, wall)


def _timed(path: str) -> dict[str, float]:
    """Cost of one diagnosis in this process, as `hil diagnose --by session` does it."""
    args = groups.alone(path, "follower")
    began, wall = time.process_time(), time.perf_counter()
    with terminal.silent():
        found = diagnose.answer(args)
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
    text += common.table(["a session", ""], rows)
    text += f"\n  all {len(costs)} took {wall:.0f} s, with whatever else the machine did\n\n"
    hours = FLEET * mean / 3600
    total = [
        ["sessions", f"{FLEET * size / 1e9:.0f} GB"],
        ["answers", f"{FLEET * sum(c['answer_kb'] for c in costs) / len(costs) / 1e6:.1f} GB"],
        ["to see whose they are, in one process", f"{FLEET * naming / 60:.1f} min"],
        ["to diagnose them", f"{hours:.1f} processor hours"],
        *([f"  on {n} processors", f"{hours / n:.1f} h"] for n in CORES),
    ]
    text += common.table([f"{FLEET} of them", ""], total)
    return text, {"sessions": costs, "bytes": size, "naming_s": naming, "wall_s": wall}


def _velocity(args: argparse.Namespace) -> Found:
    """Velocity estimators: error and delay of each, and what an update costs here."""
    common.check_page(args.report)
    text = velocity.report()
    common.write_page(args.report, text)
    rows = [
        [label, f"{velocity.cost_ns(name, options):.0f}"] for label, name, options in velocity.CASES
    ]
    cost = common.table(["estimator", "ns"], rows)
    data = {
        "rows": [
            vars(r) | {"delay_ms": None if r.delay_ms != r.delay_ms else r.delay_ms}
            for r in velocity.compare()
        ]
    }
    return f"{text}\nOne update of three channels on this machine\n{cost}", dict(data)


def _ukf(args: argparse.Namespace) -> Found:
    """Compiled elastic-transmission filter against filterpy."""
    f = ukf.measure()
    rows = [["compiled", f"{f.compiled_us:.2f}"], ["filterpy", f"{f.reference_us:.0f}"]]
    text = common.table(["filter of ten states", "us a step"], rows)
    text += f"\n  largest difference over {f.steps} steps: {f.worst:.1e} standard deviations\n\n"
    beside = [[said, f"{us:.1f}"] for said, us in f.loop_us.items()]
    text += common.table(["in the loop, one arm", "us a tick"], beside)
    return text, dict(vars(f))


#: Tasks: name -> what differs from the default problem.
_TASKS: dict[str, DesignProblem] = {
    "gel 300 N/m": DesignProblem(real=Realisation(32.0, 30.0, 32.0)),
    "gel 300 N/m, k <= 225": DesignProblem(real=Realisation(32.0, 30.0, 32.0), stiffness=225.0),
    "gel 600 N/m, k <= 240": DesignProblem(
        real=Realisation(32.0, 30.0, 32.0),
        environment=Impedance(0.0, 3.0, 600.0),
        stiffness=240.0,
        contact=0.8,
    ),
    "condition of Q to 3": DesignProblem(real=Realisation(32.0, 30.0, 32.0), kappa=3.0, force=2.0),
}


@dataclass(frozen=True)
class RedesignRow:
    """One task.

    Parameters
    ----------
    task : str
        Name.
    sensitivity, kappa : float
        Of the optimum.
    agreeing, starts : int
        Searches within 1 % of the best.
    cold_s, warm_s : float
        Time of all searches; of one search after the gel has become 10 % stiffer.
    """

    task: str
    sensitivity: float
    kappa: float
    agreeing: int
    starts: int
    cold_s: float
    warm_s: float


def redesigned() -> list[RedesignRow]:
    """Design every task from afar, then again from a neighbouring solution."""
    from hil.teleop.force_sensor_free import conditioning

    rows = []
    for name, problem in _TASKS.items():
        start = time.perf_counter()
        found = optimise.optimise(problem)
        cold = time.perf_counter() - start
        ze = problem.environment
        near = replace(problem, environment=Impedance(ze.m, ze.b, 1.1 * ze.k))
        start = time.perf_counter()
        optimise.optimise(near, start=found.theta)
        warm = time.perf_counter() - start
        rows.append(
            RedesignRow(
                name,
                found.sensitivity,
                conditioning(found.design),
                found.agreeing,
                found.starts,
                cold,
                warm,
            )
        )
    return rows


def _redesign(args: argparse.Namespace) -> Found:
    """Sensitivity-optimised designs: what they reach, and how long they take."""
    rows = redesigned()
    cells = [
        [
            r.task,
            f"{r.sensitivity:.3f}",
            f"{r.kappa:.2f}",
            f"{r.agreeing} of {r.starts}",
            f"{r.cold_s:.2f}",
            f"{r.warm_s:.2f}",
        ]
        for r in rows
    ]
    head = ["task", "sensitivity", "condition of Q", "agree", "from afar s", "re-design s"]
    return common.table(head, cells), {"rows": [vars(r) for r in rows]}


def _wire(args: argparse.Namespace) -> Found:
    """Microseconds a tick of every driver on its simulated wire; speed of lockstep sessions."""
    costs = [*wire.costs(), wire.session()]
    speeds = [wire.speed(backend) for backend in wire.SPEEDS]
    rows = [[c.name, f"{c.median:.1f}", f"{c.p99:.1f}"] for c in costs]
    whole, real = costs[-2].p99, costs[-1].p99
    text = common.table(["a tick of rigs/teleop.toml, sim-wire", "median us", "p99 us"], rows)
    with arranged() as found:
        text += f"\n  arranged as a session in real time: {found.as_text()}"
    text += (
        f"\n  p99 of the whole tick: {_met(whole <= wire.TICK_US)} ({wire.TICK_US:g} us), after a "
        f"sleep: {_met(real <= wire.TICK_US)}\n\n"
    )
    rows = [
        [
            s.backend,
            f"{s.wall:.1f}",
            f"{s.cpu:.1f}",
            f"{wire.SPEEDS[s.backend]:g}",
            _met(s.wall >= wire.SPEEDS[s.backend]),
        ]
        for s in speeds
    ]
    head = [f"lockstep, {wire.SECONDS:g} s", "x real time", "x processor time", "wanted", ""]
    data = {
        "costs": [vars(c) for c in costs],
        "speeds": [vars(s) for s in speeds],
        "tick_us_wanted": wire.TICK_US,
        "speeds_wanted": wire.SPEEDS,
    }
    return text + common.table(head, rows), data


def _met(reached: bool) -> str:
    return "met" if reached else "NOT met"


BENCHES: dict[str, Callable[[argparse.Namespace], Found]] = {
    "fleet": _fleet,
    "identify": _identify,
    "velocity": _velocity,
    "ukf": _ukf,
    "redesign": _redesign,
    "wire": _wire,
}
