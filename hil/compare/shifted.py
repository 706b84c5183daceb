"""Which single effect turns one session's parameters into another's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.compare.evidence import possible_terms
from hil.identify.assemble import in_units
from hil.identify.blocks import time_blocks
from hil.identify.design import Term, coefficients
from hil.identify.projector import Projector
from hil.identify.regression import cluster_covariance, inflation
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
#: Share of the difference that one effect must account for to be named.
MOST = 0.7


@dataclass(frozen=True)
class _Try:
    """One explanation: words, share of the difference, and its score."""

    text: str
    share: float
    score: float


def explanation(fitted: FitResult, alone: FitResult, residual: FloatArray, j: int) -> str:
    """Words for what would account for joint j's error under the other's parameters.

    All parameters stay as they were fitted; one term at a time is added to them, of the model's
    own (another value) or of the catalogue's (an effect), and the best is told with its share of
    what the parameters miss; longer laws pay the price of their coefficients.  Empty where none
    accounts for `MOST` of it.

    Parameters
    ----------
    fitted, alone : FitResult
        The fit, and the same model fitted to the other runs.
    residual : ndarray (d, n)
        Residual of the other runs under the fit.
    j : int
        Joint.
    """
    problem, sigma = alone.problem, alone.sigma
    bare = Projector(problem, [], sigma)
    bare.residual = (residual / sigma[:, None]).reshape(-1)
    bare.rss = float(bare.residual @ bare.residual)
    r, left = residual[j] / sigma[j], alone.residual[j] / sigma[j]
    missed = max(float(r @ r - left @ left), 1e-300)
    per = float(np.mean(left**2)) * inflation(left, problem.run)
    price = float(np.log(max(r.size / inflation(left, problem.run), 2.0)))
    tried = [_scaled(fitted, alone, residual, j, missed, per, price)]
    for term, known in _terms(fitted, alone, j):
        tried.append(_tried(term, known, bare, missed, per, price, j))
    best = max(tried, key=lambda x: x.score)
    if best.share < MOST:
        return ""
    return f"{best.text} would account for {100 * min(best.share, 1.0):.0f} % of that"


def _terms(fitted: FitResult, alone: FitResult, j: int) -> list[tuple[Term, bool]]:
    """Terms on joint j: the model's own with their shapes (True), and candidates without any.

    What has a shape to be searched would imitate anything.
    """
    own = [(t, True) for t in fitted.terms if t.effect.whole_robot or t.joint == j]
    new = [
        replace(t, per_run=False) for t in possible_terms(alone)[0]
        if not t.effect.shape and (t.effect.of_robot or t.joint == j)
    ]  # fmt: skip
    return [*own, *((t, False) for t in new)]


def _tried(
    term: Term, known: bool, bare: Projector, missed: float, per: float, price: float, j: int
) -> _Try:
    columns = bare.weighted(term)
    rows = bare.residual[bare.rows(term)]
    beta = np.asarray(np.linalg.lstsq(columns, rows, rcond=None)[0], dtype=np.float64)
    n = bare.problem.n
    part = (columns @ beta)[j * n : (j + 1) * n] if term.effect.whole_robot else columns @ beta
    r = bare.residual[j * n : (j + 1) * n]
    gain = float(r @ r - (r - part) @ (r - part))
    return _Try(_words(term, known, beta, bare), gain / missed, gain / per - price * beta.size)


def _words(term: Term, known: bool, beta: FloatArray, bare: Projector) -> str:
    """E.g. ``torque-offset on joint2 (0.3 N m)``, ``another value of j2.coulomb.fc (by 0.1)``."""
    problem = bare.problem
    joints, named = problem.joints, coefficients(term, problem)
    unit = in_units(named[0][1].unit, problem, term.joint)
    size = f"{beta[0]:+.3g} {unit}".removesuffix(" 1") if beta.size == 1 else ""
    if known:
        if beta.size == 1:
            return f"another {named[0][0]} ({size})"
        return f"other values of {term.effect.name}"
    where = "" if term.effect.of_robot else f" on {joints[term.joint]}"
    return f"{term.effect.name}{where}{f' ({size})' if size else ''} in one of them"


def _scaled(
    fitted: FitResult, alone: FitResult, residual: FloatArray, j: int,
    missed: float, per: float, price: float,
) -> _Try:  # fmt: skip
    """All efforts of the joint scaled: another torque constant, gear or unit."""
    model = alone.problem.y[j] - residual[j]
    size = float(model @ model)
    if size == 0.0:
        return _Try("", 0.0, -np.inf)
    g = float(model @ residual[j]) / size
    gain = g * g * size / float(alone.sigma[j]) ** 2
    text = f"all efforts of the joint scaled by {1 + g:.3g} (a torque-gain, a gear, a unit)"
    return _Try(text, gain / missed, gain / per - price)


def foretold(fitted: FitResult, alone: FitResult, j: int) -> float:
    """Difference of two fits' predictions on joint j in units of what their errors allow.

    With X the columns of the other runs, theta and V the coefficients of both fits and their
    covariances,  z^2 = |X (theta_1 - theta_2)|^2 / tr X (V_1 + V_2) X';  directions that the first
    fit does not determine are left out of both.
    """
    rows = slice(j * alone.problem.n, (j + 1) * alone.problem.n)
    x = alone.x[rows]
    if fitted.names != alone.names:
        return float("inf")
    b = fitted.basis
    known = (b.v @ b.v.T) * b.scale[None, :] / b.scale[:, None]
    x = x @ known
    moved = x @ (fitted.theta - alone.theta)
    allowed = sum(float(np.sum((x @ v) * x)) for v in map(_covariance, (fitted, alone)))
    return float(np.sqrt(moved @ moved / max(allowed, 1e-300)))


def _covariance(f: FitResult) -> FloatArray:
    blocks = np.tile(time_blocks(f.problem), f.problem.d)
    return cluster_covariance((f.residual / f.sigma[:, None]).reshape(-1), f.basis, blocks)
