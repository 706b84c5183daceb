"""`hil replay`: re-run the law of a session on what it measured."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from hil import terminal
from hil.errors import ConfigError
from hil.record.difference import first_difference
from hil.runtime.replay import Replayed, replay

EXAMPLE = (
    "hil replay s.mcap\n  hil replay s.mcap --set force_scale=0.5\n"
    "  hil replay s.mcap --against t.mcap"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("sessions", nargs="+", metavar="S.mcap", help="sessions of 'hil run'")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=NUMBER",
        dest="changes",
        help="change a parameter of the law, and show what it would have commanded (repeatable)",
    )
    parser.add_argument(
        "--against",
        metavar="T.mcap",
        help="do not replay; print the first difference between the session and this one, e.g. of "
        "the same seed on another machine or Python",
    )
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Replay the sessions; 0 even where they differ, for the table says so."""
    if args.against:
        return _against(args)
    changes = dict(_change(text) for text in args.changes)
    found = [replay(path, changes) for path in args.sessions]
    if args.json:
        entries = [r.as_dict() for r in found]
        terminal.emit({"schema": "hil.replay/1", "sessions": entries})
    else:
        terminal.out("\n".join(text(r) for r in found))
    return 0


def _against(args: argparse.Namespace) -> int:
    """Two sessions, message by message."""
    if len(args.sessions) != 1 or args.changes:
        raise ConfigError("--against takes one session beside its own, and no --set")
    path = args.sessions[0]
    found = first_difference(path, args.against)
    if args.json:
        told = None if found is None else asdict(found)
        terminal.emit({"schema": "hil.replay/1", "identical": found is None, "first": told})
    elif found is None:
        terminal.out(f"{path} and {args.against}: the same bytes")
    else:
        terminal.out(f"{path} and {args.against} differ, first at {found}")
    return 0


def _change(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise ConfigError(f"--set {text!r}: NAME=NUMBER is needed") from None


def text(r: Replayed) -> str:
    """Table of one session."""
    lines = [f"{r.path}: {r.compared} of {r.ticks} ticks replayed"]
    if r.first is None:
        lines.append("  every command is reproduced exactly, to the last bit and DAC code")
    else:
        f = r.first
        lines.append(
            f"  {r.differ} ticks differ, the first at tick {f.tick}: {f.arm} {f.what} recorded "
            f"{f.recorded!r}, replayed {f.replayed!r}"
        )
        for arm, rms in r.rms.items():
            shown = ", ".join(f"{1e3 * v:.3g}" for v in rms)
            lines.append(f"  {arm}: rms of the difference {shown} mN m")
    return "\n".join(lines + [f"  {note}" for note in r.notes])
