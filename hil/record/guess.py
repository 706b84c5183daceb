"""A map proposed from the names of a table's columns, for a person to check.

A name is cut into words: ``pos_shoulder_deg`` says what is measured (pos), of which joint
(shoulder) and in which unit (deg).  Where no word says what is measured, the unit does.  Columns
that differ in the joint alone are a family.  For each quantity one family is proposed: a measured
one before a commanded one, the complete one before another.  Nothing is taken that a name does not
say, and nothing is read from the values.  What is not understood stays a comment of the map.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hil.record.mapfile import SCHEMA, is_target
from hil.record.units import FACTORS, UNSCALED, scale_asked, stem_of, time_unit

#: Words of a quantity, by stem of its column.
_WORDS = {
    "q": "q pos posn position positions angle angles theta th jointangle jointpos qpos jp winkel "
    "lage istposition istwinkel",
    "qd": "qd dq qdot qvel vel velo veloc velocity velocities speed speeds omega thetadot dtheta "
    "jv geschwindigkeit drehzahl istdrehzahl",
    "tau": "tau torque torques trq effort efforts eff moment moments u jf drehmoment istmoment",
    "i": "i current currents cur curr amp amps ampere amperes strom motorstrom iststrom",
    "temp": "temp temps temperature temperatures temperatur",
}
#: Words of what is no column of a recording, or an estimate from somebody's model.
_OTHER = (
    "acc accel acceleration accelerations qdd ddq qddot jerk voltage volt pwm error err status "
    "hat est estimate estimated"
)
#: Words of external efforts.
_EXTERNAL = "ext external contact env loadcell interaction human"
#: Words of what was asked for, not measured.
_COMMAND = "target desired des cmd command commanded commands ref reference setpoint goal d soll"
#: Words that say nothing here.
_EMPTY = (
    "joint joints j axis ax motor mot link actual act measured meas msr state states robot arm "
    "observation data signals values log logs logsout the of in filtered filt raw value val sensor "
    "input present feedback ist"
)
#: Words of what counts.
_ENCODER = frozenset(("enc", "encoder"))
_SETS = {stem: frozenset(words.split()) for stem, words in _WORDS.items()}
_NONE, _OUTSIDE, _ASKED, _NOTHING = (
    frozenset(words.split()) for words in (_OTHER, _EXTERNAL, _COMMAND, _EMPTY)
)
#: Units as a map writes them, by what is measured in them; a force may be an effort.
_BY_KIND = {
    "t": "s ms us ns",
    "q": "rad mrad deg rev m cm mm um in ft",
    "qd": "rad/s mrad/s deg/s rev/s m/s cm/s mm/s um/s in/s ft/s rpm",
    "tau": "Nm mNm Nmm Ncm kNm uNm cNm dNm daNm lbfin lbfft ozfin kgfcm kgfm gfcm",
    "force": "N mN kN lbf ozf kgf",
    "i": "A mA",
    "temp": "degC K",
    "": "V mV kV W kW Hz kHz bar mbar Pa kPa MPa g kg % m/s2 rad/s2 deg/s2 permille counts "
    "counts/s",
}
_KIND = {unit: kind for kind, units in _BY_KIND.items() for unit in units.split()}
#: Other spellings, in small letters and without spaces, points and stars.
_SPELT = {
    **{u.lower(): u for u in _KIND if len(u) > 1 and u not in ("mN", "mV")},
    **{"degree": "deg", "degrees": "deg", "°": "deg", "radian": "rad", "radians": "rad"},
    **{"°/s": "deg/s", "dps": "deg/s", "degs": "deg/s", "rads": "rad/s", "mms": "mm/s"},
    **{"µs": "us", "μs": "us", "µm": "um", "sec": "s", "msec": "ms", "usec": "us"},
    **{"°c": "degC", "celsius": "degC", "kelvin": "K", "1/min": "rpm", "u/min": "rpm"},
    **{"grad": "deg", "grad/s": "deg/s", "umdr": "rev", "umdrehungen": "rev"},
    **dict.fromkeys(
        "count cnt cnts inc incs incr increments inkremente tick ticks qc pulse pulses".split(),
        "counts",
    ),
    **dict.fromkeys("inc/s ticks/s pulses/s cps".split(), "counts/s"),
    **dict.fromkeys("promille per/mille permil ‰".split(), "permille"),
    **dict.fromkeys("revs revolution revolutions turn turns".split(), "rev"),
    **dict.fromkeys("revolutions/s turns/s turn/s".split(), "rev/s"),
    **{"ozin": "ozfin", "lbin": "lbfin", "inlb": "lbfin", "inlbf": "lbfin", "lbft": "lbfft"},
    **{"ftlb": "lbfft", "ftlbf": "lbfft", "kgcm": "kgfcm", "kgm": "kgfm", "gcm": "gfcm"},
    **{"kpcm": "kgfcm", "kpm": "kgfm", "pcm": "gfcm", "µnm": "uNm", "μnm": "uNm", "kp": "kgf"},
    **{"lb": "lbf", "lbs": "lbf", "inch": "in", "inches": "in", "feet": "ft", "foot": "ft"},
    **{"percent": "%", "prozent": "%", "pct": "%"},
    **{"milliamp": "mA", "milliamps": "mA", "rad/s^2": "rad/s2", "m/s^2": "m/s2"},
}
#: Words that are a unit wherever they stand in a name; others only in brackets and at its end.
_ANYWHERE = frozenset(_SPELT) - set(
    "ms us ns cm kg bar sec turn revolution in ft lb lbs inch foot feet inches".split()
)
#: What units are made of, in small letters: a bracket of nothing else is a unit, known or not.
_ATOMS = frozenset(
    "oz ozf lb lbs lbf kip kgf kg g gf in inch ft foot yd mil cm mm um m km s ms us ns min h hr "
    "rad mrad deg grad rev n mn cn dn dan kn kp nm a ma v w kw hz sec arcsec arcmin dyn dyne "
    "j".split()
)
#: A capital after a small letter, and digits beside letters, begin a word.
_CUT = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[0-9]+")
_BRACKETS = re.compile(r"[\[(]([^\[\]()0-9][^\[\]()]*)[\])]")
_END = re.compile(r"(?<=[ _.\-/0-9])(?:[A-Za-zµμ°]+[_/ .·*-])?[A-Za-zµμ°%]+$")
#: Units that count in brackets alone: at the end of a name they are words (theta_in, wrist_ft).
_BRACKETED = frozenset(("in", "ft", "in/s", "ft/s"))
_SPEED = {u.removesuffix("/s"): u for u in _BY_KIND["qd"].split()}
_LENGTHS = frozenset(("m", "cm", "mm", "um"))
#: Names that the protocol of a drive gives: what they say in words, and in which unit.
_DRIVES = (
    (re.compile(r"pos_estimate_counts", re.I), "pos", "counts"),
    (re.compile(r"pos_estimate", re.I), "pos", "rev"),
    (re.compile(r"vel_estimate_counts", re.I), "vel", "counts/s"),
    (re.compile(r"vel_estimate", re.I), "vel", "rev/s"),
    (re.compile(r"iq_measured", re.I), "current", "A"),
    (re.compile(r"present_position", re.I), "pos", "counts"),
    (re.compile(r"present_velocity", re.I), "vel", "counts/s"),
    (re.compile(r"present_(?:current|load)", re.I), "current", "counts"),
)
#: Columns beside which positions are in turns, and speeds in turns by second: of a moteus.
_IN_TURNS = re.compile(r"(?:^|[^A-Za-z])[qd]_current(?:_A)?$")
_WRENCH = frozenset(f"{kind}{axis}" for kind in "ft" for axis in "xyz")
#: What a person calls a column, by stem.
_OF_NONE = "no column of a recording"
_CALLED = {"q": "position", "tau": "motor effort"}


@dataclass(frozen=True)
class _Column:
    """What the name of a column says."""

    name: str
    #: Empty where nothing says what is measured, or it is nothing of a recording.
    stem: str
    joint: str = ""
    unit: str = ""
    asked: bool = False
    #: What is left of the name without joint and unit: columns of one family share it.
    family: str = ""
    #: Why it is no column of a recording; empty where the name says nothing at all.
    why: str = ""
    #: Its rule in a map, where that is not its name alone.
    rule: str = ""


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
    fill : tuple of str
        Columns of a recording that the map lacks, e.g. ``tau2``.
    plain : bool
        Whether it may be taken without a look: nothing is lacking, each name says its quantity and
        a joint of the robot, no factor is to be filled in, and the efforts are measured ones.
    """

    text: str
    missing: tuple[str, ...]
    columns: Mapping[str, str]
    fill: tuple[str, ...] = ()
    plain: bool = False


