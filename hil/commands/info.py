"""`hil info`: what a recording holds, and what is wrong with it before anyone fits it.

Of a session it also says when it was, and how its loop kept the pace; of a table or a ROS bag what
was taken of it.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.reader import make_reader

from hil import outputs, terminal, work
from hil.commands import common, trust
from hil.errors import ConfigError, DataError, plural
from hil.models.robots import undescribed
from hil.record.bags import BagChoice
from hil.record.checks import check, column_unit, columns, joint_units
from hil.record.consistency import DataFault
from hil.record.mcap_read import (
    ChannelSummary,
    SessionSummary,
    began,
    read_attachments,
    summary,
)
from hil.record.recording import BEGAN, BEGAN_BY, UNWRAPPED, Recording
from hil.record.recovery import recover
from hil.record.sources import every_arm, find, is_session, recorded, refuse_table_words
from hil.rig import safety
from hil.runtime.watchdog import WATCHDOG, parsed_report, report_in_words, report_path
from hil.userfile import read_text

if TYPE_CHECKING:
    from hil.identify.prepare import Prepared
    from hil.identify.timing import Lateness

_US = (
    ("wake-up late", "late"),
    ("tick takes", "busy"),
)
#: Stops of a session that are printed, each.
_STOPS = 6
_SHARES = (("p50", "p50"), ("p99", "p99"), ("p99.9", "p999"), ("most", "most"))

#: What a loop's figures must hold to be shown.
_FIGURES = {"ticks", "missed", "dropped", "ring_most", "longest_gap"} | {
    f"{key}_{q}" for _, key in _US for _, q in _SHARES
}


def when(found: SessionSummary) -> str:
    """Date and length, e.g. ``recorded 2026-11-21 13:45:02 UTC, 3 s``."""
    counted = [c for c in found.channels if c.count]
    first = min((c.first_s for c in counted), default=0.0)
    length = max((c.last_s for c in counted), default=0.0) - first
    date, by = began(found)
    if not found.channels:
        return f"{'recorded' if by == 'stamps' else 'last changed'} {date:%Y-%m-%d %H:%M:%S} UTC"
    if by == "file":  # of a session that says no date; its copies have others
        return f"{length:.4g} s"
    said = "recorded" if by == "stamps" else "table last changed"
    return f"{said} {date:%Y-%m-%d %H:%M:%S} UTC, {length:.4g} s"


def figures(session: SessionSummary) -> dict[str, float] | None:
    """Figures of the loop, where the session is of `hil run` and was closed."""
    try:
        told = json.loads(session.metadata.get("loop", {}).get("figures", ""))
        found = {str(name): value for name, value in told.items() if math.isfinite(value)}
    except (ValueError, AttributeError, TypeError, RecursionError, OverflowError):
        return None  # a record has no checksum
    return found if found.keys() >= _FIGURES else None


def loop_lines(found: SessionSummary) -> list[str]:
    """Rows about the loop; none for sessions that no loop wrote."""
    f = figures(found)
    if f is None:
        return []
    session, loop = found.metadata.get("session", {}), found.metadata["loop"]
    clock, rate = session.get("clock", "?"), session.get("rate_hz", "?").removesuffix(".0")
    rows = [
        f"loop: {f['ticks']:.0f} ticks at {rate} Hz, clock {clock}; {f['missed']:.0f} deadlines "
        f"missed, {f['dropped']:.0f} rows dropped, at most {f['ring_most']:.0f} waited in the ring"
    ]
    if clock == "lockstep":
        return [*rows, "  no time passes within a tick of a virtual clock", ""]
    rows += [
        f"  {label:<13} " + ", ".join(f"{p} {f[f'{key}_{q}']:.1f}" for p, q in _SHARES) + " us"
        for label, key in _US
    ]
    rows.append(f"  {'longest gap':<13} {f['longest_gap']:.0f} us between two ticks")
    rows.append(f"  {'arranged':<13} {loop.get('granted') or 'nothing was granted'}")
    return [*rows, ""]


EXAMPLE = "hil info run1.mcap run2.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "sessions",
        nargs="+",
        metavar="S.mcap",
        help="sessions, ROS bags, tables, or folders of them; of model and rig files (.toml), "
        "what they would run",
    )
    parser.add_argument(
        "--recover",
        metavar="OUT.mcap",
        help="write what a cut-off session still holds",
    )
    parser.add_argument("--arm", help="name of the arm of a table; arm to take of a bag")
    common.add_sources(parser)
    common.add_tables(parser)
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Print what the recordings hold."""
    if args.recover:
        return _recover(args.sessions, Path(args.recover), args.json)
    files = [path for path in args.sessions if path.endswith(".toml")]
    run_by = [(path, what) for path in files for what in trust.executables(Path(path))]
    choice = common.bag_choice(args)
    paths = find(path for path in args.sessions if path not in files)
    refuse_table_words(paths, choice.table)
    seen, unread = _all_seen(paths, choice)
    if args.json:
        entries = [_as_dict(*entry) for entry in seen]
        entries += [{"path": path, **trust.entry(what)} for path, what in run_by]
        terminal.write_stdout(json.dumps({"schema": "hil.info/1", "sessions": entries}) + "\n")
    else:
        terminal.write_stdout(terminal.sentences("\n".join(_text(*entry) for entry in seen)))
        terminal.write_stdout(
            "".join(f"{path}: {trust.list_line(what)}\n" for path, what in run_by)
        )
        idle = [path for path in files if path not in {p for p, _ in run_by}]
        terminal.write_stdout("".join(f"{path}: runs nothing\n" for path in idle))
    if unread:
        sys.stdout.flush()
        raise unread[0] if len(unread) == 1 else DataError("\n".join(map(str, unread)))
    return 0


