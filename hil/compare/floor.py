"""The noise floor: what no model could explain, measured and not assumed.

Three sources, the first available counts:

1. *repeats*: the motion repeats itself; what differs between two passes is noise;
2. *largest model*: what the base model, every candidate and a smooth function of all positions
   and speeds together cannot predict on blocks of time that they were not fitted to.

The noise scale must never come from the incomplete model: the missing effect inflates it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from hil.identify.problem import Problem
from hil.identify.regression import inflation
from hil.identify.repeats import period
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
#: Non-linearity and cross-talk of strain-gauge force sensors (1-2 % of what is measured): below
#: that, a law of the environment cannot be told from the sensor's own error.
SENSOR_ACCURACY = 0.02
#: Linearity of amplifiers and DACs, and the jitter of a command within its period: no motor
#: effort is known better than to about a third of a percent.
EFFORT_ACCURACY = 0.003


@dataclass(frozen=True)
class Floor:
    """Noise floor by joint.

    Parameters
    ----------
    rms : ndarray (d,)
        Floor [N m or N], in the band of the effort filter.
    method : str
        ``"repeats"`` or ``"largest-model"``.
    residual : ndarray (d, n)
        Residual of the largest model: the noise that detection is tested against.
    inflation : ndarray (d,)
        1 + 2 sum of autocorrelations of that residual.
    scale : ndarray (d,)
        Its root mean square, corrected for degrees of freedom.
    """

    rms: FloatArray
    method: str
    residual: FloatArray
    inflation: FloatArray
    scale: FloatArray

    def effective(self, problem: Problem) -> FloatArray:
        """Number of independent instants by joint (d,)."""
        return problem.count / self.inflation


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
        columns = [(bumps[:, :, None] * place[:, None, :3]).reshape(len(x), -1), place[:, 1:]]
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
    out = np.empty_like(result.residual)
    factor, scale, predicted = np.ones((3, problem.d))
    for j in range(problem.d):
        own = x[j][:, np.any(x[j] != 0, axis=0)]
        more = np.concatenate([*extra[j], smooth_features(problem, j)], axis=1)
        live = problem.live[j]
        own, more, y = own[live], more[live], problem.y[j, live]
        out[j] = 0.0
        out[j, live], rank = _least_squares(np.concatenate([own, more], axis=1), y)
        factor[j] = inflation(out[j], problem.run)
        # band-limited or coloured rows: one independent value in `factor` instants
        spent = rank * max(factor[j], problem.rate / (2 * problem.rates.effort))
        now = float(result.rms[j])
        free = max(y.size - spent, 0.3 * y.size)
        scale[j] = min(np.sqrt(np.sum(out[j] ** 2) / free), now)
        predicted[j] = min(_left_out(own, more, y), now)
    return out, factor, scale, predicted


def _left_out(base: FloatArray, more: FloatArray, y: FloatArray, folds: int = 6) -> float:
    """Rms error on left-out blocks of time; ridge on `more`, the best of four strengths."""
    x = np.concatenate([base, more], axis=1)
    norm = np.linalg.norm(x, axis=0)
    x = x[:, norm > 1e-300] / norm[norm > 1e-300]
    penalised = (np.arange(norm.size) >= base.shape[1])[norm > 1e-300]
    edges = np.linspace(0, y.size, folds + 1).astype(int)
    grams = [x[a:b].T @ x[a:b] for a, b in pairwise(edges)]
    rights = [x[a:b].T @ y[a:b] for a, b in pairwise(edges)]
    best = np.inf
    for strength in (1e-4, 1e-3, 1e-2, 1e-1):
        ridge = np.diag(np.where(penalised, strength, 1e-10))
        error = 0.0
        for k, (a, b) in enumerate(pairwise(edges)):
            theta = scipy.linalg.solve(
                sum(grams) - grams[k] + ridge, sum(rights) - rights[k], assume_a="sym"
            )
            error += float(np.sum((y[a:b] - x[a:b] @ theta) ** 2))
        best = min(best, error)
    return float(np.sqrt(best / y.size))


def _least_squares(x: FloatArray, y: FloatArray) -> tuple[FloatArray, int]:
    norm = np.linalg.norm(x, axis=0)
    x = x[:, norm > 1e-300] / norm[norm > 1e-300]
    q, r, _ = scipy.linalg.qr(x, mode="economic", pivoting=True, check_finite=False)
    size = np.abs(np.diag(r))
    rank = int(np.sum(size > 1e-6 * size[0])) if size.size else 0
    q = q[:, :rank]
    return y - q @ (q.T @ y), rank


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
    return np.sqrt(total / count) if np.all(count) else None


def measure(result: FitResult, extra: list[list[FloatArray]]) -> Floor:
    """Noise floor of a fit, from repeats where the motion repeats, else the largest model.

    Of a joint that only holds its place nothing is judged: its floor is its residual.
    """
    residual, factor, scale, predicted = largest_model(result, extra)
    repeats = repeat_floor(result)
    rms, method = (predicted, "largest-model") if repeats is None else (repeats, "repeats")
    size = result.problem.rms(result.problem.effort)
    accuracy = SENSOR_ACCURACY if result.model.explains == "external" else EFFORT_ACCURACY
    rms = np.where(result.problem.holds, result.rms, np.hypot(rms, accuracy * size))
    return Floor(rms, method, residual, factor, scale)
