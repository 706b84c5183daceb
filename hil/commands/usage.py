"""Mistakes on the command line: one clear line each, never a page of usage.

What a failure says to the user, and its exit code; the traceback only with ``--debug``.
"""

from __future__ import annotations

import argparse
import difflib
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from hil.errors import HilError, unknown


class Parser(argparse.ArgumentParser):
    """Parser that says what is wrong in one line, and where the options are listed."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        #: Parsers of the commands by name.
        self.commands: dict[str, Parser] = {}

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
            near = difflib.get_close_matches(name, [o for o in options if o[:2] == "--"], n=1)
            hint = f"; did you mean {near[0]}?" if near else "."
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
        where = "files and names stand together, before the options"
        parser.error(f"unexpected {extra[0]!r}; {where}")


#: Modules of the program itself; effects from anywhere else are the user's.
_OWN = "hil."


def explain(error: Exception, command: str) -> tuple[str, int]:
    """Sentence and exit code of any error.

    Parameters
    ----------
    error : Exception
        What went wrong.
    command : str
        Name of the command, for the way to the traceback.
    """
    if isinstance(error, HilError):
        place = _place(error.__cause__)
        return f"{error}{f' ({place})' if place else ''}", error.exit_code
    place = _place(error)
    if place:
        return f"an effect of your own failed in {place}: {_what(error)}; mend it there", 2
    if isinstance(error, OSError) and error.strerror:
        where = error.filename or "a file or the standard output"
        return f"cannot read or write {where}: {error.strerror}", 2
    return (
        f"internal error: {_what(error)}; run 'hil --debug {command} ...' for the traceback, "
        f"and please report it{_suspects()}"
    ), 1


def _what(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _place(error: BaseException | None) -> str:
    """File and line of the user's code that an error passed through last; empty if none did."""
    if error is None:
        return ""
    files = user_files()
    if isinstance(error, SyntaxError) and error.filename in files:
        return f"{error.filename}, line {error.lineno}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename in files]
    return f"{frames[-1].filename}, line {frames[-1].lineno}" if frames else ""


def _suspects() -> str:
    files = sorted(Path(f).name for f in user_files())
    if not files:
        return ""
    return (
        f"; effects of your own are loaded ({', '.join(files)}): "
        "hil.testing.check_effect tells whether they keep to the rules"
    )


def user_files() -> set[str]:
    """Files of effects that do not come with the program."""
    names = {name for name in sys.modules if name.startswith("hil_plugin_")}
    if "hil.models.effect" in sys.modules:
        kinds = _below(sys.modules["hil.models.effect"].Effect)
        names |= {k.__module__ for k in kinds if not k.__module__.startswith(_OWN)}
    found = (getattr(sys.modules.get(name), "__file__", None) for name in names)
    return {file for file in found if file}


def _below(kind: type) -> set[type]:
    """All classes that a class is a base of."""
    direct: set[type] = set(kind.__subclasses__())
    return direct.union(*(_below(k) for k in direct))
