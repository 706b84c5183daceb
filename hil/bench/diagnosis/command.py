"""`hil bench diagnosis`: a plan of cases run, or run again with something changed, and its page.

With --halve a small plan is diagnosed with one decision constant halved and doubled after the
other.  What is derived from a number follows it: `hil.diagnosis.constants` is made anew with another
value in its place, and every module of the diagnosis that has taken a name from it gets the new
one.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import pkgutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from hil import terminal
from hil.bench.diagnosis import ablation, cases, runner, session, tables
from hil.bench.diagnosis.cases import SessionCase
from hil.bench.diagnosis.tables import revisions, table
from hil.diagnosis import constants
from hil.errors import ConfigError, unknown
from hil.experiments.replicate import Where, where
from hil.terminal import Found

Row = dict[str, Any]
#: Sessions of the quick plan that are diagnosed with every number changed: of both plants, short,
#: with every answer; so far as few as a machine does in some ten minutes.
SMALL = (
    "none/arm/coloured/repeated/0",
    "presliding@2x0.5/arm/white/repeated/1",
    "none/planar2/white/points/50",
    "none/gantry2/dac/shuttle/50",
    "load-friction@1x1.5/spindle/white/points/6",
    "delay@1x1.5/pendulum/dac/wander/1",
    "end-stop@2x5/gantry2/white/wander/4",
    "harmonic-drive@1x5/planar2/coloured/wander/5",
    "outside-brake@1x1.5/pendulum/coloured/points/1",
    "belt-skip@1x1.5/gantry2/coloured/points/4",
)
FACTORS = (0.5, 2.0)
_SOURCE = Path(constants.__file__)


@dataclass(frozen=True)
class Changed:
    """A case to be diagnosed with a number multiplied."""

    case: SessionCase
    number: str
    factor: float

    @property
    def name(self) -> str:
        """Key in the results."""
        return f"{self.case.name} with {self.factor:g} {self.number}"


def numbers() -> dict[str, float]:
    """Decision constants that follow from no other one, in the order of their file."""
    out = {}
    for node in ast.parse(_SOURCE.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            if not any(isinstance(n, ast.Name) for n in ast.walk(node.value)):
                out[name] = ast.literal_eval(node.value)
    return out


def varied(number: str, factor: float) -> dict[str, Any]:
    """All constants with one of them multiplied; whole numbers stay whole and above zero.

    Raises
    ------
    ConfigError
        If there is no such number.
    """
    known = numbers()
    if number not in known:
        raise ConfigError(unknown("decision constant", number, known))
    old = known[number]
    new = max(1, round(old * factor)) if isinstance(old, int) else old * factor
    tree = ast.parse(_SOURCE.read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == number:
            node.value = ast.copy_location(ast.Constant(new), node.value)
    space: dict[str, Any] = {}
    exec(compile(tree, str(_SOURCE), "exec"), space)
    return {k: v for k, v in space.items() if k.isupper()}


def _users() -> list[ModuleType]:
    """The constants, and all loaded modules that may have taken names from them."""
    package = constants.__name__.rpartition(".")[0]
    for found in pkgutil.iter_modules([str(_SOURCE.parent)], f"{package}."):
        importlib.import_module(found.name)
    return [m for name, m in list(sys.modules.items()) if name.startswith("hil.")]


@contextmanager
def changed(number: str, factor: float) -> Iterator[None]:
    """Multiply a number, and what follows from it, for a while."""
    new = varied(number, factor)
    old = {k: vars(constants)[k] for k in new}
    places = [(m, k) for m in _users() for k in new if vars(m).get(k) is old[k]]
    for module, k in places:
        setattr(module, k, new[k])
    try:
        yield
    finally:
        for module, k in places:
            setattr(module, k, old[k])


def small(todo: list[SessionCase]) -> list[SessionCase]:
    """The sessions of a plan that are diagnosed again.

    Raises
    ------
    ConfigError
        If the plan has none of them.
    """
    found = [c for c in todo if c.name in SMALL]
    if not found:
        raise ConfigError(f"--halve: no session is left; it has {', '.join(SMALL)} of --quick")
    return found


def run(todo: list[SessionCase], rows: list[Row], where: Where, path: Path | None) -> list[Row]:
    """Diagnose every case with every number halved and doubled.

    Parameters
    ----------
    todo : list of SessionCase
        The small plan.
    rows : list of dict
        Its results as things are, of this revision.
    where : Where
        Who computes.
    path : Path or None
        File of `rows`; what is found goes to one beside it, ``.halve.jsonl``.

    Raises
    ------
    DataError
        If results are of another revision.
    """
    kept = path.with_suffix(".halve.jsonl") if path else None
    ablation.same(rows, path)
    tasks = [Changed(c, n, x) for c in todo for n in numbers() for x in FACTORS]
    found = runner.run(tasks, where, kept, again, "again")
    ablation.same(found, kept)
    return found


def again(task: Changed) -> Row:
    """Row of the results: what is said of a case with a number changed."""
    with changed(task.number, task.factor):
        row = ablation.anew(task.case)
    return {"again": task.name, "number": task.number, "factor": task.factor} | row


_FLIPS = ("changed", "right to wrong", "wrong to right")
_HEAD = ["number", "value", *(f"{x}: {y}" for x in ("halved", "doubled") for y in _FLIPS)]


def report(rows: list[Row], again: list[Row], command: str) -> str:
    """Everything, as Markdown."""
    before = {r["case"]: r for r in rows}
    lines = [
        "# Decision constants, halved and doubled",
        "",
        f"Made by `{command}` at revision {revisions(rows)}; {len(rows)} sessions, "
        f"{len(again)} diagnoses.",
        "",
        "Every number of `hil/diagnosis/constants.py` that follows from no other one is halved and",
        "doubled; what is derived from it follows. Changed: sessions whose verdict, names or",
        "outcome are others. Right: exactly what is hidden, or a set with the truth in it.",
        "So few sessions show which numbers matter much. They do not show that another is idle.",
        "",
        table(_HEAD, [_line(n, v, before, again) for n, v in numbers().items()]),
        "",
        "## Answers that change",
        "",
        _changes(before, again),
    ]
    return "\n".join(lines) + "\n"


def _line(number: str, value: float, before: dict[str, Row], again: list[Row]) -> list[Any]:
    out: list[Any] = [number, f"{value:g}"]
    for factor in FACTORS:
        mine = [r for r in again if (r["number"], r["factor"]) == (number, factor)]
        pairs = [(before[r["case"]], r) for r in mine]
        out.append(sum(ablation.differ(a, b) for a, b in pairs))
        out.append(sum(ablation.good(a) and not ablation.good(b) for a, b in pairs))
        out.append(sum(ablation.good(b) and not ablation.good(a) for a, b in pairs))
    return out


def _changes(before: dict[str, Row], again: list[Row]) -> str:
    lines = [
        [
            f"{b['number']} x {b['factor']:g}",
            b["case"],
            ablation.words(before[b["case"]]),
            ablation.words(b),
        ]
        for b in again
        if ablation.differ(before[b["case"]], b)
    ]
    head = ["number", "session", "as it is", "with it changed"]
    return table(head, lines) if lines else "None."


def command(args: argparse.Namespace) -> Found:
    """Thousands of hidden effects, in the plants it was tuned on and in those it was not."""
    kept = runner.resumed(args.resume)
    terminal.check_page(args.report)
    seeds = args.seeds or cases.SEEDS
    plants = chosen(args.plants)
    todo = only([c for plant in plants for c in PLANS[plant](args.quick, seeds)], args.only)
    todo = small(todo) if args.halve else todo
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
        again = run(todo, rows, where(args), kept)
        text = report(rows, again, f"hil bench diagnosis --halve{quick}{which}")
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
