"""`hil bench faults`, `loop` and `record`: the loop under attack, beside cyclictest, its record."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from tqdm import tqdm

from hil.bench import determinism, loop, record_speed
from hil.bench.faults import cases, process, runner
from hil.commands import benchpage, common
from hil.commands.benchpage import Found


def _faults(args: argparse.Namespace) -> Found:
    """Every fault of device, data and process, and the state each leads to."""
    benchpage.check(args.report)
    live = [] if args.quick else list(process.CASES)
    total = len(cases.FAULTS) + len(live)
    with (
        tempfile.TemporaryDirectory() as folder,
        tqdm(total=total, unit="fault", disable=not sys.stderr.isatty()) as bar,
    ):
        found = runner.run(cases.FAULTS, Path(folder), lambda _: bar.update() and None)
        for name in live:
            found.append(process.one(name, Path(folder)))
            bar.update()
    benchpage.write(
        args.report, runner.report(found, f"hil bench faults{' --quick' if args.quick else ''}")
    )
    text = common.table(list(runner.HEAD), [runner.row(o) for o in found])
    return f"{text}\n\n{runner.verdict(found)}", {"faults": [asdict(o) for o in found]}


def _loop(args: argparse.Namespace) -> Found:
    """The loop under load: how late its ticks are, beside cyclictest."""
    benchpage.check(args.report)
    found = loop.compare(args.seconds)
    text = loop.table(found)
    benchpage.write(args.report, loop.page(found, f"hil bench loop --seconds {args.seconds:g}"))
    return text, {"runs": [asdict(r) for r in found]}


def _record(args: argparse.Namespace) -> Found:
    """What recording costs, and whether it loses a row."""
    found = record_speed.measure(args.seconds)
    return record_speed.table(found), asdict(found)


def _determinism(args: argparse.Namespace) -> Found:
    """Lockstep sessions by several Pythons: the same bytes, or the first difference."""
    benchpage.check(args.report)
    found = determinism.compare([sys.executable, *args.python], args.seconds)
    others = " --python PYTHON" * len(args.python)
    benchpage.write(
        args.report,
        determinism.page(found, f"hil bench determinism --seconds {args.seconds:g}{others}"),
    )
    text = common.table(list(determinism.HEAD), determinism.rows(found))
    return text, {"sessions": [asdict(s) for s in found]}


BENCHES: dict[str, Callable[[argparse.Namespace], Found]] = {
    "determinism": _determinism,
    "faults": _faults,
    "loop": _loop,
    "record": _record,
}
