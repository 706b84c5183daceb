"""A map proposed from the names of a table's columns, for a person to check.

A name is cut into words: ``pos_shoulder_deg`` says what is measured (pos), of which joint
(shoulder) and in which unit (deg).  Columns that differ in the joint alone are a family.  For
each quantity one family is proposed: a measured one before a commanded one, the complete one before
another.  Nothing is taken that a name does not say, and nothing is read from the values.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hil.record.mapfile import SCHEMA, is_target
from hil.record.units import FACTORS, time_unit

#: Words of a quantity, by stem of its column.
_WORDS = {
    "q": "q pos posn position positions angle angles theta th jointangle jointpos qpos",
    "qd": "qd dq qdot qvel vel velo veloc velocity velocities speed speeds omega thetadot dtheta",
    "tau": "tau torque torques trq effort efforts moment moments u",
    "i": "i current currents cur curr amp amps ampere amperes",
    "temp": "temp temps temperature temperatures",
}
#: Words of what is no column of a recording, or an estimate from somebody's model.
_OTHER = (
    "acc accel acceleration accelerations qdd ddq qddot jerk voltage volt pwm error err status "
    "hat est estimate estimated"
)
#: Words of external efforts.
_EXTERNAL = "ext external contact env"
#: Words of what was asked for, not measured.
_COMMAND = "target desired des cmd command commanded commands ref reference setpoint goal d"
#: Words that say nothing here.
_EMPTY = (
    "joint joints j axis ax motor mot link actual act measured meas msr state states robot arm "
    "observation data the of in filtered filt raw value val sensor input present feedback"
)
#: Units, as names write them.
_UNITS = {
    **{u.lower(): u for u in ("rad", "mrad", "deg", "rev", "m", "cm", "mm", "um", "rpm")},
    **{u.lower(): u for u in ("Nm", "mNm", "Nmm", "Ncm", "kNm", "N", "mN", "kN", "A", "mA")},
    **{"degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "dps": "deg/s"},
    **{"milliamp": "mA", "milliamps": "mA", "degc": "degC", "celsius": "degC", "kelvin": "K"},
    **{"rads": "rad/s", "degs": "deg/s", "ms": "m/s", "mms": "mm/s"},
}
_SETS = {stem: frozenset(words.split()) for stem, words in _WORDS.items()}
_NONE, _OUTSIDE, _ASKED, _NOTHING = (
    frozenset(words.split()) for words in (_OTHER, _EXTERNAL, _COMMAND, _EMPTY)
)
#: A capital after a small letter, and digits beside letters, begin a word.
_CUT = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[0-9]+")
_SPEED = {"rad": "rad/s", "deg": "deg/s", "m": "m/s", "mm": "mm/s", "cm": "cm/s", "rev": "rev/s"}
_WRENCH = frozenset(f"{kind}{axis}" for kind in "ft" for axis in "xyz")


@dataclass(frozen=True)
class _Column:
    """What the name of a column says."""

    name: str
    stem: str
    joint: str
    unit: str
    asked: bool
    #: What is left of the name without the joint: columns of one family share it.
    family: str


@dataclass(frozen=True)
class Proposal:
    """A map for a table, made from the names of its columns.

    Parameters
    ----------
    text : str
        The map file.
    missing : tuple of str
        Quantities that no name says, e.g. ``"motor efforts (tau)"``: the map lacks them.
    columns : mapping of str to str
        Column of the table by column of the recording, e.g. ``pos_shoulder`` by ``q1``.
    """

    text: str
    missing: tuple[str, ...]
    columns: Mapping[str, str]


def propose(names: Sequence[str], joints: Sequence[str] = ()) -> Proposal | None:
    """Map from the names of columns.

    Parameters
    ----------
    names : sequence of str
        Columns of the table.
    joints : sequence of str
        Joints of the robot, where they are known: a column that names one is of that joint.

    Returns
    -------
    Proposal or None
        None where no name says a position.
    """
    columns = [c for c in (_understood(n, joints) for n in names) if c is not None]
    positions = _best([c for c in columns if c.stem == "q"])
    if not positions:
        return None
    order, taken = _ordered(positions, joints), _quantities(columns, positions)
    timed = [n for n in names if time_unit(n) is not None]
    lacks = {"motor efforts (tau)": "tau" in taken, "the time (t)": bool(timed)}
    used = {c.name for some in taken.values() for c in some.values()}
    proposed = {"t": timed[0]} if timed else {}
    for stem, some in taken.items():
        proposed |= {f"{stem}{k}": some[j].name for k, j in enumerate(order, 1)}
    proposed |= {n: n for n in names if n in _WRENCH and n not in used}
    units = {stem: _unit_of(stem, some) for stem, some in taken.items()}
    named = order if all(j in joints for j in order) else []
    missing = tuple(what for what, there in lacks.items() if not there)
    return Proposal(_written(proposed, units, named), missing, proposed)


def quantity(name: str) -> tuple[str, str]:
    """Stem of the quantity that a column's name says, and its unit; empty where it says none.

    Parameters
    ----------
    name : str
        E.g. ``"Encoder angle (deg)"``, which gives ``("q", "deg")``.
    """
    unit = time_unit(name)
    if unit is not None:
        return "t", unit
    c = _understood(name, ())
    if c is None:
        return "", ""
    said = _SPEED.get(c.unit, c.unit) if c.stem == "qd" else c.unit
    return c.stem, said


def _quantities(
    columns: Sequence[_Column], positions: dict[str, _Column]
) -> dict[str, dict[str, _Column]]:
    """Families by stem that have a column for each joint of the positions."""
    taken = {"q": positions}
    for stem in ("qd", "tau", "tauext", "i", "temp"):
        every = [c for c in columns if c.stem == stem]
        if len(every) == len(positions) == 1:  # of one joint, whatever each name calls it
            every = [replace(every[0], joint=next(iter(positions)))]
        found = _best([c for c in every if c.joint in positions])
        if set(found) == set(positions):
            taken[stem] = found
    asked = any(c.asked for c in taken.get("tau", {}).values())
    if "i" in taken and ("tau" not in taken or asked):
        # a motor's measured current says more of its effort than what somebody asked for
        taken["tau"] = taken.pop("i")
    return taken


def _understood(name: str, joints: Sequence[str]) -> _Column | None:
    """Quantity, joint and unit that a name says; None where it says no quantity."""
    named = max((j for j in joints if j and j in name), key=len, default="")
    rest = name.replace(named, " ") if named else name
    words = _words(rest)
    if is_target(name) or any(w in _NONE for w in words):
        stem = name.rstrip("0123456789") if is_target(name) else ""
        known = stem in (*_WORDS, "tauext")
        return _Column(name, stem, name[len(stem) :], "", False, stem) if known else None
    said = [(k, stem) for k, w in enumerate(words) for stem, own in _SETS.items() if w in own]
    if not said:
        return None
    # an abbreviation of one letter says less than a word: motor_current_q1 is a current
    at, stem = max(said, key=lambda item: (len(words[item[0]]) > 1, -item[0]))
    rest_of = [w for k, w in enumerate(words) if k != at]
    unit = next((w for w in reversed(rest_of) if w in _UNITS), "")
    others = [w for w in rest_of if w not in _NOTHING | _ASKED | _OUTSIDE and w != unit]
    numbers = [w for w in others if w.isdigit()]
    joint = named or (numbers[-1] if numbers else "_".join(others))
    if stem == "tau" and _OUTSIDE & set(words):
        stem = "tauext"
    family = " ".join(w for w in words if w not in (joint, *joint.split("_")))
    asked = bool(_ASKED & set(rest_of))
    return _Column(name, stem, joint, _UNITS.get(unit, ""), asked, f"{stem} {family}")


def _words(name: str) -> list[str]:
    """Words of a name; a unit such as mA is one, though its capital stands within."""
    parts = re.findall(r"[A-Za-z]+|[0-9]+", name)
    cut = [[p] if _UNITS.get(p.lower()) == p else _CUT.findall(p) for p in parts]
    return [w.lower() for some in cut for w in some]


def _best(columns: Sequence[_Column]) -> dict[str, _Column]:
    """The family of most joints, a measured one before a commanded one, by joint."""
    families: dict[str, dict[str, _Column]] = {}
    for c in columns:
        families.setdefault(c.family, {}).setdefault(c.joint, c)
    ranked = sorted(families.values(), key=lambda f: (any(c.asked for c in f.values()), -len(f)))
    return ranked[0] if ranked else {}


def _ordered(positions: dict[str, _Column], joints: Sequence[str]) -> list[str]:
    """Joints in the order of the robot, else of their numbers, else of the columns."""
    if all(j in joints for j in positions):
        return [j for j in joints if j in positions]
    if all(j.isdigit() for j in positions):
        return sorted(positions, key=int)
    return list(positions)


def _written(columns: Mapping[str, str], units: Mapping[str, str], named: Sequence[str]) -> str:
    """Text of the map file; `named` joints are those of the robot."""
    lines = [
        "# Proposed from the names of the columns.  Check each column, its unit and its sign:",
        "# a positive effort accelerates its joint towards larger positions.",
        f'schema = "{SCHEMA}"',
        "",
    ]
    if named:
        lines += ["[robot]", f"joints = [{', '.join(map(_quoted, named))}]", ""]
    if said := [f"{stem} = {text}" for stem, text in units.items() if text]:
        lines += ["[units]", *said, ""]
    lines += ["[columns]", *(f"{target} = {_quoted(name)}" for target, name in columns.items())]
    return "\n".join(lines) + "\n"


def _unit_of(stem: str, columns: dict[str, _Column]) -> str:
    """Entry of [units] for a quantity; empty where no name says a unit, or not the same one."""
    units = {c.unit for c in columns.values()}
    unit = units.pop() if len(units) == 1 else ""
    current = {c.stem for c in columns.values()} == {"i"}
    if stem == "qd":
        unit = _SPEED.get(unit, unit)
    if stem == "tau" and current:
        return f'{{ unit = "{unit or "A"}" }}  # add torque_constant = [..], or --torque-constant'
    return f'"{unit}"' if unit in FACTORS.get(stem, {}) else ""


def _quoted(name: str) -> str:
    """A TOML string: that of JSON, but for one character."""
    return json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")
