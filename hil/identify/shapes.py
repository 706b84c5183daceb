"""Search of the non-linear parameters, the linear ones eliminated (variable projection).

With an orthonormal basis Q of all other columns and residual r, a term's columns C lower the
residual sum of squares by  c' G^+ c  with  c = C' r  and  G = C'C - (Q'C)'(Q'C).

Source: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from hil.identify import timelines
from hil.identify.design import Term, block, stack
from hil.identify.problem import Problem
from hil.identify.regression import Basis, basis
from hil.identify.screening import promising, screen
from hil.models.effect import Effect

FloatArray = NDArray[np.float64]
#: Share of the squared residual below which a shape is not worth refining.
NEGLIGIBLE = 5e-3
#: Relative difference of gains that is none: the first of a grid's equals is taken.
FLAT = 5e-4


class Projector:
    """Base regressor's basis and residual, against which terms are tried.

    Parameters
    ----------
    problem : Problem
        The runs.
    terms : list of Term
        Terms of the base.
    sigma : ndarray (d,)
        Effort scale by joint.
    """

    def __init__(self, problem: Problem, terms: list[Term], sigma: FloatArray) -> None:
        self.problem, self.sigma = problem, sigma
        w = np.repeat(1.0 / sigma, problem.n)
        y = problem.y.reshape(-1) * w
        if terms:
            x, _ = stack(problem, terms)
            self.basis: Basis = basis(x * w[:, None], 1.0 / max(float(np.linalg.norm(y)), 1.0))
            self.q = self.basis.q
        else:
            self.q = np.zeros((y.size, 0))
        self.residual = y - self.q @ (self.q.T @ y)
        self.rss = float(self.residual @ self.residual)

    def rows(self, term: Term) -> slice:
        """Rows that a term acts on."""
        n = self.problem.n
        if term.effect.whole_robot:
            return slice(0, n * self.problem.d)
        return slice(term.joint * n, (term.joint + 1) * n)

    def weighted(self, term: Term) -> FloatArray:
        """The term's weighted columns on its rows."""
        columns = block(self.problem, term)
        if term.effect.whole_robot:
            flat = columns / self.sigma[:, None, None]
            return flat.reshape(-1, columns.shape[-1])
        out: FloatArray = columns / self.sigma[term.joint]
        return out

    def gain(self, term: Term) -> float:
        """By how much the term lowers the weighted residual sum of squares."""
        gain, beta, _, _ = self.score(term)
        return gain if not term.effect.strict or within(term.effect, beta) else 0.0

    def score(self, term: Term) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Gain, coefficients (m,), Gram's inverse (m, m), and Q'C (r, m).

        Directions of the term of which less than a millionth is new are not counted.
        """
        rows = self.rows(term)
        c = self.weighted(term)
        norm = np.linalg.norm(c, axis=0)
        norm = np.where(norm > 1e-300, norm, 1.0)
        c = c / norm
        qc = self.q[rows].T @ c
        gram = c.T @ c - qc.T @ qc
        value, vector = np.linalg.eigh(gram)
        keep = value > 1e-6
        inverse = (vector[:, keep] / value[keep]) @ vector[:, keep].T
        right = c.T @ self.residual[rows]
        beta = inverse @ right
        gain = float(right @ beta)
        if term.effect.strict and not within(term.effect, beta / norm):
            beta = _kept(term.effect, beta, vector[:, keep], value[keep], norm)
            gain = float(2 * right @ beta - beta @ gram @ beta)
        return gain, beta / norm, inverse / np.outer(norm, norm), qc * norm


def _kept(
    effect: Effect, beta: FloatArray, vector: FloatArray, value: FloatArray, norm: FloatArray
) -> FloatArray:
    """Coefficients (m,) within their bounds that fit best, from the free ones."""
    params = effect.params
    if beta.size == 1:
        return np.clip(beta, params[0].lower * norm, params[0].upper * norm)
    if len(params) != beta.size or any(p.lower != 0 or p.upper < np.inf for p in params):
        return beta
    root = np.sqrt(value)[:, None] * vector.T  # |root (x - beta)|^2 is the loss
    seen = np.sum(root**2, axis=0) > 1e-6  # the rest is the base's
    out = np.zeros(beta.size)
    out[seen] = scipy.optimize.nnls(root[:, seen], root @ beta)[0]
    return out


def within(effect: Effect, beta: FloatArray) -> bool:
    """Whether all coefficients (m,) lie within their bounds."""
    return all(p.lower <= b <= p.upper for p, b in zip(effect.params, beta, strict=False))


def best_shape(projector: Projector, term: Term, refine: bool = True) -> tuple[Term, float]:
    """The term with the shape that lowers the residual most, and the gain."""
    problem = projector.problem
    grid = term.effect.grid(problem.motions[0], term.joint)
    if not grid:
        return term, 0.0
    tried = _screened(projector, term, grid)
    if not tried:
        return term, 0.0
    gains = [projector.gain(term.reshaped(s)) for s in tried]
    first = _simplest(tried, gains)
    found, gain, best = term.reshaped(tried[first]), gains[first], grid.index(tried[first])
    worth = gain > NEGLIGIBLE * projector.rss
    if refine and worth and term.effect.refine and len(term.effect.shape) and len(grid) > 1:
        found, gain = _refine(projector, found, gain, grid, best)
    return found, gain


def _screened(
    projector: Projector, term: Term, grid: list[tuple[float, ...]]
) -> list[tuple[float, ...]]:
    """The part of a long grid of orders that deserves an exact fit; other grids as they are."""
    if term.effect.spectral:
        rows, j = projector.rows(term), term.joint
        effort = projector.problem.effort[j] / projector.sigma[j]
        return timelines.promising(projector.problem, term, projector.residual[rows], effort)
    waves = screen(projector.problem, term, grid)
    if waves is None:
        return grid
    n, j = projector.problem.n, term.joint
    back = projector.problem.back(projector.residual[j * n : (j + 1) * n], j)
    return [grid[k] for k in promising(waves.gains(back))]


def _simplest(grid: list[tuple[float, ...]], gains: list[float]) -> int:
    """Best index of the first form (all shape values but the first) within 1 % of the best gain.

    A grid lists its forms from the usual to the unusual one.
    """
    top = max(gains)
    for form in dict.fromkeys(shape[1:] for shape in grid):
        own = [k for k, shape in enumerate(grid) if shape[1:] == form]
        most = max(gains[k] for k in own)
        if most >= 0.99 * top:
            return next(k for k in own if gains[k] >= most - FLAT * abs(most))
    return int(np.argmax(gains))


def _refine(
    projector: Projector, term: Term, gain: float, grid: list[tuple[float, ...]], best: int
) -> tuple[Term, float]:
    """Search the first shape parameter between the grid's neighbours (same other values)."""
    value, rest = grid[best][0], grid[best][1:]
    line = sorted(s[0] for s in grid if s[1:] == rest)
    k = line.index(value)
    low, high = line[max(k - 1, 0)], line[min(k + 1, len(line) - 1)]
    if high <= low:
        return term, gain
    result = scipy.optimize.minimize_scalar(
        lambda s: -projector.gain(term.reshaped((float(s), *rest))),
        bounds=(low, high), method="bounded", options={"maxiter": 12},
    )  # fmt: skip
    if -float(result.fun) > gain + FLAT * abs(gain):
        return term.reshaped((float(result.x), *rest)), -float(result.fun)
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
        if term.effect.name == "coulomb":
            found = _sharpest(projector, found, gain)
        out[k] = found
    return out


def _sharpest(projector: Projector, term: Term, best_gain: float) -> Term:
    """Coulomb's sign resolution: the sharpest that is within 1 % of what the best one leaves.

    A wide tanh imitates low-speed effects; it is taken only where the data ask for it.
    """
    grid = term.effect.grid(projector.problem.motions[0], term.joint)
    left = projector.rss - best_gain
    for shape in grid:
        if shape >= term.shape:
            break
        if projector.rss - projector.gain(term.reshaped(shape)) <= 1.01 * left:
            return term.reshaped(shape)
    return term
