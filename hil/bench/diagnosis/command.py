"""`hil bench diagnosis`: a plan of cases run, or run again with something changed, and its page."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

from hil import terminal
from hil.bench.diagnosis import ablation, cases, halving, runner, session, tables
from hil.errors import ConfigError
from hil.experiments.replicate import where
from hil.terminal import Found


def command(args: argparse.Namespace) -> Found:
    """Thousands of hidden effects, in the plants it was tuned on and in those it was not."""
    kept = runner.resumed(args.resume)
    terminal.check_page(args.report)
    seeds = args.seeds or cases.SEEDS
    plants = chosen(args.plants)
    todo = only([c for plant in plants for c in PLANS[plant](args.quick, seeds)], args.only)
    todo = halving.small(todo) if args.halve else todo
    rows = runner.run(todo, where(args), kept)
    quick = " --quick" if args.quick else f" --seeds {seeds}"
    which = f" --plants {plants[0]}" if len(plants) == 1 else ""
    which += "".join(f" --only {word}" for word in args.only)
    data: dict[str, object] = {"cases": rows}
    if args.ablate:
        again = ablation.run(todo, rows, where(args), kept)
        text = ablation.report(rows, again, f"hil bench diagnosis --ablate{quick}{which}")
        data |= {"without": again}
    elif args.halve:
        again = halving.run(todo, rows, where(args), kept)
        text = halving.report(rows, again, f"hil bench diagnosis --halve{quick}{which}")
        data |= {"changed": again}
    else:
        text = tables.report(rows, f"hil bench diagnosis{quick}{which}")
    terminal.write_page(args.report, text)
    return text, data


def only(todo: list[cases.SessionCase], words: Sequence[str]) -> list[cases.SessionCase]:
    """Cases whose name holds one of the words; all without any."""
    for word in words:
        if not any(word in c.name for c in todo):
            raise ConfigError(f"--only {word}: in no case's name, e.g. {todo[-1].name}")
    return [c for c in todo if not words or any(w in c.name for w in words)]


#: Plant -> its cases, quick or by seeds.
PLANS: dict[str, Callable[[bool, int], list[cases.SessionCase]]] = {
    "tuning": cases.plan,
    "test": cases.mujoco_plan,
}


def chosen(wanted: str | None) -> list[str]:
    """Plants of `wanted`; without a wish both, or what there is, which is said then."""
    if wanted == "tuning" or session.mujoco_available():
        return [wanted] if wanted in PLANS else list(PLANS)
    if wanted:
        raise ConfigError(f"--plants {wanted}: the test plants need MuJoCo: {session.MUJOCO_EXTRA}")
    terminal.log(f"without the test plants, which need MuJoCo: {session.MUJOCO_EXTRA}")
    return ["tuning"]
