"""What a candidate, and a refitted model with it, must pass: a registry of checks.

Each rule is a function of one case; it returns the reason why the case fails, or nothing.  The
search asks them in order and keeps the first reason.  `hil bench diagnosis --ablate` runs the
benchmark without each of them in turn: a rule that flips no answer goes, unless it protects what
the plans do not hold and a test does (`PROVOKED`).  What the last model says of the names that were
found comes at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.attribution import (
    Named,
    alone,
    by_chance,
    effort,
    forbidden,
    harmonic,
    kindred,
    ripples,
    why_not,
)
from hil.diagnosis.candidates import Rated
from hil.diagnosis.constants import (
    ADEQUATE,
    BEYOND,
    CERTAIN,
    DISCREPANCY,
    HALF,
    LEVEL,
    LITTLE,
    OPEN,
    RISEN,
    RUINED,
    TENTH,
    WORTH,
)
from hil.diagnosis.evidence import in_time
from hil.diagnosis.floor import practical
from hil.diagnosis.grams import Split, levels, parts
from hil.diagnosis.preconditions import upwards
from hil.diagnosis.types import Candidate, CheckResult, Evidence, Finding
from hil.identify.design import Term, head
from hil.identify.gauss_newton import complete
from hil.identify.regression import inflation
from hil.identify.result import FitResult
from hil.models.effect import SOLID, Trait, Waves

if TYPE_CHECKING:
    from hil.diagnosis.remodel import Visited
    from hil.diagnosis.search import Search
    from hil.identify.problem import Problem


@dataclass(frozen=True)
class RuleCase:
    """A candidate beside the present model."""

    search: Search
    rated: Rated
    evidence: Evidence


@dataclass(frozen=True)
class Refit:
    """A candidate after everything was fitted again with it."""

    search: Search
    rated: Rated
    before: Visited
    after: Visited


#: A case before a fit or after one.
_Asked = TypeVar("_Asked", RuleCase, Refit)
CANDIDATE: dict[str, Callable[[RuleCase], str]] = {}
FIT: dict[str, Callable[[Refit], str]] = {}
#: Codes of rules that are not asked: for the ablation alone.
OFF: set[str] = set()
#: What two rules say.
INACCURATE = "it may be an inaccuracy of the laws named before"
#: Rules without which no answer of the quick plans changes, and the tests that fail without them.
PROVOKED = {
    "detected": "tests/diagnosis/test_rules.py",
    "physical": "tests/diagnosis/test_rules.py",
    "paired": "tests/diagnosis/test_rules.py",
    "geometry": "tests/diagnosis/test_rules.py",
    "kindred": "tests/models/test_composed.py",
    "overtone": "tests/diagnosis/test_overtones.py",
    "keeps-gain": "tests/diagnosis/test_rules.py",
    "never-rises": "tests/diagnosis/test_rules.py",
    "robs": "tests/diagnosis/test_rules.py",
    "transfers": "tests/diagnosis/test_rules.py",
    "simulates": "tests/diagnosis/test_rules.py",
    "coefficients": "tests/diagnosis/test_position_noise.py",
    "scales": "tests/models/test_composed.py",
}


def _candidate(code: str) -> Callable[[Callable[[RuleCase], str]], Callable[[RuleCase], str]]:
    def add(rule: Callable[[RuleCase], str]) -> Callable[[RuleCase], str]:
        CANDIDATE[code] = rule
        return rule

    return add


def _fit(code: str) -> Callable[[Callable[[Refit], str]], Callable[[Refit], str]]:
    def add(rule: Callable[[Refit], str]) -> Callable[[Refit], str]:
        FIT[code] = rule
        return rule

    return add


def stopped(case: RuleCase) -> CheckResult | None:
    """The first rule that stops a candidate."""
    return _first(case, CANDIDATE, "candidate")


def refused(r: Rated, before: CheckResult | None = None) -> CheckResult:
    """What the search says of a candidate that it has fitted `before`, and why it did not stay."""
    fell = before is not None and before.stage == "fit"
    why = before.reason if before and fell else "it was fitted and did not stay beside the others"
    return CheckResult("refused", "fit" if fell else "candidate", why, _numbers(r))


def fails(case: Refit, only: Sequence[str] = ()) -> CheckResult | None:
    """The first rule, of all or of some, that a refitted model with a candidate fails."""
    return _first(case, {k: rule for k, rule in FIT.items() if k in (only or FIT)}, "fit")


def stage(code: str) -> str:
    """When a rule is asked: ``"candidate"`` before a fit, ``"fit"`` after one."""
    return "candidate" if code in CANDIDATE else "fit"


@contextmanager
def without(*codes: str) -> Iterator[None]:
    """Do not ask some rules for a while."""
    before = set(OFF)
    OFF.update(codes)
    try:
        yield
    finally:
        OFF.clear()
        OFF.update(before)


def _first(
    case: _Asked, rules: Mapping[str, Callable[[_Asked], str]], when: str
) -> CheckResult | None:
    """The first rule that stops a case, noted in the search: alone if no later one would."""
    asked = ((k, rule(case)) for k, rule in rules.items() if k not in OFF)
    reasons = ((k, reason) for k, reason in asked if reason)
    code, reason = next(reasons, ("", ""))
    if not code:
        return None
    fired = case.search.fired
    # what another rule stops as well is stopped without this one
    fired[code] = fired.get(code, False) or next(reasons, None) is None
    return CheckResult(code, when, reason, _numbers(case.rated))


def _numbers(r: Rated) -> dict[str, float]:
    return {"before": r.before, "after": r.after, "standard_errors": r.sureness}


# ---------------------------------------------------------------------- before a fit with it


@_candidate("detected")
def _detected(case: RuleCase) -> str:
    """Family-wise, by sign flips of blocks of noise."""
    if case.rated.candidate.p_value <= LEVEL:
        return ""
    return "by chance, the best of all candidates would explain as much"


@_candidate("worth")
def _worth(case: RuleCase) -> str:
    r = case.rated
    return "" if r.after < (1 - WORTH) ** 2 * r.before else "the held-out error hardly falls"


@_candidate("practical-size")
def _practical(case: RuleCase) -> str:
    r, problem = case.rated, case.search.problem
    size = float(problem.rms(problem.effort)[r.joint])
    if r.removed > (practical(problem) * size) ** 2:
        return ""
    return "it explains less than the accuracy of the efforts"


@_candidate("discrepancy")
def _discrepancy(case: RuleCase) -> str:
    """Laws that were named before miss their effects by a share of what they explain.

    No name is given to that; a correction may take it.  Friction is no inaccuracy of a mass or a
    spring: those are laws of posture and acceleration, which dissipate nothing, and smooth ones, so
    that a ripple over the position is none either.  Nor is what halves the error, down to the noise
    floor or to a tenth of what is above it: no other law fits what a law misses so well, but for a
    series over its variable.
    """
    r = case.rated
    if Trait.CORRECTION in r.candidate.term.effect.traits:
        return ""
    small = r.removed <= inaccuracy(case.search, r.candidate, r.joint, r.before)
    return INACCURATE if small and not _does_all(r, r.before, r.after, case.evidence) else ""


def _does_all(r: Rated, before: float, after: float, evidence: Evidence) -> bool:
    """Whether a law that is no series takes the error of its joint to the floor."""
    series = Trait.SERIES in r.candidate.term.effect.traits
    return not series and to_the_floor(before, after, r.joint, evidence)


def to_the_floor(before: float, after: float, j: int, evidence: Evidence) -> bool:
    """Whether a fall of the squared error of joint j is to its floor, but for a tenth."""
    floor = evidence.floor
    now = np.zeros(len(floor.rms))
    now[j] = max(after, 0.0) ** 0.5
    nearly = before - after > (1 - TENTH) * (before - float(floor.rms[j]) ** 2)
    return after < HALF**2 * before and (nearly or not floor.exceeded(now, j))


def inaccuracy(search: Search, c: Candidate, j: int, without: float) -> float:
    """Mean square error of joint j by which all laws but a candidate may err.

    `without`: what they leave.
    """
    explained = float(search.base.errors.power[j]) - without
    if c.term.effect.variation.timed(c.term.shape) and _steady(search.problem, j):
        # what a law of the motion misses comes again with the motion
        explained -= search.of_motion(j)
    elif c.term.effect.family == "friction" or ripples(c.term, search.problem):
        explained -= search.of_conservative(j)
    return DISCREPANCY * max(explained, 0.0)


def _steady(problem: Problem, j: int) -> bool:
    """Whether joint j moves about as fast in every third of all runs.

    Where a chirp or a ramp does not, what a law of the motion misses follows the time as well.
    """
    for k in range(len(problem.recordings)):
        speed = problem.qd[j, problem.run == k]
        for x in (speed, np.diff(speed)):
            power = [float(np.mean(part**2)) for part in np.array_split(x, 3)]
            if min(power) < HALF**2 * max(power):
                return False
    return True


@_candidate("physical")
def _physical(case: RuleCase) -> str:
    return why_not(case.rated.candidate, case.search.problem)


@_candidate("position-noise")
def _smoother(case: RuleCase) -> str:
    noise = case.rated.candidate.smoother
    return "it only smooths the noise of the positions" if noise else ""


@_candidate("blurred-sign")
def _blurred(case: RuleCase) -> str:
    blurred = case.rated.candidate.blurred
    return "it explains a filter artifact at reversals" if blurred else ""


@_candidate("late")
def _late(case: RuleCase) -> str:
    good = in_time(case.rated.candidate, case.search.now.result)
    return "" if good else "the slow motion does not confirm that the effort is late"


@_candidate("line")
def _line(case: RuleCase) -> str:
    good = alone(case.rated.candidate, case.evidence, case.search.now.result)
    return "" if good else "it is one spectral line among many: a side effect of another cause"


@_candidate("geometry")
def _geometry(case: RuleCase) -> str:
    may_be = may_be_gravity(case.search, case.rated)
    return "gravity of an unknown geometry would explain it as well" if may_be else ""


def may_be_gravity(search: Search, r: Rated) -> bool:
    """Without a robot description springs and masses are names for what gravity may be.

    What takes most of what sums of sines and cosines leave on its joint is no gravity.  Nor is it
    along a slide where the slide's own position sets it.
    """
    effect, j = r.candidate.term.effect, r.joint
    if search.problem.robot.units[j] != "rad":
        return False
    if Trait.CORRECTION in effect.traits or not search.blind or effect.family not in SOLID:
        return False
    there = [t for t in search.now.result.terms if t.joint == j]
    learnt = any(Trait.GEOMETRY in t.effect.traits for t in there)
    return not (learnt and r.after < OPEN**2 * r.before)


@_candidate("kindred")
def _kindred(case: RuleCase) -> str:
    c = case.rated.candidate
    near = any(kindred(c, f) for f in case.search.found)
    return "another form of the same cause is in the model" if near else ""


@_candidate("overtone")
def _overtone(case: RuleCase) -> str:
    c, search = case.rated.candidate, case.search
    unnamed = Trait.CORRECTION in c.term.effect.traits
    if unnamed or case.evidence.projector is None:
        return ""
    return harmonic(c, search.found, search.problem.motions[0], case.evidence.projector)


@_candidate("paired")
def _paired(case: RuleCase) -> str:
    term = case.rated.candidate.term
    r = case.rated
    # what acts in a few stretches only spreads its own gains: one that takes most is sure earlier
    least = RISEN if r.after < OPEN * r.before else BEYOND
    sure = r.sureness > least or term.effect.variation.dated(term.shape)
    return "" if sure else "the gain varies too much from block to block"


@_candidate("beyond-chance")
def _beyond(case: RuleCase) -> str:
    """N log(before / after) > m log N + 2 log(family).

    N tested instants less what their correlation takes (of a law beyond any doubt what it takes
    from that law), m values to fit beyond those that are replaced, `family` candidates of its
    joint.  A correction states no law: that it foretells blocks that were left out, by their paired
    differences, is all that it claims.

    Source: Schwarz, Ann. Statist. 6, 1978.
    """
    r, search = case.rated, case.search
    if Trait.CORRECTION in r.candidate.term.effect.traits:
        return ""
    problem, j = search.problem, r.joint
    tested = float(r.now.count[:, j].sum())
    left, now = r.residual(j), r.given(j)
    # of many fast laws that are tried in a slow remainder one is soon the best
    law = now - left if r.sureness > CERTAIN else None
    count = max(tested / inflation(left, problem.run, law), 2.0)
    gain = count * np.log(r.before / max(r.after, 1e-300))
    net = max(r.candidate.dof - search.replaced(r.candidate), 1)
    family = sum(c.joint == j for c in case.evidence.candidates)
    price = net * np.log(count) + 2 * np.log(max(family, 2))
    return "" if gain > price else "too few independent instants show it: it may be chance"


@_candidate("at-floor")
def _at_floor(case: RuleCase) -> str:
    """A joint whose error is at its floor lacks nothing that lowers it by less than a tenth.

    That is how well a floor is known; what does more shows that the floor holds it.  Held-out runs
    have the last word, where there are some: they may be above theirs.  An effect at the tip has
    so many coefficients on so many joints that it finds something in any floor: the error must be
    above it by a tenth more, and it is no matter how much of it such an effect takes.
    """
    r, search, j = case.rated, case.search, case.rated.joint
    effect, held = r.candidate.term.effect, search.now.step.heldout
    large = r.after < (1 - TENTH) ** 2 * r.before
    if Trait.CORRECTION in effect.traits or (large and not effect.scope.tip):
        return ""
    own = search.now.result.rms
    rms = own if held.kind != "holdout" else np.maximum(held.rms, own)
    rms = rms / ADEQUATE if effect.scope.tip else rms
    met = not case.evidence.floor.exceeded(rms, j)
    return "the error of its joint is at the noise floor" if met else ""


@_candidate("returned-noise")
def _returned(case: RuleCase) -> str:
    """At the floor: where position noise fed back by the controller explains more, it is that."""
    r, result = case.rated, case.search.now.result
    if case.evidence.floor.exceeded(result.rms, r.joint):
        return ""
    more = [
        c
        for c in case.evidence.candidates
        if c.joint == r.joint and c.parts[r.joint] > r.candidate.parts[r.joint]
    ]
    late = any(not in_time(c, result) for c in more)
    return "position noise fed back by the controller explains more" if late else ""


# ---------------------------------------------------------------------- after a fit with it


@_fit("keeps-gain")
def _keeps(case: Refit) -> str:
    j = case.rated.joint
    old, new = case.before.errors.power[j], case.after.errors.power[j]
    kept = new < (1 - WORTH / 2) ** 2 * old
    return "" if kept else "the error does not fall once all parameters are fitted again"


@_fit("outgrows")
def _outgrows(case: Refit) -> str:
    """The same as `_discrepancy`, of what it takes once everything is fitted again."""
    c, search, j = case.rated.candidate, case.search, case.rated.joint
    if Trait.CORRECTION in c.term.effect.traits or search.last is None:
        return ""
    old, new = (float(x.errors.power[j]) for x in (case.before, case.after))
    small = old - new <= inaccuracy(search, c, j, old)
    return INACCURATE if small and not _does_all(case.rated, old, new, search.last) else ""


@_fit("never-rises")
def _rises(case: Refit) -> str:
    """A model that is worse on held-out runs, on any joint and beyond chance, is no rung.

    What stays below the practical size is not worse.
    """
    problem, after = case.search.problem, case.after.step.heldout
    moves = np.flatnonzero(~problem.holds).tolist()
    return case.before.step.heldout.risen(after, case.rated.joint, moves, practical(problem))


@_fit("confirmed")
def _confirmed(case: Refit) -> str:
    """Held-out runs must show it, too; not what acts at instants of the fitted ones."""
    one, other, r = case.before.step.heldout, case.after.step.heldout, case.rated
    term = r.candidate.term
    if one.kind != "holdout" or term.effect.variation.dated(term.shape) or term.per_run:
        return ""
    return "" if other.gain(one, r.joint) > RISEN else "held-out runs do not show it"


@_fit("robs")
def _robs(case: Refit) -> str:
    """A correction leaves their efforts to the effects whose names stand."""
    if Trait.CORRECTION not in case.rated.candidate.term.effect.traits:
        return ""
    efforts = [
        {t.key: effort(rung.result, t.key) for t in rung.result.terms}
        for rung in (case.before, case.after)
    ]
    names = [key for key in case.search.standing if key in efforts[0]]
    robbed = [key for key in names if efforts[1].get(key, 0.0) < (1 - HALF) * efforts[0][key]]
    return f"it replaces {robbed[0][0]}" if robbed else ""


@_fit("transfers")
def _transfers(case: Refit) -> str:
    """A correction must serve every part of the recording by what the others say.

    No law keeps it from following what is special to one part; neighbouring blocks share that.  It
    must lower the error of its joint, and on each part that of the robot, in shares of the efforts,
    or raise it there by next to nothing beside what all parts gain: by chance all of five parts are
    better once in thirty times.  Of several runs those of little effort must be served by those of
    much, and the other way round.
    """
    traits = case.rated.candidate.term.effect.traits
    if Trait.CORRECTION not in traits or case.before.step.heldout.kind != "folds":
        return ""
    j, search = case.rated.joint, case.search
    size = search.problem.rms(search.problem.effort)
    silent = search.problem.holds | (size == 0.0)
    weight = np.where(silent, 0.0, 1.0 / np.where(silent, 1.0, size) ** 2)
    dealings: dict[str, Split | None] = {"part of the recording": parts(search.split)}
    # no run determines the coefficients that another one has of its own
    if not any(t.per_run for t in case.after.result.terms):
        dealings["level of effort"] = levels(search.problem, search.split)
    for what, dealt in dealings.items():
        if dealt is not None:
            old, new = (search.parted(x.result, dealt) for x in (case.before, case.after))
            fall = (old - new) @ weight
            if new[:, j].sum() >= old[:, j].sum() or np.any(fall <= -LITTLE * fall.sum()):
                return f"it does not hold from one {what} to the next"
    return ""


@_fit("coefficients")
def _coefficients(case: Refit) -> str:
    key = case.rated.candidate.term.key
    nothing = by_chance(case.after.result, key)
    return "its coefficients are not larger than their scatter over blocks" if nothing else ""


@_fit("scales")
def _scales(case: Refit) -> str:
    """A time, a width or a frequency that is less than its standard error is not determined.

    Nor is the period of a wave that is longer than what the motion can show, or a value at the end
    of its range beside a sign that is as blunt as can be, unless next to nothing is left beside it:
    both follow together what neither is.
    """
    result, key = case.after.result, case.rated.candidate.term.key
    term = next((t for t in result.terms if t.key == key), None)
    if term is None:
        return ""
    start = head(term.effect, term.joint)
    for p in term.effect.shape:
        v = result.values.get(f"{start}.{p.name}")
        if v is None or not p.size:
            continue
        if v.stderr > abs(v.value):
            return f"its {p.text} is not determined"
        ends = isinstance(term.effect.search, Waves) or _bluntest(result, term.joint)
        if v.at_bound and ends and _leaves_much(case):
            return f"its {p.text} is at the limit of what this motion can show"
    return ""


def _bluntest(result: FitResult, j: int) -> bool:
    """Whether the sign of joint j's friction turns over the widest speed that it may."""
    signs = [t for t in result.terms if t.joint == j and Trait.DRY in t.effect.traits]
    names = [f"{head(t.effect, j)}.{t.effect.shape[0].name}" for t in signs]
    return any(result.values[n].at_bound for n in names if n in result.values)


