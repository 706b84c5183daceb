"""`hil bench`: the published benchmarks.

What the public recordings give, the loop under attack and beside cyclictest, its record, and the
diagnosis on sessions with something hidden; times beside named peers are `bench_speed`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from tqdm import tqdm

from hil.bench import (
    determinism,
    doors,
    fuzz,
    hidden,
    loop,
    real,
    real_table,
    record_speed,
    recordings,
    soak,
    teleop,
)
from hil.bench.diagnosis import ablation, cases, halving, runner, session, tables
from hil.bench.diagnosis.runner import revision
from hil.bench.faults import cases as fault_cases
from hil.bench.faults import process
from hil.bench.faults import runner as fault_runner
from hil.commands import bench_speed, common, plugins
from hil.commands.common import Found
from hil.commands.design import finite
from hil.commands.fuzz_targets import TARGETS
from hil.errors import ConfigError, unknown
from hil.experiments.replicate import counted
from hil.rigs import rig_path

#: Folder for inputs that were not refused properly.
FINDINGS = "fuzz-findings"


def _diagnosis(args: argparse.Namespace) -> Found:
    """Thousands of hidden effects, in the plants it was tuned on and in those it was not."""
    kept = _resumed(args.resume)
    common.check_page(args.report)
    seeds = args.seeds or cases.SEEDS
    plants = _plants(args.plants)
    todo = _only([c for plant in plants for c in PLANS[plant](args.quick, seeds)], args.only)
    todo = halving.small(todo) if args.halve else todo
    rows = runner.run(todo, common.where(args), kept)
    quick = " --quick" if args.quick else f" --seeds {seeds}"
    which = f" --plants {plants[0]}" if len(plants) == 1 else ""
    which += "".join(f" --only {word}" for word in args.only)
    data: dict[str, object] = {"cases": rows}
    if args.ablate:
        again = ablation.run(todo, rows, common.where(args), kept)
        text = ablation.report(rows, again, f"hil bench diagnosis --ablate{quick}{which}")
        data |= {"without": again}
    elif args.halve:
        again = halving.run(todo, rows, common.where(args), kept)
        text = halving.report(rows, again, f"hil bench diagnosis --halve{quick}{which}")
        data |= {"changed": again}
    else:
        text = tables.report(rows, f"hil bench diagnosis{quick}{which}")
    common.write_page(args.report, text)
    return text, data


def _resumed(name: str) -> Path | None:
    """File of what was done before."""
    kept = Path(name) if name else None
    if kept and kept.suffix != ".jsonl":
        raise ConfigError(f"--resume {kept}: a file that ends in .jsonl is needed")
    return kept


def _only(todo: list[cases.SessionCase], words: Sequence[str]) -> list[cases.SessionCase]:
    """Cases whose name holds one of the words; all without any."""
    for word in words:
        if not any(word in c.name for c in todo):
            raise ConfigError(f"--only {word}: in no case's name, e.g. {todo[-1].name}")
    return [c for c in todo if not words or any(w in c.name for w in words)]


#: Plant -> its cases, quick or by seeds.
PLANS: dict[str, Callable[[bool, int], list[cases.SessionCase]]] = {
    "tuning": cases.plan,
    "test": cases.mujoco_plan,
}


def _plants(wanted: str | None) -> list[str]:
    """Plants of `wanted`; without a wish both, or what there is, which is said then."""
    if wanted == "tuning" or session.mujoco_available():
        return [wanted] if wanted in PLANS else list(PLANS)
    if wanted:
        raise ConfigError(f"--plants {wanted}: the test plants need MuJoCo: {session.MUJOCO_EXTRA}")
    common.log(f"without the test plants, which need MuJoCo: {session.MUJOCO_EXTRA}")
    return ["tuning"]


def _hidden(args: argparse.Namespace) -> Found:
    """Effects hidden in the simulated arms, named from the session alone."""
    count = args.seeds or 3
    seeds = range(1, count + 1)
    total = (len(hidden.EFFECTS) + 1) * count
    with tqdm(total=total, unit="session", disable=not sys.stderr.isatty()) as bar:
        found = hidden.run(Path(rig_path("identify")), list(seeds), report=lambda _: bar.update())
    rows = [
        [
            f"{c.effect or 'none'}{'@' + c.joint if c.effect else ''}",
            str(c.seed),
            c.verdict,
            ", ".join(c.named) or "-",
            f"{c.confidence:.2f}",
            f"{c.before:.2f}",
            f"{c.after:.2f}",
            "right" if c.right else "undecided" if c.undecided else "WRONG",
        ]
        for c in found
    ]
    head = ["hidden", "seed", "verdict", "named", "confidence", "before/floor", "after/floor", ""]
    data = {"cases": [vars(c) | {"right": c.right, "undecided": c.undecided} for c in found]}
    return common.table(head, rows) + _named_right(found), dict(data)


def _named_right(found: Sequence[hidden.HiddenCase]) -> str:
    """How many were named right, and what of the error is left."""
    present = [c for c in found if c.effect]
    right = sum(c.right for c in present)
    alarms = sum(c.false_alarm for c in found)
    return (
        f"\n  {right} of {len(present)} hidden effects named right "
        f"({100 * right / len(present):.0f} %), {sum(c.undecided for c in present)} named first of "
        f"two that the data cannot tell apart, {alarms} false alarms in "
        f"{len(found) - len(present)} sessions with none\n"
        f"  held-out error over its noise floor, worst joint: median "
        f"{recordings.median([c.before for c in present]):.2f} before, "
        f"{recordings.median([c.after for c in present]):.2f} after, "
        f"worst {max(c.after for c in present):.2f}"
    )


def _fuzz(args: argparse.Namespace) -> Found:
    """Every parser under mutated input; inputs that are not refused properly are kept."""
    common.check_page(args.report)
    targets = [t for t in TARGETS if not args.only or any(w in t.name for w in args.only)]
    if not targets:
        raise ConfigError(unknown("target", " ".join(args.only), [t.name for t in TARGETS]))
    if not 0 <= args.minutes <= 10_000:
        raise ConfigError(f"--minutes {args.minutes:g}: a time of 0 or more is needed")
    kept = _resumed(args.resume)
    turns = fuzz.remembered(kept) if kept else []
    inputs = []
    for target in targets if args.minutes else ():
        common.log(f"{target.name} ...")
        earlier = sum(one["name"] == target.name for one in turns)
        seed = 1000 * earlier + (args.seeds or 0)  # no turn repeats an earlier one
        found = fuzz.guarded(target, 60 * args.minutes, seed)
        inputs += fuzz.keep([found], Path(FINDINGS))
        turns.append(fuzz.turn(found, revision()))
        if kept:
            fuzz.remember(kept, turns[-1])
    sums = fuzz.summed(turns, [t.name for t in TARGETS])
    resumed = [f"--resume {kept}"] if kept else []
    only = [f"--only {word}" for word in args.only]
    command = " ".join(["hil bench fuzz", f"--minutes {args.minutes:g}", *only, *resumed])
    revisions = list(dict.fromkeys(one["revision"] for one in turns))
    common.write_page(args.report, fuzz.page(sums, command, revisions))
    said = f"{common.table(fuzz.HEAD, [e.row() for e in sums])}\n\n{fuzz.verdict(sums)}"
    if inputs:
        said += f"; the inputs are in {FINDINGS}/: {', '.join(p.name for p in inputs)}"
    rows = [dict(zip(fuzz.HEAD, e.row(), strict=True)) for e in sums]
    return said, {"targets": rows, "inputs": [str(p) for p in inputs]}


def _faults(args: argparse.Namespace) -> Found:
    """Every fault of device, data and process, and the state each leads to."""
    common.check_page(args.report)
    live = [] if args.quick else list(process.CASES)
    total = len(fault_cases.FAULTS) + len(live)
    with (
        tempfile.TemporaryDirectory() as folder,
        tqdm(total=total, unit="fault", disable=not sys.stderr.isatty()) as bar,
    ):
        found = fault_runner.run(fault_cases.FAULTS, Path(folder), lambda _: bar.update() and None)
        for name in live:
            found.append(process.one(name, Path(folder)))
            bar.update()
    common.write_page(
        args.report,
        fault_runner.report(found, f"hil bench faults{' --quick' if args.quick else ''}"),
    )
    text = common.table(list(fault_runner.HEAD), [fault_runner.row(o) for o in found])
    return f"{text}\n\n{fault_runner.verdict(found)}", {"faults": [asdict(o) for o in found]}


def _loop(args: argparse.Namespace) -> Found:
    """The loop under load: how late its ticks are, beside cyclictest."""
    common.check_page(args.report)
    if args.turns < 1:
        raise ConfigError(f"--turns {args.turns}: one or more is needed")
    found = loop.compare(args.seconds, args.turns)
    text = loop.table(found)
    command = f"hil bench loop --seconds {args.seconds:g} --turns {args.turns}"
    common.write_page(args.report, loop.page(found, command))
    return text, {"runs": [asdict(r) for r in found]}


def _ui(args: argparse.Namespace) -> Found:
    """The loop with the operator's page open and closed: how late its ticks are."""
    if args.turns < 1 or not 1.0 <= args.seconds <= 3600.0:
        raise ConfigError(
            f"--turns {args.turns} --seconds {args.seconds:g}: at least one turn of 1 s is needed"
        )
    total = args.turns * len(loop.WINDOWS)
    with tqdm(total=total, unit="run", disable=not sys.stderr.isatty()) as bar:
        found = loop.beside_pages(args.seconds, args.turns, bar.update)
    table = common.table(list(loop.PAGE_HEAD), loop.page_rows(found))
    return f"{table}\n\n{loop.page_verdict(found)}", {"runs": [finite(asdict(r)) for r in found]}


