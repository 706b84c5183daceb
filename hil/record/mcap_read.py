"""From a session file to recordings, one an arm: on common ticks, in the order of the joints.

And when a session was recorded, and by what that is known.
"""

from __future__ import annotations

import contextlib
import json
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError, unknown
from hil.record.container import Container, Topic, read
from hil.record.recording import (
    AS_IS,
    BEGAN,
    BEGAN_BY,
    LOCKED,
    SIGNAL,
    STATED,
    UNIT_SAID,
    UNWRAPPED,
    Recording,
    RobotSource,
)
from hil.record.schema import decode, decode_joint_state

FloatArray = NDArray[np.float64]
#: Topics of an arm beside its state that become columns of a recording.
_COLUMNS = ("setpoint_jf", "measured_cf", "external_jf", "motor_current", "motor_temperature")


def recording(box: Container, arm: str) -> Recording:
    """Recording of one arm of a session.

    Raises
    ------
    DataError
        If its channels do not belong together, or a needed one is missing.
    """
    topics = _common(box, arm)
    info = box.metadata.get(f"robot/{arm}", {})
    try:
        names, columns = _columns(topics, info)
    except DataError as error:
        raise DataError(f"session {box.path}: {error}") from error
    except (struct.error, IndexError, ValueError, TypeError) as error:
        raise DataError(f"session {box.path}: arm {arm!r} cannot be decoded: {error}") from error
    if broken := [n for n in (arm, *names) if "\n" in n or not n]:
        raise DataError(
            f"session {box.path}: an arm or joint has the name {broken[0]!r}; expected text "
            "without line breaks"
        )
    q, tau = columns.get("position"), columns.get("setpoint_jf", columns.get("effort"))
    if q is None or tau is None:
        what = "motor effort (setpoint_jf, or effort of measured_js)" if tau is None else "position"
        raise DataError(f"session {box.path}: arm {arm!r} has no {what}")
    if not len(names) == q.shape[1] == tau.shape[1]:
        raise DataError(
            f"session {box.path}: arm {arm!r} has {len(names)} joints, {q.shape[1]} positions and "
            f"{tau.shape[1]} efforts; expected one each a joint"
        )
    urdf = box.attachments.get(f"robot/{arm}.urdf", b"").decode(errors="replace")
    preset = "" if urdf else info.get("preset", "single-axis")
    kept = ("unit", LOCKED, STATED, UNIT_SAID, UNWRAPPED, AS_IS)
    metadata = {k: v for k, v in info.items() if k in kept or k.startswith(SIGNAL)}
    metadata |= {f"session.{k}": v for k, v in box.metadata.get("session", {}).items()}
    t = box.seconds(topics["measured_js"])
    return Recording(
        name=box.path.stem,
        arm=arm,
        joints=names,
        t=t,
        q=q,
        tau=tau,
        qd=columns.get("velocity"),
        wrench=columns.get("measured_cf"),
        tau_ext=columns.get("external_jf"),
        current=columns.get("motor_current"),
        temperature=columns.get("motor_temperature"),
        robot=RobotSource(preset, urdf, info.get("tip", "")),
        metadata=metadata,
    )


def _columns(
    topics: dict[str, Topic], info: dict[str, str]
) -> tuple[tuple[str, ...], dict[str, FloatArray]]:
    """Joint names, and every array of an arm by part of the state or name of the topic."""
    if "measured_js" not in topics:
        raise DataError("measured_js has no samples")
    state = topics["measured_js"]
    names, parts = decode_joint_state(state)
    names = names or tuple(json.loads(info.get("joints", "[]")))
    out = {part: values for part, values in parts.items() if values is not None}
    return names, out | {n: _on(t, state, names) for n, t in topics.items() if n in _COLUMNS}


def _common(box: Container, arm: str) -> dict[str, Topic]:
    """Topics of an arm by their last name, on the ticks that the fast ones share.

    A killed writer or a damaged chunk leaves some channels a message longer than others;
    nothing is invented for the shorter ones.
    """
    found = {
        name.split("/")[2]: topic
        for name, topic in box.topics.items()
        if name.startswith(f"/{arm}/") and name.count("/") == 2 and len(topic)
    }
    state = found.get("measured_js")
    if state is None:
        return found
    fast = [t for n, t in found.items() if n in _COLUMNS and 2 * len(t) > len(state)]
    if all(np.array_equal(t.stamps, state.stamps) for t in fast):
        return found
    shared = reduce(np.intersect1d, [t.stamps for t in fast], state.stamps)
    if len(shared) < 0.9 * len(state):  # channels with clocks of their own
        first = max(t.stamps[0] for t in (state, *fast))
        last = min(t.stamps[-1] for t in (state, *fast))
        shared = state.stamps[(first <= state.stamps) & (state.stamps <= last)]
        fast = []
    return {n: _only(t, shared) if t is state or t in fast else t for n, t in found.items()}


