"""The models on the way of a search: fitted, judged, and made into other ones.

Each is judged on blocks that it was not fitted to, and on held-out runs.  Another one has an effect
less, another form of one, or values and shapes that stay; and every effect of the catalogue may be
added, which is the evidence beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis import artefacts
from hil.diagnosis.attribution import as_use
from hil.diagnosis.candidates import Rated, model_groups, rate, tried
from hil.diagnosis.constants import HALF, WORTH
from hil.diagnosis.evidence import EFFECT, detect, measured_floor, priced, terms_to_try
from hil.diagnosis.grams import BlockErrors, GramTable, Split
from hil.diagnosis.heldout import Examiner, of_blocks
from hil.diagnosis.residual_tests import changes, changes_somewhere
from hil.diagnosis.types import Candidate, Change, Evidence, Floor, Step, describe
from hil.identify.context import renew
from hil.identify.design import Key, Term, head, prefix
from hil.identify.multistep import MultiStep, both
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.identify.shape_search import rounder, together
from hil.identify.timing import fit_aligned
from hil.models import catalogue
from hil.models.effect import Trait
from hil.models.model import RobotModel, Use, Value

FloatArray = NDArray[np.float64]


def without(model: RobotModel, c: Candidate, problem: Problem) -> RobotModel:
    """A model without an effect that was added on one joint."""
    use = as_use(c, problem)
    rest = tuple(u for u in model.effects if _place(u) != _place(use))
    return replace(model, effects=rest)


def other_form(problem: Problem, result: FitResult, c: Candidate) -> RobotModel | None:
    """A fitted model with a found effect in the form that leaves least, sought with its sign.

    None where it has no other form, or none is found.
    """
    own = c.term.effect
    terms = {t.key: t for t in result.terms}
    term = terms.get(c.term.key)
    dry = [t for t in terms.values() if t.joint == c.joint and Trait.DRY in t.effect.traits]
    forms = {s[1:] for s in problem.grid(own, c.term.joint)}
    sized = bool(own.shape) and own.shape[0].size
    if term is None or not dry or not sized or own.scope.whole or len(forms) < 2:
        return None
    renew(result)
    found = together(problem, result.terms, result.sigma, term, dry[0])
    if found is None:
        return None
    model = result.model
    for t in found:
        model = _reshaped(model, t, problem)
    return model


def _reshaped(model: RobotModel, term: Term, problem: Problem) -> RobotModel:
    """A fitted model with other shape values of one of its terms."""
    head = prefix(term, problem.joints)
    values = {f"{head}.{p.name}": x for p, x in zip(term.effect.shape, term.shape, strict=True)}
    use = model.effects[term.use]
    new = {n: replace(v, value=values.get(n, v.value)) for n, v in use.values.items()}
    effects = list(model.effects)
    effects[term.use] = replace(use, values=new)
    return replace(model, effects=tuple(effects))


def _place(use: Use) -> tuple[str, tuple[str, ...], bool]:
    """What tells the uses of an effect in a model apart."""
    return use.type, use.joints, bool(use.options.get("per_run"))


#: Options of an effect whose values stay.
_KEPT = {"fixed": True, "fixed_shape": True}


def with_values_kept(model: RobotModel) -> RobotModel:
    """A fitted model whose values stay; but those that every run has by itself."""
    effects = tuple(
        u if u.options.get("per_run") else replace(u, options={**u.options, **_KEPT})
        for u in model.effects
    )
    return replace(model, effects=effects)


def uncorrected(model: RobotModel) -> RobotModel:
    """A fitted model without its corrections; what stands for a description stays."""
    table = catalogue.table()
    gone = {n for n, e in table.items() if e.traits & Trait.CORRECTION and not _stands(e.traits)}
    return replace(model, effects=tuple(u for u in model.effects if u.type not in gone))


def _stands(traits: Trait) -> bool:
    """Whether a correction stands for the robot's geometry."""
    return bool(traits & Trait.GEOMETRY)


