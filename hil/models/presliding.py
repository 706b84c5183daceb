"""Presliding: friction as a state of the displacement since the last reversal."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from hil.models.effect import Effect, Param, log_grid
from hil.models.motion import FloatArray, Motion


@numba.njit(cache=True)
def dahl_state(q: FloatArray, scale: float) -> FloatArray:
    """Dahl's state for a measured position, exact between samples.

    dz/dq = (1 - z sgn v) / s   =>   z <- sgn + (z - sgn) exp(-|dq| / s)

    Parameters
    ----------
    q : ndarray (n,)
        Position [rad or m].
    scale : float
        Presliding displacement s [rad or m].

    Returns
    -------
    ndarray (n,)
        State in [-1, 1]; friction is fc z.
    """
    z = np.zeros(q.size)
    for k in range(1, q.size):
        step = q[k] - q[k - 1]
        goal = 1.0 if step > 0 else -1.0
        z[k] = goal + (z[k - 1] - goal) * np.exp(-abs(step) / scale)
    return z


class Presliding(Effect):
    """Friction that needs a displacement to build up after each reversal."""

    replayed = True
    name, family = "presliding", "friction"
    equation = "tau = f1 z(s) + f2 z(3 s) + f3 z(9 s),  dz/dq = (1 - z sgn v) / s"
    signature = "a loop over the displacement since reversal, independent of speed"
    confused_with = ("backlash", "elastic-transmission", "stribeck", "delay")
    shown_by = "small reversals below break-away, at two or more frequencies"
    source = "Dahl 1968; Lampaert, Swevers, Al-Bender, IEEE Trans. Automatic Control 47(4), 2002"
    params = (
        Param("f1", "{F}", "sliding friction of the stiffest element", 0.0),
        Param("f2", "{F}", "sliding friction of the element three times as soft", 0.0),
        Param("f3", "{F}", "sliding friction of the element nine times as soft", 0.0),
    )
    shape = (Param("s", "{x}", "presliding displacement", 0.0),)
    replaces = ("coulomb",)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[z(q; s), z(q; 3 s), z(q; 9 s)]: nested loops (generalised Maxwell slip)."""
        q = np.ascontiguousarray(motion.q[:, j])
        return np.stack([dahl_state(q, k * float(shape[0])) for k in (1.0, 3.0, 9.0)], axis=1)

    def grid(self, motion: Motion, j: int) -> list[tuple[float, ...]]:
        """From 1e-4 of the span, and from twice what the encoder resolves, to 5e-2 of the span."""
        span = float(np.ptp(motion.span[j])) or 1.0
        grain = float(motion.grain[j]) if motion.grain.size else 0.0
        return log_grid(min(max(1e-4 * span, 2 * grain), 4e-2 * span), 5e-2 * span, 10)


EFFECTS: tuple[Effect, ...] = (Presliding(),)
