"""Momentum observer of one arm: external torque without acceleration, compiled for the loop."""

from __future__ import annotations

from typing import Any

import numba as nb

from hil.controllers import dynamics


@nb.njit(cache=True, nogil=True)
def advance(
    running: bool, q: Any, v: Any, sent: Any, rub: Any, pi: Any, gain: float, period: float,
    past: Any, now: Any, room: Any, impulse: Any, flow: Any, r: Any,
) -> None:  # fmt: skip
    """One period: r = K (M q' - int(tau_c + C^T q' - N - tau_f + r) dt) into `r` (3,) [N m].

    The external torque through a first-order low-pass of corner K; implicit in r, stable for
    any K.

    Parameters
    ----------
    sent, rub : ndarray (3,)
        Torque of the last tick, friction [N m].
    gain, period : float
        K [rad/s], T [s].
    past, now : ndarray (3,)
        Integral before (read) and after (written) [N m s].
    room, impulse, flow : ndarray (6, 3), (3,), (3,)
        Scratch.
    """
    dynamics.momentum(q, v, pi, room[:2], impulse)
    dynamics.push(q, v, pi, room, flow)
    for i in range(3):
        known = past[i] + period * (sent[i] + flow[i] - rub[i]) if running else impulse[i]
        r[i] = gain * (impulse[i] - known) / (1.0 + gain * period)
        now[i] = known + period * r[i]
