"""From a session file to recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.errors import DataError, unknown
from hil.record.armtopics import recording
from hil.record.container import Container, Topic, read
from hil.record.recording import Recording


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


def summary(path: str | Path) -> SessionSummary:
    """Channels, rates, gaps, metadata.

    Raises
    ------
    DataError
        If the file is not a session.
    """
    box = read(path)
    channels = tuple(_channel(t, box) for t in box.topics.values())
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
    )


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
    found = recording(box, chosen)
    if notes := list(_notes(box, found, names if arm is None else ())):
        found.metadata["note"] = "; ".join(notes)
    return found


def load_all(paths: Sequence[str | Path], arm: str | None = None) -> list[Recording]:
    """Read one arm of several sessions."""
    return [load(path, arm) for path in paths]


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
        yield f"session {box.path.name} has {box.damaged} damaged chunks; they are left out"
