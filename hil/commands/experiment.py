"""`hil experiment`: a study of the thesis end to end, with its table."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable

from hil.commands import common
from hil.commands.designtext import finite
from hil.experiments import elastic

HELP = "a study of the thesis end to end, with its table"
EXAMPLE = "hil experiment elastic-ukf"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("name", choices=sorted(EXPERIMENTS), help="which study")
    parser.add_argument("--seed", type=int, default=1, help="seed of the motion (default 1)")
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Run one study and print its table."""
    text, data = EXPERIMENTS[args.name](args.seed)
    if args.json:
        common.emit({"schema": f"hil.experiment.{args.name}/1", **finite(data)})
    else:
        common.out(text)
    return 0


def _elastic(seed: int) -> tuple[str, dict[str, object]]:
    s = elastic.study(seed)
    rows = [[k, f"{v:.3f}"] for k, v in s.parameters.items()]
    lines = ["Parameters after 25 s, from guesses 40 % low to 80 % high",
             common.table(["parameter", "estimate / truth"], rows)]  # fmt: skip
    lines += [f"  correlation of {k}: {v:.2f} (-1: only the sum is known)"
              for k, v in s.correlation.items()]  # fmt: skip
    cells = [
        [f"{r.study} {r.value:g}", f"{1e3 * r.angle:.3f}", f"{1e3 * r.motor_angle:.3f}",
         f"{100 * r.speed:.2f}", f"{1e3 * r.innovation:+.3f}"]
        for r in s.rows
    ]  # fmt: skip
    head = ["parameters frozen, then", "link mrad", "motor for link", "speed %", "innovation mrad"]
    lines += ["", common.table(head, cells)]
    lines.append(
        f"  interaction torque moves the mean innovation by {1e3 * s.slope:.2f} mrad/(N m), "
        f"straight within {100 * s.departure:.1f} %"
    )
    return "\n".join(lines), dataclasses.asdict(s)


EXPERIMENTS: dict[str, Callable[[int], tuple[str, dict[str, object]]]] = {
    "elastic-ukf": _elastic,
}
