"""What these data cannot tell apart or could not show, why, and which motion would.

Two effects are one by structure or by this excitation, computed for this robot and model with the
fitted values: see `hil.excite.question`.

What a motion could not have shown is computed from the recorded motion, joint by joint, so that no
evidence for it is no evidence against it; each limit is one of mechanics:

- Stribeck friction acts at low speed.  Its excess over Coulomb friction, fading over a fiftieth of
  the top speed, is fitted beside everything else; what is smaller than  se sqrt(3 ln n)  (its
  price, n the effective instants) is not found: said where that is a tenth of Coulomb friction.
- Presliding and backlash act behind a reversal.  Each of the few states that are fitted needs
  several; below `FEW` reversals one odd one decides.
- What repeats or grows over position needs the range; the part that was not visited is unknown.
- Friction under load needs a load that changes otherwise than the acceleration.
- Warming takes minutes.
- Without a measured external force a gain of the effort is a unit of all parameters.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.attribution import overlap, physical
from hil.diagnosis.constants import (
    ABSORBED,
    CONFIDENT,
    CONFIDENT_ODDS,
    FEW,
    HALF,
    LITTLE,
    SAME_COSINE,
    TENTH,
    WARMING,
)
from hil.diagnosis.types import (
    EITHER,
    EXCITATION,
    STRUCTURAL,
    Candidate,
    Diagnosis,
    Evidence,
    Indistinguishable,
    Unseen,
)
from hil.errors import ConfigError
from hil.excite import choose
from hil.excite.choose import NO_MOTION, Choice, Foreseen, Survey, decide, measured, survey
from hil.excite.question import (
    Question,
    Rival,
    Stage,
    gram,
    in_context,
    model_words,
    output_words,
    robot_word,
    room,
    sharp,
    stage_of,
)
from hil.excite.trajectory import of_robot
from hil.identify.design import Term, head
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.models import catalogue
from hil.models.effect import Effect, Sight, Trait

FloatArray = NDArray[np.float64]
#: Unit of a shape value that is a speed.
_SPEED = "{x}/s"
#: Size in units of the noise that an effect gets which the base model absorbs.
PROBE = 10.0
#: Share of its largest column as which a column counts at least there.
UNSHOWN = 1e-6
#: Motions that decide whether what the whole robot does to the base can be seen at all.
RICH = ("multisine", "postures", "fast-strokes")
#: Rivals on one joint that are looked at together.
MAX_RIVALS = 6


# ------------------------------------------------------------ the motion that would


@dataclass
class Planner:
    """Finds the motion for any set of rivals beside one fit; each joint's menu is foreseen once.

    Parameters
    ----------
    result : FitResult
        The fit.
    evidence : Evidence
        Candidates beside it.
    """

    result: FitResult
    evidence: Evidence

    def __post_init__(self) -> None:
        self._seen: dict[tuple[tuple[str, int], ...], tuple[Survey, Question]] = {}
        #: Motions of a joint as the fit foresees them, whatever the rivals are.
        self._menus: dict[tuple[int | None, tuple[str, ...]], list[Foreseen]] = {}
        self._stage = _stage(self.result)
        #: Whether every motion of the menu was too long to foresee.
        self.unplanned = False

    def plan(self, among: tuple[Candidate, ...], pair: tuple[str, ...]) -> Choice | None:
        """Choice for a set of rivals among the candidates of one joint; None without a menu."""
        # a planned motion meets no force, so it says nothing of a force sensor
        among = tuple(c for c in among if not c.term.effect.scope.tip)
        if self._stage is None or not among or not set(pair) <= {c.name for c in among}:
            return None
        key = tuple((c.name, c.term.joint) for c in among)
        if key not in self._seen:
            self._seen[key] = self._look(among, self._stage)
        seen, question = self._seen[key]
        if not seen.motions:
            self.unplanned = True
            return None
        return decide(seen, question, pair)

    def _look(self, among: tuple[Candidate, ...], stage: Stage) -> tuple[Survey, Question]:
        result = self.result
        terms, theta = _base(result)
        base, v0 = sharp(terms, result.problem.motions[0].resolution)
        alone = stage.space.alone
        span = np.stack(
            [
                np.minimum(result.problem.span[:, 0], alone[:, 0]),
                np.maximum(result.problem.span[:, 1], alone[:, 1]),
            ],
            axis=1,
        )
        context = in_context(result.problem, v0, result.problem.motions[0].contact, span)
        question = _question(context, base, theta, result, self.evidence, among)
        known = gram(context, question)
        whole = all(c.term.effect.scope.whole for c in among)
        names = tuple(n for n in choose.MENU if not whole or n in RICH)
        joint = None if whole else among[0].term.joint
        if (joint, names) not in self._menus:
            self._menus[joint, names] = choose.menu(question, stage, joint, names)
        return survey(self._menus[joint, names], question, stage, known), question


def _stage(result: FitResult) -> Stage | None:
    """Where a motion could be played: within the robot's limits, else what was recorded."""
    if result.model.explains != "motor" or not room(result.problem):
        return None
    try:
        return stage_of(result.problem)
    except ConfigError:
        return None


