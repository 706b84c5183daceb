"""From a table of any rig to recordings: which column is which, of which arm and of which robot.

A table is refused whole if columns that belong together are missing, or if `column_checks` finds
values that no fit could use; each refusal says what to do.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError, plural, unknown
from hil.record.column_checks import (
    from_zero,
    in_named_units,
    in_seconds,
    judged_wraps,
    on_one_time,
    rate_told,
    refuse_units,
    unwrapped,
    whole_rows,
)
from hil.record.guess import propose, quantity, unit_named
from hil.record.locked import (
    ColumnsRobot,
    columns_robot,
    count_joints,
    frame_axes,
    free_joints,
    grouped,
    in_base_axes,
)
from hil.record.mapfile import Rule, TableMap, is_target, parse_map, refuse_constants
from hil.record.recording import GROUPS, SIGNAL, WRENCH, Recording, RobotSource
from hil.record.schema import Channel
from hil.record.table_files import ForeignTable, open_table
from hil.record.units import axes_unit, stem_of, time_unit
from hil.record.urdf_checks import UrdfJoint
from hil.userfile import parse_toml, read_text

FloatArray = NDArray[np.float64]
EXTRAS = "hil_msgs/msg/Extras"
#: How the note begins on columns that no map names.
BY_JOINTS = "columns are taken by the joints and units that their names say"
#: Columns that a table of one joint may have without its number; `i` is often a row's number.
OF_A_JOINT = ("q", "qd", "tau", "tauext")


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
    force_axes: str = "",
    arm: str = "",
    run: str = "",
    unit: str = "",
    torque_constant: Sequence[float] = (),
    missing: str = "",
    rate_hz: float = 0.0,
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
    urdf, tip, force_axes, unit : str
        Robot file, frame of the force, link in whose axes it is, and unit of the axes; each
        overrules the map.
    arm : str
        Name of the only arm, or which of several arms to keep.
    run : str
        Which run of the file.
    torque_constant : sequence of float
        Effort at the joint by motor current [N m/A], where the efforts are currents.
    missing : str
        As in the map, which it overrules.
    rate_hz : float
        Sample rate of a table without times, as in the map, which it overrules.
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
    given = replace(
        given,
        tip=tip or given.tip,
        force_axes=force_axes or given.force_axes,
        missing=missing or given.missing,
        rate_hz=rate_hz or given.rate_hz,
        joints=tuple(joints) or given.joints,
        lock={**given.lock, **(lock or {})},
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
    source, joints = _robot(given, table.path, robot)
    given, named = _by_joints(table, given, joints)
    arms = _select(given, arm)
    for name in arms:
        refuse_arm(name)
    recordings: list[Recording] = []
    used: set[str] = set()
    extra: dict[str, FloatArray] = {}
    notes = [*table.notes, *named]
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


def _by_joints(
    table: ForeignTable, given: TableMap, joints: Sequence[UrdfJoint]
) -> tuple[TableMap, list[str]]:
    """A map by names that say joints of the robot, and what was taken; as given where none do.

    Only where no map and no default name says where the positions are, and nothing is in doubt.
    """
    known = {stem_of(n) for n in _called(table.names).values() if is_target(n)}
    if not joints or any(given.arms.values()) or given.patterns or "q" in known:
        return given, []
    found = propose(table.names, given.joints or [j.name for j in joints], table.first)
    if found is None or not found.plain:
        return given, []
    made = parse_map(parse_toml(found.text)).within_units(given.units_of)
    first = ", ".join(f"{k} = {n}" for k, n in found.columns.items() if k in ("t", "q1", "tau1"))
    said = f"{BY_JOINTS}: {first}, and so on"
    more = replace(given, arms=made.arms, joints=given.joints or made.joints)
    return replace(more, units_of={**made.units_of, **given.units_of}), [said]


def _with_defaults(
    rules: Mapping[str, Rule], table: ForeignTable, given: TableMap
) -> tuple[dict[str, Rule], list[str]]:
    """Rules of the map, and columns that bear a default name and that no rule uses; what is said.

    Where nothing is the time, a column that is named like one is taken.  Where no column bears the
    number of a joint, those without one are of the only joint.
    """
    own = {**given.expand(table.names), **rules}
    taken = {source for rule in own.values() for source in rule.terms}
    called = _called(table.names)
    counted = _from_zero(table, called, taken) if not own else {}
    default = {
        counted.get(n, c): given.rule(counted.get(n, c), n)
        for n, c in called.items()
        if (is_target(c) or n in counted)
        and n not in taken
        and c not in own
        and not (c == "t" and given.rate_hz)
    }
    out, said = _whole_groups(own, default)
    if counted:
        first = ", ".join(n for n, target in counted.items() if target == f"{n[:-1]}1")
        said.append(f"the columns count joints from 0: {first} are of the first one")
    lone = {c: n for n, c in called.items() if c in OF_A_JOINT and n not in taken}
    if "q" in lone and not any(n.rstrip("0123456789") in OF_A_JOINT for n in out):
        out |= {f"{c}1": given.rule(f"{c}1", n) for c, n in lone.items()}
        said.append(f"taken as the columns of the only joint: {', '.join(lone)}")
    timed = [n for n in table.names if time_unit(n) is not None and n not in taken]
    if "t" not in out and not given.rate_hz and len(timed) == 1:
        out["t"] = given.rule("t", timed[0])
        said.append(f"the column {timed[0]!r} is taken as the time")
    efforts = _of_currents(out, given)
    if efforts:
        names = ", ".join(name for rule in efforts.values() for name in rule.terms)
        said.append(f"efforts are torque constants times the currents {names}")
    return {**out, **efforts}, said


#: What a fit can do without, by the stems of its columns.
_SPARED = ("i", "temp")


def _whole_groups(
    own: Mapping[str, Rule], default: Mapping[str, Rule]
) -> tuple[dict[str, Rule], list[str]]:
    """Rules of a map and of default names, without what some joints have and others have not.

    A logger's only ``temp1`` is of no joint: it is left out, unless a map asks for its group.
    """
    out = {**own, **default}
    groups, d = grouped(out), max(grouped(out).get("q", [0]))
    asked = set(grouped(own))
    parts = [k for k in _SPARED if k in groups and k not in asked and d]
    part = {f"{k}{n}" for k in parts if set(groups[k]) != set(range(1, d + 1)) for n in groups[k]}
    said = [f"{', '.join(t for t in out if t in part)}: not read, because not every joint has one"]
    return {t: rule for t, rule in out.items() if t not in part}, said if part else []


def _of_currents(rules: Mapping[str, Rule], given: TableMap) -> dict[str, Rule]:
    """Efforts by the currents ``i1..``, where torque constants are given and no effort is there."""
    unit = given.units_of.get("tau")
    if unit is None or not unit.torque_constant or any(stem_of(x) == "tau" for x in rules):
        return {}
    out = {}
    for target, rule in rules.items():
        if is_target(target) and stem_of(target) == "i" and len(rule.terms) == 1:
            name = next(iter(rule.terms))
            own = quantity(name)[1]
            entry = {"from": name, "unit": own} if own else {"from": name}
            out[f"tau{target[1:]}"] = given.rule(f"tau{target[1:]}", entry)
    return out


#: A column of a joint without its unit, in letters of any size, and how others call its stem.
_OF_JOINT = re.compile(r"(q|qd|dq|qdot|tau|tauext|i|temp)([0-9]{0,2})", re.IGNORECASE)
_WITH_UNIT = re.compile(r"(\w+?) *[\[(]([^\[\]()]+)[\])]")
_ALIKE = {"dq": "qd", "qdot": "qd"}


def _called(names: Sequence[str]) -> dict[str, str]:
    """How a recording calls each column of a table: ``q1`` of ``Q1 [deg]``, ``qd1`` of ``dq1``.

    A column that is called otherwise, or as another one that comes before it, keeps its name.
    """
    out: dict[str, str] = {}
    for name in sorted(names, key=lambda n: not is_target(n)):
        united = _WITH_UNIT.fullmatch(name)
        bare = united[1] if united and unit_named(united[2]) else name
        found = _OF_JOINT.fullmatch(bare)
        stem = found[1].lower() if found else ""
        meant = f"{_ALIKE.get(stem, stem)}{found[2]}" if found else name
        out[name] = name if meant in out.values() else meant
    return {name: out[name] for name in names}


def _from_zero(
    table: ForeignTable, called: Mapping[str, str], taken: Collection[str]
) -> dict[str, str]:
    """Columns of a recording by those of a table that counts its joints from 0; else nothing.

    Raises
    ------
    DataError
        If some quantities count from 0 and others from 1.
    """
    numbered = re.compile(r"(q|qd|tau|tauext|i|temp)([0-9]{1,2})")
    found = {n: m for n, c in called.items() if n not in taken and (m := numbered.fullmatch(c))}
    first = {found[n][0] for n in found if int(found[n][2]) == 0}
    if "q0" not in first:
        return {}
    stems = {m[1] for m in found.values()}
    if others := sorted(stem for stem in stems if f"{stem}0" not in first):
        raise DataError(
            f"table {table.path}: q0 counts the joints from 0, and {', '.join(others)} from 1; "
            'say which column is of which joint in a map: [columns] q1 = "q0", ...'
        )
    return {n: f"{m[1]}{int(m[2]) + 1}" for n, m in found.items()}


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
        ).about("urdf", f"URDF {file}: no such file") from error
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
    refuse_constants(given.units_of, d)
    rules, timed = in_seconds(rules, columns, table.first)
    rules, named = in_named_units(rules)
    columns, wrapped = unwrapped(rules, columns)
    values = {target: rule.apply(columns, n) for target, rule in rules.items()}
    for name, offset in given.offsets.get(table.run, {}).items():
        owner, _, target = name.rpartition(".")
        if owner in ("", arm):
            if target not in values:
                raise ConfigError(f"[offsets.{table.run}]: " + unknown("column", target, values))
            values[target] += offset
    other = ", ".join(given.offsets) if table.run not in given.offsets else ""
    told_of = [f"the offsets of the map are of {other}, none of {table.run}"] if other else []
    if given.rate_hz:
        told_of += rate_told(table, given, values)
        values.setdefault("t", np.arange(n) / given.rate_hz)
    values, mended = whole_rows(table, rules, values, given)
    order = fitted.order or range(d)
    said = _signal(given, order)
    positions = [rules[f"q{k + 1}"] for k in order]
    said |= {"unit": _axes(given, fitted, rules, order)}
    positions, units, told = judged_wraps(table, positions, wrapped, given)
    said = {**said, **units, **fitted.said}
    recording = _recording(arm, table, values, order, fitted, given, said)
    if not given.unit:
        refuse_units(table, recording, joints, positions)
    notes = [*fitted.notes, *timed, *named, *told_of, *resampled, *mended, *told]
    return _Arm(recording, rules, {n: values[n] for n in given.extras}, notes)


def _signal(given: TableMap, order: Sequence[int]) -> dict[str, str]:
    """Metadata of what a map says of the signals; what is one a joint, in their order."""
    out = {}
    for key, value in given.signal.items():
        if isinstance(value, tuple):
            if len(value) != len(order):
                raise ConfigError(
                    f"signal.{key} of the map has {plural(len(value), 'number')} for "
                    f"{plural(len(order), 'joint')}; expected one a joint, 0 = none"
                )
            value = tuple(value[k] for k in order)
        out[SIGNAL + key] = json.dumps(value)
    return out


def _axes(
    given: TableMap, fitted: ColumnsRobot, rules: Mapping[str, Rule], order: Sequence[int]
) -> str:
    """Unit of the axes: of the map, the robot, or the units of their columns; one, or one each."""
    d = len(order)
    if given.unit:
        if len(given.unit.split()) not in (1, d):
            raise ConfigError(
                f"unit {given.unit!r} is of {len(given.unit.split())} joints, but there are {d}; "
                "say one, or one a joint"
            )
        return given.unit
    units = [j.unit for j in fitted.joints]
    for k in order if not units else ():
        columns = (rules.get(f"{stem}{k + 1}") for stem in ("q", "qd", "tau", "tauext"))
        units.append(next((c.axis for c in columns if c is not None and c.axis), "rad"))
    return axes_unit(units)


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
    out, said = on_one_time(rules, tables[""], out)
    sizes = {name: values.size for name, values in out.items()}
    if len(set(sizes.values())) > 1:
        text = ", ".join(f"{n} {s}" for n, s in sizes.items())
        raise DataError(f"table {tables[''].path}: columns of different lengths: {text}")
    if not out or not min(sizes.values()):
        raise DataError(f"table {tables[''].path} holds no samples")
    return out, said


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
        metadata=dict(said),
    )


def _of_base(wrench: FloatArray, link: str, fitted: ColumnsRobot, q: FloatArray) -> FloatArray:
    """A wrench (n, 6) that the map says to be in the axes of a link, in axes of the base."""
    names = [j.name for j in fitted.joints]
    axes = frame_axes(fitted.robot.urdf, link, names, q) if fitted.robot.urdf else None
    if axes is None:
        raise DataError(
            f"force axes {link!r}: the robot's description has no such link; give the URDF "
            "(--robot) and the name of the link that carries the sensor (--force-axes, or "
            "force_axes under [robot] of the map)"
        )
    return in_base_axes(wrench, axes)