def _record(args: argparse.Namespace) -> Found:
    """What recording costs, and what a flipped bit or a cut file loses."""
    found, damage = record_speed.measure(args.seconds), record_speed.damage()
    return record_speed.table(found, damage), {**asdict(found), "damage": asdict(damage)}


def _soak(args: argparse.Namespace) -> Found:
    """Hours in real time with recording, then starts and stops: memory, latency, lost rows."""
    common.check_page(args.report)
    if not (args.hours > 0.0 and args.starts > 0):
        raise ConfigError(f"--hours {args.hours:g} --starts {args.starts}: both must be above zero")
    total = soak.steps(args.hours, args.starts)
    with tqdm(total=total, unit="part", disable=not sys.stderr.isatty()) as bar:
        found = soak.soak(args.hours, args.starts, bar.update)
    command = f"hil bench soak --hours {args.hours:g} --starts {args.starts}"
    common.write_page(args.report, soak.page(found, command))
    text = common.table(list(soak.HEAD), soak.rows(found))
    return f"{text}\n\n{soak.verdict(found)}", soak.as_dict(found)


def _doors(args: argparse.Namespace) -> Found:
    """Sources as labs have them, the command that takes each, and what comes out."""
    common.check_page(args.report)
    with tqdm(total=doors.steps(), unit="source", disable=not sys.stderr.isatty()) as bar:
        rows = list(doors.study(bar.update))
    common.write_page(args.report, doors.page(rows, "hil bench doors"))
    text = common.table(list(doors.HEAD), doors.cells(rows), (0, 1, 3, 4))
    return text, {"doors": [finite(asdict(r)) for r in rows]}


