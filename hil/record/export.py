"""Recordings as a session file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hil.errors import DataError
from hil.record.mcap_write import SessionWriter
from hil.record.recording import AS_IS, LOCKED, SIGNAL, STATED, UNIT_SAID, UNWRAPPED, Recording
from hil.record.schema import LAST_S, Channel

#: What a session keeps of the metadata of a recording, beside what a map says of its signals.
_KEPT = (LOCKED, STATED, UNIT_SAID, UNWRAPPED, AS_IS)


def robot_record(recording: Recording) -> dict[str, str]:
    """Metadata record ``robot/<arm>`` of a recording."""
    return {
        "preset": recording.robot.preset,
        "tip": recording.robot.tip,
        "joints": json.dumps(list(recording.joints)),
        "unit": recording.metadata.get("unit", "rad"),
        "name": recording.name,
        **{k: v for k, v in recording.metadata.items() if k.startswith(SIGNAL) or k in _KEPT},
    }


def write_recordings(
    path: str | Path,
    recordings: Sequence[Recording],
    metadata: Mapping[str, Mapping[str, str]] | None = None,
    extras: Sequence[tuple[Channel, np.ndarray, np.ndarray]] = (),
) -> None:
    """Write recordings (one an arm, same run) as one session.

    Parameters
    ----------
    path : str or Path
        Output.
    recordings : sequence of Recording
        One a distinct arm.
    metadata : mapping, optional
        Further metadata records.
    extras : sequence of (Channel, t (n,), values (n, k))
        Further channels.

    Raises
    ------
    DataError
        If a time is not a number from 0 s on; nothing is written then.
    ConfigError
        If the file cannot be written.
    """
    for r in recordings:
        if not np.all((r.t >= 0) & (r.t < LAST_S)):
            raise DataError(
                f"recording {r.name} ({r.arm}): time runs from {r.t.min():.6g} to {r.t.max():.6g} "
                f"s; a session holds finite times from 0 to {LAST_S} s: shift it"
            )
    records = {f"robot/{r.arm}": robot_record(r) for r in recordings}
    urdf = {f"robot/{r.arm}.urdf": r.robot.urdf.encode() for r in recordings if r.robot.urdf}
    plans = [*(p for r in recordings for p in _plan(r)), *extras]
    with SessionWriter(path, [c for c, _, _ in plans], {**(metadata or {}), **records}, urdf) as w:
        # one pass in time order over all channels
        stamps = [np.round(t * 1e9).astype(np.int64) for _, t, _ in plans]
        rows = [x.tolist() for _, _, x in plans]
        order = np.argsort(np.concatenate(stamps), kind="stable")
        which = np.repeat(np.arange(len(plans)), [len(s) for s in stamps])[order]
        index = np.concatenate([np.arange(len(s)) for s in stamps])[order]
        topics = [c.topic for c, _, _ in plans]
        for p, k in zip(which.tolist(), index.tolist(), strict=True):
            w.write(topics[p], k + 1, int(stamps[p][k]), rows[p][k])


def _plan(r: Recording) -> list[tuple[Channel, np.ndarray, np.ndarray]]:
    """Channel, times and values of everything a recording holds."""
    parts = ("position",) if r.qd is None else ("position", "velocity")
    state = r.q if r.qd is None else np.concatenate([r.q, r.qd], axis=1)
    out = [
        (Channel(f"/{r.arm}/measured_js", "joint_state", r.joints, parts), r.t, state),
        (Channel(f"/{r.arm}/setpoint_jf", "joint_state", r.joints, ("effort",)), r.t, r.tau),
    ]
    if r.wrench is not None:
        out.append((Channel(f"/{r.arm}/measured_cf", "wrench", frame="base"), r.t, r.wrench))
    for name, values in (("external_jf", r.tau_ext),):
        if values is not None:
            channel = Channel(f"/{r.arm}/{name}", "joint_state", r.joints, ("effort",))
            out.append((channel, r.t, values))
    for name, unit, values in (
        ("motor_current", "A", r.current),
        ("motor_temperature", "degC", r.temperature),
    ):
        if values is not None:
            fields = tuple(f"j{k + 1}" for k in range(r.d))
            message = "hil_msgs/msg/" + name.title().replace("_", "")
            units = (unit,) * r.d
            topic = f"/{r.arm}/{name}"
            out.append(
                (Channel(topic, "fields", fields, units=units, message=message), r.t, values)
            )
    return out
