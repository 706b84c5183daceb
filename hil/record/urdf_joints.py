"""Moving joints of a URDF in kinematic order, without a rigid-body library."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from hil.errors import DataError

_KINDS = {"revolute": "rad", "continuous": "rad", "prismatic": "m"}


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
        Position limits in `unit`; infinite where the URDF has none.
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
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise DataError(f"{where} does not parse as XML: {error}") from error
    if root.tag != "robot":
        raise DataError(f"{where}: the root element is <{root.tag}>, expected <robot>")
    children: dict[str, list[ET.Element]] = {}
    for joint in sorted(root.findall("joint"), key=lambda j: j.get("name", "")):
        children.setdefault(_link(joint, "parent", where), []).append(joint)
    inner = {_link(j, "child", where) for joints in children.values() for j in joints}
    out: list[UrdfJoint] = []
    for start in sorted(set(children) - inner):
        _walk(start, children, out, where)
    if not out:
        raise DataError(f"{where} has no moving joint (revolute, continuous or prismatic)")
    return tuple(out)


def _link(joint: ET.Element, tag: str, where: str) -> str:
    element = joint.find(tag)
    name = element.get("link", "") if element is not None else ""
    if not name:
        raise DataError(f"{where}: joint {joint.get('name')!r} has no <{tag} link=...>")
    return name


def _walk(
    link: str, children: dict[str, list[ET.Element]], out: list[UrdfJoint], where: str
) -> None:
    for joint in children.get(link, ()):
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
        _walk(_link(joint, "child", where), children, out, where)


def _range(joint: ET.Element, kind: str, where: str) -> tuple[float, float]:
    if kind == "continuous":
        return -math.inf, math.inf
    lower, upper = (_limit(joint, key, where) for key in ("lower", "upper"))
    return (lower, upper) if lower < upper else (-math.inf, math.inf)


def _most(joint: ET.Element, key: str, where: str) -> float:
    value = _limit(joint, key, where)
    return value if value > 0 else math.inf


def _limit(joint: ET.Element, key: str, where: str) -> float:
    """Attribute of a joint's limit, 0 where it has none."""
    limit = joint.find("limit")
    try:
        return float(limit.get(key, "0")) if limit is not None else 0.0
    except ValueError as error:
        raise DataError(f"{where}: joint {joint.get('name')!r}: limit: {error}") from error
