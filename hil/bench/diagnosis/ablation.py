"""The benchmark without one rule of the search after the other.

A case is diagnosed again only without rules that stopped something there that no other rule would
have stopped: without any other rule the search is the same, step by step.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from hil.bench.diagnosis import judge, runner
from hil.bench.diagnosis.cases import Case
from hil.diagnosis import rules
from hil.errors import DataError

Row = dict[str, Any]
#: The sessions of a case serve all its rules.
_sessions = lru_cache(maxsize=2)(judge.recordings)


@dataclass(frozen=True)
class Again:
    """A case to be diagnosed without a rule."""

    case: Case
    code: str

    @property
    def name(self) -> str:
        """Key in the results."""
        return f"{self.case.name} without {self.code}"


def run(todo: list[Case], rows: list[Row], jobs: int, path: Path | None) -> list[Row]:
    """Diagnose again without each rule that matters to a case.

    Parameters
    ----------
    todo : list of Case
        The plan.
    rows : list of dict
        Its results with all rules, of this revision.
    jobs : int
        Processes.
    path : Path or None
        File of `rows`; what is found goes to one beside it, ``.ablate.jsonl``.

    Raises
    ------
    DataError
        If results are of another revision, whose answers may be others.
    """
    kept = path.with_suffix(".ablate.jsonl") if path else None
    _same(rows, path)
    found = runner.run(repeated(todo, rows), jobs, kept, again, "again")
    _same(found, kept)
    return found


def repeated(todo: list[Case], rows: list[Row]) -> list[Again]:
    """Cases and the rules without which their answer may be another."""
    by_name = {r["case"]: r for r in rows}
    return [Again(c, code) for c in todo for code in by_name[c.name].get("alone", [])]


def again(task: Again) -> Row:
    """Row of the results: what is said of a case without a rule."""
    train, other = _sessions(task.case)
    started = time.process_time()
    with rules.without(task.code):
        row = judge.answer(task.case, train, other)
    cpu = round(time.process_time() - started, 3)
    return {"again": task.name, "case": task.case.name, "without": task.code, "cpu": cpu} | row


def _same(rows: list[Row], path: Path | None) -> None:
    """Refuse results of another revision."""
    now = runner.revision()
    others = {r["revision"] for r in rows} - {now}
    if others:
        raise DataError(
            f"{path}: results of revision {', '.join(sorted(others))}, and this is {now}: an "
            "answer that differs would not be the rule's doing; start another file"
        )
