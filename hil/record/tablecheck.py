"""What an import refuses: values that no fit could use, each with what to do about it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError
from hil.record.consistency import unit_doubt, velocity_factor
from hil.record.recording import Recording
from hil.record.schema import LAST_S
from hil.record.tablefile import Table
from hil.record.tablemap import Rule
from hil.record.urdf_joints import UrdfJoint

FloatArray = NDArray[np.float64]

#: A step of so many median periods is a jump.
JUMP = 10.0
#: A longer median period [s] means that the time is not in seconds, or useless for dynamics.
LONG_PERIOD = 0.05


def refuse_not_finite(
    table: Table, rules: Mapping[str, Rule], values: Mapping[str, FloatArray]
) -> None:
    """Refuse NaN and infinite values, naming the column, how many and which rows first.

    Raises
    ------
    DataError
        If there are any.
    """
    for target, column in values.items():
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            source = ", ".join(rules[target].terms) if target in rules else target
            first = ", ".join(str(table.first_row + k) for k in bad[:5])
            some = f"rows {first}, ..." if bad.size > 5 else f"rows {first}"
            where, these = (f"row {first}", "it") if bad.size == 1 else (some, "these rows")
            raise DataError(
                f"table {table.path}: column {source!r} has {bad.size} missing, NaN or infinite "
                f"values of {column.size}, in {where}; cut or repair {these}"
            )


def clean_time(table: Table, t: FloatArray | None, gaps: str, repeated: str) -> NDArray[np.intp]:
    """Rows to keep, after checking that the time increases evenly.

    Parameters
    ----------
    table : Table
        For messages.
    t : ndarray (n,)
        Time [s].
    gaps, repeated : str
        As in the map file.

    Raises
    ------
    DataError
        If time runs backward, repeats, jumps or is not in seconds.
    """
    if t is None or t.size < 2:
        raise DataError(f"table {table.path}: {0 if t is None else t.size} samples; too few")
    dt = np.diff(t)
    rows = np.arange(t.size)
    back, same = np.flatnonzero(dt < 0), np.flatnonzero(dt == 0)
    if back.size:
        k = int(back[0])
        raise DataError(
            f"table {table.path}: time runs backward {back.size} times, first in row "
            f"{table.first_row + k + 1} ({t[k]:.6g} s, then {t[k + 1]:.6g} s); "
            "sort the rows, or import each run by itself"
        )
    if same.size and repeated == "refuse":
        raise DataError(
            f"table {table.path}: {same.size} repeated time stamps, first in row "
            f"{table.first_row + int(same[0]) + 1} ({t[same[0]]:.6g} s); remove these rows, or say "
            'repeated = "drop" in [table] of a map'
        )
    even = np.delete(rows, same + 1)
    _refuse_steps(table, t[even], even, gaps)
    return rows if repeated == "keep" else even


def _refuse_steps(table: Table, t: FloatArray, rows: NDArray[np.intp], gaps: str) -> None:
    dt = np.diff(t)
    if not dt.size:
        raise DataError(f"table {table.path}: the time never changes")
    period = float(np.median(dt))
    if period > LONG_PERIOD:
        raise DataError(
            f"table {table.path}: the time advances by {period:.4g} s a sample "
            f"({1 / period:.3g} Hz); it looks like milliseconds (or samples, microseconds): "
            'scale it to seconds in a map, [columns] t = { from = "t", scale = 0.001 }. If it '
            "truly is in seconds, the recording is too slow for dynamics"
        )
    jumps = np.flatnonzero(dt > JUMP * period)
    if jumps.size and gaps == "refuse":
        k = int(jumps[0])
        raise DataError(
            f"table {table.path}: time jumps {jumps.size} times, first in row "
            f"{table.first_row + int(rows[k + 1])} (from {t[k]:.6g} to {t[k + 1]:.6g} s at a "
            f"period of {period:.4g} s); import each part by itself, or say "
            'gaps = "keep" in [table] of a map'
        )


def from_zero(table: Table, recordings: Sequence[Recording]) -> list[Recording]:
    """Shift a table that begins before 0 s as a whole; a session cannot hold earlier times.

    Raises
    ------
    DataError
        If it holds times that are certainly no seconds.
    """
    start = min(float(r.t[0]) for r in recordings)
    if max(float(r.t[-1]) for r in recordings) >= LAST_S:
        raise DataError(
            f"table {table.path}: time begins at {start:.6g}; expected seconds. Scale it in a map: "
            '[columns] t = { from = "t", scale = 0.001 }'
        )
    if start >= 0:
        return list(recordings)
    return [
        replace(r, t=r.t - start, metadata={**r.metadata, "time_shift_s": repr(-start)})
        for r in recordings
    ]


def refuse_units(table: Table, recording: Recording, joints: tuple[UrdfJoint, ...]) -> None:
    """Refuse positions that are certainly degrees or millimetres.

    Raises
    ------
    DataError
        If they are; `unit` in the map's [robot] overrules it.
    """
    for k, name in enumerate(recording.joints):
        q = recording.q[:, k]
        joint = joints[k] if joints else UrdfJoint(name, recording.metadata["unit"])
        bounded = math.isfinite(joint.upper) and math.isfinite(joint.lower)
        if unit_doubt(q, joint, bool(joints)):
            degrees = joint.unit == "rad"
            what, scale = ("degrees", "0.0174532925199433") if degrees else ("millimetres", "0.001")
            limits = f" (limits {joint.lower:.4g} to {joint.upper:.4g})" if bounded else ""
            raise DataError(
                f"table {table.path}: q{k + 1} ({name}) runs from {q.min():.4g} to {q.max():.4g} "
                f"{joint.unit}{limits}; these look like {what}. Scale them in a map: [columns] "
                f'q{k + 1} = {{ from = "q{k + 1}", scale = {scale} }}; if they truly are '
                f'{joint.unit}, say unit = "{joint.unit}" in its [robot] (or --unit {joint.unit})'
            )
    for k in range(recording.d):
        _refuse_mixed(table, recording, k)


def _refuse_mixed(table: Table, r: Recording, k: int) -> None:
    """Refuse a position in degrees beside a velocity in rad/s, or the other way round."""
    if r.qd is None:
        return
    factor, correlation = velocity_factor(r.t, r.q[:, k], r.qd[:, k])
    degrees = {math.pi / 180: f"q{k + 1}", 180 / math.pi: f"qd{k + 1}"}
    for known, column in degrees.items():
        if correlation > 0.98 and abs(factor / known - 1) < 0.05 and r.metadata["unit"] == "rad":
            raise DataError(
                f"table {table.path}: qd{k + 1} is {factor:.4g} times the derivative of "
                f"q{k + 1}, so {column} is in degrees. Scale it in a map: [columns] "
                f'{column} = {{ from = "{column}", scale = 0.0174532925199433 }}'
            )
