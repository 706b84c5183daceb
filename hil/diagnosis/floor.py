"""The noise floor: what no model could explain, measured and not assumed.

Three sources, the first available counts:

1. *repeats*: the motion repeats itself; what differs between two passes is noise;
2. *largest model*: what the base model, every candidate and a smooth function of all positions
   and speeds together cannot predict on blocks of time that they were not fitted to.

The noise scale must never come from the incomplete model: the missing effect inflates it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from hil.diagnosis.constants import MATTERS, SENSOR_ACCURACY
from hil.diagnosis.folds import Split, split
from hil.diagnosis.types import Floor
from hil.identify.problem import Problem
from hil.identify.regression import inflation
from hil.identify.result import FitResult
from hil.identify.screening import period

FloatArray = NDArray[np.float64]
#: Columns of which less than this is new do not count.
RANK = 1e-6
#: Times that normal equations are solved, from the second on for what is left.
FLOOR_STEPS = 2
#: A model with more coefficients than this share of the instants follows any noise.
FULL = 0.9
#: Ridges that are tried.
STRENGTHS = (1e-4, 1e-3, 1e-2, 1e-1)


def smooth_features(problem: Problem, j: int) -> FloatArray:
    """Smooth functions of position and speeds for joint j, filtered, shape (n, m); made once."""
    if ("smooth", j) not in problem.memo:
        problem.memo["smooth", j] = _smooth(problem, j)
    out: FloatArray = problem.memo["smooth", j]
    return out


def _smooth(problem: Problem, j: int) -> FloatArray:
    rms = np.maximum(
        np.sqrt(np.mean(np.concatenate([m.qd for m in problem.motions]) ** 2, axis=0)), 1e-12
    )
    parts = []
    for m in problem.motions:
        x, v = np.clip(m.scaled(j), -1, 1), m.qd / rms
        own = v[:, j]
        bumps = np.exp(-0.5 * ((own[:, None] - np.linspace(-2.1, 2.1, 7)) / 0.5) ** 2)
        place = np.polynomial.chebyshev.chebvander(x, 3)
        columns = [(bumps[:, :, None] * place[:, None, :3]).reshape(len(x), 21), place[:, 1:]]
        others = [k for k in range(problem.d) if k != j][:5]
        for k in others:
            columns.append(
                np.stack(
                    [np.tanh(3 * v[:, k]), v[:, k], v[:, k] * own, v[:, k] * np.tanh(3 * own)],
                    axis=1,
                )
            )
        pairs = [(a, b) for a in others for b in others if a < b][:6]
        columns += [(v[:, a] * v[:, b])[:, None] for a, b in pairs]
        parts.append(np.concatenate(columns, axis=1))
    return problem.gated(parts, j)


def largest_model(
    result: FitResult, extra: list[list[FloatArray]]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Everything fitted together, joint by joint.

    Parameters
    ----------
    result : FitResult
        The present fit.
    extra : list (d) of list of ndarray (n, m)
        Candidate columns for each joint.

    Returns
    -------
    residual (d, n), inflation (d,), scale (d,), predicted (d,)
        Residual, its 1 + 2 sum rho, its rms corrected for degrees of freedom, and the rms
        error on blocks that were left out.
    """
    problem = result.problem
    x = result.x.reshape(problem.d, problem.n, -1)
    dealt = split(problem, whole_runs=False)
    out = np.empty_like(result.residual)
    factor, scale, predicted = np.ones((3, problem.d)) * [[1.0], [0.0], [0.0]]
    for j in range(problem.d):
        own = x[j][:, np.any(x[j] != 0, axis=0)]
        live = problem.live[j]
        out[j] = 0.0
        if not np.any(live):
            continue
        columns, y = (
            _beside(own, [*extra[j], smooth_features(problem, j)], live),
            problem.y[j, live],
        )
        norm = np.linalg.norm(columns, axis=0)
        some = norm > 1e-300
        penalised = (np.arange(norm.size) >= own.shape[1])[some]
        # in place: of ten minutes these are the largest arrays of a diagnosis
        columns = columns[:, some]
        columns /= norm[some]
        folds = _folds(columns, y, dealt, live)
        out[j, live], rank = _least_squares(folds)
        factor[j] = inflation(out[j], problem.run)
        # band-limited or coloured rows: one independent value in `factor` instants
        spent = rank * max(factor[j], problem.rate / (2 * problem.rates.effort))
        now = float(result.rms[j])
        free = max(y.size - spent, 0.3 * y.size)
        scale[j] = min(np.sqrt(np.sum(out[j] ** 2) / free), now)
        predicted[j] = min(_left_out(folds, penalised), now)
        if rank > FULL * y.size:  # the residual is rounding; the left-out blocks are not
            scale[j] = predicted[j]
    return out, factor, scale, predicted


def _beside(own: FloatArray, more: Sequence[FloatArray], live: NDArray[np.bool_]) -> FloatArray:
    """Columns side by side, of the instants that count."""
    out = np.concatenate([own, *more], axis=1)
    return out if live.all() else out[live]


