"""Names of what the search has found: exchanged for better ones, weighed, and raced.

Every other effect of a joint is tried in the place of each one that was found, beside all the rest.
What cannot be told from it is its rival, and free functions without a name run against it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil import work
from hil.diagnosis import artefacts, rules
from hil.diagnosis.attribution import (
    Named,
    as_use,
    beyond,
    choose,
    described_odds,
    kindred,
    likelier,
    may_be,
    overlap,
    physical,
    pliable,
    twins,
)
from hil.diagnosis.candidates import (
    Rated,
    drawn_best,
    paired,
    rate,
    simplest,
    tried,
)
from hil.diagnosis.constants import (
    ABSORBED,
    CERTAIN,
    DISCREPANCY,
    HALF,
    RISEN,
    RIVAL,
    SAME_COSINE,
    SURE,
    TENTH,
    WORTH,
)
from hil.diagnosis.evidence import (
    in_time,
    priced,
    terms_to_try,
)
from hil.diagnosis.floor import practical
from hil.diagnosis.grams import BlockErrors
from hil.diagnosis.remodel import Visited, let_go, missed, reverted, without
from hil.diagnosis.search import Search
from hil.diagnosis.types import Candidate, describe, ranking
from hil.identify.context import lend_load, renew
from hil.identify.design import Term, replaced
from hil.identify.projector import Projector
from hil.models.effect import Effect, Lines
from hil.models.model import RobotModel

FloatArray = NDArray[np.float64]
#: Other effects that a search starts from in the place of one, and exchanges one after another.
STARTS, ROUNDS = 2, 5
#: Rules of a fit in which one effect takes the place of another that leaves as much.
ALLOWED = ("coefficients", "scales", "allowed")
#: The same where it leaves less.
FORMS = ("never-rises", *ALLOWED)


def exchange(search: Search) -> list[Named]:
    """Try every other effect in the place of each one that was found, beside all the others.

    One that does better takes the place; those that cannot be told from it are its rivals.
    """
    named: dict[tuple[str, int], Named] = {}
    for _ in range(ROUNDS):
        changed = False
        for k, c in enumerate(list(search.found)):
            if c.term.key in named:
                continue
            work.at(f"rivals of {c.name}", 0.62 + 0.16 * k / len(search.found))
            now = search.now
            rated, projector = _beside(search, c)
            rated = _settled(search, c, rated)
            other = _better(search, c, rated) or _suiting(search, c, rated, projector)
            went = {} if other is not None else _elsewhere(search, c, rated)
            if other is None and search.now is now:
                own = _refitted_rivals(search, c, rated, went, projector)
                other = _as_described(search, own, rated)
                named[c.term.key] = own
            if other is not None or search.now is not now:
                changed = True
                named.clear()
                break
        if changed:
            continue
        side = _other_side(search)
        if side is None or not _taken(search, side):
            every = [named[c.term.key] for c in search.found]
            return every if side is None else _beside_it(every, side)
        named.clear()
    return [named.get(c.term.key) or Named(c, HALF, []) for c in search.found]


# ------------------------------------------------------------ what differs between runs


@dataclass(frozen=True)
class _Side:
    """The other way to say what differs between runs.

    Parameters
    ----------
    rung : Visited
        The model with it.
    gone, new : list of Candidate
        Effects of the present model that it does without, and what takes their place.
    own : (float, float)
        Weight of the present way, by the likelihood and by draws of blocks.
    """

    rung: Visited
    gone: list[Candidate]
    new: list[Candidate]
    own: tuple[float, float]


def _other_side(search: Search) -> _Side | None:
    """One effect of the whole robot for what several of its joints have, or these for it.

    In the place of one of them alone it has more values than that, and does no more.  None where
    there is no other way, or the effect of one joint alone.
    """
    mine = [c for c in search.found if c.term.per_run]
    whole = [c for c in mine if c.term.effect.scope.whole]
    if len(mine) < 2 and not whole:
        return None
    gone = whole or mine
    before = _with(search, _left_out(search, gone), [])
    new = [r.candidate for r in _differing(search, before, not whole)]
    rung = _with(search, before.result.model, new)
    if new and not whole:
        new += _staying(gone, before, _differing(search, rung, False))
        rung = _with(search, before.result.model, new)
    renew(search.now.result)
    if not new:
        return None
    own = _weights(search, before, (gone, search.now), (new, rung))
    there, then = ({c.term.key for c in some} for some in (gone, new))
    gone = [c for c in gone if c.term.key not in then]
    new = [c for c in new if c.term.key not in there]
    return _Side(rung, gone, new, own) if gone and new else None


def _left_out(search: Search, gone: Sequence[Candidate]) -> RobotModel:
    """The present model without some effects."""
    model = search.now.result.model
    for c in gone:
        model = without(model, c, search.problem)
    return model


def _with(search: Search, model: RobotModel, new: Sequence[Candidate]) -> Visited:
    """A model with some effects more."""
    for c in new:
        model = model + as_use(c, search.problem)
    return search.rung("other side", model, search.now.result.sigma)


def _staying(gone: Sequence[Candidate], before: Visited, beside: list[Rated]) -> list[Candidate]:
    """Effects of single joints that stay beside one of the robot: it does not act there, or errs.

    By more than a law may miss of its effect.
    """
    power, known = before.errors.power, {c.term.key for c in gone}
    return [
        r.candidate
        for r in beside
        if r.candidate.term.key in known
        and r.removed > DISCREPANCY * max(float(power[r.joint]) - r.before, 0.0)
    ]


def _differing(search: Search, rung: Visited, whole: bool) -> list[Rated]:
    """What differs between runs and pays: the best effect of the robot, or of each joint."""
    terms = [
        t
        for t in terms_to_try(rung.result, search.moves)[0]
        if t.per_run and t.effect.scope.whole == whole
    ]
    _, found = tried(rung.result, terms)
    good = [
        r
        for r in rate(rung.result, search.split, found)
        if search.score(r) > 0 and physical(r.candidate, search.problem)
    ]
    if whole:
        return [max(good, key=search.score)] if good else []
    each = ([r for r in good if r.joint == j] for j in search.moves)
    return [simplest(some, search.score) for some in each if some]


def _weights(
    search: Search,
    before: Visited,
    one: tuple[Sequence[Candidate], Visited],
    other: tuple[Sequence[Candidate], Visited],
) -> tuple[float, float]:
    """Weight of one of two sides by the likelihood, and the share of draws in which it is best."""
    mine, theirs = (_as_one(search, before, *side) for side in (one, other))
    rated = _in_noise(search, mine.candidate, [mine, theirs])
    if len(rated) < 2:  # one of them explains nothing
        own = float(any(r.errors is mine.errors for r in rated))
        return own, own
    drawn = drawn_best(rated[0].candidate, rated, ~search.problem.holds)
    share = next(p for r, p in drawn if r is rated[0])
    return likelier(rated[0].candidate, rated[1].candidate), share


def _as_one(search: Search, before: Visited, some: Sequence[Candidate], rung: Visited) -> Rated:
    """Several effects of a model as one, beside the model without them."""
    there = {t.key: len(t.effect.params) for t in before.result.terms}
    net = sum(max(c.dof - sum(there.get(k, 0) for k in replaced(c.term)), 1) for c in some)
    c = replace(some[0], dof=net + search.replaced(some[0]), joint=search.moves[0])
    old, new, j = before.errors, rung.errors, c.joint
    fall, powers = old.squared[:, j] - new.squared[:, j], (float(old.power[j]), float(new.power[j]))
    left, given = rung.result.residual, before.result.residual
    return Rated(c, old, new, fall, *powers, j, left.__getitem__, given.__getitem__)


def _taken(search: Search, side: _Side) -> bool:
    """Whether the search goes on from the other side: it is likelier, surely better and allowed."""
    now, problem = search.now, search.problem
    if max(side.own) >= HALF or any(c.term.key in search.refused for c in side.new):
        return False
    weight = ~problem.holds / np.maximum(now.errors.power, 1e-300)
    if paired((now.errors.squared - side.rung.errors.squared) @ weight) < RISEN:
        return False
    names = ("; ".join(describe(c, problem) for c in some) for some in (side.new, side.gone))
    rung = replace(side.rung, added=tuple(side.new))
    rung.step = replace(rung.step, label=" for ".join(names))
    search.rungs.append(rung)
    search.found = [c for c in search.found if all(c is not g for g in side.gone)] + side.new
    search.refused |= {c.term.key for c in side.gone}
    search.forget()
    renew(rung.result)
    return True


def _beside_it(every: list[Named], side: _Side) -> list[Named]:
    """Names, of which those that the other side does without have it for a rival."""
    return [
        n.against(side.new, side.own) if any(n.candidate is g for g in side.gone) else n
        for n in every
    ]


def _beside(search: Search, c: Candidate) -> tuple[list[Rated], Projector]:
    """Every effect of a joint beside the model without one of them, rated; and that projector.

    Laws of the load take that of the whole model: masses that make up for the effect that is left
    out carry another one, beside which no law in its place can be seen.  What is too small for
    these data is among them: it takes no name's place, but is a rival.
    """
    now = search.now
    rung = search.rung("without", without(now.result.model, c, search.problem), now.result.sigma)
    result = rung.result
    lend_load(now.result)
    own, moves = c.term.effect, np.flatnonzero(~search.problem.holds).tolist()
    terms = [t for t in terms_to_try(result, moves)[0] if _comparable(t, own, c.joint)]
    projector, found = tried(result, terms)
    floor = search.first.floor if search.first else None
    assert floor is not None  # noqa: S101
    priced(found, floor, result)
    rated = [_judged_on(r, c.joint) if _own(r, c) else r for r in rate(result, search.split, found)]
    others = [f for f in search.found if f is not c]
    sound = [
        r
        for r in rated
        if r.candidate.name == own.name
        or (
            r.removed > 0
            and r.candidate.score > 0
            and may_be(r.candidate, search.problem)
            and r.candidate.absorbed < ABSORBED
            and in_time(r.candidate, result)
            and not any(kindred(r.candidate, f) for f in others)
        )
    ]
    artefacts.mark([r.candidate for r in sound], result, projector)
    return [r for r in sound if r.candidate.name == own.name or not r.candidate.artefact], projector


def _own(r: Rated, c: Candidate) -> bool:
    """Whether a rated candidate is an effect of the model itself."""
    return r.candidate.term.key == c.term.key


def _judged_on(r: Rated, j: int) -> Rated:
    """A rated effect of the robot, judged on the joint of its name and not where it does most."""
    if r.joint == j:
        return r
    fall = r.now.squared[:, j] - r.errors.squared[:, j]
    before, after = float(r.now.power[j]), float(r.errors.power[j])
    return replace(r, joint=j, fall=fall, before=before, after=after)


def _settled(search: Search, c: Candidate, rated: list[Rated]) -> list[Rated]:
    """The same; an effect of the model that a rival seems to beat counts as the model has it.

    Its shapes were searched beside everything then, the rivals' coarsely: those that seem to beat
    it count as the model would have them in its place.
    """
    own = next((r for r in rated if _own(r, c)), None)
    if own is None:
        return rated
    ahead = [r for r in rated if r.after <= own.after - DISCREPANCY * own.removed]
    if not ahead:
        return rated
    settled = {id(own): _refitted(own, search.now)}
    for r in sorted(ahead, key=lambda r: r.after)[:STARTS]:
        settled[id(r)] = _refitted(r, _in_place(search, c, r.candidate))
    return [settled.get(id(r), r) for r in rated]


def _refitted(r: Rated, now: Visited) -> Rated:
    """An effect with the errors of a model that has it, where its shapes settled lower."""
    j = r.joint
    if now.errors.power[j] >= r.after or now.errors.squared.shape != r.errors.squared.shape:
        return r
    fall = r.now.squared[:, j] - now.errors.squared[:, j]
    return replace(r, errors=now.errors, fall=fall, after=float(now.errors.power[j]))


def _comparable(t: Term, own: Effect, j: int) -> bool:
    """Whether a term may stand in the place of an effect on joint j.

    The same effect on any joint, for of some only ratios are determined; of the others those of
    its joint and of the whole robot, but for lines over time and what changes at an instant.
    """
    if t.effect.name == own.name:
        return True
    return (t.joint == j or t.effect.scope.whole) and not (
        isinstance(t.effect.search, Lines) or t.effect.variation.sudden
    )


def _better(search: Search, c: Candidate, rated: list[Rated]) -> Candidate | None:
    """The effect that takes the place of one, if the model with it does better held out."""
    own = next((r for r in rated if r.candidate.term.key == c.term.key), None)
    good = [
        r
        for r in rated
        if (r.candidate.name, c.term.joint) not in search.refused
        and (r is own or (r.candidate.name != c.name and _may_stand(search, r)))
        and r.joint == c.joint
    ]
    if own is None or not good:
        renew(search.now.result)
        return None
    best = simplest(good, search.score)
    if best is own or paired(best.fall - own.fall) < RISEN or best.after > own.after:
        renew(search.now.result)
        return None
    now, rung = search.now, _in_place(search, c, best.candidate)
    weight = ~search.problem.holds / np.maximum(now.errors.power, 1e-300)
    gain = paired((now.errors.squared - rung.errors.squared) @ weight)
    if gain < RISEN or rules.fails(rules.Refit(search, best, now, rung), FORMS):
        search.refused.add((best.candidate.name, c.term.joint))
        renew(now.result)
        return None
    _exchanged(search, c, best.candidate, rung)
    return best.candidate


def _may_stand(search: Search, r: Rated) -> bool:
    """Whether a rated effect may take the place of a name: it is told by the data, and no mass."""
    return physical(r.candidate, search.problem) and not rules.may_be_gravity(search, r)


def _suiting(
    search: Search, c: Candidate, rated: list[Rated], projector: Projector
) -> Candidate | None:
    """The law that has no more values than one, and does as much once all is fitted with it.

    Shapes of other effects of the joint are those that suit the law that was found first, and are
    sought again without it: a polynomial over the position stands for a weight and a stop together
    until the stop has a name, a weight for a spring until the relaxation beside it has one, and a
    relaxation for a spring as long as the bristles beside it have the form that they have without
    either.  With such shapes about it need not act alike, if it takes half as much; it is tried
    once.  With as many values the other law must do better.
    """
    own = next((r for r in rated if _own(r, c)), None)
    if own is None:
        return None
    shaped = any(f is not c and f.joint == c.joint and f.term.effect.shape for f in search.found)
    some = [
        r
        for r in rated
        if r is not own
        and r.joint == c.joint
        and _may_stand(search, r)
        and r.candidate.dof <= c.dof
        and (r.candidate.name, c.term.joint) not in search.refused
        and (shaped or r.removed > (1 - DISCREPANCY) * own.removed)
        and not (c.term.effect.scope.whole or r.candidate.term.effect.scope.whole)
    ]
    some.sort(key=lambda r: r.after)
    alike = [r for r in some if overlap(r.candidate, c, projector) > SAME_COSINE][:STARTS]
    others = [
        r
        for r in some
        if shaped
        and all(r is not a for a in alike)
        and r.removed > HALF * own.removed
        and (c.term.key, r.candidate.term.key) not in search.tried_for
    ][:STARTS]
    search.tried_for |= {(c.term.key, r.candidate.term.key) for r in others}
    now, most = search.now, search.score(_refitted(own, search.now))
    for r in alike + others:
        rung = _in_place(search, c, r.candidate)
        gain = paired((now.errors.squared - rung.errors.squared)[:, c.joint])
        least = RISEN if r.candidate.dof == c.dof else -RISEN
        if gain < least or missed(rung.errors, now.errors, search.moves):
            continue
        if search.score(_refitted(r, rung)) < most:
            continue
        if not rules.fails(rules.Refit(search, r, now, rung), FORMS):
            _exchanged(search, c, r.candidate, rung)
            return r.candidate
    if alike or others:
        renew(now.result)
    return None


def _as_described(search: Search, named: Named, rated: list[Rated]) -> Candidate | None:
    """The rival that leaves the masses as the robot's description has them, where a name does not.

    It leaves no more, and the description decides between the two beyond doubt: of the gains of two
    motors, whose ratio alone the data know, the one beside which no link is another one.
    """
    c, now = named.candidate, search.now
    every = {r.candidate.term.key: r for r in rated}
    for rival in named.rivals:
        r = every.get(rival.term.key)
        if r is None or (rival.name, rival.term.joint) in search.refused:
            continue
        if not physical(rival, search.problem):
            continue
        rung = _in_place(search, c, rival)
        (odds,) = described_odds(now.result, [rung.result])
        held = rung.step.heldout.rms > (1 + WORTH / 2) * now.step.heldout.rms
        worse = missed(rung.errors, now.errors, search.moves) or np.any(held[search.moves])
        if -odds < CERTAIN or worse:
            continue
        if not rules.fails(rules.Refit(search, r, now, rung), ALLOWED):
            other = replace(rival, joint=c.joint)  # where it is felt is the same
            _exchanged(search, c, other, rung)
            return other
    return None


def _exchanged(search: Search, c: Candidate, other: Candidate, rung: Visited) -> None:
    """One effect in the place of another, for good; what that explained is its doing now."""
    known = search.stands_for
    known[other.term.key] = known.get(c.term.key, c.term.key)
    label = f"{describe(other, search.problem)} for {describe(c, search.problem)}"
    rung.step, rung.added = replace(rung.step, label=label), (other,)
    renew(rung.result)
    search.rungs.append(rung)
    search.found[search.found.index(c)] = other
    search.refused.add((c.name, c.term.joint))


def _elsewhere(search: Search, c: Candidate, rated: list[Rated]) -> dict[tuple[str, int], Rated]:
    """Effects that take nearly what one takes, each with what pays beside it, by key.

    As long as the error of their joint is above its floor, all are but a start: a spring and an
    eccentric mass differ by little, and only beside the mass does the friction of its load pay.
    The search goes on from each of them; where it leaves less, it is taken over.
    """
    now, j = search.now, c.joint
    own = next((r for r in rated if _own(r, c)), None)
    floor = search.first.floor if search.first else None
    if own is None or floor is None or not floor.exceeded(now.result.rms, j):
        return {}
    near = [
        r
        for r in rated
        if r.joint == j
        and r.candidate.name != c.name
        and (r.candidate.name, c.term.joint) not in search.refused
        and _may_stand(search, r)
        and r.removed > (1 - DISCREPANCY) * own.removed
    ]
    went = {}
    weight = ~search.problem.holds / np.maximum(now.errors.power, 1e-300)
    for r in sorted(near, key=lambda r: r.after)[:STARTS]:
        apart = search.started(c, r.candidate)
        if apart is None or not any(f.term.key == r.candidate.term.key for f in apart.found):
            continue
        if apart.now.errors.squared.shape != now.errors.squared.shape:
            continue
        gain = paired((now.errors.squared - apart.now.errors.squared) @ weight)
        if _no_more(search, apart, c, r):
            continue
        less = apart.now.errors.power[j] < (1 - WORTH) ** 2 * now.errors.power[j]
        refit = rules.Refit(search, r, now, apart.now)
        if less and gain > RISEN and not rules.fails(refit, FORMS):
            search.taken_over(apart, c)
            return {}
        if all(f is not r.candidate for f in apart.now.added):  # something paid beside it
            went[r.candidate.term.key] = _gone_on(r, search, apart)
    renew(now.result)
    return went


def _no_more(search: Search, apart: Search, c: Candidate, r: Rated) -> bool:
    """Whether a start has led to the same law, and to no more beside it than that may be wrong by.

    The search from that law has given no name to what this takes.
    """
    j = r.joint
    left, less = float(search.now.errors.power[j]), float(apart.now.errors.power[j])
    again = any(f.term.key == c.term.key for f in apart.found)
    return again and left - less <= rules.inaccuracy(search, r.candidate, j, left)


def _gone_on(r: Rated, search: Search, apart: Search) -> Rated:
    """A rated effect with the errors of the search that started from it, and all its values."""
    j, errors = r.joint, apart.now.errors
    more = sum(f.dof for f in apart.found) - sum(f.dof for f in search.found)
    own = next(f for f in apart.found if f.term.key == r.candidate.term.key).dof
    candidate = replace(r.candidate, dof=max(own + more, 1))
    fall = r.now.squared[:, j] - errors.squared[:, j]
    return replace(r, candidate=candidate, errors=errors, fall=fall, after=float(errors.power[j]))


def _refitted_rivals(
    search: Search,
    c: Candidate,
    rated: list[Rated],
    went: dict[tuple[str, int], Rated],
    projector: Projector,
) -> Named:
    """Confidence and rivals, without those that are none once everything is fitted again.

    Where another effect of the joint has a shape, that was found without either of the two; beside
    it they may look alike though one leaves surely more with the shape that suits it.  Nor is a
    wider law one, of which the named one is a case, that foretells no better; a twin is none of
    those, nor is a law that acts on other joints, too, and what follows any smooth law is no case
    of another.  `went` holds those from which the search
    went on, with the errors that it came to.
    """
    problem, coarse = search.problem, {r.candidate.term.key: r.candidate for r in rated}
    rated = [went.get(r.candidate.term.key, r) for r in rated]
    named = _weighed(search, c, rated, projector)
    keys = {r.term.key for r in named.rivals}
    others = any(f is not c and f.joint == c.joint and f.term.effect.shape for f in search.found)
    most = (1 + WORTH) ** 2 * float(search.now.errors.power[c.joint])
    gone = []
    for r in (r for r in rated if r.candidate.term.key in keys):
        alone = coarse[r.candidate.term.key]
        wider = (
            alone.dof > c.dof
            and not pliable(c.term, problem)
            and (c.term.effect.scope.whole or not alone.term.effect.scope.whole)
            and not twins(c, alone, projector)
            and overlap(c, alone, projector) > SAME_COSINE
        )
        apart = r.candidate.term.key in went
        if not (wider or (others and not apart)):
            continue
        errors = r.errors if apart else _in_place(search, c, r.candidate).errors
        errs = others and not apart and _errs(search, c, errors, most)
        if errs or (wider and not _gains(search, errors)):
            gone.append(r)
    if not gone:
        return named
    return _weighed(search, c, [r for r in rated if all(r is not w for w in gone)], projector)


def separated(search: Search, named: Named) -> Named:
    """A name without the rivals that the last model, corrections and all, shows to be none.

    With one of them in the place of the effect it errs twice as much, on left-out blocks or on the
    held-out runs.  The others are weighed anew by the masses that they need, which are nearer to
    the robot's description or further from it than those that the effect needs.  What other effects
    and corrections take hid that before; and held-out runs that go further than the fitted ones
    tell a law from what follows it within their range.
    """
    problem, j = search.problem, named.candidate.joint
    accuracy = (practical(problem) * float(problem.rms(problem.effort)[j])) ** 2
    most = max(float(search.now.errors.power[j]) / HALF**2, accuracy)
    rungs = _with_theirs(search, named)
    pairs = [
        (r, rung)
        for r, rung in zip(named.rivals, rungs, strict=True)
        if not _surely_worse(search, named.candidate, rung, most)
    ]
    odds = described_odds(search.now.result, [rung.result for _, rung in pairs])
    if len(pairs) == len(named.rivals) and not any(odds):
        return named
    return named.among([r for r, _ in pairs]).told(odds)


def emptied(search: Search, c: Candidate, before: Visited) -> Visited | None:
    """The last model without an effect that came to nothing there; None where it did not.

    Its own effort, beyond what the effect that it replaces does, is within its errors once all is
    fitted together, or a tenth of what it was in the model `before` the corrections, and the rest
    foretells as much.  Values that were kept while corrections were sought came to nothing by
    no fit.
    """
    now, key, j = search.now, c.term.key, c.joint
    term = next((t for t in now.result.terms if t.key == key), None)
    if term is None or term.fixed:
        return None
    rung = search.rung(now.step.label, reverted(now.result, c), now.result.sigma)
    renew(now.result)
    rung.step = replace(rung.step, result=let_go(rung.result, now.result.model))
    there = {t.key for t in now.result.terms}
    own = zip(rung.result.terms, rung.result.slices, strict=True)
    back = [rung.result.x[:, where] for t, where in own if t.key not in there]
    instead = np.hstack([rung.result.x[:, :0], *back])
    size, error = beyond(now.result, key, instead)
    had, _ = beyond(before.result, key, instead)
    held = rung.step.heldout.rms[j] > (1 + WORTH / 2) * now.step.heldout.rms[j]
    worse = held or missed(rung.errors, now.errors, [j])
    nothing = size <= min(max(SURE * error, TENTH * had), HALF * had)
    return rung if nothing and not worse else None


def _surely_worse(search: Search, c: Candidate, rung: Visited, most: float) -> bool:
    """Whether the model with a rival in the place of an effect is worse, see `_errs`.

    Held-out runs may show it, too.
    """
    one, other = search.now.step.heldout, rung.step.heldout
    if one.kind == "holdout" and one.gain(other, c.joint) > RISEN:
        power = float(other.rms[c.joint]) ** 2
        if power > max(most, float(one.rms[c.joint]) ** 2 / HALF**2):
            return True
    return _errs(search, c, rung.errors, most)


def _in_place(search: Search, c: Candidate, *rivals: Candidate) -> Visited:
    """The model with rivals in the place of an effect, everything fitted again."""
    now = search.now
    model = without(now.result.model, c, search.problem)
    for r in rivals:
        model = model + as_use(r, search.problem)
    rung = search.rung("in place", model, now.result.sigma)
    renew(now.result)
    return rung


def _with_theirs(search: Search, named: Named) -> list[Visited]:
    """The models with each rival in the place of an effect; what goes together has one model."""
    c = named.candidate
    several = [r for r in named.rivals if _one_of_several(c, r)]
    together = _in_place(search, c, *several) if several else None
    return [
        together if together is not None and _one_of_several(c, r) else _in_place(search, c, r)
        for r in named.rivals
    ]


def _one_of_several(c: Candidate, r: Candidate) -> bool:
    """Whether a rival is one of several that stand for an effect of the whole robot, by joints."""
    whole = c.term.effect.scope.whole and not r.term.effect.scope.whole
    return whole and c.term.per_run and r.term.per_run


def _errs(search: Search, c: Candidate, other: BlockErrors, most: float) -> bool:
    """Whether another model surely foretells left-out blocks worse than the present one.

    And leaves more power on an effect's joint than `most`.
    """
    now = search.now
    weight = ~search.problem.holds / np.maximum(now.errors.power, 1e-300)
    left, before = other.squared @ weight, now.errors.squared @ weight
    # where it errs many times as much, most of that may lie in a few blocks: by its logarithm, too
    ratio = np.maximum(left, 1e-300) / np.maximum(before, 1e-300)
    rise = max(paired(left - before), paired(np.log(ratio)))
    return rise > SURE and float(other.power[c.joint]) > most


def _gains(search: Search, other: BlockErrors) -> bool:
    """Whether another model foretells left-out blocks better than the present one.

    By what would be worth a name, too: more values follow what others leave.
    """
    now = search.now
    weight = ~search.problem.holds / np.maximum(now.errors.power, 1e-300)
    sure = paired((now.errors.squared - other.squared) @ weight) > RISEN
    return sure and missed(now.errors, other, search.moves)


def _weighed(search: Search, c: Candidate, rated: list[Rated], projector: Projector) -> Named:
    """Confidence and rivals of an effect among those that could stand in its place.

    The lesser of two weights: by the likelihood, tempered by what a law may miss of its effect,
    and by how often it does best when blocks are drawn anew.
    """
    rated = _in_noise(search, c, rated)
    order = sorted((r.candidate for r in rated), key=ranking)
    own = next((x for x in order if x.term.key == c.term.key), None)
    if own is None:
        return Named(c, HALF, [])
    rest = [x for x in order if x is not own]
    _, likely, heavy = choose([own, *rest], projector)
    drawn = [(r.candidate, p) for r, p in drawn_best(own, rated, ~search.problem.holds)]
    best = next(p for r, p in drawn if r is own)
    rivals = [r for r, _ in heavy]
    rivals += [r for r, p in drawn if p >= RIVAL and r not in [own, *rivals]]
    odds = [tuple(next((p for x, p in of if x is r), 0.0) for of in (heavy, drawn)) for r in rivals]
    return Named(c, min(likely, best), rivals, [(a, b) for a, b in odds], (likely, best))


def _in_noise(search: Search, c: Candidate, rated: list[Rated]) -> list[Rated]:
    """The same with what each candidate takes of the held-out error, in units of the noise.

        chi2 = sum_j N_j (before_j - after_j) / s_j^2 + 2 m,

    s_j^2 what the best of them leaves and m its values: held out, m chance values cost m where
    they gain m on the fitted instants.
    """
    good = [r for r in rated if r.candidate.term.key == c.term.key] or rated
    if not good:
        return []
    noise = np.minimum.reduce([r.errors.power for r in rated])
    colour = search.first.floor.inflation if search.first else np.ones(search.problem.d)
    floor = search.first.floor.rms**2 if search.first else np.zeros(search.problem.d)
    out = []
    for r in rated:
        count = r.now.count.sum(axis=0) / colour
        fall = (r.now.power - r.errors.power) / np.maximum(noise, 1e-300)
        chi2 = float(np.sum((count * fall)[~search.problem.holds])) + 2.0 * r.candidate.dof
        size = float(np.log(max(float(count[r.joint]), 2.0)))
        net = max(r.candidate.dof - search.replaced(r.candidate), 1)
        above = np.maximum(r.errors.power - floor, 0.0) / np.maximum(noise, 1e-300)
        missed = float(np.sum((count * above)[~search.problem.holds]))
        own = replace(r.candidate, chi2=chi2, price=net * size, missed=missed)
        out.append(replace(r, candidate=own))
    return [r for r in out if r.candidate.score > 0]
