"""Multi-step error: the model simulated forward from measured states, over short horizons.

One-step (inverse dynamics) error can fall while the simulated motion gets worse; both are
shown, always.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]
WINDOWS = 60


@dataclass(frozen=True)
class MultiStep:
    """Simulated position error.

    Parameters
    ----------
    horizon : float
        Length of each simulation [s].
    rms : ndarray (d,)
        Rms position error over all windows and instants [rad or m].
    relative : ndarray (d,)
        100 rms error / rms displacement within the windows [%].
    windows : int
        Number of simulations.
    diverged : int
        Windows whose simulation left the recorded range by more than its span.
    power : ndarray (windows, d)
        Mean squared position error of each window; NaN where it diverged.
    """

    horizon: float
    rms: FloatArray
    relative: FloatArray
    windows: int
    diverged: int
    power: FloatArray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    @property
    def lost(self) -> bool:
        """Whether no simulation stayed in the recorded range, so that the error means nothing."""
        return self.windows == self.diverged

    def rises(self, before: MultiStep, j: int, factor: float) -> bool:
        """Whether joint j's error rose by this factor and by more than its standard error.

        The same windows are compared; neighbours overlap by half, which halves their number.
        """
        if self.lost or before.lost:
            return self.lost and not before.lost
        if self.power.shape != before.power.shape or not self.power.size:
            return bool(self.rms[j] > factor * before.rms[j])
        pair = np.stack([before.power[:, j], self.power[:, j]])
        pair = pair[:, np.isfinite(pair).all(axis=0)]
        old, new = np.sqrt(pair.mean(axis=1)) if pair.size else (np.inf, np.inf)
        rise = pair[1] - pair[0]
        chance = float(np.std(rise)) * np.sqrt(2 / max(rise.size - 1, 1))
        return bool(new > factor * old and rise.mean() > chance)


class _Forward:
    """Effort of the model for many states at once; state effects follow the measured motion."""

    def __init__(self, result: FitResult, motion: Motion) -> None:
        self.result, self.motion = result, motion
        self.parts = [
            (t, result.theta[s])
            for t, s in zip(result.terms, result.slices, strict=True)
            if not t.per_run
        ]

    def replayed(self, term: Term) -> bool:
        """States and derivatives of the measured effort are taken from the measured run."""
        return term.effect.name in ("presliding", "delay")

    def fixed(self) -> FloatArray:
        """Effort (n, d) of the replayed terms along the measured motion."""
        out = np.zeros_like(self.motion.q)
        for t, theta in self.parts:
            if self.replayed(t):
                out[:, t.joint] += t.effect.columns(self.motion, t.joint, t.shape) @ theta
        return out

    def effort(
        self, q: FloatArray, qd: FloatArray, qdd: FloatArray, load: FloatArray
    ) -> FloatArray:
        """Effort (w, d) of the other terms at states (w, d)."""
        m = replace(self.motion, t=np.arange(len(q), dtype=float), q=q, qd=qd, qdd=qdd, load=load,
                    tau=np.zeros_like(q), tau_ext=np.zeros_like(q), average=0.0)  # fmt: skip
        out = np.zeros_like(q)
        for t, theta in self.parts:
            if self.replayed(t):
                continue
            columns = t.effect.columns(m, t.joint, t.shape)
            if t.effect.whole_robot:
                out += columns @ theta
            else:
                out[:, t.joint] += columns @ theta
        return out


def simulate(result: FitResult, problem: Problem, seconds: float = 0.5) -> MultiStep:
    """Simulate a fitted model from measured states with the measured effort.

    M(q) qdd = tau + tau_ext - h(q, qd); semi-implicit Euler at the evaluation rate.

    Parameters
    ----------
    result : FitResult
        The fit.
    problem : Problem
        Runs to simulate (the same or held-out ones).
    seconds : float
        Horizon.
    """
    errors: list[FloatArray] = []
    moves: list[FloatArray] = []
    for motion in problem.motions:
        horizon = max(2, round(seconds / motion.dt))
        edge = int(0.2 / motion.dt)
        last = motion.n - horizon - edge
        if last <= edge:
            continue
        count = min(WINDOWS, max(1, (last - edge) // max(horizon // 2, 1)))
        starts = np.linspace(edge, last, count).astype(int)
        error, move = _run(result, motion, starts, horizon)
        errors.append(error)
        moves.append(move)
    if not errors:
        nothing = np.full(problem.d, np.nan)
        return MultiStep(seconds, nothing, nothing, 0, 0)
    error, move = np.concatenate(errors), np.concatenate(moves)
    span = np.ptp(problem.span, axis=1)
    bad = np.any(~np.isfinite(error) | (np.abs(error) > span), axis=(1, 2))
    good = error[~bad] if (~bad).any() else np.nan_to_num(error, nan=np.inf)
    rms = np.sqrt(np.mean(good**2, axis=(0, 1)))
    size = np.sqrt(np.mean(move**2, axis=(0, 1)))
    power = np.full((len(error), problem.d), np.nan)
    power[~bad] = np.mean(error[~bad] ** 2, axis=1)
    relative = 100 * rms / np.maximum(size, 1e-12)
    return MultiStep(seconds, rms, relative, len(error), int(bad.sum()), power)


def _run(
    result: FitResult, motion: Motion, starts: NDArray[np.int_], horizon: int
) -> tuple[FloatArray, FloatArray]:
    """Position errors and displacements (windows, horizon, d)."""
    model, dt, d = _Forward(result, motion), motion.dt, motion.d
    drive = motion.tau + motion.tau_ext - model.fixed()
    q, qd = motion.q[starts].copy(), motion.qd[starts].copy()
    error = np.empty((len(starts), horizon, d))
    move = np.empty_like(error)
    unit = np.eye(d)
    with np.errstate(all="ignore"):
        for k in range(horizon):
            load = motion.load[starts + k]
            rest = model.effort(q, qd, np.zeros_like(q), load)
            mass = np.stack(
                [model.effort(q, qd, np.tile(unit[i], (len(q), 1)), load) - rest for i in range(d)],
                axis=-1,
            )
            push = drive[starts + k] - rest
            qdd = (
                np.linalg.solve(mass, push[..., None])[..., 0] if _regular(mass) else push * np.nan
            )
            qd = qd + dt * qdd
            q = q + dt * qd
            q, qd = np.clip(q, -1e6, 1e6), np.clip(qd, -1e6, 1e6)
            error[:, k] = q - motion.q[starts + k + 1]
            move[:, k] = motion.q[starts + k + 1] - motion.q[starts]
    return error, move


def _regular(mass: FloatArray) -> bool:
    return bool(np.all(np.isfinite(mass)) and np.all(np.abs(np.linalg.det(mass)) > 1e-300))
