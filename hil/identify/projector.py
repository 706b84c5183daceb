"""One term tried beside all others: what it explains, for several shapes at once.

With an orthonormal basis Q of all other columns and residual r, a term's columns C lower the
residual sum of squares by  c' G^+ c  with  c = C' r  and  G = C'C - (Q'C)'(Q'C).

Source: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from hil.identify.design import Term, block
from hil.identify.problem import ROW_BATCH, Problem
from hil.identify.regression import basis, least_squares
from hil.identify.solve import factors
from hil.models.effect import Effect, strict

FloatArray = NDArray[np.float64]
#: Relative error of a coefficient that was put on its bound in other units.
ROUNDING = 1e-9
#: Norm of a column below which it is none: its square would underflow.
LEAST_NORM = 1e-150


@dataclass(frozen=True)
class Scores:
    """What g shapes of one term explain.

    Parameters
    ----------
    gain : ndarray (g,)
        By how much each lowers the weighted residual sum of squares.
    beta, inverse : ndarray (g, m), (g, m, m)
        Coefficients and the inverse of the projected Gram matrix.
    qc : ndarray (r, g, m)
        Q'C.
    columns : ndarray (N, g, m)
        Weighted columns C on the term's rows.
    """

    gain: FloatArray
    beta: FloatArray
    inverse: FloatArray
    qc: FloatArray
    columns: FloatArray


def batches(
    shapes: Sequence[tuple[float, ...]], size: int
) -> Iterator[Sequence[tuple[float, ...]]]:
    """Slices of a sequence, `size` long."""
    return (shapes[k : k + size] for k in range(0, len(shapes), size))


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
        #: Q = diag(Q_1 .. Q_d) [U_1; ..; U_d], a joint's rows each: (n, k_j) and (k_j, r).
        self.parts = _parts(problem, terms, sigma, 1.0 / max(float(np.linalg.norm(y)), 1.0))
        self.residual = y - self.spanned(self.inner(slice(0, y.size), y[:, None])[:, 0])
        self.rss = float(self.residual @ self.residual)
        self._found: dict[tuple[object, ...], Scores] = {}
        #: What others have computed beside this base.
        self.memo: dict[tuple[object, ...], Any] = {}

    @property
    def q(self) -> FloatArray:
        """Orthonormal columns (d n, r) that span the base, made from the factors."""
        return np.concatenate([q @ u for q, u in self.parts])

    def inner(self, rows: slice, x: FloatArray) -> FloatArray:
        """Q'x (r, k) of what acts on a joint's rows, or on all of them, x (N, k)."""
        n = self.problem.n
        own = self.parts[rows.start // n : rows.stop // n]
        each = zip(own, x.reshape(len(own), n, -1), strict=True)
        return np.asarray(sum(u.T @ (q.T @ part) for (q, u), part in each))

    def spanned(self, known: FloatArray) -> FloatArray:
        """Q c (d n, ...) of coefficients c (r, ...)."""
        return np.concatenate([q @ (u @ known) for q, u in self.parts])

    def rows(self, term: Term) -> slice:
        """Rows that a term acts on."""
        n = self.problem.n
        if term.effect.scope.whole:
            return slice(0, n * self.problem.d)
        return slice(term.joint * n, (term.joint + 1) * n)

    def weighted(self, term: Term) -> FloatArray:
        """The term's weighted columns on its rows."""
        columns = block(self.problem, term)
        if term.effect.scope.whole:
            flat = np.divide(columns, self.sigma[:, None, None], out=np.empty(columns.shape))
            return flat.reshape(self.problem.d * self.problem.n, -1)
        out: FloatArray = columns / self.sigma[term.joint]
        return out

    def gain(self, term: Term) -> float:
        """By how much the term lowers the weighted residual sum of squares."""
        return float(self.gains(term, [term.shape])[0])

    def gain_of(self, term: Term, columns: FloatArray) -> float:
        """The same of weighted columns (N, m) on the term's rows, whatever their signs."""
        gram, right = self._normal(term, columns)
        return float(right @ least_squares(gram, right, 1e-9))

    def gain_beside(self, term: Term, columns: FloatArray, other: FloatArray) -> float:
        """The same beside another column (N, 1) that has a coefficient of at most 1.

        The fall is convex in that coefficient: where the best one is larger, 1 is best.
        """
        gram, right = self._normal(term, np.column_stack([other, columns]))
        beta = least_squares(gram, right, 1e-9)
        if beta[0] <= 1.0:
            return float(right @ beta)
        rest = right[1:] - gram[1:, 0]
        alone = float(2 * right[0] - gram[0, 0])
        return alone + float(rest @ least_squares(gram[1:, 1:], rest, 1e-9))

    def _normal(self, term: Term, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gram's matrix and right side of weighted columns beside the base."""
        rows = self.rows(term)
        right, known = columns.T @ self.residual[rows], self.inner(rows, columns)
        return columns.T @ columns - known.T @ known, right

    def gains(self, term: Term, shapes: Sequence[tuple[float, ...]]) -> FloatArray:
        """The same for several shapes of the term."""
        known = self._found.get((*term.key, term.per_run, *shapes))
        if known is not None and len(known.gain) == len(shapes):
            return _counted(term.effect, known)
        return np.concatenate([_counted(term.effect, s) for s in self.scores(term, shapes)])

    def score(self, term: Term) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Gain, coefficients (m,), Gram's inverse (m, m), and Q'C (r, m)."""
        (s,) = self.scores(term, [term.shape])
        return float(s.gain[0]), s.beta[0], s.inverse[0], s.qc[:, 0]

    def scores(self, term: Term, shapes: Sequence[tuple[float, ...]]) -> Iterator[Scores]:
        """Scores of a term for several shapes, in batches of columns that fit the memory."""
        if len(shapes) > 1 and not term.per_run:
            first = block(self.problem, term.reshaped(shapes[0]))
            for some in batches(shapes, max(1, ROW_BATCH // max(first.nbytes, 1))):
                parts = self.problem.several(term.effect, term.joint, some)
                if len({p.shape[-1] for p in parts}) == 1:
                    yield self._known(term, some, self._stacked(term, parts))
                else:
                    for s, p in zip(some, parts, strict=True):
                        yield self._known(term, [s], self._stacked(term, [p]))
        else:
            for s in shapes:
                yield self._known(term, [s], self.weighted(term.reshaped(s))[:, None])

    def _stacked(self, term: Term, parts: Sequence[FloatArray]) -> FloatArray:
        """Weighted columns (N, shapes, m) of several shapes."""
        m, whole = parts[0].shape[-1], term.effect.scope.whole
        d, n = (self.problem.d if whole else 1), self.problem.n
        sigma = self.sigma[:, None, None] if whole else self.sigma[term.joint]
        out = np.empty((d, n, len(parts), m))
        for k, part in enumerate(parts):
            np.divide(part.reshape(d, n, m), sigma, out=out[:, :, k])
        return out.reshape(d * n, len(parts), m)

    def _known(self, term: Term, shapes: Sequence[tuple[float, ...]], c: FloatArray) -> Scores:
        """Scores of weighted columns; all but the columns are remembered for a second use."""
        key = (*term.key, term.per_run, *shapes)
        if key not in self._found:
            # not a view, which would keep all of them
            self._found[key] = replace(self._scores(term, c), columns=np.empty((0, *c.shape[1:])))
        return replace(self._found[key], columns=c)

    def _scores(self, term: Term, c: FloatArray) -> Scores:
        """Scores from weighted columns (N, shapes, m).

        Directions of the term of which less than a millionth is new are not counted.
        """
        rows, (n, g, m) = self.rows(term), c.shape
        by = c.transpose(1, 2, 0)
        own = by @ by.transpose(0, 2, 1)
        norm = np.sqrt(np.diagonal(own, axis1=1, axis2=2))
        norm = np.where(norm > LEAST_NORM, norm, 1.0)
        right = ((self.residual[rows] @ c.reshape(n, -1)).reshape(g, m)) / norm
        qc = self.inner(rows, c.reshape(n, -1)).reshape(-1, g, m)
        unit = qc / norm
        own /= norm[:, :, None] * norm[:, None, :]
        across = unit.transpose(1, 2, 0)
        gram = own - across @ across.transpose(0, 2, 1)
        value, vector = np.linalg.eigh(gram)
        share = np.where(value > 1e-6, 1.0 / np.where(value > 1e-6, value, 1.0), 0.0)
        inverse = (vector * share[:, None, :]) @ vector.transpose(0, 2, 1)
        beta = (inverse @ right[:, :, None])[:, :, 0]
        gain = np.sum(right * beta, axis=1)
        if strict(term.effect):
            for k in range(g):
                if not within(term.effect, beta[k] / norm[k]):
                    beta[k] = _kept(term.effect, beta[k], vector[k], value[k], norm[k])
                    gain[k] = 2 * right[k] @ beta[k] - beta[k] @ gram[k] @ beta[k]
        return Scores(gain, beta / norm, inverse / (norm[:, :, None] * norm[:, None, :]), qc, c)


def _parts(
    problem: Problem, terms: list[Term], sigma: FloatArray, least: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Factors of the orthonormal columns, joint by joint."""
    if not terms:
        return [(np.zeros((problem.n, 0)), np.zeros((0, 0)))] * problem.d
    q, r = factors(problem, terms, sigma)
    edges = np.cumsum([len(x) for x in r])[:-1]
    return list(zip(q, np.split(basis(np.concatenate(r), least).q, edges), strict=True))


def _kept(
    effect: Effect, beta: FloatArray, vector: FloatArray, value: FloatArray, norm: FloatArray
) -> FloatArray:
    """Coefficients (m,) within their bounds that fit best, from the free ones."""
    params = effect.params
    if beta.size == 1:
        return np.clip(beta, params[0].lower * norm, params[0].upper * norm)
    if len(params) != beta.size or any(p.lower != 0 for p in params):
        return beta
    # |root (x - beta)|^2 is the loss
    root = np.sqrt(np.where(value > 1e-6, value, 0.0))[:, None] * vector.T
    seen = np.sum(root**2, axis=0) > 1e-6  # the rest is the base's
    out = np.zeros(beta.size)
    if np.any(seen):  # of no column at all, `nnls` frees memory that is not its own
        out[seen] = scipy.optimize.nnls(root[:, seen], root @ beta)[0]
    return out


def within(effect: Effect, beta: FloatArray) -> bool:
    """Whether all coefficients (m,) lie within their bounds, or on them but for rounding."""
    return all(
        p.lower - ROUNDING * abs(p.lower) <= b <= p.upper + ROUNDING * abs(p.upper)
        for p, b in zip(effect.params, beta, strict=False)
    )


def _counted(effect: Effect, scores: Scores) -> FloatArray:
    """Gains (g,); none where a strict effect's coefficients leave their bounds."""
    if not strict(effect):
        return scores.gain
    return np.where([within(effect, b) for b in scores.beta], scores.gain, 0.0)
