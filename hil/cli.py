"""The program `hil`: one table of commands, one place where errors become exit codes."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from types import ModuleType

from hil.errors import HilError

#: name -> module with `HELP`, `EXAMPLE`, `configure(parser)` and `run(args) -> int`; in the
#: order of a day's work.  A command stands here when it works, not before.
COMMANDS: dict[str, str] = {
    "demo": "hil.commands.demo",
    "run": "hil.commands.run",
    "devices": "hil.commands.devices",
    "import": "hil.commands.import_",
    "info": "hil.commands.info",
    "fit": "hil.commands.fit",
    "compare": "hil.commands.compare",
    "diagnose": "hil.commands.diagnose",
    "add": "hil.commands.add",
    "improve": "hil.commands.improve",
    "effects": "hil.commands.effects",
    "bench": "hil.commands.bench",
}


def _module(name: str) -> ModuleType:
    return importlib.import_module(COMMANDS[name])


def build_parser(only: str | None = None) -> argparse.ArgumentParser:
    """Build the argument parser; with `only`, load that command's module and no other."""
    parser = argparse.ArgumentParser(
        prog="hil",
        description="Haptic teleoperation rigs: run, record, and find the missing physics.",
    )
    parser.add_argument("--debug", action="store_true", help="show the traceback of any error")
    sub = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
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
        command.set_defaults(run=module.run)
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
    parser = build_parser(first if first in COMMANDS else None)
    args = parser.parse_args(words)
    try:
        return int(args.run(args))
    except HilError as error:
        if args.debug:
            raise
        sys.stderr.write(f"hil {args.command}: {error}\n")
        return error.exit_code
    except BrokenPipeError:
        sys.stderr.close()
        return 0
    except KeyboardInterrupt:
        sys.stderr.write(f"hil {args.command}: interrupted; what was recorded so far is kept\n")
        return 130


if __name__ == "__main__":
    raise SystemExit(main())
