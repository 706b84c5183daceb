"""From a session file to recordings."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError, unknown
from hil.record.container import Container, Topic, read
from hil.record.recording import Recording, RobotSource
from hil.record.schema import PARTS
from hil.record.writer import write_recordings

FloatArray = NDArray[np.float64]


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
    """What a session holds."""

    path: str
    bytes: int
    truncated: bool
    channels: tuple[ChannelSummary, ...]
    metadata: dict[str, dict[str, str]]
    attachments: tuple[str, ...]
    arms: tuple[str, ...]


def summary(path: str | Path) -> SessionSummary:
    """Channels, rates, gaps, metadata.

    Raises
    ------
    DataError
        If the file is not a session.
    """
    box = read(path)
    channels = tuple(_channel(t) for t in box.topics.values())
    return SessionSummary(
        str(path),
        box.size,
        box.truncated,
        channels,
        box.metadata,
        tuple(box.attachments),
        _arms(box),
    )


def _channel(topic: Topic) -> ChannelSummary:
    t = np.array(topic.times, dtype=np.float64) * 1e-9
    rate = float(1 / np.median(np.diff(t))) if t.size > 2 and np.median(np.diff(t)) > 0 else 0.0
    sequence = np.array(topic.sequence, dtype=np.int64)
    missing = int(np.sum(np.maximum(np.diff(sequence) - 1, 0))) if sequence.size > 1 else 0
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
        Arm; default the only one, else the first, with a note in ``metadata["note"]``.

    Raises
    ------
    DataError
        If the file is no session, has no such arm or no samples.
    """
    box = read(path)
    names = _arms(box)
    if not names:
        has = ", ".join(box.topics) or "none"
        raise DataError(f"session {path} has no /<arm>/measured_js channel. It has: {has}")
    chosen = arm or names[0]
    if chosen not in names:
        raise DataError(f"session {path}: " + unknown("arm", chosen, names))
    recording = _recording(box, chosen)
    if arm is None and len(names) > 1:
        recording.metadata["note"] = (
            f"session {Path(path).name} has the arms {', '.join(names)}; using {chosen!r} "
            "(choose with --arm, or arm = ... in the model's [robot])"
        )
    return recording


def load_all(paths: Sequence[str | Path], arm: str | None = None) -> list[Recording]:
    """Read one arm of several sessions."""
    return [load(path, arm) for path in paths]


def recover(source: str | Path, target: str | Path) -> int:
    """Write what a cut-off session still holds as a proper one; returns samples kept."""
    box = read(source)
    recordings = [_recording(box, name) for name in _arms(box)]
    known = {f"robot/{r.arm}" for r in recordings}
    rest = {k: v for k, v in box.metadata.items() if k not in known}
    write_recordings(target, recordings, rest)
    return sum(r.n for r in recordings)


def _recording(box: Container, arm: str) -> Recording:
    state = box.topics[f"/{arm}/measured_js"]
    if not state.data:
        raise DataError(f"session {box.path}: arm {arm!r} has no samples")
    names, parts = decode_joint_state(state)
    t = np.asarray(np.array(state.times, dtype=np.int64) * 1e-9, dtype=np.float64)
    jf = box.topics.get(f"/{arm}/setpoint_jf")
    tau = parts["effort"]
    if jf and jf.data:
        tau = _aligned(decode_joint_state(jf)[1]["effort"], jf, state)
    if tau is None or parts["position"] is None:
        raise DataError(f"session {box.path}: arm {arm!r} has no position or no motor effort")
    info = box.metadata.get(f"robot/{arm}", {})
    urdf = box.attachments.get(f"robot/{arm}.urdf", b"").decode()
    preset = "" if urdf else info.get("preset", "single-axis")
    joints = tuple(json.loads(info["joints"])) if "joints" in info else names
    metadata = {k: v for k, v in info.items() if k == "unit"}
    metadata |= {f"session.{k}": v for k, v in box.metadata.get("session", {}).items()}
    return Recording(
        name=box.path.stem, arm=arm, joints=joints, t=t, q=parts["position"], tau=tau,
        qd=parts["velocity"], wrench=_optional(box, arm, "measured_cf", state),
        tau_ext=_optional(box, arm, "external_jf", state),
        current=_optional(box, arm, "motor_current", state),
        temperature=_optional(box, arm, "motor_temperature", state),
        robot=RobotSource(preset, urdf, info.get("tip", "")),
        metadata=metadata,
    )  # fmt: skip


def _optional(box: Container, arm: str, name: str, state: Topic) -> FloatArray | None:
    topic = box.topics.get(f"/{arm}/{name}")
    if topic is None or not topic.data:
        return None
    if name == "external_jf":
        return _aligned(decode_joint_state(topic)[1]["effort"], topic, state)
    if name == "measured_cf":
        (n,) = struct.unpack_from("<I", topic.data[0], 12)
        start = 4 + -(-(12 + n) // 8) * 8
        return _aligned(_numbers(topic, start, 6), topic, state)
    return _aligned(_numbers(topic, 12, (len(topic.data[0]) - 12) // 8), topic, state)


def _aligned(values: FloatArray | None, topic: Topic, state: Topic) -> FloatArray | None:
    """Values on the state's stamps: as they are if stamps agree, else linearly interpolated."""
    if values is None or topic.times == state.times:
        return values
    t, at = np.array(topic.times, float), np.array(state.times, float)
    return np.stack([np.interp(at, t, column) for column in values.T], axis=1)


def _numbers(topic: Topic, start: int, count: int) -> FloatArray:
    """`count` doubles at byte `start` of every message, shape (n, count)."""
    size = len(topic.data[0])
    if any(len(x) != size for x in topic.data):
        raise DataError(f"topic {topic.name}: messages of different sizes; expected one layout")
    raw = np.frombuffer(b"".join(topic.data), dtype=np.uint8).reshape(-1, size)
    return np.ascontiguousarray(raw[:, start : start + 8 * count]).view("<f8").astype(np.float64)


def decode_joint_state(topic: Topic) -> tuple[tuple[str, ...], dict[str, FloatArray | None]]:
    """Joint names and the parts (n, d) of a JointState topic; absent parts are None."""
    data = topic.data[0]

    def text(at: int) -> tuple[str, int]:
        at += -at % 4
        (n,) = struct.unpack_from("<I", data, at + 4)
        return data[at + 8 : at + 8 + n - 1].decode(), at + 4 + n

    _, at = text(8)
    at += -at % 4
    (count,) = struct.unpack_from("<I", data, at + 4)
    at, names = at + 4, []
    for _ in range(count):
        name, at = text(at)
        names.append(name)
    parts: dict[str, FloatArray | None] = {}
    for part in PARTS:
        at += -at % 4
        (n,) = struct.unpack_from("<I", data, at + 4)
        at += 4
        if n:
            at += -at % 8
        parts[part] = _numbers(topic, at + 4, n) if n else None
        at += 8 * n
    return tuple(names), parts
