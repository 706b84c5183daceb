"""The program `hil`: one table of commands, one place where errors become exit codes."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from types import ModuleType

from hil.commands.failures import explain
from hil.commands.usage import Parser, refuse_rest, refuse_unknown
from hil.errors import unknown

#: name -> module with `HELP`, `EXAMPLE`, `configure(parser)` and `run(args) -> int`; in the
#: order of a day's work.  A command stands here when it works, not before.
COMMANDS: dict[str, str] = {
    "demo": "hil.commands.demo",
    "run": "hil.commands.run",
    "devices": "hil.commands.devices",
    "selftest": "hil.commands.selftest",
    "replay": "hil.commands.replay",
    "import": "hil.commands.import_",
    "info": "hil.commands.info",
    "fit": "hil.commands.fit",
    "compare": "hil.commands.compare",
    "diagnose": "hil.commands.diagnose",
    "add": "hil.commands.add",
    "improve": "hil.commands.improve",
    "effects": "hil.commands.effects",
    "excite": "hil.commands.excite",
    "design": "hil.commands.design",
    "experiment": "hil.commands.experiment",
    "bench": "hil.commands.bench",
}


def _module(name: str) -> ModuleType:
    return importlib.import_module(COMMANDS[name])


def build_parser(only: str | None = None) -> Parser:
    """Build the argument parser; with `only`, load that command's module and no other."""
    debug = "show the traceback of any error"
    parser = Parser(
        prog="hil",
        description="Haptic teleoperation rigs: run, record, and find the missing physics.",
    )
    parser.add_argument("--debug", action="store_true", help=debug)
    sub = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name in [only] if only else COMMANDS:
        module = _module(name)
        command = sub.add_parser(
            name,
            help=module.HELP,
            description=module.HELP,
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
        0 done, 2 bad input or usage, 3 hardware or device fault, 1 internal error.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    first = next((w for w in words if not w.startswith("-")), None)
    if first is not None and first not in COMMANDS:
        sys.stderr.write(f"hil: {unknown('command', first, COMMANDS)}\n")
        return 2
    parser = build_parser(first)
    command = parser.commands[first] if first else parser
    refuse_unknown(command, words)
    args, extra = parser.parse_known_args(words)
    refuse_rest(command, extra)
    if first is None:
        parser.leave(f"name a command: {', '.join(COMMANDS)}.")
    try:
        code = int(args.run(args))
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader has seen enough, e.g. `head`
        _drop_output()
        return 0
    except KeyboardInterrupt:
        sys.stderr.write(f"hil {args.command}: interrupted; what was recorded so far is kept\n")
        return 130
    except Exception as error:
        if args.debug:
            raise
        text, code = explain(error, args.command)
        _drop_output()
        sys.stderr.write(f"hil {args.command}: {text}\n")
        return code


def _drop_output() -> None:
    """Print what is still buffered; where that fails, send it nowhere, so that exiting works."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    raise SystemExit(main())
