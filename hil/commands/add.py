"""`hil add`: add an effect, refit everything, error before and after."""

from __future__ import annotations

import argparse

from hil import terminal
from hil.commands import common
from hil.diagnosis import verbs
from hil.diagnosis.attribution import impossible_values
from hil.diagnosis.verbs import Rung, rising, useless
from hil.errors import ConfigError
from hil.models.model import Value
from hil.report.data import ladder_json

EXAMPLE = "hil add stribeck run.mcap --joint joint2 --model arm.toml -o arm2.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument(
        "effect", help="what to add: a name that 'hil effects' lists, e.g. stribeck"
    )
    parser.add_argument("sessions", nargs="*", metavar="S.mcap", help="sessions to fit")
    parser.add_argument(
        "--joint",
        action="append",
        default=[],
        metavar="NAME",
        help="joint that gets the effect, e.g. joint2; repeat for several; without, every joint",
    )
    common.add_model(parser)
    parser.add_argument(
        "--session",
        action="append",
        default=[],
        metavar="S.mcap",
        nargs="+",
        help="the sessions, where they do not follow the effect on the command line",
    )
    common.add_holdout(parser)
    common.add_sources(parser)
    common.add_tables(parser)
    common.add_output(parser, "M2.toml", "the new model, whether or not the effect helps")


def run(args: argparse.Namespace) -> int:
    """Add and print."""
    sessions = [*args.sessions, *(s for group in args.session for s in group)]
    if not sessions:
        raise ConfigError(f"no session is given to fit; for example: {EXAMPLE}")
    runs, held, model = common.load_inputs(args, sessions)
    joints = tuple(args.joint) or ("*",)
    rungs = verbs.add(runs, model, args.effect, joints, held)
    if args.output:
        common.save_model(rungs[1].step.result.model, args.output)
    idle, worse = _idle(args.joint, *rungs), rising(list(rungs))
    odd = impossible_values(rungs[1].step.result, args.effect)
    if args.json:
        data = {"schema": "hil.add/1", "ladder": ladder_json(list(rungs))}
        warnings = [{"code": "no-benefit", "text": w} for w in idle]
        warnings += [{"code": "multi-step", "text": w} for w in worse]
        warnings += [{"code": "no-physics", "text": w} for w in odd]
        warnings += [{"code": code, "text": w} for code, w in rungs[1].step.result.warnings]
        terminal.emit({**data, "warnings": warnings})
        return 0
    terminal.out(_table(*rungs))
    for name, value in _new(*rungs).items():
        terminal.out(f"  {common.value_line(name, value, rungs[1].step.result.problem.joints)}")
    for line in (*odd, *(text for _, text in rungs[1].step.result.warnings)):
        terminal.out(f"  warning: {line}")
    for line in idle:
        terminal.out(f"  {line}")
    for warning in worse:
        terminal.out(f"  warning: {warning}")
    if args.output:
        terminal.out(f"\nnew model: {args.output}")
    return 0


def _new(before: Rung, after: Rung) -> dict[str, Value]:
    """Parameters that the effect brought."""
    known = before.step.result.values
    return {n: v for n, v in after.step.result.values.items() if n not in known}


def _idle(names: list[str], before: Rung, after: Rung) -> list[str]:
    joints = after.step.result.problem.joints
    return useless(before, after, [joints.index(n) for n in names] or list(range(len(joints))))


def _table(before: Rung, after: Rung) -> str:
    """Both errors by joint; a law of contact cannot be simulated and has only the first."""
    joints = after.step.result.problem.joints
    simulated = after.step.result.model.explains == "motor"
    rows = []
    for r in (before, after):
        values = [[f"{x:.2f}" for x in r.step.heldout.relative]]
        if simulated:
            lost, errors = r.multi_step.lost, r.multi_step.relative
            values.append(["-"] * len(joints) if lost else [f"{x:.2f}" for x in errors])
        rows.append((r.step.label, values))
    return terminal.of_joints("held-out error", joints, rows, ("%", "simulated %")[: 1 + simulated])
