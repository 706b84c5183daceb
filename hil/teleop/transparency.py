"""Transparency: which condition a controller meets, which it misses, and every family that does.

Theorem (necessary and sufficient for Class I controllers, thesis 4.2.1; derived in this form):
f_m = kf f_s and v_s = kp v_m for every operator and environment if and only if

    c1 = kp (z_cs + c7),   c2 = kf (1 + c6),   kf c3 = 1 + c5,   kp c4 = -(z_cm + c8)

and the ports are determined, c1 c2 - c3 c4 != 0.  The local gains c5..c8 are free.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

from hil.teleop.architecture import Design, MotionTerm

#: Channel -> the local gain that replaces it, and the value that makes it vanish.
LOCAL = {
    "c1": ("c7", "-z_cs"),
    "c2": ("c6", "-1"),
    "c3": ("c5", "-1"),
    "c4": ("c8", "-z_cm"),
}
_EQUATIONS = {
    "c1": "c1 = kp (z_cs + c7)",
    "c2": "c2 = kf (1 + c6)",
    "c3": "kf c3 = 1 + c5",
    "c4": "kp c4 = -(z_cm + c8)",
    "rank": "c1 c2 - c3 c4 != 0",
}
#: A condition holds if its two sides agree to this share of the larger one.
_TOLERANCE = 1e-9
#: Coefficients below this part of the largest are rounding, and not said.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class TransparencyCondition:
    """One condition of the theorem.

    Parameters
    ----------
    name, equation : str
        Channel, or ``"rank"``; what it demands.
    holds : bool
        Whether it is met.
    gap : float
        Largest difference of its two sides relative to the larger (for ``rank``: the size of
        c1 c2 - c3 c4 relative to its terms).
    text : str
        What to change.
    """

    name: str
    equation: str
    holds: bool
    gap: float
    text: str


@dataclass(frozen=True)
class Family:
    """One family of transparent controllers.

    Parameters
    ----------
    channels : tuple of str
        The channels that it uses.
    local : dict of str to str
        Local gains that replace the others.
    free : tuple of str
        Local gains that may be chosen.
    condition : str
        What must not vanish.
    """

    channels: tuple[str, ...]
    local: dict[str, str]
    free: tuple[str, ...]
    condition: str


def _wanted(design: Design) -> dict[str, MotionTerm]:
    """c1..c4 that the theorem demands for the local gains of this design."""
    kp, kf = design.motion_scale, design.force_scale
    return {
        "c1": (design.slave.term + design.c7) * kp,
        "c2": MotionTerm(0.0, kf * (1.0 + design.c6)),
        "c3": MotionTerm(0.0, (1.0 + design.c5) / kf),
        "c4": -(design.master.term + design.c8) * (1.0 / kp),
    }


def check(design: Design) -> list[TransparencyCondition]:
    """All five conditions with their gaps, the missed ones saying what to change."""
    goal = _wanted(design)
    found = []
    for name in LOCAL:
        value = getattr(design, name)
        have = value if isinstance(value, MotionTerm) else MotionTerm(0.0, value)
        difference = (have + (-goal[name])).size()
        gap = difference / max(have.size(), goal[name].size(), 1e-300)
        holds = gap <= _TOLERANCE or difference <= _TOLERANCE
        text = "" if holds else f"{name} is {_said(have)}, it should be {_said(goal[name])}"
        found.append(
            TransparencyCondition(name, _EQUATIONS[name], holds, 0.0 if holds else gap, text)
        )
    return [*found, _rank(design)]


def _rank(design: Design) -> TransparencyCondition:
    one, two = design.c1 * design.c2, design.c4 * design.c3
    gap = (one + (-two)).size() / max(one.size(), two.size(), 1e-300)
    holds = gap > _TOLERANCE
    text = "" if holds else "the channels cancel: the port variables are not determined"
    return TransparencyCondition("rank", _EQUATIONS["rank"], holds, gap, text)


def transparent(design: Design) -> bool:
    """Whether all five conditions hold."""
    return all(c.holds for c in check(design))


def families(channels: int) -> list[Family]:
    """Every family of transparent controllers with exactly so many channels.

    A vanishing channel needs the local gain of `LOCAL`.  Then c1 c2 - c3 c4 becomes
    (1 + c6)(z_cs + c7) + (1 + c5)(z_cm + c8); c1 or c2 takes its first part, c3 or c4 the
    second, and one of both must be left.

    Parameters
    ----------
    channels : int
        0 to 4.
    """
    found = []
    for used in combinations(LOCAL, channels):
        gone = [c for c in LOCAL if c not in used]
        first, second = {"c1", "c2"}.isdisjoint(gone), {"c3", "c4"}.isdisjoint(gone)
        if not (first or second):
            continue
        local = {LOCAL[c][0]: LOCAL[c][1] for c in gone}
        parts = [("(1 + c6)(z_cs + c7)", first), ("(1 + c5)(z_cm + c8)", second)]
        condition = " + ".join(text for text, there in parts if there) + " != 0"
        free = tuple(c for c in ("c5", "c6", "c7", "c8") if c not in local)
        found.append(Family(used, local, free, condition))
    return found


def redundant(design: Design) -> dict[str, str]:
    """Channels of a transparent design that a local gain can replace, and by which value.

    Parameters
    ----------
    design : Design
        Any; an empty result for one that is not transparent.
    """
    if not transparent(design):
        return {}
    now = [c for c in LOCAL if _there(getattr(design, c))]
    out = {}
    for name in now:
        rest = tuple(c for c in now if c != name)
        if any(f.channels == rest for f in families(len(rest))):
            local, value = LOCAL[name]
            out[name] = f"{local} = {value}"
    return out


def _there(value: MotionTerm | float) -> bool:
    return (value.size() if isinstance(value, MotionTerm) else abs(value)) > 0.0


def _said(term: MotionTerm) -> str:
    parts = [(term.k, "/s"), (term.b, ""), (term.a, " s")]
    least = _ROUNDING * term.size()
    text = " + ".join(f"{x:.6g}{unit}" for x, unit in parts if abs(x) > least)
    return text.replace("+ -", "- ") or "0"
