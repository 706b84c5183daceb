"""What these data cannot tell apart, why, and which motion would."""

from __future__ import annotations

from dataclasses import dataclass

from hil.compare.attribute import physical
from hil.compare.candidate import Candidate
from hil.compare.evidence import Evidence
from hil.compare.experiment import ABSORBED, MOST, Planner
from hil.compare.rivals import overlap
from hil.excite import menu
from hil.excite.choose import Choice
from hil.excite.recorded import model_words, output_words, robot_word
from hil.identify.result import FitResult
from hil.identify.timing import LATE
from hil.models import catalogue

#: Cosine between projected columns from which two effects count as one.
SAME = 0.98
#: Confidence from which a name is one.
CONFIDENT = 0.75
#: Log odds below which a motion is as good as none.
SOME = 1.0
#: Why a set cannot be told apart.
STRUCTURAL, EXCITATION = "structural", "excitation"


@dataclass(frozen=True)
class Indistinguishable:
    """A set of effects that the data cannot separate.

    Parameters
    ----------
    effects : tuple of str
        The set.
    why, experiment : str
        Sentences for people.
    reason : str
        ``"structural"``: no motion of this robot would; ``"excitation"``: another motion would.
    motion, command : str
        Best motion of the menu and the command that makes it; empty where there is none.
    """

    effects: tuple[str, ...]
    why: str
    experiment: str
    reason: str = STRUCTURAL
    motion: str = ""
    command: str = ""


#: A name, its rivals, and the number of its joint; -1 of the whole robot.
Undecided = tuple[str, list[str], int]


@dataclass(frozen=True)
class _Set:
    """A set before anything is planned: candidates on one joint, and what is known of it."""

    among: tuple[Candidate, ...]
    effects: tuple[str, ...]
    why: str
    #: Whether nobody asked for it: then it is left out where what is recorded decides.
    aside: bool = False


def pairs(
    evidence: Evidence, rivals: list[Undecided], result: FitResult | None = None
) -> list[Indistinguishable]:
    """Indistinguishable sets: structural, absorbed by the base, and by this excitation.

    Parameters
    ----------
    evidence : Evidence
        Candidates of one fit.
    rivals : list of (effect, rivals, joint)
        Sets that attribution could not decide; the joint by its number, -1 of the whole robot.
    result : FitResult, optional
        That fit; without it nothing is planned.
    """
    out = [
        Indistinguishable((name, "every other parameter"), why, catalogue.get(name).shown_by)
        for name, why in evidence.impossible
        if name == "torque-gain"
    ]
    late = [n for n, *_ in rivals if n in LATE]
    out += [
        Indistinguishable((late[0], name), why, catalogue.get(name).shown_by)
        for name, why in evidence.impossible
        if name == "filter-lag" and late
    ]
    sets = _absorbed(evidence, {e for x in out for e in x.effects})
    for name, others, j in rivals:
        if others:
            every = "both" if len(others) == 1 else f"all {len(others) + 1}"
            where = f" of {result.problem.joints[j]}" if result is not None and j >= 0 else ""
            why = f"{every} explain this residual{where} nearly equally well with this motion"
            sets.append(_Set(_named(evidence, (name, *others), j), (name, *others), why))
    sets += _collinear(evidence, sets, {n for name, others, _ in rivals for n in (name, *others)})
    planner = Planner(result, evidence) if sets and result is not None else None
    planned = (_planned(s, sets, planner) for s in sets)
    return out + [x for x in planned if x is not None]


def concerned(named: list[tuple[str, list[str], float]], *evidence: Evidence) -> set[str]:
    """Effects that an answer is about: named, rivals, with evidence; doubles of unsure ones.

    `named` holds name, rivals and confidence of each.
    """
    unsure = [name for name, _, confidence in named if confidence < CONFIDENT]
    doubles = {x for name in unsure for x in catalogue.get(name).confused_with}
    evident = {c.name for e in evidence for c in e.candidates if c.score > 0}
    return {n for name, rivals, _ in named for n in (name, *rivals)} | doubles | evident


def at_issue(
    sets: list[Indistinguishable], concerned: set[str]
) -> tuple[list[Indistinguishable], list[Indistinguishable]]:
    """Sets that bear on this answer, and those that hold of the robot whatever was recorded.

    Parameters
    ----------
    sets : list of Indistinguishable
        All of them.
    concerned : set of str
        Effects that are named, in doubt, or have evidence for them.
    """
    standing = [
        s for s in sets
        if s.reason == STRUCTURAL and not concerned & set(s.effects)
    ]  # fmt: skip
    return [s for s in sets if s not in standing], standing


def _named(evidence: Evidence, names: tuple[str, ...], j: int) -> tuple[Candidate, ...]:
    """Best candidate of each name, on joint j, or else on that of the first, where it is there."""
    out: list[Candidate] = []
    for name in names:
        own = [c for c in evidence.candidates if c.name == name]
        where = out[0].term.joint if out else j
        out += ([c for c in own if c.term.joint == where] or own)[:1]
    return tuple(out)