def _base(result: FitResult) -> tuple[list[Term], FloatArray]:
    """Terms of the fit with their coefficients, but for those of single runs."""
    kept = [
        (t, result.theta[s])
        for t, s in zip(result.terms, result.slices, strict=True)
        if not t.per_run
    ]
    return [t for t, _ in kept], np.concatenate([x for _, x in kept] or [np.zeros(0)])


def _question(
    context: Problem,
    base: list[Term],
    theta: FloatArray,
    result: FitResult,
    evidence: Evidence,
    among: tuple[Candidate, ...],
) -> Question:
    """Question about some candidates with the coefficients that the data give them."""
    floor = evidence.floor
    # coloured noise: one independent instant in `inflation`
    noise = np.maximum(floor.scale * np.sqrt(floor.inflation), 1e-12)
    projector = Projector(context, base, result.sigma)
    rivals = [_rival(c, projector, noise) for c in among]
    return measured(base, theta, rivals, noise, context)


def _rival(c: Candidate, projector: Projector, noise: FloatArray) -> Rival:
    """A candidate with its coefficients; ten times the noise where the base absorbs it.

    Directions of which less than a thousandth is new are left out: what the recording hardly
    shows must not be extrapolated.
    """
    term = replace(c.term, per_run=False)
    columns = projector.weighted(term)
    size = np.linalg.norm(columns, axis=0)
    if c.absorbed > ABSORBED:
        rms = size / np.sqrt(len(columns)) * projector.sigma[term.joint]
        # what the recording does not show at all may be large, and not infinite
        seen = np.maximum(rms, UNSHOWN * float(rms.max(initial=0.0)))
        probe = np.full_like(rms, PROBE * noise[term.joint])
        return Rival(term, np.divide(probe, seen, out=np.zeros_like(rms), where=seen > 0))
    unit = columns / np.maximum(size, 1e-300)
    rows = projector.rows(term)
    inner = projector.inner(rows, unit)
    value, vector = np.linalg.eigh(unit.T @ unit - inner.T @ inner)
    keep = value > 1e-3
    right = vector[:, keep].T @ (unit.T @ projector.residual[rows])
    return Rival(term, (vector[:, keep] @ (right / value[keep])) / np.maximum(size, 1e-300))


#: A name, its rivals, and the number of its joint; -1 of the whole robot.
Undecided = tuple[str, list[str], int]


# ------------------------------------------------------------ indistinguishable sets


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
        Indistinguishable((name, "every other parameter"), why, catalogue.get(name).doc.shown_by)
        for name, why in evidence.impossible
        if Trait.GAIN in catalogue.get(name).traits
    ]
    late = [n for n, *_ in rivals if Trait.LATE in catalogue.get(n).traits]
    out += [
        Indistinguishable((late[0], name), why, catalogue.get(name).doc.shown_by)
        for name, why in evidence.impossible
        if late and Trait.LATE in catalogue.get(name).traits
    ]
    sets = _absorbed(evidence, {e for x in out for e in x.effects})
    for name, others, j in rivals:
        if others:
            every = "both" if len(others) == 1 else f"all {len(others) + 1}"
            where = f" of {result.problem.joints[j]}" if result is not None and j >= 0 else ""
            why = f"with this motion {every} explain the residual{where} almost equally well"
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
    doubles = {x for name in unsure for x in catalogue.get(name).doc.confused_with}
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
    standing = [s for s in sets if s.reason == STRUCTURAL and not concerned & set(s.effects)]
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
            partners = c.term.effect.doc.confused_with
            why = (
                f"the model's own parameters can imitate {100 * c.absorbed:.2f} % of it: "
                f"{c.name} only changes their values"
            )
            out.append(_Set((c,), (c.name, partners[0] if partners else "the base model"), why))
    return out


