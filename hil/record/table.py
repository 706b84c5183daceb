"""From a table of any rig to recordings."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError, unknown
from hil.record.mapfile import is_target
from hil.record.recording import Recording, RobotSource
from hil.record.schema import Channel
from hil.record.tablecheck import clean_time, from_zero, refuse_not_finite, refuse_units
from hil.record.tablecolumns import GROUPS, WRENCH, count_joints
from hil.record.tablefile import Table, open_table
from hil.record.tablemap import SIGNAL, Rule, TableMap
from hil.record.urdf_joints import UrdfJoint, urdf_joints

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


def import_table(
    path: str | Path,
    mapping: TableMap | None = None,
    *,
    urdf: str | Path = "",
    tip: str = "",
    arm: str = "",
    run: str = "",
    unit: str = "",
) -> Imported:
    """Read a table through a map; everything is validated, nothing is written.

    Parameters
    ----------
    path : str or Path
        CSV, NPZ or MAT file.
    mapping : TableMap, optional
        The map; without one the default column names.
    urdf, tip, unit : str
        Robot file, frame of the force and unit of the axes; each overrules the map.
    arm : str
        Name of the only arm, or which of several arms to keep.
    run : str
        Which run of the file.

    Raises
    ------
    DataError
        If a column is missing or not a number, the time is not increasing, the units are
        certainly wrong, or the URDF does not fit.
    ConfigError
        If the map names something that is not there.
    """
    given = mapping or TableMap()
    given = replace(given, tip=tip or given.tip, unit=unit or given.unit)
    table = open_table(path, given.array, given.columns, run)
    tables = {"": table, **_joined(table, given)}
    arms = _select(given, arm)
    robot, joints = _robot(given, Path(path), urdf)
    recordings: list[Recording] = []
    used: set[str] = set()
    extra: dict[str, FloatArray] = {}
    for name, rules in arms.items():
        filled = _with_defaults(rules, table)
        recording, sources, extra = _arm(name or "arm", filled, tables, given, robot, joints)
        recordings.append(recording)
        used |= sources
    recordings = from_zero(table, recordings)
    unused = tuple(n for prefix, t in tables.items() for n in _prefixed(prefix, t) if n not in used)
    return Imported(tuple(recordings), unused, _extras(given, recordings, extra))


def _extras(
    given: TableMap, recordings: Sequence[Recording], values: Mapping[str, FloatArray]
) -> tuple[tuple[Channel, FloatArray, FloatArray], ...]:
    if not values:
        return ()
    units = tuple(given.units[n] for n in values)
    channel = Channel("/extras", "fields", tuple(values), units=units, message=EXTRAS)
    return ((channel, recordings[-1].t, np.stack(list(values.values()), axis=1)),)


def _select(given: TableMap, arm: str) -> dict[str, Mapping[str, Rule]]:
    if len(given.arms) == 1:
        only = next(iter(given.arms))
        return {arm or only: given.arms[only]}
    if arm and arm not in given.arms:
        raise ConfigError("the map has no " + unknown("arm", arm, given.arms))
    return {n: r for n, r in given.arms.items() if arm in ("", n)}


def _joined(table: Table, given: TableMap) -> dict[str, Table]:
    return {prefix: open_table(table.path.parent / name) for prefix, name in given.join.items()}


def _prefixed(prefix: str, table: Table) -> tuple[str, ...]:
    return tuple(f"{prefix}.{n}" if prefix else n for n in table.names)


def _with_defaults(rules: Mapping[str, Rule], table: Table) -> dict[str, Rule]:
    """Rules of the map, and columns that bear a default name and that no rule uses."""
    taken = {source for rule in rules.values() for source in rule.terms}
    default = {
        n: Rule({n: 1.0}) for n in table.names if is_target(n) and n not in taken | set(rules)
    }
    return {**rules, **default}


def _robot(
    given: TableMap, table: Path, urdf: str | Path
) -> tuple[RobotSource, tuple[UrdfJoint, ...]]:
    name = str(urdf or given.urdf)
    if not name:
        return RobotSource(given.preset, "", given.tip), ()
    folders = [Path()] if urdf else [f for f in (given.folder, table.parent) if f is not None]
    file = next((f / name for f in folders if (f / name).is_file()), folders[0] / name)
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise DataError(f"URDF {file}: no such file; give its path with --robot") from error
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text"
        raise DataError(f"URDF {file} cannot be read: {why}") from error
    joints = urdf_joints(text, f"URDF {file}")
    links = set(re.findall(r"<(?:link|joint)\s[^>]*?name\s*=\s*[\"']([^\"']+)", text))
    if given.tip and given.tip not in links:
        raise DataError(f"URDF {file}: " + unknown("frame", given.tip, links))
    return RobotSource("", text, given.tip), joints


def _arm(
    arm: str,
    rules: Mapping[str, Rule],
    tables: Mapping[str, Table],
    given: TableMap,
    robot: RobotSource,
    joints: tuple[UrdfJoint, ...],
) -> tuple[Recording, set[str], dict[str, FloatArray]]:
    """Recording of an arm, the columns that it took, and the extra ones."""
    table = tables[""]
    d = count_joints(rules, table, joints, given.rate_hz > 0)
    rules = {**rules, **given.extras}
    columns = _sources(rules, tables)
    n = next(iter(columns.values())).size
    values = {target: rule.apply(columns, n) for target, rule in rules.items()}
    for name, offset in given.offsets.get(table.run, {}).items():
        owner, _, target = name.rpartition(".")
        if owner in ("", arm):
            if target not in values:
                raise ConfigError(f"[offsets.{table.run}]: " + unknown("column", target, values))
            values[target] += offset
    if given.rate_hz:
        values.setdefault("t", np.arange(n) / given.rate_hz)
    refuse_not_finite(table, rules, values)
    keep = clean_time(table, values["t"], given.gaps, given.repeated)
    values = {k: v[keep] for k, v in values.items()}
    said = {SIGNAL + k: repr(v) for k, v in given.signal.items()}
    recording = _recording(arm, table, values, d, robot, joints, given.unit, said)
    if not given.unit:
        refuse_units(table, recording, joints)
    return recording, set(columns), {n: values[n] for n in given.extras}


def _sources(rules: Mapping[str, Rule], tables: Mapping[str, Table]) -> dict[str, FloatArray]:
    """Values of every column that a rule uses, all of one length."""
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
    sizes = {name: values.size for name, values in out.items()}
    if len(set(sizes.values())) > 1:
        text = ", ".join(f"{n} {s}" for n, s in sizes.items())
        raise DataError(f"table {tables[''].path}: columns of different lengths: {text}")
    if not out or not min(sizes.values()):
        raise DataError(f"table {tables[''].path} holds no samples")
    return out


def _recording(
    arm: str,
    table: Table,
    values: Mapping[str, FloatArray],
    d: int,
    robot: RobotSource,
    joints: tuple[UrdfJoint, ...],
    unit: str,
    said: Mapping[str, str],
) -> Recording:
    stacked = {
        key: np.stack([values[f"{stem}{k + 1}"] for k in range(d)], axis=1)
        for stem, key in GROUPS.items()
        if f"{stem}1" in values
    }
    wrench = None
    if "fx" in values:
        zero = np.zeros(values["t"].size)
        wrench = np.stack([values.get(name, zero) for name in WRENCH], axis=1)
    metres = joints and all(j.unit == "m" for j in joints)
    names = tuple(j.name for j in joints) or tuple(f"joint{k + 1}" for k in range(d))
    return Recording(
        name=table.run, arm=arm, joints=names, t=values["t"], q=stacked["q"],
        tau=stacked["tau"], qd=stacked.get("qd"), wrench=wrench,
        tau_ext=stacked.get("tau_ext"), current=stacked.get("current"),
        temperature=stacked.get("temperature"), robot=robot,
        metadata={"unit": unit or ("m" if metres else "rad"), **said},
    )  # fmt: skip
