"""Whether the columns of a table can be what its map says: one time, whole rows, known units.

What cannot be mended is refused, and each refusal says what to do.  What is read from a name, a
size or a wrap and not from the map is said in a sentence.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from hil.errors import DataError, plural
from hil.record.consistency import counts_doubt, other_units, unit_doubt, velocity_factor
from hil.record.guess import quantity
from hil.record.jumps import NEAR, TURN, Wraps, periods, wraps
from hil.record.mapfile import Rule, TableMap, is_target
from hil.record.recording import AS_IS, STATED, UNIT_SAID, UNWRAPPED, Recording, usual_step
from hil.record.schema import LAST_S
from hil.record.table_files import ForeignTable
from hil.record.text_tables import is_clock
from hil.record.units import FACTORS, Unit, axis_of, epoch_unit, stem_of, time_unit
from hil.record.urdf_checks import UrdfJoint

FloatArray = NDArray[np.float64]
#: A step of so many median periods is a jump.
JUMP = 10.0
#: A longer median period [s] means that the time is not in seconds, or useless for dynamics.
LONG_PERIOD = 0.05
#: The longest one [s] where a map says that it is in seconds, or gives the rate.
LONGEST_PERIOD = 0.1
#: Rounding of times and drift of a clock that make no period longer, relative.
ROUNDED = 0.02
#: A median period [s] from which the time hardly is in seconds.
NO_SECONDS = 0.5
#: A rig hardly samples faster [Hz]: beyond it a time has another unit.
FASTEST_RIG = 2e4
#: No shorter median period [s] is one of a rig: filters and grids would take any memory.
SHORT_PERIOD = 1e-6
#: A day [s].
DAY, MINUTE = 86400.0, 60.0
#: A shorter period of a time since 1970 [s] says that it is none.
FASTEST = 1e-5
#: A longer stretch of missing values is no line [rows].
_BRIDGED = 10


def on_one_time(
    rules: Mapping[str, Rule], table: ForeignTable, values: dict[str, FloatArray]
) -> tuple[dict[str, FloatArray], list[str]]:
    """Columns that were logged at times of their own, interpolated at those that `t` is read from.

    Only while all of them were logged.

    Raises
    ------
    DataError
        If a column has no increasing time of its own for each of its samples.
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


#: Seconds between the beginnings of 1904, from which some instruments count, and of 1970; and what
#: a time is since 1904 if it says a year after 2065.
SINCE_1904, NO_DATE = 2082844800.0, 3.0e9


def in_seconds(
    rules: Mapping[str, Rule],
    columns: Mapping[str, FloatArray],
    cells: Mapping[str, str],
) -> tuple[Mapping[str, Rule], list[str]]:
    """Rules with the unit of the time that its name or its size says, where none was given.

    `cells` are those of the first row, as they are written.
    """
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
    if is_clock(cells.get(name, "")):
        return rules, [f"the time {name!r} is the time of day"]
    if unit == "s" and not epoch:
        return rules, []
    if epoch == "s" and first >= NO_DATE:
        begin = datetime.fromtimestamp(first - SINCE_1904, UTC)
        text = f"the time {name!r} is in s since 1904; it begins at {begin:%Y-%m-%d %H:%M:%S} UTC"
        return {**rules, "t": Rule({name: 1.0}, -SINCE_1904)}, [text]
    factor = FACTORS["t"][unit]
    text = f"the time {name!r} is in {unit}"
    if epoch:
        begin = datetime.fromtimestamp(first * factor, UTC)
        dates = ", or dates (UTC where they say no zone)" if unit == "s" else ""
        text += f" since 1970{dates}; it begins at {begin:%Y-%m-%d %H:%M:%S} UTC"
    return {**rules, "t": Rule({name: factor})}, [text]


def in_named_units(rules: Mapping[str, Rule]) -> tuple[dict[str, Rule], list[str]]:
    """Rules with the units that the names of their columns say, where none was given.

    Raises
    ------
    ConfigError
        If a name says a unit that needs a torque constant or a scale.
    """
    out, said = dict(rules), []
    for target, rule in rules.items():
        if target == "t" or rule.stated or not is_target(target):
            continue
        if len(rule.terms) != 1 or abs(next(iter(rule.terms.values()))) != 1.0:
            continue
        ((name, sign),) = rule.terms.items()
        unit = quantity(name)[1]
        axis = axis_of(target, unit)
        if not unit or FACTORS[stem_of(target)].get(unit) == 1.0:
            out[target] = replace(rule, axis=axis)
            continue
        factor, shift = Unit(unit).to_si(target)
        terms, shift = {name: sign * factor}, rule.shift + shift
        out[target] = replace(rule, terms=terms, shift=shift, stated=True, axis=axis)
        said.append(f"{target} is read in {unit}, as the name of its column {name!r} says")
    return out, said


