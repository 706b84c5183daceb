"""A one-joint elastic transmission to test estimators on: its own equations and integrator.

Motor and link joined by a cable that stiffens, friction on both sides that warms with the load's
tension.  Semi-implicit Euler at 20 substeps, encoder counts; nothing of the filter is used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan, fabs, pi
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
SUBSTEPS = 20
PERIOD = 1e-3


@dataclass(frozen=True)
class Plant:
    """What the joint is made of.

    Parameters
    ----------
    motor, link : float
        Inertias [kg m^2], on the link's side.
    k1, k3 : float
        Cable [N m/rad], [N m/rad^3].
    coulomb, viscous : tuple of 2 floats
        Motor and link side [N m], [N m s/rad].
    tension_friction : float
        Share of the Coulomb friction of the link that follows the cable's tension.
    counts : float
        Per turn of the motor.
    """

    motor: float = 2e-4
    link: float = 1e-3
    k1: float = 50.0
    k3: float = 2e5
    coulomb: tuple[float, float] = (0.012, 0.010)
    viscous: tuple[float, float] = (1.5e-3, 1.0e-3)
    tension_friction: float = 0.0
    counts: float = 20000.0

    def slackened(self, tension: float) -> Plant:
        """The same joint with `tension` times its cable tension: stiffness and pulley friction."""
        fall = 1.0 + self.tension_friction * (tension - 1.0)
        return replace(
            self, k1=self.k1 * tension, k3=self.k3 * tension,
            coulomb=(self.coulomb[0], self.coulomb[1] * fall),
        )  # fmt: skip


@dataclass(frozen=True)
class Run:
    """One record at 1 kHz.

    Parameters
    ----------
    y, u : ndarray (n,)
        Motor angle as counted [rad], motor torque [N m].
    q, v : ndarray (n,)
        True angle and speed of the link [rad], [rad/s].
    """

    y: FloatArray
    u: FloatArray
    q: FloatArray
    v: FloatArray


@nb.njit(cache=True)
def _simulate(u: Any, load: Any, c: Any, out: Any) -> None:
    a, b, q, v = 0.0, 0.0, 0.0, 0.0
    h = PERIOD / SUBSTEPS
    for k in range(u.size):
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = a, b, q, v
        push = u[k] - 0.02 * a
        out[k, 4] = push
        for _ in range(SUBSTEPS):
            d = a - q
            pull = c[2] * d + c[3] * d**3
            # friction turns over at a twentieth of a rad/s, with an arc tangent
            rub_m = c[4] * atan(b / 0.032) * 2 / pi + c[6] * b
            rub_l = c[5] * atan(v / 0.032) * 2 / pi + c[7] * v
            b += h * (push - rub_m - pull) / c[0]
            v += h * (pull - rub_l + load[k]) / c[1]
            a += h * b
            q += h * v
            if fabs(a) > 1e3:
                return


def record(plant: Plant, seconds: float, seed: int, load: float = 0.0, size: float = 1.0) -> Run:
    """Run the joint on six sines of torque with a light spring to the middle.

    Parameters
    ----------
    plant : Plant
        The joint.
    seconds : float
        Length [s].
    seed : int
        Of the sines, 0.4 to 9 Hz.
    load : float
        External torque ON the link from 1 s on [N m].
    size : float
        Factor on the sines' 0.05 N m.
    """
    rng, n = np.random.default_rng(seed), round(seconds / PERIOD)
    t = np.arange(n) * PERIOD
    phase, rate = rng.uniform(0, 2 * np.pi, 6), rng.uniform(0.4, 9.0, 6)
    u = size * 0.05 * np.sin(2 * np.pi * rate * t[:, None] + phase).sum(1)
    out = np.zeros((n, 5))
    c = np.array([plant.motor, plant.link, plant.k1, plant.k3, *plant.coulomb, *plant.viscous])
    _simulate(u, np.where(t > 1.0, load, 0.0), c, out)
    grain = 2 * np.pi / plant.counts
    return Run(np.round(out[:, 0] / grain) * grain, out[:, 4], out[:, 2], out[:, 3])
