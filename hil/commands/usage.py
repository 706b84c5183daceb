"""Mistakes on the command line: one clear line each, never a page of usage."""

from __future__ import annotations

import argparse
import difflib
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from hil.errors import unknown


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
