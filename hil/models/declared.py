"""Whether an effect is declared so that the rest can use it, and in words why not."""

from __future__ import annotations

from collections.abc import Iterator

from hil.models.effect import FIXED, NEVER, Effect
from hil.models.parts import Doc, Relations, Scope, Search, Trait, Variation

#: What a class may not leave out.
NEEDED = ("name", "family", "doc")
#: Part -> its type, how it is written, its default, and what was an attribute of its own once.
PARTS: dict[str, tuple[type, str, object, tuple[str, ...]]] = {
    "doc": (
        Doc, "Doc(equation=..., signature=..., shown_by=..., source=...)", None,
        ("equation", "signature", "confused_with", "shown_by", "source", "caveat", "variables",
         "remark"),
    ),
    "scope": (
        Scope, "Scope(Of.ROBOT, explains=..., lacks=..., terms=...)", Effect.scope,
        ("whole_robot", "jointless", "explains", "available", "terms"),
    ),
    "variation": (
        Variation, "PER_RUN", NEVER, ("per_run", "relative", "sudden", "belongs", "dated"),
    ),
    "relations": (
        Relations, "Relations(replaces=...)", Effect.relations,
        ("replaces", "twins", "limit", "foils", "state"),
    ),
    "search": (
        Search, "Grid(shapes), shapes(motion, j) a function", FIXED,
        ("grid", "across", "others", "carrier", "powers", "rounds", "refine",
         "ends_at_resolution", "spectral"),
    ),
    "limits": (
        tuple, "(Limit(code, met), BOUNDS)", Effect.limits, ("credible", "strict"),
    ),
    "traits": (
        Trait, "Trait.REPLAYED | ...", Trait.NONE,
        ("candidate", "uses_load", "motion_only", "replayed", "smooths", "correction", "geometry"),
    ),
}  # fmt: skip


def misdeclared(effect: Effect) -> str:
    """What is wrong with an effect's declaration and what to do; empty if nothing."""
    kind = type(effect)
    old = "; ".join(_old(kind))
    if old:
        return (
            f"{kind.__name__} is declared in the old way: {old} (docs/own-effects.md shows a "
            "whole one)"
        )
    missing = [name for name in NEEDED if not hasattr(kind, name)]
    if missing:
        return f"{kind.__name__} has no {', no '.join(missing)}; docs/own-effects.md shows one"
    for part, (expected, written, _, _) in PARTS.items():
        value = getattr(kind, part)
        if not isinstance(value, expected):
            return f"{kind.__name__}.{part} is {value!r}, expected {written}"
    if kind.shape and kind.search.grid is FIXED.grid:
        return f"{kind.__name__} has shape parameters but no grid: write search = Grid(shapes)"
    return ""


def _old(kind: type[Effect]) -> Iterator[str]:
    """Where attributes of an earlier declaration belong, part by part."""
    for part, (_, written, default, names) in PARTS.items():
        unset = getattr(kind, part, None) == default
        # a function of such a name may be what a part was made of
        found = [n for n in names if hasattr(kind, n) and (unset or not _callable(kind, n))]
        if found:
            listed = ", ".join(map(repr, found))
            yield f"{listed} belong{'s' if len(found) == 1 else ''} into {part} = {written}"


def _callable(kind: type[Effect], name: str) -> bool:
    return callable(getattr(kind, name))