def _collinear(evidence: Evidence, known: list[_Set], named: set[str]) -> list[_Set]:
    """Pairs on one joint, one of them named, whose projected columns nearly coincide."""
    if evidence.projector is None:
        return []
    out: list[_Set] = []
    top = [
        c
        for c in evidence.candidates
        if c.score > 0 and c.absorbed < ABSORBED and physical(c, evidence.projector.problem)
    ][:8]
    seen = {frozenset((a, b)) for x in known for a in x.effects for b in x.effects}
    for a_index, a in enumerate(top):
        for b in top[a_index + 1 :]:
            same = a.name == b.name or frozenset((a.name, b.name)) in seen
            if a.term.joint != b.term.joint or same or not named & {a.name, b.name}:
                continue
            cosine = overlap(a, b, evidence.projector)
            if cosine > SAME_COSINE:
                seen.add(frozenset((a.name, b.name)))
                why = f"with this motion both have the same signature (cosine {cosine:.3f})"
                out.append(_Set((a, b), (a.name, b.name), why, True))
    return out


def _surely(odds: float) -> str:
    """Log odds of the right effect against the other as a probability, in words at its end."""
    sure = 1.0 / (1.0 + math.exp(-float(np.clip(odds, -700.0, 700.0))))
    text = f"{sure:.2f}"
    return text if text != "1.00" else "above 0.99"


def _planned(s: _Set, sets: list[_Set], planner: Planner | None) -> Indistinguishable | None:
    """The set with its reason and the motion that separates it best; None if it is told apart."""
    choice = None
    if planner is not None and len(s.among):
        some = _of_one_run(s.among, planner)
        group = _of_one_run(_group(s, sets), planner)
        choice = planner.plan(group, tuple(c.name for c in some))
    ways = [w for c in s.among for w in catalogue.get(c.name).doc.shown_by.split("; ")]
    shown = "; ".join(dict.fromkeys(ways))
    if choice is None or planner is None:
        reason = STRUCTURAL if len(s.among) == 1 else EXCITATION
        unplanned = planner is not None and planner.unplanned
        why = f"{s.why}; no motion was planned: each would take too long" if unplanned else s.why
        return Indistinguishable(s.effects, why, shown or s.effects[0], reason)
    if choice.structural:
        beyond = f"; beyond these limits: {shown}" if len(s.among) == 1 else ""
        why = f"{s.why}; {_structural(s, choice)}"
        return Indistinguishable(s.effects, why, NO_MOTION + beyond)
    if s.aside and choice.now is not None and choice.now.decided:
        return None
    return _by_motion(s, choice, planner)


def _of_one_run(among: tuple[Candidate, ...], planner: Planner) -> tuple[Candidate, ...]:
    """Rivals that one planned run can show: in it a value of every run is one of the model's own.

    What tells the others from the model tells them from it as well.
    """
    own = {t.key for t in planner.result.terms}
    some = tuple(c for c in among if not (c.term.per_run and c.term.key in own))
    return some or among


def _structural(s: _Set, choice: Choice) -> str:
    """Why no motion tells a set apart."""
    left = 100 * (1 - choice.everything.share)
    why = (
        f"in all motions of the menu together, the other still explains {left:.1f} % of its effort"
    )
    if f"{left:.1f}" == "100.0":
        who = "the model's own parameters explain" if len(s.among) == 1 else "the other explains"
        why = f"in all motions of the menu together, {who} all of it as well"
    unfelt = f"; its joints never feel {' or '.join(choice.unfelt)}" if choice.unfelt else ""
    return f"{why}{unfelt}"


def _group(s: _Set, sets: list[_Set]) -> tuple[Candidate, ...]:
    """All candidates in sets on the same joint, so that they share one question and survey."""
    if len(s.among) == 1:
        return s.among
    joint = s.among[0].term.joint
    alike = [x for x in sets if len(x.among) > 1 and x.among[0].term.joint == joint]
    every = {c.name: c for x in alike for c in x.among}
    few = len(every) <= MAX_RIVALS
    return tuple(every.values()) if few else s.among


