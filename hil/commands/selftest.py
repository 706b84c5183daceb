"""`hil selftest`: a rig device by device, without motor power and then, if allowed, with it."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict

from hil.commands import common
from hil.commands.run import add_rearm, opener
from hil.rig.config import RigConfig, load_rig
from hil.runtime.runner import unwinding_signals
from hil.runtime.selftest import USUAL, selftest

EXAMPLE = "hil selftest rigs/teleop.toml --torque 0.1"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("rig", metavar="RIG.toml", help="rig file")
    parser.add_argument(
        "--torque", type=float, default=USUAL, help=f"torque of a pulse [N m] (default {USUAL})"
    )
    parser.add_argument("--no-motors", action="store_true", help="stop before the motors")
    add_rearm(parser)
    parser.add_argument("--json", action="store_true", help="steps as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Run the steps; 0 if all of them passed, 2 if the motors were asked for and not allowed."""
    config = load_rig(args.rig)
    steps, answers = [], []

    def allowed() -> bool:
        answers.append(args.no_motors or _confirmed(config, args))
        return answers[-1] and not args.no_motors

    with unwinding_signals():
        steps_of = selftest(config, args.torque, allowed, opener(args.rig), args.rig, args.rearm)
        for step in steps_of:
            steps.append(step)
            if not args.json:
                mark = "ok  " if step.passed else "FAIL"
                common.out(f"{mark}  {step.device:<16} {step.what:<10} {step.text}")
    if args.json:
        rows = [asdict(step) for step in steps]
        common.out(json.dumps({"schema": "hil.runtime.selftest/1", "steps": rows}))
    if not all(step.passed for step in steps):
        return 3
    return 0 if all(answers) else 2


def _confirmed(config: RigConfig, args: argparse.Namespace) -> bool:
    """Whether the user has typed the name of the rig."""
    sys.stderr.write(
        f"\nNow every motor of {', '.join(config.controller.arms)} gets pulses of "
        f"{args.torque:g} N m, one joint at a time.\nRest the arms in their docks, keep clear, one "
        "hand at the emergency stop.\n"
        f"Type the name of the rig, {config.name}, to go on; anything else ends here: "
    )
    sys.stderr.flush()
    line = ""
    try:
        line = sys.stdin.readline()
    finally:
        # a terminal has ended the line itself, unless the input ended or was interrupted
        if not (line.endswith("\n") and sys.stdin.isatty()):
            sys.stderr.write("\n")
    if line.strip() == config.name:
        return True
    said = f"{line.strip()!r} is not the name of the rig" if line else "the input ended"
    sys.stderr.write(
        f"hil selftest: {said}; the motors stay off and were not tested. Type {config.name} when "
        "asked, or give --no-motors to test the rest alone\n"
    )
    return False