def _all_seen(
    paths: list[Path], choice: BagChoice
) -> tuple[list[tuple[SessionSummary, list[_Arm]]], list[ConfigError | DataError]]:
    """What the readable ones hold, and the errors of the others: one does not hide the rest."""
    seen, unread = [], []
    for k, path in enumerate(paths):
        work.at(f"read {path.name}", k / len(paths))
        try:
            seen.append(_seen(path, choice))
        except (ConfigError, DataError) as error:
            if len(paths) == 1:
                raise
            unread.append(error)
    return seen, unread


def _recover(sessions: list[str], target: Path, as_json: bool) -> int:
    if len(sessions) != 1:
        raise ConfigError(f"--recover takes one session, got {len(sessions)}")
    if target.exists():
        raise ConfigError(f"{target} exists; name a new file for --recover")
    outputs.check(target, ".mcap", sessions)
    found = summary(sessions[0])
    trip = _trip(found)
    more = {} if trip is None else {WATCHDOG: {"report": json.dumps(trip)}}
    with outputs.writing(target):
        kept = recover(sessions[0], target, more)
    lost = {"unread_bytes": found.unread, "damaged_chunks": found.damaged}
    if as_json:
        entry = {"schema": "hil.info/1", "recovered": str(target), "messages": kept, **lost}
        terminal.write_stdout(json.dumps(entry) + "\n")
    else:
        terminal.write_stdout(
            f"{target}: {plural(kept, 'message')} recovered from {sessions[0]}; "
            f"{plural(found.unread, 'byte')} at its end and "
            f"{plural(found.damaged, 'damaged record')} could not be read\n"
        )
    return 0


@dataclass(frozen=True)
class _Arm:
    """An arm's recording, its faults, and what the analysis makes of it where it can."""

    recording: Recording
    faults: list[DataFault]
    prepared: Prepared | None
    readings: list[tuple[str, str]] = field(default_factory=list)
    lateness: Lateness | None = None


def _seen(path: Path, choice: BagChoice) -> tuple[SessionSummary, list[_Arm]]:
    """A session, or what else holds a recording, and its arms."""
    if is_session(path):
        return summary(path), [_arm(r) for r in every_arm(path, choice)]
    runs = every_arm(path, choice)
    return _source(path, runs), [_arm(r) for r in runs]


def _source(path: Path, runs: list[Recording]) -> SessionSummary:
    """Size and date of a table or a bag; it has no channels of this program."""
    seconds, by = recorded(path, runs)
    files = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path]
    told = {BEGAN: f"{seconds:.3f}", BEGAN_BY: "stamps" if by == "stamps" else "table"}
    size = sum(p.stat().st_size for p in files)
    arms = tuple(r.arm for r in runs)
    return SessionSummary(str(path), size, False, 0, 0, (), {"import": told}, (), arms)


def _arm(r: Recording) -> _Arm:
    faults = check(r)
    if any(f.severity == "error" for f in faults):
        return _Arm(r, faults, None)
    from hil.commands.common import note_compiling
    from hil.identify.prepare import prepared
    from hil.identify.timing import lateness

    note_compiling()
    told: list[tuple[str, str]] = []
    try:
        if any(f.code == "velocity-scale" for f in faults):
            from hil.identify.timing import reading_notes

            told = reading_notes(r)
        return _Arm(r, faults, prepared(r), told, lateness(r))
    except DataError:  # too short for any filter, which the faults say
        return _Arm(r, faults, None)


