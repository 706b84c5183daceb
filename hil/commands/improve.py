"""`hil improve`: diagnose and add until nothing more is justified."""

from __future__ import annotations

import argparse

from hil import terminal
from hil.commands import common
from hil.commands.diagnose import add_verbose, code, show
from hil.diagnosis import engine
from hil.diagnosis.constants import CONFIDENT

EXAMPLE = "hil improve run.mcap --model arm.toml -o better.toml --report ladder.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    common.add_sessions(parser)
    common.add_output(parser, "M2.toml", "the improved model")
    common.add_report(parser)
    add_verbose(parser)


def run(args: argparse.Namespace) -> int:
    """Improve and print."""
    runs, held, model = common.load(args)
    result = engine.diagnose(runs, model, held)
    # an unexplained excess leaves the model as it was; bad data leave none
    if args.output and result.ladder:
        common.save_model(result.model, args.output)
    show(args, result)
    if args.output and result.ladder and not args.json:
        terminal.out(f"{'improved model' if result.findings else 'model, refitted'}: {args.output}")
        for f in result.findings:
            if f.confidence < CONFIDENT:
                names = " or ".join([f"{f.effect} on {f.joint or 'the robot'}", *f.rivals])
                terminal.out(f"  not settled: {names}; these data fit either")
    return code(result)
