"""Which joints a recording holds: all columns of each, and a URDF with the others locked in place.

A position and an effort of each joint, and what else there is of any, are all there or the table is
refused; the refusal proposes names.

A stock URDF has more joints than a recording of its arm: grippers, fingers, wheels, a lift.  Here
they become fixed joints at a position; everything behind this file sees a robot that has the
joints of the recording and no others, and the bodies of the rest where they are.
"""

from __future__ import annotations

import itertools
import json
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError, families, plural, unknown
from hil.record.recording import GROUPS, LOCKED, WRENCH, RobotSource
from hil.record.urdf_checks import UrdfJoint, checked_urdf, link_at, urdf_joints

if TYPE_CHECKING:
    from hil.record.mapfile import Rule
    from hil.record.table_files import ForeignTable

FloatArray = NDArray[np.float64]
#: What a fixed joint has not.
_MOVING_TAGS = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")
_FREE = ("floating", "planar")
_MOVING = ("revolute", "continuous", "prismatic")


def free_joints(urdf: str, where: str = "the URDF") -> tuple[UrdfJoint, ...]:
    """Moving joints of a URDF as `urdf_joints`, without those of a mobile base that floats.

    Raises
    ------
    DataError
        If it is no URDF, or has no moving joint.
    """
    grounded = _grounded(checked_urdf(urdf, where))
    if all(j.get("type") not in _MOVING for j in grounded.findall("joint")):
        return urdf_joints(urdf, where)  # which says why there is none
    return urdf_joints(_text(grounded), where)


def arm_joints(urdf: str, d: int) -> tuple[str, ...]:
    """The first `d` moving joints, where every other one hangs beyond the last of them.

    That is an arm with its gripper; where the others are elsewhere, or none are, nobody but the
    user can say which joints are meant, and the answer is empty.

    Parameters
    ----------
    urdf : str
        URDF text.
    d : int
        How many.

    Raises
    ------
    DataError
        If it is no URDF, or has no moving joint.
    """
    root = _grounded(checked_urdf(urdf, "the URDF"))
    names = [j.name for j in urdf_joints(_text(root), "the URDF")]
    if not 0 < d < len(names):
        return ()
    above = {link_at(j, "child"): j for j in root.findall("joint")}
    elements = {j.get("name", ""): j for j in root.findall("joint")}

    def before(name: str) -> list[str]:
        """Joints between the root and one."""
        out: list[str] = []
        link = link_at(elements[name], "parent")
        while link in above:
            out.append(above[link].get("name", ""))
            link = link_at(above[link], "parent")
        return out

    chain = all(names[k] in before(names[k + 1]) for k in range(d - 1))
    beyond = all(names[d - 1] in before(n) for n in names[d:])
    return tuple(names[:d]) if chain and beyond else ()


def locked_urdf(
    urdf: str, keep: Sequence[str], at: Mapping[str, float], where: str = "the URDF"
) -> tuple[str, dict[str, float]]:
    """URDF in which all joints but some are fixed, and the position of each that was locked.

    Parameters
    ----------
    urdf : str
        URDF text.
    keep : sequence of str
        Joints that stay free.  Joints that mimic one of them follow it as before.
    at : mapping of str to float
        Positions [rad or m] of others; one that is not named stands at 0, or at the limit next to
        it where 0 is out of reach.
    where : str
        What to call the URDF in messages.

    Raises
    ------
    DataError
        If it is no URDF, or has no moving joint.
    ConfigError
        If a joint to keep or lock is none of its moving joints.
    """
    root = _grounded(checked_urdf(urdf, where))
    joints = {j.name: j for j in urdf_joints(_text(root), where)}
    for name in (*keep, *at):
        if name not in joints:
            raise ConfigError(f"{where}: " + unknown("moving joint", name, joints))
    if both := [name for name in keep if name in at]:
        raise ConfigError(f"joint {both[0]!r} is to be kept and locked; choose one")
    elements = {j.get("name", ""): j for j in root.findall("joint")}
    locked = {
        name: at.get(name, min(max(0.0, joint.lower), joint.upper))
        for name, joint in joints.items()
        if name not in keep
    }
    followers = _followers(elements, locked, where)
    if not locked and not any(j.get("type") in _FREE for j in ET.fromstring(urdf).findall("joint")):
        return urdf, {}
    for name, value in {**locked, **followers}.items():
        _fix(elements[name], value)
    return _text(root), locked


