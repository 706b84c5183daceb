"""`hil bench`: the published benchmarks."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from hil.commands import benchhidden, benchloop, benchrecorded, benchspeed, common, plugins
from hil.commands.benchpage import Found

EXAMPLE = "hil bench diagnosis --quick"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("name", choices=sorted(BENCHES), metavar="NAME", help="which benchmark")
    common.list_names(parser, BENCHES)
    parser.add_argument(
        "--seeds", type=int, help="seeds per hidden effect (hidden: 3, diagnosis: 10)"
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
        "--seconds",
        type=float,
        default=60.0,
        help="of every run (loop), of the session (record, determinism); default 60",
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes (diagnosis, real)")
    parser.add_argument(
        "--resume",
        metavar="R.jsonl",
        help="keep every result in this file, and do not do again what it holds (diagnosis)",
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
        help="cases whose name (real: or kind) holds this word (diagnosis, real); repeatable",
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
    **benchhidden.BENCHES,
    **benchspeed.BENCHES,
    **benchrecorded.BENCHES,
    **benchloop.BENCHES,
}