def _by_motion(s: _Set, choice: Choice, planner: Planner) -> Indistinguishable:
    best, problem = choice.best, planner.result.problem
    if best.verdict.odds < CONFIDENT_ODDS:
        why = f"{s.why}; at this size no motion of the menu shows a difference"
        return Indistinguishable(s.effects, why, EITHER, EXCITATION)
    names = tuple(c.name for c in s.among)
    joint = problem.joints[s.among[0].term.joint]
    whole = all(c.term.effect.scope.whole for c in s.among)
    motion = best.motion.name
    doubt = choice.now is not None and not choice.now.decided
    now = f"; {_surely(choice.now.odds)} now" if choice.now and doubt else ""
    words = ["hil", "excite", robot_word(problem), "--for", ",".join(names)]
    words += model_words(c.term.effect for c in s.among)
    words += [] if whole else ["--joint", joint]
    command = shlex.join([*words, "--motion", motion, *output_words(problem)])
    where, about = "" if whole else f" of {joint}", choose.describe_motion(motion, problem.d)
    text = (
        f"{motion}{where}: {about} (confidence {_surely(best.verdict.odds)} expected{now}"
        + ("" if best.verdict.decided else "; not enough to decide, with the values fitted here")
        + ")"
    )
    why = f"{s.why}; another motion can separate them"
    if choice.now is not None and choice.now.decided:
        why = f"{s.why}: the difference is smaller than the accuracy of such laws on real parts"
    if choice.never:
        why += f" (but no motion tells {names[0]} from {' or '.join(choice.never)})"
    return Indistinguishable(s.effects, why, text, EXCITATION, motion, command)


def sets_of(d: Diagnosis) -> list[Indistinguishable]:
    """Indistinguishable sets of a diagnosis."""
    if d.sets is None:
        result = d.ladder[0].result if d.ladder else None
        place = {name: j for j, name in enumerate(result.problem.joints)} if result else {}
        named = [*d.findings, *d.partial]
        rivals = [(f.effect, f.rivals, place.get(f.joint or "", -1)) for f in named]
        d.sets = pairs(d.first, rivals, result)
    return d.sets


def at_issue_of(d: Diagnosis) -> tuple[list[Indistinguishable], list[Indistinguishable]]:
    """Sets that bear on the answer of a diagnosis, and those that hold whatever was recorded."""
    named = [(f.effect, f.rivals, f.confidence) for f in [*d.findings, *d.partial]]
    return at_issue(sets_of(d), concerned(named, d.first, d.last))


# ------------------------------------------------------------ what the motion could not show


def unseen(result: FitResult, evidence: Evidence) -> list[Unseen]:
    """What the fitted runs could not show; effects that the model has already are left out.

    Parameters
    ----------
    result : FitResult
        The last fit.
    evidence : Evidence
        Beside it.
    """
    problem = result.problem
    if result.model.explains != "motor":
        return []
    found: dict[tuple[tuple[str, ...], str], list[str]] = {}
    for j in np.flatnonzero(~problem.holds).tolist():
        there = {t.effect.name for t in result.terms if t.joint == j or t.effect.scope.whole}
        for effects, why in _of_joint(problem, j):
            new = tuple(e for e in effects if e not in there)
            if new:
                found.setdefault((new, why), []).append(problem.joints[j])
    out = [
        Unseen(effects, tuple(joints), why, _command(effects[0], problem, joints))
        for (effects, why), joints in found.items()
    ]
    return [*_low_speed(result, evidence), *out, *_of_all(problem)]


def _command(effect: str, problem: Problem, joints: Sequence[str]) -> str:
    """What plans a motion that shows an effect; empty where the robot's own motion cannot."""
    places = [problem.joints.index(name) for name in joints]
    loaded = any(np.any(m.static[:, places]) for m in problem.motions)
    if Sight.LOAD in catalogue.get(effect).doc.shown and not loaded:
        return ""
    where = ["--joint", joints[0]] if len(joints) == 1 and problem.d > 1 else []
    words = ["hil", "excite", robot_word(problem), "--for", effect, *where]
    return shlex.join([*words, *output_words(problem)])


def _low_speed(result: FitResult, evidence: Evidence) -> list[Unseen]:
    """Stribeck friction that would go unseen, over all joints with Coulomb friction."""
    problem, missed = result.problem, {}
    laws = [e for e in _showing(Sight.SLOW) if e.shape and e.shape[0].unit == _SPEED]
    present = {t.key for t in result.terms}
    for j in np.flatnonzero(~problem.holds).tolist():
        fc = _dry(result, j)
        unseen = [e for e in laws if (e.name, j) not in present] if fc > 0 else []
        share = max((_missed(result, evidence, e, j) / fc for e in unseen), default=0.0)
        if share > TENTH:
            missed[problem.joints[j]] = share
    if not missed:
        return []
    names = tuple(e.name for e in _showing(Sight.SLOW))
    why = (
        f"too little of the motion is slower than {100 * LITTLE:g} % of the top speed; friction "
        f"that rises only there is not seen{_up_to(max(missed.values()))}"
    )
    return [Unseen(names, tuple(missed), why, _command(laws[0].name, problem, list(missed)))]