@dataclass(frozen=True)
class _Folds:
    """Columns of length one (n, p) and y (n,), with X'X and X'y of every fold.

    And the rows that are tested of each fold.
    """

    x: FloatArray
    y: FloatArray
    grams: FloatArray
    rights: FloatArray
    tested: list[NDArray[np.int_]]


def _folds(x: FloatArray, y: FloatArray, dealt: Split, live: NDArray[np.bool_]) -> _Folds:
    """The instants `live` (of n) of a joint, whose rows `x` and `y` are, by fold."""
    fold, inner = dealt.fold[dealt.block][live], dealt.tested[live]
    parts = [np.flatnonzero(fold == k) for k in range(dealt.folds)]
    grams = np.stack([x[rows].T @ x[rows] for rows in parts])
    rights = np.stack([x[rows].T @ y[rows] for rows in parts])
    return _Folds(x, y, grams, rights, [rows[inner[rows]] for rows in parts])


def _left_out(f: _Folds, penalised: NDArray[np.bool_]) -> float:
    """Rms error on left-out blocks of time; ridge on some columns, the best of STRENGTHS."""
    ridges = np.stack([np.diag(np.where(penalised, s, 1e-10)) for s in STRENGTHS])
    errors, every, right = np.zeros(len(ridges)), f.grams.sum(axis=0), f.rights.sum(axis=0)
    for k, rows in enumerate(f.tested):
        x, y = f.x[rows], f.y[rows]
        left = (every - f.grams[k] + ridges, (right - f.rights[k])[:, None])
        theta = np.linalg.solve(*left)[:, :, 0]
        errors += np.sum((y[:, None] - x @ theta.T) ** 2, axis=0)
    count = sum(rows.size for rows in f.tested)
    return float(np.sqrt(errors.min() / count)) if count else float("inf")


def _least_squares(f: _Folds) -> tuple[FloatArray, int]:
    """Residual of y on all columns, and how many of them count.

    P'X'X P = R'R with the largest pivots first, down to RANK in R; solved again for what is left,
    as normal equations lose half the digits.

    Source: Golub and Van Loan, Matrix Computations, 2013, 4.2.9 (pivoting), 5.3.8 (refinement).
    """
    if not f.x.size:
        return f.y, 0
    factor, order, rank, _ = scipy.linalg.lapack.dpstrf(f.grams.sum(axis=0), tol=RANK**2)
    own, left = order[:rank] - 1, f.y
    for _ in range(FLOOR_STEPS):
        theta = np.zeros(f.x.shape[1])
        theta[own] = scipy.linalg.cho_solve((factor[:rank, :rank], False), (f.x.T @ left)[own])
        left = left - f.x @ theta
    return left, int(rank)


def repeat_floor(result: FitResult) -> FloatArray | None:
    """Floor from repeats: rms of the residual's difference over one period / sqrt 2.

    The residual, not the effort, is compared: what small differences of the motion cost is
    taken out by the model.  None if no run repeats itself at least once.
    """
    problem = result.problem
    total, count = np.zeros((2, problem.d))
    for k in range(len(problem.recordings)):
        lag = period(problem, k)
        if not lag:
            continue
        r, live = result.residual[:, problem.run == k], problem.live[:, problem.run == k]
        both = live[:, lag:] & live[:, :-lag]
        total += np.sum(both * (r[:, lag:] - r[:, :-lag]) ** 2, axis=1) / 2
        count += np.sum(both, axis=1)
    known = count > 0
    if not np.all(known | problem.silent):
        return None
    return np.sqrt(total / np.maximum(count, 1))


def measure(result: FitResult, extra: list[list[FloatArray]]) -> Floor:
    """Noise floor of a fit, from repeats where the motion repeats, else the largest model.

    Of a joint that only holds its place nothing is judged: its floor is its residual.  One without
    an effort has the largest effort of the others.
    """
    residual, factor, scale, predicted = largest_model(result, extra)
    repeats = repeat_floor(result)
    rms, method = (predicted, "largest-model") if repeats is None else (repeats, "repeats")
    size = result.problem.rms(result.problem.effort)
    rms = np.where(result.problem.holds, result.rms, np.hypot(rms, known_to(result) * size))
    # where no effort is recorded nothing is known of it
    unknown = np.where(result.problem.silent, float(np.max(size)), 0.0)
    return Floor(np.maximum(rms, unknown), method, residual, factor, np.maximum(scale, unknown))


def known_to(result: FitResult) -> float:
    """Share of the rms effort to which the efforts, or the forces, are known."""
    sensor = result.model.explains == "external"
    return result.problem.accuracy or (SENSOR_ACCURACY if sensor else MATTERS)


def practical(problem: Problem) -> float:
    """Share of the rms effort below which nothing matters: it is neither named nor unexplained."""
    return problem.accuracy or MATTERS
