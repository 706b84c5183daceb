"""`hil devices`: what a rig needs, what of it is reachable, and what to do about the rest."""

from __future__ import annotations

import argparse
import json
import sys

from hil.commands.run import named
from hil.rig import status
from hil.rig.config import load_rig
from hil.runtime import guard

EXAMPLE = "hil devices rigs/teleop.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("rig", metavar="RIG.toml", nargs="?", help="rig file")
    parser.add_argument("--json", action="store_true", help="rows as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Print one row per box and device of a rig, or what is attached at all."""
    if args.rig is None:
        rows = status.everything()
    else:
        config = load_rig(args.rig)
        with named(args.rig):
            rows = status.check(config)
        found = guard.standing(config.safety, args.rig)
        if found is not None:
            able, what = found
            rows.append(status.row("watchdog", "cut", "-", "yes" if able else "no", what))
    if args.json:
        sys.stdout.write(json.dumps({"schema": "hil.devices/1", "devices": rows}) + "\n")
    else:
        sys.stdout.write(text(rows) + "\n")
    return 3 if any(row["reachable"] == "no" for row in rows) else 0


def text(rows: list[dict[str, str]]) -> str:
    """Rows as an aligned table."""
    names = ("device", "driver", "backend", "reachable", "what")
    table = [names, *(tuple(row[n] for n in names) for row in rows)]
    width = [max(len(line[k]) for line in table) for k in range(len(names))]
    return "\n".join(
        "  ".join(cell.ljust(w) for cell, w in zip(line, width, strict=True)).rstrip()
        for line in table
    )
