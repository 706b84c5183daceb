"""The search: forward while something pays, backward and by exchange, joint by joint.

In each round every joint that is still open gets its best candidate; all of them are fitted
together with everything else.  A joint closes when nothing pays on it any more.  What an effect is
judged by is what is left now, on blocks that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis import artefacts, rules
from hil.diagnosis.attribution import as_use, choose, kindred, physical
from hil.diagnosis.candidates import Rated, model_groups, paired, rate, tried
from hil.diagnosis.competitors import COMPETITORS, FOIL, competitor, foils
from hil.diagnosis.constants import BEATEN, BEYOND, DISCREPANCY, RIVAL, SURE, WORTH
from hil.diagnosis.evidence import (
    CORRECTION,
    EFFECT,
    GEOMETRY,
    detect,
    in_time,
    measured_floor,
    priced,
    terms_to_try,
)  # fmt: skip
from hil.diagnosis.folds import Split, parts
from hil.diagnosis.grams import Errors, Group, Table
from hil.diagnosis.heldout import Examiner, of_blocks
from hil.diagnosis.residual_tests import changes
from hil.diagnosis.types import Candidate, CheckResult, Evidence, Step, describe, ranking
from hil.identify.context import renew
from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.identify.timing import fit_aligned
from hil.models import catalogue
from hil.models.effect import Effect, Lines, Trait
from hil.models.model import RobotModel

FloatArray = NDArray[np.float64]
#: Draws of the bootstrap.
DRAWS = 400
#: Rules of a fit in which one effect takes the place of another.
FORMS = ("never-rises", "coefficients", "scales", "allowed")


@dataclass
class Visited:
    """A model on the way, with its errors on the fitted runs' folds and on held-out runs."""

    step: Step
    errors: Errors
    added: tuple[Candidate, ...] = ()

    @property
    def result(self) -> FitResult:
        """Its fit."""
        return self.step.result

    @property
    def keys(self) -> set[tuple[str, int]]:
        """Effects that were added with it, by name and joint."""
        return {c.term.key for c in self.added}


@dataclass(frozen=True)
class _Tried:
    """Evidence that was gathered last, and beside which model."""

    rung: Visited
    kind: str
    joints: tuple[int, ...]
    first: Evidence | None
    evidence: Evidence
    rated: list[Rated]

    def serves(
        self, rung: Visited, kind: str, joints: Sequence[int], first: Evidence | None
    ) -> bool:  # fmt: skip
        """Whether it holds what is asked for; floors of the first evidence are kept."""
        same = rung is self.rung and kind == self.kind and set(joints) <= set(self.joints)
        return same and (first is self.first or first is self.evidence)

    def of(self, joints: Sequence[int]) -> tuple[Evidence, list[Rated]]:
        """What belongs to some joints, or to the whole robot."""
        if set(joints) == set(self.joints):
            return self.evidence, self.rated
        some = [
            r for r in self.rated if r.joint in joints or r.candidate.term.effect.scope.of_robot
        ]
        return replace(self.evidence, candidates=[r.candidate for r in some]), some


