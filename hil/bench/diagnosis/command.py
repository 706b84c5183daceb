"""`hil bench diagnosis`: a plan of cases run, or run again with something changed, and its page.

With --halve a small plan is diagnosed with one decision constant halved and doubled after the
other.  What is derived from a number follows it: `hil.diagnosis.constants` is made anew with
another value in its place, and every module of the diagnosis that has taken a name from it gets the
new one.

With --ablate the benchmark is run without one rule of the search after the other.  A case is
diagnosed again only without rules that stopped something there that no other rule would have
stopped: without any other rule the search is the same, step by step.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import pkgutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

from hil import terminal
from hil.bench.diagnosis import cases, runner, session, tables
from hil.bench.diagnosis.cases import SessionCase
from hil.bench.diagnosis.tables import PLANTS, revisions, table
from hil.diagnosis import constants, rules
from hil.errors import ConfigError, DataError, unknown
from hil.experiments.parallel_runs import Where, computer
from hil.terminal import Found

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
_FACTORS = (0.5, 2.0)
_SOURCE = Path(constants.__file__)
CaseRow = dict[str, Any]
#: The sessions of a case serve all its rules.
_sessions = lru_cache(maxsize=2)(runner.recordings)


@dataclass(frozen=True)
class Again:
    """A case to be diagnosed without a rule, or without several: their codes joined by ``+``."""

    case: SessionCase
    code: str

    @property
    def name(self) -> str:
        """Key in the results."""
        return f"{self.case.name} without {self.code}"


def ablate(
    todo: list[SessionCase], rows: list[CaseRow], where: Where, path: Path | None
) -> list[CaseRow]:
    """Diagnose again without each rule that matters to a case.

    Parameters
    ----------
    todo : list of Case
        The plan.
    rows : list of dict
        Its results with all rules, of this revision.
    where : Where
        Who computes.
    path : Path or None
        File of `rows`; what is found goes to one beside it, ``.ablate.jsonl``.

    Raises
    ------
    DataError
        If results are of another revision, whose answers may be others.
    """
    kept = path.with_suffix(".ablate.jsonl") if path else None
    same(rows, path)
    found = runner.run_cases(repeated(todo, rows), where, kept, without_rule, "again")
    same(found, kept)
    return found + runner.run_cases(
        inactive_together(todo, rows, found), where, kept, without_rule, "again"
    )


def repeated(todo: list[SessionCase], rows: list[CaseRow]) -> list[Again]:
    """Cases and the rules without which their answer may be another."""
    by_name = {r["case"]: r for r in rows}
    return [Again(c, code) for c in todo for code in by_name[c.name].get("alone", [])]


def inactive_together(
    todo: list[SessionCase], rows: list[CaseRow], found: list[CaseRow]
) -> list[Again]:
    """Cases in which one of the rules fired that change no answer alone, without all of those.

    Of two rules that stop the same, neither changes an answer alone.
    """
    by_name = {r["case"]: r for r in rows}
    moved = {r["without"] for r in found if differ(by_name[r["case"]], r)}
    idle = [code for code in (*rules.CANDIDATE, *rules.FIT) if code not in moved]
    fired = [c for c in todo if set(idle) & set(by_name[c.name].get("fired", []))]
    return [Again(c, "+".join(idle)) for c in fired] if len(idle) > 1 else []


def without_rule(task: Again) -> CaseRow:
    """Row of the results: what is said of a case without a rule."""
    with rules.without(*task.code.split("+")):
        row = _anew(task.case)
    return {"again": task.name, "without": task.code} | row


def _anew(case: SessionCase) -> CaseRow:
    """What is said of a case now, with the CPU time that it took."""
    train, other = _sessions(case)
    started = time.process_time()
    row = runner.diagnosed_answer(case, train, other)
    return {"case": case.name, "cpu": round(time.process_time() - started, 3)} | row


def same(rows: list[CaseRow], path: Path | None) -> None:
    """Refuse results of another revision."""
    now = runner.revision()
    others = {r["revision"] for r in rows} - {now}
    if others:
        raise DataError(
            f"{path}: results of revision {', '.join(sorted(others))}, and this is {now}: an "
            "answer that differs would not be the rule's doing; start another file"
        )


_HEAD = (
    "rule",
    "stage",
    "fired",
    "alone",
    "changed",
    "right to wrong",
    "wrong to right",
    "share right without it, less with it, %",
    "CPU s",
)


@dataclass(frozen=True)
class RuleEffect:
    """What a rule does to the answers of a plan.

    Parameters
    ----------
    code, stage : str
        The rule, and when it is asked.
    fired, alone : int
        Sessions in which it stopped something, and in which no other rule would have.
    changed, lost, gained : int
        Sessions whose answer is another without it; is right no more; is right only then.
    interval : (float, float)
        Of the share right without it less the share right with it, at 95 %.
    seconds : float
        CPU time of the diagnoses without it.
    """

    code: str
    stage: str
    fired: int
    alone: int
    changed: int
    lost: int
    gained: int
    interval: tuple[float, float]
    seconds: float


def good(row: CaseRow) -> bool:
    """Whether an answer is right, or a set with the truth in it."""
    return row["outcome"] in ("right", "ambiguous")


def differ(a: CaseRow, b: CaseRow) -> bool:
    """Whether two answers to one case differ: verdict, names or outcome."""
    return _said(a) != _said(b) or a["outcome"] != b["outcome"]


def rule_effects(rows: list[CaseRow], again: list[CaseRow]) -> list[RuleEffect]:
    """Every rule, in the order in which they are asked."""
    rows = [r for r in rows if r["outcome"] not in ("unstable", "crashed")]
    return [_effect(code, rows, again) for code in (*rules.CANDIDATE, *rules.FIT)]


def _effect(code: str, rows: list[CaseRow], again: list[CaseRow]) -> RuleEffect:
    without = {r["case"]: r for r in again if r["without"] == code}
    pairs = [(r, without.get(r["case"], r)) for r in rows]
    lost = sum(good(a) and not good(b) for a, b in pairs)
    gained = sum(good(b) and not good(a) for a, b in pairs)
    both = sum(good(a) and good(b) for a, b in pairs)
    return RuleEffect(
        code,
        rules.stage(code),
        sum(code in r["fired"] for r in rows),
        len(without),
        sum(differ(a, b) for a, b in pairs),
        lost,
        gained,
        tables.difference(both, lost, gained, len(pairs) - both - lost - gained),
        sum(r["cpu"] for r in without.values()),
    )


def ablate_page(rows: list[CaseRow], again: list[CaseRow], command: str) -> str:
    """Everything, as Markdown, for every plant that has rows."""
    plants = [p for p in PLANTS if any(tables.plant_of(r) == p for r in rows)]
    lines = [
        "# Ablation: the diagnosis without each of its rules",
        "",
        f"Made by `{command}` at revision {revisions(rows)}; {len(rows)} sessions, "
        f"{len(again)} diagnoses without a rule or several.",
        "",
        "Fired: sessions in which the rule stopped a candidate or a fit; alone: those in",
        "which no other rule would have stopped it, which are diagnosed again without it.",
        "Right: exactly what is hidden, or a set with the truth in it. Intervals: Newcombe, 95 %,",
        "over all sessions of the plant.",
        "A rule is taken out alone: of two that stop the same, neither changes an answer here, and",
        "without both answers may change. So those that change none are taken out together, too. A",
        "name that is wrong where another was is no flip, but an answer that changes.",
    ]
    idle = []
    alone = [r for r in again if "+" not in r["without"]]
    for plant in plants:
        mine = [r for r in rows if tables.plant_of(r) == plant]
        names = {r["case"] for r in mine}
        others = [r for r in alone if r["case"] in names]
        found = rule_effects(mine, others)
        idle.append({e.code for e in found if not e.changed})
        lines += ["", f"## {PLANTS[plant]}: {len(mine)} sessions", "", _table(found)]
        lines += ["", f"### {PLANTS[plant]}: answers that change", "", _changes(mine, others)]
    still = [code for code in (*rules.CANDIDATE, *rules.FIT) if all(code in x for x in idle)]
    both = [r for r in again if "+" in r["without"]]
    if both:
        title = f"## Without all that change no answer alone: {len(both)} sessions"
        lines += ["", title, "", _changes(rows, [r | {"without": "all of them"} for r in both])]
    lines += ["", "## No answer changes without", "", *_idle(still)]
    return "\n".join(lines) + "\n"


def _idle(codes: list[str]) -> list[str]:
    """Rules that change no answer, each with the test that fails without it."""
    if not codes:
        return ["(none)"]
    held = ([code, rules.PROVOKED.get(code, "none")] for code in codes)
    return [
        "They stay for what these sessions do not hold, where a test fails without them.",
        "",
        table(["rule", "test that fails without it"], list(held)),
    ]


def _table(found: list[RuleEffect]) -> str:
    rows = [
        [
            e.code,
            e.stage,
            e.fired,
            e.alone,
            e.changed,
            e.lost,
            e.gained,
            f"{100 * e.interval[0]:+.1f} to {100 * e.interval[1]:+.1f}",
            f"{e.seconds:.0f}",
        ]
        for e in found
    ]
    return table(_HEAD, rows)


def _changes(rows: list[CaseRow], again: list[CaseRow]) -> str:
    before = {r["case"]: r for r in rows}
    lines = [
        [b["without"], b["case"], words(before[b["case"]]), words(b)]
        for b in again
        if differ(before[b["case"]], b)
    ]
    head = ["without", "session", "with it", "without it"]
    return table(head, sorted(lines)) if lines else "None."


def words(row: CaseRow) -> str:
    """An answer in few words."""
    names = ", ".join(f"{f['effect']} {f['joint'] or ''}".strip() for f in row["named"])
    return f"{row['outcome']}: {names or row['verdict']}"


def _said(row: CaseRow) -> tuple[str, list[tuple[str, str]]]:
    return row["verdict"], sorted((f["effect"], f["joint"] or "") for f in row["named"])


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


def decision_numbers() -> dict[str, float]:
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
    known = decision_numbers()
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
def constant_changed(number: str, factor: float) -> Iterator[None]:
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


def halve(
    todo: list[SessionCase], rows: list[CaseRow], where: Where, path: Path | None
) -> list[CaseRow]:
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
    same(rows, path)
    tasks = [Changed(c, n, x) for c in todo for n in decision_numbers() for x in _FACTORS]
    found = runner.run_cases(tasks, where, kept, with_number, "again")
    same(found, kept)
    return found


def with_number(task: Changed) -> CaseRow:
    """Row of the results: what is said of a case with a number changed."""
    with constant_changed(task.number, task.factor):
        row = _anew(task.case)
    return {"again": task.name, "number": task.number, "factor": task.factor} | row


_FLIPS = ("changed", "right to wrong", "wrong to right")
_FLIPS_HEAD = ["number", "value", *(f"{x}: {y}" for x in ("halved", "doubled") for y in _FLIPS)]


def halve_page(rows: list[CaseRow], again: list[CaseRow], command: str) -> str:
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
        table(_FLIPS_HEAD, [_line(n, v, before, again) for n, v in decision_numbers().items()]),
        "",
        "## Answers that change",
        "",
        _numbers_that_change(before, again),
    ]
    return "\n".join(lines) + "\n"


def _line(number: str, value: float, before: dict[str, CaseRow], again: list[CaseRow]) -> list[Any]:
    out: list[Any] = [number, f"{value:g}"]
    for factor in _FACTORS:
        mine = [r for r in again if (r["number"], r["factor"]) == (number, factor)]
        pairs = [(before[r["case"]], r) for r in mine]
        out.append(sum(differ(a, b) for a, b in pairs))
        out.append(sum(good(a) and not good(b) for a, b in pairs))
        out.append(sum(good(b) and not good(a) for a, b in pairs))
    return out


def _numbers_that_change(before: dict[str, CaseRow], again: list[CaseRow]) -> str:
    lines = [
        [
            f"{b['number']} x {b['factor']:g}",
            b["case"],
            words(before[b["case"]]),
            words(b),
        ]
        for b in again
        if differ(before[b["case"]], b)
    ]
    head = ["number", "session", "as it is", "with it changed"]
    return table(head, lines) if lines else "None."


def command(args: argparse.Namespace) -> Found:
    """Thousands of hidden effects, in the plants it was tuned on and in those it was not."""
    kept = runner.resumed(args.resume)
    terminal.check_page(args.report)
    seeds = args.seeds or cases.SEEDS_PER_CASE
    plants = chosen_plants(args.plants)
    todo = only([c for plant in plants for c in PLANS[plant](args.quick, seeds)], args.only)
    todo = small(todo) if args.halve else todo
    rows = runner.run_cases(todo, computer(args), kept)
    quick = " --quick" if args.quick else f" --seeds {seeds}"
    which = f" --plants {plants[0]}" if len(plants) == 1 else ""
    which += "".join(f" --only {word}" for word in args.only)
    data: dict[str, object] = {"cases": rows}
    if args.ablate:
        again = ablate(todo, rows, computer(args), kept)
        text = ablate_page(rows, again, f"hil bench diagnosis --ablate{quick}{which}")
        data |= {"without": again}
    elif args.halve:
        again = halve(todo, rows, computer(args), kept)
        text = halve_page(rows, again, f"hil bench diagnosis --halve{quick}{which}")
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
    "tuning": cases.rig_plan,
    "test": cases.mujoco_plan,
}


def chosen_plants(wanted: str | None) -> list[str]:
    """Plants of `wanted`; without a wish both, or what there is, which is said then."""
    if wanted == "tuning" or session.mujoco_available():
        return [wanted] if wanted in PLANS else list(PLANS)
    if wanted:
        raise ConfigError(f"--plants {wanted}: the test plants need MuJoCo: {session.MUJOCO_EXTRA}")
    terminal.log(f"without the test plants, which need MuJoCo: {session.MUJOCO_EXTRA}")
    return ["tuning"]
