"""The search: forward while something pays, and backward, joint by joint.

In each round every joint that is still open gets its best candidate; all of them are fitted
together with everything else.  A joint closes when nothing pays on it any more.  What an effect is
judged by is what is left now, on blocks that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil import work
from hil.diagnosis import remodel, rules
from hil.diagnosis.attribution import as_use, overlap
from hil.diagnosis.candidates import (
    Rated,
    model_groups,
    paired,
    rate_together,
    simplest,
    values_of,
)
from hil.diagnosis.constants import ADEQUATE, BEYOND, HALF, RISEN, WORTH
from hil.diagnosis.evidence import (
    CORRECTION,
    GEOMETRY,
    terms_to_try,
)
from hil.diagnosis.floor import practical
from hil.diagnosis.grams import BlockErrors, GramTable, Split
from hil.diagnosis.grams import split as dealt
from hil.diagnosis.remodel import Models, Visited, missed, without
from hil.diagnosis.types import Candidate, CheckResult, Evidence, Step, describe
from hil.identify.context import renew
from hil.identify.design import comes_back, replaced
from hil.identify.problem import Alignment
from hil.identify.screening import USUAL
from hil.identify.shape_search import expected_sign
from hil.identify.slow_motion import LESS
from hil.identify.timing import late_after_all
from hil.models import catalogue
from hil.models.effect import Trait
from hil.models.model import RobotModel

FloatArray = NDArray[np.float64]


#: Laws that are fitted in the place of corrections, of a joint.
HINTS = 3


@dataclass
class Search(Models):
    """State of the search: the models on the way, and what was found and refused."""

    refused: set[tuple[str, int]] = field(default_factory=set)
    #: Of these the ones that did not hold beside the present model of a joint, and which joint.
    beside: dict[tuple[str, int], int] = field(default_factory=dict)
    #: Why what might have been added was not, by effect and joint.
    stops: dict[tuple[str, int], CheckResult] = field(default_factory=dict)
    #: Rules that stopped something -> whether of one thing at least no other would have.
    fired: dict[str, bool] = field(default_factory=dict)
    #: Whether several joints have no robot description.
    blind: bool = False
    found: list[Candidate] = field(default_factory=list)
    #: Effects, and others that were tried in the place of each though they act otherwise.
    tried_for: set[tuple[tuple[str, int], tuple[str, int]]] = field(default_factory=set)
    #: Effect -> the first one in whose place it stands: what that explained is its doing.
    stands_for: dict[tuple[str, int], tuple[str, int]] = field(default_factory=dict)
    #: Effects whose names stand, by effect and joint: corrections leave them their efforts.
    standing: list[tuple[str, int]] = field(default_factory=list)
    #: Laws that do as much as all corrections of a joint, with the rungs that they give, by joint.
    instead: dict[int, list[tuple[Rated, Visited]]] = field(default_factory=dict)
    #: Evidence beside the last model.
    last: Evidence | None = None

    def pays(self, r: Rated, evidence: Evidence) -> bool:
        """Whether a candidate passes every rule; the first that stops it is kept.

        What was fitted and did not hold is no rule's matter: it is not tried again until the model
        of its joint has grown, so that the search ends.
        """
        tried = (r.candidate.name, r.candidate.term.joint) in self.refused
        known = self.stops.get(r.candidate.term.key)
        case = rules.RuleCase(self, r, evidence)
        stop = rules.refused(r, known) if tried else rules.stopped(case)
        if stop is not None:
            self.stops[r.candidate.term.key] = stop
        return stop is None

    def replaced(self, c: Candidate) -> int:
        """Values of the model that a candidate takes the place of."""
        gone = replaced(c.term)
        own = [t for t in self.now.result.terms if t.key in gone]
        return sum(len(t.effect.params) + len(t.effect.shape) for t in own)

    def of_conservative(self, j: int) -> float:
        """Power of joint j's error that masses and springs took, added without other laws there."""
        return self._taken_by(lambda c: c.term.effect.family in ("mass", "stiffness"), j)

    def of_motion(self, j: int) -> float:
        """The same of laws of the motion alone, which are the same at any time."""
        return self._taken_by(lambda c: not c.term.effect.variation.timed(c.term.shape), j)

    def _taken_by(self, kind: Callable[[Candidate], bool], j: int) -> float:
        out = 0.0
        for before, after in pairwise(self.rungs[self.start :]):
            there = [c for c in after.added if c.joint == j]
            if there and all(map(kind, there)):
                out += float(before.errors.power[j] - after.errors.power[j])
        return out

    # ------------------------------------------------------------------ forward

    def forward(self, joints: Sequence[int] | None = None) -> None:
        """Add what pays, joint by joint, until every one of some joints, or of all, has failed."""
        open_joints = self.moves if joints is None else list(joints)
        while open_joints:
            found = len(self.rungs) - self.start - 1
            work.at("seek effects", 0.5 - 0.35 * 0.6**found)
            evidence, rated = self.evidence(open_joints)
            if self.first is None and self._wide_from_the_start(evidence, rated):
                continue
            self.first = self.first or evidence
            self.last = evidence
            picks = self._picks(rated, evidence, open_joints)
            open_joints = [
                j
                for j in open_joints
                if any(p.joint == j or p.candidate.term.effect.scope.whole for p in picks)
            ]
            if not picks:
                return
            before = self.now
            open_joints = self._added(self._apart(picks, evidence), open_joints)
            if self.blind and self.now is not before:
                # what a large effect hid of the geometry is no news, and gets no name
                self._corrected([c.joint for c in self.now.added], GEOMETRY)
            if self.now is not before:
                self.reformed(self.now.added)
            self.backward()

    def given(self) -> None:
        """Go back to the given model, whatever was found beside it."""
        del self.rungs[self.start + 1 :]
        self.found, self.last = [], self.first
        self.forget()
        renew(self.now.result)

    def complete(self) -> None:
        """Wider signs and other forms, once nothing pays any more, and what then does."""
        if joints := self.rounded():
            self.forward(joints)
        if joints := self.reformed(self.found):
            self.forward(joints)

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
        self.rungs.append(self.rung("kept", remodel.with_values_kept(named.model), named.sigma))
        table = catalogue.table()
        self.refused = {k for k in self.refused if Trait.CORRECTION not in table[k[0]].traits}
        self._corrected(joints, CORRECTION)
        self.found, self.stops, self.fired = kept
        del self.rungs[first]
        for rung in self.rungs[first:]:
            rung.step = replace(rung.step, result=remodel.freed(rung.result, named))
        return self.rungs[start:]

    def reformed(self, some: Sequence[Candidate]) -> list[int]:
        """Effects with several forms in the one that leaves least, each sought with its sign.

        What was beside them when they were found may have left another form.

        Returns
        -------
        list of int
            Joints on which another one was found.
        """
        changed = []
        for c in some:
            now = self.now
            model = remodel.other_form(self.problem, now.result, c)
            if model is None:
                continue
            rung = self.rung(now.step.label, model, now.result.sigma)
            fall = (now.errors.squared - rung.errors.squared)[:, c.joint]
            worse = missed(rung.errors, now.errors, self.moves) or self._risen(rung, c.joint)
            if paired(fall) < RISEN or worse or self._by_the_clock(c, rung, float(fall.sum())):
                renew(now.result)
                continue
            rung.added = now.added
            self.rungs[-1] = rung
            self.forget()
            changed.append(c.joint)
        return changed

    def _by_the_clock(self, c: Candidate, rung: Visited, fall: float) -> bool:
        """Whether a clock takes the place of a state, and explains hardly more of its joint."""
        old, new = (
            next(t.shape for t in r.result.terms if t.key == c.term.key) for r in (self.now, rung)
        )
        timed = c.term.effect.variation.timed
        at = next((k for k, r in enumerate(self.rungs) if c in r.added), 0)
        if timed(old) or not timed(new) or not at:
            return False
        before, after = (r.errors.squared[:, c.joint].sum() for r in (self.rungs[at - 1], rung))
        return fall < (1 - USUAL) * float(before - after)

    def rounded(self) -> list[int]:
        """Signs that turn over a wider speed than their range, where no effect says as much.

        Friction of bearings, grease and seals may set in over a good part of the speed.  From the
        start such a sign would imitate bristles, filters and play; so it is tried when these have
        had their turn: beside all of them, in the place of all and in that of each.

        Returns
        -------
        list of int
            Joints on which one was found.
        """
        return [j for j in self.moves if self._rounded(j)]

    def _wide_from_the_start(self, evidence: Evidence, rated: Sequence[Rated]) -> bool:
        """Whether a wider sign alone brings a joint's error to its floor, as no effect does better.

        A lubricated slide lacks nothing: names would follow what a sign of the usual width misses.
        """
        found = False
        for j in self.moves:
            now, known = self.now, dict(self.problem.least)
            if not evidence.floor.exceeded(now.result.rms, j):
                continue
            rung = self.with_wider_sign(j, ())
            most = max((self.score(r) for r in rated if r.joint == j), default=0.0)
            if rung and self._suffices(rung, j, most, evidence):
                rung.added, found = now.added, True
                self.rungs[-1] = rung
                continue
            self.signs_again(known)
        if found:
            self.forget()
        return found

    def _suffices(self, rung: Visited, j: int, most: float, evidence: Evidence) -> bool:
        """Whether a model without a further value does all, and as much as a score of `most`."""
        now, new = self.now.errors, rung.errors
        if not rules.to_the_floor(float(now.power[j]), float(new.power[j]), j, evidence):
            return False
        return self._scored(now, new, ()) >= most and not self._risen(rung, j)

    def _rounded(self, j: int) -> bool:
        """Whether joint j has a wider sign now, beside what was found on it or without some."""
        now, known = self.now, dict(self.problem.least)
        own = [c for c in self.found[::-1] if c.joint == j]
        for gone in ([], *([own] if len(own) > 1 else []), *([c] for c in own)):
            rung = self.with_wider_sign(j, gone)
            if rung and self._does_better(rung, j, gone):
                if gone:
                    self.rungs.append(rung)
                    self.found = [c for c in self.found if not any(c is g for g in gone)]
                    self.refused |= {(c.name, c.term.joint) for c in gone}
                else:
                    rung.added = now.added
                    self.rungs[-1] = rung
                self.forget()
                return True
            self.signs_again(known)
        return False

    def _does_better(self, rung: Visited, j: int, gone: Sequence[Candidate]) -> bool:
        """Whether it lowers joint j's error clearly; in the place of an effect, at all."""
        now = self.now.errors
        sure = paired((now.squared - rung.errors.squared)[:, j]) > (0.0 if gone else RISEN)
        small = not gone and rung.errors.power[j] > (1 - WORTH) ** 2 * now.power[j]
        worse = missed(rung.errors, now, self.moves) or self._risen(rung, j)
        return sure and not small and not worse

    def _risen(self, rung: Visited, j: int) -> bool:
        """Whether held-out runs say that a model made for joint j is worse than the present one."""
        small = practical(self.problem)
        return bool(self.now.step.heldout.risen(rung.step.heldout, j, self.moves, small))

    def _shares(self, rung: Visited) -> FloatArray:
        """Errors on left-out blocks and runs (2, moving) over the effort as it is aligned now."""
        size = self.problem.rms(self.problem.effort)[self.moves]
        return np.stack([x.rms[self.moves] / size for x in (rung.errors, rung.step.heldout)])

    def retimed(self) -> bool:
        """Efforts of another lateness, where all that was found leaves clearly less with them so.

        Returns
        -------
        bool
            Whether they are taken so now.
        """
        problem, rungs = self.problem, self.rungs
        before, settled = problem.alignment, problem.aligned
        if not self.found or not late_after_all(self.now.result):
            return False
        self._fitted_anew()
        now, then = (np.maximum(self._shares(x), 1e-300) for x in (self.now, rungs[-1]))
        if np.sum(np.log(now / then)) < 0.0:
            return True
        self.rungs, self._measured = rungs, None
        self._aligned_as(before, settled)
        return False

    def _aligned_as(self, alignment: Alignment, settled: bool) -> None:
        """Efforts aligned as they were, beside the last model."""
        self.problem.aligned = settled
        self.problem.align_effort(alignment)
        renew(self.now.result)

    def _fitted_anew(self) -> None:
        """Every model on the way fitted anew, to efforts that are aligned otherwise now."""
        fresh = [self.rung(r.step.label, r.result.model, r.result.sigma) for r in self.rungs]
        for old, new in zip(self.rungs, fresh, strict=True):
            new.added = old.added
        # the noise floor is that of the other alignment
        self.rungs, self._measured = fresh, None
        self.forget()

    def untimed(self) -> bool:
        """Efforts as they were recorded, where all that was found leaves clearly less with them so.

        A lateness within a sample is that of the slow motion, and holds as long as something may
        be missing that looks late.  Friction that sticks at its reversals looks early, and has no
        law.  A filter, or a larger lateness, was found beside what the given model lacked.  In the
        end what predicts the efforts counts, each in its own scale: a filter that is undone makes
        them larger.

        Returns
        -------
        bool
            Whether they are taken so now.
        """
        problem, now = self.problem, self.now
        before, settled = problem.alignment, problem.aligned
        given = problem.given_shift is not None or problem.given_lag.lag or problem.given_lag.rate
        if given or not (before.shift or before.lag or before.rate):
            return False
        error = self._shares(now)
        problem.align_effort(Alignment())
        problem.aligned = True
        last = self.rung(now.step.label, now.result.model, now.result.sigma)
        ratio = self._shares(last) / np.maximum(error, 1e-300)
        if np.any(ratio > 1 + WORTH) or np.prod(ratio) ** (1.0 / ratio.size) > 1 - LESS:
            self._aligned_as(before, settled)
            return False
        self._fitted_anew()
        if not self.found:  # its evidence and floor are those of the other alignment
            self.first = None
            self.first, _ = self.evidence(self.moves)
            self.last = self.first
        return True

    def blunted(self) -> None:
        """Signs as blunt as is to be expected from the fitted runs, once nothing pays any more.

        The search takes sharp ones, for a blunt sign imitates what is missing.  Strokes with rests
        say no more than how blunt it may be, and so do fast runs.
        """
        now, problem = self.now, self.problem
        if self.examine.kind == "holdout":  # they have said how blunt
            return
        colour = self.first.floor.inflation if self.first else np.ones(problem.d)
        renew(now.result)
        found = expected_sign(now.result, problem.count / colour)
        if not found:
            return
        before = dict(problem.least)
        problem.least.update(found)
        rung = self.rung(now.step.label, now.result.model, now.result.sigma)
        if missed(rung.errors, now.errors, self.moves):
            self.signs_again(before)
            return
        rung.added = now.added
        self.rungs[-1] = rung
        self.forget()

    def settle(self, corrections: int) -> bool:
        """Whether the model without its last corrections does better than it did before them.

        Fitted on from the values that it has beside them: the fit before was in a local minimum.
        The lower one then takes its place, and the corrections are gone.
        """
        last, before = self.now, self.rungs[-1 - corrections]
        model = remodel.uncorrected(last.result.model)
        rung = self.rung(before.step.label, model, last.result.sigma)
        if not self._lower(rung, before):
            renew(last.result)
            return False
        rung.added = before.added
        self.rungs[-1 - corrections :] = [rung]
        self.forget()
        return True

    def _lower(self, rung: Visited, before: Visited) -> bool:
        """Whether a fit's left-out error is clearly lower on a joint, and higher on none."""
        old, new = (
            np.stack([x.errors.rms, x.step.heldout.rms])[:, self.moves] for x in (before, rung)
        )
        clear = np.any(new[0] < (1 - WORTH) * old[0])
        return bool(clear and np.all(new < (1 + WORTH / 2) * old))

    def alike(self, joints: Sequence[int]) -> dict[int, tuple[str, ...]]:
        """Laws that do as much as all corrections of a joint, by joint, the simplest first.

        They are sought beside the last model without its corrections, and fitted in their place.
        As names they were too small beside what was named before, or hidden by shapes that a fit
        without them takes; here they are a hint (but see `promoted`).
        """
        self.instead = {}
        if not joints:
            return {}
        last, stops, fired = self.now, dict(self.stops), dict(self.fired)
        rest = remodel.uncorrected(last.result.model)
        self.rungs.append(self.rung("without", remodel.held(rest), last.result.sigma))
        evidence, rated = self.evidence(joints)
        with rules.without("discrepancy"):
            good = [r for r in rated if self.pays(r, evidence)]
        self.instead = {j: self._doing_as_much(j, good, rest, last) for j in joints}
        self.rungs.pop()
        self.stops, self.fired = stops, fired
        self.forget()
        names = {j: [r.candidate.name for r, _ in laws] for j, laws in self.instead.items()}
        return {j: tuple(dict.fromkeys(some)) for j, some in names.items()}

    def _doing_as_much(
        self, j: int, good: list[Rated], rest: RobotModel, last: Visited
    ) -> list[tuple[Rated, Visited]]:
        """Of the best candidates of a joint those that reach a tenth more than `last` does."""
        most = float(last.errors.power[j])
        some = [r for r in good if r.joint == j and r.removed > HALF * (r.before - most)]
        out = []
        for r in sorted(some, key=values_of)[:HINTS]:
            model = rest + as_use(r.candidate, self.problem)
            rung = self.rung("in place", model, last.result.sigma)
            if rung.errors.power[j] < ADEQUATE**2 * most:
                out.append((r, rung))
        return out

    def promoted(self, corrections: int) -> bool:
        """Whether a law that does as much as all corrections of its joint takes their place.

        Beside the fixed shapes of what was named before it seemed too small: it does more once
        these have settled with it, and what it takes then is no inaccuracy of theirs.
        """
        before = self.rungs[-1 - corrections]
        for laws in self.instead.values():
            for r, rung in laws[:1]:
                if rules.fails(rules.Refit(self, r, before, rung)) is not None:
                    continue
                label = f"+ {describe(r.candidate, self.problem)}"
                rung.step, rung.added = replace(rung.step, label=label), (r.candidate,)
                self.rungs[-corrections:] = [rung]
                self.found.append(r.candidate)
                renew(rung.result)
                self.forget()
                return True
        return False

    def geometry(self) -> None:
        """Add what stands for a robot description that is missing; names are sought beside it."""
        if terms_to_try(self.now.result, self.moves, kind=GEOMETRY)[0]:
            self._corrected(self.moves, GEOMETRY)
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
                names, before = list(self.found), self.now
                self._added(picks, left)
                self.found = names
                if self.now is not before:
                    self._sharpened()

    def _sharpened(self) -> None:
        """Signs of the joints that got a correction as sharp as before, where that does better.

        A blunt one may have stood for what the correction follows, and holds it back now.
        """
        now, least = self.now, self.problem.least
        joints = {c.joint for c in now.added}
        blunt = {key: least.pop(key) for key in list(least) if key[1] in joints}
        if not blunt:
            return
        rung = self.rung(now.step.label, now.result.model, now.result.sigma)
        if not self._lower(rung, now):
            least.update(blunt)
            renew(now.result)
            return
        rung.added = now.added
        self.rungs[-1] = rung
        self.forget()

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
            if self.score(best) > self._instead_of(best, own, picks):
                return [best]
        return picks

    def _apart(self, picks: list[Rated], evidence: Evidence) -> list[Rated]:
        """Picks without those of an effect that has a better one on another joint and looks alike.

        Of the gains of two motors the data know the ratio alone: one stands for both, and the
        other joint is asked again beside it.
        """
        projector, kept = evidence.projector, list[Rated]()
        for p in sorted(picks, key=lambda p: -self.score(p)):
            same = (k.candidate for k in kept if k.candidate.name == p.candidate.name)
            if not (projector and any(overlap(c, p.candidate, projector) > HALF for c in same)):
                kept.append(p)
        return [p for p in picks if any(p is k for k in kept)]

    def _instead_of(self, whole: Rated, own: list[Rated], picks: list[Rated]) -> float:
        """Score of what stands in the place of an effect of the whole robot: the pick of its joint.

        A difference between runs may be one of the robot, or one on each joint: of what differs
        between runs the best of every joint count together.
        """
        rest = max((self.score(p) for p in picks if p.joint == whole.joint), default=-np.inf)
        if not whole.candidate.term.per_run:
            return rest
        apart = [
            simplest(mine, self.score)
            for j in self.moves
            if (mine := [r for r in own if r.joint == j and r.candidate.term.per_run])
        ]
        return max(rest, self.together(apart)) if len(apart) > 1 else rest

    def together(self, some: Sequence[Rated]) -> float:
        """Score of several candidates as of one."""
        each = [r.candidate for r in some]
        now, errors = rate_together(self.now.result, self.split, each)
        return self._scored(now, errors, [(c, r.joint) for c, r in zip(each, some, strict=True)])

    def score(self, r: Rated) -> float:
        """Evidence for a candidate over all joints that move, less the price of its values.

            sum_j N_j log(before_j / after_j) - m log N,

        with N_j independent instants, by the correlation of what the largest model leaves.
        Source: Schwarz, Ann. Statist. 6, 1978.
        """
        return self._scored(r.now, r.errors, [(r.candidate, r.joint)])

    def _scored(
        self, now: BlockErrors, errors: BlockErrors, added: Sequence[tuple[Candidate, int]]
    ) -> float:
        """The same of errors without and with some candidates, each with its joint."""
        moves = ~self.problem.holds
        colour = self.first.floor.inflation if self.first else np.ones(self.problem.d)
        count = np.maximum(now.count.sum(axis=0) / colour, 2.0)
        ratio = np.maximum(now.power, 1e-300) / np.maximum(errors.power, 1e-300)
        price = sum(max(c.dof - self.replaced(c), 1) * float(np.log(count[j])) for c, j in added)
        return float(np.sum((count * np.log(ratio))[moves])) - price

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
        self.beside |= {(p.candidate.name, p.candidate.term.joint): p.joint for p in bad}
        self.refused |= self.beside.keys()
        if self.now is before:
            renew(before.result)
        return joints

    def _fitted(self, picks: list[Rated], before: Visited) -> list[Rated]:
        """Fit with some picks; the new rung is kept if all of them hold, else those that do not."""
        model = before.result.model
        for p in picks:
            model = model + as_use(p.candidate, self.problem)
        label = "; ".join(f"+ {describe(p.candidate, self.problem)}" for p in picks)
        judged = (self.split, [(r.step, r.errors) for r in self.rungs])
        if self.split.by_run and any(p.candidate.term.per_run for p in picks):
            self._by_blocks()
        rung = self.rung(label, model, before.result.sigma)
        bad = [p for p in picks if not self._holds(p, before, rung)]
        if bad and self.split is not judged[0]:
            self._judged_by(*judged)
        if not bad:
            rung.added = tuple(p.candidate for p in picks)
            self.rungs.append(rung)
            self.found += list(rung.added)
            self._asked_again({p.joint for p in picks})
        return bad

    def _by_blocks(self) -> None:
        """Judge on blocks of all runs: no run determines the values that another one has."""
        self.split = dealt(self.problem, self.seed, whole_runs=False)
        judged = []
        for rung in self.rungs:
            renew(rung.result)
            again = self.judged(rung.step.label, rung.result)
            judged.append((again.step, again.errors))
        self._judged_by(self.split, judged)

    def _judged_by(self, split: Split, judged: Sequence[tuple[Step, BlockErrors]]) -> None:
        """Give every rung its errors on a dealing of the instants."""
        self.split = split
        self.forget()
        for rung, (step, errors) in zip(self.rungs, judged, strict=True):
            rung.step, rung.errors = step, errors

    def _asked_again(self, joints: set[int]) -> None:
        """What did not hold may hold beside a model that has grown."""
        again = {key for key, j in self.beside.items() if j in joints}
        self.refused -= again
        self.beside = {key: j for key, j in self.beside.items() if key not in again}

    def _holds(self, p: Rated, before: Visited, after: Visited) -> bool:
        """Whether an effect stands after everything was fitted again."""
        fail = rules.fails(rules.Refit(self, p, before, after))
        if fail is not None:
            self.stops[p.candidate.term.key] = fail
        return fail is None

    def started(self, c: Candidate, other: Candidate) -> Search | None:
        """The search from another start: one effect in the place of a found one of its joint.

        What was found on that joint after it is sought anew, and the rest stays.  None where the
        fit with the other effect is none.
        """
        mine = self._since(c)
        model = self.now.result.model
        for f in mine:
            model = without(model, f, self.problem)
        model = model + as_use(other, self.problem)
        rung = self.rung(f"+ {describe(other, self.problem)}", model, self.now.result.sigma)
        if not np.all(np.isfinite(rung.errors.power)):
            return None
        rung.added = (other,)
        gone = {id(f) for f in mine} - {id(c)}
        kept = [other if f is c else f for f in self.found if id(f) not in gone]
        apart = replace(self, refused=set(), beside={}, stops={}, fired={}, found=kept)
        apart.rungs = [*self.rungs[: self._rung_of(c)], rung]
        apart.forward([c.joint])
        return apart

    def taken_over(self, apart: Search, c: Candidate) -> None:
        """Go on from where a search came to that started elsewhere.

        Its steps take the places of those from there on, or become one where other joints' effects
        are among these.
        """
        k = self._rung_of(c)
        new = [f for f in apart.found if all(f is not old for old in self.found)]
        since = {id(f) for f in self._since(c)}
        if all(id(f) in since for rung in self.rungs[k:] for f in rung.added):
            self.rungs[k:] = apart.rungs[k:]
        else:
            names, rung = "; ".join(describe(f, self.problem) for f in new), apart.now
            rung.step = replace(rung.step, label=f"{names} for {describe(c, self.problem)}")
            rung.added = tuple(new)
            self.rungs.append(rung)
        self.found, self.stops, self.last = apart.found, apart.stops, apart.last
        self.refused |= apart.refused | {(c.name, c.term.joint)}
        self.beside = apart.beside

    def _since(self, c: Candidate) -> list[Candidate]:
        """A found effect, and those that were found on its joint after it."""
        later = self.found[self.found.index(c) :]
        one = [f for f in later if f.joint == c.joint and not f.term.effect.scope.whole]
        return one if any(f is c for f in one) else [c, *one]

    def _rung_of(self, c: Candidate) -> int:
        """The rung that an effect was added with."""
        return next(k for k, r in enumerate(self.rungs) if any(a is c for a in r.added))

    # ------------------------------------------------------------------ backward, exchange

    def backward(self) -> None:
        """Take out what later effects, or other shapes that came with it, have made superfluous."""
        for c in list(self.found):
            now = self.now
            key = c.term.key
            model, joints = now.result.model, self.problem.joints
            there = any(t.key == key for t in now.result.terms)
            if not there or comes_back(c.term, model, joints):
                continue
            groups = model_groups(now.result)
            table = GramTable(self.problem, self.split, now.result.sigma, groups)
            rest = table.errors([g.key for g in groups if g.key != key])
            feel = self.moves if c.term.effect.scope.whole else [c.joint]
            rise = rest.squared - now.errors.squared
            if missed(rest, now.errors, feel) or any(paired(rise[:, j]) > BEYOND for j in feel):
                continue
            rung = self.rung(
                f"- {describe(c, self.problem)}",
                without(model, c, self.problem),
                now.result.sigma,
            )
            if not missed(rung.errors, now.errors, feel):
                self.rungs.append(rung)
                self.found.remove(c)
                self.refused.add((c.name, c.term.joint))
                return
            renew(now.result)