def _leaves_much(case: Refit) -> bool:
    """Whether a model leaves more than a tenth of what a joint's squared error has above its floor.

    Where no floor is known, of all of it.
    """
    j, first = case.rated.joint, case.search.first
    least = 0.0 if first is None else float(first.floor.rms[j]) ** 2
    before, after = (float(x.errors.power[j]) - least for x in (case.before, case.after))
    return after > TENTH * max(before, 0.0)


@_fit("allowed")
def _lawful(case: Refit) -> str:
    result, key = case.after.result, case.rated.candidate.term.key
    term = next((t for t in result.terms if t.key == key), None)
    return "" if term is None else forbidden(result, term)


@_fit("simulates")
def _simulates(case: Refit) -> str:
    """A correction must not ruin the simulated motion: no law keeps its function from swinging."""
    if Trait.CORRECTION not in case.rated.candidate.term.effect.traits:
        return ""
    if case.after.result.model.explains != "motor":
        return ""
    old, new = case.search.simulated(case.before), case.search.simulated(case.after)
    moves = np.flatnonzero(~case.search.problem.holds).tolist()
    # what leaves the range in some windows has so much scatter in the others that no rise is sure
    leaves = new.diverged - old.diverged > TENTH * new.windows
    worse = leaves or any(new.rises(old, j, RUINED) for j in moves)
    return "it makes the simulated motion much worse" if worse else ""