def whole_rows(
    table: ForeignTable,
    rules: Mapping[str, Rule],
    values: Mapping[str, FloatArray],
    given: TableMap,
) -> tuple[dict[str, FloatArray], list[str]]:
    """Values of the rows that a fit can use, and what is said of the others.

    Parameters
    ----------
    table : ForeignTable
        For messages.
    rules, values : mapping
        By target column, with the time [s] as `t`.
    given : TableMap
        The map, which says what to do with missing values, repeated times and gaps.

    Raises
    ------
    DataError
        If values are missing and the map does not say what to do, or the time runs backward,
        repeats, jumps or is not in seconds.
    """
    notes: list[str] = []
    out = dict(values)
    if given.missing == "refuse":
        _refuse_not_finite(table, rules, out)
    else:
        out, text = _mended(out, given.missing)
        notes += [text] if text else []
    sure = given.rate_hz > 0 or ("t" in rules and rules["t"].stated)
    longest = LONGEST_PERIOD if sure else LONG_PERIOD
    keep = _clean_time(table, out["t"], given, longest, _time_column(rules))
    return {k: v[keep] for k, v in out.items()}, notes


def _time_column(rules: Mapping[str, Rule]) -> str:
    """Name that the time has in the table."""
    of = list(rules["t"].terms) if "t" in rules else []
    return of[0] if len(of) == 1 else "t"


#: Share by which a rate may be off the steps of a time and still mean the same.
_SAME_RATE = 0.01


def rate_told(table: ForeignTable, given: TableMap, values: Mapping[str, FloatArray]) -> list[str]:
    """What is said where a rate was given and the times of a table contradict it.

    A column that counts the samples contradicts nothing, nor does one in another unit of time.

    Parameters
    ----------
    table : ForeignTable
        The table.
    given : TableMap
        The map with the rate.
    values : mapping of str to ndarray (n,)
        By target column; with a time [s] only where the map names its column.
    """
    timed = [name for name in table.names if name == "t" or time_unit(name) is not None]
    if "t" in values:
        period, units = float(np.median(np.diff(values["t"]))), ["s"]
    elif len(timed) == 1:
        period, units = _steps(table, timed[0]), ["s", "ms", "us", "ns"]
    else:
        return []
    off = [abs(given.rate_hz * period * FACTORS["t"][unit] - 1) for unit in units]
    if not period > 0 or period == 1.0 or min(off) <= _SAME_RATE:
        return []
    theirs, ours = f"{1 / period:.4g} Hz", f"the rate of {given.rate_hz:.4g} Hz"
    if "t" in values:
        return [f"{ours} is not taken: the map names the column of the time, which says {theirs}"]
    return [
        f"{ours} is taken, and not the column {timed[0]!r}, which in seconds says {theirs}; leave "
        "the rate out if that column is the time"
    ]


def _steps(table: ForeignTable, name: str) -> float:
    """Median step of a column of increasing numbers; 0 of any other."""
    try:
        steps = np.diff(table.columns([name])[name])
    except DataError:
        return 0.0
    return float(np.median(steps)) if steps.size and np.all(steps > 0) else 0.0


