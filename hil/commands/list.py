"""`hil list`: the recordings of a folder, what they are of, and whether they can be used."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from hil import terminal, work
from hil.commands import common
from hil.errors import HilError, plural
from hil.record.bags import BagChoice, is_bag
from hil.record.checks import check
from hil.record.mcap_read import SessionSummary, began, summary
from hil.record.recording import TAGS, Recording, tags_of
from hil.record.sources import below, every_arm, is_session, recorded, refuse_table_words
from hil.signals.device import OperatingState

EXAMPLE = "hil list sessions --tag needle"


@dataclass(frozen=True)
class ListedSession:
    """Row of the list.

    Parameters
    ----------
    path : str
        File, below the folder.
    of : str
        Rig, what was imported, ROS bag, or table.
    arms : tuple of str
        Names, each with the number of its joints.
    recorded : str
        Date and time (UTC); empty where the file cannot be read.
    recorded_by : str
        ``stamps`` of the recording; else the last change of the ``table`` that was imported, or of
        the ``file`` itself.
    seconds : float
        Length [s].
    tags : tuple of str
        As they were given.
    verdict : str
        ``usable``, how many faults, or why it cannot be read; that it was broken off or recovered,
        or ended PAUSED or FAULT.
    """

    path: str
    of: str = ""
    arms: tuple[str, ...] = ()
    recorded: str = ""
    recorded_by: str = ""
    seconds: float = 0.0
    tags: tuple[str, ...] = ()
    verdict: str = ""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument(
        "paths",
        nargs="+",
        metavar="FOLDER",
        help="folders with sessions and bags, or with tables alone; or files",
    )
    parser.add_argument(
        "--tag",
        action="append",
        default=[],
        metavar="TAG",
        help="only sessions with this tag (repeatable: with all of them)",
    )
    parser.add_argument("--arm", help="name of the arm of a table; arm to take of a bag")
    common.add_sources(parser)
    common.add_tables(parser)
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Print a row a session."""
    paths, choice = below(args.paths), common.bag_choice(args)
    refuse_table_words(paths, choice.table)
    rows = []
    for k, path in enumerate(paths):
        work.at(path.name, k / len(paths))
        row = _row(path, choice)
        if set(args.tag) <= set(row.tags):
            rows.append(row)
    if args.json:
        terminal.emit({"schema": "hil.list/1", "sessions": [asdict(r) for r in rows]})
        return 0
    head = ["session", "of", "arms", "recorded (UTC)", "length [s]", "tags", "verdict"]
    cells = [_cells(r) for r in rows]
    shown = [k for k in range(len(head)) if not rows or any(row[k] for row in cells)]
    left = [place for place, k in enumerate(shown) if head[k] != "length [s]"]
    table = [[row[k] for k in shown] for row in cells]
    terminal.out(terminal.table([head[k] for k in shown], table, left))
    tagged = f" with {', '.join(args.tag)}" if args.tag else ""
    terminal.out(f"\n{plural(len(rows), 'session')}{tagged} of {len(paths)}")
    if kinds := [by for by in _CHANGED if any(r.recorded_by == by for r in rows)]:
        whose = " or ".join(_CHANGED[by] for by in kinds)
        terminal.out(f"* the recording has no date; this is the last change of {whose}")
    return 0


#: What a date is of that is not the recording's own.
_CHANGED = {"table": "the imported table", "file": "the file itself"}


def _cells(r: ListedSession) -> list[str]:
    date = r.recorded + (" *" if r.recorded_by in _CHANGED else "")
    seconds = f"{r.seconds:.4g}"
    return [r.path, r.of, ", ".join(r.arms), date, seconds, ", ".join(r.tags), r.verdict]


def _row(path: Path, choice: BagChoice) -> ListedSession:
    """What a file is; what cannot be read says why in its row."""
    try:
        runs = every_arm(path, choice)
        found = summary(path) if is_session(path) else None
    except (HilError, OSError) as error:
        return ListedSession(str(path), verdict=f"cannot be read: {' '.join(str(error).split())}")
    date, by = began(found) if found else _of_file(path, runs)
    return ListedSession(
        str(path),
        _origin(found) if found else "ROS bag" if is_bag(path) else "table",
        tuple(f"{r.arm} ({r.d})" for r in runs),
        f"{date:%Y-%m-%d %H:%M}",
        by,
        max((float(r.t[-1] - r.t[0]) for r in runs), default=0.0),
        tags_of(found.metadata.get(TAGS, {})) if found else (),
        _verdict(runs, found),
    )


def _of_file(path: Path, runs: Sequence[Recording]) -> tuple[datetime, str]:
    """Date of a bag or a table and by what it is known."""
    seconds, by = recorded(path, runs)
    return datetime.fromtimestamp(seconds, UTC), by


#: States in which the motors have no torque: a session that ends so has not done what it was for.
_TORQUELESS = (OperatingState.PAUSED.name, OperatingState.FAULT.name)


def _verdict(runs: Sequence[Recording], found: SessionSummary | None) -> str:
    """``usable``, or what is wrong with a file and how many faults its arms have."""
    wrong = ["cut off"] if found and found.truncated else []
    wrong += [plural(found.damaged, "damaged record")] if found and found.damaged else []
    faults = [f.severity for r in runs for f in check(r)]
    counts = [(faults.count(severity), severity) for severity in ("error", "warning")]
    wrong += [plural(count, severity) for count, severity in counts if count]
    wrong += [] if runs else ["no arm"]
    ended = ["broken off"] if found and found.end and found.end.text else []
    last = found.states[-1].state if found and found.states else ""
    ended += [f"ended {last}"] if last in _TORQUELESS else []
    ended += ["recovered"] if found and found.recovered else []
    return ", ".join([*(wrong or ["usable"]), *ended])


def _origin(found: SessionSummary) -> str:
    told = found.metadata
    if rig := told.get("session", {}).get("rig"):
        return f"rig {rig}"
    table = told.get("import", {}).get("table", "")
    return f"from {table}" if table else ""
