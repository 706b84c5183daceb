"""Forward simulation of fitted models, many windows of a run at once.

A step costs about the same for one window as for hundreds, so several models are simulated
together and a term that they share is evaluated once for all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.compare.elimination import eliminated
from hil.compare.states import looked_at, parts_of, replayed, shared
from hil.identify.result import FitResult
from hil.models.mass import RigidBody
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int_]


@dataclass(frozen=True)
class Windows:
    """What is simulated with one model.

    Parameters
    ----------
    result : FitResult
        The fit.
    starts : ndarray of int (windows,)
        First instants.
    horizon : int
        Instants of each window.
    servo : float
        Bandwidth [Hz] of a servo that leads the model back to the measured motion; 0 = none.
    motion : Motion, optional
        The run with the load of this model, where that is another one.
    """

    result: FitResult
    starts: IntArray
    horizon: int
    servo: float = 0.0
    motion: Motion | None = None


class _Forward:
    """Effort of the models for many states at once; state effects follow the measured motion.

    Row k of the states belongs to jobs[owner[k]].
    """

    def __init__(self, jobs: Sequence[Windows], motion: Motion, owner: IntArray) -> None:
        self.motion, self.owner = motion, owner
        every = shared([parts_of(job.result, motion) for job in jobs], owner)
        #: Rigid-body parameters: the robot gives their balance at once; no parts of the rest.
        own = [isinstance(t.effect, RigidBody) for t, _ in every]
        self._masses = [theta for (_, theta), mine in zip(every, own, strict=True) if mine]
        self._parts = [part for part, mine in zip(every, own, strict=True) if not mine]
        self._seen = [looked_at(t, motion) for t, _ in self._parts]
        #: Whether anything but the rigid bodies has a mass.
        self._heavy = any("qdd" in seen for seen in self._seen)

    def slope(
        self, q: FloatArray, qd: FloatArray, step: FloatArray, load: FloatArray
    ) -> FloatArray:
        """Secant slope (w, d) of each joint's own friction over speeds qd - step to qd + step.

        Across a reversal dry friction rises by its whole size: the secant, unlike the tangent,
        knows it, and the implicit step below then holds a joint that sticks.
        """
        speeds = np.stack([qd + step, qd - step])
        up, down = self.effort(q, speeds, np.zeros_like(speeds), load, mass=False)
        out: FloatArray = np.maximum((up - down) / (2 * step), 0.0)
        return out

    def balance(
        self, q: FloatArray, qd: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Effort (w, d) without acceleration, and mass matrix (w, d, d), at states (w, d)."""
        w, d = q.shape
        # no acceleration, then one of each joint where it matters: all states at once
        unit = np.zeros((1 + d * self._heavy, w, d))
        for j in range(len(unit) - 1):
            unit[1 + j, :, j] = 1.0
        each = self.effort(q, qd, unit, load)
        rest, mass = each[0], np.zeros((w, d, d))
        if self._heavy:
            mass = np.moveaxis(each[1:] - each[0], 0, -1)
        for pi in self._masses:
            still, heavy = self.motion.robot.balance(q, qd, pi)
            rest, mass = rest + still, mass + heavy
        return rest, mass

    def solve(self, mass: FloatArray, push: FloatArray) -> FloatArray:
        """Acceleration (w, d); NaN for all windows of a job that has a singular one."""
        out = eliminated(mass, push)
        if np.isfinite(out).all():
            return out
        size = np.abs(np.linalg.det(mass))
        bad = ~(np.isfinite(size) & (size > 1e-300) & np.isfinite(mass).all(axis=(1, 2)))
        lost = np.isin(self.owner, self.owner[bad])
        safe = np.where(lost[:, None, None], np.eye(mass.shape[1]), mass)
        return np.where(lost[:, None], np.nan, eliminated(safe, push))

    def effort(
        self, q: FloatArray, qd: FloatArray, qdd: FloatArray, load: FloatArray, mass: bool = True
    ) -> FloatArray:
        """Effort (r, w, d) but for `_masses`, at q (w, d), qd (w, d) or (r, w, d), qdd (r, w, d).

        Without the mass' on demand.  `load` (w, 2, d): all that is transmitted as measured, and
        its static part.
        """
        shape = qdd.shape
        flat = (q, qd, load[:, 0], load[:, 1])
        positions, speeds, fully, static = (
            x.reshape(-1, shape[2]) if x.ndim == 3 else _times(x, shape[0]) for x in flat
        )
        every = few = self.motion.at_states(
            positions, speeds, qdd.reshape(positions.shape), fully, static
        )
        if qd.ndim == 2 and shape[0] > 1:
            # one state each is enough for what no acceleration changes
            few = self.motion.at_states(q, qd, qdd[0], *flat[2:])
        out = np.zeros(shape)
        for (t, theta), seen in zip(self._parts, self._seen, strict=True):
            if not mass and (t.effect.whole_robot or "qd" not in seen):
                continue
            m = every if "qdd" in seen else few
            columns = t.effect.columns(m, t.joint, t.shape)
            if t.effect.whole_robot:
                columns = columns.reshape(-1, shape[1], *columns.shape[1:])
                out += np.einsum("rwdm,wm->rwd", columns, theta)
            elif theta.shape[1] == 1:
                out[..., t.joint] += columns.reshape(-1, shape[1]) * theta[:, 0]
            else:
                columns = columns.reshape(-1, *theta.shape)
                out[..., t.joint] += (columns * theta).sum(axis=2)
        return out


