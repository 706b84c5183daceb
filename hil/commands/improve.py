"""`hil improve`: diagnose and add until nothing more is justified."""

from __future__ import annotations

import argparse

from hil.commands import common
from hil.commands.diagnose import text
from hil.compare import analysis
from hil.compare.tables import diagnosis_json, ladder_json
from hil.compare.warn import rising
from hil.models.files import write_model

HELP = "diagnose and add effects until nothing more is justified; the error ladder"
EXAMPLE = "hil improve run.mcap --model arm.toml -o better.toml --report ladder.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    common.add_sessions(parser)
    parser.add_argument("-o", "--output", metavar="M2.toml", help="write the improved model")
    parser.add_argument("--report", metavar="R.html", help="write a self-contained report")


def run(args: argparse.Namespace) -> int:
    """Improve and print."""
    common.writable(args.output, ".toml")
    common.writable(args.report, ".html")
    runs, held, model = common.load(args)
    result = analysis.diagnose(runs, model, held)
    rungs = analysis.ladder(result)
    warnings = rising(rungs)
    # an unexplained excess or bad data leave the model as it was
    final = result.model
    if args.output:
        write_model(final, args.output)
    if args.report:
        from hil.compare.report import diagnosis_report

        diagnosis_report(result, args.report)
    if args.json:
        data = diagnosis_json(result)
        more = [{"code": "multi-step", "text": w} for w in warnings]
        data["warnings"] = [*data["warnings"], *more]  # type: ignore[misc]
        common.emit({**data, "ladder": ladder_json(rungs)})
        return 0
    common.out(text(result))
    for r in rungs:
        worst = ", ".join(f"{x:.2f} %" for x in r.multi_step.relative)
        common.out(f"  multi-step error, {r.step.label}: {worst}")
    for warning in warnings:
        common.out(f"  warning: {warning}")
    if args.output:
        common.out(f"\nimproved model: {args.output}")
    if args.report:
        common.out(f"report: {args.report}")
    return 0
