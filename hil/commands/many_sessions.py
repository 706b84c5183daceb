"""`hil diagnose` of many sessions: robot by robot, folder by folder, or each on its own.

A group is a run of its own, in a process or on a cluster; every answer is kept in a file as soon
as it is there, so that this process holds a row a group, however many there are.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil import terminal, work
from hil.commands import common
from hil.errors import ConfigError, HilError, plural
from hil.experiments.parallel_runs import (
    FAILED,
    KeptRuns,
    LostRun,
    computer,
    counted,
    made_by,
    spread,
)
from hil.record.sources import RobotName, below, find, robot_of
from hil.terminal import settings, silent
from hil.userfile import read_text

Data = dict[str, Any]
VERDICTS = (
    "adequate", "missing-effect", "ambiguous", "unexplained", "not-identifiable", "bad-data",
)  # fmt: skip
#: Groups up to which every short answer is printed, and up to which every row is.
_ANSWERS, _ROWS = 3, 40
#: Options that change an answer.
_WORDS = ("arm", "robot", "topic", "effort_topic", "force_topic", "joints", "lock")


@dataclass
class RobotGroup:
    """Sessions that are diagnosed together.

    Parameters
    ----------
    label : str
        What they are of, for a table.
    robot : RobotName or None
        Their robot; None where no session of it could be read.
    sessions, holdout : list of Path
        To fit and to judge on.
    failed : str
        Why nothing can be diagnosed.
    """

    label: str
    robot: RobotName | None
    sessions: list[Path] = field(default_factory=list)
    holdout: list[Path] = field(default_factory=list)
    failed: str = ""


@dataclass(frozen=True)
class _Row:
    """What a table says of a group."""

    robot: str
    label: str
    sessions: int
    verdict: str
    named: tuple[str, ...] = ()
    before: float = 0.0
    after: float = 0.0


def session_groups(args: argparse.Namespace) -> list[RobotGroup]:
    """Groups of the sessions of a command line, in the order of their first session.

    With --by a session that cannot be read is a group that says why; without, it is an error.

    Raises
    ------
    DataError, ConfigError
        If a session cannot be read, or a held-out one is of no robot of the groups.
    """
    paths = below(args.sessions) if args.by else find(args.sessions)
    kind, out = args.by or "robot", []
    arm = args.arm or (common.model_file(args.model).arm if args.model else "") or None
    choice = common.bag_choice(args)
    for k, path in enumerate(paths):
        work.at("which robots", k / len(paths))
        try:
            robot = robot_of(path, arm, choice)
        except (HilError, OSError) as error:
            if not args.by:
                raise
            out.append(RobotGroup(str(path), None, [path], failed=_line(error)))
            continue
        _place(out, path, robot, kind)
    for path in find(args.holdout):
        robot = robot_of(path, arm, choice)
        theirs = [g for g in out if g.robot and g.robot.same(robot)]
        if not theirs:
            raise ConfigError(
                f"held-out session {path} is of {robot}; no session to fit is of that robot"
            )
        for group in theirs:
            group.holdout.append(path)
    return out


def _place(out: list[RobotGroup], path: Path, robot: RobotName, kind: str) -> None:
    """Add a session to its group, or to a new one."""
    label = {"robot": str(robot), "folder": str(path.parent), "session": str(path)}[kind]
    for group in out if kind != "session" else ():
        here = kind == "robot" or group.sessions[0].parent == path.parent
        if here and group.robot is not None and group.robot.same(robot):
            group.sessions.append(path)
            return
    out.append(RobotGroup(label, robot, [path]))


def several(args: argparse.Namespace, found: Sequence[RobotGroup]) -> bool:
    """Whether the answer is of groups, and not of one robot's sessions as ever."""
    return bool(args.by or args.cluster or args.keep or len(found) > 1)


