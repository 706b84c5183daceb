"""`hil diagnose`: which physical effect is missing."""

from __future__ import annotations

import argparse
from typing import Any

from hil.commands import common
from hil.commands.diagnosetext import text
from hil.diagnosis import engine, verbs
from hil.diagnosis.types import Diagnosis
from hil.diagnosis.verbs import Rung, rising
from hil.report.json import diagnosis_json, ladder_json
from hil.report.text import Files

EXAMPLE = "hil diagnose run.mcap --model arm.toml --holdout other.mcap --report why.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    common.add_sessions(parser)
    common.add_report(parser)
    add_verbose(parser)


def add_verbose(parser: argparse.ArgumentParser) -> None:
    """--verbose."""
    parser.add_argument(
        "--verbose",
        action="store_true",
        help="also explain what no motion of the robot could ever tell apart",
    )


def run(args: argparse.Namespace) -> int:
    """Diagnose and print."""
    runs, held, model = common.load(args)
    result = engine.diagnose(runs, model, held)
    show(args, result)
    return code(result)


def show(args: argparse.Namespace, result: Diagnosis) -> None:
    """Report, then JSON or text, of a diagnosis with both errors of every rung."""
    rungs = verbs.ladder(result)
    worse = rising(rungs)
    common.deliver(
        args,
        lambda path: _report(args, result, path),
        lambda: _json(result, rungs, worse),
        lambda: "\n".join([text(result, rungs, args.verbose), *(f"  warning: {w}" for w in worse)]),
    )


def code(result: Diagnosis) -> int:
    """Exit code: 2 where the recording has faults and nothing was fitted."""
    return 2 if result.verdict == "bad-data" else 0


def _json(result: Diagnosis, rungs: list[Rung], worse: list[str]) -> dict[str, Any]:
    """The diagnosis with its ladder and the warnings of the multi-step error."""
    data = diagnosis_json(result)
    more = [{"code": "multi-step", "text": w} for w in worse]
    return {
        **data,
        "warnings": [*data["warnings"], *more],  # type: ignore[misc]
        "ladder": ladder_json(rungs),
    }


def _report(args: argparse.Namespace, result: Diagnosis, path: str) -> None:
    from hil.report.html import diagnosis_report

    files = Files(tuple(args.sessions), tuple(args.holdout), args.model or "", args.arm or "")
    diagnosis_report(result, path, files)