def propose(
    names: Sequence[str], joints: Sequence[str] = (), first: Mapping[str, str] | None = None
) -> Proposal | None:
    """Map from the names of columns; a part of one where some are not understood.

    Parameters
    ----------
    names : sequence of str
        Columns of the table.
    joints : sequence of str
        Joints of the robot, where they are known: a column that names one is of that joint.
    first : mapping of str to str, optional
        Cells of the first row: a log of ROS says there whose the columns with each number are.

    Returns
    -------
    Proposal or None
        None where no name says anything.
    """
    called = _called(names, first or {})
    said = [
        replace(_understood(called.get(n, n), joints, _series(names)), name=n)
        for n in dict.fromkeys(names)
    ]
    said = _of_two_parts(said)
    if any(_IN_TURNS.search(n) for n in names):
        turns = {"q": "rev", "qd": "rev/s"}
        said = [replace(c, unit=c.unit or turns.get(c.stem, "")) for c in said]
    columns = _joints_alone([c for c in said if c.stem], joints)
    timed = _timed(columns)
    columns = _efforts(columns)
    families = {s: _best([c for c in columns if c.stem == s]) for s in (*_WORDS, "tauext")}
    base = families["q"] or max(families.values(), key=len)
    order = _ordered(base, families, joints)
    if not order and timed is None:
        return None
    taken = _quantities(columns, order)
    proposed = {"t": timed} if timed else {}
    for stem, some in taken.items():
        proposed |= {f"{stem}{k}": some[j] for k, j in enumerate(order, 1) if j in some}
    used = {c.name for c in proposed.values()}
    wrench = [n for n in names if n in _WRENCH and n not in used]
    proposed |= {n: _Column(n, n) for n in wrench}
    used |= set(wrench)
    fill, missing = _lacks(proposed, order, joints)
    left = [c for c in {c.name: c for c in (*said, *columns)}.values() if c.name not in used]
    named = order if order and all(j in joints for j in order) else []
    text = _written(proposed, named, order, fill, left, taken)
    whole = not missing and all(len(some) == len(order) for some in taken.values())
    plain = bool(named) and whole and all(_is_plain(k, c) for k, c in proposed.items())
    return Proposal(text, missing, {k: c.name for k, c in proposed.items()}, fill, plain)


