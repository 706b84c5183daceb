"""The benchmark without one rule of the search after the other, and what that says, as Markdown.

A case is diagnosed again only without rules that stopped something there that no other rule would
have stopped: without any other rule the search is the same, step by step.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from hil.bench.diagnosis import runner, tables
from hil.bench.diagnosis.cases import SessionCase
from hil.bench.diagnosis.tables import PLANTS, revisions, table
from hil.diagnosis import rules
from hil.errors import DataError
from hil.experiments.replicate import Where

Row = dict[str, Any]
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


def run(todo: list[SessionCase], rows: list[Row], where: Where, path: Path | None) -> list[Row]:
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
    found = runner.run(repeated(todo, rows), where, kept, again, "again")
    same(found, kept)
    return found + runner.run(together(todo, rows, found), where, kept, again, "again")


def repeated(todo: list[SessionCase], rows: list[Row]) -> list[Again]:
    """Cases and the rules without which their answer may be another."""
    by_name = {r["case"]: r for r in rows}
    return [Again(c, code) for c in todo for code in by_name[c.name].get("alone", [])]


def together(todo: list[SessionCase], rows: list[Row], found: list[Row]) -> list[Again]:
    """Cases in which one of the rules fired that change no answer alone, without all of those.

    Of two rules that stop the same, neither changes an answer alone.
    """
    by_name = {r["case"]: r for r in rows}
    moved = {r["without"] for r in found if differ(by_name[r["case"]], r)}
    idle = [code for code in (*rules.CANDIDATE, *rules.FIT) if code not in moved]
    fired = [c for c in todo if set(idle) & set(by_name[c.name].get("fired", []))]
    return [Again(c, "+".join(idle)) for c in fired] if len(idle) > 1 else []


def again(task: Again) -> Row:
    """Row of the results: what is said of a case without a rule."""
    with rules.without(*task.code.split("+")):
        row = anew(task.case)
    return {"again": task.name, "without": task.code} | row


def anew(case: SessionCase) -> Row:
    """What is said of a case now, with the CPU time that it took."""
    train, other = _sessions(case)
    started = time.process_time()
    row = runner.answer(case, train, other)
    return {"case": case.name, "cpu": round(time.process_time() - started, 3)} | row


def same(rows: list[Row], path: Path | None) -> None:
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


def good(row: Row) -> bool:
    """Whether an answer is right, or a set with the truth in it."""
    return row["outcome"] in ("right", "ambiguous")


def differ(a: Row, b: Row) -> bool:
    """Whether two answers to one case differ: verdict, names or outcome."""
    return _said(a) != _said(b) or a["outcome"] != b["outcome"]


def effects(rows: list[Row], again: list[Row]) -> list[RuleEffect]:
    """Every rule, in the order in which they are asked."""
    rows = [r for r in rows if r["outcome"] not in ("unstable", "crashed")]
    return [_effect(code, rows, again) for code in (*rules.CANDIDATE, *rules.FIT)]


def _effect(code: str, rows: list[Row], again: list[Row]) -> RuleEffect:
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


def report(rows: list[Row], again: list[Row], command: str) -> str:
    """Everything, as Markdown, for every plant that has rows."""
    plants = [p for p in PLANTS if any(tables.plant(r) == p for r in rows)]
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
        mine = [r for r in rows if tables.plant(r) == plant]
        names = {r["case"] for r in mine}
        others = [r for r in alone if r["case"] in names]
        found = effects(mine, others)
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


def _changes(rows: list[Row], again: list[Row]) -> str:
    before = {r["case"]: r for r in rows}
    lines = [
        [b["without"], b["case"], words(before[b["case"]]), words(b)]
        for b in again
        if differ(before[b["case"]], b)
    ]
    head = ["without", "session", "with it", "without it"]
    return table(head, sorted(lines)) if lines else "None."


def words(row: Row) -> str:
    """An answer in few words."""
    names = ", ".join(f"{f['effect']} {f['joint'] or ''}".strip() for f in row["named"])
    return f"{row['outcome']}: {names or row['verdict']}"


def _said(row: Row) -> tuple[str, list[tuple[str, str]]]:
    return row["verdict"], sorted((f["effect"], f["joint"] or "") for f in row["named"])
