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


@numba.njit(cache=True)
def slip_state(q: FloatArray, scale: float) -> FloatArray:
    """State of a Maxwell-slip element: a spring that slips at the displacement `scale`.

    z <- clip(z + dq / s, -1, 1)

    Parameters
    ----------
    q : ndarray (n,)
        Position [rad or m].
    scale : float
        Displacement s at which it slips [rad or m].

    Returns
    -------
    ndarray (n,)
        State in [-1, 1]; friction is fc z.
    """
    z = np.zeros(q.size)
    for k in range(1, q.size):
        z[k] = min(max(z[k - 1] + (q[k] - q[k - 1]) / scale, -1.0), 1.0)
    return z


class Presliding(Effect):
    """Friction that needs a displacement to build up after each reversal.

    It takes the place of Coulomb friction: what builds up within less than the data resolve
    stays as a sign.
    """

    replayed = strict = True
    name, family = "presliding", "friction"
    equation = (
        "tau = f0 tanh(v / v0) + f1 z(s) + f2 z(3 s) + f3 z(9 s),  "
        "z <- clip(z + dq / s, -1, 1) (Maxwell slip) or dz/dq = (1 - z sgn v) / s (Dahl)"
    )
    signature = "a loop over the displacement since reversal, independent of speed"
    confused_with = ("backlash", "elastic-transmission", "stribeck", "delay")
    shown_by = "small reversals below break-away, at two or more frequencies"
    source = "Dahl 1968; Lampaert, Swevers, Al-Bender, IEEE Trans. Automatic Control 47(4), 2002"
    params = (
        Param("f0", "{F}", "sliding friction that builds up at once", 0.0),
        Param("f1", "{F}", "sliding friction of the stiffest element", 0.0),
        Param("f2", "{F}", "sliding friction of the element three times as soft", 0.0),
        Param("f3", "{F}", "sliding friction of the element nine times as soft", 0.0),
    )
    shape = (
        Param("s", "{x}", "presliding displacement", 0.0),
        Param("form", "1", "0 Maxwell slip, 1 Dahl", 0.0, 1.0),
    )
    replaces = ("coulomb",)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[sign, z(q; s), z(q; 3 s), z(q; 9 s)]: nested loops."""
        q = np.ascontiguousarray(motion.q[:, j])
        state = slip_state if shape[1] == 0.0 else dahl_state
        loops = [state(q, k * float(shape[0])) for k in (1.0, 3.0, 9.0)]
        return np.stack([motion.sign(j), *loops], axis=1)

    def grid(self, motion: Motion, j: int) -> list[tuple[float, ...]]:
        """From 1e-4 of the span, and from twice what the encoder resolves, to 5e-2 of the span."""
        span = float(np.ptp(motion.span[j])) or 1.0
        grain = float(motion.grain[j]) if motion.grain.size else 0.0
        least = min(max(1e-4 * span, 2 * grain), 4e-2 * span)
        return [(s, form) for form in (0.0, 1.0) for (s,) in log_grid(least, 5e-2 * span, 10)]


EFFECTS: tuple[Effect, ...] = (Presliding(),)