# ---------------------------------------------------------------------- after all fits


#: How the reason begins why a name is doubtful beside a geometry that was not learnt.
OF_GEOMETRY = "without a robot description it may be gravity or the coupling of the joints"
#: Beside masses that are none; or why one is that paid only until the others were found, or was
#: allowed until then.
_UPWARDS = "beside it the gravity of {} acts upwards, as no masses of the links do"
_UNSHOWN = "in the end, the error of the held-out data does not fall with it"
_OUTGROWN = "beside the others it has values that its law does not allow: "
_UNKNOWN = "none of its values is determined"
_CORNERED = "more is missing there, and a value lies at the end of what was searched: "
#: How reasons begin that stay, whatever becomes of a name's rivals.
DOUBTS = (OF_GEOMETRY, _UPWARDS.partition("{")[0], _UNSHOWN, _OUTGROWN, _UNKNOWN, _CORNERED)


def doubted(
    every: list[Finding],
    named: Sequence[Named],
    search: Search,
    over: NDArray[np.bool_],
    left: NDArray[np.bool_],
) -> list[Finding]:
    """Findings, of which those have even odds at most that the last model makes doubtful.

    Parameters
    ----------
    every : list of Finding
        What was found.
    named : sequence of Named
        The same as candidates.
    search : Search
        With its last model; knows whether the geometry is known.
    over : ndarray (d,)
        Joints on which something is missing.
    left : ndarray (d,)
        Joints whose error is above the noise floor, on the fitted runs or on the held-out ones.
    """
    end = search.now.result
    every = _shapeless(_weightless(every, named, end), search, over)
    return _cornered(_outlived(every, named, end), named, end, left)


