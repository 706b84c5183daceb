"""The report's last words: what the data cannot tell apart, and what to measure next."""

from __future__ import annotations

from hil.compare import advice
from hil.compare.ambiguity import Indistinguishable, at_issue, concerned
from hil.compare.material import COMPARED, Material
from hil.compare.page import folded, items, paragraph, section, table
from hil.compare.words import LEADING


def further(m: Material) -> str:
    """What the data cannot tell apart, and which motion would."""
    parts = []
    named = [(f.effect, f.rivals, f.confidence) for f in (*m.findings, *m.partial)]
    sets, standing = at_issue(m.sets, concerned(named, m.first, m.last))
    if sets:
        parts.append(_sets(sets))
    elif m.verdict != COMPARED:
        parts.append(paragraph("No two of the plausible effects coincide with this motion."))
    if m.unseen:
        parts += [paragraph("What this motion could not show:"), items([u.text for u in m.unseen])]
    steps = [f"{f.effect}: {advice.shown_by(f.effect)}" for f in (*m.findings, *m.partial)]
    if steps:
        parts += [paragraph("What to measure next, to confirm each effect:"), items(steps)]
    notes = [
        text for code, text in m.warnings
        if m.verdict != "not-identifiable"
        and not code.startswith("impossible") and code not in LEADING
    ]  # fmt: skip
    if notes:
        parts += ["<h3>Notes</h3>", items(notes)]
    if standing:
        names = "; ".join(f"{s.effects[0]} from {', '.join(s.effects[1:])}" for s in standing)
        parts.append(folded(f"No motion alone tells apart: {names}", _sets(standing)))
    return section("What these data cannot tell apart, and what to measure next", *parts)


def _sets(sets: list[Indistinguishable]) -> str:
    rows = [[" / ".join(s.effects), s.why, s.experiment] for s in sets]
    return table(["effects", "why", "motion that would show it"], rows, (0, 1, 2))
