"""How the model's effort changes with its shape values: central differences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.identify.context import references
from hil.identify.design import Term, by_run
from hil.identify.problem import Problem
from hil.identify.regression import Basis, extended
from hil.identify.solve import noise_to_signal
from hil.models.effect import Trait
from hil.models.motion import Motion
from hil.models.param import JOINT

FloatArray = NDArray[np.float64]
#: Step of the difference, in distances between grid values.
STEP = 0.01
#: The same for values that lie on no continuous grid, relative to the value.
SMALL = 1e-3


def line(problem: Problem, term: Term) -> FloatArray:
    """Values of the first shape parameter on the term's grid, the form being as it is; sorted.

    All values where the others were changed to what the grid does not hold (`Search.across`).
    """
    grid = problem.grid(term.effect, term.joint)
    own = [s[0] for s in grid if s[1:] == term.shape[1:]]
    return np.unique(own or [s[0] for s in grid])


def searched(problem: Problem, term: Term) -> bool:
    """Whether the first shape value was found on a continuous range (the others are forms)."""
    held = term.fixed or term.fixed_shape or not term.effect.shape or not term.effect.search.refine
    return not held and line(problem, term).size > 1


def end_of_range(problem: Problem, term: Term) -> int:
    """-1 or 1 where the first shape value lies on the lower or upper end of its range, else 0."""
    values = line(problem, term)
    near = 1e-6 * float(np.min(np.diff(values)))
    value = term.shape[0]
    return int(value >= values[-1] - near) - int(value <= values[0] + near)


def jacobian(
    problem: Problem, terms: Sequence[Term], theta: FloatArray, slices: Sequence[slice], k: int
) -> FloatArray:
    """Derivative of the model's effort by the first shape value of term k, shape (d, n).

    What other effects take from it (the sign resolution, the surface) changes with it.
    """
    return derivative(problem, terms, theta, slices, k, 0)


def derivative(
    problem: Problem, terms: Sequence[Term], theta: FloatArray, slices: Sequence[slice],
    k: int, i: int,
) -> FloatArray:  # fmt: skip
    """Derivative of the model's effort by shape value i of term k, shape (d, n)."""
    term = terms[k]
    shape = term.shape
    if i == 0:
        low, high = around(problem, term)
        h = STEP * (high - low) / 2
    else:
        h = SMALL * abs(shape[i])
    # dy/ds = (y(s + h) - y(s - h)) / (2 h)
    up, down = (
        _effort(problem, terms, theta, slices, term.reshaped((*shape[:i], x, *shape[i + 1 :])))
        for x in (shape[i] + h, shape[i] - h)
    )
    return (up - down) / (2 * h)


def around(problem: Problem, term: Term) -> tuple[float, float]:
    """Neighbours of the first shape value on its grid."""
    values = line(problem, term)
    below, above = values[values < term.shape[0]], values[values > term.shape[0]]
    return float(below.max(initial=values[0])), float(above.min(initial=values[-1]))


def with_shapes(
    problem: Problem, terms: Sequence[Term], theta: FloatArray, slices: Sequence[slice],
    b: Basis, sigma: FloatArray, which: Sequence[int],
) -> Basis:  # fmt: skip
    """Basis of [X, J]: the coefficients' basis and the first shape values of some terms."""
    if not which:
        return b
    columns = [jacobian(problem, terms, theta, slices, k) / sigma[:, None] for k in which]
    j = np.stack([c.reshape(-1) for c in columns], axis=1)
    return extended(b, j, noise_to_signal(problem.y / sigma[:, None]))


def _effort(
    problem: Problem, terms: Sequence[Term], theta: FloatArray, slices: Sequence[slice], new: Term
) -> FloatArray:
    """Filtered effort (d, n) of a changed term and of those that may refer to it."""
    old = problem.motions[0]
    context = references([new], old.v0, old.contact)
    motions = [m.with_(**context) for m in problem.motions]
    changed = not np.array_equal(context["v0"], old.v0) or not np.array_equal(
        context["contact"], old.contact, equal_nan=True
    )
    out = np.zeros((problem.d, problem.n))
    for t, where in zip(terms, slices, strict=True):
        if t.key == new.key:
            out += _acting(problem, motions, new, theta[where])
        elif changed and _refers(t, new.joint):
            out += _acting(problem, motions, t, theta[where])
    return out


def _refers(term: Term, joint: int) -> bool:
    """Whether a term's columns may depend on what was found for a joint."""
    coupled = any(p.name == JOINT for p in term.effect.shape)
    return Trait.MOTION not in term.effect.traits and (term.joint == joint or coupled)


def _acting(
    problem: Problem, motions: Sequence[Motion], term: Term, theta: FloatArray
) -> FloatArray:
    """Filtered effort (d, n) of one term."""
    each = by_run(term, theta, problem.runs)[problem.whole] if term.per_run else None
    own = np.tile(theta, (len(motions), 1)) if each is None else each
    raw = [
        term.effect.columns(m, term.joint, term.shape) @ c
        for m, c in zip(motions, own, strict=True)
    ]
    out = np.zeros((problem.d, problem.n))
    if term.effect.scope.whole:
        out[:] = problem.acting(raw, None).T
    else:
        out[term.joint] = problem.acting(raw, term.joint)
    return out
