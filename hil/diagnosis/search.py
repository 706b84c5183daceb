"""The search: forward while something pays, backward and by exchange, joint by joint.

In each round every joint that is still open gets its best candidate; all of them are fitted
together with everything else.  A joint closes when nothing pays on it any more.  What an effect is
judged by is what is left now, on blocks that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.compare import blur, denoise
from hil.compare.attribute import choose, kindred, physical
from hil.compare.candidate import Candidate, ranking
from hil.compare.changes import changes
from hil.compare.detect import detect
from hil.compare.evidence import Evidence, _floor, in_time, priced
from hil.compare.findings import Step, describe
from hil.compare.heldout import Examiner
from hil.compare.retest import as_use
from hil.diagnosis import rules
from hil.diagnosis.candidates import (
    Rated,
    model_groups,
    paired,
    rate,
    terms_to_try,
    tried,
)  # fmt: skip
from hil.diagnosis.competitors import COMPETITORS, competitor
from hil.diagnosis.constants import BEYOND, DISCREPANCY, WORTH
from hil.diagnosis.folds import Split
from hil.diagnosis.grams import Errors, Table
from hil.identify.context import renew
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.identify.timing import fit_aligned
from hil.models.model import RobotModel

FloatArray = NDArray[np.float64]
#: Rules of a fit that ask for its values alone, not for its errors.
FORMS = ("coefficients", "scales", "allowed")


@dataclass
class Rung:
    """A model on the way, with its errors on the fitted runs' folds and on held-out runs."""

    step: Step
    errors: Errors
    added: tuple[Candidate, ...] = ()

    @property
    def result(self) -> FitResult:
        """Its fit."""
        return self.step.result


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
    stops: dict[tuple[str, int], rules.CheckResult] = field(default_factory=dict)
    #: Rules that stopped something -> whether of one thing at least no other would have.
    fired: dict[str, bool] = field(default_factory=dict)
    rungs: list[Rung] = field(default_factory=list)
    found: list[Candidate] = field(default_factory=list)
    first: Evidence | None = None
    last: Evidence | None = None

    @property
    def now(self) -> Rung:
        """The last model."""
        return self.rungs[-1]

    def rung(self, label: str, model: RobotModel, scale: FloatArray | None = None) -> Rung:
        """Fit a model and judge it."""
        result = fit_aligned(self.problem, model, scale)
        return self.judged(label, result)

    def judged(self, label: str, result: FitResult) -> Rung:
        """A fit with its errors."""
        groups = model_groups(result)
        table = Table(self.problem, self.split, result.sigma, groups)
        errors = table.errors([g.key for g in groups])
        return Rung(Step(label, result, self.examine(result)), errors)

    # ------------------------------------------------------------------ evidence

    def evidence(self, joints: Sequence[int]) -> tuple[Evidence, list[Rated]]:
        """All candidates on some joints beside the present model."""
        result = self.now.result
        terms, impossible = terms_to_try(result, joints)
        projector, _ = tried(result, [])
        changed = changes(result, projector)
        if not changed:
            terms = [t for t in terms if not t.effect.sudden]
        projector, found = tried(result, terms)
        floor = _floor(found, projector, result) if self.first is None else self.first.floor
        priced(found, floor, result)
        detect(found, projector, floor, result, self.seed)
        denoise.mark(found, projector)
        blur.mark(found, result, projector)
        _, _, rated = rate(result, self.split, found)
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
        gone = {(name, c.term.joint) for name in c.term.effect.replaces}
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
                if any(p.joint == j or p.candidate.term.effect.whole_robot for p in picks)
            ]  # fmt: skip
            if not picks:
                return
            open_joints = self._added(picks, open_joints)
            self.backward()

    def _picks(
        self, rated: list[Rated], evidence: Evidence, joints: Sequence[int]
    ) -> list[Rated]:
        """The best candidate of each joint, or one of the whole robot that does more alone."""
        good = [r for r in rated if self.pays(r, evidence)]
        own = [r for r in good if not r.candidate.term.effect.whole_robot]
        picks = []
        for j in joints:
            mine = [r for r in own if r.joint == j]
            if mine:
                picks.append(simplest(mine, self.score))
        whole = [r for r in good if r.candidate.term.effect.whole_robot]
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
        now, moves = self.now.errors, ~self.problem.holds
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

    def _fitted(self, picks: list[Rated], before: Rung) -> list[Rated]:
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

    def _holds(self, p: Rated, before: Rung, after: Rung) -> bool:
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
            if not any(t.key == key for t in now.result.terms) or c.term.effect.replaces:
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


