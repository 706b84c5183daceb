"""The sampled loop as it runs: stability, delay that it bears, and what it shows at its ports.

The eigenvalues of the map of one period (`hil.teleop.axis`) decide; driven by a force it predicts
the hybrid matrix that a session shows.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hil.teleop.axis import Axis, Loop
from hil.teleop.hybrid import ComplexArray, FloatArray, Impedance


def radius(loop: Loop, zh: Impedance, ze: Impedance, period: float) -> float:
    """Largest magnitude of the eigenvalues of one period; stable below 1."""
    return mode(loop, zh, ze, period)[0]


def mode(loop: Loop, zh: Impedance, ze: Impedance, period: float) -> tuple[float, float]:
    """Magnitude of the largest eigenvalue of one period, and its frequency [Hz]."""
    values = np.linalg.eigvals(Axis(loop, zh, ze, period).matrix())
    top = values[np.abs(values).argmax()]
    return float(abs(top)), float(abs(np.angle(top)) / (2 * np.pi * period))


def margin(loop: Loop, zh: Impedance, ze: Impedance, period: float) -> float:
    """Additional round-trip delay that the sampled loop bears [s], to half a millisecond or so.

    Half of it is added to each channel; the search doubles, then halves, and ends at 0.2 s.
    """

    def stable(extra: float) -> bool:
        real = replace(
            loop.real, forward_s=loop.real.forward_s + extra / 2,
            backward_s=loop.real.backward_s + extra / 2,
        )  # fmt: skip
        return radius(replace(loop, real=real), zh, ze, period) < 1.0 + 1e-9

    if not stable(0.0):
        return 0.0
    step, low = 2 * period, 0.0
    while low < 0.2 and stable(low + step):
        low, step = low + step, 2 * step
    high = low + step
    while high - low > 2.5 * period and low < 0.2:
        mid = 2 * period * round((low + high) / 2 / (2 * period))
        low, high = (mid, high) if stable(mid) else (low, mid)
    return low


def hybrid_at(loop: Loop, w: FloatArray, period: float, encoders: bool = False) -> ComplexArray:
    """Hybrid matrix that the sampled loop shows at w [rad/s], (n, 2, 2).

    Two experiments per frequency, free and against a spring, driven by the operator's force:
    from [f_m; -v_s] of both and [v_m; f_s] of both.  With `encoders` the speeds are those that
    encoders on the motors see, which lack the cables' stretch.
    """
    y, u = [], []
    for ze in (Impedance(0.0, 0.5, 0.0), Impedance(0.0, 2.0, 200.0)):
        axis = Axis(loop, Impedance(0.2, 3.0, 80.0), ze, period)
        a, n = axis.matrix(), axis.size
        b = axis.advance(np.zeros(n), 1.0)
        ports = np.stack([np.array(axis.ports(e)) for e in np.eye(n)], axis=1)
        direct = np.array(axis.ports(np.zeros(n), 1.0))
        z = [np.linalg.solve(np.exp(1j * x * period) * np.eye(n) - a, b) for x in w]
        f = np.stack([ports @ v + direct for v in z])
        vm, vs = axis.speeds(np.stack(z).T, encoders)
        y.append(np.stack([f[:, 0], -vs], -1))
        u.append(np.stack([vm, f[:, 1]], -1))
    out: Any = np.stack(y, -1) @ np.linalg.inv(np.stack(u, -1))
    return np.asarray(out, np.complex128)
