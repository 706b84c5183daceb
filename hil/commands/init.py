"""`hil init`: a rig file of the package, copied to be edited."""

from __future__ import annotations

import argparse
import sys
import tomllib
from pathlib import Path

from hil.commands import outputs
from hil.rigs import NAMES, rig_path

EXAMPLE = "hil init teleop -o my-rig.toml"
_FIRST = "teleop"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "name",
        metavar="NAME",
        nargs="?",
        default=_FIRST,
        help=f"rig to copy: {', '.join(NAMES)} (default {_FIRST})",
    )
    parser.add_argument("-o", "--output", metavar="RIG.toml", help="file to write (NAME.toml)")


def run(args: argparse.Namespace) -> int:
    """Copy the rig file; a file that is there is not replaced."""
    source = rig_path(args.name)
    output = Path(args.output or f"{args.name}.toml")
    text = source.read_text(encoding="utf-8")
    outputs.check(output, ".toml", [source], lambda path: outputs.same_text(path, ""), "empty")
    with outputs.writing(output):
        output.write_text(text, encoding="utf-8")
    what = tomllib.loads(text).get("controller", {}).get("name", "")
    sys.stdout.write(
        f"{output}: rig {args.name}, controller {what}, on simulated devices\n"
        f"next: hil run {output} --clock lockstep -o {output.stem}.mcap\n"
    )
    return 0