def simplest(rated: list[Rated], score: Callable[[Rated], float]) -> Rated:
    """Of the candidates that do as well as the best one, the one with the least to fit.

    As well: within what a library's law misses of its effect.
    """
    best = max(rated, key=score)
    alike = [r for r in rated if r.after - best.after <= DISCREPANCY * best.removed]
    return min([best, *alike], key=lambda r: (r.candidate.dof, -score(r)))


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
            other = _better(search, c, rated)
            if other is not None:
                changed = True
                named.clear()
                break
            named[c.term.key] = _weighed(c, rated, projector)
        if not changed:
            break
    return [named.get(c.term.key) or Named(c, 0.5, []) for c in search.found]


def _beside(search: Search, c: Candidate) -> tuple[list[Rated], Projector]:
    """Every effect of a joint beside the model without one of them, rated; and that projector."""
    now = search.now
    rung = search.rung("without", without(now.result.model, c, search.problem), now.result.sigma)
    result = rung.result
    terms, _ = terms_to_try(result, [c.term.joint])
    own = c.term.effect
    terms = [
        t for t in terms
        if t.effect.name == own.name
        or not (t.effect.of_robot or t.effect.spectral or t.effect.sudden or own.whole_robot)
    ]  # fmt: skip
    projector, found = tried(result, terms)
    floor = search.first.floor if search.first else None
    assert floor is not None  # noqa: S101
    priced(found, floor, result)
    denoise.mark(found, projector)
    blur.mark(found, result, projector)
    _, _, rated = rate(result, search.split, found)
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


def _better(search: Search, c: Candidate, rated: list[Rated]) -> Candidate | None:
    """The effect that takes the place of one, if the model with it does better held out."""
    own = next((r for r in rated if r.candidate.term.key == c.term.key), None)
    good = [r for r in rated if (r.candidate.name, c.term.joint) not in search.refused]
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
    j = c.joint
    gain = paired(now.errors.squared[:, j] - rung.errors.squared[:, j])
    if gain < 1.0 or rules.fails(rules.Refit(search, best, rung, rung), FORMS):
        search.refused.add((best.candidate.name, c.term.joint))
        renew(now.result)
        return None
    search.rungs.append(rung)
    search.found[search.found.index(c)] = best.candidate
    search.refused.add((c.name, c.term.joint))
    return best.candidate


def _weighed(c: Candidate, rated: list[Rated], projector: Projector) -> Named:
    """Confidence and rivals of an effect among those that could stand in its place."""
    order = sorted((r.candidate for r in rated), key=ranking)
    own = next((x for x in order if x.term.key == c.term.key), None)
    if own is None:
        return Named(c, 0.5, [])
    rest = [x for x in order if x is not own]
    _, confidence, rivals = choose([own, *rest], projector)
    return Named(c, confidence, rivals)


def shares(search: Search) -> dict[int, tuple[float, str]]:
    """What the names of a joint take of all that they and any free function beside them take.

        share = D / (D + G),

    D the fall of the held-out mean square error by the names and G the further fall by the free
    function that takes most, where that is beyond chance.  With the function's variables.
    """
    now, first = search.now, search.rungs[0]
    joints = sorted({c.joint for c in search.found})
    if now.result.model.explains != "motor":
        return {}
    out = {}
    base = model_groups(now.result)
    for j in joints:
        free = [g for what in COMPETITORS if (g := competitor(search.problem, j, what)) is not None]
        table = Table(search.problem, search.split, now.result.sigma, [*base, *free])
        keys = [g.key for g in base]
        start = table.errors(keys)
        best, words = 0.0, ""
        for g in free:
            after = table.errors([*keys, g.key])
            fall = start.squared[:, j] - after.squared[:, j]
            gain = float(start.power[j] - after.power[j])
            # what is sure of it: less two standard errors
            sure = gain * max(1.0 - 2.0 / max(paired(fall), 1e-9), 0.0)
            if sure > best:
                best, words = sure, str(g.key[1])  # type: ignore[index]
        taken = max(float(first.errors.power[j] - start.power[j]), 1e-300)
        out[j] = (taken / (taken + best), words)
    return out
