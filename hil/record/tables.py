"""From a table of any rig to recordings.

It is refused whole if columns that belong together are missing, or if it holds values that no fit
could use; each refusal says what to do.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError, plural, unknown
from hil.record.consistency import counts_doubt, unit_doubt, velocity_factor
from hil.record.jumps import NEAR, TURN, Wraps, periods, wraps
from hil.record.locked import (
    GROUPS,
    WRENCH,
    ColumnsRobot,
    columns_robot,
    count_joints,
    frame_axes,
    free_joints,
    grouped,
    in_base_axes,
)
from hil.record.mapfile import SIGNAL, Rule, TableMap, is_target
from hil.record.recording import (
    AS_IS,
    STATED,
    UNIT_SAID,
    UNWRAPPED,
    Recording,
    RobotSource,
)
from hil.record.schema import LAST_S, Channel
from hil.record.table_files import ForeignTable, open_table
from hil.record.units import FACTORS, epoch_unit, stem_of, time_unit
from hil.record.urdf_joints import UrdfJoint
from hil.userfile import read_text

#: A step of so many median periods is a jump.
JUMP = 10.0
#: A longer median period [s] means that the time is not in seconds, or useless for dynamics.
LONG_PERIOD = 0.05
#: Rounding of times and drift of a clock that make no period longer, relative.
ROUNDED = 0.02
#: A median period [s] from which the time hardly is in seconds.
NO_SECONDS = 0.5
#: No shorter median period [s] is one of a rig: filters and grids would take any memory.
SHORT_PERIOD = 1e-6


def refuse_not_finite(
    table: ForeignTable, rules: Mapping[str, Rule], values: Mapping[str, FloatArray]
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
                f"values of {column.size}, in {where}; cut or repair {these}, or say what to do "
                'with such rows: missing = "drop" or "interpolate" in [table] of a map, or '
                f"{table.option('missing', 'drop')} or interpolate"
            )


def clean_time(
    table: ForeignTable, t: FloatArray | None, gaps: str, repeated: str
) -> NDArray[np.intp]:
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
        if DAY / 2 < t[k] - t[k + 1] < DAY and 0 <= t.min() and t.max() < DAY:
            raise DataError(
                f"table {table.path}: the time of day passes midnight in row "
                f"{table.first_row + k + 1}; write the date before each time, or import each part "
                "by itself"
            )
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


def _refuse_steps(table: ForeignTable, t: FloatArray, rows: NDArray[np.intp], gaps: str) -> None:
    dt = np.diff(t)
    if not dt.size:
        raise DataError(f"table {table.path}: the time never changes")
    period = float(np.median(dt))
    if period < SHORT_PERIOD:
        raise DataError(
            f"table {table.path}: the time advances by {period:.4g} s a sample; no rig samples "
            f"faster than {1 / SHORT_PERIOD:g} Hz. Scale it to seconds in a map, [columns] "
            't = { from = "t", scale = ... }'
        )
    if period > LONG_PERIOD * (1 + ROUNDED):
        scale = 'scale it to seconds in a map, [columns] t = { from = "t", scale = 0.001 }'
        slow = f"{1 / LONG_PERIOD:g} Hz is the slowest that is analysed"
        raise DataError(
            f"table {table.path}: the time advances by {period:.4g} s a sample "
            f"({1 / period:.3g} Hz); "
            + (
                f"{slow}. Record faster; if the time is in another unit, {scale}"
                if period < NO_SECONDS
                else f"it looks like milliseconds (or samples, microseconds): {scale}. If it "
                f"truly is in seconds, the recording is too slow for dynamics: {slow}"
            )
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


def from_zero(table: ForeignTable, recordings: Sequence[Recording]) -> list[Recording]:
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


def refuse_units(
    table: ForeignTable,
    recording: Recording,
    joints: tuple[UrdfJoint, ...],
    rules: Sequence[Rule],
) -> None:
    """Refuse positions that are certainly degrees, millimetres or counts.

    Parameters
    ----------
    table : Table
        For messages.
    recording : Recording
        What was read, in the order of `joints`.
    joints : tuple of UrdfJoint
        Joints of the robot, if it is described.
    rules : sequence of Rule
        Where each joint's position came from; one whose unit was said is not doubted.

    Raises
    ------
    DataError
        If they are; `unit` in the map's [robot] overrules it.
    """
    for k, name in enumerate(recording.joints):
        if rules[k].stated:
            continue
        q = recording.q[:, k]
        joint = joints[k] if joints else UrdfJoint(name, recording.metadata["unit"])
        bounded = math.isfinite(joint.upper) and math.isfinite(joint.lower)
        source = next(iter(rules[k].terms), f"q{k + 1}")
        if counts_doubt(q):
            raise DataError(
                f"table {table.path}: q{k + 1} ({name}) holds whole numbers only, {q.min():.6g} to "
                f"{q.max():.6g} {joint.unit}: encoder counts? Scale them in a map: [columns] "
                f'q{k + 1} = {{ from = "{source}", scale = ... }}, {joint.unit} by count; if they '
                f'truly are {joint.unit}, say unit = "{joint.unit}" in its [robot] (or '
                f"{table.option('unit', joint.unit)})"
            )
        if unit_doubt(q, joint, bool(joints)):
            degrees = joint.unit == "rad"
            what, scale = ("degrees", "0.0174532925199433") if degrees else ("millimetres", "0.001")
            limits = f" (limits {joint.lower:.4g} to {joint.upper:.4g})" if bounded else ""
            every = (
                f"Say {table.option('unit', 'deg')} where all are, or scale" if degrees else "Scale"
            )
            raise DataError(
                f"table {table.path}: q{k + 1} ({name}) runs from {q.min():.4g} to {q.max():.4g} "
                f"{joint.unit}{limits}; these look like {what}. {every} them in a map: [columns] "
                f'q{k + 1} = {{ from = "{source}", scale = {scale} }}; if they truly are '
                f'{joint.unit}, say unit = "{joint.unit}" in its [robot] (or '
                f"{table.option('unit', joint.unit)})"
            )
    for k in range(recording.d):
        _refuse_mixed(table, recording, k)


def _refuse_mixed(table: ForeignTable, r: Recording, k: int) -> None:
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


FloatArray = NDArray[np.float64]
EXTRAS = "hil_msgs/msg/Extras"


@dataclass(frozen=True)
class Imported:
    """What came out of a table.

    Parameters
    ----------
    recordings : tuple of Recording
        One an arm.
    unused : tuple of str
        Columns of the table that nothing uses.
    extras : tuple of (Channel, t (n,), values (n, k))
        Further columns that the map takes along, as a channel of the session.
    """

    recordings: tuple[Recording, ...]
    unused: tuple[str, ...]
    extras: tuple[tuple[Channel, FloatArray, FloatArray], ...] = ()
    #: What was guessed or left out, a sentence each.
    notes: tuple[str, ...] = ()
    #: Rules by target column, one mapping an arm.
    rules: tuple[Mapping[str, Rule], ...] = ()


def import_table(
    path: str | Path,
    mapping: TableMap | None = None,
    *,
    urdf: str | Path = "",
    tip: str = "",
    arm: str = "",
    run: str = "",
    unit: str = "",
    torque_constant: Sequence[float] = (),
    missing: str = "",
    joints: Sequence[str] = (),
    lock: Mapping[str, float] | None = None,
) -> Imported:
    """Read a table through a map; everything is validated, nothing is written.

    Parameters
    ----------
    path : str or Path
        Table in one of the formats of `open_table`, or folder of a LeRobot data set.
    mapping : TableMap, optional
        The map; without one the default column names.
    urdf, tip, unit : str
        Robot file, frame of the force and unit of the axes; each overrules the map.
    arm : str
        Name of the only arm, or which of several arms to keep.
    run : str
        Which run of the file.
    torque_constant : sequence of float
        Effort at the joint by motor current [N m/A], where the efforts are currents.
    missing : str
        As in the map, which it overrules.
    joints, lock : sequence of str, mapping of str to float
        As in the map, which they overrule.

    Raises
    ------
    DataError
        If a column is missing or not a number, the time is not increasing, the units are
        certainly wrong, or the URDF does not fit.
    ConfigError
        If the map names something that is not there.
    """
    given = mapping or TableMap()
    given = replace(given, tip=tip or given.tip, missing=missing or given.missing)
    given = replace(
        given, joints=tuple(joints) or given.joints, lock={**given.lock, **(lock or {})}
    )
    given = given.within(unit, torque_constant)
    table = open_table(path, given.array, given.columns, run, given.header_row)
    return read_columns(table, given, urdf, arm)


def read_columns(
    table: ForeignTable, given: TableMap, robot: str | Path | RobotSource = "", arm: str = ""
) -> Imported:
    """Read the columns of an open table through a map, as `import_table` does.

    Parameters
    ----------
    table : ForeignTable
        Columns by name, from a file or from memory.
    given : TableMap
        The map.
    robot : str, Path or RobotSource
        URDF file, or the robot itself; empty for that of the map.
    arm : str
        Name of the only arm, or which of several arms to keep.

    Raises
    ------
    DataError, ConfigError
        As `import_table`.
    """
    with np.errstate(all="ignore"):  # what overflows is infinite then, and refused
        return _read_columns(table, given, robot, arm)


def _read_columns(
    table: ForeignTable, given: TableMap, robot: str | Path | RobotSource, arm: str
) -> Imported:
    tables = {"": table, **_joined(table, given)}
    arms = _select(given, arm)
    for name in arms:
        refuse_arm(name)
    source, joints = _robot(given, table.path, robot)
    recordings: list[Recording] = []
    used: set[str] = set()
    extra: dict[str, FloatArray] = {}
    notes: list[str] = []
    every: list[Mapping[str, Rule]] = []
    for name, rules in arms.items():
        filled, guessed = _with_defaults(rules, table, given)
        made = _arm(name or "arm", filled, tables, given, source, joints)
        recordings.append(made.recording)
        extra, every = made.extras, [*every, made.rules]
        used |= {term for rule in made.rules.values() for term in rule.terms}
        notes += [x for x in (*guessed, *made.notes) if x not in notes]
    recordings = from_zero(table, recordings)
    unused = tuple(n for prefix, t in tables.items() for n in _prefixed(prefix, t) if n not in used)
    extras = _extras(given, recordings, extra)
    return Imported(tuple(recordings), unused, extras, tuple(notes), tuple(every))


def _extras(
    given: TableMap, recordings: Sequence[Recording], values: Mapping[str, FloatArray]
) -> tuple[tuple[Channel, FloatArray, FloatArray], ...]:
    if not values:
        return ()
    units = tuple(given.units[n] for n in values)
    channel = Channel("/extras", "fields", tuple(values), units=units, message=EXTRAS)
    return ((channel, recordings[-1].t, np.stack(list(values.values()), axis=1)),)


#: An arm is a part of the names of its topics.
_ARM = re.compile(r"\w[\w.-]{0,63}")


def refuse_arm(name: str) -> None:
    """Refuse a name that cannot be a part of a topic's; the empty one stands for none.

    Raises
    ------
    ConfigError
        If it holds more than letters, digits, dots and dashes, or is longer than 64.
    """
    if name and not _ARM.fullmatch(name):
        raise ConfigError(
            f"arm {name[:80]!r}: a name of at most 64 letters, digits, '_', '.' and '-' is needed"
        )


def _select(given: TableMap, arm: str) -> dict[str, Mapping[str, Rule]]:
    if len(given.arms) == 1:
        only = next(iter(given.arms))
        return {arm or only: given.arms[only]}
    if arm and arm not in given.arms:
        raise ConfigError("the map has no " + unknown("arm", arm, given.arms))
    return {n: r for n, r in given.arms.items() if arm in ("", n)}


def _joined(table: ForeignTable, given: TableMap) -> dict[str, ForeignTable]:
    return {prefix: open_table(table.path.parent / name) for prefix, name in given.join.items()}


def _prefixed(prefix: str, table: ForeignTable) -> tuple[str, ...]:
    return tuple(f"{prefix}.{n}" if prefix else n for n in table.names)


def _with_defaults(
    rules: Mapping[str, Rule], table: ForeignTable, given: TableMap
) -> tuple[dict[str, Rule], list[str]]:
    """Rules of the map, and columns that bear a default name and that no rule uses; what is said.

    Where nothing is the time, a column that is named like one is taken.
    """
    own = {**given.expand(table.names), **rules}
    taken = {source for rule in own.values() for source in rule.terms}
    default = {
        n: given.rule(n, n) for n in table.names if is_target(n) and n not in taken | set(own)
    }
    out, said = {**own, **default}, []
    timed = [n for n in table.names if time_unit(n) is not None and n not in taken]
    if "t" not in out and not given.rate_hz and len(timed) == 1:
        out["t"] = given.rule("t", timed[0])
        said.append(f"the column {timed[0]!r} is taken as the time")
    return out, said


def _timed(
    rules: Mapping[str, Rule], columns: Mapping[str, FloatArray]
) -> tuple[Mapping[str, Rule], list[str]]:
    """Rules with the unit of the time that its name or its size says, where none was given."""
    rule = rules.get("t", Rule({}))
    if list(rule.terms.values()) != [1.0] or rule.shift:
        return rules, []
    name = next(iter(rule.terms))
    values = columns[name][np.isfinite(columns[name])]
    first = float(values[0]) if values.size else 0.0
    step = float(np.median(np.abs(np.diff(values)))) if values.size > 1 else 0.0
    epoch = epoch_unit(first)
    if epoch and not FASTEST <= step * FACTORS["t"][epoch] <= LONG_PERIOD:
        return rules, []  # it only looks like a date
    unit = epoch or time_unit(name) or "s"
    if unit == "s" and not epoch:
        return rules, []
    factor = FACTORS["t"][unit]
    text = f"the time {name!r} is in {unit}"
    if epoch:
        begin = datetime.fromtimestamp(first * factor, UTC)
        dates = ", or dates (UTC where they say no zone)" if unit == "s" else ""
        text += f" since 1970{dates}; it begins at {begin:%Y-%m-%d %H:%M:%S} UTC"
    return {**rules, "t": Rule({name: factor})}, [text]


#: A day [s].
DAY = 86400.0
#: A shorter period of a time since 1970 [s] says that it is none.
FASTEST = 1e-5
#: A longer stretch of missing values is no line [rows].
_BRIDGED = 10


def _mended(values: Mapping[str, FloatArray], how: str) -> tuple[dict[str, FloatArray], str]:
    """Rows that are whole, short gaps filled where that is wanted, and what was done."""
    out = {name: np.where(np.isfinite(v), v, np.nan) for name, v in values.items()}
    t = out.get("t", np.arange(next(iter(out.values())).size, dtype=float))
    filled = sum(_bridge(t, v) for v in out.values() if v is not t) if how == "interpolate" else 0
    whole = np.logical_and.reduce([~np.isnan(v) for v in out.values()])
    said = [f"{plural(filled, 'missing value')} interpolated"] if filled else []
    lost = int(np.sum(~whole))
    said += [f"{plural(lost, 'row')} with missing values left out"] if lost else []
    return {name: v[whole] for name, v in out.items()}, "; ".join(said)


def _bridge(t: FloatArray, v: FloatArray) -> int:
    """Fill the short stretches of missing values of a column in place; how many."""
    good = ~np.isnan(t) & ~np.isnan(v)
    at, bad = np.flatnonzero(good), np.flatnonzero(~np.isnan(t) & ~good)
    after = np.searchsorted(at, bad)
    inside = (after > 0) & (after < at.size)
    bad, after = bad[inside], after[inside]
    bad = bad[at[after] - at[after - 1] <= _BRIDGED + 1]
    v[bad] = np.interp(t[bad], t[at], v[at])
    return int(bad.size)


def _robot(
    given: TableMap, table: Path, robot: str | Path | RobotSource
) -> tuple[RobotSource, tuple[UrdfJoint, ...]]:
    if isinstance(robot, RobotSource):
        source = replace(robot, tip=given.tip or robot.tip)
        return source, _moving(source, "the URDF") if source.urdf else ()
    name = str(robot or given.urdf)
    if not name:
        return RobotSource(given.preset, "", given.tip), ()
    folders = [Path()] if robot else [f for f in (given.folder, table.parent) if f is not None]
    file = next((f / name for f in folders if (f / name).is_file()), folders[0] / name)
    try:
        text = read_text(file)
    except FileNotFoundError as error:
        raise DataError(
            f"URDF {file}: no such file; give the path of one as the robot (--robot, or robot=...)"
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text"
        raise DataError(f"URDF {file} cannot be read: {why}") from error
    source = RobotSource("", text, given.tip)
    return source, _moving(source, f"URDF {file}")


def _moving(source: RobotSource, what: str) -> tuple[UrdfJoint, ...]:
    """Moving joints of a description, after checking that it has the frame of the tip."""
    joints = free_joints(source.urdf, what)
    links = set(re.findall(r"<(?:link|joint)\s[^>]*?name\s*=\s*[\"']([^\"']+)", source.urdf))
    if source.tip and source.tip not in links:
        raise DataError(f"{what}: " + unknown("frame", source.tip, links))
    return joints


@dataclass(frozen=True)
class _Arm:
    """Recording of an arm, the rules it was read by, the extra columns, what is said."""

    recording: Recording
    rules: Mapping[str, Rule]
    extras: dict[str, FloatArray]
    notes: list[str]


def _arm(
    arm: str,
    rules: Mapping[str, Rule],
    tables: Mapping[str, ForeignTable],
    given: TableMap,
    robot: RobotSource,
    joints: tuple[UrdfJoint, ...],
) -> _Arm:
    table = tables[""]
    fitted = columns_robot(robot, given.joints, given.lock, max(grouped(rules).get("q", [0])))
    robot, joints = fitted.robot, fitted.joints
    d = count_joints(rules, table, joints, given.rate_hz > 0)
    rules = {**rules, **given.extras}
    columns, resampled = _sources(rules, tables)
    n = next(iter(columns.values())).size
    rules, notes = _timed(rules, columns)
    notes = [*fitted.notes, *notes, *resampled]
    columns, wrapped = _unwrapped(rules, columns)
    values = {target: rule.apply(columns, n) for target, rule in rules.items()}
    for name, offset in given.offsets.get(table.run, {}).items():
        owner, _, target = name.rpartition(".")
        if owner in ("", arm):
            if target not in values:
                raise ConfigError(f"[offsets.{table.run}]: " + unknown("column", target, values))
            values[target] += offset
    if given.rate_hz:
        values.setdefault("t", np.arange(n) / given.rate_hz)
    if given.missing == "refuse":
        refuse_not_finite(table, rules, values)
    else:
        values, text = _mended(values, given.missing)
        notes += [text] if text else []
    keep = clean_time(table, values["t"], given.gaps, given.repeated)
    values = {k: v[keep] for k, v in values.items()}
    said = {SIGNAL + k: repr(v) for k, v in given.signal.items()}
    order = fitted.order or range(d)
    positions = [rules[f"q{k + 1}"] for k in order]
    if not given.unit:
        _refuse_wraps(table, positions, wrapped)
    told = [
        found.text(f"q{k + 1}")
        for k, rule in enumerate(positions)
        for source, found in wrapped.items()
        if rule.unwrap and source in rule.terms
    ]
    said |= {UNWRAPPED: "; ".join(told)} if told else {}
    notes += [f"{text} (unwrap = false in its column of a map keeps it)" for text in told]
    positions = [replace(r, stated=r.stated or _turns(r, wrapped)) for r in positions]
    said |= {UNIT_SAID: given.unit} if given.unit else {}
    stated = " ".join(str(k + 1) for k, rule in enumerate(positions) if rule.stated)
    said |= {STATED: stated} if stated else {}
    kept = " ".join(str(k + 1) for k, rule in enumerate(positions) if not rule.unwrap)
    said |= {AS_IS: kept} if kept else {}
    recording = _recording(arm, table, values, order, fitted, given, {**said, **fitted.said})
    if not given.unit:
        refuse_units(table, recording, joints, positions)
    return _Arm(recording, rules, {n: values[n] for n in given.extras}, notes)


def _unwrapped(
    rules: Mapping[str, Rule], columns: Mapping[str, FloatArray]
) -> tuple[dict[str, FloatArray], dict[str, Wraps]]:
    """Columns (n,) in which positions that wrap are continuous, and how these wrap."""
    out, found = dict(columns), {}
    time = next(iter(rules["t"].terms), "") if "t" in rules else ""
    for target, rule in rules.items():
        sources = rule.terms.items() if stem_of(target) == "q" and rule.unwrap else ()
        for source, weight in sources:
            x = columns[source]
            there = np.isfinite(x)
            t = columns[time][there] if time else np.arange(int(there.sum()), dtype=float)
            one = wraps(t, x[there], periods(x[there], weight)) if t.size else None
            if one is not None:
                found[source] = one
                out[source] = x.copy()
                out[source][there] = one.values
    return out, found


def _turns(rule: Rule, wrapped: Mapping[str, Wraps]) -> bool:
    """Whether a position wraps at a turn in radians: then it is in radians."""
    sizes = [abs(w) * wrapped[s].period for s, w in rule.terms.items() if s in wrapped]
    return any(abs(size / TURN[0] - 1) < NEAR / 20 for size in sizes)


def _refuse_wraps(
    table: ForeignTable, positions: Sequence[Rule], wrapped: Mapping[str, Wraps]
) -> None:
    """Refuse a position that is no angle in radians, as the period says at which it wraps."""
    for k, rule in enumerate(positions):
        for source in rule.terms:
            if source not in wrapped or rule.stated or rule.terms[source] != 1.0:
                continue
            found = wrapped[source]
            if found.period == TURN[0]:
                continue
            units = {360.0: 'unit = "deg"', 1.0: 'unit = "rev"'}
            scale = f"scale = {TURN[0] / found.period:.9g}  # if {found.name} are a turn"
            entry = units.get(found.period, scale)
            raise DataError(
                f"table {table.path}: q{k + 1} wraps at {found.name}; it is not in radians. Say "
                f'what it is in, in a map: [columns] q{k + 1} = {{ from = "{source}", '
                f"{entry.partition('  #')[0]} }}"
                + (f" (if {found.name} are one turn)" if "#" in entry else "")
            )


def _sources(
    rules: Mapping[str, Rule], tables: Mapping[str, ForeignTable]
) -> tuple[dict[str, FloatArray], list[str]]:
    """Values of every column that a rule uses, all of one length, and what is said of them."""
    wanted = list(dict.fromkeys(s for rule in rules.values() for s in rule.terms))
    out: dict[str, FloatArray] = {}
    for prefix, table in tables.items():
        names = _prefixed(prefix, table)
        here = [n for n in wanted if n in names]
        plain = [table.names[names.index(n)] for n in here]
        out |= dict(zip(here, table.columns(plain).values(), strict=True))
    known = [n for p, t in tables.items() for n in _prefixed(p, t)]
    for name in wanted:
        if name not in out:
            raise ConfigError(f"table {tables[''].path}: " + unknown("column", name, known))
    out, said = _on_one_time(rules, tables[""], out)
    sizes = {name: values.size for name, values in out.items()}
    if len(set(sizes.values())) > 1:
        text = ", ".join(f"{n} {s}" for n, s in sizes.items())
        raise DataError(f"table {tables[''].path}: columns of different lengths: {text}")
    if not out or not min(sizes.values()):
        raise DataError(f"table {tables[''].path} holds no samples")
    return out, said


def _on_one_time(
    rules: Mapping[str, Rule], table: ForeignTable, values: dict[str, FloatArray]
) -> tuple[dict[str, FloatArray], list[str]]:
    """Columns that were logged at times of their own, interpolated at those that `t` is read from.

    Only while all of them were logged.
    """
    base = next(iter(rules["t"].terms), "") if "t" in rules else ""
    others = {n: table.times[n] for n in values if table.times.get(n, base) != base}
    if base not in values or not others:
        return values, []
    read = table.columns(list(dict.fromkeys(others.values())))
    t, moved, inside = values[base], [], np.ones(values[base].size, dtype=np.bool_)
    out = dict(values)
    for name, own in others.items():
        at = read[own]
        if at.size != values[name].size or at.size < 2 or np.any(np.diff(at) < 0):
            raise DataError(
                f"table {table.path}: {own!r} is not the increasing time of each sample of {name!r}"
            )
        if at.size == t.size and np.array_equal(at, t):
            continue
        out[name] = np.interp(t, at, values[name])
        inside &= (t >= at[0]) & (t <= at[-1])
        moved.append(name)
    if moved and all(v.size == t.size for v in out.values()):
        out = {n: v[inside] for n, v in out.items()}
    text = f"{', '.join(moved)}: interpolated at the times of {base}"
    lost = plural(int(np.sum(~inside)), "sample")
    text += f"; {lost} left out that not all of them span" if not inside.all() else ""
    return out, [text] if moved else []


def _recording(
    arm: str,
    table: ForeignTable,
    values: Mapping[str, FloatArray],
    order: Sequence[int],
    fitted: ColumnsRobot,
    given: TableMap,
    said: Mapping[str, str],
) -> Recording:
    joints = fitted.joints
    stacked = {
        key: np.stack([values[f"{stem}{k + 1}"] for k in order], axis=1)
        for stem, key in GROUPS.items()
        if f"{stem}1" in values
    }
    wrench = None
    if "fx" in values:
        zero = np.zeros(values["t"].size)
        wrench = np.stack([values.get(name, zero) for name in WRENCH], axis=1)
        if given.force_axes:
            wrench = _of_base(wrench, given.force_axes, fitted, stacked["q"])
    metres = joints and all(j.unit == "m" for j in joints)
    names = tuple(j.name for j in joints) or tuple(f"joint{k + 1}" for k in order)
    return Recording(
        name=table.run,
        arm=arm,
        joints=names,
        t=values["t"],
        q=stacked["q"],
        tau=stacked["tau"],
        qd=stacked.get("qd"),
        wrench=wrench,
        tau_ext=stacked.get("tau_ext"),
        current=stacked.get("current"),
        temperature=stacked.get("temperature"),
        robot=fitted.robot,
        metadata={"unit": given.unit or ("m" if metres else "rad"), **said},
    )


def _of_base(wrench: FloatArray, link: str, fitted: ColumnsRobot, q: FloatArray) -> FloatArray:
    """A wrench (n, 6) that the map says to be in the axes of a link, in axes of the base."""
    names = [j.name for j in fitted.joints]
    axes = frame_axes(fitted.robot.urdf, link, names, q) if fitted.robot.urdf else None
    if axes is None:
        raise DataError(
            f"[robot] force_axes = {link!r}: the robot's description has no such link; give the "
            "URDF (--robot) and the name of the link that carries the sensor"
        )
    return in_base_axes(wrench, axes)
