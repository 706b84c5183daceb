"""`hil init`: a rig file of the package, copied to be edited."""

from __future__ import annotations

import argparse
import sys
import tomllib
from pathlib import Path

from hil import outputs
from hil.errors import ConfigError
from hil.rigs import NAMES, rig_path
from hil.userfile import write_text

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
    """Copy the rig file and the robots that it names; a file that is there is not replaced."""
    source = rig_path(args.name)
    output = Path(args.output or f"{args.name}.toml")
    text = source.read_text(encoding="utf-8")
    outputs.check(output, ".toml", [source], lambda path: outputs.same_text(path, ""), "empty")
    table = tomllib.loads(text)
    robots = {a["robot"] for a in table["arms"].values() if str(a.get("robot")).endswith(".urdf")}
    for name in sorted(robots):
        beside, robot = output.with_name(name), source.with_name(name).read_text(encoding="utf-8")
        if beside.exists() and not outputs.same_text(beside, robot):
            raise ConfigError(f"{beside} is there and is another robot; choose another folder")
        with outputs.writing(beside):
            write_text(beside, robot)
    with outputs.writing(output):
        write_text(output, text)
    what = table.get("controller", {}).get("name", "")
    sys.stdout.write(
        f"{output}: rig {args.name}, controller {what}, on simulated devices\n"
        f"next: hil run {output} --clock lockstep -o {output.stem}.mcap\n"
    )
    return 0
