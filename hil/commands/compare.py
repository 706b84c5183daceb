"""`hil compare`: model against measurement."""

from __future__ import annotations

import argparse

from hil import terminal
from hil.commands import common
from hil.diagnosis import verbs
from hil.diagnosis.residuals import nowhere
from hil.diagnosis.verbs import Comparison
from hil.diagnosis.verdict import NO_GEOMETRY
from hil.errors import ConfigError
from hil.models.model import Band
from hil.report.data import comparison_json

EXAMPLE = "hil compare run.mcap --model arm.toml --report out.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    common.add_sessions(
        parser, what="recordings to fit (with --as-is: to judge the model on as it is)"
    )
    common.add_report(parser)
    parser.add_argument(
        "--as-is",
        action="store_true",
        help="keep the model's values; without it all are fitted again to these sessions",
    )
    parser.add_argument(
        "--like",
        default="",
        metavar="RUN",
        help="with --as-is: fitted run whose own values (payload, offset) a new run gets",
    )


def run(args: argparse.Namespace) -> int:
    """Compare and print."""
    if args.like and not args.as_is:
        raise ConfigError(
            "--like needs --as-is: without it, every run is fitted with its own values"
        )
    runs, held, model = common.load_inputs(args)
    found = verbs.compare(runs, model, held, as_is=args.as_is, like=args.like)
    common.deliver(
        args, lambda path: _report(found, path), lambda: comparison_json(found), lambda: text(found)
    )
    return 0


def _report(found: Comparison, path: str) -> None:
    from hil.report.html import comparison_report

    comparison_report(found, path)


def _short(c: Comparison, j: int) -> str:
    """Relative error over the short horizon."""
    return "-" if c.multi_step.lost else f"{c.multi_step.relative[j]:.2f}"


def _replay(c: Comparison, j: int) -> str:
    loop = c.multi_step.closed_loop
    return "-" if loop is None or loop.lost else f"{loop.relative[j]:.2f}"


def _horizon(c: Comparison) -> str:
    loop = c.multi_step.closed_loop
    return "-" if loop is None else f"{loop.horizon:.2g} s"


def text(c: Comparison) -> str:
    """The comparison for a terminal."""
    first = [f"{f.sentence}.\n" for f in c.faults if f.code == NO_GEOMETRY]
    lines = [*first, _errors(c), f"\n{_judged(c)}", _taken(c), "\nWhere it fails", *_places(c)]
    rest = (f for f in c.faults if f.code != NO_GEOMETRY)
    return "\n".join([*lines, *(f"  warning: {f.sentence}" for f in rest)])


def _errors(c: Comparison) -> str:
    """Both errors of every joint beside its noise floor."""
    floor = c.noise
    size = c.heldout.effort_rms
    rows = [
        [
            name,
            *(
                (
                    f"{c.heldout.rms[j]:.4g}",
                    f"{c.heldout.relative[j]:.2f}",
                    f"{floor[j]:.4g}",
                    f"{c.heldout.rms[j] / floor[j]:.2f}",
                )
                if size[j]
                else ("-",) * 4  # no effort was recorded
            ),
            _short(c, j),
            _replay(c, j),
        ]
        for j, name in enumerate(c.result.problem.joints)
    ]
    head = [
        "joint",
        "rms error",
        "relative %",
        "noise floor",
        "error/floor",
        "simulated %",
        "replay %",
    ]
    return terminal.table(head, rows)


def _judged(c: Comparison) -> str:
    """On what the errors are taken, and what the floor is from."""
    method = {
        "repeats": "repeated motion",
        "largest-model": "the residual of the largest model on left-out data",
    }
    fixed = all(t.fixed for t in c.result.terms)
    own = "these sessions" if fixed else "blocks of the same sessions, held out"
    judged = "held-out sessions" if c.heldout.kind == "holdout" else own
    which = "the held-out sessions" if c.heldout_floor is not None else "these sessions"
    other = " (not that of the fitted sessions)" if fixed or c.heldout_floor is not None else ""
    values = "all values fitted to these data"
    if fixed:
        values = "values of the model file; nothing was fitted"
    return (
        f"  {values}; errors on {judged}. Noise floor of {which}{other}, from "
        f"{method[c.evidence.floor.method]}.\n"
        f"  simulated %: position simulated over {c.multi_step.horizon:g} s. replay %: over "
        f"{_horizon(c)}, with a soft servo to the measured motion."
    )


def _taken(c: Comparison) -> str:
    """Filters and shift of both sides, and where they are from."""
    problem = c.result.problem
    rates, shift, lag = problem.rates, problem.shift, problem.alignment.lag
    said = "not shifted"
    if shift:
        said = f"taken {abs(shift) * 1e3:.3g} ms {'earlier' if shift < 0 else 'later'}"
    if lag:
        said += f", without a low-pass of {lag * 1e3:.3g} ms"
    if rate := 1e6 * problem.alignment.rate:
        said += f", {abs(rate):.3g} us {'earlier' if rate > 0 else 'later'} with every second"
    source = "chosen from the data; to change it, set [signal] in the model file"
    if c.result.model.band != Band():
        source = "from [signal] in the model file, else from its [fitted]"
    return (
        f"  positions filtered to {rates.position:.4g} Hz, efforts to {rates.effort:.4g} Hz; "
        f"efforts {said} ({source})"
    )


def _places(c: Comparison) -> list[str]:
    """The strongest places first."""
    places = [r for items in c.where.values() for r in items]
    if not places:
        return [f"  {nowhere(c.result.problem)}"]
    return [f"  - {r.text}" for r in sorted(places, key=lambda r: -r.strength)[:8]]
