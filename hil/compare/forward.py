"""Forward simulation of a fitted model, many windows of a run at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.identify.design import Term, by_run
from hil.identify.result import FitResult
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]


class _Forward:
    """Effort of the model for many states at once; state effects follow the measured motion."""

    def __init__(self, result: FitResult, motion: Motion) -> None:
        self.result, self.motion = result, motion
        self.parts = [
            (t, result.theta[s] if not t.per_run else self._of_run(t, result.theta[s]))
            for t, s in zip(result.terms, result.slices, strict=True)
        ]

    def _of_run(self, term: Term, theta: FloatArray) -> FloatArray:
        """Coefficients of this run; zero for a run that was not fitted."""
        motions = self.result.problem.motions
        own = by_run(term, theta, len(motions))
        for k, m in enumerate(motions):
            if m is self.motion:
                return np.asarray(own[k])
        return np.zeros(own.shape[1])

    def replayed(self, term: Term) -> bool:
        """States and derivatives of the measured effort are taken from the measured run."""
        return term.effect.replayed

    def fixed(self) -> FloatArray:
        """Effort (n, d) of the replayed terms along the measured motion."""
        out = np.zeros_like(self.motion.q)
        for t, theta in self.parts:
            if self.replayed(t):
                where = slice(None) if t.effect.whole_robot else t.joint
                out[:, where] += t.effect.columns(self.motion, t.joint, t.shape) @ theta
        return out

    def slope(
        self, q: FloatArray, qd: FloatArray, step: FloatArray, load: FloatArray
    ) -> FloatArray:
        """Secant slope (w, d) of each joint's own friction over speeds qd - step to qd + step.

        Across a reversal dry friction rises by its whole size: the secant, unlike the tangent,
        knows it, and the implicit step below then holds a joint that sticks.
        """
        speeds = np.concatenate([qd + step, qd - step])
        twice, rest = np.tile(q, (2, 1)), np.zeros_like(speeds)
        up, down = np.split(
            self.effort(twice, speeds, rest, np.tile(load, (2, 1, 1)), mass=False), 2
        )
        out: FloatArray = np.maximum((up - down) / (2 * step), 0.0)
        return out

    def balance(
        self, q: FloatArray, qd: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Effort (w, d) without acceleration, and mass matrix (w, d, d), at states (w, d)."""
        w, d = q.shape
        # no acceleration, then one of each joint: all states at once
        unit = np.repeat(np.concatenate([np.zeros((1, d)), np.eye(d)]), w, axis=0)
        q, qd = (np.tile(x, (1 + d, 1)) for x in (q, qd))
        load = np.tile(load, (1 + d, 1, 1))
        each = self.effort(q, qd, unit, load).reshape(1 + d, w, d)
        return each[0], np.moveaxis(each[1:] - each[0], 0, -1)

    def effort(
        self, q: FloatArray, qd: FloatArray, qdd: FloatArray, load: FloatArray, mass: bool = True
    ) -> FloatArray:
        """Effort (w, d) of the other terms at states (w, d); without the mass' on demand.

        `load` (w, 2, d): all that is transmitted as measured, and its static part.
        """
        m = replace(self.motion, t=np.arange(len(q), dtype=float), q=q, qd=qd, qdd=qdd,
                    load=load[:, 0], static=load[:, 1], tau=np.zeros_like(q),
                    tau_ext=np.zeros_like(q), average=0.0)  # fmt: skip
        out = np.zeros_like(q)
        for t, theta in self.parts:
            if self.replayed(t) or (t.effect.whole_robot and not mass):
                continue
            columns = t.effect.columns(m, t.joint, t.shape)
            if t.effect.whole_robot:
                out += columns @ theta
            else:
                out[:, t.joint] += columns @ theta
        return out


def forward(
    result: FitResult, motion: Motion, starts: NDArray[np.int_], horizon: int, servo: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Position errors and displacements (windows, horizon, d).

    (M(q) + dt D) qdd = tau + tau_ext - h(q, qd),  qdd += w^2 (q_m - q) + 2 w (qd_m - qd)

    with w = 2 pi servo and D the secant slope of friction over the step (linearly implicit Euler at
    the evaluation rate).

    Parameters
    ----------
    result : FitResult
        The fit.
    motion : Motion
        Measured run.
    starts : ndarray of int (windows,)
        First instants.
    horizon : int
        Instants of each window.
    servo : float
        Bandwidth [Hz] of a servo that leads the model back to the measured motion; 0 = none.
    """
    model, dt, d = _Forward(result, motion), motion.dt, motion.d
    drive = motion.tau + motion.tau_ext - model.fixed()
    q, qd = motion.q[starts].copy(), motion.qd[starts].copy()
    error = np.empty((len(starts), horizon, d))
    move = np.empty_like(error)
    unit, w = np.eye(d), 2 * np.pi * servo
    loads = np.stack([motion.load, motion.static], axis=1)
    with np.errstate(all="ignore"):
        for k in range(horizon):
            load = loads[starts + k]
            rest, mass = model.balance(q, qd, load)
            push = drive[starts + k] - rest
            qdd = _solve(mass, push)
            slope = model.slope(q, qd, np.abs(dt * qdd) + 1e-9, load)
            qdd = _solve(mass + dt * slope[..., None] * unit, push)
            qdd = qdd + w**2 * (motion.q[starts + k] - q) + 2 * w * (motion.qd[starts + k] - qd)
            qd = qd + dt * qdd
            q = q + dt * qd
            q, qd = np.clip(q, -1e6, 1e6), np.clip(qd, -1e6, 1e6)
            error[:, k] = q - motion.q[starts + k + 1]
            move[:, k] = motion.q[starts + k + 1] - motion.q[starts]
    return error, move


def _solve(mass: FloatArray, push: FloatArray) -> FloatArray:
    if not _regular(mass):
        return push * np.nan
    return np.asarray(np.linalg.solve(mass, push[..., None])[..., 0])


def _regular(mass: FloatArray) -> bool:
    return bool(np.all(np.isfinite(mass)) and np.all(np.abs(np.linalg.det(mass)) > 1e-300))