def run_groups(
    args: argparse.Namespace,
    found: Sequence[RobotGroup],
    work: Callable[[argparse.Namespace], Data],
) -> int:
    """Diagnose every group and print what came out.

    Parameters
    ----------
    args : Namespace
        Of the command.
    found : sequence of RobotGroup
        As `session_groups` gives them.
    work : callable
        Gives ``{"diagnosis": JSON, "text": short answer}`` of a command line of one group; a
        function of a module.

    Returns
    -------
    int
        2 where a group could not be diagnosed, else 0.
    """
    if args.report:
        raise ConfigError(
            f"--report is the page of one diagnosis, and these are {plural(len(found), 'group')}; "
            "give the sessions of one, or --keep FOLDER for all answers as JSON"
        )
    if args.output:
        raise ConfigError(
            f"-o is the model of one robot, and these are {plural(len(found), 'group')}; "
            "give the sessions of one"
        )
    who = computer(args)
    if not args.model:
        terminal.log("no --model given: the base model of each robot")
    began = time.perf_counter()
    with ExitStack() as stack:
        folder = args.keep or stack.enter_context(tempfile.TemporaryDirectory())
        kept = KeptRuns(folder, made_by())
        names = [_name(args, g) for g in found]
        left = [k for k, g in enumerate(found) if not g.failed and kept.read(names[k]) is None]
        jobs = [(work, _words(args, found[k])) for k in left]
        shown = not (settings.quiet or args.json)
        results = spread(_one, jobs, who)
        for k, data in counted(results, len(jobs), args.by or "robot", shown):
            kept.write(names[left[k]], {FAILED: data.text} if isinstance(data, LostRun) else data)
        answers = (
            {FAILED: g.failed} if g.failed else kept.read(name) or {}
            for g, name in zip(found, names, strict=True)
        )
        rows = _said(args, found, answers)
    if not args.json:
        terminal.out(_summary(args, rows, len(left), time.perf_counter() - began))
    return 2 if any(r.verdict in (_NOT, "bad-data") for r in rows) else 0


def _one(job: tuple[Callable[[argparse.Namespace], Data], argparse.Namespace]) -> Data:
    """Answer of one group; what cannot be diagnosed says why."""
    work, args = job
    try:
        with silent():  # a note a group would be many
            return work(args)
    except (HilError, OSError) as error:
        return {FAILED: _line(error)}


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


def _words(args: argparse.Namespace, group: RobotGroup) -> argparse.Namespace:
    """The command line of one group; paths that hold in any folder of any machine that has them."""
    return argparse.Namespace(
        **{name: getattr(args, name) for name in _WORDS if name != "robot"},
        sessions=[str(p.resolve()) for p in group.sessions],
        holdout=[str(p.resolve()) for p in group.holdout],
        model=str(Path(args.model).resolve()) if args.model else None,
        robot=str(Path(args.robot).resolve()) if args.robot else "",
        typed=[str(p) for p in group.sessions],
    )


def one_arm(path: str, arm: str) -> argparse.Namespace:
    """The command line of one arm of one session, with the base model."""
    parser = argparse.ArgumentParser()
    common.add_sessions(parser)
    args = parser.parse_args([path, "--arm", arm])
    return _words(args, RobotGroup(path, None, [Path(path)]))


def _name(args: argparse.Namespace, group: RobotGroup) -> str:
    """File of an answer: of these very sessions, by size and time, this model and these options."""
    told = {
        "sessions": [_stamp(p) for p in group.sessions],
        "holdout": [_stamp(p) for p in group.holdout],
        "files": [read_text(p) for p in (args.model, args.robot) if p],
        "options": {name: getattr(args, name) for name in _WORDS},
    }
    return "diagnose-" + hashlib.sha256(json.dumps(told).encode()).hexdigest()[:24]


def _stamp(path: Path) -> list[list[str | int]]:
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    stats = [(p, p.stat()) for p in files if p.exists()]
    return [[str(p), s.st_size, s.st_mtime_ns] for p, s in stats]


# ------------------------------------------------------------ what came out

_NOT = "not diagnosed"


