"""Accepted effects tested again beside all that came after them.

An effect is named against what the model still lacks at that time.  What is found later, on any
joint, for they share the links, clears the view: the effect may have become superfluous, or
another one may do better in its place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.compare import blur, denoise
from hil.compare.attribute import choose, kindred, physical, simplest_first
from hil.compare.candidate import Candidate, ranking, try_all
from hil.compare.credible import credible
from hil.compare.evidence import possible_terms, priced
from hil.compare.findings import Accepted, Step, describe
from hil.compare.floor import ADEQUATE, Floor
from hil.compare.heldout import Examiner, HeldOut
from hil.compare.significance import by_chance
from hil.identify.design import Term, head
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.solve import solve
from hil.identify.timing import LATE, fit_aligned
from hil.models.model import RobotModel, Use, Value

#: An effect without which its joint's error rises by this factor is not superfluous.
NEEDED = 1.05
#: Factor within which two held-out errors are the same, and standard errors of a difference from
#: which the larger one is out of the question.
SAME, REFUTED = 1.002, 2.0


def as_use(c: Candidate, problem: Problem) -> Use:
    """A candidate as a part of a model, its shape as the starting value."""
    effect = c.term.effect
    start = head(effect, c.term.joint)
    values = {
        f"{start}.{p.name}": Value(v, unit=p.unit)
        for p, v in zip(effect.shape, c.term.shape, strict=True)
    }
    options: dict[str, object] = {"per_run": True} if c.term.per_run else {}
    joints = ("*",) if effect.of_robot else (problem.joints[c.term.joint],)
    return Use(effect.name, joints, options, values)


def refitted(label: str, model: RobotModel, examine: Examiner, now: Step) -> Step:
    """Rung of another model, fitted from the residual scales of the present one."""
    result = fit_aligned(now.result.problem, model, now.result.sigma)
    return Step(label, result, examine(result))


def drop_superfluous(found: list[Accepted], ladder: list[Step], examine: Examiner) -> None:
    """Take out an accepted effect that later ones have made superfluous.

    One that they have emptied may cost a little on the held-out data, but not more: without it the
    fit may no longer find their shapes.  No joint may get worse: they share the links.
    """
    now = ladder[-1]
    for k, (c, _, _) in enumerate(found[:-1]):
        use = as_use(c, now.result.problem)
        model = now.result.model
        rest = tuple(u for u in model.effects if (u.type, u.joints) != (use.type, use.joints))
        if len(rest) == len(model.effects) or _needed(c, found[k + 1 :], now):
            continue
        label = f"- {describe(c, now.result.problem)} (superfluous)"
        step = refitted(label, replace(model, effects=rest), examine, now)
        more = ADEQUATE if by_chance(now.result, c.term.key) else SAME
        factor = np.where(np.arange(now.result.problem.d) == c.joint, more, ADEQUATE)
        if np.all(step.heldout.rms <= factor * now.heldout.rms):
            found.pop(k)
            ladder.append(step)
            return


def _needed(candidate: Candidate, later: list[Accepted], now: Step) -> bool:
    """Whether an effect is plainly needed, so that no full fit without it has to show it.

    The coefficients alone are fitted without it; shapes may only make up for it where a later
    effect shares its joint.
    """
    j, result = candidate.joint, now.result
    near = any(c.joint == j or c.term.effect.whole_robot for c, _, _ in later)
    if near or candidate.term.effect.whole_robot or candidate.term.effect.replaces:
        return False
    terms = [t for t in result.terms if t.key != candidate.term.key]
    *_, residual = solve(result.problem, terms, result.model, result.sigma)
    return bool(result.problem.rms(residual)[j] > NEEDED * result.rms[j])


def look_again(
    found: list[Accepted], ladder: list[Step], floor: Floor, examine: Examiner
) -> bool:  # fmt: skip
    """Choose again among all forms of an effect, beside those found after it.

    Confidence and rivals become what the whole model says; a name that another one beats is
    changed if the model with the other one does at least as well on the held-out data, else the
    other one is a rival.  The ladder then shows the new names.

    Returns
    -------
    bool
        Whether the ladder has changed.
    """
    changed = False
    for k in range(len(found) - 1):
        now = found[k][0]
        effect = now.term.effect
        # what stands for other terms leaves the model without them if it goes; of gains that
        # only ratios determine none is better than those of the other joints
        elsewhere = any(x.term.joint != now.term.joint for x in found[k][2])
        if effect.of_robot or effect.replaces or elsewhere:
            continue
        order, projector = _forms(found, k, ladder[-1], floor)
        if not order:
            continue
        if order[0].term.key != now.term.key and _swap(
            found, k, choose(order, projector), ladder, examine, floor
        ):
            changed = True
            continue
        own = [x for x in order if x.term.key == now.term.key]
        if own:
            rest = [x for x in order if x is not own[0]]
            found[k] = (now, *choose([*own, *rest], projector)[1:])
    return changed


def _forms(
    found: list[Accepted], k: int, now: Step, floor: Floor
) -> tuple[list[Candidate], Projector]:
    """What could stand in the place of an accepted effect, best first, and what it was tried on.

    All of its joint are tried beside the present model without it.
    """
    result, c = now.result, found[k][0]
    rest = [t for t in result.terms if t.key != c.term.key]
    projector = Projector(result.problem, rest, result.sigma)
    own = [t for t in result.terms if t.key == c.term.key]
    terms = [t for t in possible_terms(result)[0] if t.joint == c.joint and _comparable(t, c)]
    with result.problem.aside():
        tried = try_all(projector, result, [t.reshaped(()) for t in own] + terms)
    priced(tried, floor, result)
    denoise.mark(tried, projector)
    blur.mark(tried, result, projector)
    motion = result.problem.motions[0]
    sound = [
        x for x in tried
        if x.score > 0 and not (x.smoother or x.blurred) and x.absorbed < 0.9999
        and physical(x, motion)
        and not any(kindred(x, y) for y, _, _ in found[k + 1 :])
    ]  # fmt: skip
    return simplest_first(sorted(sound, key=ranking)), projector


def _comparable(term: Term, c: Candidate) -> bool:
    """Whether a term may take the place of an accepted effect.

    A line over time stands alone or not at all, and the slow motion has shown a lateness or not.
    """
    effect = term.effect
    if effect.of_robot or effect.spectral or effect.sudden or effect.replaces:
        return False
    return effect.name not in LATE or c.name in LATE


def _swap(
    found: list[Accepted], k: int, other: Accepted, ladder: list[Step], examine: Examiner,
    floor: Floor,
) -> bool:  # fmt: skip
    """Give an accepted effect another name, and make the ladder anew; whether that holds."""
    names = [*found[:k], other, *found[k + 1 :]]
    steps = remade(names, ladder[0], examine)
    if not credible(steps[k + 1], steps[k], other[0], floor.rms):
        return False
    if larger(steps[-1].heldout, ladder[-1].heldout, found[k][0].joint):
        return False
    found[:], ladder[:] = names, steps
    return True


def remade(names: list[Accepted], first: Step, examine: Examiner) -> list[Step]:
    """Ladder with these names, one after the other."""
    problem, steps = first.result.problem, [first]
    for c, _, _ in names:
        model = steps[-1].result.model + as_use(c, problem)
        steps.append(refitted(f"+ {describe(c, problem)}", model, examine, steps[-1]))
    return steps


def larger(one: HeldOut, other: HeldOut, j: int) -> bool:
    """Whether one held-out error of joint j is larger than the other, beyond chance."""
    return bool(one.rms[j] > SAME * other.rms[j] and other.gain(one, j) > REFUTED)