def _as_dict(found: SessionSummary, arms: list[_Arm]) -> dict[str, object]:
    return {
        "path": found.path,
        "bytes": found.bytes,
        "truncated": found.truncated,
        "unread_bytes": found.unread,
        "damaged_chunks": found.damaged,
        "channels": [
            {
                "topic": c.topic,
                "schema": c.schema,
                "count": c.count,
                "rate_hz": c.rate_hz if _periodic(c) else None,
                "first_s": c.first_s,
                "last_s": c.last_s,
                "missing": _missing(c, arms),
            }
            for c in found.channels
        ],
        "arms": [_arm_dict(arm) for arm in arms],
        "start_ns": found.zero_ns,
        "loop": figures(found),
        "metadata": found.metadata,
        "attachments": list(found.attachments),
        "states": [asdict(s) for s in found.states],
        "end": asdict(found.end) if found.end else None,
        "recovered": found.recovery or None,
        "watchdog": _trip(found),
        "executables": _executables(found),
    }


def _trip(found: SessionSummary) -> dict[str, Any] | None:
    """What the watchdog did in a session: in its record, or beside one that was killed."""
    recorded = parsed_report(str(found.metadata.get(WATCHDOG, {}).get("report", "")))
    if recorded:
        return recorded
    path = Path(found.path)
    # of a session in parts it stands beside the first
    first = path.with_name(Path(found.metadata.get("part", {}).get("first", "") or path).name)
    for report in dict.fromkeys((report_path(path), report_path(first))):
        try:
            if told := parsed_report(read_text(report)):
                return told
        except FileNotFoundError:
            continue
        except (OSError, UnicodeDecodeError) as error:
            return {"why": "unknown", "cut": f"{report} cannot be read ({error})"}
    return None


def _stops(found: SessionSummary) -> list[str]:
    """When and why the motors of a session were without torque."""
    before = ("", *(s.state for s in found.states))
    changes = [s for was, s in zip(before, found.states, strict=False) if s.state != was]
    stops = [s for s in changes if s.state in ("PAUSED", "FAULT")]
    shown = stops if len(stops) <= _STOPS else [*stops[: _STOPS - 1], stops[-1]]
    texts = {c.name: c.text for c in safety.TABLE}
    rows = [
        f"  {s.state} at {s.at_s:.4f} s (tick {s.tick}): "
        + ("; ".join(texts.get(c, c) for c in s.causes) or "asked for by the operator")
        for s in shown
    ]
    if len(stops) > len(shown):
        rows.insert(-1, f"  ... {plural(len(stops) - len(shown), 'stop')} more")
    return [*rows, ""] if rows else []


def _end(found: SessionSummary) -> list[str]:
    """That a session did not end by itself, or is what was left of another one."""
    told = [found.end.text if found.end else "", found.recovered]
    if found.recovered and found.end is None:
        told.append("its end is missing: what the loop did after the last row is not known")
    rows = [f"  {text}" for text in told if text]
    return [*rows, ""] if rows else []


def _executables(found: SessionSummary) -> list[str]:
    """What the files within the session name that could run."""
    inside = {"model.toml", "rig.toml"} & set(found.attachments)
    return trust.named_in_session(read_attachments(found.path)) if inside else []


