"""Search of the non-linear parameters, the linear ones eliminated (variable projection).

With an orthonormal basis Q of all other columns and residual r, a term's columns C lower the
residual sum of squares by  c' G^+ c  with  c = C' r  and  G = C'C - (Q'C)'(Q'C).

Source: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.refine import FINE, present, searched
from hil.identify.trial import CLOSE, grid_of, left, simplest, tried
from hil.models.effect import Waves

FloatArray = NDArray[np.float64]
#: Share of the squared residual below which a shape is not worth refining.
NEGLIGIBLE = 5e-3
#: Share of what is left that odd harmonics must account for: two columns of noise account for
#: a percent of a few hundred independent instants.
ODD = 0.02


def best_shape(
    projector: Projector, term: Term, refine: bool = True, accuracy: float = FINE
) -> tuple[Term, float]:
    """The term with the shape that lowers the residual most, and the gain.

    `accuracy` is the share of the gain, or of what is left if that is less, within which the
    shape must be the best.
    """
    problem = projector.problem
    grid = grid_of(problem, term)
    if not grid:
        return term, 0.0
    known = tried(projector, term, grid)
    if not known:
        return term, 0.0
    shapes, gains = list(known), list(known.values())
    first = simplest(shapes, gains, [left(projector, term, g) for g in gains])
    found, gain = term.reshaped(shapes[first]), gains[first]
    if refine and gain > NEGLIGIBLE * left(projector, term):
        found, gain = searched(projector, found, grid, known, accuracy)
    if refine:
        found, gain = present(projector, term, (found, gain), grid, accuracy)
    return _fundamental(projector, found, gain, grid)


def _fundamental(
    projector: Projector, term: Term, gain: float, grid: list[tuple[float, ...]]
) -> tuple[Term, float]:
    """Twice the order of waves over position whose odd harmonics are nothing.

    The second harmonic of half an order is the order itself: the data cannot tell, people can.
    """
    twice = tuple(2 * s for s in term.shape)
    waves = len(twice) == 1 and len(grid) > 1 and twice[0] <= grid[-1][0]
    search, motion = term.effect.search, projector.problem.motions[0]
    if not waves or not isinstance(search, Waves) or search.carrier(motion, term.joint) is None:
        return term, gain
    most = projector.gain(term.reshaped(twice))
    if most >= gain - ODD * abs(left(projector, term, gain)):
        return term.reshaped(twice), most
    return term, gain


def search_shapes(
    problem: Problem,
    terms: list[Term],
    sigma: FloatArray,
    idle: Collection[tuple[str, int]] = (),
) -> list[Term]:
    """One round: every term with a shape is searched, all others present.

    Terms in `idle` (effect, joint) are kept at zero by their bounds and take no part.
    """
    out = list(terms)
    for k, term in enumerate(terms):
        if not term.effect.shape or term.fixed or term.fixed_shape:
            continue
        others = [t for t in out[:k] + out[k + 1 :] if t.key not in idle]
        projector = Projector(problem, others, sigma)
        found, gain = best_shape(projector, term)
        if term.effect.search.sharpest:
            found = _sharpest(projector, found, gain)
        out[k] = found
    return out


def _sharpest(projector: Projector, term: Term, best_gain: float) -> Term:
    """A sign's resolution: the sharpest that is within 1 % of what the best one leaves.

    A wide tanh imitates low-speed effects; it is taken only where the data ask for it.
    """
    grid = grid_of(projector.problem, term)
    least = best_gain - (CLOSE - 1) * left(projector, term, best_gain)
    for shape in grid:
        if shape >= term.shape:
            break
        if projector.gain(term.reshaped(shape)) >= least:
            return term.reshaped(shape)
    return term
