"""`hil improve`: diagnose and add until nothing more is justified."""

from __future__ import annotations

import argparse

from hil.commands import common
from hil.commands.diagnose import add_verbose, concluded

EXAMPLE = "hil improve run.mcap --model arm.toml -o better.toml --report ladder.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    common.add_sessions(parser)
    common.add_output(parser, "M2.toml", "the improved model")
    common.add_report(parser)
    add_verbose(parser)


def run(args: argparse.Namespace) -> int:
    """Improve and print."""
    return concluded(args)
