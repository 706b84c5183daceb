"""Columns of a recording, and whether a table has all that belong together."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from hil.errors import DataError, plural
from hil.record.tablefile import Table
from hil.record.tablemap import Rule
from hil.record.urdf_joints import UrdfJoint

WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
#: Stem of a column -> field of a recording.
GROUPS = {"q": "q", "tau": "tau", "qd": "qd", "tauext": "tau_ext", "i": "current",
           "temp": "temperature"}  # fmt: skip


def count_joints(
    rules: Mapping[str, Rule], table: Table, joints: tuple[UrdfJoint, ...], timed: bool
) -> int:
    """Number of joints, after checking that every group of columns is complete.

    Parameters
    ----------
    rules : mapping
        By target column.
    table : Table
        For messages.
    joints : tuple of UrdfJoint
        Of the robot; empty without a URDF.
    timed : bool
        Whether the time follows from a rate.

    Raises
    ------
    DataError
        If a column is missing or one too many, or the URDF is of another robot.
    """
    groups = _grouped(rules)
    d = max(groups.get("q", [0]))
    if "t" not in rules and not timed:
        raise _no_column(table, ["t"], "the time [s]; or rate_hz = ... in [table] of a map")
    for stem in GROUPS:
        if stem in groups or stem in ("q", "tau"):
            _whole(table, stem, groups.get(stem, []), d)
    _whole_wrench(table, rules)
    if joints and len(joints) != d:
        names = ", ".join(j.name for j in joints)
        raise DataError(
            f"the URDF does not match table {table.path}: {plural(len(joints), 'moving joint')} "
            f"({names}), but {plural(d, 'position column')}"
        )
    return d


def _grouped(rules: Mapping[str, Rule]) -> dict[str, list[int]]:
    """Stem -> numbers of the columns that have one."""
    groups: dict[str, list[int]] = {}
    for name in rules:
        match = re.fullmatch(r"([a-z]+)([0-9]+)", name)
        if match:
            groups.setdefault(match[1], []).append(int(match[2]))
    return groups


def _whole(table: Table, stem: str, numbers: Sequence[int], d: int) -> None:
    """Refuse a group that has not one column for each of `d` joints."""
    count = plural(d, "joint")
    missing = [f"{stem}{k}" for k in range(1, max(d, 1) + 1) if k not in numbers]
    if missing:
        raise _no_column(table, missing, f"it has {count} (q columns)" if d else "")
    if max(numbers) > d:
        raise DataError(f"table {table.path}: column {stem}{max(numbers)}, but only {count}")


def _whole_wrench(table: Table, rules: Mapping[str, Rule]) -> None:
    """Refuse a force or a wrench of which a component is missing."""
    force = [n for n in WRENCH if n in rules]
    need = WRENCH if any(n in force for n in WRENCH[3:]) else WRENCH[:3]
    if force and not set(need) <= set(force):
        raise _no_column(table, [n for n in need if n not in force], f"it has {', '.join(force)}")


def _no_column(table: Table, names: Sequence[str], why: str) -> DataError:
    reason = f" ({why})" if why else ""
    return DataError(
        f"table {table.path} has no column {', '.join(repr(n) for n in names)}{reason}. It has: "
        f'{", ".join(table.names[:40])}. Rename in a map file: [columns] {names[0]} = "..."'
    )