def _showing(sight: Sight) -> list[Effect]:
    """Effects of a motor that only show where a recording has this, in the catalogue's order."""
    table = (e for e in catalogue.table().values() if "motor" in e.scope.explains)
    return [e for e in table if sight in e.doc.shown and Trait.GIVEN not in e.traits]


def _richest(sight: Sight) -> tuple[str, ...]:
    """Their names; what has most coefficients, hence shows most of it, first."""
    return tuple(e.name for e in sorted(_showing(sight), key=lambda e: -len(e.params)))


def _dry(result: FitResult, j: int) -> float:
    """Coulomb friction of joint j; zero without any."""
    for t in result.terms:
        if t.joint == j and Trait.DRY in t.effect.traits:
            found = result.values.get(f"{head(t.effect, j)}.{t.effect.params[0].name}")
            return found.value if found else 0.0
    return 0.0


def _up_to(share: float) -> str:
    """How much of Coulomb friction is missed, where that says anything."""
    return f" (up to {100 * share:.2g} % of Coulomb friction)" if share < 1.0 else ", however large"


def _missed(result: FitResult, evidence: Evidence, effect: Effect, j: int) -> float:
    """Excess of static friction that pays no more than its price [N m or N]; infinite if unseen."""
    problem, floor, projector = result.problem, evidence.floor, evidence.projector
    speed = np.abs(problem.qd[j][problem.live[j]])
    if projector is None or not speed.size:
        return 0.0
    vs = LITTLE * float(np.quantile(speed, 0.995))
    form = effect.search.grid(problem.motions[0], j)[0][1:]
    _, _, inverse, _ = projector.score(Term(effect, j, (vs, *form)))
    noise = (floor.scale[j] / result.sigma[j]) ** 2 * floor.inflation[j]
    instants = max(float(floor.effective(problem)[j]), 2.0)
    count = len(effect.params) + len(effect.shape)
    return float(np.sqrt(inverse[0, 0] * noise * count * np.log(instants)))


def _of_joint(problem: Problem, j: int) -> Iterator[tuple[tuple[str, ...], str]]:
    """Effects and reasons of one joint."""
    turns = _reversals(problem, j)
    if turns < FEW:
        yield _richest(Sight.REVERSALS), f"fewer than {FEW} reversals"
    limits = of_robot(problem.source)
    if limits is not None and np.ptp(problem.q[j]) < HALF * (limits.high[j] - limits.low[j]):
        yield _richest(Sight.RANGE), "less than half of its range was visited"
    if _steady(problem, j):
        yield _richest(Sight.LOAD), "its static and external load hardly change"


def _reversals(problem: Problem, j: int) -> int:
    """Changes of the direction of motion, standstill left out, within the runs."""
    count = 0
    for k in range(len(problem.recordings)):
        v = problem.qd[j][(problem.run == k) & problem.live[j]]
        count += int(np.sum(np.diff(np.sign(v[v != 0.0])) != 0))
    return count


def _steady(problem: Problem, j: int) -> bool:
    """Whether neither gravity, springs nor an external force change the load."""
    static = np.concatenate([m.static[:, j] + m.tau_ext[:, j] for m in problem.motions])
    size = float(np.sqrt(np.mean(problem.effort[j] ** 2)))
    return bool(np.std(static) < TENTH * size)


def _of_all(problem: Problem) -> list[Unseen]:
    """What concerns the whole robot."""
    out = []
    length = max(float(r.t[-1] - r.t[0]) for r in problem.recordings)
    if length < WARMING:
        why = f"the longest recording lasts {length:.3g} s; a drift over minutes would not show"
        out.append(Unseen(_richest(Sight.MINUTES), (), why))
    if not any(np.any(m.tau_ext) or np.any(m.wrench) for m in problem.motions):
        why = "no external force was measured; without it a gain scales all parameters alike"
        out.append(Unseen(_richest(Sight.FORCE), (), why))
    return out