def _weightless(every: list[Finding], named: Sequence[Named], result: FitResult) -> list[Finding]:
    """Findings, of which laws of posture are doubtful beside masses that are none.

    What holds a joint, or the tip, and gravity make up for each other there: that the fit gives
    gravity against the description shows that the law is another one.
    """
    against = upwards(result)
    out = []
    for f, n in zip(every, named, strict=True):
        effect = n.candidate.term.effect
        felt = bool(against) if effect.scope.whole else n.candidate.joint in against
        if felt and effect.family in (*SOLID, "contact"):
            names = ", ".join(result.problem.joints[j] for j in against)
            why = _UPWARDS.format(names)
            f = replace(f, confidence=min(f.confidence, HALF), reason=why)
        out.append(f)
    return out


def _outlived(every: list[Finding], named: Sequence[Named], end: FitResult) -> list[Finding]:
    """Findings, of which those are doubtful that the last model no longer bears out.

    What paid when it was found may have been left by shapes that the others had then.  What acts at
    instants of the fitted runs, or in some of them, need not be seen elsewhere.
    """
    last = {t.key: t for t in end.terms}
    out = []
    for f, n in zip(every, named, strict=True):
        term, varies = n.candidate.term, n.candidate.term.effect.variation
        elsewhere = varies.dated(term.shape) or (term.per_run and not varies.own(term.shape))
        why = "" if elsewhere or f.relative_after < f.relative_before else _UNSHOWN
        if not why and (says := _forbidden(end, last.get(term.key))):
            why = f"{_OUTGROWN}{says}"
        values = [v for v in f.parameters.values() if v.identifiable and v.stderr > 0.0]
        if not why and values and all(abs(v.value) <= v.stderr for v in values):
            why = _UNKNOWN
        if why and f.confidence > 0.0:
            # what raises an error is no finding
            rose = why == _UNSHOWN and f.relative_after > (1 + WORTH / 2) * f.relative_before
            f = replace(f, confidence=0.0 if rose else min(f.confidence, HALF), reason=why)
        out.append(f)
    return out