@dataclass
class Search:
    """State of the search.

    Parameters
    ----------
    problem : Problem
        The fitted runs.
    split : Split
        Their blocks and folds.
    examine : Examiner
        Held-out runs, if there are any.
    seed : int
        Of the sign flips.
    """

    problem: Problem
    split: Split
    examine: Examiner
    seed: int = 0
    refused: set[tuple[str, int]] = field(default_factory=set)
    #: Why what might have been added was not, by effect and joint.
    stops: dict[tuple[str, int], CheckResult] = field(default_factory=dict)
    #: Rules that stopped something -> whether of one thing at least no other would have.
    fired: dict[str, bool] = field(default_factory=dict)
    rungs: list[Visited] = field(default_factory=list)
    #: Whether several joints have no robot description.
    blind: bool = False
    #: The rung that names are judged against: the first one, unless the geometry was missing.
    start: int = 0
    found: list[Candidate] = field(default_factory=list)
    #: Effects whose names stand, by effect and joint: corrections leave them their efforts.
    standing: list[tuple[str, int]] = field(default_factory=list)
    first: Evidence | None = None
    last: Evidence | None = None
    _tried: _Tried | None = None

    @property
    def now(self) -> Visited:
        """The last model."""
        return self.rungs[-1]

    @property
    def base(self) -> Visited:
        """The model that names are judged against."""
        return self.rungs[self.start]

    def rung(self, label: str, model: RobotModel, scale: FloatArray | None = None) -> Visited:
        """Fit a model and judge it."""
        result = fit_aligned(self.problem, model, scale)
        return self.judged(label, result)

    def judged(self, label: str, result: FitResult) -> Visited:
        """A fit with its errors."""
        groups = model_groups(result)
        table = Table(self.problem, self.split, result.sigma, groups)
        keys = [g.key for g in groups]
        errors = table.errors(keys)
        if self.examine.kind == "holdout":
            heldout = self.examine(result)
        else:
            heldout = of_blocks(table.left_out(keys), self.problem, self.split)
        return Visited(Step(label, result, heldout), errors)

    def parted(self, result: FitResult) -> Errors:
        """Errors of a fit on each part of the recording by the coefficients of the others."""
        groups = model_groups(result)
        table = Table(self.problem, parts(self.split), result.sigma, groups)
        return table.errors([g.key for g in groups])

    # ------------------------------------------------------------------ evidence

    def evidence(self, joints: Sequence[int], kind: str = EFFECT) -> tuple[Evidence, list[Rated]]:
        """All candidates of a kind on some joints beside the present model, or of these."""
        known = self._tried
        if known is not None and known.serves(self.now, kind, joints, self.first):
            return known.of(joints)
        with self.problem.aside():
            out, rated = self._evidence(joints, kind)
        self._tried = _Tried(self.now, kind, tuple(joints), self.first, out, rated)
        return out, rated

    def _evidence(self, joints: Sequence[int], kind: str) -> tuple[Evidence, list[Rated]]:
        result = self.now.result
        terms, impossible = terms_to_try(result, joints, kind=kind)
        projector, _ = tried(result, [])
        changed = changes(result, projector)
        if not changed:
            terms = [t for t in terms if not t.effect.variation.sudden]
        projector, found = tried(result, terms, projector=projector)
        floor = measured_floor(found, projector, result) if self.first is None else self.first.floor
        priced(found, floor, result)
        detect(found, projector, floor, result, self.seed)
        artefacts.mark_smoothers(found, projector)
        artefacts.mark_blurred(found, result, projector)
        rated = rate(result, self.split, found)
        order = sorted(range(len(found)), key=lambda k: -_score(rated[k]))
        out = Evidence([found[k] for k in order], floor, projector, impossible, changed)
        return out, [rated[k] for k in order]

    def pays(self, r: Rated, evidence: Evidence) -> bool:
        """Whether a candidate passes every rule; the first that stops it is kept."""
        stop = rules.stopped(rules.Case(self, r, evidence))
        if stop is not None:
            self.stops[r.candidate.term.key] = stop
        return stop is None

    def replaced(self, c: Candidate) -> int:
        """Values of the model that a candidate takes the place of."""
        gone = {(name, c.term.joint) for name in c.term.effect.relations.replaces}
        own = [t for t in self.now.result.terms if t.key in gone]
        return sum(len(t.effect.params) + len(t.effect.shape) for t in own)

    # ------------------------------------------------------------------ forward

    def forward(self) -> None:
        """Add what pays, joint by joint, until every joint has failed."""
        open_joints = [j for j in range(self.problem.d) if not self.problem.holds[j]]
        while open_joints:
            evidence, rated = self.evidence(open_joints)
            self.first = self.first or evidence
            self.last = evidence
            picks = self._picks(rated, evidence, open_joints)
            open_joints = [
                j for j in open_joints
                if any(p.joint == j or p.candidate.term.effect.scope.whole for p in picks)
            ]  # fmt: skip
            if not picks:
                return
            before = self.now
            open_joints = self._added(picks, open_joints)
            if self.blind and self.now is not before:
                # what a large effect hid of the geometry is no news, and gets no name
                self._corrected([c.joint for c in self.now.added], GEOMETRY)
            self.backward()

    def correct(self, joints: Sequence[int]) -> list[Visited]:
        """Add corrections without a name where no effect pays any more; the rungs they give.

        They pass the same rules as effects do, but are none: names, stops and rules that fired
        stay what they are.  First everything is fitted again with a correction; one that would take
        the effort of a named effect is then tried again on what the model leaves.
        """
        kept, start = (list(self.found), dict(self.stops), dict(self.fired)), len(self.rungs)
        self._corrected(joints, CORRECTION)
        if "robs" not in self.fired:
            self.found, self.stops, self.fired = kept
            return self.rungs[start:]
        named, first = self.now.result, len(self.rungs)
        self.rungs.append(self.rung("kept", _kept(named.model), named.sigma))
        table = catalogue.table()
        self.refused = {k for k in self.refused if Trait.CORRECTION not in table[k[0]].traits}
        self._corrected(joints, CORRECTION)
        self.found, self.stops, self.fired = kept
        del self.rungs[first]
        for rung in self.rungs[first:]:
            rung.step = replace(rung.step, result=_freed(rung.result, named))
        return self.rungs[start:]

    def geometry(self) -> None:
        """Add what stands for a robot description that is missing; names are sought beside it."""
        joints = np.flatnonzero(~self.problem.holds).tolist()
        if terms_to_try(self.now.result, joints, kind=GEOMETRY)[0]:
            self._corrected(joints, GEOMETRY)
            self.start = len(self.rungs) - 1
            self.first, self.stops, self.fired = None, {}, {}

    def _corrected(self, joints: Sequence[int], kind: str) -> None:
        """Add corrections of a kind on some joints as long as they pay."""
        left = list(joints)
        while left:
            evidence, rated = self.evidence(left, kind)
            picks = self._picks(rated, evidence, left)
            left = [j for j in left if any(p.joint == j for p in picks)]
            if picks:
                names = list(self.found)
                self._added(picks, left)
                self.found = names

    def _picks(self, rated: list[Rated], evidence: Evidence, joints: Sequence[int]) -> list[Rated]:
        """The best candidate of each joint, or one of the whole robot that does more alone."""
        good = [r for r in rated if self.pays(r, evidence)]
        own = [r for r in good if not r.candidate.term.effect.scope.whole]
        picks = []
        for j in joints:
            mine = [r for r in own if r.joint == j]
            if mine:
                picks.append(simplest(mine, self.score))
        whole = [r for r in good if r.candidate.term.effect.scope.whole]
        if whole:
            best = max(whole, key=self.score)
            rest = [p for p in picks if p.joint == best.joint]
            if not rest or self.score(best) > self.score(rest[0]):
                return [best]
        return picks

    def score(self, r: Rated) -> float:
        """Evidence for a candidate over all joints that move, less the price of its values.

            sum_j N_j log(before_j / after_j) - m log N,

        with N_j independent instants, by the correlation of what the largest model leaves.
        Source: Schwarz, Ann. Statist. 6, 1978.
        """
        now, moves = r.now, ~self.problem.holds
        colour = self.first.floor.inflation if self.first else np.ones(self.problem.d)
        count = np.maximum(now.count.sum(axis=0) / colour, 2.0)
        ratio = np.maximum(now.power, 1e-300) / np.maximum(r.errors.power, 1e-300)
        net = max(r.candidate.dof - self.replaced(r.candidate), 1)
        price = net * np.log(float(count[r.joint]))
        return float(np.sum((count * np.log(ratio))[moves])) - float(price)

    def _added(self, picks: list[Rated], joints: list[int]) -> list[int]:
        """Fit with the picks; those that do not hold after the fit are refused.

        Effects of several joints that do not hold together are tried one by one, the best first.
        """
        before = self.now
        bad = self._fitted(picks, before)
        if bad and len(picks) > 1:
            single = sorted(picks, key=lambda p: -self.score(p))
            bad = [p for p in single if self.now is not before or self._fitted([p], before)]
            bad = [] if self.now is not before else bad
        self.refused |= {(p.candidate.name, p.candidate.term.joint) for p in bad}
        if self.now is before:
            renew(before.result)
        return joints

    def _fitted(self, picks: list[Rated], before: Visited) -> list[Rated]:
        """Fit with some picks; the new rung is kept if all of them hold, else those that do not."""
        model = before.result.model
        for p in picks:
            model = model + as_use(p.candidate, self.problem)
        label = "; ".join(f"+ {describe(p.candidate, self.problem)}" for p in picks)
        rung = self.rung(label, model, before.result.sigma)
        bad = [p for p in picks if not self._holds(p, before, rung)]
        if not bad:
            rung.added = tuple(p.candidate for p in picks)
            self.rungs.append(rung)
            self.found += list(rung.added)
        return bad

    def _holds(self, p: Rated, before: Visited, after: Visited) -> bool:
        """Whether an effect stands after everything was fitted again."""
        fail = rules.fails(rules.Refit(self, p, before, after))
        if fail is not None:
            self.stops[p.candidate.term.key] = fail
        return fail is None

    # ------------------------------------------------------------------ backward, exchange

    def backward(self) -> None:
        """Take out what later effects have made superfluous."""
        for c in self.found[:-1]:
            now = self.now
            key, j = c.term.key, c.joint
            if not any(t.key == key for t in now.result.terms) or c.term.effect.relations.replaces:
                continue
            groups = model_groups(now.result)
            table = Table(self.problem, self.split, now.result.sigma, groups)
            rest = table.errors([g.key for g in groups if g.key != key])
            rise = rest.squared[:, j] - now.errors.squared[:, j]
            if rest.power[j] > (1 + WORTH / 2) ** 2 * now.errors.power[j] or paired(rise) > BEYOND:
                continue
            rung = self.rung(
                f"- {describe(c, self.problem)}", without(now.result.model, c, self.problem),
                now.result.sigma,
            )  # fmt: skip
            if rung.errors.power[j] <= (1 + WORTH / 2) ** 2 * now.errors.power[j]:
                self.rungs.append(rung)
                self.found.remove(c)
                return
            renew(now.result)


