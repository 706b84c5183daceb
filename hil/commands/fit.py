"""`hil fit`: identify all parameters jointly."""

from __future__ import annotations

import argparse
import re

from hil import terminal
from hil.commands import common
from hil.diagnosis import verbs
from hil.diagnosis.heldout import Examiner
from hil.diagnosis.verdict import NO_GEOMETRY
from hil.errors import ConfigError, plural
from hil.identify.result import FitResult
from hil.identify.simulated import SimulatedFit, SimulationErrors, refine
from hil.identify.solve import DESCRIBED
from hil.models.model import Value, in_words, without_error
from hil.work import single_threaded

EXAMPLE = "hil fit run1.mcap run2.mcap --model arm.toml -o fitted.toml --simulate"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    common.add_sessions(parser, model=False)
    common.add_output(parser, "FITTED.toml", "the fitted model")
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="EFFECT[:JOINT]",
        help="leave an effect of the model out, on all of its joints or on one, e.g. "
        "stribeck:joint2 (repeatable)",
    )
    parser.add_argument(
        "--simulate",
        action="store_true",
        help="refine the fit on the simulated motion; kept only where it is better on held-out "
        "thirds of the sessions",
    )
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--window",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="length of the simulations (with --simulate); default: the longest of 0.25 to 8 s in "
        "which the model stays in range",
    )
    how.add_argument(
        "--free-run",
        action="store_true",
        help="simulate whole sessions from their first state (with --simulate)",
    )
    parser.add_argument(
        "--holdout",
        action="append",
        default=[],
        metavar="H.mcap",
        help="session on which both errors are shown before and after (with --simulate; "
        "repeatable); it does not influence the fit",
    )


def run(args: argparse.Namespace) -> int:
    """Fit and print."""
    if not args.simulate and (args.window or args.free_run or args.holdout):
        raise ConfigError("--window, --free-run and --holdout belong to --simulate; add it")
    if args.window < 0:
        raise ConfigError(f"--window {args.window:g}: expected seconds above zero")
    runs, held, model = common.load_inputs(args)
    for given in args.without:
        effect, _, joint = given.partition(":")
        model = model.without(effect, joint or "*", runs[0].joints)
    result, found = verbs.fit(runs, model), None
    if args.simulate:
        Examiner(result.problem, held)  # refuses sessions that cannot be held out
        found = single_threaded(refine)(result, held, args.window, args.free_run, terminal.log)
        result = found.result
    if args.output:
        common.save_model(result.model, args.output)
    if args.json:
        more = {"simulated": found.as_dict()} if found else {}
        terminal.emit(result.as_dict() | more)
    else:
        terminal.out(text(result) + (simulated(found) if found else ""))
        if args.output:
            terminal.out(f"\nfitted model: {args.output}")
    return 0


def simulated(fit: SimulatedFit) -> str:
    """Both errors before and after a refinement on the simulated motion."""
    rows = _pair("held-out thirds", fit.heldout, fit)
    if fit.official:
        rows += _pair("--holdout", fit.official, fit)
    what = "whole thirds" if fit.free_run else f"windows of {fit.judged:.3g} s"
    best = fit.tried[0]
    said = (
        f"refined on windows of {best.window:.3g} s, pull {best.pull:g}"
        if fit.better
        else "no refinement was better on held-out windows; the one-step fit stays"
    )
    head = ["judged on", "joint", "one-step %", "refined", "simulated rms", "refined"]
    return f"\n\n{terminal.table(head, rows, left=(0, 1))}\n\n  {what} simulated; {said}"


def _pair(
    where: str, pair: tuple[SimulationErrors, SimulationErrors], fit: SimulatedFit
) -> list[list[str]]:
    """Rows of a table, one a joint: errors on some data before and after."""
    problem, (old, new) = fit.given.problem, pair
    return [
        [
            where,
            joint,
            f"{old.one_step[j]:.2f}",
            f"{new.one_step[j]:.2f}",
            f"{old.simulated[j]:.3g} {problem.robot.units[j]}",
            f"{new.simulated[j]:.3g}",
        ]
        for j, joint in enumerate(problem.joints)
    ]


def _remark(name: str, v: Value, joints: tuple[str, ...]) -> str:
    """Words for a code, whether the value stands for itself, why it has no standard error."""
    if v.at_bound:
        return "on its bound"
    if not v.identifiable:
        return "only in combination"
    if v.source == DESCRIBED:
        return "mostly the robot description's"
    return in_words(name, v.value, joints) or without_error(name, v)


def text(result: FitResult) -> str:
    """The fit for a terminal."""
    rows = []
    for name, v in result.values.items():
        told = v.stderr == v.stderr and v.identifiable
        error = f"{v.stderr:.2g}" if told else "-"
        unit = "" if v.unit == "1" else v.unit
        rows.append([name, f"{v.value:.5g}", error, unit, _remark(name, v, result.problem.joints)])
    head = ["parameter", "value", "std error", "unit", "remark"]
    out = terminal.table(head, rows, left=(0, 3, 4))
    relative = ", ".join(
        f"{j} {x:.2f} %" for j, x in zip(result.problem.joints, result.relative, strict=True)
    )
    first = "".join(f"{w}.\n\n" for code, w in result.warnings if code == NO_GEOMETRY)
    return (
        f"{first}{out}\n\n  relative error (fitted data): {relative}\n"
        f"  {result.basis.rank} of {result.x.shape[1]} directions determined, condition number "
        f"{result.basis.condition:.3g}, band up to {result.problem.rates.effort:.3g} Hz"
        + _described(result)
        + _about(result)
        + "".join(f"\n  warning: {w}" for code, w in result.warnings if code != NO_GEOMETRY)
    )


def _about(result: FitResult) -> str:
    """About what the inertias of bodies are; empty where the fit has none."""
    bodies = any(re.fullmatch(r"rigid-body\..+\.I[xyz]{2}", n) for n in result.values)
    where = "the frame of the joint, those of a URDF about the centre of mass"
    return f"\n  inertias (I..) are about {where}" if bodies else ""


def _described(result: FitResult) -> str:
    """A line on what the robot description gave; empty without."""
    if result.pull is None:
        return ""
    count = len(result.of_description())
    return (
        f"\n  by the data, the masses of the robot description are right to about "
        f"{100 * result.pull.error:.2g} %; {plural(count, 'value')} of {len(result.values)} "
        "come mostly from it, and the standard errors are of the data alone"
    )