def _only(topic: Topic, stamps: NDArray[np.uint64]) -> Topic:
    keep = np.isin(topic.stamps, stamps)
    if not keep.any():
        raise DataError(f"topic {topic.name} and the others of its arm share no time")
    return topic.only(keep)


def _on(topic: Topic, state: Topic, joints: tuple[str, ...]) -> FloatArray:
    """Values of a topic in the order of the joints and on the stamps of the state.

    As they are if the stamps agree, else linearly interpolated.
    """
    values = decode(topic, joints)
    if np.array_equal(topic.stamps, state.stamps):
        return values
    t, at = topic.stamps.astype(np.float64), state.stamps.astype(np.float64)
    return np.stack([np.interp(at, t, column) for column in values.T], axis=1)


@dataclass(frozen=True)
class ChannelSummary:
    """What `hil info` says of a topic."""

    topic: str
    schema: str
    count: int
    rate_hz: float
    first_s: float
    last_s: float
    missing: int


@dataclass(frozen=True)
class StateChange:
    """State of the loop and its causes from a time [s] and tick on, where either is new."""

    state: str
    at_s: float
    tick: int
    causes: tuple[str, ...]


#: Names of the events that end a session.
_ENDS = ("done", "fault", "broken off")


@dataclass(frozen=True)
class SessionEnd:
    """How a session of `hil run` ended.

    Parameters
    ----------
    how : str
        ``"done"``, ``"fault"`` or ``"broken off"``.
    at_s : float
        Time [s].
    tick : int
        Its tick.
    error : str
        What broke it off.
    """

    how: str
    at_s: float
    tick: int
    error: str = ""

    @property
    def text(self) -> str:
        """Sentence of a session that was broken off; empty for another."""
        if self.how != "broken off":
            return ""
        return (
            f"broken off at {self.at_s:.4f} s (tick {self.tick}): {self.error or 'no error told'}"
        )


@dataclass(frozen=True)
class SessionSummary:
    """What a session holds; times of channels count from `zero_ns`, see `Container.zero_ns`."""

    path: str
    bytes: int
    truncated: bool
    unread: int
    damaged: int
    channels: tuple[ChannelSummary, ...]
    metadata: dict[str, dict[str, str]]
    attachments: tuple[str, ...]
    arms: tuple[str, ...]
    zero_ns: int = 0
    states: tuple[StateChange, ...] = ()
    end: SessionEnd | None = None
    recovery: dict[str, str] = field(default_factory=dict)

    @property
    def recovered(self) -> str:
        """Sentence of a session that `hil info --recover` wrote; empty for another."""
        told = self.recovery
        if not told:
            return ""
        return (
            f"recovered from {told.get('source', 'another file')}: "
            f"{told.get('unread_bytes', '?')} bytes at its end and "
            f"{told.get('damaged_records', '?')} damaged records could not be read"
        )


def summary(path: str | Path) -> SessionSummary:
    """Channels, rates, gaps, metadata.

    Raises
    ------
    DataError
        If the file is not a session.
    """
    box = read(path)
    channels = tuple(_channel(t, box) for t in box.topics.values())
    events = list(_events(box))
    return SessionSummary(
        str(path),
        box.size,
        box.truncated,
        box.unread,
        box.damaged,
        channels,
        box.metadata,
        tuple(box.attachments),
        _arms(box),
        box.zero_ns,
        tuple(e for e in events if isinstance(e, StateChange)),
        next((e for e in reversed(events) if isinstance(e, SessionEnd)), None),
        box.recovery,
    )


def _events(box: Container) -> Iterator[StateChange | SessionEnd]:
    """Changes of state and the end among the events; what is neither is left out."""
    topic = box.topics.get("/events")
    if topic is None:
        return
    for at, raw in zip(box.seconds(topic), topic.data, strict=True):
        with contextlib.suppress(ValueError, KeyError, TypeError, RecursionError, AttributeError):
            event = json.loads(raw)
            told, tick = event["data"], int(event["tick"])
            if event["name"] == "state":
                causes = tuple(str(cause) for cause in told["conditions"])
                yield StateChange(str(told["state"]), float(at), tick, causes)
            elif event["name"] in _ENDS:
                yield SessionEnd(event["name"], float(at), tick, str(told.get("error", "")))


