"""`hil bench`: the published benchmarks."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from tqdm import tqdm

from hil.bench import hidden, identify, recordings, redesign, ukf, velocity, wire
from hil.bench.diagnosis import cases, runner, tables
from hil.commands import benchloop, common, identifytable, outputs, plugins
from hil.errors import ConfigError
from hil.rigs import rig_path
from hil.runtime.realtime import arranged

HELP = "the published benchmarks: hidden effects, speed, and the three public recordings"
EXAMPLE = "hil bench diagnosis --quick"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("name", choices=sorted(BENCHES), metavar="NAME", help="which benchmark")
    common.list_names(parser, BENCHES)
    parser.add_argument(
        "--seeds", type=int, help="seeds per hidden effect (hidden: 3, diagnosis: 10)"
    )
    parser.add_argument(
        "--quick", action="store_true",
        help="a subset in minutes (diagnosis); without the faults of the process (faults)",
    )  # fmt: skip
    parser.add_argument(
        "--seconds", type=float, default=60.0,
        help="of every run (loop), of the session (record, determinism); default 60",
    )  # fmt: skip
    parser.add_argument("--jobs", type=int, default=2, help="processes (diagnosis)")
    parser.add_argument(
        "--resume", metavar="R.jsonl",
        help="keep every result in this file, and do not do again what it holds (diagnosis)",
    )  # fmt: skip
    parser.add_argument(
        "--report", metavar="R.md",
        help="write the tables too (diagnosis, identify, velocity, faults, loop, determinism)",
    )  # fmt: skip
    parser.add_argument(
        "--figaroh", metavar="PYTHON", default="",
        help="interpreter of an environment that has FIGAROH (identify)",
    )  # fmt: skip
    parser.add_argument(
        "--python", metavar="PYTHON", action="append", default=[],
        help="another interpreter that has this package, e.g. of an environment with Python 3.13 "
        "(determinism); repeatable",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Run one benchmark and print its table."""
    plugins.load_installed()
    text, data = BENCHES[args.name](args)
    if args.json:
        common.emit({"schema": f"hil.bench.{args.name}/1", **data})
    else:
        common.out(text)
    return 0


