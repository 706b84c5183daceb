"""`hil add`: add an effect, refit everything, error before and after."""

from __future__ import annotations

import argparse

from hil.commands import common
from hil.compare import analysis
from hil.compare.tables import ladder_json
from hil.compare.warn import rising
from hil.models.files import write_model

HELP = "add an effect to a model, refit everything, error before and after"
EXAMPLE = "hil add stribeck --joint joint2 --model arm.toml --session run.mcap -o arm2.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("effect", help="name of an effect (see 'hil effects')")
    parser.add_argument(
        "--joint", action="append", default=[], help="joint (repeatable); default all"
    )
    common.add_model(parser)
    parser.add_argument("--session", action="append", required=True, metavar="S.mcap", nargs="+")
    parser.add_argument("--holdout", action="append", default=[], metavar="H.mcap")
    parser.add_argument("-o", "--output", metavar="M2.toml", help="write the new model")


def run(args: argparse.Namespace) -> int:
    """Add and print."""
    common.writable(args.output, ".toml")
    sessions = [s for group in args.session for s in group]
    runs, held, model = common.load(args, sessions)
    joints = tuple(args.joint) or ("*",)
    rungs = analysis.add(runs, model, args.effect, joints, held)
    if args.output:
        write_model(rungs[1].step.result.model, args.output)
    warnings = rising(list(rungs))
    if args.json:
        data = {"schema": "hil.add/1", "ladder": ladder_json(list(rungs))}
        common.emit({**data, "warnings": [{"code": "multi-step", "text": w} for w in warnings]})
        return 0
    joint_names = rungs[0].step.result.problem.joints
    rows = [
        [r.step.label, *(f"{x:.2f}" for x in (*r.step.heldout.relative, *r.multi_step.relative))]
        for r in rungs
    ]
    head = [
        "held-out error",
        *(f"{j} %" for j in joint_names),
        *(f"{j} multi-step %" for j in joint_names),
    ]
    common.out(common.table(head, rows))
    for warning in warnings:
        common.out(f"  warning: {warning}")
    if args.output:
        common.out(f"\nnew model: {args.output}")
    return 0