def _times(x: FloatArray, count: int) -> FloatArray:
    """States (w, d) that many times, one after the other."""
    return x if count == 1 else np.concatenate([x] * count)


def forward(motion: Motion, jobs: Sequence[Windows]) -> list[tuple[FloatArray, FloatArray]]:
    """Position errors and displacements (windows, horizon, d) of each job.

    (M(q) + dt D) qdd = tau + tau_ext - h(q, qd),  qdd += w^2 (q_m - q) + 2 w (qd_m - qd)

    with w = 2 pi servo and D the secant slope of friction over the step (linearly implicit Euler at
    the evaluation rate).

    Parameters
    ----------
    motion : Motion
        Measured run.
    jobs : sequence of Windows
        Models and windows.
    """
    owner = np.repeat(np.arange(len(jobs)), [len(job.starts) for job in jobs])
    starts = np.concatenate([job.starts for job in jobs])
    horizon = np.array([job.horizon for job in jobs])[owner]
    drive, loads = _drives(jobs, motion, owner), _loads(jobs, motion, owner)
    w = 2 * np.pi * np.array([job.servo for job in jobs])
    path = np.full((len(starts), int(horizon.max()), motion.d), np.nan)
    rows, begin, q, qd = np.arange(len(starts)), 0, motion.q[starts], motion.qd[starts]
    with np.errstate(all="ignore"):
        for end in np.unique(horizon).tolist():
            on = horizon[rows] >= end
            q, qd, rows = q[on], qd[on], rows[on]
            model, servo = _Forward(jobs, motion, owner[rows]), w[owner[rows], None]
            for k in range(begin, end):
                now = starts[rows] + k
                q, qd = _step(model, q, qd, drive(rows, now), loads(rows, now), servo, now)
                path[rows, k] = q
            begin = end
    return [
        _errors(path[owner == k, : job.horizon], job.starts, motion) for k, job in enumerate(jobs)
    ]


def _drives(
    jobs: Sequence[Windows], motion: Motion, owner: IntArray
) -> Callable[[IntArray, IntArray], FloatArray]:
    """What drives rows (w,) at instants (w,): efforts less those that are replayed, (w, d)."""
    results = list({id(job.result): job.result for job in jobs}.values())
    place = {id(r): k for k, r in enumerate(results)}
    which = np.array([place[id(job.result)] for job in jobs])[owner]
    own = {id(job.result): job.motion for job in jobs}
    felt = np.stack([replayed(r, motion, own[id(r)]) for r in results])
    every = motion.tau + motion.tau_ext - felt
    return lambda rows, now: np.asarray(every[which[rows], now])


def _loads(
    jobs: Sequence[Windows], motion: Motion, owner: IntArray
) -> Callable[[IntArray, IntArray], FloatArray]:
    """Load of rows (w,) at instants (w,) and its part at rest, (w, 2, d): each model's own."""
    carried = [job.motion or motion for job in jobs]
    if all(m is carried[0] for m in carried):
        m = carried[0]
        return lambda rows, now: np.stack([m.load[now], m.static[now]], axis=1)

    def each(rows: IntArray, now: IntArray) -> FloatArray:
        out = np.empty((len(rows), 2, motion.d))
        for k, m in enumerate(carried):
            own = owner[rows] == k
            out[own, 0], out[own, 1] = m.load[now[own]], m.static[now[own]]
        return out

    return each


def _step(
    model: _Forward, q: FloatArray, qd: FloatArray, drive: FloatArray, load: FloatArray,
    w: FloatArray, now: IntArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Positions and speeds (rows, d) one instant after `now` (rows,)."""
    m = model.motion
    rest, mass = model.balance(q, qd, load)
    push = drive - rest
    qdd = model.solve(mass, push)
    slope = model.slope(q, qd, np.abs(m.dt * qdd) + 1e-9, load)
    qdd = model.solve(mass + m.dt * slope[..., None] * np.eye(m.d), push)
    qdd = qdd + w**2 * (m.q[now] - q) + 2 * w * (m.qd[now] - qd)
    qd = qd + m.dt * qdd
    q = q + m.dt * qd
    return np.clip(q, -1e6, 1e6), np.clip(qd, -1e6, 1e6)


def _errors(path: FloatArray, starts: IntArray, motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Errors and displacements of simulated positions (windows, horizon, d)."""
    true = motion.q[starts[:, None] + np.arange(1, path.shape[1] + 1)]
    return path - true, true - motion.q[starts][:, None]