def _is_plain(target: str, c: _Column) -> bool:
    """Whether a column is what its name says, in a unit that is known or not said."""
    stem = target.rstrip("0123456789")
    in_doubt = c.asked or bool(c.unit and c.unit not in _KIND) or (stem, c.stem) == ("tau", "i")
    return not in_doubt and not scale_asked(stem, c.unit)


def _called(names: Sequence[str], first: Mapping[str, str]) -> dict[str, str]:
    """Names of columns with a joint's name in place of its number, where the first row says it.

    Beside ``field.name0``, which holds ``elbow``, ``field.position0`` is ``field.position elbow``.
    """
    numbered = re.compile(r"(.*?)([A-Za-z]+)\[?([0-9]+)\]?")
    parts = {n: found for n in names if (found := numbered.fullmatch(n))}
    joints = {
        (found[1], found[3]): text
        for n, found in parts.items()
        if found[2] == "name" and re.search(r"[^\W\d_]", text := first.get(n, ""))
    }
    return {
        n: f"{found[1]}{found[2]} {joints[found[1], found[3]]}"
        for n, found in parts.items()
        if found[2] != "name" and (found[1], found[3]) in joints
    }


#: How the two parts of a time are called, and the unit of the second [s].
_PARTS = (
    ("sec", "nanosec", "1e-9"),
    ("secs", "nsecs", "1e-9"),
    ("sec", "nsec", "1e-9"),
    ("seconds", "nanoseconds", "1e-9"),
    ("sec", "usec", "1e-6"),
)


