"""The program `hil`: one table of commands, clear usage errors, and exit codes.

A mistake on the command line is one line, never a page of usage.  A failure says what to do next;
its traceback appears only with ``--debug``.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import hil
from hil import terminal
from hil.errors import HilError, in_short, own_place, unknown, user_files, with_place
from hil.interrupt import CODE, Ended, interrupts


class Parser(argparse.ArgumentParser):
    """Parser that says what is wrong in one line, and where the options are listed."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        #: Parsers of the commands by name.
        self.commands: dict[str, Parser] = {}

    @property
    def alone(self) -> str:
        """Files and names that it takes, where it takes one of each; empty where several."""
        named = [a for a in self._actions if not a.option_strings]
        several = any(a.nargs in ("+", "*", argparse.PARSER) for a in named)
        return "" if several else " ".join(str(a.metavar or a.dest) for a in named) or "no names"

    def error(self, message: str) -> NoReturn:
        """Say it and leave with exit code 2."""
        self.leave(f"{message}.")

    def leave(self, sentence: str) -> NoReturn:
        """Say a whole sentence and leave with exit code 2."""
        sys.stderr.write(f"{self.prog}: {sentence} '{self.prog} --help' lists the options.\n")
        raise SystemExit(2)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a value that is none of the choices, with the nearest one."""
        if action.choices is not None and value not in action.choices:
            known = [str(x) for x in action.choices]
            text = unknown("value", str(value), known).rstrip(".")
            raise argparse.ArgumentError(action, text)

    def options(self) -> list[str]:
        """Names of all options."""
        return [o for action in self._actions for o in action.option_strings]

    def actions(self) -> list[argparse.Action]:
        """All that can stand on the command line."""
        return list(self._actions)


def refuse_unknown(parser: Parser, words: Sequence[str]) -> None:
    """Refuse long options that a command does not have, with the nearest one that it has.

    Looked at before anything else: a mistyped option often shows as something missing.

    Parameters
    ----------
    parser : Parser
        Of the command.
    words : sequence of str
        What stands on the command line.
    """
    options = parser.options()
    end = words.index("--") if "--" in words else len(words)
    for name in (w.split("=")[0] for w in words[:end] if w.startswith("-")):
        known = any(o.startswith(name) for o in options)
        if not known and (name.startswith("--") or name[:2] not in (*options, "-")):
            long = [o[2:] for o in options if o[:2] == "--"]
            near = difflib.get_close_matches(name.lstrip("-"), long, n=1)
            hint = f"; did you mean --{near[0]}?" if near else "."
            if not _number(name.split()[0]):
                parser.leave(f"unknown option {name}{hint}")


def _number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def refuse_rest(parser: Parser, extra: Sequence[str]) -> None:
    """Refuse what a command left over."""
    if extra:
        alone = parser.alone
        where = "give all files and names together, before the options"
        where = f"the command takes {alone} and options" if alone else where
        if "--holdout" in parser.options():
            where += ", and --holdout before each held-out session"
        if _number(extra[0]):
            where = "write several values of an option with commas, e.g. 1.5,2,0.3"
        parser.error(f"unexpected {extra[0]!r}; {where}")


def explain(
    error: Exception, command: str, suspect: Callable[[BaseException], str] = lambda error: ""
) -> tuple[str, int]:
    """Sentence and exit code of any error.

    Parameters
    ----------
    error : Exception
        What went wrong.
    command : str
        Name of the command, for the way to the traceback.
    suspect : callable
        Sentence about a file that takes the place of a module of Python; empty if none does.
    """
    if isinstance(error, HilError):
        return with_place(error), error.exit_code
    if place := own_place(error):
        return f"an effect of your own failed in {place}: {in_short(error)}; mend it there", 2
    registry = sys.modules.get("hil.registry")
    if registry is not None and (blamed := registry.culprit(error)):
        return blamed, 2
    if isinstance(error, OSError) and error.strerror:
        where = error.filename or "a file or the standard output"
        return f"cannot read or write {where}: {error.strerror}", 2
    if isinstance(error, RuntimeError) and str(error).startswith("Symlink loop"):
        # what pathlib says of it up to Python 3.12
        where = str(error).removeprefix("Symlink loop from ")
        return f"cannot read or write {where}: it links to itself; give the file that is meant", 2
    if hidden := suspect(error):
        return hidden, 2
    return (
        f"internal error: {in_short(error)}; run 'hil --debug {command} ...' for the traceback, "
        f"and please report it{_suspects()}"
    ), 1


def _suspects() -> str:
    files = sorted(Path(f).name for f in user_files())
    if not files:
        return ""
    return (
        f"; effects of your own are loaded ({', '.join(files)}): "
        "hil.testing.check_effect tells whether they keep to the rules"
    )


class Command(NamedTuple):
    """Row of the table: a module with `EXAMPLE`, `configure(parser)` and `run(args) -> int`."""

    module: str
    #: Kept here, so that the list of commands loads none of them.
    help: str
    #: Whether it shows how far it has come; others are short, or show that themselves.
    long: bool = False


#: In the order of a day's work.  A command stands here when it works, not before.
COMMANDS: dict[str, Command] = {
    "demo": Command(
        "hil.commands.demo",
        "the whole story on simulated devices: a hidden effect, found from the recording alone",
    ),
    "run": Command("hil.commands.run", "run a session of a rig and record it"),
    "ui": Command(
        "hil.commands.ui", "the operator's page of a rig: commands, forces, health of the loop"
    ),
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
        "hil.commands.import_",
        "convert a table of any rig (CSV, NPZ, MAT, Parquet, XLSX, LeRobot, ...) into a session",
        long=True,
    ),
    "trust": Command(
        "hil.commands.trust",
        "agree to run what a model file (plugins) or a rig file (cut program) names",
    ),
    "info": Command(
        "hil.commands.info", "channels, rates, gaps and data faults of recordings", long=True
    ),
    "list": Command(
        "hil.commands.list",
        "the recordings of a folder: rig, arms, date, length, tags, and whether they can be used",
        long=True,
    ),
    "view": Command(
        "hil.commands.view",
        "layouts for Foxglove, Lichtblick, PlotJuggler and rerun; live stream of a session",
    ),
    "fit": Command("hil.commands.fit", "identify all parameters of a model jointly", long=True),
    "compare": Command(
        "hil.commands.compare",
        "model against measurement: error, noise floor, where it fails",
        long=True,
    ),
    "diagnose": Command("hil.commands.diagnose", "which physical effect is missing", long=True),
    "add": Command(
        "hil.commands.add",
        "add one effect to a model, fit all anew, and print the held-out error before and after",
        long=True,
    ),
    "studio": Command(
        "hil.commands.studio",
        "compare, see where a model fails and add what is missing, in the browser",
    ),
    "improve": Command(
        "hil.commands.improve",
        "diagnose and add effects until nothing more is justified; the error ladder",
        long=True,
    ),
    "export": Command(
        "hil.commands.export",
        "a model for another program: URDF, MJCF, SDF, Isaac Lab, C, C++, Python, ROS 2, a card",
        long=True,
    ),
    "effects": Command("hil.commands.effects", "the catalogue of physical effects"),
    "excite": Command(
        "hil.commands.excite",
        "the safe motion that identifies the model or separates rival effects",
        long=True,
    ),
    "design": Command(
        "hil.commands.design",
        "a teleoperation controller's gains, margins, sensitivity and conditioning, before it runs",
    ),
    "experiment": Command(
        "hil.commands.experiment", "a study of the thesis end to end, with its table"
    ),
    "completion": Command(
        "hil.commands.completion", "what bash, zsh or fish needs to complete commands and options"
    ),
    "bench": Command(
        "hil.commands.bench",
        "the published benchmarks: hidden effects, speed, and the three public recordings",
    ),
}


def build_parser(only: str | None = None) -> Parser:
    """Build the argument parser; with `only`, load that command's module and no other."""
    debug = "show the traceback of any error"
    quiet = "print results and errors alone: no notes, no progress"
    parser = Parser(
        prog="hil",
        description="Haptic teleoperation rigs: run, record, and find the missing physics.",
    )
    parser.add_argument("--version", action="store_true", help="print the version")
    parser.add_argument("--debug", action="store_true", help=debug)
    parser.add_argument("--quiet", action="store_true", help=quiet)
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
        command.add_argument("--quiet", action="store_true", default=argparse.SUPPRESS, help=quiet)
        command.set_defaults(run=module.run, every_command=_every_command)
        parser.commands[name] = command
    return parser