def _arm_dict(arm: _Arm) -> dict[str, object]:
    r = arm.recording
    return {
        "name": r.arm,
        "robot": _robot(r),
        "units": list(joint_units(r)),
        "joints": list(r.joints),
        "samples": r.n,
        "duration_s": float(r.t[-1] - r.t[0]),
        "rate_hz": _rate(r),
        "ranges": {n: [_number(v.min()), _number(v.max())] for n, _, v in columns(r)},
        "faults": [
            {"code": f.code, "severity": f.severity, "joint": f.joint or None, "text": f.text}
            for f in arm.faults
        ],
        "unwrapped": r.metadata.get(UNWRAPPED),
        "taken": r.metadata.get("note"),
        "prepared": arm.prepared.as_dict() if arm.prepared else None,
        "readings": [{"code": code, "text": text} for code, text in arm.readings],
        "lateness": vars(arm.lateness) if arm.lateness else None,
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _rate(r: Recording) -> float:
    return r.rate if r.n > 1 and r.period > 0 else 0.0


def _robot(r: Recording) -> str:
    return "a URDF" if r.robot.urdf else r.robot.preset


def _text(found: SessionSummary, arms: list[_Arm]) -> str:
    cut = ", cut off" if found.truncated else ""
    lines = [f"{found.path}: {found.bytes / 1e6:.3g} MB{cut}, {when(found)}", ""]
    if found.truncated or found.damaged:
        chunks = plural(found.damaged, "damaged record")
        lost = f"{plural(found.unread, 'byte')} at the end and {chunks}"
        lines += [
            f"  {_why(found)}; what follows is what is left ({lost} cannot be read).",
            f"  {_other_tools(found)}",
            f"  hil info {found.path} --recover NEW.mcap writes it as a proper session.",
            "",
        ]
    part = found.metadata.get("part", {})
    if {"first", "number", "before", "why"} <= part.keys():
        lines += [
            f"  part {part['number']} of the session that begins in {part['first']}, after "
            f"{part['before']} ({part['why']})",
            "",
        ]
    rows: list[tuple[str, ...]] = [
        ("channel", "messages", "rate [Hz]", "from [s]", "to [s]", "missing")
    ]
    rows += [
        (
            c.topic,
            str(c.count),
            f"{c.rate_hz:.5g}" if _periodic(c) else "-",
            f"{c.first_s:.4f}",
            f"{c.last_s:.4f}",
            str(_missing(c, arms) or "-"),
        )
        for c in found.channels
    ]
    lines += [*_aligned(rows), ""] if found.channels else []
    lines += loop_lines(found)
    lines += [*_stops(found), *_end(found)]
    trip, named = _trip(found), _executables(found)
    lines += [f"  {report_in_words(trip)}", ""] if trip else []
    lines += [f"  {text}; reading the session runs nothing of it" for text in named]
    if not arms:
        lines += ["  no arm: no /<name>/measured_js channel, so there is nothing to fit", ""]
    for arm in arms:
        lacks = undescribed(arm.recording.robot, arm.recording.d)
        note = arm.recording.metadata.get("note", "")
        lines += [f"{text}." for text in (lacks, note and f"taken from {note}") if text]
        made = [f"  {x}" for x in (arm.recording.metadata.get(UNWRAPPED),) if x]
        made += [f"  {text}" for text in arm.prepared.sentences] if arm.prepared else []
        made += [f"  {text}" for _, text in arm.readings]
        made += [f"  {arm.lateness.text}"] if arm.lateness else []
        lines += [*_arm_text(arm.recording), *made, *_faults_text(arm.faults), ""]
    # what a file says of itself begins no line of its own
    return "\n".join(line.replace("\n", "\\n") for line in lines)


def _other_tools(found: SessionSummary) -> str:
    """What readers of the format make of the file as it is: asked of the format's own library."""
    try:
        with Path(found.path).open("rb") as file:
            whole = make_reader(file).get_summary() is not None
    except Exception:  # the library raises many kinds on a damaged file; each is its refusal
        whole = False
    if not whole:
        return (
            "Other tools: one that needs the index (Foxglove, mcap info) refuses the file; a "
            "streaming one (mcap cat, mcap recover) reads up to the first wrong byte."
        )
    return (
        "Other tools: one that uses the index opens the file, and shows wrong numbers in the "
        "damaged part unless it verifies checksums; a streaming one stops there."
    )


def _why(found: SessionSummary) -> str:
    return "the writer did not finish" if found.truncated else "the file is damaged"


def _arm_text(r: Recording) -> list[str]:
    units = dict(zip(r.joints, joint_units(r), strict=True))
    rows: list[tuple[str, ...]] = [("column", "joint", "least", "most", "unit")]
    rows += [
        (n, j or "-", f"{v.min():.4g}", f"{v.max():.4g}", column_unit(n, units.get(j, "")))
        for n, j, v in columns(r)
    ]
    head = (
        f"arm {r.arm}: {plural(r.d, 'joint')}, {plural(r.n, 'sample')}, "
        f"{r.t[-1] - r.t[0]:.4g} s at {_rate(r):.5g} Hz; "
        f"robot: {_robot(r)}"
    )
    return [head, *_aligned(rows)]


def _faults_text(faults: list[DataFault]) -> list[str]:
    if not faults:
        return ["  data faults: none found"]
    lines = [f"  data faults: {len(faults)}"]
    for f in faults:
        lines.append(f"  {f.severity} [{f.code}] {f.sentence}")
    return lines


def _missing(channel: ChannelSummary, arms: list[_Arm]) -> int:
    """Messages that are missing by their count, or by the stamps of the arm's rows."""
    if not _periodic(channel):
        return 0
    by_stamps = [
        sum(gap.rows for gap in arm.prepared.timing.gaps)
        for arm in arms
        if arm.prepared
        and channel.topic.startswith(f"/{arm.recording.arm}/")
        and channel.count == arm.recording.n
    ]
    return max([channel.missing, *by_stamps])


def _periodic(channel: ChannelSummary) -> bool:
    """Whether a channel has a message a tick; events do not."""
    return channel.schema != "hil_event"


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    rows = [tuple(cell.replace("\n", "\\n") for cell in row) for row in rows]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