def _score(r: Rated) -> float:
    return r.removed / max(r.before, 1e-300)


def without(model: RobotModel, c: Candidate, problem: Problem) -> RobotModel:
    """A model without an effect that was added on one joint."""
    use = as_use(c, problem)
    rest = tuple(u for u in model.effects if (u.type, u.joints) != (use.type, use.joints))
    return replace(model, effects=rest)


#: Options of an effect whose values stay.
KEPT = {"fixed": True, "fixed_shape": True}


def _kept(model: RobotModel) -> RobotModel:
    """A fitted model whose values stay; but those that every run has by itself."""
    effects = tuple(
        u if u.options.get("per_run") else replace(u, options={**u.options, **KEPT})
        for u in model.effects
    )
    return replace(model, effects=effects)


def _freed(result: FitResult, named: FitResult) -> FitResult:
    """A fit with the effects and values of another one beside its own corrections."""
    own = {(u.type, u.joints): u for u in named.model.effects}
    effects = tuple(own.get((u.type, u.joints), u) for u in result.model.effects)
    model = replace(result.model, effects=effects)
    return replace(result, model=model, values={**result.values, **named.values})


def simplest(rated: list[Rated], score: Callable[[Rated], float]) -> Rated:
    """Of the candidates that do as well as the best one, the one with the least to fit.

    As well: within what a library's law misses of its effect.
    """
    best = max(rated, key=score)
    alike = [r for r in rated if _alike(r, best)]
    return min([best, *alike], key=lambda r: (*_values(r.candidate), -score(r)))