def _of_two_parts(columns: Sequence[_Column]) -> list[_Column]:
    """Columns with a time in two parts as one; a header's stamp before others."""
    names = {c.name for c in columns}
    found = {}
    for whole, rest, unit in _PARTS:
        for n in names:
            head = n.removesuffix(whole)
            if n.endswith(whole) and not n.endswith(rest) and head + rest in names:
                found[n] = head + rest, unit
    if not found:
        return list(columns)
    first = min(found, key=lambda n: ("stamp" not in n, len(n), n))
    rest, unit = found[first]
    text = f"{{ sum = {{ {_quoted(first)} = 1, {_quoted(rest)} = {unit} }} }}"
    others = [c for c in columns if c.name not in (first, rest) and c.stem != "t"]
    return [_Column(first, "t", rule=text), *others]


def quantity(name: str) -> tuple[str, str]:
    """Stem of the quantity that a column's name says, and its unit; empty where it says none.

    Parameters
    ----------
    name : str
        E.g. ``"Encoder angle (deg)"``, which gives ``("q", "deg")``.
    """
    c = _understood(name, (), frozenset())
    return ("", "") if c.stem in ("", "force") else (c.stem, c.unit)


def unit_named(text: str) -> str:
    """Unit that a text is, in brackets or not, as a map writes it; empty where it is none."""
    bare = text.strip()
    pairs = {"[": "]", "(": ")", "<": ">"}
    if len(bare) > 2 and pairs.get(bare[0]) == bare[-1]:
        bare = bare[1:-1]
    return _spelt(bare)


def with_units(names: Sequence[str], cells: Sequence[str]) -> tuple[str, ...]:
    """Names with the units of a second header row; empty where the row is none.

    Every cell of such a row is a unit, or says that there is none.  A column that is called as a
    recording calls it, and is in SI units, keeps its name.

    Parameters
    ----------
    names, cells : sequence of str
        The row of names, and the one below it.
    """
    units = [unit_named(c) for c in cells]
    none = [c in ("", "-", "[-]", "()", "1") for c in cells]
    if len(cells) != len(names) or not any(units):
        return ()
    if not all(u or no for u, no in zip(units, none, strict=True)):
        return ()
    return tuple(
        name if not u or _in_si(name, u) else f"{name} [{u}]"
        for name, u in zip(names, units, strict=True)
    )


def _in_si(name: str, unit: str) -> bool:
    """Whether a column is one of a recording, in the unit of a recording."""
    if not is_target(name):
        return False
    return FACTORS.get(stem_of(name), {}).get(unit) == 1.0 and unit != "K"


def _timed(columns: Sequence[_Column]) -> _Column | None:
    """The column of time: one that is called so, else the only one in a unit of time.

    The stamp of a message says when it was measured, its reception when it came.
    """
    timed = [c for c in columns if c.stem == "t"]
    if stamped := [c for c in timed if c.name.endswith("header.stamp")]:
        return stamped[0]
    called = [c for c in timed if time_unit(c.name) is not None]
    if first := next((c.name for c in columns if c.stem == "q"), ""):  # that of the positions
        called.sort(key=lambda c: not first.startswith(c.name.rpartition(".")[0] + "."))
    return called[0] if called else timed[0] if len(timed) == 1 else None