def _refuse_not_finite(
    table: ForeignTable, rules: Mapping[str, Rule], values: Mapping[str, FloatArray]
) -> None:
    """Refuse NaN and infinite values: every column that has some, the worst first, and rows."""
    bad = {target: np.flatnonzero(~np.isfinite(v)) for target, v in values.items()}
    some = sorted((k for k in bad if bad[k].size), key=lambda k: -bad[k].size)
    if not some:
        return
    size = values[some[0]].size
    names = {k: ", ".join(rules[k].terms) if k in rules else k for k in some}
    each = [
        f"column {names[k]!r} has {bad[k].size} missing, NaN or infinite values of {size}, in "
        f"{_rows_told(table, bad[k])}"
        for k in some[:_TOLD]
    ]
    if len(some) > _TOLD:
        more = ", ".join(f"{names[k]!r} {bad[k].size}" for k in some[_TOLD:])
        each.append(f"further columns: {more}")
    what = f"table {table.path}: {'; '.join(each)}"
    these = "it" if len(some) == 1 and bad[some[0]].size == 1 else "these rows"
    raise DataError(
        f"{what}; remove or repair {these}, or choose what is done with such rows: "
        'missing = "drop" or "interpolate" in [table] of a map, or '
        f"{table.option('missing', 'drop')} or {table.option('missing', 'interpolate')}"
    ).about("missing", what)


#: Columns whose rows are told, and rows of each.
_TOLD, _ROWS = 3, 5


def _rows_told(table: ForeignTable, rows: NDArray[np.intp]) -> str:
    """The first of some rows, as the table counts them."""
    first = ", ".join(str(table.first_row + k) for k in rows[:_ROWS])
    if rows.size == 1:
        return f"row {first}"
    return f"rows {first}, ..." if rows.size > _ROWS else f"rows {first}"


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


def _clean_time(
    table: ForeignTable, t: FloatArray | None, given: TableMap, longest: float, column: str
) -> NDArray[np.intp]:
    """Rows to keep, after checking that the time increases evenly, by `longest` [s] at most.

    `column` is its name in the table.
    """
    gaps, repeated = given.gaps, given.repeated
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
        _refuse_twelve_hours(table, t)
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
    _refuse_twelve_hours(table, t)
    _refuse_steps(table, t[even], even, gaps, longest, column)
    return rows if repeated == "keep" else even


def _refuse_twelve_hours(table: ForeignTable, t: FloatArray) -> None:
    """Refuse a clock of twelve hours that does not say which half of the day it is.

    It goes back by twelve hours in the place of one sample, or ahead by a day where dates stand
    before the times.
    """
    dt = np.diff(t)
    near = JUMP * float(np.median(np.abs(dt)))
    for step, how in ((-DAY / 2, "goes back by 12 hours"), (DAY, "goes ahead by 24 hours")):
        at = np.flatnonzero(np.abs(dt - step) <= near)
        if at.size and near < MINUTE:
            raise DataError(
                f"table {table.path}: the time {how} within one sample in row "
                f"{table.first_row + int(at[0]) + 1}, as a clock of twelve hours that says neither "
                "AM nor PM. Write AM or PM behind each time, or hours from 0 to 23; or import each "
                "part by itself"
            )


def _refuse_steps(
    table: ForeignTable,
    t: FloatArray,
    rows: NDArray[np.intp],
    gaps: str,
    longest: float,
    column: str,
) -> None:
    dt = np.diff(t)
    if not dt.size:
        raise DataError(f"table {table.path}: the time never changes")
    period = usual_step(dt)
    if period < SHORT_PERIOD:
        what = (
            f"table {table.path}: the time advances by {period:.4g} s a sample; no rig samples "
            f"faster than {1 / SHORT_PERIOD:g} Hz"
        )
        raise DataError(
            f"{what}. Scale it to seconds in a map, [columns] t = "
            f"{{ from = {json.dumps(column, ensure_ascii=False)}, scale = ... }}"
        ).about("time", what)
    if period > longest * (1 + ROUNDED):
        what = (
            f"table {table.path}: the time advances by {period:.4g} s a sample "
            f"({1 / period:.3g} Hz)"
        )
        raise DataError(f"{what}; {_what_time(t, period, longest, column)}").about("time", what)
    jumps = np.flatnonzero(dt > JUMP * period)
    if jumps.size and gaps == "refuse":
        k = int(jumps[0])
        raise DataError(
            f"table {table.path}: time jumps {jumps.size} times, first in row "
            f"{table.first_row + int(rows[k + 1])} (from {t[k]:.6g} to {t[k + 1]:.6g} s at a "
            f"period of {period:.4g} s); import each part by itself, or say "
            'gaps = "keep" in [table] of a map'
        )


_SPOKEN = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}