#: Share of its range by which a joint may be said to stand beyond it: robots are built otherwise
#: than described; degrees for radians, or another joint, are farther off.
BEYOND = 0.1


def refuse_beyond(joints: Sequence[UrdfJoint], lock: Mapping[str, float]) -> None:
    """Refuse positions that somebody gives for locked joints far outside of their ranges.

    Parameters
    ----------
    joints : sequence of UrdfJoint
        Joints of the robot.
    lock : mapping of str to float
        Given positions [rad or m].

    Raises
    ------
    ConfigError
        With the first such joint and its range.
    """
    for j in joints:
        at = lock.get(j.name, 0.0 if math.isinf(j.lower) else j.lower)
        slack = BEYOND * (j.upper - j.lower)
        if not j.lower - slack <= at <= j.upper + slack:
            raise ConfigError(
                f"joint {j.name!r} is to be locked at {at:.4g} {j.unit}, its range in the URDF is "
                f"{j.lower:.4g} to {j.upper:.4g} {j.unit}; give a position [rad or m] within it"
            )


@dataclass(frozen=True)
class ColumnsRobot:
    """A robot that has the joints of some columns and no others.

    Parameters
    ----------
    robot : RobotSource
        The robot, the other joints of its URDF locked.
    joints : tuple of UrdfJoint
        Joints in the order of the robot; none without a URDF.
    order : tuple of int
        Which column each joint is.
    said : mapping of str to str
        Metadata of the recording: where joints are locked.
    notes : tuple of str
        The same as sentences.
    """

    robot: RobotSource
    joints: tuple[UrdfJoint, ...] = ()
    order: tuple[int, ...] = ()
    said: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def columns_robot(
    robot: RobotSource, joints: Sequence[str], lock: Mapping[str, float], d: int
) -> ColumnsRobot:
    """Lock the joints that no column is of: those not named, or a gripper beyond the arm.

    Parameters
    ----------
    robot : RobotSource
        The robot.
    joints : sequence of str
        Joints of the columns, in their order; empty where nobody named them.
    lock : mapping of str to float
        Where joints are locked [rad or m].
    d : int
        Columns.

    Raises
    ------
    ConfigError
        If a joint is none of the URDF, or named twice, or there is no URDF.
    """
    if not robot.urdf:
        if joints or lock:
            raise ConfigError("joints and lock are of a URDF; give it with --robot")
        return ColumnsRobot(robot)
    known, names = free_joints(robot.urdf), tuple(joints)
    refuse_beyond(known, lock)
    if not names:
        rest = tuple(j.name for j in known if j.name not in lock)
        names = arm_joints(locked_urdf(robot.urdf, rest, lock)[0], d) if rest else ()
        names = names or rest
    if len(set(names)) < len(names):
        raise ConfigError(f"joints = {', '.join(names)} names a joint twice")
    text, locked = locked_urdf(robot.urdf, names, lock)
    left = tuple(j for j in known if j.name in names)
    order = tuple(names.index(j.name) for j in left)
    if not locked:
        return ColumnsRobot(replace(robot, urdf=text), left, order)
    note = f"locked: {', '.join(f'{n} at {v:.4g}' for n, v in locked.items())}"
    if not joints:
        note = f"the columns are taken as those of {', '.join(names)}; {note} (--joints and --lock)"
    said = {LOCKED: json.dumps(locked)}
    return ColumnsRobot(replace(robot, urdf=text), left, order, said, (note,))


