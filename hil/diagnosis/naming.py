"""Names of what the search has found: exchanged for better ones, weighed, and raced.

Every other effect of a joint is tried in the place of each one that was found, beside all the rest.
What cannot be told from it is its rival, and free functions without a name run against it.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil import progress
from hil.diagnosis import artefacts, rules
from hil.diagnosis.attribution import (
    as_use,
    beyond,
    choose,
    described_odds,
    kindred,
    overlap,
    physical,
    twins,
)
from hil.diagnosis.candidates import (
    COMPETITORS,
    FOIL,
    Rated,
    competitor,
    foils,
    model_groups,
    paired,
    rate,
    simplest,
    tried,
)
from hil.diagnosis.constants import (
    ABSORBED,
    BEATEN,
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
from hil.diagnosis.grams import BlockErrors, GramTable, Group
from hil.diagnosis.remodel import Visited, let_go, missed, reverted, without
from hil.diagnosis.search import Search
from hil.diagnosis.types import Candidate, describe, ranking
from hil.identify.context import lend_load, renew
from hil.identify.design import Term, replaced
from hil.identify.projector import Projector
from hil.models.effect import Effect, Lines

FloatArray = NDArray[np.float64]
#: Draws of the bootstrap.
DRAWS = 400
#: Other effects that a search starts from in the place of one, and exchanges one after another.
STARTS, ROUNDS = 2, 5
#: Rules of a fit in which one effect takes the place of another.
FORMS = ("never-rises", "coefficients", "scales", "allowed")


@dataclass
class Named:
    """An effect of the last model, and how sure its name is.

    Parameters
    ----------
    candidate : Candidate
        The effect.
    confidence : float
        Weight of the models that hold it, among those that cannot be told apart.
    rivals : list of Candidate
        Effects that take its place in the others.
    odds : list of (float, float)
        Weight of each rival by the likelihood, and share of the draws that it wins; empty where
        there are none.
    own : (float, float)
        The same of the effect: its confidence is the lesser one.
    """

    candidate: Candidate
    confidence: float
    rivals: list[Candidate]
    odds: list[tuple[float, float]] = field(default_factory=list)
    own: tuple[float, float] = (HALF, HALF)

    def among(self, rivals: Sequence[Candidate]) -> Named:
        """The same among fewer rivals."""
        kept = [k for k, r in enumerate(self.rivals) if any(r is x for x in rivals)]
        gone = [x for k, x in enumerate(self.odds) if k not in kept]
        left = (1.0 - sum(x[way] for x in gone) for way in (0, 1))
        own = tuple(min(p / max(x, p, 1e-300), 1.0) for p, x in zip(self.own, left, strict=True))
        return Named(
            self.candidate,
            min(own),
            [self.rivals[k] for k in kept],
            [self.odds[k] for k in kept],
            (own[0], own[1]),
        )

    def told(self, odds: Sequence[float]) -> Named:
        """The same where something else is known: log odds of the effect over each rival.

        A rival that is likelier leaves the name undecided: which one is named the search decides.
        """
        own, rivals = np.array(self.own), np.array(self.odds).reshape(-1, 2)
        weight = rivals * np.exp(np.clip(np.negative(odds), -_OVERFLOW, _OVERFLOW))[:, None]
        # what is neither the effect nor a rival that is listed keeps its weight
        left = np.maximum(1.0 - own - rivals.sum(axis=0), 0.0)
        whole = np.maximum(own + weight.sum(axis=0) + left, 1e-300)
        own, weight = np.maximum(own / whole, np.minimum(own, HALF)), weight / whole
        kept = [k for k in range(len(self.rivals)) if weight[k].max() >= RIVAL]
        return Named(
            self.candidate,
            float(own.min()),
            [self.rivals[k] for k in kept],
            [(float(weight[k, 0]), float(weight[k, 1])) for k in kept],
            (float(own[0]), float(own[1])),
        )


#: Largest log odds that is told apart from certainty.
_OVERFLOW = 50.0


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
            progress.at(f"rivals of {c.name}", 0.2 + 0.13 * k / len(search.found))
            now = search.now
            rated, projector = _beside(search, c)
            rated = _settled(search, c, rated)
            other = _better(search, c, rated)
            went = {} if other is not None else _elsewhere(search, c, rated)
            if other is not None or search.now is not now:
                changed = True
                named.clear()
                break
            named[c.term.key] = _refitted_rivals(search, c, rated, went, projector)
        if not changed:
            break
    return [named.get(c.term.key) or Named(c, HALF, []) for c in search.found]


def _beside(search: Search, c: Candidate) -> tuple[list[Rated], Projector]:
    """Every effect of a joint beside the model without one of them, rated; and that projector.

    Laws of the load take that of the whole model: masses that make up for the effect that is left
    out carry another one, beside which no law in its place can be seen.
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
    artefacts.mark_smoothers(found, result, projector)
    artefacts.mark_blurred(found, result, projector)
    rated = [_judged_on(r, c.joint) if _own(r, c) else r for r in rate(result, search.split, found)]
    others = [f for f in search.found if f is not c]
    sound = [
        r
        for r in rated
        if r.candidate.name == own.name
        or (
            r.removed > 0
            and r.candidate.score > 0
            and physical(r.candidate, search.problem)
            and not (r.candidate.smoother or r.candidate.blurred)
            and r.candidate.absorbed < ABSORBED
            and in_time(r.candidate, result)
            and not any(kindred(r.candidate, f) for f in others)
        )
    ]
    return sound, projector


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
        and (r is own or r.candidate.name != c.name)
        and r.joint == c.joint
    ]
    if own is None or not good:
        renew(search.now.result)
        return None
    best = simplest(good, search.score)
    if best is own or paired(best.fall - own.fall) < RISEN or best.after > own.after:
        renew(search.now.result)
        return None
    now = search.now
    model = without(now.result.model, c, search.problem) + as_use(best.candidate, search.problem)
    label = f"{describe(best.candidate, search.problem)} for {describe(c, search.problem)}"
    rung = search.rung(label, model, now.result.sigma)
    weight = ~search.problem.holds / np.maximum(now.errors.power, 1e-300)
    gain = paired((now.errors.squared - rung.errors.squared) @ weight)
    if gain < RISEN or rules.fails(rules.Refit(search, best, now, rung), FORMS):
        search.refused.add((best.candidate.name, c.term.joint))
        renew(now.result)
        return None
    rung.added = (best.candidate,)
    search.rungs.append(rung)
    search.found[search.found.index(c)] = best.candidate
    search.refused.add((c.name, c.term.joint))
    return best.candidate


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
    those, nor is a law that acts on other joints, too.  `went` holds those from which the search
    went on, with the errors that it came to.
    """
    coarse = {r.candidate.term.key: r.candidate for r in rated}
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
    rungs = [_in_place(search, named.candidate, r) for r in named.rivals]
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


def _in_place(search: Search, c: Candidate, rival: Candidate) -> Visited:
    """The model with a rival in the place of an effect, everything fitted again."""
    now = search.now
    model = without(now.result.model, c, search.problem) + as_use(rival, search.problem)
    rung = search.rung("in place", model, now.result.sigma)
    renew(now.result)
    return rung


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
    drawn = [(r.candidate, p) for r, p in _drawn(own, rated, ~search.problem.holds)]
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


def _drawn(
    own: Candidate, rated: list[Rated], moves: NDArray[np.bool_]
) -> list[tuple[Rated, float]]:
    """How often each effect does best, with weights of blocks drawn from Dirichlet(1, .., 1).

    One that is as good as the best, within what a law may miss, and has no more to fit, is best.

    Source: Rubin, Ann. Statist. 9, 1981; Yao, Vehtari, Simpson, Gelman, Bayesian Analysis 13, 2018
    (pseudo-BMA+).
    """
    mine = next(r for r in rated if r.candidate is own)
    near = [r for r in rated if r.joint == mine.joint and r.fall.size == mine.fall.size]
    # over all joints: what a law of two joints takes on the other one is its own, too
    noise = np.minimum.reduce([r.errors.power for r in near])
    weight = moves / np.maximum(noise, 1e-300)
    falls = np.stack([(r.now.squared - r.errors.squared) @ weight for r in near])
    draws = np.random.default_rng(0).dirichlet(np.ones(falls.shape[1]), DRAWS)
    total = draws @ falls.T
    top = total.max(axis=1)
    order = sorted(
        range(len(near)), key=lambda k: (near[k].candidate is not own, near[k].candidate.dof)
    )
    good = total >= (top * (1 - DISCREPANCY))[:, None]
    first = np.argmax(good[:, order], axis=1)
    share = np.bincount(first, minlength=len(near)) / DRAWS
    return [(near[k], float(share[n])) for n, k in enumerate(order)]


def shares(search: Search) -> dict[tuple[str, int], tuple[float, str]]:
    """What each name takes of all that it and any free function take, and that one's variables.

        share = D / (D + G),

    D the fall of the held-out mean square error by the name, and G by how much a free function
    does better: in its place, against the fall by that name; or beside all names of the joint,
    against the fall by them together.  Only what is sure of G counts.
    """
    now, out = search.now, {}
    if now.result.model.explains != "motor" or not search.found:
        return {}
    base = model_groups(now.result)
    for j in sorted({c.joint for c in search.found}):
        free = [g for what in COMPETITORS if (g := competitor(search.problem, j, what)) is not None]
        for c in (c for c in search.found if c.joint == j):
            free += foils(search.problem, c.term)
        race = _Race(GramTable(search.problem, search.split, now.result.sigma, base, free), free, j)
        every = [g.key for g in base]
        taken = float(search.base.errors.power[j]) - race.power(every)
        beside = race.best(every, every)
        for c in (c for c in search.found if c.joint == j):
            rest = [k for k in every if k != c.term.key]
            own = race.power(rest) - race.power(every)
            gain, words = beside
            out[c.term.key] = (taken / (taken + gain) if taken > 0 else 0.0, words)
            if not replaced(c.term):  # what it replaced is not there to be put back
                gain, words = race.best(rest, every)
                stands = own > 0 and gain <= (0.0 if words == FOIL else BEATEN) * own
                out[c.term.key] = min(
                    out[c.term.key], (own / (own + gain) if stands else 0.0, words)
                )
    return out


@dataclass(frozen=True)
class _Race:
    """A model of one joint, and free functions that run against its names."""

    table: GramTable
    free: list[Group]
    joint: int

    def power(self, keys: Sequence[Hashable]) -> float:
        """Held-out mean square error of the joint."""
        return float(self.table.errors(keys).power[self.joint])

    def best(self, keys: Sequence[Hashable], against: Sequence[Hashable]) -> tuple[float, str]:
        """What is sure of how much the best function with `keys` does better than `against`.

        Sure by the fall of the squared error of blocks, or by that of its logarithm: where a few
        blocks hold most of the error, the first says little of the rest.
        """
        start, j = self.table.errors(against), self.joint
        gain, words = 0.0, ""
        for g in self.free:
            after = self.table.errors([*keys, g.key])
            fall = start.squared[:, j] - after.squared[:, j]
            sure = float(start.power[j] - after.power[j])
            size = max(float(after.squared[:, j].mean()), 1e-300)
            ratio = np.log((start.squared[:, j] + size) / (after.squared[:, j] + size))
            certain = max(paired(fall), paired(ratio), 1e-9)
            sure *= max(1.0 - SURE / certain, 0.0)
            if sure > gain:
                gain, words = sure, str(g.key[1])  # type: ignore[index]
        return gain, words