def _forbidden(end: FitResult, term: Term | None) -> str:
    """Why an effect's own law does not allow its values in the end; empty if it does.

    Coefficients are less sure than beside a given shape where the shape is not: that is asked only
    if it may matter, for it takes as long as a fit.
    """
    says = "" if term is None else forbidden(end, term)
    return forbidden(complete(end), term) if says and term is not None else ""


def _cornered(
    every: list[Finding], named: Sequence[Named], end: FitResult, left: NDArray[np.bool_]
) -> list[Finding]:
    """Findings, of which those are doubtful whose shape would go on beyond what it may be.

    Where the error is above the noise floor beside it, another law is meant, which this one follows
    as far as it can.
    """
    out = []
    for f, n in zip(every, named, strict=True):
        effect, j = n.candidate.term.effect, n.candidate.joint
        start = head(effect, n.candidate.term.joint)
        shapes = {f"{start}.{p.name}": p.text for p in effect.shape if not p.choice}
        ends = [x for k, x in shapes.items() if k in end.values and end.values[k].at_bound]
        if ends and left[j]:
            why = f"{_CORNERED}{ends[0]}"
            f = replace(f, confidence=min(f.confidence, HALF), reason=why)
        out.append(f)
    return out


def _shapeless(every: list[Finding], search: Search, over: NDArray[np.bool_]) -> list[Finding]:
    """Findings, which are doubtful where an unknown geometry was not learnt down to the noise.

    Gravity and the coupling of the joints act on all of them: what the sums in their place leave on
    one joint may be what a law was named for on another.  Axes that all slide have neither.
    """
    problem = search.problem
    turning = any(unit == "rad" for unit in problem.robot.units)
    if not (search.blind and turning and np.any(over)):
        return every
    names = ", ".join(problem.joints[j] for j in np.flatnonzero(over).tolist())
    why = f"{OF_GEOMETRY}, as the error of {names} above the noise floor may be"
    return [replace(f, confidence=HALF, reason=why) if f.confidence > HALF else f for f in every]