def _grounded(root: ET.Element) -> ET.Element:
    """The robot with a floating or planar base, as of mobile robots, standing at its origin."""
    for joint in root.findall("joint"):
        if joint.get("type") in _FREE:
            _strip(joint)
    return root


def _followers(
    elements: Mapping[str, ET.Element], locked: Mapping[str, float], where: str
) -> dict[str, float]:
    """Positions of the joints that mimic locked ones, also over several steps."""
    out: dict[str, float] = {}
    mimics = {n: m for n, e in elements.items() if (m := e.find("mimic")) is not None}
    for name in mimics:
        factor, offset, leader = 1.0, 0.0, name
        for _ in mimics:
            if leader not in mimics:
                break
            mimic = mimics[leader]
            offset += factor * float(mimic.get("offset", "0"))
            factor *= float(mimic.get("multiplier", "1"))
            leader = mimic.get("joint", "")
        if leader not in elements or leader in mimics:
            raise DataError(f"{where}: joint {name!r} mimics {leader!r}, which is no joint of it")
        if leader in locked:
            out[name] = factor * locked[leader] + offset
    return out


def _fix(joint: ET.Element, value: float) -> None:
    """Make a joint a fixed one, at a position."""
    origin = joint.find("origin")
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    place, turn = _three(origin, "xyz"), _rotation(_three(origin, "rpy"))
    if joint.get("type") == "prismatic":
        place = place + turn @ (value * _axis(joint))
    else:
        turn = turn @ _about(_axis(joint), value)
    origin.set("xyz", " ".join(f"{x:.17g}" for x in place))
    origin.set("rpy", " ".join(f"{x:.17g}" for x in _angles(turn)))
    _strip(joint)


def _strip(joint: ET.Element) -> None:
    joint.set("type", "fixed")
    for tag in _MOVING_TAGS:
        for element in joint.findall(tag):
            joint.remove(element)


def _text(root: ET.Element) -> str:
    return ET.tostring(root, encoding="unicode")


def _three(element: ET.Element, key: str) -> FloatArray:
    return np.array([float(x) for x in element.get(key, "0 0 0").split()])


def _axis(joint: ET.Element) -> FloatArray:
    """Unit axis of a joint; that of a URDF without one is x."""
    element = joint.find("axis")
    axis = np.array([1.0, 0, 0]) if element is None else _three(element, "xyz")
    out: FloatArray = axis / (float(np.linalg.norm(axis)) or 1.0)
    return out


def _about(axis: FloatArray, angle: float | FloatArray) -> FloatArray:
    """Rotations about a unit axis (Rodrigues), (..., 3, 3) for angles (...)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.asarray(angle)[..., None, None]
    out: FloatArray = np.eye(3) + np.sin(turn) * cross + (1 - np.cos(turn)) * (cross @ cross)
    return out


def _rotation(rpy: FloatArray) -> FloatArray:
    """Rotation of fixed-axis roll, pitch and yaw, as a URDF means them."""
    x, y, z = np.eye(3)
    return _about(z, rpy[2]) @ _about(y, rpy[1]) @ _about(x, rpy[0])


def _angles(turn: FloatArray) -> FloatArray:
    """Roll, pitch and yaw of a rotation; at a pitch of 90 degrees the roll is 0."""
    level = math.hypot(turn[0, 0], turn[1, 0])
    pitch = math.atan2(-turn[2, 0], level)
    if level < 1e-9:
        return np.array([0.0, pitch, math.atan2(-turn[0, 1], turn[1, 1])])
    return np.array([math.atan2(turn[2, 1], turn[2, 2]), pitch, math.atan2(turn[1, 0], turn[0, 0])])


def frame_axes(
    urdf: str, frame: str, names: Sequence[str], q: FloatArray, where: str = "the URDF"
) -> FloatArray | None:
    """Axes of a link as columns in axes of the base, (n, 3, 3); None if there is no such link.

    Parameters
    ----------
    urdf : str
        URDF text.
    frame : str
        Name of the link.
    names : sequence of str
        Joints of the columns of `q`; the others stand at 0.
    q : ndarray (n, d)
        Positions [rad or m].
    where : str
        What to call the URDF in messages.

    Raises
    ------
    DataError
        If it is no URDF.
    """
    root = checked_urdf(urdf, where)
    if frame not in {link.get("name") for link in root.findall("link")}:
        return None
    above = {link_at(j, "child"): j for j in root.findall("joint")}
    out = np.tile(np.eye(3), (len(q), 1, 1))
    while frame in above:
        joint = above[frame]
        turn = _turned(joint, names, q)
        origin = joint.find("origin")
        fixed = np.eye(3) if origin is None else _rotation(_three(origin, "rpy"))
        out = fixed @ turn @ out
        frame = link_at(joint, "parent")
    return out


def in_base_axes(wrench: FloatArray, axes: FloatArray) -> FloatArray:
    """A wrench (n, 6) of a link's axes (n, 3, 3), in axes of the base."""
    turned = [np.einsum("nij,nj->ni", axes, wrench[:, k : k + 3]) for k in (0, 3)]
    return np.concatenate(turned, axis=1)