def _absorbed(evidence: Evidence, known: set[str]) -> list[_Set]:
    out: list[_Set] = []
    for c in evidence.candidates:
        if c.absorbed > ABSORBED and c.name not in known:
            known.add(c.name)
            partners = c.term.effect.confused_with
            why = (
                f"parameters that are free already take up {100 * c.absorbed:.2f} % of what it "
                f"does: any {c.name} shows up as other values of theirs"
            )
            out.append(_Set((c,), (c.name, partners[0] if partners else "the base model"), why))
    return out


def _collinear(evidence: Evidence, known: list[_Set], named: set[str]) -> list[_Set]:
    """Pairs on one joint, one of them named, whose projected columns nearly coincide."""
    if evidence.projector is None:
        return []
    out: list[_Set] = []
    motion = evidence.projector.problem.motions[0]
    top = [
        c for c in evidence.candidates
        if c.score > 0 and c.absorbed < ABSORBED and physical(c, motion)
    ][:8]  # fmt: skip
    seen = {frozenset((a, b)) for x in known for a in x.effects for b in x.effects}
    for a_index, a in enumerate(top):
        for b in top[a_index + 1 :]:
            same = a.name == b.name or frozenset((a.name, b.name)) in seen
            if a.term.joint != b.term.joint or same or not named & {a.name, b.name}:
                continue
            cosine = overlap(a, b, evidence.projector)
            if cosine > SAME:
                seen.add(frozenset((a.name, b.name)))
                why = f"with this motion their signatures coincide (cosine {cosine:.3f})"
                out.append(_Set((a, b), (a.name, b.name), why, True))
    return out


def _planned(s: _Set, sets: list[_Set], planner: Planner | None) -> Indistinguishable | None:
    """The set with its reason and the motion that separates it best; None if it is told apart."""
    choice = None
    if planner is not None and len(s.among):
        names = tuple(c.name for c in s.among)
        choice = planner.plan(_group(s, sets), names)
    ways = [w for c in s.among for w in catalogue.get(c.name).shown_by.split("; ")]
    shown = "; ".join(dict.fromkeys(ways))
    if choice is None or planner is None:
        reason = STRUCTURAL if len(s.among) == 1 else EXCITATION
        return Indistinguishable(s.effects, s.why, shown or s.effects[0], reason)
    if choice.structural:
        why = (
            f"{s.why}; structural: after all motions of the menu together the other would still "
            f"imitate {100 * (1 - choice.everything.share):.1f} % of it"
        )
        if len(s.among) > 1:
            return Indistinguishable(s.effects, why, "no motion of this robot alone")
        return Indistinguishable(s.effects, why, f"no motion of this robot alone; {shown}")
    if s.aside and choice.now is not None and choice.now.decided:
        return None
    return _by_motion(s, choice, planner)


def _group(s: _Set, sets: list[_Set]) -> tuple[Candidate, ...]:
    """All candidates in sets on the same joint, so that the menu is foreseen once for them."""
    if len(s.among) == 1:
        return s.among
    joint = s.among[0].term.joint
    alike = [x for x in sets if len(x.among) > 1 and x.among[0].term.joint == joint]
    every = {c.name: c for x in alike for c in x.among}
    few = len(every) <= MOST
    return tuple(every.values()) if few else s.among


def _by_motion(s: _Set, choice: Choice, planner: Planner) -> Indistinguishable:
    best, problem = choice.best, planner.result.problem
    if best.verdict.odds < SOME:
        why = f"{s.why}; as large as it is here, no motion of the menu shows a difference"
        return Indistinguishable(s.effects, why, "the same effect, larger", EXCITATION)
    names = tuple(c.name for c in s.among)
    joint = problem.joints[s.among[0].term.joint]
    whole = all(c.term.effect.whole_robot for c in s.among)
    motion = best.motion.name
    now = "" if choice.now is None else f", {choice.now.odds:.1f} now"
    words = ["hil", "excite", robot_word(problem), "--for", ",".join(names)]
    words += model_words(c.term.effect for c in s.among)
    words += [] if whole else ["--joint", joint]
    command = " ".join([*words, "--motion", motion, *output_words(problem)])
    where = "" if whole else f" of {joint}"
    text = (
        f"{motion}{where}: {menu.describe(motion)} (log odds {best.verdict.odds:.1f} foreseen{now}"
        + ("" if best.verdict.decided else "; with the values fitted here too little to decide")
        + f"): {command}"
    )
    why = f"{s.why}; it is this excitation, not the structure"
    if choice.now is not None and choice.now.decided:
        why = f"{s.why}: they differ by less than real parts depart from such laws"
    if choice.never:
        why += f" (but no motion tells {names[0]} from {' or '.join(choice.never)})"
    return Indistinguishable(s.effects, why, text, EXCITATION, motion, command)