def _said(
    args: argparse.Namespace, found: Sequence[RobotGroup], answers: Iterator[Data]
) -> list[_Row]:
    """Rows of all groups; their JSON or short answers go out one by one."""
    rows = []
    if args.json:
        terminal.write_stdout('{"schema": "hil.diagnose.groups/1", "groups": [\n')
    for k, (group, data) in enumerate(zip(found, answers, strict=True)):
        rows.append(_row(group, data))
        if args.json:
            told = {
                "group": group.label,
                "robot": str(group.robot) if group.robot else None,
                "sessions": [str(p) for p in group.sessions],
                **({FAILED: data[FAILED]} if FAILED in data else {"diagnosis": data["diagnosis"]}),
            }
            text = json.dumps(told, indent=2, allow_nan=False)
            terminal.write_stdout(f"{text}{',' * (k + 1 < len(found))}\n")
        elif len(found) <= _ANSWERS or args.verbose:
            heading = f"{group.label} ({plural(len(group.sessions), 'session')})"
            text = f"{_NOT}: {data[FAILED]}" if FAILED in data else data["text"]
            terminal.out(f"{heading}\n{'-' * len(heading)}\n{text}\n")
    if args.json:
        terminal.write_stdout("]}\n")
    return rows


def _row(group: RobotGroup, data: Data) -> _Row:
    robot, count = str(group.robot) if group.robot else "-", len(group.sessions)
    if FAILED in data:
        return _Row(robot, group.label, count, _NOT, (data[FAILED],))
    d = data["diagnosis"]
    named = [f["effect"] + (f" on {f['joint']}" if f["joint"] else "") for f in d["findings"]]
    if not d["ladder"]:
        return _Row(robot, group.label, count, d["verdict"], tuple(named))
    first, last = d["ladder"][0]["relative"], d["ladder"][-1]["relative"]
    worst = max(first, key=lambda j: first[j] or 0.0)
    ends = first[worst] or 0.0, last[worst] or 0.0
    return _Row(robot, group.label, count, d["verdict"], tuple(named), *ends)


def _summary(args: argparse.Namespace, rows: list[_Row], fresh: int, seconds: float) -> str:
    """Table of the groups, or of what they are of where they are many; then the time."""
    lines = []
    shown = rows
    if len(rows) > _ROWS and not args.verbose:
        lines += [_counts(rows), ""]
        shown = [r for r in rows if r.verdict != "adequate"][:_ROWS]
    what = {"session": "session", "folder": "folder"}.get(args.by, "robot")
    head = [what, "sessions", "verdict", "missing, or why", "error %"]
    cells = [
        [
            r.label,
            str(r.sessions),
            r.verdict,
            "; ".join(r.named) or "-",
            f"{r.before:.2f} -> {r.after:.2f}" if r.before else "-",
        ]
        for r in shown
    ]
    lines.append(terminal.table(head, cells, (0, 2, 3)))
    if len(shown) < len(rows):
        lines.append(f"  {len(rows) - len(shown)} rows more: --verbose, or --json")
    total = sum(r.sessions for r in rows)
    lines.append(
        f"\n{plural(total, 'session')} in {plural(len(rows), 'group')}; {fresh} diagnosed now in "
        f"{seconds:.0f} s"
    )
    lines.append("  error: held out, of the worst joint, given -> improved model")
    return "\n".join(lines)


def _counts(rows: list[_Row]) -> str:
    """Verdicts by robot."""
    robots = list(dict.fromkeys(r.robot for r in rows))
    cells = []
    for robot in robots:
        mine = [r for r in rows if r.robot == robot]
        verdicts = Counter(r.verdict for r in mine)
        named = Counter(n for r in mine if r.verdict != _NOT for n in r.named)
        often = ", ".join(f"{n} ({k})" for n, k in named.most_common(2))
        counts = [str(verdicts[v]) for v in (*VERDICTS, _NOT)]
        cells.append([robot, str(len(mine)), *counts, often or "-"])
    head = ["robot", "groups", *VERDICTS, _NOT, "most often missing"]
    keep = [k for k, h in enumerate(head) if h not in (*VERDICTS, _NOT) or _any(cells, k)]
    return terminal.table(
        [head[k] for k in keep], [[c[k] for k in keep] for c in cells], (0, len(keep) - 1)
    )


def _any(cells: list[list[str]], k: int) -> bool:
    return any(c[k] != "0" for c in cells)
