"""How the fitted model's effort answers a small error of position or acceleration.

Evaluated twenty times a second along the run and interpolated: it changes with the posture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hil.identify.design import Term
from hil.models.effect import Trait
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]
#: Evaluations a second, and the step of the difference [rad or m].
RATE, STEP = 20.0, 1e-5


class Response:
    """Inertia and static stiffness of a model along one run.

    Parameters
    ----------
    motion : Motion
        The run.
    parts : sequence of (Term, ndarray (m,))
        Mass, stiffness and viscous terms with their coefficients.
    more : sequence of (Term, ndarray (m,))
        Further terms that depend on nothing but the motion.
    """

    def __init__(
        self, motion: Motion, parts: Sequence[tuple[Term, FloatArray]],
        more: Sequence[tuple[Term, FloatArray]] = (),
    ) -> None:  # fmt: skip
        self._motion, self._parts, self._more = motion, parts, more
        self._unslipped: dict[int, FloatArray] = {}
        stride = max(1, int(1 / RATE / motion.dt))
        self._pick = np.unique(np.append(np.arange(0, motion.n, stride), motion.n - 1))

    @cached_property
    def inertia(self) -> FloatArray:
        """M(q) with M[i, j] = d tau_i / d qdd_j, shape (n, d, d)."""
        rest, one = self._effort(0.0, 0.0), np.eye(self._motion.d)
        return self._along([self._effort(0.0, row) - rest for row in one])

    @cached_property
    def gradient(self) -> FloatArray:
        """G(q) with G[i, j] = d tau_i / d q_j at rest, shape (n, d, d)."""
        rest, step = self._effort(0.0, 0.0), STEP * np.eye(self._motion.d)
        return self._along([(self._effort(row, 0.0) - rest) / STEP for row in step])

    @cached_property
    def damping(self) -> FloatArray:
        """Viscous coefficient of each joint, shape (d,)."""
        out = np.zeros(self._motion.d)
        for t, theta in self._parts:
            if Trait.VISCOUS in t.effect.traits:
                out[t.joint] += float(theta[0])
        return out

    def unslipped(self, j: int) -> FloatArray:
        """f(q - e, q' - e', q'' - e'') - f(q, q', q''), e the jumps of joint j, shape (n, d)."""
        if j not in self._unslipped:
            m, only = self._motion, np.arange(self._motion.d) == j
            e = m.slips * only if m.slips.size else np.zeros((3, *m.q.shape))
            true = replace(m, q=m.q - e[0], qd=m.qd - e[1], qdd=m.qdd - e[2])
            out = np.zeros_like(m.q)
            for t, theta in (*self._parts, *self._more) if np.any(e) else ():
                where = slice(None) if t.effect.scope.whole else t.joint
                moved = t.effect.columns(true, t.joint, t.shape)
                out[:, where] += (moved - t.effect.columns(m, t.joint, t.shape)) @ theta
            self._unslipped[j] = out
        return self._unslipped[j]

    def _along(self, columns: list[FloatArray]) -> FloatArray:
        values = np.stack(columns, axis=2)
        if len(self._pick) < 4:
            return np.broadcast_to(values[:1], (self._motion.n, *values.shape[1:])).copy()
        spline = CubicSpline(self._motion.t[self._pick], values, axis=0)
        return np.asarray(spline(self._motion.t), dtype=np.float64)

    def _effort(self, aside: FloatArray | float, qdd: FloatArray | float) -> FloatArray:
        """Effort at rest in the postures, moved aside, under an acceleration; (picked, d)."""
        m, zero = self._motion, np.zeros((len(self._pick), self._motion.d))
        posed = replace(
            m, t=m.t[self._pick], q=m.q[self._pick] + aside, qd=zero, qdd=zero + qdd, response=None
        )
        out = np.zeros_like(zero)
        for t, theta in self._parts:
            where = slice(None) if t.effect.scope.whole else t.joint
            out[:, where] += t.effect.columns(posed, t.joint, t.shape) @ theta
        return out
