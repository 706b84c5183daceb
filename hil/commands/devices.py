"""`hil devices`: what a rig needs, what of it is reachable, and what to do about the rest."""

from __future__ import annotations

import argparse
import json
import sys

from hil import registry
from hil.config import RigConfig, load_rig
from hil.errors import HilError
from hil.rig import open_rig, require_backend

HELP = "show the devices of a rig, whether they are reachable, and what is missing"
EXAMPLE = "hil devices rigs/teleop.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("rig", metavar="RIG.toml", nargs="?", help="rig file")
    parser.add_argument("--json", action="store_true", help="rows as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Print one row per device, or the drivers when no rig is given."""
    if args.rig is None:
        rows = drivers()
    else:
        rows = check(load_rig(args.rig))
    if args.json:
        sys.stdout.write(json.dumps({"schema": "hil.devices/1", "devices": rows}) + "\n")
    else:
        sys.stdout.write(text(rows) + "\n")
    return 0 if all(row["reachable"] != "no" for row in rows) else 3


def drivers() -> list[dict[str, str]]:
    """All drivers that are installed, with what can be said without a rig file."""
    return [
        {"device": "-", "driver": name, "backend": "sim", "reachable": "yes",
         "what": "simulated; hardware back ends do not exist yet"}
        for name in sorted(registry.names("hil.drivers"))
    ]  # fmt: skip


def check(config: RigConfig) -> list[dict[str, str]]:
    """One row per device of the rig: is it reachable, and if not, why and what to do."""
    trouble = {}
    for name in config.devices:
        try:
            require_backend(name, config)
        except HilError as error:
            trouble[name] = str(error)
    whole = "" if trouble else _try_to_open(config)
    rows = []
    for name, device in config.devices.items():
        problem = trouble.get(name, whole)
        rows.append(
            {"device": name, "driver": device.driver, "backend": config.backend_of(name),
             "reachable": "no" if problem else "yes", "what": problem or "ready"}
        )  # fmt: skip
    return rows


def _try_to_open(config: RigConfig) -> str:
    """Open and close the rig; the error, or nothing."""
    try:
        open_rig(config, seed=0).close()
    except HilError as error:
        return str(error)
    return ""


def text(rows: list[dict[str, str]]) -> str:
    """Rows as an aligned table."""
    names = ("device", "driver", "backend", "reachable", "what")
    table = [names, *(tuple(row[n] for n in names) for row in rows)]
    width = [max(len(line[k]) for line in table) for k in range(len(names))]
    return "\n".join(
        "  ".join(cell.ljust(w) for cell, w in zip(line, width, strict=True)).rstrip()
        for line in table
    )