def _turned(joint: ET.Element, names: Sequence[str], q: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) of a joint about its axis."""
    name = joint.get("name", "")
    if joint.get("type") not in ("revolute", "continuous") or name not in names:
        return np.eye(3)
    return _about(_axis(joint), q[:, list(names).index(name)])


# ------------------------------------------------------------ the columns of the joints


def count_joints(
    rules: Mapping[str, Rule], table: ForeignTable, joints: tuple[UrdfJoint, ...], timed: bool
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
    groups = grouped(rules)
    d = max(groups.get("q", [0]))
    if "t" not in rules and not timed:
        rate = "" if table.in_memory else "--rate HZ, or "
        raise _no_column(table, ["t"], f"the time [s]; or {rate}rate_hz = ... in [table] of a map")
    for stem in GROUPS:
        if stem in groups or stem in ("q", "tau"):
            _whole(table, stem, groups.get(stem, []), d)
    _whole_wrench(table, rules)
    if joints and len(joints) != d:
        names = ", ".join(j.name for j in joints)
        how = 'joints=["a", "b"]' if table.in_memory else "--joints A,B,.."
        what = (
            f"the URDF does not match table {table.path}: {plural(len(joints), 'moving joint')} "
            f"({names}), but {plural(d, 'position column')}"
        )
        raise DataError(
            f"{what}; name the joints of the columns with {how} (or joints = [..] in a map), and "
            "the others are locked"
        ).about("joints", what)
    return d


def grouped(rules: Mapping[str, Rule]) -> dict[str, list[int]]:
    """Stem -> numbers of the columns that have one."""
    groups: dict[str, list[int]] = {}
    for name in rules:
        match = re.fullmatch(r"([a-z]+)([0-9]+)", name)
        if match:
            groups.setdefault(match[1], []).append(int(match[2]))
    return groups


def _whole(table: ForeignTable, stem: str, numbers: Sequence[int], d: int) -> None:
    """Refuse a group that has not one column for each of `d` joints."""
    count = plural(d, "joint")
    missing = [f"{stem}{k}" for k in range(1, max(d, 1) + 1) if k not in numbers]
    if missing:
        why = f"it has {count} (q columns)" if d else ""
        if not numbers and stem == "tau":
            why += ", and without the motors' efforts no model can be fitted"
        if numbers and stem == "tau":
            why += f"; for a joint without a motor, write {missing[0]} = 0.0 in a map"
        raise _no_column(table, missing, why)
    if max(numbers) > d:
        lacking = [f"q{k}" for k in numbers if k > d]
        raise _no_column(table, lacking, f"it has {stem}{max(numbers)}, and positions of {count}")


def _whole_wrench(table: ForeignTable, rules: Mapping[str, Rule]) -> None:
    """Refuse a force or a wrench of which a component is missing."""
    force = [n for n in WRENCH if n in rules]
    need = WRENCH if any(n in force for n in WRENCH[3:]) else WRENCH[:3]
    if force and not set(need) <= set(force):
        raise _no_column(table, [n for n in need if n not in force], f"it has {', '.join(force)}")


def _no_column(table: ForeignTable, names: Sequence[str], why: str) -> DataError:
    # of tables alone, and only where one is refused
    from hil.record.guess import propose
    from hil.record.mapfile import known_log, patterns

    reason = f" ({why})" if why else ""
    found, log = propose(table.names), known_log(table.names)
    wanted = ", ".join(map(repr, families(names)))
    it_has = ", ".join(families(table.names)[:40])
    lacks = f"table {table.path} has no column {wanted}{reason}. It has: {it_has}. "
    if log:
        given = f'map="{log}"' if table.in_memory else f"--map {log}"
        return DataError(f"{lacks}These are the columns of a {log} log: read it with {given}")
    if table.in_memory:
        said = patterns(found.columns) if found is not None else {}
        said = {k: v for k, v in said.items() if k != v}
        known = found is not None and names[0] in found.columns
        said |= {} if known else {names[0]: "..."}
        return DataError(
            f"{lacks}Rename with map={{'columns': {said}}}, which may say units, too "
            "(docs/import.md)"
        )
    file = table.path.name if table.path.is_file() else "TABLE"  # an episode is no file of its own
    propose_it = f"'hil import {file} --propose-map MAP.toml' writes"
    offer = f'Rename in a map file (docs/import.md): [columns] {names[0]} = "..."'
    if found is not None and names[0] in found.columns:
        offer = f"{propose_it} a map from these names"
    elif found is not None:
        offer += f"; {propose_it} one to complete"
    what = f"no column of table {table.path} is {wanted}"
    return DataError(f"{lacks}{offer}").about("time" if names[0] == "t" else "column", what)


# ------------------------------------------------------------ joints that are called otherwise


def called_in(known: Sequence[str], names: Sequence[str], given: Sequence[str]) -> dict[str, str]:
    """Joints of a robot by the names that a recording has for them; empty where these are known.

    Names that differ in one prefix and one suffix alone are matched where only one of each fits
    best, half of them or more; others by their order where the user gives it.

    Parameters
    ----------
    known : sequence of str
        Joints of the URDF that may move.
    names : sequence of str
        Those of the recording.
    given : sequence of str
        Joints of the URDF as the user names them, in the order of the recording.
    """
    if not known or set(known) & set(names) or len(names) < 2:
        return {}
    if len(given) == len(names) and set(given) <= set(known):
        return dict(zip(names, given, strict=True))
    middles = _middles(names)
    frames = {
        (n[:at], n[at + len(m) :])
        for n in known
        for m in middles.values()
        for at in range(len(n))
        if m and n.startswith(m, at)
    }
    found = [
        {name: before + m + after for name, m in middles.items() if before + m + after in known}
        for before, after in sorted(frames)
    ]
    most = max(map(len, found), default=0)
    best = [x for x in found if len(x) == most]
    return best[0] if len(best) == 1 and most >= max(2, len(names) / 2) else {}


def _middles(names: Sequence[str]) -> dict[str, str]:
    """Names without the prefix and the suffix that all share; digits belong to none."""
    before = _shared(names).rstrip("0123456789")
    after = _shared([n[::-1] for n in names])[::-1].lstrip("0123456789")
    return {n: n[len(before) : len(n) - len(after)] for n in names}


def _shared(names: Sequence[str]) -> str:
    """What all names begin with."""
    same = itertools.takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))
    return "".join(letters[0] for letters in same)