def _efforts(columns: Sequence[_Column]) -> list[_Column]:
    """Columns with each force and torque an effort of its joint, or of no joint."""
    slides = {c.joint: c.unit in _LENGTHS for c in columns if c.stem == "q" and c.unit}
    alone = next(iter(slides.values())) if len(slides) == 1 else None
    out = []
    for c in columns:
        slide = slides.get(c.joint, alone)
        if c.stem == "force":
            lever = ", where the joints turn: as an effort it needs its lever arm as scale"
            why = "" if slide else f"a force in {c.unit}{lever if slide is False else ''}"
            stem = ("tauext" if "ext" in c.family.split() else "tau") if slide else ""
            c = replace(c, stem=stem, why=why)
        elif slide and c.stem in ("tau", "tauext") and _KIND.get(c.unit) == "tau":
            c = replace(c, stem="", why=f"a torque in {c.unit}, where the joint slides")
        out.append(c)
    return out


def _quantities(columns: Sequence[_Column], order: Sequence[str]) -> dict[str, dict[str, _Column]]:
    """Families by stem, by joint; a family may lack some joints of the order."""
    taken: dict[str, dict[str, _Column]] = {}
    for stem in ("q", "qd", "tau", "tauext", "i", "temp"):
        every = [c for c in columns if c.stem == stem]
        if len(every) == len(order) == 1:  # of one joint, whatever each name calls it
            every = [replace(every[0], joint=order[0])]
        if found := _best([c for c in every if c.joint in order]):
            taken[stem] = found
    asked = any(c.asked for c in taken.get("tau", {}).values())
    whole = set(taken.get("i", ())) == set(order)
    if whole and (asked or not set(order) <= set(taken.get("tau", ()))):
        # a motor's measured current says more of its effort than what somebody asked for
        taken["tau"] = taken.pop("i")
    return taken


