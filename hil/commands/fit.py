"""`hil fit`: identify all parameters jointly."""

from __future__ import annotations

import argparse

from hil.commands import common
from hil.compare import analysis
from hil.identify.result import FitResult
from hil.models.model import Value
from hil.models.told import in_words, without_error

EXAMPLE = "hil fit run1.mcap run2.mcap --model arm.toml -o fitted.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    common.add_sessions(parser, model=False)
    common.add_output(parser, "FITTED.toml", "the fitted model")


def run(args: argparse.Namespace) -> int:
    """Fit and print."""
    runs, _, model = common.load(args)
    result = analysis.fit(runs, model)
    if args.output:
        common.save_model(result.model, args.output)
    if args.json:
        common.emit(result.as_dict())
    else:
        common.out(text(result))
        if args.output:
            common.out(f"\nfitted model: {args.output}")
    return 0


def _remark(name: str, v: Value, joints: tuple[str, ...]) -> str:
    """Words for a code, whether the value stands for itself, why it has no standard error."""
    if v.at_bound:
        return "on its bound"
    if not v.identifiable:
        return "only in combination"
    return in_words(name, v.value, joints) or without_error(name, v)


def text(result: FitResult) -> str:
    """The fit for a terminal."""
    rows = []
    for name, v in result.values.items():
        error = f"{v.stderr:.2g}" if v.stderr == v.stderr else "-"
        unit = "" if v.unit == "1" else v.unit
        rows.append([name, f"{v.value:.5g}", error, unit, _remark(name, v, result.problem.joints)])
    head = ["parameter", "value", "std error", "unit", "remark"]
    out = common.table(head, rows, left=(0, 3, 4))
    relative = ", ".join(
        f"{j} {x:.2f} %" for j, x in zip(result.problem.joints, result.relative, strict=True)
    )
    return (
        f"{out}\n\n  relative error (fitted data): {relative}\n"
        f"  {result.basis.rank} of {result.x.shape[1]} directions determined, condition number "
        f"{result.basis.condition:.3g}, band up to {result.problem.rates.effort:.3g} Hz"
        + "".join(f"\n  warning: {text}" for _, text in result.warnings)
    )
