"""Parameters by their full names, e.g. ``j2.presliding.form``: their declaration, and words."""

from __future__ import annotations

import re
from collections.abc import Mapping

from hil.models import catalogue
from hil.models.effect import Effect
from hil.models.model import Value
from hil.models.param import Param

#: Shape parameter over which a sign is resolved.
SIGN = "v0"
#: Standard error in units of its value from which a coefficient is loose.
LOOSE = 0.5
_NAME = re.compile(r"(?:j\d+\.)?(?P<effect>[^.]+)\.(?P<param>[^\[]+)")


def _shape(name: str) -> tuple[Effect, Param] | None:
    """Effect and shape parameter of a full name; None for a coefficient or an unknown effect."""
    found = _NAME.fullmatch(name)
    effect = catalogue.table().get(found["effect"]) if found else None
    if effect is None or found is None:
        return None
    return next(((effect, p) for p in effect.shape if p.name == found["param"]), None)


def in_words(name: str, value: float, joints: tuple[str, ...] = ()) -> str:
    """Words for a value that is a code; empty where the number says all.

    Parameters
    ----------
    name : str
        Full name of the parameter.
    value : float
        Its value.
    joints : tuple of str
        Joints of the robot, where they are known: the other joint of a coupling has a name.
    """
    found = _shape(name)
    return found[1].words(value, joints) if found else ""


def without_error(name: str, v: Value) -> str:
    """Why a value has no standard error; empty where it has one, or can have none by its nature."""
    found = _shape(name)
    if v.stderr == v.stderr or (found and (found[1].choice or found[1].words(v.value))):
        return ""
    if v.source == "given":
        return "given, not fitted"
    if not v.identifiable:
        return "the data do not determine it by itself"
    if v.at_bound:
        return "at the end of what was searched, the optimum may lie beyond"
    if found and found[1].name == SIGN:
        return "the sharpest sign that fits, as fine as the data resolve"
    if found and found[0].search.at_resolution:
        return "at the end of what the data resolve"
    return "it hardly changes the effort here"


def remark(effect: str, parameters: Mapping[str, Value]) -> str:
    """What the fitted values of one effect say that a reader might miss; empty if nothing.

    Parameters
    ----------
    effect : str
        Its name.
    parameters : mapping of str to Value
        Its parameters by full name.
    """
    short = {n.split(".")[-1]: v for n, v in parameters.items() if "[" not in n}
    kind = catalogue.get(effect)
    if not all(p.name in short for p in (*kind.params, *kind.shape)):
        return ""
    values, errors = ({n: getattr(v, k) for n, v in short.items()} for k in ("value", "stderr"))
    said = [kind.doc.remark(values, errors), _loose(kind, values, errors)]
    return "; ".join(x for x in said if x)


def _loose(kind: Effect, values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    """What to make of a single coefficient that is loose with a shape of its own."""
    if len(kind.params) != 1 or not kind.shape:
        return ""
    name = kind.params[0].name
    loose = [n for n in errors if errors[n] > LOOSE * abs(values[n])]
    if name not in loose or len(loose) < 2:
        return ""
    others = ", ".join(n for n in loose if n != name)
    return (
        f"{name} trades off with {others}: sure is the law that they make together, in the range "
        "that was recorded, and none of them alone"
    )
