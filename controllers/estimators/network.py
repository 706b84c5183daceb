"""Friction learnt in the loop, and with it the force on the tip without a sensor.

A momentum observer that knows no friction sees r = LPF(tau_s - tau_f).  While nothing touches the
arm, -r is what the wavelet networks of `hil.controllers.estimators.wavelets` learn; then
tau_s = r + LPF(tau_f).  With a force sensor "nothing touches" is measured; without one, say for how
long.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba as nb
import numpy as np

from hil.controllers import dynamics
from hil.controllers.estimators import wavelets
from hil.controllers.lawrence_config import PREMIUM
from hil.errors import ConfigError
from hil.signals.device import FloatArray

NETWORK_COLUMNS = (
    *(f"force_{axis}" for axis in "xyz"),
    *(f"torque{j}" for j in (1, 2, 3)),
    *(f"friction{j}" for j in (1, 2, 3)),
    "learning",
    "nodes",
)
_UNITS = ("N",) * 3 + ("N m",) * 6 + ("1",) * 2
#: Memory before the networks: integral (3,), time, time of the last touch.
_FIRST = 5


@dataclass(frozen=True)
class WaveletConfig:
    """Parameters of networks that learn in the loop.

    Parameters
    ----------
    nodes : int
        Most wavelets; 0 = Coulomb and viscous friction alone.
    backbone : bool
        Whether Coulomb and viscous friction carry the wavelets.
    scale : tuple of 3 floats
        Speed that counts as 1 per joint [rad/s].
    coarsest, finest : int
        Levels.
    gain, floor, zone : float
        Learning gain within 0 and 2 a tick, floor of the energy, dead zone [N m].
    add, remove : float
        Activity [N m] above which a node gets finer ones beside it, below which it goes.
    dwell : float
        Time that a node has to prove itself [s].
    soft : float
        Speed over which the sign of the velocity is resolved [rad/s].
    """

    nodes: int = 60
    backbone: bool = True
    scale: tuple[float, float, float] = (1.5, 1.5, 1.5)
    coarsest: int = -1
    finest: int = 1
    gain: float = 0.01
    floor: float = 0.05
    zone: float = 5e-4
    add: float = 1e-3
    remove: float = 2e-4
    dwell: float = 3.0
    soft: float = 0.02

    def __post_init__(self) -> None:
        if not 0 <= self.nodes <= 400 or not 0.0 <= self.gain < 2.0 or min(self.scale) <= 0.0:
            raise ConfigError(
                "friction network: 0 to 400 nodes, a gain within 0 and 2, positive scales needed"
            )
        if not self.remove < self.add:
            raise ConfigError(
                f"friction network: remove = {self.remove:g} must be below add = {self.add:g}"
            )
        if self.nodes == 0 and not self.backbone:
            raise ConfigError("friction network: without nodes and backbone nothing is left")

    def record(self, share: float, period: float) -> Any:
        """What the kernels read; `share` of the low-pass a tick."""
        c = np.zeros(1, KNOWN)[0]
        for name in (
            "backbone",
            "scale",
            "coarsest",
            "finest",
            "gain",
            "floor",
            "zone",
            "add",
            "remove",
            "soft",
        ):
            c[name] = getattr(self, name)
        c["share"], c["dwell"], c["slow"] = share, self.dwell / period, period / self.dwell
        return c


_F = np.float64
KNOWN = np.dtype(
    [
        ("scale", _F, (3,)),
        *(
            (n, _F)
            for n in (
                "backbone",
                "coarsest",
                "finest",
                "gain",
                "floor",
                "zone",
                "add",
                "remove",
                "soft",
                "share",
                "dwell",
                "slow",
            )
        ),
    ]
)


@dataclass(frozen=True)
class NetworkConfig:
    """Parameters of the estimator.

    Parameters
    ----------
    corner_hz : float
        Low-pass of the observer.
    model : tuple of 8 floats
        Rigid-body parameters pi of the arm with its sensor.
    learn_until : float
        Time after which nothing is learnt any more [s].
    touch : float
        Measured force above which, and for half a second after, nothing is learnt [N].
    network : table
        See `WaveletConfig`.
    lengths : tuple of 2 floats
        l1, l2 [m].
    """

    corner_hz: float = 10.0
    model: tuple[float, ...] = PREMIUM
    learn_until: float = float("inf")
    touch: float = 0.3
    network: WaveletConfig = WaveletConfig()
    lengths: tuple[float, float] = dynamics.LINK_LENGTHS

    def __post_init__(self) -> None:
        if len(self.model) != 8 or self.corner_hz <= 0.0 or self.touch <= 0.0:
            raise ConfigError(
                "friction network: model needs 8 numbers; corner_hz and touch must be positive"
            )


@nb.njit(cache=True, nogil=True)
def untouched(phase: int, force: Any, c: Any, past: Any, now: Any, at: int) -> bool:
    """Whether nothing has touched the tip for half a second; memory: time, last touch."""
    now[at] = past[at] + c.period if phase > 0 else 0.0
    size = force[0] ** 2 + force[1] ** 2 + force[2] ** 2
    now[at + 1] = now[at] if size > c.touch * c.touch else past[at + 1]
    return bool(now[at] - now[at + 1] > 0.5 and now[at] < c.until)


@nb.njit(cache=True, nogil=True)
def _estimate(
    phase: int, u: Any, sent: Any, c: Any, n: Any, psi: Any, w: Any, past: Any, now: Any, out: Any
) -> None:
    """One period; see `NetworkForces.update`."""
    q, v = u[:3], u[3:6]
    free = untouched(phase, u[6:9], c, past, now, 3)
    m = now[_FIRST:]
    m[:] = past[_FIRST:]
    if phase == 0:
        wavelets.clear(m)
    w.goal[:] = 0.0
    dynamics.advance(
        phase == 2,
        q,
        v,
        sent,
        w.goal,
        c.model,
        c.gain,
        c.period,
        past,
        now,
        w.room,
        w.impulse,
        w.flow,
        w.r,
    )
    wavelets.predict_network(v, n, m, psi, w.rub, w.seen)
    if free:
        for j in range(3):
            w.goal[j] = -w.r[j]
        wavelets.learn_weights(w.goal, w.seen, n, m)
        if m.size > wavelets.HEAD_NUMBERS:
            wavelets.adapt_structure(v, n, m)
    dynamics.jacobian(q, c.lengths, w.jacobian)
    for j in range(3):
        w.r[j] += w.seen[j]
        out[3 + j], out[6 + j] = w.r[j], w.rub[j]
    dynamics.solve_transposed(w.jacobian, w.r, w.square, out)
    out[9], out[10] = free, count(m)


@nb.njit(cache=True, nogil=True)
def count(m: Any) -> float:
    """Wavelets in use."""
    used = 0.0
    for at in range(wavelets.HEAD_NUMBERS, m.size, wavelets.NODE):
        used += m[at] != wavelets.NONE
    return used


_KNOWN = np.dtype(
    [
        ("model", _F, (8,)),
        ("lengths", _F, (2,)),
        ("gain", _F),
        ("period", _F),
        ("until", _F),
        ("touch", _F),
    ]
)
_WORK = np.dtype(
    [
        ("rub", _F, (3,)),
        ("seen", _F, (3,)),
        ("goal", _F, (3,)),
        ("flow", _F, (3,)),
        ("impulse", _F, (3,)),
        ("r", _F, (3,)),
        ("room", _F, (6, 3)),
        ("jacobian", _F, (3, 3)),
        ("square", _F, (3, 3)),
    ]
)


class NetworkForces:
    """The estimator of one arm; see `hil.signals.device.Estimator`.

    Parameters
    ----------
    config : NetworkConfig
        Parameters.
    period : float
        Of the loop [s].
    """

    names, units, force, message = NETWORK_COLUMNS, _UNITS, 0, "FrictionNetworkEstimate"

    def __init__(self, config: NetworkConfig, period: float) -> None:
        self.corner_hz = config.corner_hz
        self.memory = _FIRST + wavelets.memory_size(config.network.nodes)
        gain = 2 * np.pi * config.corner_hz
        self._c, self._w = np.zeros(1, _KNOWN)[0], np.zeros(1, _WORK)[0]
        self._c["model"], self._c["lengths"] = config.model, config.lengths
        self._c["gain"], self._c["period"] = gain, period
        self._c["until"], self._c["touch"] = config.learn_until, config.touch
        self._n = config.network.record(gain * period / (1 + gain * period), period)
        self._psi = np.zeros(6 + config.network.nodes)

    def update(
        self,
        phase: int,
        past: FloatArray,
        u: FloatArray,
        sent: FloatArray,
        now: FloatArray,
        out: FloatArray,
    ) -> None:
        """One period; see `hil.signals.device.Estimator`."""
        _estimate(phase, u, sent, self._c, self._n, self._psi, self._w, past, now, out)


Config = NetworkConfig
build = NetworkForces