def _lacks(
    proposed: Mapping[str, _Column], order: Sequence[str], joints: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Columns that a recording needs and the map has not, and the same in words."""
    fill, missing = [], []
    known = max(len(order), 1)
    for stem, what in (("q", "positions (q)"), ("tau", "motor efforts (tau)")):
        absent = [k for k in range(1, known + 1) if f"{stem}{k}" not in proposed]
        fill += [f"{stem}{k}" for k in absent]
        whole = len(absent) == known
        named = [order[k - 1] if order[k - 1] in joints else str(k) for k in absent if order]
        missing += [what] if whole else [f"{_CALLED[stem]} of joint {j}" for j in named]
    if "t" not in proposed:
        missing.append("the time (t)")
        fill.append("t")
    return tuple(fill), tuple(missing)


def _series(names: Sequence[str]) -> frozenset[str]:
    """Names that differ in a last letter: it counts (leg_A, leg_B) and is no unit."""
    ends = [n for n in dict.fromkeys(names) if re.search(r"[ _.\-][A-Za-z]$", n)]
    stems = [n[:-1] for n in ends]
    return frozenset(n for n in ends if stems.count(n[:-1]) > 1)


def _understood(name: str, joints: Sequence[str], series: frozenset[str]) -> _Column:
    """Quantity, joint and unit that a name says."""
    timed = time_unit(name)
    if timed is not None:
        return _Column(name, "t", unit=timed)
    for pattern, plain, unit in _DRIVES:
        if pattern.search(name):
            c = _understood(pattern.sub(plain, name), joints, series)
            return replace(c, name=name, unit=c.unit or unit)
    named = _joint_named(name, joints)
    rest = re.sub(re.escape(named), " ", name, flags=re.IGNORECASE) if named else name
    if named and rest == name:  # named by its words alone
        own = set(_words(named))
        rest = " ".join(["", *(w for w in re.split(r"[ _.\-]+", name) if w.lower() not in own)])
    bare, unit = (rest, "") if name in series else _unit_at(rest)
    words = _words(bare)
    if is_target(name) or any(w in _NONE for w in words):
        stem = name.rstrip("0123456789") if is_target(name) else ""
        known = stem in (*_WORDS, "tauext")
        if known:
            return _Column(name, stem, name[len(stem) :], "", False, stem)
        return _Column(name, "", why="" if is_target(name) else _OF_NONE)
    if not unit:
        said = [w for w in words if w in _ANYWHERE]
        unit = _SPELT[said[-1]] if said else ""
        words = [w for w in words if w not in said]
    scaled = bool(unit) and unit not in UNSCALED
    at, stem = _meant(words, unit if scaled else "")
    if not stem and not unit and (words == ["zeit"] or (named and not words)):
        stem = "q" if named else "t"
    if unit == "counts" and not stem and _ENCODER & set(words):
        at, stem = next(k for k, w in enumerate(words) if w in _ENCODER), "q"
    unit = "counts/s" if (stem, unit) == ("qd", "counts") else unit
    if unit and not scaled and not scale_asked("tau" if stem == "i" else stem, unit):
        stem = ""
    odd = "" if unit else _odd_unit(rest)
    if not stem:
        why = f"in {unit}: {_OF_NONE}" if _KIND.get(unit) == "" else ""
        if unit == "%":
            why = "in %: say what 100 % is, as scale = (that, in N m, N, A or rad) / 100"
        return _Column(name, "", named, unit, why=why)
    if stem == "t":
        return _Column(name, "t", unit=unit)
    rest_of = [w for k, w in enumerate(words) if k != at]
    others = [w for w in rest_of if w not in _NOTHING | _ASKED | _OUTSIDE]
    numbers = [w for w in others if w.isdigit()]
    joint = named or (numbers[-1] if numbers else "_".join(others))
    outside = bool(_OUTSIDE & set(words))
    if stem == "tau" and outside:
        stem = "tauext"
    left = [w for w in words if w not in (joint, *joint.split("_")) and w not in _SPELT]
    family = " ".join([*left, *(["ext"] if outside else [])])
    asked = bool(_ASKED & set(rest_of))
    unit = _SPEED.get(unit, unit) if stem == "qd" else unit
    fits = stem == "force" or _KIND.get(unit) in (stem, "force" if "tau" in stem else stem)
    fits = fits or (stem == "tauext" and _KIND.get(unit) == "tau") or bool(unit and not scaled)
    if unit and not fits and unit not in _BRACKETED and _bracketed(rest, unit):
        how = f"{{ from = {_quoted(name)}, scale = (SI unit by this one) }}"
        why = f"{unit} is no unit of what its name says; to take it all the same, write {how}"
        return _Column(name, "", joint, unit, why=why)
    return _Column(name, stem, joint, odd or (unit if fits else ""), asked, family)


def _meant(words: Sequence[str], unit: str) -> tuple[int, str]:
    """Place of the word that says what is measured, and the stem; of the unit alone, place -1."""
    kind = _KIND.get(unit)
    said = [(k, stem) for k, w in enumerate(words) for stem, own in _SETS.items() if w in own]
    if not said:
        return -1, kind or ""
    # what it is given as: a current_as_torque is a torque
    said = [(k, stem) for k, stem in said if "as" in words[:k]] or said
    # an abbreviation of one letter says less than a word: motor_current_q1 is a current
    at, stem = max(said, key=lambda item: (len(words[item[0]]) > 1, -item[0]))
    if kind == "" or (kind and kind != stem and len(words[at]) == 1):
        return (at, stem) if (stem, kind) == ("tau", "force") else (-1, kind)
    return at, "i" if (stem, kind) == ("tau", "i") else stem


def _unit_at(name: str) -> tuple[str, str]:
    """A name without the unit in brackets or at its end, and that unit."""
    for found in _BRACKETS.finditer(name):
        if unit := _spelt(found[1]):
            return name[: found.start()] + " " + name[found.end() :], unit
    found_end = _END.search(name)
    while found_end:
        if (unit := _spelt(found_end[0])) and unit not in _BRACKETED:
            return name[: found_end.start()], unit
        cut = re.search(r"[_/ .·*-]", found_end[0])
        if not cut:
            break
        found_end = _END.search(name, found_end.start() + cut.end())
    return name, ""


def _odd_unit(name: str) -> str:
    """Unit in the brackets of a name that no map knows; empty where there is none."""
    for found in _BRACKETS.finditer(name):
        parts = re.findall(r"[^\W\d_]+", found[1].lower())
        # one letter may count joints, and the least of something is no minute
        alone = len(parts) == 1 and (len(parts[0]) == 1 or parts[0] == "min")
        if parts and not alone and set(parts) <= _ATOMS and not _spelt(found[1]):
            return found[1].strip()
    return ""


def _bracketed(name: str, unit: str) -> bool:
    """Whether a unit of more than a letter stands in brackets: it is meant as one."""
    inside = [found[1] for found in _BRACKETS.finditer(name)]
    return any(len(text) > 1 and _spelt(text) == unit for text in inside)


def _spelt(text: str) -> str:
    """Unit that a text is, as a map writes it; empty where it is none."""
    near = re.sub(r"[ ·*]", "", text.strip()).replace("_", "/")
    plain = re.sub(r"[ ·*._-]", "", text.strip())
    if plain.startswith("%"):  # of a rated torque, say
        return "%"
    for form in (near, plain):
        if form in _KIND:
            return form
        if len(form) > 1 and (unit := _SPELT.get(form.lower())):
            return unit
    return "deg" if plain == "°" else ""


def _words(name: str) -> list[str]:
    """Words of a name; a unit such as mA is one, though its capital stands within."""
    parts = re.findall(r"[^\W\d_]+|[0-9]+", name)
    cut = [[p] if _SPELT.get(p.lower()) == p or not p.isascii() else _CUT.findall(p) for p in parts]
    return [w.lower() for some in cut for w in some]


def _joint_named(name: str, joints: Sequence[str]) -> str:
    """The joint of the robot that a name holds, whole or in all of its words; empty for none."""
    whole = [
        j
        for j in joints
        if j and re.search(rf"(?<![^\W_]){re.escape(j)}(?![^\W_])", name, re.IGNORECASE)
    ]
    within = [j for j in joints if len(j) > 1 and re.search(rf"{re.escape(j)}(?!\d)", name)]
    if found := whole or within:
        return max(found, key=len)
    words, keys = set(_words(name)), {j: set(_words(j)) - _NOTHING for j in joints}
    by_word = [j for j, key in keys.items() if key <= words and any(not w.isdigit() for w in key)]
    return max(by_word, key=lambda j: len(keys[j]), default="")


def _joints_alone(columns: Sequence[_Column], joints: Sequence[str]) -> list[_Column]:
    """Columns whose joint is a word, without the words that all of one quantity share."""
    out = []
    for c in columns:
        alike = [o for o in columns if o.stem == c.stem and o.asked == c.asked and not o.why]
        words = [set(o.joint.split("_")) for o in alike]
        shared = set.intersection(*words) if len(words) > 1 else set()
        joint = "_".join(w for w in c.joint.split("_") if w not in shared)
        if joint and joint != c.joint and c.joint not in joints:
            more = [w for w in c.joint.split("_") if w in shared]
            c = replace(c, joint=joint, family=" ".join([c.family, *more]))
        out.append(c)
    return out


def _best(columns: Sequence[_Column]) -> dict[str, _Column]:
    """The family of most joints, a measured one before a commanded one, by joint."""
    families: dict[str, dict[str, _Column]] = {}
    for c in columns:
        families.setdefault(c.family, {}).setdefault(c.joint, c)
    ranked = sorted(families.values(), key=lambda f: (any(c.asked for c in f.values()), -len(f)))
    return ranked[0] if ranked else {}


def _ordered(
    base: Mapping[str, _Column],
    families: Mapping[str, Mapping[str, _Column]],
    joints: Sequence[str],
) -> list[str]:
    """Joints in the order of the robot, else of their numbers, else of the columns."""
    named = {j for some in families.values() for j in some if j in joints}
    if base and all(j in joints for j in base):
        return [j for j in joints if j in named]
    if all(j.isdigit() for j in base):
        return sorted(base, key=int)
    return list(base)


def _written(
    columns: Mapping[str, _Column],
    named: Sequence[str],
    order: Sequence[str],
    fill: Sequence[str],
    left: Sequence[_Column],
    taken: Mapping[str, Mapping[str, _Column]],
) -> str:
    """Text of the map file; `named` joints are those of the robot."""
    lines = [
        "# Proposed from the names of the columns.  Check each column, its unit and its sign:",
        "# a positive effort accelerates its joint towards larger positions.",
        f'schema = "{SCHEMA}"',
        "",
    ]
    lengths = {c.unit in _LENGTHS for c in taken.get("q", {}).values()}
    if lengths == {True} and not named:
        lines += ["[robot]", 'unit = "m"', ""]
    if named:
        lines += ["[robot]", f"joints = [{', '.join(map(_quoted, named))}]", ""]
    units = {stem: _unit_of(stem, some) for stem, some in taken.items()}
    if said := [f"{stem} = {text}" for stem, text in units.items() if text]:
        lines += ["[units]", *said, ""]
    lines.append("[columns]")
    for target, c in columns.items():
        stem = target.rstrip("0123456789")
        alone = c.unit and not units.get(stem) and c.unit in FACTORS.get(stem, {})
        alone = alone and time_unit(c.name) is None  # a name of time says its unit by itself
        asked = scale_asked(stem, c.unit)
        if c.stem != "t" and c.unit and c.unit not in _KIND:
            asked = "SI unit by this one, in place of unit, which is not known"
        note = f"  # add scale = {asked}" if asked else ""
        if (stem, c.stem) == ("tau", "i") and not units.get(stem) and c.unit not in UNSCALED:
            note, asked = "  # add torque_constant = effort at the joint by A", c.unit
        plain = c.rule or _quoted(c.name)
        lines.append(f"{target} = {_rule(c) if alone or asked else plain}{note}")
    if fill:
        lines += [
            "# Fill in the names of these columns, or say what else they are (docs/import.md):"
        ]
        lines += [f'# {target} = "..."' for target in fill]
    for c in left:
        known = c.stem == "t" or c.joint in order or c.why.endswith(_OF_NONE)
        why = c.why or ("" if known or not c.stem else "of which joint?")
        kind = "not taken" if known and (c.stem or c.why) else "not understood"
        lines.append(f"# {kind}: {_quoted(c.name)}{f' ({why})' if why else ''}")
    return "\n".join(lines) + "\n"


def _rule(c: _Column) -> str:
    return f'{{ from = {_quoted(c.name)}, unit = "{c.unit}" }}'


def _unit_of(stem: str, columns: Mapping[str, _Column]) -> str:
    """Entry of [units] for a quantity; empty where no name says a unit, or not the same one."""
    units = {c.unit for c in columns.values()}
    unit = units.pop() if len(units) == 1 else ""
    current = {c.stem for c in columns.values()} == {"i"} and unit not in UNSCALED
    current = current and len({c.unit for c in columns.values()}) == 1
    if stem == "tau" and current:
        return f'{{ unit = "{unit or "A"}" }}  # add torque_constant = [..], or --torque-constant'
    return f'"{unit}"' if unit in FACTORS.get(stem, {}) else ""


def _quoted(name: str) -> str:
    """A TOML string: that of JSON, but for one character."""
    return json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")