def _alike(r: Rated, best: Rated) -> bool:
    """Whether a candidate does as well as the best: surely no worse, or with less to fit."""
    close = r.after - best.after <= DISCREPANCY * best.removed
    fewer = r.candidate.dof < best.candidate.dof
    return bool(close and (fewer or paired(best.fall - r.fall) < BEYOND))


def _values(c: Candidate) -> tuple[int, int]:
    """Values that a candidate fits, and shape values that its law has."""
    return c.dof, len(c.term.shape)


# ---------------------------------------------------------------------- names


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
    """

    candidate: Candidate
    confidence: float
    rivals: list[Candidate]


def exchange(search: Search) -> list[Named]:
    """Try every other effect in the place of each one that was found, beside all the others.

    One that does better takes the place; those that cannot be told from it are its rivals.
    """
    named: dict[tuple[str, int], Named] = {}
    for _ in range(2):
        changed = False
        for c in list(search.found):
            if c.term.key in named:
                continue
            rated, projector = _beside(search, c)
            rated = _settled(rated, c, search.now)
            other = _better(search, c, rated)
            if other is not None:
                changed = True
                named.clear()
                break
            named[c.term.key] = _weighed(search, c, rated, projector)
        if not changed:
            break
    return [named.get(c.term.key) or Named(c, 0.5, []) for c in search.found]


def _beside(search: Search, c: Candidate) -> tuple[list[Rated], Projector]:
    """Every effect of a joint beside the model without one of them, rated; and that projector."""
    now = search.now
    rung = search.rung("without", without(now.result.model, c, search.problem), now.result.sigma)
    result = rung.result
    own, moves = c.term.effect, np.flatnonzero(~search.problem.holds).tolist()
    terms = [t for t in terms_to_try(result, moves)[0] if _comparable(t, own, c.joint)]
    projector, found = tried(result, terms)
    floor = search.first.floor if search.first else None
    assert floor is not None  # noqa: S101
    priced(found, floor, result)
    artefacts.mark_smoothers(found, projector)
    artefacts.mark_blurred(found, result, projector)
    rated = rate(result, search.split, found)
    motion = search.problem.motions[0]
    others = [f for f in search.found if f is not c]
    sound = [
        r for r in rated
        if r.candidate.name == own.name
        or (
            r.removed > 0 and r.candidate.score > 0 and physical(r.candidate, motion)
            and not (r.candidate.smoother or r.candidate.blurred)
            and r.candidate.absorbed < 0.9999 and in_time(r.candidate, result)
            and not any(kindred(r.candidate, f) for f in others)
        )
    ]  # fmt: skip
    return sound, projector


def _own(r: Rated, c: Candidate) -> bool:
    """Whether a rated candidate is an effect of the model itself."""
    return r.candidate.term.key == c.term.key


def _settled(rated: list[Rated], c: Candidate, now: Visited) -> list[Rated]:
    """The same; an effect of the model that a rival seems to beat counts as the model has it.

    Its shapes were searched beside everything then, the rivals' coarsely.
    """
    own = next((r for r in rated if _own(r, c)), None)
    if own is None or all(r.after > own.after - DISCREPANCY * own.removed for r in rated):
        return rated
    return [_refitted(r, now) if r is own else r for r in rated]


def _refitted(r: Rated, now: Visited) -> Rated:
    """An effect of the model with the errors that the model has, where its shapes settled lower."""
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
        r for r in rated
        if (r.candidate.name, c.term.joint) not in search.refused
        and (r is own or r.candidate.name != c.name) and r.joint == c.joint
    ]  # fmt: skip
    if own is None or not good:
        renew(search.now.result)
        return None
    best = simplest(good, search.score)
    if best is own or paired(best.fall - own.fall) < 1.0 or best.after > own.after:
        renew(search.now.result)
        return None
    now = search.now
    model = without(now.result.model, c, search.problem) + as_use(best.candidate, search.problem)
    label = f"{describe(best.candidate, search.problem)} for {describe(c, search.problem)}"
    rung = search.rung(label, model, now.result.sigma)
    weight = ~search.problem.holds / np.maximum(now.errors.power, 1e-300)
    gain = paired((now.errors.squared - rung.errors.squared) @ weight)
    if gain < 1.0 or rules.fails(rules.Refit(search, best, now, rung), FORMS):
        search.refused.add((best.candidate.name, c.term.joint))
        renew(now.result)
        return None
    rung.added = (best.candidate,)
    search.rungs.append(rung)
    search.found[search.found.index(c)] = best.candidate
    search.refused.add((c.name, c.term.joint))
    return best.candidate


def _weighed(
    search: Search, c: Candidate, rated: list[Rated], projector: Projector
) -> Named:  # fmt: skip
    """Confidence and rivals of an effect among those that could stand in its place.

    The lesser of two weights: by the likelihood, tempered by what a law may miss of its effect,
    and by how often it does best when blocks are drawn anew.
    """
    rated = _in_noise(search, c, rated)
    order = sorted((r.candidate for r in rated), key=ranking)
    own = next((x for x in order if x.term.key == c.term.key), None)
    if own is None:
        return Named(c, 0.5, [])
    rest = [x for x in order if x is not own]
    _, likely, rivals = choose([own, *rest], projector)
    drawn = _drawn(own, rated, ~search.problem.holds)
    rivals += [r.candidate for r, p in drawn if p >= RIVAL and r.candidate not in [own, *rivals]]
    best = next(p for r, p in drawn if r.candidate is own)
    return Named(c, min(likely, best), rivals)


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
    out = []
    for r in rated:
        count = r.now.count.sum(axis=0) / colour
        fall = (r.now.power - r.errors.power) / np.maximum(noise, 1e-300)
        chi2 = float(np.sum((count * fall)[~search.problem.holds])) + 2.0 * r.candidate.dof
        size = float(np.log(max(float(count[r.joint]), 2.0)))
        net = max(r.candidate.dof - search.replaced(r.candidate), 1)
        out.append(replace(r, candidate=replace(r.candidate, chi2=chi2, price=net * size)))
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
        race = _Race(Table(search.problem, search.split, now.result.sigma, base, free), free, j)
        every = [g.key for g in base]
        taken = float(search.base.errors.power[j]) - race.power(every)
        beside = race.best(every, every)
        for c in (c for c in search.found if c.joint == j):
            rest = [k for k in every if k != c.term.key]
            own = race.power(rest) - race.power(every)
            gain, words = beside
            out[c.term.key] = (taken / (taken + gain) if taken > 0 else 0.0, words)
            if not c.term.effect.relations.replaces:  # what it replaced is not there to be put back
                gain, words = race.best(rest, every)
                stands = own > 0 and gain <= (0.0 if words == FOIL else BEATEN) * own
                out[c.term.key] = min(
                    out[c.term.key], (own / (own + gain) if stands else 0.0, words)
                )
    return out


@dataclass(frozen=True)
class _Race:
    """A model of one joint, and free functions that run against its names."""

    table: Table
    free: list[Group]
    joint: int

    def power(self, keys: Sequence[Hashable]) -> float:
        """Held-out mean square error of the joint."""
        return float(self.table.errors(keys).power[self.joint])

    def best(self, keys: Sequence[Hashable], against: Sequence[Hashable]) -> tuple[float, str]:
        """What is sure of how much the best function with `keys` does better than `against`."""
        start, j = self.table.errors(against), self.joint
        gain, words = 0.0, ""
        for g in self.free:
            after = self.table.errors([*keys, g.key])
            fall = start.squared[:, j] - after.squared[:, j]
            sure = float(start.power[j] - after.power[j])
            sure *= max(1.0 - SURE / max(paired(fall), 1e-9), 0.0)
            if sure > gain:
                gain, words = sure, str(g.key[1])  # type: ignore[index]
        return gain, words