def _teleop(args: argparse.Namespace) -> Found:
    """Teleoperation over delay: drag, stiffness that is felt, stiffest walls, virtual fixtures."""
    common.check_page(args.report)
    total = teleop.steps(args.quick)
    with tqdm(total=total, unit="row", disable=not sys.stderr.isatty()) as bar:
        found = teleop.study(quick=args.quick, report=bar.update)
    command = "hil bench teleop" + " --quick" * args.quick
    common.write_page(args.report, teleop.page(found, command))
    tables = (
        (teleop.HEAD, teleop.cells(found.laws)),
        (teleop.WALL_HEAD, teleop.wall_cells(found.walls)),
        (teleop.LIMIT_HEAD, teleop.limit_cells(found.limits)),
        (teleop.FIXTURE_HEAD, teleop.fixture_cells(found.fixtures)),
    )
    text = "\n\n".join(common.table(list(head), body) for head, body in tables)
    text += f"\n\n  the motors of the leader hold {found.holds:.1f} N at home"
    return text, finite(asdict(found))


def _determinism(args: argparse.Namespace) -> Found:
    """Lockstep sessions by several Pythons: the same bytes, or the first difference."""
    common.check_page(args.report)
    found = determinism.compare([sys.executable, *args.python], args.seconds)
    others = " --python PYTHON" * len(args.python)
    common.write_page(
        args.report,
        determinism.page(found, f"hil bench determinism --seconds {args.seconds:g}{others}"),
    )
    text = common.table(list(determinism.HEAD), determinism.rows(found))
    return text, {"sessions": [asdict(s) for s in found]}