def held(model: RobotModel) -> RobotModel:
    """A fitted model with its shapes held."""
    stay = {"fixed_shape": True}
    return replace(
        model, effects=tuple(replace(u, options={**u.options, **stay}) for u in model.effects)
    )


def reverted(result: FitResult, c: Candidate) -> RobotModel:
    """A fitted model with what an effect replaces in its place, and all its shapes held.

    What both have of a shape, as how sharply friction turns, stays what it is.
    """
    j, model = c.term.joint, without(held(result.model), c, result.problem)
    term = next(t for t in result.terms if t.key == c.term.key)
    known = {p.name: x for p, x in zip(term.effect.shape, term.shape, strict=True)}
    alike = {
        (name, f"{head(e, j)}.{p.name}"): Value(known[p.name])
        for name in term.effect.relations.replaces
        for e in (catalogue.get(name),)
        for p in e.shape
        if p.name in known
    }
    effects = tuple(
        replace(u, values=u.values | {n: v for (own, n), v in alike.items() if own == u.type})
        for u in model.effects
    )
    return replace(model, effects=effects)


def let_go(result: FitResult, before: RobotModel) -> FitResult:
    """A fit whose shapes are held no more than in another model of the same effects."""
    own = {_place(u): u.options for u in before.effects}
    effects = tuple(replace(u, options=own[_place(u)]) for u in result.model.effects)
    terms = [
        replace(t, fixed_shape=bool(own[_place(effects[t.use])].get("fixed_shape")))
        for t in result.terms
    ]
    return replace(result, model=replace(result.model, effects=effects), terms=terms)


def freed(result: FitResult, named: FitResult) -> FitResult:
    """A fit with the effects and values of another one beside its own corrections."""
    own = {_place(u): u for u in named.model.effects}
    effects = tuple(own.get(_place(u), u) for u in result.model.effects)
    model = replace(result.model, effects=effects)
    return replace(result, model=model, values={**result.values, **named.values})


# ------------------------------------------------------------ on the way


@dataclass
class Visited:
    """A model on the way, with its errors on the fitted runs' folds and on held-out runs."""

    step: Step
    errors: BlockErrors
    added: tuple[Candidate, ...] = ()
    #: Its simulated error, once it was asked for.
    simulated: MultiStep | None = None

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
    ) -> bool:
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
class _Beside:
    """What was tried beside a fit, before it was held against any noise.

    One evidence is asked for with several floors: neither shapes nor held-out worth depend on them.
    """

    result: FitResult
    projector: Projector
    changed: tuple[Change, ...]
    #: Whether a value changes within the runs, be it in each at an instant of its own.
    sudden: bool
    #: Candidates by term, and whether it has values a run; None for one that has no shape here.
    rated: dict[tuple[Key, bool], Rated | None] = field(default_factory=dict)

    def of(self, terms: Sequence[Term], split: Split) -> list[Rated]:
        """Candidates for terms with what they are worth; those not tried yet are tried now."""
        fresh = [t for t in terms if (t.key, t.per_run) not in self.rated]
        if fresh:
            _, found = tried(self.result, fresh, projector=self.projector)
            self.rated |= {(t.key, t.per_run): None for t in fresh}
            for r in rate(self.result, split, found):
                self.rated[r.candidate.term.key, r.candidate.term.per_run] = r
        known = [self.rated[t.key, t.per_run] for t in terms]
        # evidence writes into its candidates
        return [replace(r, candidate=replace(r.candidate)) for r in known if r is not None]


