"""Moving joints of a URDF in kinematic order, without a rigid-body library.

Every robot file passes here first: the library behind the models trusts what stands in it, takes
any number for a mass, and memory with the cube of the joints.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from hil.errors import DataError, unknown

_KINDS = {"revolute": "rad", "continuous": "rad", "prismatic": "m"}
#: Largest URDF [characters], and what is more than any robot has: one with two arms, hands and
#: casters has a hundred moving joints, most of which are locked for an analysis.
LARGEST, MOST_ELEMENTS, MOST_LINKS, MOST_JOINTS = 4 * 2**20, 100_000, 1000, 300
#: Gravity where a description names none [m/s^2].
GRAVITY = (0.0, 0.0, -9.81)
#: Larger or smaller than any part of a machine, in SI units.
_ABSURD = 1e9
#: Attributes of numbers by element, and how many each holds.
_NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "limit": dict.fromkeys(("lower", "upper", "velocity", "effort"), 1),
    "mimic": {"multiplier": 1, "offset": 1},
    "dynamics": {"damping": 1, "friction": 1},
    "safety_controller": dict.fromkeys(
        ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), 1
    ),
    "calibration": {"rising": 1, "falling": 1},
}
#: They may be infinite, as exporters write where there is no limit.
_BOUNDS = ("limit", "safety_controller")


#: A number as XML writes it; Python's own reader takes digits of any script, and 1_000, too.
_NUMBER = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|inf(?:inity)?|nan)", re.IGNORECASE
)


def _number(text: str) -> float:
    if not _NUMBER.fullmatch(text.strip(" \t\r\n")):
        raise ValueError(f"{text[:80]!r} is no number")
    return float(text)


@dataclass(frozen=True)
class UrdfJoint:
    """A moving joint.

    Parameters
    ----------
    name : str
        Its name.
    unit : str
        ``"rad"`` or ``"m"``.
    lower, upper : float
        Position limits in `unit`; infinite where the URDF has none, or both 0, as exporters write
        where nobody filled them in.
    velocity, effort : float
        Largest speed [unit/s] and effort [N m or N]; infinite where the URDF has none, or none
        above 0, as exporters write where nobody filled them in.
    """

    name: str
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf


def urdf_joints(text: str, where: str = "the URDF") -> tuple[UrdfJoint, ...]:
    """Moving joints, depth first from the root, branches by joint name; mimic ones left out.

    Parameters
    ----------
    text : str
        URDF text.
    where : str
        What to call it in messages.

    Raises
    ------
    DataError
        If it is not a URDF, has no moving joint, or one of several degrees of freedom.
    """
    root = checked_urdf(text, where)
    children: dict[str, list[ET.Element]] = {}
    for joint in sorted(root.findall("joint"), key=lambda j: j.get("name", "")):
        children.setdefault(_link(joint, "parent", where), []).append(joint)
    inner = {_link(j, "child", where) for joints in children.values() for j in joints}
    out: list[UrdfJoint] = []
    # depth first by a list: a chain may be longer than calls nest
    waiting = [j for start in sorted(set(children) - inner) for j in children[start]][::-1]
    while waiting:
        joint = waiting.pop()
        kind, name = joint.get("type", ""), joint.get("name", "")
        if kind in _KINDS and joint.find("mimic") is None:
            ends = _range(joint, kind, where)
            most = [_most(joint, key, where) for key in ("velocity", "effort")]
            out.append(UrdfJoint(name, _KINDS[kind], *ends, *most))
        elif kind not in _KINDS and kind != "fixed":
            raise DataError(
                f"{where}: joint {name!r} is of type {kind!r}; "
                f"expected one of {', '.join(_KINDS)}, fixed"
            )
        waiting += children.get(_link(joint, "child", where), [])[::-1]
    if not out:
        raise DataError(f"{where} has no moving joint (revolute, continuous or prismatic)")
    return tuple(out)


def unlike(one: str, other: str) -> str:
    """First moving joint of both robots that sits elsewhere, or moves otherwise, in the other.

    Parameters
    ----------
    one, other : str
        Texts of URDFs; empty where there is none.

    Returns
    -------
    str
        Half a sentence; empty where the joints that both have agree.
    """
    if not one or not other or one == other:
        return ""
    mine, theirs = _places(one), _places(other)
    for name in mine.keys() & theirs.keys():
        for what, a in mine[name].items():
            b = theirs[name][what]
            if any(abs(x - y) > _SAME_PLACE for x, y in zip(a, b, strict=True)):
                texts = (" ".join(f"{x:.4g}" for x in v) for v in (a, b))
                return f"joint {name} has the {what} {' and not '.join(texts)}"
    return ""


#: Numbers of two descriptions [m, rad or 1] that differ by less are the same.
_SAME_PLACE = 1e-6


def _places(text: str) -> dict[str, dict[str, list[float]]]:
    """Origin and axis of each moving joint."""
    out = {}
    for joint in checked_urdf(text).findall("joint"):
        if joint.get("type") in _KINDS:
            parts = (
                ("origin", "xyz", "0 0 0"),
                ("origin", "rpy", "0 0 0"),
                ("axis", "xyz", "1 0 0"),
            )
            out[joint.get("name", "")] = {
                f"{tag} {key}": [_number(x) for x in _attribute(joint, tag, key, none).split()]
                for tag, key, none in parts
            }
    return out


def _attribute(joint: ET.Element, tag: str, key: str, none: str) -> str:
    element = joint.find(tag)
    return none if element is None else element.get(key, none)


def link_at(joint: ET.Element, end: str) -> str:
    """Name of the link at an end of a joint, ``"parent"`` or ``"child"``; empty if it has none."""
    return _attribute(joint, end, "link", "")


def frames_of(text: str, where: str = "the URDF") -> list[str]:
    """Names that a tip can have: the links and joints of a URDF.

    Raises
    ------
    DataError
        If it is no URDF.
    """
    root = checked_urdf(text, where)
    return [str(e.get("name")) for tag in ("link", "joint") for e in root.findall(tag)]


def gravity_of(root: ET.Element, where: str = "the URDF") -> tuple[float, float, float]:
    """Gravity in axes of the base [m/s^2]: down, unless the description says otherwise.

    URDF has no word for it.  ``<gravity>0 0 0</gravity>`` within ``<robot>`` is that of efforts
    which were recorded without gravity; ``0 0 9.81`` that of a robot under a ceiling.

    Raises
    ------
    DataError
        If it is not three numbers.
    """
    found = root.findall("gravity")
    if not found:
        return GRAVITY
    text = found[0].text or ""
    try:
        x, y, z = (_number(part) for part in text.split())
    except ValueError:
        x = y = z = math.nan
    if len(found) > 1 or not all(abs(v) < _ABSURD for v in (x, y, z)):
        raise DataError(
            f"{where}: <gravity>{text[:80]!r}</gravity>; expected one element with three numbers "
            "[m/s^2] in axes of the base, as 0 0 -9.81"
        )
    return x, y, z


def checked_urdf(text: str, where: str = "the URDF") -> ET.Element:
    """Root of a URDF in which no claim, loop or number does harm to what reads it next.

    Raises
    ------
    DataError
        If it is no URDF, is larger than any robot, has a loop, several bases, a joint between
        links that are not there, a number that no body has, or a joint whose axis or limits leave
        it no way to move.
    """
    if len(text) > LARGEST or "<!DOCTYPE" in text:
        raise DataError(
            f"{where} has {len(text)} characters or a document type; expected a URDF of at most "
            f"{LARGEST} characters without entities"
        )
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise DataError(f"{where} does not parse as XML: {error}") from error
    if root.tag != "robot":
        raise DataError(f"{where}: the root element is <{root.tag}>, expected <robot>")
    _refuse_sizes(root, where)
    for owner in (*root.findall("link"), *root.findall("joint")):
        for element in owner.iter():
            if element.tag not in ("visual", "collision"):
                _refuse_numbers(owner, element, where)
    _refuse_loops(root, where)
    _refuse_forests(root, where)
    _refuse_ranges(root, where)
    gravity_of(root, where)
    return root


def _refuse_sizes(root: ET.Element, where: str) -> None:
    joints = root.findall("joint")
    moving = sum(j.get("type") != "fixed" for j in joints)
    for what, count, most in (
        ("elements", sum(1 for _ in root.iter()), MOST_ELEMENTS),
        ("links", max(len(root.findall("link")), len(joints) + 1), MOST_LINKS),
        ("moving joints", moving, MOST_JOINTS),
    ):
        if count > most:
            raise DataError(f"{where} has {count} {what}; a robot of at most {most} can be used")
    for tag in ("link", "joint"):
        names = [e.get("name", "") for e in root.findall(tag)]
        for name in names:
            if not name or not name.isprintable() or len(name) > 256:
                raise DataError(f"{where}: a {tag} has the name {name[:80]!r}; expected a word")
        if len(set(names)) < len(names):
            twice = next(n for k, n in enumerate(names) if n in names[:k])
            raise DataError(f"{where}: {tag} {twice!r} is there twice")


def _refuse_numbers(owner: ET.Element, element: ET.Element, where: str) -> None:
    for key, count in _NUMBERS.get(element.tag, {}).items():
        text = element.get(key)
        if text is None:
            continue
        place = f"{owner.tag} {owner.get('name')!r}: <{element.tag} {key}={text[:80]!r}>"
        try:
            values = [_number(x) for x in text.split()]
        except ValueError:
            raise DataError(f"{where} does not parse: {place}; expected {count} numbers") from None
        if len(values) != count or any(math.isnan(x) for x in values):
            raise DataError(f"{where}: {place}; expected {count} numbers")
        if element.tag not in _BOUNDS and any(abs(x) > _ABSURD for x in values):
            raise DataError(f"{where}: {place}; no part of a machine has that in SI units")
        moves = owner.tag == "joint" and owner.get("type") != "fixed"
        if element.tag == "axis" and moves and not any(values):
            raise DataError(
                f"{where}: {place}; a joint moves about or along an axis, expected a direction "
                "as 0 0 1, or the type fixed if it does not move"
            )
        if key in ("value", "ixx", "iyy", "izz") and values[0] < 0:
            raise DataError(f"{where}: {place}; a mass or moment of inertia is not negative")


def _refuse_loops(root: ET.Element, where: str) -> None:
    """Refuse links with two parents, and loops, which a tree of links has not."""
    parents: dict[str, str] = {}
    for joint in root.findall("joint"):
        child = _link(joint, "child", where)
        if child in parents:
            raise DataError(f"{where}: link {child!r} has two parents; expected a tree of links")
        parents[child] = _link(joint, "parent", where)
    known: set[str] = set()  # on a path to a root
    for start in parents:
        path, link = [], start
        while link in parents and link not in known:
            path.append(link)
            link = parents[link]
            if len(path) > len(parents):
                raise DataError(f"{where}: the joints from {start!r} up form a loop")
        known.update(path)


def _refuse_forests(root: ET.Element, where: str) -> None:
    """Refuse joints between links that are not there, and several trees."""
    links = [str(e.get("name")) for e in root.findall("link")]
    held = set()
    for joint in root.findall("joint"):
        for tag in ("parent", "child"):
            if (name := _link(joint, tag, where)) not in links:
                raise DataError(
                    f"{where}: joint {joint.get('name')!r} names the {tag} {name[:80]!r}: "
                    + unknown("link", name, links)
                )
        held.add(_link(joint, "child", where))
    tops = [name for name in links if name not in held]
    if len(tops) > 1:
        raise DataError(
            f"{where} has {len(tops)} links that no joint holds ({_listed(tops)}); expected one, "
            "the base: take out what does not belong to the robot, or hold it with a fixed joint"
        )


def _listed(names: list[str]) -> str:
    """The first few names."""
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")


def _refuse_ranges(root: ET.Element, where: str) -> None:
    """Refuse moving joints whose limits leave no way; both 0 is a range that nobody stated."""
    for joint in root.findall("joint"):
        if joint.get("type") not in ("revolute", "prismatic") or joint.find("mimic") is not None:
            continue
        lower, upper = (_limit(joint, key, where) for key in ("lower", "upper"))
        if lower < upper or lower == upper == 0:
            continue
        raise DataError(
            f"{where}: joint {joint.get('name')!r}: its limits, lower = {lower:g} and upper = "
            f"{upper:g}, leave it no range; expected lower below upper (one that is not stated "
            "counts as 0, both 0 as no limits). Give its range, or the type fixed if it does not "
            "move"
        )


def _link(joint: ET.Element, tag: str, where: str) -> str:
    element = joint.find(tag)
    name = element.get("link", "") if element is not None else ""
    if not name:
        raise DataError(f"{where}: joint {joint.get('name')!r} has no <{tag} link=...>")
    return name


def _range(joint: ET.Element, kind: str, where: str) -> tuple[float, float]:
    if kind == "continuous":
        return -math.inf, math.inf
    lower, upper = (_limit(joint, key, where) for key in ("lower", "upper"))
    return (lower, upper) if lower < upper else (-math.inf, math.inf)  # both 0


def _most(joint: ET.Element, key: str, where: str) -> float:
    value = _limit(joint, key, where)
    return value if value > 0 else math.inf


def _limit(joint: ET.Element, key: str, where: str) -> float:
    """Attribute of a joint's limit, 0 where it has none."""
    limit = joint.find("limit")
    try:
        return _number(limit.get(key, "0")) if limit is not None else 0.0
    except ValueError as error:
        raise DataError(f"{where}: joint {joint.get('name')!r}: limit: {error}") from error
