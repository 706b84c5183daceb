"""Map files: how the columns of a foreign table become those of a recording, and their units.

    value = scale * sign * source + shift (+ the offset of the run)

or, for a combination of columns, ``sum = { a = 0.5, b = -0.5 }`` in place of `from`; a bare
number is a constant column.  A `unit` multiplies the scale.  A position that wraps is made
continuous before, but for ``unwrap = false``.  ``"q*" = "state.q[*]"`` is a rule for
all joints; of a list of such names the first counts that the table has.  ``[extras]`` takes further
columns along, each with its unit.

Units are those that labs write; a recording has SI units.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.record.recording import EFFORT_STEP, signal_value
from hil.record.units import Unit, axes_unit, axis_of, scale_asked, stem_of
from hil.userfile import parse_toml, read_text

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Rule:
    """One column of the recording from those of the table: sum of weight * source, + shift.

    `stated`: its unit was said, or a scale, so that nobody doubts it.  `unwrap`: a position that
    wraps is made continuous.  `axis`: ``"rad"`` or ``"m"`` where its unit says that of its joint.
    """

    terms: Mapping[str, float]
    shift: float = 0.0
    stated: bool = False
    unwrap: bool = True
    axis: str = ""

    def apply(self, columns: Mapping[str, FloatArray], n: int) -> FloatArray:
        """Values (n,) of the column."""
        out = np.full(n, self.shift)
        for source, weight in self.terms.items():
            out += weight * columns[source]
        return out


@dataclass(frozen=True)
class TableMap:
    """A map file, or what stands for it when there is none.

    Parameters
    ----------
    arms : mapping of str to mapping of str to Rule
        Rules by arm and target column; the arm ``""`` is the only one and unnamed.
    preset, urdf, tip : str
        The robot; `urdf` is a file name.
    force_axes : str
        Link of the URDF in whose axes the force is; ``""`` = the base's.
    unit : str
        Unit of the axes, ``"rad"`` or ``"m"``, or one a joint (``"rad m"``); ``""`` = not said
        (that of the columns is taken, else rad, and doubted).
    array, columns : str, tuple of str
        Which 2-D array, and the names of its columns.
    rate_hz : float
        Sample rate where the table has no time column; 0 otherwise.
    join : mapping of str to str
        Further tables beside the first by the prefix of their columns.
    gaps, repeated : str
        ``"keep"`` what was recorded, or ``"refuse"`` it; ``"drop"`` the repeated rows.
    missing : str
        ``"refuse"`` missing values, ``"drop"`` their rows, or ``"interpolate"`` short stretches.
    header_row : int
        Row of a text table with the names of the columns; 0 to find it.
    units_of : mapping of str to Unit
        Unit of the columns with this stem that have no rule, or a rule for all joints.
    patterns : mapping of str to tuple of mapping
        Rules for all joints by stem, see `expand`.
    signal : mapping of str to float, or to a tuple of float
        What is said of the analysis, as in a model's [signal].
    offsets : mapping
        Offset by run and target column (``arm.column`` where there are several arms).
    extras, units : mapping
        Further columns to take along by field name, and their units.
    folder : Path or None
        Folder of the map file.
    joints : tuple of str
        Joints of the URDF that the columns are of, in their order; the others are locked.
    lock : mapping of str to float
        Where joints are locked [rad or m]; the others at 0, or the limit next to it.
    """

    arms: Mapping[str, Mapping[str, Rule]] = field(default_factory=lambda: {"": {}})
    preset: str = "single-axis"
    urdf: str = ""
    tip: str = ""
    force_axes: str = ""
    unit: str = ""
    array: str = ""
    columns: tuple[str, ...] = ()
    rate_hz: float = 0.0
    join: Mapping[str, str] = field(default_factory=dict)
    gaps: str = "keep"
    repeated: str = "keep"
    missing: str = "refuse"
    header_row: int = 0
    units_of: Mapping[str, Unit] = field(default_factory=dict)
    patterns: Mapping[str, tuple[Mapping[str, Any], ...]] = field(default_factory=dict)
    signal: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)
    offsets: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    extras: Mapping[str, Rule] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    folder: Path | None = None
    joints: tuple[str, ...] = ()
    lock: Mapping[str, float] = field(default_factory=dict)

    def rule(self, target: str, entry: Mapping[str, Any] | str) -> Rule:
        """Rule of a column as it would stand in [columns], in the unit that [units] says."""
        return _rule(target, entry, self.units_of)

    def expand(self, names: Sequence[str]) -> dict[str, Rule]:
        """Rules of the patterns for the columns that a table has.

        Parameters
        ----------
        names : sequence of str
            Columns of the table.
        """
        out: dict[str, Rule] = {}
        for stem, choices in self.patterns.items():
            for entry in choices:
                found = _matching(str(entry["from"]), names)
                for k, name in enumerate(found, 1):
                    out[f"{stem}{k}"] = self.rule(f"{stem}{k}", {**entry, "from": name})
                if found:
                    break
        return out

    def within(self, unit: str, torque_constant: Sequence[float]) -> TableMap:
        """The map with units from the command line; ``"deg"`` is of positions and speeds."""
        units = _with_constants(self.units_of, torque_constant)
        if unit != "deg":
            return replace(self, unit=unit or self.unit, units_of=units)
        degrees = {"q": Unit("deg"), "qd": Unit("deg/s")}
        return replace(self.within_units(degrees), unit="rad", units_of=units | degrees)

    def within_units(self, units: Mapping[str, Unit]) -> TableMap:
        """The map with units, by stem, for the rules that do not say theirs."""
        arms = {
            arm: {target: _in_units(target, rule, units) for target, rule in rules.items()}
            for arm, rules in self.arms.items()
        }
        return replace(self, arms=arms)


def _in_units(target: str, rule: Rule, units: Mapping[str, Unit]) -> Rule:
    """A rule whose unit the map does not say, in that of its stem; a constant stays."""
    stem = stem_of(target)
    if rule.stated or not rule.terms or stem not in units:
        return rule
    factor, zero = units[stem].to_si(target)
    terms = {name: factor * weight for name, weight in rule.terms.items()}
    axis = axis_of(target, units[stem].name)
    return replace(rule, terms=terms, shift=rule.shift + zero, stated=True, axis=axis)


def refuse_constants(units: Mapping[str, Unit], joints: int) -> None:
    """Refuse more torque constants than joints.

    Raises
    ------
    ConfigError
        If there are more.
    """
    for unit in units.values():
        given = unit.torque_constant
        if not isinstance(given, int | float) and len(given) > joints:
            raise ConfigError(
                f"{len(given)} torque constants for {joints} joints; give one, or one a joint"
            )


def _with_constants(units: Mapping[str, Unit], torque_constant: Sequence[float]) -> dict[str, Unit]:
    """Units in which the efforts are currents, where torque constants are given; one is of all."""
    if not torque_constant:
        return dict(units)
    old = units.get("tau", Unit("A")).name or "A"
    one = len(torque_constant) == 1
    return {**units, "tau": Unit(old, torque_constant[0] if one else tuple(torque_constant))}


def _matching(pattern: str, names: Sequence[str]) -> list[str]:
    """Columns that a pattern with one ``*`` for a number matches, by that number."""
    head, _, tail = pattern.partition("*")
    numbered = re.compile(re.escape(head) + r"([0-9]{1,2})" + re.escape(tail))
    found = [(int(m[1]), n) for n in names if (m := numbered.fullmatch(n))]
    return [name for _, name in sorted(found)]


def patterns(columns: Mapping[str, str]) -> dict[str, str]:
    """Rules of columns, those of a stem as one pattern for `TableMap.expand` where they are one.

    Parameters
    ----------
    columns : mapping of str to str
        Column of the table by target column.
    """
    out: dict[str, str] = {}
    stems = {target: target.rstrip("0123456789") for target in columns}
    for stem in dict.fromkeys(stems.values()):
        own = {target: columns[target] for target in columns if stems[target] == stem}
        plan = [f"{stem}{k + 1}" for k in range(len(own))]
        head, _, tail = re.sub(r"[0-9]+(?=[^0-9]*$)", "*", next(iter(own.values()))).partition("*")
        same = _matching(f"{head}*{tail}", list(own.values()))
        one = len(own) > 2 and list(own) == plan and same == list(own.values())
        out |= {f"{stem}*": f"{head}*{tail}"} if one else own
    return out


def known_log(names: Sequence[str]) -> str:
    """Built-in map of a program whose log has such columns; empty where none reads them.

    Parameters
    ----------
    names : sequence of str
        Columns of the table.
    """
    for name in builtin_maps():
        found = read_map(name, (1.0,) * _MOST_JOINTS)
        timed = set(found.arms.get("", {}).get("t", Rule({"": 1.0})).terms) <= set(names)
        filled = found.expand(names) if timed and found.patterns else {}
        if {"q1", "tau1"} <= set(filled):
            return name
    return ""


#: Torque constants that stand in while a map is only compared with columns.
_MOST_JOINTS = 99
SCHEMA = "hil.map/1"
TARGETS = (
    "t",
    "q1..",
    "qd1..",
    "tau1..",
    "tauext1..",
    "i1..",
    "temp1..",
    "fx",
    "fy",
    "fz",
    "tx",
    "ty",
    "tz",
)
_TARGET = re.compile(r"t|[ft][xyz]|(q|qd|tau|tauext|i|temp)[1-9][0-9]?")
_TOP = ("schema", "robot", "table", "columns", "units", "arms", "offsets", "extras", "signal")
_ROBOT = ("preset", "urdf", "tip", "force_axes", "unit", "arm", "joints", "lock")
_TABLE = ("array", "columns", "rate_hz", "join", "gaps", "repeated", "missing", "header_row")
_SIGNAL = (
    "position_hz",
    "effort_hz",
    "rate_hz",
    "gap_s",
    "shift_s",
    "lag_s",
    "lag_poles",
    "clock_ppm",
    "accuracy",
    EFFORT_STEP,
)
_RULE = ("from", "sum", "scale", "sign", "shift", "unit", "torque_constant", "unwrap")
#: Values of a key of [table]; the first is the default.
_POLICIES = {
    "gaps": ("keep", "refuse"),
    "repeated": ("keep", "drop", "refuse"),
    "missing": ("refuse", "drop", "interpolate"),
}
_STEMS = ("t", "q", "qd", "tau", "tauext", "i", "temp")


def is_target(name: str) -> bool:
    """Whether a column of this name belongs to a recording."""
    return _TARGET.fullmatch(name) is not None


def builtin_maps() -> tuple[str, ...]:
    """Names of the maps that come with the package."""
    files = resources.files("hil.record").joinpath("maps").iterdir()
    return tuple(sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml")))


def _plain(name: str) -> str:
    """A name as it may be typed: ur_rtde is ur-rtde."""
    return name.lower().replace("_", "-")


def read_map(source: str | Path, torque_constant: Sequence[float] = ()) -> TableMap:
    """Read a map file, or a built-in map by its name.

    Parameters
    ----------
    source : str or Path
        File or name.
    torque_constant : sequence of float
        As on the command line: of the efforts that the map reads from currents [N m/A].

    Raises
    ------
    ConfigError
        If it is missing, not TOML, or holds an unknown key or column.
    """
    path, name = Path(source), str(source)
    spelt = {_plain(n): n for n in builtin_maps()}
    builtin = not path.is_file() and _plain(name) in spelt
    try:
        if builtin:
            name = spelt[_plain(name)]
            text = resources.files("hil.record").joinpath("maps", f"{name}.toml").read_text("utf-8")
        else:
            text = read_text(path)
        out = parse_map(parse_toml(text), torque_constant)
    except FileNotFoundError as error:
        known = ", ".join(builtin_maps())
        raise ConfigError(f"map {name}: no such file, and no built-in map ({known})") from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"map {name} cannot be read: {error}") from error
    except ConfigError as error:
        raise ConfigError(f"map {name}: {error}") from error
    return out if builtin else replace(out, folder=path.parent)


def parse_map(data: Mapping[str, Any], torque_constant: Sequence[float] = ()) -> TableMap:
    """Map from the tables of a TOML file.

    Raises
    ------
    ConfigError
        If it holds an unknown key, column or value.
    """
    _keys(data, _TOP, "the map")
    if data.get("schema", SCHEMA) != SCHEMA:
        raise ConfigError(f"schema is {data['schema']!r}, expected {SCHEMA!r}")
    robot, table = _table(data, "robot", _ROBOT), _table(data, "table", _TABLE)
    if "urdf" in robot and "preset" in robot:
        raise ConfigError("[robot] has both urdf and preset; keep one")
    for key, values in _POLICIES.items():
        if table.get(key, values[0]) not in values:
            raise ConfigError(unknown(f"value of table.{key}", str(table[key]), values))
    units = _with_constants(_units_of(_table(data, "units", _STEMS)), torque_constant)
    arms = _arms(data, str(robot.get("arm", "")), units)
    return TableMap(
        arms=arms,
        preset=str(robot.get("preset", "single-axis")),
        urdf=str(robot.get("urdf", "")),
        tip=str(robot.get("tip", "")),
        force_axes=str(robot.get("force_axes", "")),
        unit=axes_unit(robot.get("unit", "")),
        array=str(table.get("array", "")),
        columns=_names(table.get("columns", ())),
        rate_hz=_number(table.get("rate_hz", 0.0), "table.rate_hz"),
        join={str(k): str(v) for k, v in _table(table, "join").items()},
        gaps=str(table.get("gaps", "keep")),
        repeated=str(table.get("repeated", "keep")),
        missing=str(table.get("missing", "refuse")),
        header_row=_row(table.get("header_row", 0)),
        units_of=units,
        patterns=_patterns(_table(data, "columns")),
        offsets=_offsets(data, arms),
        joints=_names(robot.get("joints", ())),
        lock={k: _number(v, f"robot.lock.{k}") for k, v in _table(robot, "lock").items()},
        signal={
            k: signal_value(k, v, f"signal.{k}") for k, v in _table(data, "signal", _SIGNAL).items()
        },
        **_extras(data),
    )


def _row(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ConfigError(f"table.header_row is {value!r}; expected the number of a row, e.g. 5")
    return value


def _units_of(table: Mapping[str, Any]) -> dict[str, Unit]:
    """Units by stem."""
    out: dict[str, Unit] = {}
    for stem, entry in table.items():
        given = {"unit": entry} if isinstance(entry, str) else entry
        if not isinstance(given, dict):
            raise ConfigError(f"units.{stem} is {entry!r}; expected a unit, e.g. {stem} = 'deg'")
        _keys(given, ("unit", "torque_constant"), f"units.{stem}")
        out[stem] = _unit(given, f"units.{stem}")
        if not given.get("torque_constant") and out[stem].name in ("A", "mA"):
            continue  # it may come from the command line
        out[stem].to_si(f"{stem}1" if stem != "t" else "t")
    return out


def _unit(entry: Mapping[str, Any], what: str) -> Unit:
    constant = entry.get("torque_constant", 0.0)
    where = f"{what}.torque_constant"
    several = isinstance(constant, list)
    values = tuple(_number(x, where) for x in constant) if several else _number(constant, where)
    return Unit(str(entry.get("unit", "")), values)


def _arms(
    data: Mapping[str, Any], single: str, units: Mapping[str, Unit]
) -> dict[str, dict[str, Rule]]:
    shared = _rules(_table(data, "columns"), units)
    arms = _table(data, "arms")
    if not arms:
        return {single: shared}
    out: dict[str, dict[str, Rule]] = {}
    for arm in arms:
        entry = _table(arms, arm, ("columns",))
        out[arm] = {**shared, **_rules(_table(entry, "columns"), units)}
    return out


def _rules(table: Mapping[str, Any], units: Mapping[str, Unit]) -> dict[str, Rule]:
    plain = {t: entry for t, entry in table.items() if not t.endswith("*")}
    out: dict[str, Rule] = {}
    asked: dict[str, list[str]] = {}
    for target, entry in plain.items():
        unit = str(entry.get("unit", "")) if isinstance(entry, dict) else ""
        if unit and "scale" not in entry and scale_asked(stem_of(_target(target)), unit):
            asked.setdefault(f"{unit}: {scale_asked(stem_of(target), unit)}", []).append(target)
            continue
        out[target] = _rule(_target(target), entry, units)
    if asked:
        text = "; ".join(f"{', '.join(some)} in {what}" for what, some in asked.items())
        raise ConfigError(f"add scale = ... to these columns: {text}")
    return out


def _patterns(table: Mapping[str, Any]) -> dict[str, tuple[Mapping[str, Any], ...]]:
    """Rules for all joints, by stem."""
    out: dict[str, tuple[Mapping[str, Any], ...]] = {}
    for target in (t for t in table if t.endswith("*")):
        if target[:-1] not in _STEMS[1:]:
            known = [f"{stem}*" for stem in _STEMS[1:]]
            raise ConfigError(unknown("column of a recording", target, known))
        given = table[target] if isinstance(table[target], list) else [table[target]]
        entries = [{"from": x} if isinstance(x, str) else x for x in given]
        for entry in entries:
            if not isinstance(entry, dict) or str(entry.get("from", "")).count("*") != 1:
                raise ConfigError(
                    f"column {target!r}: expected names with one * for the number of the joint"
                )
            _keys(entry, _RULE, f"column {target!r}")
        out[target[:-1]] = tuple(entries)
    return out


def _extras(data: Mapping[str, Any]) -> dict[str, Any]:
    """Rules and units of the extra columns."""
    rules, units = {}, {}
    for name, entry in _table(data, "extras").items():
        if is_target(name):
            raise ConfigError(f"extra {name!r} is a column of a recording; name it in [columns]")
        plain = (
            {k: v for k, v in entry.items() if k != "unit"} if isinstance(entry, dict) else entry
        )
        rules[name] = _rule(name, plain, {})
        units[name] = str(entry.get("unit", "")) if isinstance(entry, dict) else ""
    return {"extras": rules, "units": units}


def _target(name: str) -> str:
    if not is_target(name):
        raise ConfigError(unknown("column of a recording", name, TARGETS))
    return name


def _rule(target: str, entry: Any, units: Mapping[str, Unit]) -> Rule:
    """Rule of a column; a unit of its own stands before that of its stem."""
    if isinstance(entry, int | float) and not isinstance(entry, bool):
        return Rule({}, float(entry))
    entry = {"from": entry} if isinstance(entry, str) else entry
    if not isinstance(entry, dict):
        raise ConfigError(f"column {target!r}: expected a name, a number or {{ from = ... }}")
    _keys(entry, _RULE, f"column {target!r}")
    if ("from" in entry) == ("sum" in entry):
        raise ConfigError(f"column {target!r}: exactly one of 'from' and 'sum' is needed")
    terms = _table(entry, "sum") if "sum" in entry else {str(entry["from"]): 1.0}
    sign = _number(entry.get("sign", 1.0), f"{target}.sign")
    if abs(sign) != 1:
        raise ConfigError(f"column {target!r}: sign is {sign:g}, expected 1 or -1")
    factor, zero = _to_si(target, entry, units)
    factor *= sign * _number(entry.get("scale", 1.0), f"{target}.scale")
    weights = {str(k): factor * _number(v, f"{target}.sum.{k}") for k, v in terms.items()}
    stated = "unit" in entry or "scale" in entry or stem_of(target) in units
    unwrap = entry.get("unwrap", True)
    if not isinstance(unwrap, bool) or (not unwrap and stem_of(target) != "q"):
        raise ConfigError(f"column {target!r}: unwrap is of positions, true or false")
    shift = zero + _number(entry.get("shift", 0.0), f"{target}.shift")
    named = str(entry.get("unit") or units.get(stem_of(target), Unit()).name)
    return Rule(weights, shift, stated, unwrap, axis_of(target, named))


def _to_si(target: str, entry: Mapping[str, Any], units: Mapping[str, Unit]) -> tuple[float, float]:
    """Factor and shift of the unit of a column; a scale of its own says that [units] is not."""
    if not is_target(target):
        if "unit" in entry:
            raise ConfigError(f"column {target!r}: a unit of this kind is said beside it")
        return 1.0, 0.0
    given = units.get(stem_of(target), Unit())
    if "unit" in entry:
        own = _unit(entry, f"column {target!r}")
        if "scale" in entry and scale_asked(stem_of(target), own.name):
            return 1.0, 0.0
        named = own.torque_constant or given.torque_constant
        return Unit(own.name, named).to_si(target)
    return (1.0, 0.0) if "scale" in entry else given.to_si(target)


def _offsets(
    data: Mapping[str, Any], arms: Mapping[str, Mapping[str, Rule]]
) -> dict[str, dict[str, float]]:
    out: dict[str, dict[str, float]] = {}
    table = _table(data, "offsets")
    for run in table:
        out[run] = {}
        for name, value in _flat(_table(table, run)).items():
            arm, _, column = name.rpartition(".")
            if arm and arm not in arms:
                raise ConfigError(f"[offsets.{run}]: " + unknown("arm", arm, arms))
            out[run][f"{arm}.{_target(column)}" if arm else _target(column)] = _number(value, name)
    return out


def _flat(table: Mapping[str, Any]) -> dict[str, Any]:
    """One level of nested tables as dotted names."""
    out: dict[str, Any] = {}
    for key, value in table.items():
        nested = value.items() if isinstance(value, dict) else None
        out |= {f"{key}.{k}": v for k, v in nested} if nested is not None else {key: value}
    return out


def _keys(table: Mapping[str, Any], known: tuple[str, ...], what: str) -> None:
    for key in table:
        if key not in known:
            raise ConfigError(unknown(f"key in {what}", key, known))


def _table(
    data: Mapping[str, Any], key: str, known: tuple[str, ...] | None = None
) -> dict[str, Any]:
    value = data.get(key, {})
    if not isinstance(value, dict):
        raise ConfigError(f"{key} must be a table, found {value!r}")
    if known is not None:
        _keys(value, known, f"[{key}]")
    return value


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"{what} is {value!r}; expected a number")
    return float(value)


def _names(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list | tuple) or not all(isinstance(v, str) for v in value):
        raise ConfigError(f"table.columns is {value!r}; expected a list of names")
    return tuple(value)