def _what_time(t: FloatArray, period: float, longest: float, column: str) -> str:
    """What a time may be that is too slow in seconds, and what to do."""
    slow = f"{1 / longest:g} Hz is the slowest that is analysed"
    of = json.dumps(column, ensure_ascii=False)
    map_ = f'in a map, [columns] t = {{ from = {of}, unit = "'
    fits = {
        unit: 1 / (period * FACTORS["t"][unit])
        for unit in ("ms", "us", "ns")
        if 1 / FASTEST_RIG <= period * FACTORS["t"][unit] <= LONG_PERIOD
    }
    units = ", or ".join(f"{_SPOKEN[unit]} ({rate:.4g} Hz)" for unit, rate in fits.items())
    if epoch_unit(float(t[0])) == "s" and np.all(t == np.floor(t)):
        return (
            "these are dates to whole seconds, and there are several samples in each. Record the "
            "time with its fractions, or leave it out and give rate_hz = ... in [table] of a map"
        )
    if np.all(np.diff(t) == 1.0):
        return (
            "it counts samples, or is in ms. For samples give rate_hz = ... in [table] of a map; "
            f'for ms say so {map_}ms" }}'
        )
    if period >= NO_SECONDS and fits:
        unit = next(iter(fits))
        return (
            f'it looks like {units}: say so {map_}{unit}" }}. If it truly is in seconds, the '
            f"recording is too slow for dynamics: {slow}"
        )
    if longest < period <= LONGEST_PERIOD * (1 + ROUNDED):
        return (
            f'without a word of its unit {slow}. If it is in seconds, say so {map_}s" }}; if it is '
            f'in another unit, {map_}ms" }}'
        )
    return f'{slow}. Record faster; if the time is in another unit, say so {map_}ms" }}'


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


def unwrapped(
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


def judged_wraps(
    table: ForeignTable, positions: Sequence[Rule], wrapped: Mapping[str, Wraps], given: TableMap
) -> tuple[list[Rule], dict[str, str], list[str]]:
    """Rules of positions with what their wraps say, metadata of their units, and what is said.

    Parameters
    ----------
    table : ForeignTable
        For messages.
    positions : sequence of Rule
        Where each joint's position comes from.
    wrapped : mapping of str to Wraps
        What `unwrapped` found, by column.
    given : TableMap
        The map; positions whose unit it says are not doubted.

    Raises
    ------
    DataError
        If the period at which a position wraps says that it is no angle in radians.
    """
    if not given.unit:
        _refuse_wraps(table, positions, wrapped)
    told = [
        found.text(f"q{k + 1}")
        for k, rule in enumerate(positions)
        for source, found in wrapped.items()
        if rule.unwrap and source in rule.terms
    ]
    said = {UNWRAPPED: "; ".join(told)} if told else {}
    notes = [f"{text} (unwrap = false in its column of a map keeps it)" for text in told]
    out = [replace(r, stated=r.stated or _turns(r, wrapped)) for r in positions]
    said |= {UNIT_SAID: given.unit} if given.unit else {}
    stated = " ".join(str(k + 1) for k, rule in enumerate(out) if rule.stated)
    said |= {STATED: stated} if stated else {}
    kept = " ".join(str(k + 1) for k, rule in enumerate(out) if not rule.unwrap)
    said |= {AS_IS: kept} if kept else {}
    return out, said, notes


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
        joint = joints[k] if joints else UrdfJoint(name, recording.units[k])
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
            if joint.unit == "rad" and not bounded:
                raise DataError(
                    f"table {table.path}: q{k + 1} ({name}) runs from {q.min():.4g} to "
                    f"{q.max():.4g}, in rad or in degrees? Say {table.option('unit', 'rad')} if it "
                    f"turns so often, {table.option('unit', 'deg')} if these are degrees; or say "
                    f'it in a map: unit = "rad" under [robot], or [columns] q{k + 1} = '
                    f'{{ from = "{source}", scale = 0.0174532925199433 }}'
                )
            units, degrees = other_units(q, joint), joint.unit == "rad"
            what, scale = " or ".join(units), " or ".join(f"{x:.15g}" for x in units.values())
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
        if correlation > 0.98 and abs(factor / known - 1) < 0.05 and r.units[k] == "rad":
            raise DataError(
                f"table {table.path}: qd{k + 1} is {factor:.4g} times the derivative of "
                f"q{k + 1}, so {column} is in degrees. Scale it in a map: [columns] "
                f'{column} = {{ from = "{column}", scale = 0.0174532925199433 }}'
            )
