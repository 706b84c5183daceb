"""Whether what a refit made of an added effect can be physics; else it is no finding."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.compare.candidate import Candidate
from hil.compare.findings import Step
from hil.compare.floor import ADEQUATE
from hil.compare.significance import by_chance
from hil.identify.design import Term, coefficients, head
from hil.identify.projector import Projector
from hil.identify.regression import basis
from hil.identify.result import FitResult
from hil.models.model import Value

FloatArray = NDArray[np.float64]
#: Shape parameters that are a size.
SCALES = ("T", "f", "b", "s", "p", "vs")
#: Share of an excess that is as good as nothing: a scale beyond the edge would explain little more.
REST = 0.10


def credible(step: Step, before: Step, c: Candidate, floor: FloatArray) -> bool:
    """Whether an added effect's values can be physics after everything was fitted again.

    Its own law must allow them (`Effect.credible`), its scales (a time, a width, a frequency)
    must exceed their standard errors and its coefficients chance, and a scale on the edge of what
    was searched must leave nothing, or next to nothing of what it found, above the floor: else it
    stands for something else.

    Parameters
    ----------
    step, before : Step
        The refit with the effect, and the rung without it.
    c : Candidate
        The effect.
    floor : ndarray (d,)
        Noise floor.
    """
    shapes = _shapes(step, c)
    if any(v.stderr > abs(v.value) for name, v in shapes.items() if name in SCALES):
        return False
    if by_chance(step.result, c.term.key):
        return False
    if any(v.at_bound for name, v in shapes.items() if name in SCALES) and _left(
        step, before, c.joint, float(floor[c.joint])
    ):
        return False
    term = next((t for t in step.result.terms if t.key == c.term.key), None)
    return term is None or (_allowed(step.result, term) and not _outdone(step, term))


def _shapes(step: Step, c: Candidate) -> dict[str, Value]:
    start, values = head(c.term.effect, c.term.joint), step.result.values
    names = [p.name for p in c.term.effect.shape]
    return {n: values[f"{start}.{n}"] for n in names if f"{start}.{n}" in values}


def _left(step: Step, before: Step, j: int, floor: float) -> bool:
    """Whether joint j is still above its floor, by more than a REST of what it was."""
    rms, first = step.result.rms[j], before.result.rms[j]
    return bool(rms > ADEQUATE * floor and rms**2 - floor**2 > REST * (first**2 - floor**2))


def impossible(result: FitResult, effect: str) -> list[str]:
    """Sentences on an effect's values that its own law does not allow, joint by joint."""
    joints = result.problem.joints
    return [
        f"{effect}{'' if t.effect.of_robot else f' on {joints[t.joint]}'}: values that fit best "
        "cannot be physics (a stop that pulls, friction that drives, a cause that is another one); "
        "'hil diagnose' would not name it"
        for t in result.terms
        if t.effect.name == effect and not _allowed(result, t)
    ]


def _allowed(result: FitResult, term: Term) -> bool:
    """Whether the effect's own law allows its values, in every run that has its own."""
    values = [result.values[n] for n, _ in coefficients(term, result.problem)]
    runs = result.problem.runs if term.per_run else 1
    each = np.array([[v.value, v.stderr] for v in values]).reshape(-1, 2)
    if not len(each):
        return True
    parts = np.array_split(each, runs - int(term.effect.relative) if term.per_run else 1)
    motion = result.problem.motions[0]
    return all(
        term.effect.credible(motion, term.joint, term.shape, p[:, 0].tolist(), p[:, 1].tolist())
        for p in parts
    )


def _outdone(step: Step, term: Term) -> bool:
    """Whether a law without a name explains more than the effect in its place."""
    problem, j = step.result.problem, term.joint
    laws = [term.effect.foils(m, j, term.shape) for m in problem.motions]
    if not laws[0]:
        return False
    rest = Projector(problem, [t for t in step.result.terms if t != term], step.result.sigma)
    rows, own = rest.rows(term), rest.gain(term)
    for parts in zip(*laws, strict=True):
        columns = problem.gated(list(parts), j) / step.result.sigma[j]
        # gain of C on the residual r:  |P C (P C)^+ r|^2,  P = 1 - Q Q'
        wide = np.zeros((rest.residual.size, columns.shape[1]))
        wide[rows] = columns
        wide -= rest.q @ (rest.q[rows].T @ columns)
        if float(np.sum((basis(wide).q.T @ rest.residual) ** 2)) > own:
            return True
    return False
