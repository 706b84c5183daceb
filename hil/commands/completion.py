"""`hil completion`: what a shell needs to complete commands, options and values.

The script is made from the parsers themselves, so that it knows what the program knows.  It names
no path and starts no program; after an update it is made again.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

EXAMPLE = 'eval "$(hil completion bash)"'


@dataclass(frozen=True)
class ShellOption:
    """An option of a command.

    Parameters
    ----------
    names : tuple of str
        E.g. ``-o`` and ``--output``.
    help : str
        Its help on one line.
    values : tuple of str
        Values that it takes, where they are known.
    takes : bool
        Whether it takes a value at all.
    """

    names: tuple[str, ...]
    help: str
    values: tuple[str, ...]
    takes: bool


@dataclass(frozen=True)
class Words:
    """What can stand behind one command: its help, options and values of its arguments."""

    help: str
    options: tuple[ShellOption, ...]
    values: tuple[str, ...]


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("shell", choices=tuple(_SHELLS), help="the shell that reads it")


def run(args: argparse.Namespace) -> int:
    """Print the script of a shell."""
    rows = {name: _words(text, actions) for name, (text, actions) in args.every_command().items()}
    sys.stdout.write(_SHELLS[args.shell](rows) + "\n")
    return 0


def _words(text: str, actions: Sequence[argparse.Action]) -> Words:
    shown = [a for a in actions if a.help != argparse.SUPPRESS]
    options = tuple(_option(a) for a in shown if a.option_strings)
    values = [str(v) for a in actions if not a.option_strings for v in a.choices or ()]
    return Words(_plain(text), options, tuple(values))


def _option(action: argparse.Action) -> ShellOption:
    values = tuple(str(v) for v in action.choices or ())
    text = _plain(str(action.help or ""))
    return ShellOption(tuple(action.option_strings), text, values, action.nargs != 0)


def _plain(text: str) -> str:
    """Help as it may stand between quotes of any shell."""
    return re.sub(r"[^\w .,;()/%=+*-]", " ", " ".join(text.replace("%%", "%").split()))[:100]


def _flat(words: Words) -> str:
    return " ".join(n for o in words.options for n in o.names)


def _bash(commands: dict[str, Words]) -> str:
    """Completion of bash: a function that knows words, and files for everything else."""
    lines = [
        "_hil() {",
        '  local cur="${COMP_WORDS[COMP_CWORD]}" prev="${COMP_WORDS[COMP_CWORD-1]}" words=""',
        "  COMPREPLY=()",
        '  if [ "$COMP_CWORD" -eq 1 ]; then',
        f'    COMPREPLY=($(compgen -W "{" ".join(commands)} --version" -- "$cur")); return',
        "  fi",
        '  case "${COMP_WORDS[1]} $prev" in',
    ]
    for name, words in commands.items():
        for o in words.options:
            if o.values:
                case = " | ".join(f'"{name} {n}"' for n in o.names)
                reply = f'COMPREPLY=($(compgen -W "{" ".join(o.values)}" -- "$cur")); return;;'
                lines.append(f"    {case}) {reply}")
    lines += ["  esac", '  case "${COMP_WORDS[1]}" in']
    for name, words in commands.items():
        values = " ".join(words.values)
        other = f'[[ "$cur" == -* ]] || words="{values}"'
        lines.append(f'    {name}) words="{_flat(words)}"; {other};;')
    lines += [
        "  esac",
        '  COMPREPLY=($(compgen -W "$words" -- "$cur"))',
        "}",
        "complete -o default -F _hil hil",
    ]
    return "\n".join(lines)


def _zsh(commands: dict[str, Words]) -> str:
    """Completion of zsh."""
    lines = ["#compdef hil", "_hil() {", "  local -a commands", "  commands=("]
    lines += [f"    '{name}:{words.help}'" for name, words in commands.items()]
    lines += [
        "  )",
        "  if (( CURRENT == 2 )); then _describe 'command' commands; return; fi",
        "  local command=$words[2]",
        "  shift words; (( CURRENT-- ))",
        "  case $command in",
    ]
    for name, words in commands.items():
        specs = [_spec(o, n) for o in words.options for n in o.names]
        values = f"'*: :({' '.join(words.values)})'" if words.values else "'*: :_files'"
        lines.append(f"    {name}) _arguments {' '.join([*specs, values])};;")
    lines += [
        "  esac",
        "}",
        'if [ "$funcstack[1]" = "_hil" ]; then _hil "$@"; else compdef _hil hil; fi',
    ]
    return "\n".join(lines)


def _spec(option: ShellOption, name: str) -> str:
    """Specification of an option as `_arguments` reads it; each may be given again."""
    taken = ""
    if option.takes:
        taken = f":value:({' '.join(option.values)})" if option.values else ":value:_files"
    return f"'*{name}[{option.help}]{taken}'"


def _fish(commands: dict[str, Words]) -> str:
    """Completion of fish."""
    lines = ["complete -c hil -e"]
    for name, words in commands.items():
        lines.append(f"complete -c hil -n __fish_use_subcommand -f -a {name} -d '{words.help}'")
        here = f"complete -c hil -n '__fish_seen_subcommand_from {name}'"
        lines += [f"{here} {_fish_option(o)}" for o in words.options]
        if words.values:
            lines.append(f"{here} -f -a '{' '.join(words.values)}'")
    return "\n".join(lines)


def _fish_option(option: ShellOption) -> str:
    names = " ".join(f"-l {n[2:]}" if n.startswith("--") else f"-s {n[1:]}" for n in option.names)
    taken = (
        f" -x -a '{' '.join(option.values)}'" if option.values else " -r" if option.takes else ""
    )
    return f"{names}{taken} -d '{option.help}'"


_SHELLS: dict[str, Callable[[dict[str, Words]], str]] = {
    "bash": _bash,
    "zsh": _zsh,
    "fish": _fish,
}
