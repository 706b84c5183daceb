"""`hil bench diagnosis` and `hidden`: effects hidden in the simulator, and what is named."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from tqdm import tqdm

from hil.bench import hidden, recordings
from hil.bench.diagnosis import ablation, cases, runner, session, tables
from hil.commands import benchpage, common
from hil.commands.benchpage import Found
from hil.errors import ConfigError
from hil.rigs import rig_path


def _diagnosis(args: argparse.Namespace) -> Found:
    """Thousands of hidden effects, in the plants it was tuned on and in those it was not."""
    kept = Path(args.resume) if args.resume else None
    if kept and kept.suffix != ".jsonl":
        raise ConfigError(f"--resume {kept}: a file that ends in .jsonl is needed")
    benchpage.check(args.report)
    seeds = args.seeds or cases.SEEDS
    plants = _plants(args.plants)
    todo = _only([c for plant in plants for c in PLANS[plant](args.quick, seeds)], args.only)
    rows = runner.run(todo, args.jobs, kept)
    quick = " --quick" if args.quick else f" --seeds {seeds}"
    which = f" --plants {plants[0]}" if len(plants) == 1 else ""
    which += "".join(f" --only {word}" for word in args.only)
    data: dict[str, object] = {"cases": rows}
    if args.ablate:
        again = ablation.run(todo, rows, args.jobs, kept)
        text = ablation.report(rows, again, f"hil bench diagnosis --ablate{quick}{which}")
        data |= {"without": again}
    else:
        text = tables.report(rows, f"hil bench diagnosis{quick}{which}")
    benchpage.write(args.report, text)
    return text, data


def _only(todo: list[cases.Case], words: Sequence[str]) -> list[cases.Case]:
    """Cases whose name holds one of the words; all without any."""
    for word in words:
        if not any(word in c.name for c in todo):
            raise ConfigError(f"--only {word}: in no case's name, e.g. {todo[-1].name}")
    return [c for c in todo if not words or any(w in c.name for w in words)]


#: Plant -> its cases, quick or by seeds.
PLANS: dict[str, Callable[[bool, int], list[cases.Case]]] = {
    "tuning": cases.plan,
    "test": cases.mujoco_plan,
}


def _plants(wanted: str | None) -> list[str]:
    """Plants of `wanted`; without a wish both, or what there is, which is said then."""
    if wanted == "tuning" or session.mujoco_available():
        return [wanted] if wanted in PLANS else list(PLANS)
    if wanted:
        raise ConfigError(f"--plants {wanted}: the test plants need MuJoCo: {session.MUJOCO_EXTRA}")
    common.log(f"without the test plants, which need MuJoCo: {session.MUJOCO_EXTRA}")
    return ["tuning"]


def _hidden(args: argparse.Namespace) -> Found:
    """Effects hidden in the simulated arms, named from the session alone."""
    count = args.seeds or 3
    seeds = range(1, count + 1)
    total = (len(hidden.EFFECTS) + 1) * count
    with tqdm(total=total, unit="session", disable=not sys.stderr.isatty()) as bar:
        found = hidden.run(Path(rig_path("identify")), list(seeds), report=lambda _: bar.update())
    rows = [
        [
            f"{c.effect or 'none'}{'@' + c.joint if c.effect else ''}",
            str(c.seed),
            c.verdict,
            ", ".join(c.named) or "-",
            f"{c.confidence:.2f}",
            f"{c.before:.2f}",
            f"{c.after:.2f}",
            "right" if c.right else "undecided" if c.undecided else "WRONG",
        ]
        for c in found
    ]
    head = ["hidden", "seed", "verdict", "named", "confidence", "before/floor", "after/floor", ""]
    data = {"cases": [vars(c) | {"right": c.right, "undecided": c.undecided} for c in found]}
    return common.table(head, rows) + _named_right(found), dict(data)


def _named_right(found: Sequence[hidden.Case]) -> str:
    """How many were named right, and what of the error is left."""
    present = [c for c in found if c.effect]
    right = sum(c.right for c in present)
    alarms = sum(c.false_alarm for c in found)
    return (
        f"\n  {right} of {len(present)} hidden effects named right "
        f"({100 * right / len(present):.0f} %), {sum(c.undecided for c in present)} named first of "
        f"two that the data cannot tell apart, {alarms} false alarms in "
        f"{len(found) - len(present)} sessions with none\n"
        f"  held-out error over its noise floor, worst joint: median "
        f"{recordings.median([c.before for c in present]):.2f} before, "
        f"{recordings.median([c.after for c in present]):.2f} after, "
        f"worst {max(c.after for c in present):.2f}"
    )


BENCHES: dict[str, Callable[[argparse.Namespace], Found]] = {
    "diagnosis": _diagnosis,
    "hidden": _hidden,
}