def _channel(topic: Topic, box: Container) -> ChannelSummary:
    t = box.seconds(topic)
    rate = float(1 / np.median(np.diff(t))) if t.size > 2 and np.median(np.diff(t)) > 0 else 0.0
    sequence = topic.ticks
    # in steps of its own: a slow channel has a message every so many ticks
    steps = np.diff(sequence) if sequence.size > 1 else np.ones(1, np.int64)
    missing = int(np.sum(np.maximum(steps // max(1, int(np.median(steps))) - 1, 0)))
    first, last = (float(t[0]), float(t[-1])) if t.size else (0.0, 0.0)
    return ChannelSummary(topic.name, topic.schema, t.size, rate, first, last, missing)


def _arms(box: Container) -> tuple[str, ...]:
    return tuple(
        name.split("/")[1]
        for name in box.topics
        if name.endswith("/measured_js") and name.count("/") == 2
    )


def arms(path: str | Path) -> tuple[str, ...]:
    """Names of the arms of a session, in file order."""
    return _arms(read(path))


def load(path: str | Path, arm: str | None = None) -> Recording:
    """Read one arm of a session.

    Parameters
    ----------
    path : str or Path
        Session; one that a killed writer left is read up to its last complete chunk.
    arm : str, optional
        Arm; default the only one, else the first.  That, and a session cut off or damaged, is
        told in ``metadata["note"]``.

    Raises
    ------
    DataError
        If the file is no session, has no such arm or no samples.
    """
    return _load(read(path), arm)


def robot_of(path: str | Path, arm: str | None = None) -> tuple[tuple[str, ...], RobotSource]:
    """Joints and robot of an arm, without its samples where the metadata say them.

    Raises
    ------
    DataError
        As `load`.
    """
    box = read(path, messages=False)
    names = _arms(box)
    chosen = arm or next(iter(names), "")
    info = box.metadata.get(f"robot/{chosen}", {})
    if chosen not in names or "joints" not in info:
        found = load(path, arm)
        return found.joints, found.robot
    urdf = box.attachments.get(f"robot/{chosen}.urdf", b"").decode(errors="replace")
    try:
        joints = tuple(map(str, json.loads(info["joints"])))
    except (ValueError, TypeError) as error:
        raise DataError(f"session {path}: the joints of arm {chosen!r} cannot be read") from error
    preset = "" if urdf else info.get("preset", "single-axis")
    return joints, RobotSource(preset, urdf, info.get("tip", ""))


def load_arms(path: str | Path) -> list[Recording]:
    """Read all arms of a session in one pass, in file order."""
    box = read(path)
    return [_load(box, arm) for arm in _arms(box)]


def _load(box: Container, arm: str | None) -> Recording:
    path, names = box.path, _arms(box)
    if not names:
        has = ", ".join(box.topics) or "none"
        raise DataError(f"session {path} has no /<arm>/measured_js channel. It has: {has}")
    chosen = arm or names[0]
    if chosen not in names:
        raise DataError(f"session {path}: " + unknown("arm", chosen, names))
    found = recording(box, chosen).unwrapped()
    if notes := list(_notes(box, found, names if arm is None else ())):
        found.metadata["note"] = "; ".join(notes)
    return found


def read_metadata(path: str | Path) -> dict[str, dict[str, str]]:
    """Metadata records of a session by name; they survive a killed writer.

    Raises
    ------
    DataError
        If the file is not a session.
    """
    return read(path, messages=False).metadata


def read_attachments(path: str | Path) -> dict[str, bytes]:
    """Attached files of a session by name; they survive a killed writer.

    Raises
    ------
    DataError
        If the file is not a session.
    """
    return read(path, messages=False).attachments


def _notes(box: Container, found: Recording, names: tuple[str, ...]) -> Iterator[str]:
    """What the user should know of how a session was read."""
    if len(names) > 1:
        yield (
            f"session {box.path.name} has the arms {', '.join(names)}; using {found.arm!r} "
            "(choose with --arm, or arm = ... in the model's [robot])"
        )
    if box.truncated:
        yield (
            f"session {box.path.name} is cut off; {found.n} samples up to "
            f"{found.t[-1]:.6g} s are left"
        )
    if box.damaged:
        yield f"session {box.path.name} has {box.damaged} damaged records; they are left out"


#: No recording is later [s since 1970]: the year 3000.
_LATEST = 32503680000.0


def began(found: SessionSummary) -> tuple[datetime, str]:
    """Date of the first sample (UTC), and by what it is known.

    Returns
    -------
    date : datetime
        In UTC.
    by : {"stamps", "table", "file"}
        Whether that is the date of the recording's own stamps, or only when the table that was
        imported, or the session itself, was last changed.
    """
    told = found.metadata.get("import", {})
    if found.zero_ns:
        seconds, by = found.zero_ns * 1e-9, "stamps"
    else:
        seconds, by = _number(told.get(BEGAN, "")), told.get(BEGAN_BY, "")
    if not math.isfinite(seconds) or by not in ("stamps", "table"):
        seconds, by = changed(Path(found.path)), "file"
    return datetime.fromtimestamp(seconds, UTC), by


def _number(text: str) -> float:
    """A number below the year 3000 as a time; NaN where a damaged record holds none."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if 0.0 < value < _LATEST else math.nan


def changed(path: Path) -> float:
    """When a file was last changed [s since 1970]; of a folder, the latest of its files."""
    files = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else []
    return max((p.stat().st_mtime for p in files), default=path.stat().st_mtime)
