"""The outcome of `hil bench real` as tables: errors by kind, by joint, and what is aimed at."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from hil import terminal
from hil.bench import real
from hil.bench.diagnosis import runner
from hil.bench.real import Ours, RealRow, ScriptErrors
from hil.experiments.replicate import counted, where
from hil.terminal import Found

#: Largest ratio of our error to the person's that is aimed at.
_AIM = 1.1
#: An error is worse than the given model's from this ratio on: two fits differ by rounding.
_WORSE = 1.001
HEAD = (
    "case", "given", "with offset", "person", "ours", "blind", "floor", "ours / person",
    "verdict", "named", "person s", "ours s", "MiB",
)  # fmt: skip
JOINT_HEAD = (
    "case",
    "joint",
    "given",
    "with offset",
    "person",
    "ours",
    "floor",
    "person's features",
)
FAILED = "internal error"
_NOTHING = "-"


def ratio(row: RealRow) -> float:
    """Our written model's error over the person's; NaN where either is missing."""
    if (
        not isinstance(row.ours, Ours)
        or not isinstance(row.script, ScriptErrors)
        or not row.ours.ladder
    ):
        return math.nan
    return row.whole(row.ours.ladder[row.ours.written]) / row.whole(row.script.final)


def blind(row: RealRow) -> float:
    """The same for the model that was chosen without the judged runs."""
    if (
        not isinstance(row.ours, Ours)
        or not isinstance(row.script, ScriptErrors)
        or not row.ours.blind
    ):
        return math.nan
    return row.whole(row.ours.blind) / row.whole(row.script.final)


def blindly_worse(row: RealRow) -> bool:
    """Whether that model is worse than the given one."""
    if not isinstance(row.ours, Ours) or not row.ours.blind:
        return False
    return row.whole(row.ours.blind) > _WORSE * row.whole(row.ours.ladder[0])


def worse(row: RealRow) -> bool:
    """Whether the written model is worse than the given one."""
    if not isinstance(row.ours, Ours) or not row.ours.ladder:
        return False
    given, written = (row.whole(row.ours.ladder[k]) for k in (0, row.ours.written))
    return written > _WORSE * given


def line(row: RealRow) -> list[str]:
    """One case: errors in %, what was named, seconds and memory."""
    errors = [_NOTHING] * 6
    named = verdict = person_s = ours_s = _NOTHING
    if isinstance(row.script, ScriptErrors):
        errors[1], errors[2] = (_number(row.whole(x)) for x in (row.script.given, row.script.final))
        person_s = f"{row.script.seconds:.1f}"
    if isinstance(row.ours, Ours):
        verdict, ours_s = row.ours.verdict, f"{row.ours.seconds:.1f}"
        named = ", ".join(f"{name} ({p:.2f})" for name, p in row.ours.names) or _NOTHING
        if whole := [row.whole(x) for x in row.ours.ladder]:
            unseen = row.whole(row.ours.blind) if row.ours.blind else math.nan
            mine = (whole[0], whole[row.ours.written], unseen, row.whole(row.ours.floor))
            errors[0], errors[3], errors[4], errors[5] = map(_number, mine)
    else:
        verdict = FAILED
    far, star = ratio(row), "*" if isinstance(row.ours, Ours) and row.ours.refitted else ""
    return [
        row.case,
        *errors,
        _NOTHING if math.isnan(far) else f"{far:.2f}{star}",
        verdict,
        named,
        person_s,
        ours_s,
        _NOTHING if math.isnan(row.mebibytes) else f"{row.mebibytes:.0f}",
    ]


def joint_lines(row: RealRow) -> list[list[str]]:
    """Errors of each joint of a case [%]; a joint that only holds its place has none."""
    out = []
    for j, joint in enumerate(row.joints):
        errors = [_NOTHING] * 5
        features = _NOTHING
        if isinstance(row.script, ScriptErrors):
            features = ", ".join(row.script.features[j]) or _NOTHING
            errors[1], errors[2] = _number(row.script.given[j]), _number(row.script.final[j])
        if isinstance(row.ours, Ours) and row.ours.ladder:
            rungs = row.ours.ladder
            errors[0], errors[3] = _number(rungs[0][j]), _number(rungs[row.ours.written][j])
            errors[4] = _number(row.ours.floor[j])
        if row.holds[j]:
            joint, errors = f"{joint} (holds)", [_NOTHING] * 5
        out.append([row.case, joint, *errors, features])
    return out


def aims(rows: Sequence[RealRow]) -> list[str]:
    """What is aimed at, and how many cases reach it."""
    known = [(r, r.script) for r in rows if isinstance(r.script, ScriptErrors)]
    complete = [r for r in rows if r.complete]
    named = [r.case for r in complete if isinstance(r.ours, Ours) and r.ours.names]
    broken = [r.case for r in rows if not isinstance(r.ours, Ours)]
    late = [r.case for r in rows if worse(r)]
    alone = [r.case for r in rows if not isinstance(r.script, ScriptErrors)]
    near, below = sum(ratio(r) <= _AIM for r, _ in known), sum(ratio(r) < 1 for r, _ in known)
    own = [r.case for r in rows if isinstance(r.ours, Ours) and r.ours.refitted]
    blinds = sum(blind(r) <= _AIM for r, _ in known), sum(blind(r) < 1 for r, _ in known)
    harmed = [r.case for r in rows if blindly_worse(r)]
    lines = [
        f"at most {_AIM:g} times the person's error: {near} of {len(known)} cases (aim: all)",
        f"below the person's error: {below} of {len(known)} cases (aim: half)",
        f"worse than the given model: {_some(late)} (aim: none)",
        f"chosen without a look at the judged runs: at most {_AIM:g} times {blinds[0]}, below "
        f"{blinds[1]}, worse than the given model {_some(harmed)}",
        f"internal errors: {_some(broken)} (aim: none)",
        f"named where nothing is missing: {_some(named)} of {len(complete)} cases (aim: none)",
    ]
    low = [r.case for r, script in known if _floor(r) > r.whole(script.final)]
    lines.append(f"noise floor stated above the person's error: {_some(low)} (aim: none)")
    if own:
        lines.append(f"* a value of every run by itself, judged runs included: {_some(own)}")
    return lines + ([f"the person's script failed: {_some(alone)}"] if alone else [])


def _floor(row: RealRow) -> float:
    """Noise floor that is stated [%]; NaN without any."""
    return row.whole(row.ours.floor) if isinstance(row.ours, Ours) and row.ours.ladder else math.nan


def _kinds(rows: Sequence[RealRow]) -> dict[str, list[RealRow]]:
    """Rows by kind of robot, in the order in which they come."""
    out: dict[str, list[RealRow]] = {}
    for row in rows:
        out.setdefault(row.kind, []).append(row)
    return out


def by_kind(rows: Sequence[RealRow]) -> list[list[str]]:
    """How many cases of each kind reach the aim, and the median ratio."""
    out = []
    for kind, some in _kinds(rows).items():
        ratios = sorted(math.inf if math.isnan(x) else x for x in map(ratio, some))
        near, below = sum(x <= _AIM for x in ratios), sum(x < 1 for x in ratios)
        middle = (ratios[(len(ratios) - 1) // 2] + ratios[len(ratios) // 2]) / 2
        out.append(
            [
                kind,
                str(len(some)),
                str(near),
                str(below),
                str(sum(map(worse, some))),
                _NOTHING if math.isinf(middle) else f"{middle:.2f}",
            ]
        )
    return out


KIND_HEAD = ("kind", "cases", f"at most {_AIM:g}", "below", "worse than given", "median ratio")


def failures(rows: Sequence[RealRow]) -> list[str]:
    """What failed on which case."""
    out = [f"{r.case}: {r.ours}" for r in rows if isinstance(r.ours, str)]
    return out + [f"{r.case}, person: {r.script}" for r in rows if isinstance(r.script, str)]


def data(rows: Sequence[RealRow]) -> list[dict[str, Any]]:
    """For JSON; what is no number is null."""
    return [{key: _plain_data(x) for key, x in asdict(row).items()} for row in rows]


def _plain_data(x: Any) -> Any:
    if isinstance(x, dict):
        return {key: _plain_data(value) for key, value in x.items()}
    if isinstance(x, list | tuple):
        return [_plain_data(value) for value in x]
    return None if isinstance(x, float) and not math.isfinite(x) else x


def text(rows: Sequence[RealRow]) -> str:
    """For the terminal; `table` lays out a head and its rows."""
    parts = []
    for kind, some in _kinds(rows).items():
        parts += [kind, terminal.table(list(HEAD), [line(r) for r in some]), ""]
    parts += [terminal.table(list(KIND_HEAD), by_kind(rows)), ""]
    return "\n".join([*parts, *(f"  {x}" for x in (*aims(rows), *failures(rows)))])


def page(rows: Sequence[RealRow], command: str, revision: str) -> str:
    """For the documentation."""
    parts = [
        "# Real recordings",
        "",
        f"Printed by `{command} --report docs/bench/real.md`",
        f"at revision {revision}.  Every public recording that the package can load, default",
        "settings.  Some runs are fitted and others judged: the split of the set, else first and",
        "second half; EMPS: the sine-like record, and the one with pulses; the lever in free",
        "motion: every other run.  Errors are rms residuals over rms effort on the runs that were",
        "not fitted, in %, over the joints that move (each in its own effort's scale).",
        "",
        "- *given*: the base model as `hil import` writes it (on foam and springs a linear spring",
        "  and an offset); *with offset*: the same by the person's script, with an offset on every",
        "  joint;",
        "- *person*: greedy least squares on hand-made features "
        "(`hil/bench/least_squares_script.py`),",
        "  chosen on the training runs alone; same rows and band;",
        "- *ours*: the model that `hil improve` writes where the judged runs are given as held-out",
        "  runs (no rung of its ladder may raise their error); *blind*: where it does not see them",
        "  at all, as the person's script; *floor*: the noise floor that it states;",
        "- *named*: with the confidence stated; seconds and memory of one process on one core;",
        "- \\*: the written model has a value of every run by itself (an offset, say), which is",
        "  estimated on the judged runs, too; the person's script has one value for all runs.",
        "",
        "## What is aimed at",
        "",
        *(f"- {x}" for x in map(_plain, aims(rows))),
        "",
        *_markdown(KIND_HEAD, by_kind(rows)),
        "",
    ]
    for kind, some in _kinds(rows).items():
        missing = "; nothing is known to be missing" if all(r.complete for r in some) else ""
        parts += [f"## {kind[0].upper()}{kind[1:]}{missing}", ""]
        parts += [*_markdown(HEAD, [line(r) for r in some]), ""]
    parts += ["## Joint by joint, and what the person's script took", ""]
    parts += [*_markdown(JOINT_HEAD, [x for r in rows for x in joint_lines(r)]), ""]
    if broken := failures(rows):
        parts += ["## What failed", "", *(f"- {x}" for x in broken), ""]
    return "\n".join(parts)


def _markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    body = ("| " + " | ".join(_plain(x) for x in row) + " |" for row in rows)
    return ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *body]


def _plain(words: str) -> str:
    """Words in which Markdown finds nothing to set."""
    return words.replace("|", "/").replace("*", "\\*").replace("_", "\\_")


def _number(x: float) -> str:
    return _NOTHING if math.isnan(x) else f"{x:.3g}" if abs(x) < 1 else f"{x:.1f}"


def _some(names: Sequence[str]) -> str:
    return f"{len(names)} ({', '.join(names)})" if names else "0"


def command(args: argparse.Namespace) -> Found:
    """Every public recording: the given model, a person's script, and the tool beside them."""
    terminal.check_page(args.report)
    todo, kept, made_by = real.cases(args.only), runner.resumed(args.resume), runner.revision()
    names = {c.name for c in todo}
    before = runner.read(kept) if kept else []
    found = {
        r["case"]["case"]: real.from_data(r["case"])
        for r in before
        if r["revision"] == made_by and r["case"]["case"] in names
    }
    left = [c for c in todo if c.name not in found]
    for row in counted(real.run(left, where(args)), len(left), "case"):
        found[row.case] = row
        if kept:
            runner.append(kept, {"revision": made_by, "case": real.to_data(row)})
    rows = [found[c.name] for c in todo]
    only = "".join(f" --only {word}" for word in args.only)
    command = f"hil bench real{only} --workers {args.workers}"
    terminal.write_page(args.report, page(rows, command, made_by))
    return text(rows), {"revision": made_by, "cases": data(rows)}