def _every_command() -> dict[str, tuple[str, list[argparse.Action]]]:
    """Help of every command, and all that can stand behind it."""
    return {
        name: (row.help, build_parser(name).commands[name].actions())
        for name, row in COMMANDS.items()
    }


def main(
    argv: Sequence[str] | None = None, suspect: Callable[[BaseException], str] = lambda error: ""
) -> int:
    """Run one command and return its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        What stands on the command line; default: of this process.
    suspect : callable
        See `explain`.

    Returns
    -------
    int
        0 done, 2 bad input or usage, 3 hardware or device fault, 1 internal error,
        130 interrupted, 128 + number ended by a signal.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    with terminal.quoted(words):
        return _main(words, suspect)


def _main(words: list[str], suspect: Callable[[BaseException], str]) -> int:
    first = next((w for w in words if not w.startswith("-")), None)
    if first is not None and first not in COMMANDS:
        sys.stderr.write(f"hil: {_one_line(unknown('command', first, COMMANDS))}\n")
        return 2
    if held := [w for w in words if "\0" in w]:
        sys.stderr.write(f"hil: {held[0]!r} holds a zero byte; no name of a file or option does\n")
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
    terminal.settings.quiet = args.quiet
    try:
        with interrupts.unwinding(args.command), terminal.working(COMMANDS[args.command].long):
            code = int(args.run(args))
            sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader has seen enough, e.g. `head`
        _drop_output()
        return 0
    except KeyboardInterrupt as stop:
        return _interrupted(str(stop))
    except Ended as end:
        return _ended(end, args.command)
    except Exception as error:
        if interrupts.seen:  # a library has made an error of its own of the interruption
            return _interrupted("")
        if args.debug:
            raise
        text, code = explain(error, args.command, suspect)
        _drop_output()
        said = f"hil {args.command}: {_one_line(text)}"
        sys.stderr.write(terminal.sentences(said, sys.stderr) + "\n")
        return code


def _one_line(text: str) -> str:
    """A message on one line, also where a name in it has several."""
    return text.replace("\n", "\\n")


def _interrupted(said: str) -> int:
    """Say that the command was interrupted, and where the record is."""
    _drop_output()
    sys.stderr.write(interrupts.line(said))
    return CODE


def _ended(end: Ended, command: str) -> int:
    """Say which signal ended the command, and where the record is; the terminal may be gone."""
    _drop_output()
    with contextlib.suppress(OSError):
        sys.stderr.write(f"hil {command}: ended by {end}{f'; {end.said}' if end.said else ''}\n")
        sys.stderr.flush()
    return int(end.code or 0)


def _drop_output() -> None:
    """Print what is still buffered; where that fails, send it nowhere, so that exiting works."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    raise SystemExit(main())
