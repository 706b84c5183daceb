"""Units that labs write, of the columns of a table: each to SI.

A name of a column may end in one.  Currents need a torque constant, counts a scale.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hil.errors import ConfigError, unknown

DEGREE, TURN = math.pi / 180, 2 * math.pi
_LENGTH = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
_ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": DEGREE, "rev": TURN, "turn": TURN}
#: A pound and an ounce of force, a kilogram's and a gram's weight [N].
_POUND, _WEIGHT = 4.4482216152605, 9.80665
_FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": _POUND, "ozf": _POUND / 16, "kgf": _WEIGHT}
_TORQUE = {"Nm": 1.0, "mNm": 1e-3, "Nmm": 1e-3, "Ncm": 0.01, "kNm": 1e3}
_TORQUE |= {"uNm": 1e-6, "cNm": 0.01, "dNm": 0.1, "daNm": 10.0}
_TORQUE |= {"lbfin": _POUND * 0.0254, "lbfft": _POUND * 0.3048, "ozfin": _POUND / 16 * 0.0254}
_TORQUE |= {"kgfcm": _WEIGHT * 0.01, "kgfm": _WEIGHT, "gfcm": _WEIGHT * 1e-5}
_CURRENT = {"A": 1.0, "mA": 1e-3}
#: Stem of a column -> unit without spaces -> factor to SI.
FACTORS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "q": _ANGLE | _LENGTH,
    "qd": {f"{u}/s": x for u, x in (_ANGLE | _LENGTH).items()} | {"rpm": TURN / 60},
    "tau": _TORQUE | _FORCE,
    "tauext": _TORQUE | _FORCE,
    "i": _CURRENT,
    "temp": {"degC": 1.0, "K": 1.0},
    "f": _FORCE,
    "m": _TORQUE,
}
#: Units that say nothing without a scale: unit -> stem of a column -> what its scale is.
UNSCALED: dict[str, dict[str, str]] = {
    "counts": {
        "q": "rad (or m) per count, e.g. 0.00153398 for 4096 counts a turn of the joint",
        "tau": "effort at the joint per count [N m or N]",
    },
    "counts/s": {"qd": "rad (or m) per count, e.g. 0.00153398 for 4096 counts a turn of the joint"},
    "permille": {"tau": "rated effort at the joint [N m or N] / 1000"},
    "%": {"tau": "effort at the joint at 100 % [N m or N] / 100"},
}


def scale_asked(stem: str, unit: str) -> str:
    """What the scale of a column is in a unit that says nothing without; empty where none is."""
    return UNSCALED.get(unit.replace(" ", ""), {}).get("tau" if stem == "tauext" else stem, "")


#: Zero of a scale in SI.
_SHIFTS = {"K": -273.15}
_SAME = {"°": "deg", "µs": "us", "μs": "us", "°C": "degC", "°/s": "deg/s", "sec": "s"}


#: What a unit of positions, speeds or efforts says of its joint: that it turns or that it slides.
_AXES = dict.fromkeys([*_ANGLE, *(f"{u}/s" for u in _ANGLE), "rpm", *_TORQUE], "rad")
_AXES |= dict.fromkeys([*_LENGTH, *(f"{u}/s" for u in _LENGTH), *_FORCE], "m")


def axis_of(target: str, unit: str) -> str:
    """Unit of a joint, ``"rad"`` or ``"m"``, that the unit of one of its columns says; or empty."""
    known = _AXES if stem_of(target) in ("q", "qd", "tau", "tauext") else {}
    return known.get(_SAME.get(unit.strip(), unit.replace(" ", "")), "")


def axes_unit(given: Any, alone: Sequence[str] = ()) -> str:
    """Unit of the axes as a person says it: ``"rad"``, ``"m"``, or one a joint (``"rad m"``).

    Parameters
    ----------
    given : str or sequence of str
        Words with spaces or commas between them, or a list of them.
    alone : sequence of str
        Further words that may stand alone.

    Raises
    ------
    ConfigError
        If it is something else.
    """
    words = re.split(r"[ ,]+", given.strip()) if isinstance(given, str) else given
    words = [] if words == [""] else words
    if not isinstance(words, list | tuple):
        raise ConfigError(unknown("unit", str(given), ("rad", "m", *alone)))
    if len(words) == 1 and words[0] in alone:
        return str(words[0])
    for word in words:
        if word not in ("rad", "m"):
            raise ConfigError(unknown("unit", str(word), ("rad", "m", *alone)))
    return " ".join(words[:1] if len(set(words)) == 1 else words)


def stem_of(target: str) -> str:
    """Stem of a column of a recording: ``q`` of ``q3``, ``f`` of ``fx``, ``m`` of ``tx``."""
    if re.fullmatch(r"[ft][xyz]", target):
        return "f" if target[0] == "f" else "m"
    return target.rstrip("0123456789*")


@dataclass(frozen=True)
class Unit:
    """Unit of a column of a table.

    Parameters
    ----------
    name : str
        E.g. ``"deg"``, ``"rpm"``, ``"mA"``; empty is SI.
    torque_constant : float or sequence of float
        Effort at the joint by motor current [N m/A or N/A], gear included; one, or one a joint.
    """

    name: str = ""
    torque_constant: float | Sequence[float] = 0.0

    def to_si(self, target: str) -> tuple[float, float]:
        """Factor and shift of a column: SI = factor * value + shift.

        Raises
        ------
        ConfigError
            If the column cannot have this unit, or a current needs a torque constant.
        """
        name = _SAME.get(self.name.strip(), self.name.replace(" ", ""))
        stem = stem_of(target)
        if stem in ("tau", "tauext") and name in _CURRENT:
            return _CURRENT[name] * self._constant(target), 0.0
        if asked := scale_asked(stem, name):
            raise ConfigError(f"column {target!r} is in {name}: add scale = {asked}")
        known = FACTORS[stem]
        if name and name not in known:
            more = tuple(_CURRENT) if stem in ("tau", "tauext") else ()
            raise ConfigError(f"column {target!r}: " + unknown("unit", self.name, (*known, *more)))
        return known.get(name, 1.0), _SHIFTS.get(name, 0.0)

    def _constant(self, target: str) -> float:
        given = self.torque_constant
        if isinstance(given, int | float):
            value = float(given)
        else:
            k = int(re.sub(r"\D", "", target) or 1)
            if k > len(given):
                raise ConfigError(
                    f"column {target!r}: only {len(given)} torque constants are given"
                )
            value = float(given[k - 1])
        if not math.isfinite(value) or value == 0:
            raise ConfigError(
                f"column {target!r} is a current in {self.name}; a torque_constant (effort at the "
                "joint by motor current [N m/A], gear included) turns it into an effort: give it "
                "in the map or with --torque-constant"
            )
        return value


#: Names of a column of time, with the unit that one may end in.
_TIME = re.compile(
    r"_{0,2}(?:t|time|times|utc|x_value|timestamp|time_?stamp|stamp|elapsed|zeitstempel|"
    r"(?:field\.)?header\.stamp|[\w.()]+\.time)"
    r"[ _.]*[\[(]?(?P<unit>s|sec|secs|seconds|min|minutes|ms|msec|us|usec|µs|ns|nsec)?[\])]?",
    re.IGNORECASE,
)
_WORDS = {
    **{"sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "usec": "us", "nsec": "ns"},
    "minutes": "min",
}
#: From 2001 to 2128, in seconds since 1970.
_EPOCH = (1e9, 5e9)


def time_unit(name: str) -> str | None:
    """Unit that the name of a column of time says, e.g. ``ms`` of ``time_ms``.

    Empty where the name says none; None where it is no name of a time.
    """
    found = _TIME.fullmatch(name.strip())
    if not found:
        return None
    unit = (found["unit"] or "").lower()
    return _WORDS.get(unit, unit)


def epoch_unit(first: float) -> str:
    """Unit of a time since 1970, from its size; empty where it is none."""
    for unit in ("s", "ms", "us", "ns"):
        if _EPOCH[0] <= first * FACTORS["t"][unit] < _EPOCH[1]:
            return unit
    return ""
