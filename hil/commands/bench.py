"""`hil bench`: the published benchmarks, by name.

Each is one function of a module, which is loaded when it is asked for.  A new benchmark is such a
function and a row of `BENCHES`.
"""

from __future__ import annotations

import argparse

from hil import terminal
from hil.commands import common
from hil.commands.common import NamedFunction
from hil.models import catalogue

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
        help="take out each rule of the search in turn, where it alone stopped something, and "
        "print which answers change (diagnosis)",
    )
    parser.add_argument(
        "--halve",
        action="store_true",
        help="halve and double each decision constant in turn, on ten sessions of --quick, and "
        "print which answers change (diagnosis)",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=60.0,
        help="of every run (loop, ui), of the session (record, determinism, studio); default 60",
    )
    parser.add_argument(
        "--minutes", type=float, default=1.0, help="for every parser (fuzz); default 1"
    )
    parser.add_argument(
        "--turns", type=int, default=5, help="of all runs (loop, ui, studio); default 5"
    )
    parser.add_argument("--hours", type=float, default=2.0, help="length of the session (soak)")
    parser.add_argument("--starts", type=int, default=1000, help="starts and stops (soak)")
    common.add_workers(parser, " (diagnosis, real, fleet)", "--jobs")
    parser.add_argument(
        "--resume",
        metavar="R.jsonl",
        help="keep every result in this file, and skip results that it holds (diagnosis, real); "
        "add the turns to those of this file (fuzz; with --minutes 0 only their table)",
    )
    parser.add_argument(
        "--report",
        metavar="R.md",
        help="write the tables too (diagnosis, real, identify, velocity, faults, loop, "
        "determinism, studio)",
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
    catalogue.load_installed()
    text, data = BENCHES[args.name].load()(args)
    if args.json:
        terminal.emit({"schema": f"hil.bench.{args.name}/1", **data})
    else:
        terminal.out(text)
    return 0


#: In the order of the help.
BENCHES: dict[str, NamedFunction] = {
    "contact": NamedFunction(
        "hil.bench.recordings:contact_command",
        "Public recordings of a teleoperation rig against foam, springs and walls",
    ),
    "determinism": NamedFunction(
        "hil.bench.determinism:command",
        "Lockstep sessions by several Pythons: the same bytes, or the first difference",
    ),
    "diagnosis": NamedFunction(
        "hil.bench.diagnosis.command:command",
        "Thousands of hidden effects, in the plants it was tuned on and in those it was not",
    ),
    "emps": NamedFunction(
        "hil.bench.recordings:emps_command",
        "Public recording of the EMPS drive: identification, and what is missing",
    ),
    "faults": NamedFunction(
        "hil.bench.faults.runner:command",
        "Every fault of device, data and process, and the state each leads to",
    ),
    "fuzz": NamedFunction(
        "hil.commands.fuzz_targets:command",
        "Every parser under mutated input; inputs that are not refused properly are kept",
    ),
    "hidden": NamedFunction(
        "hil.bench.hidden:command",
        "Effects hidden in the simulated arms, named from the session alone",
    ),
    "loop": NamedFunction(
        "hil.bench.loop:command", "The loop under load: how late its ticks are, beside cyclictest"
    ),
    "real": NamedFunction(
        "hil.bench.real:command",
        "Every public recording: the given model, a person's script, and the tool beside them",
    ),
    "record": NamedFunction(
        "hil.bench.record_speed:command",
        "What recording costs, and what a flipped bit or a cut file loses",
    ),
    "soak": NamedFunction(
        "hil.bench.soak:command",
        "Hours in real time with recording, then starts and stops: memory, latency, lost rows",
    ),
    "doors": NamedFunction(
        "hil.bench.doors:command",
        "Sources as labs have them, the command that takes each, and what comes out",
    ),
    "teleop": NamedFunction(
        "hil.bench.teleop:command",
        "Teleoperation over delay: drag, stiffness that is felt, stiffest walls, virtual fixtures",
    ),
    "ui": NamedFunction(
        "hil.bench.loop:page_command",
        "The loop with the operator's page open and closed: how late its ticks are",
    ),
    "studio": NamedFunction(
        "hil.commands.studio:bench",
        "How long the studio takes from Add to its answer, on three and on seven joints",
    ),
    "wrist": NamedFunction(
        "hil.bench.recordings:wrist_command",
        "Public recording of the Staubli TX40: the coupling of its wrist",
    ),
    "fleet": NamedFunction(
        "hil.commands.fleet:command",
        "What it costs to diagnose ten thousand sessions, measured on eleven of them",
    ),
    "identify": NamedFunction(
        "hil.bench.identify:command", "How long identification and diagnosis take, beside peers"
    ),
    "velocity": NamedFunction(
        "hil.bench.velocity:command",
        "Velocity estimators: error and delay of each, and what an update costs here",
    ),
    "ukf": NamedFunction(
        "hil.bench.costs:ukf", "Compiled elastic-transmission filter against filterpy"
    ),
    "redesign": NamedFunction(
        "hil.bench.costs:redesign",
        "Sensitivity-optimised designs: what they reach, and how long they take",
    ),
    "wire": NamedFunction(
        "hil.bench.wire:command",
        "Microseconds a tick of every driver on its simulated wire; speed of lockstep sessions",
    ),
}