def _diagnosis(args: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Thousands of hidden effects in the compiled simulator."""
    kept = Path(args.resume) if args.resume else None
    if kept and kept.suffix != ".jsonl":
        raise ConfigError(f"--resume {kept}: a file that ends in .jsonl is needed")
    _markdown(args.report)
    seeds = args.seeds or cases.SEEDS
    rows = runner.run(cases.plan(args.quick, seeds), args.jobs, kept)
    quick = " --quick" if args.quick else f" --seeds {seeds}"
    text = tables.report(rows, f"hil bench diagnosis{quick}")
    if args.report:
        Path(args.report).write_text(text, encoding="utf-8")
    return text, {"cases": rows}


def _hidden(args: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Effects hidden in the simulated arms, named from the session alone."""
    count = args.seeds or 3
    seeds = range(1, count + 1)
    total = (len(hidden.EFFECTS) + 1) * count
    with tqdm(total=total, unit="session", disable=not sys.stderr.isatty()) as bar:
        cases = hidden.run(Path(rig_path("identify")), list(seeds), report=lambda _: bar.update())
    rows = [
        [
            f"{c.effect or 'none'}{'@' + c.joint if c.effect else ''}", str(c.seed), c.verdict,
            ", ".join(c.named) or "-", f"{c.confidence:.2f}", f"{c.before:.2f}", f"{c.after:.2f}",
            "right" if c.right else "undecided" if c.undecided else "WRONG",
        ]
        for c in cases
    ]  # fmt: skip
    head = ["hidden", "seed", "verdict", "named", "confidence", "before/floor", "after/floor", ""]
    present = [c for c in cases if c.effect]
    right = sum(c.right for c in present)
    alarms = sum(c.false_alarm for c in cases)
    summary = (
        f"\n  {right} of {len(present)} hidden effects named right "
        f"({100 * right / len(present):.0f} %), {sum(c.undecided for c in present)} named first of "
        f"two that the data cannot tell apart, {alarms} false alarms in "
        f"{len(cases) - len(present)} sessions with none\n"
        f"  held-out error over its noise floor, worst joint: median "
        f"{recordings.median([c.before for c in present]):.2f} before, "
        f"{recordings.median([c.after for c in present]):.2f} after, "
        f"worst {max(c.after for c in present):.2f}"
    )
    data = {"cases": [vars(c) | {"right": c.right, "undecided": c.undecided} for c in cases]}
    return common.table(head, rows) + summary, dict(data)


def _emps(args: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Public recording of the EMPS drive: identification, and what is missing."""
    p, e = recordings.emps_published(), recordings.emps_diagnosed()
    rows = [
        [
            k,
            f"{v:.3f}",
            f"{recordings.PUBLISHED[k]:.2f}",
            f"{100 * (v / recordings.PUBLISHED[k] - 1):+.2f} %",
        ]
        for k, v in p.values.items()
    ]
    lines = ["Published identification", common.table(["parameter", "here", "published", ""], rows)]
    lines.append(
        f"  relative force error {p.error:.2f} % (published {recordings.PUBLISHED_ERROR} %), "
        f"on the record with pulses {p.heldout:.2f} %"
    )
    steps = zip(e.diagnosis.ladder, e.heldout, e.open_loop_mm, strict=True)
    table = [[s.label, f"{h:.2f}", f"{mm:.1f}"] for s, h, mm in steps]
    lines += ["", "What is missing", common.table(["model", "held-out %", "open loop mm"], table)]
    gain = 100 * (1 - e.heldout[-1] / e.heldout[0])
    lines.append(f"  held-out force error falls by {gain:.0f} %")
    for k in range(1, len(table)):
        if e.open_loop_mm[k] > 1.05 * e.open_loop_mm[k - 1]:
            lines.append(
                f"  warning: {table[k][0]} lowers the force error, but the open-loop position "
                f"error rises from {e.open_loop_mm[k - 1]:.1f} to {e.open_loop_mm[k]:.1f} mm"
            )
    data: dict[str, object] = {
        "published": p.values, "error": p.error, "heldout": e.heldout,
        "open_loop_mm": e.open_loop_mm, "models": [s.label for s in e.diagnosis.ladder],
    }  # fmt: skip
    return "\n".join(lines), data


def _contact(args: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Public recordings of a teleoperation rig against foam, springs and walls."""
    lines, data = [], {}
    for kind in ("foam", "spring", "rigid"):
        found = [recordings.contact(r) for r in recordings.contact_runs(kind)]
        rows = [
            [
                c.run, c.verdict, f"{c.spring:.1f}", f"{c.final:.1f}", ", ".join(c.named) or "-",
                f"{c.hysteresis - c.damping:+.0f}",
            ]
            for c in found
        ]  # fmt: skip
        head = ["run", "verdict", "spring %", "final %", "named", "hysteresis - damping"]
        lines += [kind, common.table(head, rows)]
        spring, final = (
            recordings.median([getattr(c, x) for c in found]) for x in ("spring", "final")
        )
        lines.append(
            f"  median held-out error {spring:.1f} % with a linear spring, "
            f"{final:.1f} % with the law found\n"
        )
        data[kind] = [vars(c) | {"named": list(c.named)} for c in found]
    return "\n".join(lines), dict(data)


def _wrist(args: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Public recording of the Staubli TX40: the coupling of its wrist."""
    lines, data = [], {}
    for split in ("fifths", "halves"):
        w = recordings.wrist(split)
        joints = w.diagnosis.result.problem.joints
        rows = [[s.label, *(f"{x:.1f}" for x in s.heldout.relative)] for s in w.diagnosis.ladder]
        what = {
            "fifths": "Contiguous fifths, each held out",
            "halves": "First half fits, second half tests",
        }[split]
        lines += [f"{what}: held-out error %", common.table(["model", *joints], rows), ""]
        data[split] = {s.label: s.heldout.relative.tolist() for s in w.diagnosis.ladder}
    return "\n".join(lines), dict(data)


def _velocity(args: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Velocity estimators: error and delay of each, and what an update costs here."""
    _markdown(args.report)
    text = velocity.report()
    if args.report:
        Path(args.report).write_text(text, encoding="utf-8")
    rows = [
        [label, f"{velocity.cost_ns(name, options):.0f}"] for label, name, options in velocity.CASES
    ]
    cost = common.table(["estimator", "ns"], rows)
    data = {"rows": [vars(r) | {"delay_ms": None if r.delay_ms != r.delay_ms else r.delay_ms}
                     for r in velocity.compare()]}  # fmt: skip
    return f"{text}\nOne update of three channels on this machine\n{cost}", dict(data)


def _wire(args: argparse.Namespace) -> tuple[str, dict[str, object]]:
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
        [s.backend, f"{s.wall:.1f}", f"{s.cpu:.1f}", f"{wire.SPEEDS[s.backend]:g}",
         _met(s.wall >= wire.SPEEDS[s.backend])]
        for s in speeds
    ]  # fmt: skip
    head = [f"lockstep, {wire.SECONDS:g} s", "x real time", "x processor time", "wanted", ""]
    data = {"costs": [vars(c) for c in costs], "speeds": [vars(s) for s in speeds],
            "tick_us_wanted": wire.TICK_US, "speeds_wanted": wire.SPEEDS}  # fmt: skip
    return text + common.table(head, rows), data


def _met(reached: bool) -> str:
    return "met" if reached else "NOT met"


def _markdown(path: str | None) -> None:
    if path and Path(path).suffix != ".md":
        raise ConfigError(f"--report {path}: a file that ends in .md is needed")


def _identify(args: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """How long identification and diagnosis take, beside peers."""
    outputs.check(args.report, ".md", (), identifytable.is_page, "a page of this benchmark")
    report = identify.run(figaroh=args.figaroh, report=lambda what: common.log(f"measuring {what}"))
    if args.report:
        with outputs.writing(args.report):
            Path(args.report).write_text(identifytable.page(report), encoding="utf-8")
    return identifytable.text(report), identifytable.data(report)


def _redesign(args: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Sensitivity-optimised designs: what they reach, and how long they take."""
    rows = redesign.measure()
    cells = [
        [r.task, f"{r.sensitivity:.3f}", f"{r.kappa:.2f}", f"{r.agreeing} of {r.starts}",
         f"{r.cold_s:.2f}", f"{r.warm_s:.2f}"]
        for r in rows
    ]  # fmt: skip
    head = ["task", "sensitivity", "condition of Q", "agree", "from afar s", "re-design s"]
    return common.table(head, cells), {"rows": [vars(r) for r in rows]}


def _ukf(args: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Compiled elastic-transmission filter against filterpy."""
    f = ukf.measure()
    rows = [["compiled", f"{f.compiled_us:.2f}"], ["filterpy", f"{f.reference_us:.0f}"]]
    text = common.table(["filter of ten states", "us a step"], rows)
    text += f"\n  largest difference over {f.steps} steps: {f.worst:.1e} standard deviations\n\n"
    beside = [[said, f"{us:.1f}"] for said, us in f.loop_us.items()]
    text += common.table(["in the loop, one arm", "us a tick"], beside)
    return text, dict(vars(f))


BENCHES: dict[str, Callable[[argparse.Namespace], tuple[str, dict[str, object]]]] = {
    "diagnosis": _diagnosis,
    "hidden": _hidden,
    "identify": _identify,
    "emps": _emps,
    "contact": _contact,
    "wrist": _wrist,
    "velocity": _velocity,
    **benchloop.BENCHES,
    "ukf": _ukf,
    "redesign": _redesign,
    "wire": _wire,
}
