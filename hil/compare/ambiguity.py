"""What these data cannot tell apart, why, and which motion would."""

from __future__ import annotations

from dataclasses import dataclass

from hil.compare.attribute import overlap
from hil.compare.evidence import Candidate, Evidence
from hil.models import catalogue

#: Cosine between projected columns from which two effects count as one.
SAME = 0.98


@dataclass(frozen=True)
class Indistinguishable:
    """A set of effects that the data cannot separate."""

    effects: tuple[str, ...]
    why: str
    experiment: str


def pairs(evidence: Evidence, rivals: list[tuple[str, list[str]]]) -> list[Indistinguishable]:
    """Indistinguishable sets: structural, absorbed by the base, and by this excitation.

    Parameters
    ----------
    evidence : Evidence
        Candidates of one fit.
    rivals : list of (effect, rivals)
        Sets that attribution could not decide.
    """
    out = [
        Indistinguishable((name, "every other parameter"), why, _experiment(name))
        for name, why in evidence.impossible
        if name == "torque-gain"
    ]
    for c in evidence.candidates:
        if c.absorbed > 0.9999 and not any(c.name in x.effects for x in out):
            out.append(_absorbed(c))
    for name, others in rivals:
        if others:
            why = "both explain this residual nearly equally well with this motion"
            out.append(Indistinguishable((name, *others), why, _experiment(name)))
    out += _collinear(evidence, out, {n for name, others in rivals for n in (name, *others)})
    return out


def _absorbed(c: Candidate) -> Indistinguishable:
    partner = c.term.effect.confused_with[0] if c.term.effect.confused_with else "the base model"
    why = (
        f"its columns lie in the span of the parameters that are already free "
        f"({100 * c.absorbed:.2f} % absorbed): any {c.name} shows up as other parameter values"
    )
    return Indistinguishable((c.name, partner), why, _experiment(c.name))


def _collinear(
    evidence: Evidence, known: list[Indistinguishable], named: set[str]
) -> list[Indistinguishable]:
    """Pairs on one joint, one of them named, whose projected columns nearly coincide."""
    if evidence.projector is None:
        return []
    out: list[Indistinguishable] = []
    top = [c for c in evidence.candidates if c.score > 0 and c.absorbed < 0.9999][:8]
    seen = {frozenset(x.effects) for x in known}
    for a_index, a in enumerate(top):
        for b in top[a_index + 1 :]:
            same = a.name == b.name or frozenset((a.name, b.name)) in seen
            if a.term.joint != b.term.joint or same or not named & {a.name, b.name}:
                continue
            cosine = overlap(a, b, evidence.projector)
            if cosine > SAME:
                seen.add(frozenset((a.name, b.name)))
                why = f"with this motion their signatures coincide (cosine {cosine:.3f})"
                out.append(Indistinguishable((a.name, b.name), why, _experiment(a.name)))
    return out


def _experiment(name: str) -> str:
    return catalogue.get(name).shown_by