def _emps(args: argparse.Namespace) -> Found:
    """Public recording of the EMPS drive: identification, and what is missing."""
    p, e, r = recordings.emps_published(), recordings.emps_diagnosed(), recordings.emps_refined()
    lines = ["Published identification", *_published(p), "", "What is missing", *_missing(e)]
    lines += ["", "Refined on free runs of the first record", *_refined(r)]
    data: dict[str, object] = {
        "published": p.values,
        "error": p.error,
        "heldout": e.heldout,
        "free_run_mm": e.free_run_mm,
        "models": [s.label for s in e.diagnosis.ladder],
        "simulated": {k: f.as_dict() for k, f in zip(r.labels, r.fits, strict=True)},
        "taken": r.labels[r.taken],
        "references_mm": recordings.REFERENCES,
    }
    return "\n".join(lines), data


def _published(p: recordings.Published) -> list[str]:
    """Parameters beside those of the publication."""
    rows = []
    for name, value in p.values.items():
        told = recordings.PUBLISHED[name]
        rows.append([name, f"{value:.3f}", f"{told:.2f}", f"{100 * (value / told - 1):+.2f} %"])
    return [
        common.table(["parameter", "here", "published", ""], rows),
        f"  relative force error {p.error:.2f} % (published {recordings.PUBLISHED_ERROR} %), "
        f"on the record with pulses {p.heldout:.2f} %",
    ]


def _missing(e: recordings.Emps) -> list[str]:
    """Both errors of every rung, and where one rises as the other falls."""
    steps = zip(e.diagnosis.ladder, e.heldout, e.free_run_mm, strict=True)
    table = [[s.label, f"{h:.2f}", f"{mm:.1f}"] for s, h, mm in steps]
    lines = [
        "Fitted on the first record, both errors on the record with pulses, which is simulated",
        "from its first state to its end",
        common.table(["model", "force %", "free run mm"], table),
    ]
    gain = 100 * (1 - e.heldout[-1] / e.heldout[0])
    lines.append(f"  held-out force error falls by {gain:.0f} %")
    for k in range(1, len(table)):
        if e.free_run_mm[k] > 1.05 * e.free_run_mm[k - 1]:
            lines.append(
                f"  warning: {table[k][0]} lowers the force error, but the free run's position "
                f"error rises from {e.free_run_mm[k - 1]:.1f} to {e.free_run_mm[k]:.1f} mm"
            )
    return lines


def _refined(r: recordings.Refined) -> list[str]:
    """Every structure before and after, on the first record's thirds and on the other record."""
    rows = []
    for label, f in zip(r.labels, r.fits, strict=True):
        before, after = f.official or f.heldout
        held = [f"{1e3 * e.simulated[0]:.2f}" for e in f.heldout]
        force = [f"{e.one_step[0]:.2f}" for e in (before, after)]
        mm = [f"{1e3 * e.simulated[0]:.2f}" for e in (before, after)]
        rows.append([label, *held, *force, *mm])
    rows += [[f"published: {k}", *["-"] * 5, f"{x:.2f}"] for k, x in recordings.REFERENCES.items()]
    head = ["model", "thirds mm", "refined", "force %", "refined", "free run mm", "refined"]
    return [
        "Held-out thirds of the first record, then both errors on the record with pulses",
        common.table(head, rows),
        f"  the first record takes {r.labels[r.taken]}",
    ]


def _contact(args: argparse.Namespace) -> Found:
    """Public recordings of a teleoperation rig against foam, springs and walls."""
    lines, data = [], {}
    for kind in ("foam", "spring", "rigid"):
        found = [recordings.contact(r) for r in recordings.contact_runs(kind)]
        rows = [
            [
                c.run,
                c.verdict,
                f"{c.spring:.1f}",
                f"{c.final:.1f}",
                ", ".join(c.named) or "-",
                f"{c.hysteresis - c.damping:+.0f}",
            ]
            for c in found
        ]
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


def _wrist(args: argparse.Namespace) -> Found:
    """Public recording of the Staubli TX40: the coupling of its wrist."""
    lines, data = [], {}
    for split in ("fifths", "halves"):
        w = recordings.wrist(split)
        joints = w.diagnosis.result.problem.joints
        rows = [[s.label, *(f"{x:.1f}" for x in s.heldout.relative)] for s in w.diagnosis.ladder]
        what = {
            "fifths": "Blocks of the whole recording, held out",
            "halves": "First half fits, second half tests",
        }[split]
        lines += [f"{what}: held-out error %", common.table(["model", *joints], rows), ""]
        data[split] = {s.label: s.heldout.relative.tolist() for s in w.diagnosis.ladder}
    return "\n".join(lines), dict(data)