@dataclass
class Models:
    """The models on the way of a search, from the given one to the last, and what may be added.

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
    rungs: list[Visited] = field(default_factory=list)
    #: The rung that names are judged against: the first one, unless the geometry was missing.
    start: int = 0
    #: Evidence beside the first model.
    first: Evidence | None = None
    _tried: _Tried | None = None
    _beside: _Beside | None = None
    #: The noise floor and the errors beside which it was measured.
    _measured: tuple[Floor, FloatArray] | None = None

    @property
    def moves(self) -> list[int]:
        """Joints that move."""
        return np.flatnonzero(~self.problem.holds).tolist()

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
        table = GramTable(self.problem, self.split, result.sigma, groups)
        keys = [g.key for g in groups]
        errors = table.errors(keys)
        if self.examine.kind == "holdout":
            heldout = self.examine(result)
        else:
            heldout = of_blocks(table.left_out(keys), self.problem, self.split)
        return Visited(Step(label, result, heldout), errors)

    def parted(self, result: FitResult, dealt: Split) -> FloatArray:
        """Squared errors (folds, d) on each fold of a dealing, fitted to the others."""
        renew(result)  # columns may depend on what another fit has found since
        groups = model_groups(result)
        errors = GramTable(self.problem, dealt, result.sigma, groups).errors(
            [g.key for g in groups]
        )
        out = np.zeros((dealt.folds, self.problem.d))
        np.add.at(out, dealt.fold, errors.squared)
        return out

    def simulated(self, rung: Visited) -> MultiStep:
        """The simulated error of a rung on the fitted runs."""
        if rung.simulated is None:
            renew(rung.result)
            rung.simulated = both(rung.result, self.problem)
        return rung.simulated

    def with_wider_sign(self, j: int, gone: Sequence[Candidate]) -> Visited | None:
        """A wider sign on joint j, beside all or without some; None where none is wider."""
        now, label, beside = self.now, self.now.step.label, self.now.result
        renew(beside)
        if gone:
            label, model = f"- {describe(gone[0], self.problem)}", beside.model
            for c in gone:
                model = without(model, c, self.problem)
            label += f" and {len(gone) - 1} more" if gone[1:] else ""
            beside = self.rung(label, model, beside.sigma).result
        found = rounder(beside, j)
        if not found:
            return None
        self.problem.least.update(found)
        return self.rung(label, beside.model, now.result.sigma)

    def signs_again(self, known: Mapping[Key, float]) -> None:
        """Let signs be as sharp as they were, `known` by term, beside the last model."""
        self.problem.least.clear()
        self.problem.least.update(known)
        renew(self.now.result)

    # ------------------------------------------------------------------ evidence

    def forget(self) -> None:
        """Drop what was tried beside the present model: something that it rests on has changed."""
        self._tried = self._beside = None

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
        if self._beside is None or self._beside.result is not result:
            projector, _ = tried(result, [])
            once = changes(result, projector)
            sudden = changes_somewhere(result, projector, once)
            self._beside = _Beside(result, projector, once, sudden)
        projector, changed = self._beside.projector, self._beside.changed
        terms, impossible = terms_to_try(result, joints, kind=kind)
        if not self._beside.sudden:
            terms = [t for t in terms if not t.effect.variation.sudden]
        rated = self._beside.of(terms, self.split)
        found = [r.candidate for r in rated]
        floor = self._floor(found, projector)
        priced(found, floor, result)
        detect(found, projector, floor, result, self.seed)
        artefacts.mark([c for c in found if c.detected], result, projector)
        rated.sort(key=lambda r: -r.removed / max(r.before, 1e-300))
        candidates = [r.candidate for r in rated]
        return Evidence(candidates, floor, projector, impossible, changed), rated

    def _floor(self, found: list[Candidate], projector: Projector) -> Floor:
        """The noise floor; measured again once an error has halved, and no larger then.

        Beside a large error candidates take shapes that explain none of the rest.
        """
        result = self.now.result
        if self.first is None or self._measured is None:
            self._measured = measured_floor(found, projector, result), result.rms
        before, rms = self._measured
        if np.any(result.rms[self.moves] < HALF * rms[self.moves]):
            self._measured = measured_floor(found, projector, result).below(before), result.rms
        return self._measured[0]


def missed(rest: BlockErrors, now: BlockErrors, joints: Sequence[int]) -> bool:
    """Whether the error of a joint is larger without an effect by what would be worth a name."""
    return any(rest.power[j] > (1 + WORTH / 2) ** 2 * now.power[j] for j in joints)
