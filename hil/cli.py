"""The program `hil`: one table of commands, one place where errors become exit codes."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from typing import NamedTuple

import hil
from hil.commands.terminal import quoted
from hil.commands.usage import Parser, explain, refuse_rest, refuse_unknown
from hil.errors import unknown
from hil.interrupt import CODE, interrupts


class Command(NamedTuple):
    """Row of the table: a module with `EXAMPLE`, `configure(parser)` and `run(args) -> int`."""

    module: str
    #: Kept here, so that the list of commands loads none of them.
    help: str


#: In the order of a day's work.  A command stands here when it works, not before.
COMMANDS: dict[str, Command] = {
    "demo": Command(
        "hil.commands.demo",
        "the whole story on simulated devices: a hidden effect, found from the recording alone",
    ),
    "run": Command("hil.commands.run", "run a session of a rig and record it"),
    "init": Command("hil.commands.init", "copy a rig file of the package, to edit"),
    "devices": Command(
        "hil.commands.devices",
        "show what is attached, what of a rig is reachable, and what is missing and why",
    ),
    "selftest": Command(
        "hil.commands.selftest",
        "test a rig device by device, first without motor power, then at a small torque",
    ),
    "replay": Command(
        "hil.commands.replay",
        "re-run the controller of a session on its recorded inputs and compare its commands",
    ),
    "import": Command(
        "hil.commands.import_", "bring a CSV, NPZ or MAT recording of any rig into a session"
    ),
    "info": Command("hil.commands.info", "channels, rates, gaps and data faults of sessions"),
    "fit": Command("hil.commands.fit", "identify all parameters of a model jointly"),
    "compare": Command(
        "hil.commands.compare", "model against measurement: error, noise floor, where it fails"
    ),
    "diagnose": Command("hil.commands.diagnose", "which physical effect is missing"),
    "add": Command(
        "hil.commands.add",
        "add one effect to a model, fit all anew, and print the held-out error before and after",
    ),
    "improve": Command(
        "hil.commands.improve",
        "diagnose and add effects until nothing more is justified; the error ladder",
    ),
    "effects": Command("hil.commands.effects", "the catalogue of physical effects"),
    "excite": Command(
        "hil.commands.excite",
        "the safe motion that identifies the model or separates rival effects",
    ),
    "design": Command(
        "hil.commands.design",
        "a teleoperation controller's gains, margins, sensitivity and conditioning, before it runs",
    ),
    "experiment": Command(
        "hil.commands.experiment", "a study of the thesis end to end, with its table"
    ),
    "bench": Command(
        "hil.commands.bench",
        "the published benchmarks: hidden effects, speed, and the three public recordings",
    ),
}


def build_parser(only: str | None = None) -> Parser:
    """Build the argument parser; with `only`, load that command's module and no other."""
    debug = "show the traceback of any error"
    parser = Parser(
        prog="hil",
        description="Haptic teleoperation rigs: run, record, and find the missing physics.",
    )
    parser.add_argument("--version", action="store_true", help="print the version")
    parser.add_argument("--debug", action="store_true", help=debug)
    sub = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name in COMMANDS:
        if name != only:
            sub.add_parser(name, help=COMMANDS[name].help)
            continue
        module = importlib.import_module(COMMANDS[name].module)
        command = sub.add_parser(
            name,
            help=COMMANDS[name].help,
            description=COMMANDS[name].help,
            epilog=f"example:\n  {module.EXAMPLE}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.configure(command)
        command.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=debug)
        command.set_defaults(run=module.run)
        parser.commands[name] = command
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Returns
    -------
    int
        0 done, 2 bad input or usage, 3 hardware or device fault, 1 internal error,
        130 interrupted.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    with quoted():
        return _main(words)


def _main(words: list[str]) -> int:
    first = next((w for w in words if not w.startswith("-")), None)
    if first is not None and first not in COMMANDS:
        sys.stderr.write(f"hil: {_one_line(unknown('command', first, COMMANDS))}\n")
        return 2
    parser = build_parser(first)
    command = parser.commands[first] if first else parser
    refuse_unknown(command, words)
    args, extra = parser.parse_known_args(words)
    refuse_rest(command, extra)
    if first is None and args.version:
        sys.stdout.write(f"hil {hil.__version__}\n")
        return 0
    if first is None:
        parser.leave(f"name a command: {', '.join(COMMANDS)}.")
    try:
        with interrupts.unwinding(args.command):
            code = int(args.run(args))
            sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader has seen enough, e.g. `head`
        _drop_output()
        return 0
    except KeyboardInterrupt as stop:
        return _interrupted(str(stop))
    except Exception as error:
        if interrupts.seen:  # a library has made an error of its own of the interruption
            return _interrupted("")
        if args.debug:
            raise
        text, code = explain(error, args.command)
        _drop_output()
        sys.stderr.write(f"hil {args.command}: {_one_line(text)}\n")
        return code


def _one_line(text: str) -> str:
    """A message on one line, also where a name in it has several."""
    return text.replace("\n", "\\n")


def _interrupted(said: str) -> int:
    """Say that the command was interrupted, and where the record is."""
    _drop_output()
    sys.stderr.write(interrupts.line(said))
    return CODE


def _drop_output() -> None:
    """Print what is still buffered; where that fails, send it nowhere, so that exiting works."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    raise SystemExit(main())