def _real(args: argparse.Namespace) -> Found:
    """Every public recording: the given model, a person's script, and the tool beside them."""
    common.check_page(args.report)
    todo, kept, made_by = real.cases(args.only), _resumed(args.resume), revision()
    names = {c.name for c in todo}
    before = runner.read(kept) if kept else []
    found = {
        r["case"]["case"]: real.from_data(r["case"])
        for r in before
        if r["revision"] == made_by and r["case"]["case"] in names
    }
    left = [c for c in todo if c.name not in found]
    for row in counted(real.run(left, common.where(args)), len(left), "case"):
        found[row.case] = row
        if kept:
            runner.append(kept, {"revision": made_by, "case": real.to_data(row)})
    rows = [found[c.name] for c in todo]
    only = "".join(f" --only {word}" for word in args.only)
    command = f"hil bench real{only} --workers {args.workers}"
    common.write_page(args.report, real_table.page(rows, command, made_by))
    data: dict[str, object] = {"revision": made_by, "cases": real_table.data(rows)}
    return real_table.text(rows, common.table), data


EXAMPLE = "hil bench diagnosis --quick"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("name", choices=sorted(BENCHES), metavar="NAME", help="which benchmark")
    common.list_names(parser, BENCHES)
    parser.add_argument(
        "--seeds", type=int, help="seeds per hidden effect (hidden: 3, diagnosis: 10, fleet: 1)"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a subset in minutes (diagnosis); without the faults of the process (faults)",
    )
    parser.add_argument(
        "--plants",
        choices=("tuning", "test", "both"),
        help="simulators of the diagnosis: those it was tuned on, those it never saw (MuJoCo), "
        "or both; default: what is installed",
    )
    parser.add_argument(
        "--ablate",
        action="store_true",
        help="without each rule of the search in turn, where it alone stopped something: "
        "which answers change (diagnosis)",
    )
    parser.add_argument(
        "--halve",
        action="store_true",
        help="with each decision constant halved and doubled in turn, on ten sessions of "
        "--quick: which answers change (diagnosis)",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=60.0,
        help="of every run (loop, ui), of the session (record, determinism); default 60",
    )
    parser.add_argument(
        "--minutes", type=float, default=1.0, help="for every parser (fuzz); default 1"
    )
    parser.add_argument("--turns", type=int, default=5, help="of all runs (loop, ui); default 5")
    parser.add_argument("--hours", type=float, default=2.0, help="length of the session (soak)")
    parser.add_argument("--starts", type=int, default=1000, help="starts and stops (soak)")
    common.add_workers(parser, " (diagnosis, real, fleet)", "--jobs")
    parser.add_argument(
        "--resume",
        metavar="R.jsonl",
        help="keep every result in this file, and do not do again what it holds (diagnosis, real); "
        "add the turns to those of this file (fuzz; with --minutes 0 only their table)",
    )
    parser.add_argument(
        "--report",
        metavar="R.md",
        help="write the tables too (diagnosis, real, identify, velocity, faults, loop, "
        "determinism)",
    )
    parser.add_argument(
        "--only",
        metavar="WORD",
        action="append",
        default=[],
        help="cases whose name (real: or kind) holds this word (diagnosis, real, fuzz); repeatable",
    )
    parser.add_argument(
        "--figaroh",
        metavar="PYTHON",
        default="",
        help="interpreter of an environment that has FIGAROH (identify)",
    )
    parser.add_argument(
        "--python",
        metavar="PYTHON",
        action="append",
        default=[],
        help="another interpreter that has this package, e.g. of an environment with Python 3.13 "
        "(determinism); repeatable",
    )
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


BENCHES: dict[str, Callable[[argparse.Namespace], Found]] = {
    "contact": _contact,
    "determinism": _determinism,
    "diagnosis": _diagnosis,
    "emps": _emps,
    "faults": _faults,
    "fuzz": _fuzz,
    "hidden": _hidden,
    "loop": _loop,
    "real": _real,
    "record": _record,
    "soak": _soak,
    "doors": _doors,
    "teleop": _teleop,
    "ui": _ui,
    "wrist": _wrist,
    **bench_speed.BENCHES,
}
