"""Basis of a model's regressor from the factors of its joints, most of them made once.

The rows of joint j hold few of all columns.  With X_j = Q_j R_j for each joint,

    X = diag(Q_1 .. Q_d) [R_1; ..; R_d],

so the N rows are needed for the few columns that have changed, and scales by joint only weigh the
small R_j.  What depends on the motion alone is factored once for a problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from hil.identify.design import Term, block
from hil.identify.problem import Problem
from hil.identify.regression import Basis, of_factors
from hil.models.effect import Trait

FloatArray = NDArray[np.float64]
Pair = tuple[FloatArray, FloatArray]


def factored(
    problem: Problem, terms: Sequence[Term], sigma: FloatArray, least: float,
    free: FloatArray | None = None,
) -> Basis:  # fmt: skip
    """Basis of the weighted regressor (d n, p) of some terms.

    Parameters
    ----------
    problem, terms : Problem, sequence of Term
        Whose columns.
    sigma : ndarray (d,)
        Scale of each joint's rows.
    least : float
        Noise to signal, as in `basis`.
    free : ndarray (p,), optional
        0 where a column does not count.
    """
    return of_factors(*factors(problem, terms, sigma, free), least)


def factors(
    problem: Problem, terms: Sequence[Term], sigma: FloatArray, free: FloatArray | None = None
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Q_j (n, k_j), orthonormal, and R_j (k_j, p) of every joint's weighted rows."""
    blocks = [block(problem, t) for t in terms]
    edges = np.concatenate([[0], np.cumsum([b.shape[-1] for b in blocks])]).astype(int)
    places = [np.arange(a, b) for a, b in pairwise(edges)]
    q, r = [], []
    for j in range(problem.d):
        here = [k for k, t in enumerate(terms) if blocks[k].ndim == 3 or t.joint == j]
        once = [k for k in here if _once(terms[k])]
        rest = [k for k in here if k not in once]
        pair = _kept(problem, j, [terms[k] for k in once], [_rows(blocks[k], j) for k in once])
        if rest:
            pair = _appended(pair, np.concatenate([_rows(blocks[k], j) for k in rest], axis=1))
        wide = np.zeros((len(pair[1]), int(edges[-1])))
        if here:
            wide[:, np.concatenate([places[k] for k in (*once, *rest)])] = pair[1] / sigma[j]
        q.append(pair[0])
        r.append(wide if free is None else wide * free)
    return q, r


def _once(term: Term) -> bool:
    return Trait.MOTION in term.effect.traits and not term.effect.shape


def _rows(values: FloatArray, j: int) -> FloatArray:
    return values[j] if values.ndim == 3 else values


def _kept(problem: Problem, j: int, terms: list[Term], blocks: list[FloatArray]) -> Pair:
    """Factors of what depends on the motion alone, made at first use."""
    key = ("factors", j, tuple((*t.key, t.per_run) for t in terms))
    if key not in problem.memo:
        x = np.concatenate([np.zeros((problem.n, 0)), *blocks], axis=1)
        problem.memo[key] = scipy.linalg.qr(x, mode="economic", check_finite=False)
    q, r = problem.memo[key]
    return q, r


def _appended(pair: Pair, c: FloatArray) -> Pair:
    """Factors of [X, C]; twice orthogonalised, for once loses what nearly lies in X."""
    q, r = pair
    inner = q.T @ c
    left = c - q @ inner
    again = q.T @ left
    p, t = scipy.linalg.qr(left - q @ again, mode="economic", check_finite=False)
    top = np.concatenate([r, inner + again], axis=1)
    bottom = np.concatenate([np.zeros((len(t), r.shape[1])), t], axis=1)
    return np.concatenate([q, p], axis=1), np.concatenate([top, bottom])
