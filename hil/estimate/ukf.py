"""States and parameters of an elastic transmission from motor angle and torque alone, compiled.

    Jm q_m'' = tau - Fcm sgn~(q_m') - Fvm q_m' - k1 D - k3 D^3,   D = q_m - q
    Jl q''   = k1 D + k3 D^3 - Fcl sgn~(q') - Fvl q',             sgn~(v) = tanh(v / v0)

State x = [q_m, q_m', q, q', log k1, log k3, log Fcm, log Fvm, log Fcl, log Fvl]; y = q_m (thesis
section 3.1 and figure 3.3; the cubic spring is an assumption).  Unscented transform with
lam = alpha^2 (n + kappa) - n (Wan & van der Merwe 2000); one Runge-Kutta step a period.  The
measurement is linear, so its sigma points need not be drawn: P_yy = P_00 + R, P_xy = P e_0.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.estimate.ukf_kernels import WIDE, N, run, step

FloatArray = NDArray[np.float64]
NAMES = ("k1", "k3", "fcm", "fvm", "fcl", "fvl")


@dataclass(frozen=True)
class UkfConfig:
    """Known masses, starting values and noise.

    Parameters
    ----------
    motor_inertia, link_inertia : float
        Jm, Jl, both reflected to the link [kg m^2].
    start : tuple of 6 floats
        First guess of k1 [N m/rad], k3 [N m/rad^3], Fcm [N m], Fvm [N m s/rad], Fcl, Fvl.
    resolution : float
        Encoder count [rad]; measurement variance resolution^2 / 12.
    noise : tuple of 5 floats
        Variances added per step: q_m, q_m', q, q', log parameters.
    spread : float
        Variance of the log parameters at the start.
    soft : float
        v0 of the friction's sign [rad/s].
    alpha, beta, kappa : float
        Scaling of the sigma points.
    """

    motor_inertia: float = 2e-4
    link_inertia: float = 1e-3
    start: tuple[float, ...] = (30.0, 3.6e5, 0.02, 9e-4, 0.006, 1.6e-3)
    resolution: float = 2 * np.pi / 20000
    noise: tuple[float, ...] = (1e-12, 1e-4, 1e-12, 1e-4, 1e-9)
    spread: float = 0.25
    soft: float = 0.05
    alpha: float = 0.5
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        if len(self.start) != 6 or min(self.start) <= 0.0:
            raise ConfigError("UKF: start needs six positive numbers: k1, k3, Fcm, Fvm, Fcl, Fvl")
        if len(self.noise) != 5 or min(self.noise) < 0.0:
            raise ConfigError("UKF: noise needs five numbers that are not negative")
        if min(self.motor_inertia, self.link_inertia, self.resolution, self.soft) <= 0.0:
            raise ConfigError("UKF: inertias, resolution and soft must be positive")

    def weights(self) -> FloatArray:
        """Lam + n, Wm0, Wc0, Wi, shape (4,)."""
        lam = self.alpha**2 * (N + self.kappa) - N
        w0 = lam / (N + lam)
        rest = 1 - self.alpha**2 + self.beta
        return np.array([N + lam, w0, w0 + rest, 0.5 / (N + lam)])

    def variances(self) -> FloatArray:
        """Process noise per state, shape (10,)."""
        return np.array([*self.noise[:4], *[self.noise[4]] * 6])


_F = np.float64
#: What the kernels of one filter work on.
RECORD = np.dtype([
    ("x", _F, (N,)), ("now", _F, (N,)), ("p", _F, (N, N)), ("low", _F, (N, N)),
    ("points", _F, (N, WIDE)), ("pars", _F, (6, WIDE)), ("gain", _F, (N,)),
    ("noise", _F, (N,)), ("w", _F, (4,)), ("c", _F, (4,)), ("variance", _F),
])  # fmt: skip


@dataclass
class ElasticUkf:
    """The filter with its state.

    Parameters
    ----------
    config : UkfConfig
        What is known.
    position : float
        Motor angle at the start [rad].
    """

    config: UkfConfig = field(default_factory=UkfConfig)
    position: float = 0.0

    def __post_init__(self) -> None:
        c = self.config
        self._f = np.zeros(1, RECORD)[0]
        self._f["x"][:4] = self.position, 0.0, self.position, 0.0
        self._f["x"][4:] = np.log(c.start)
        self._f["p"][:] = np.diag([1e-6, 1e-2, 1e-6, 1e-2, *[c.spread] * 6])
        self._f["noise"], self._f["w"] = c.variances(), c.weights()
        self._f["c"] = 1 / c.motor_inertia, 1 / c.link_inertia, 1 / c.soft, 0.0
        self._f["variance"] = c.resolution**2 / 12

    @property
    def state(self) -> FloatArray:
        """Corrected state, (10,); parameters as logarithms."""
        return np.array(self._f["now"])

    @property
    def covariance(self) -> FloatArray:
        """Predicted covariance, (10, 10)."""
        return np.array(self._f["p"])

    @property
    def parameters(self) -> dict[str, float]:
        """k1, k3, fcm, fvm, fcl, fvl in SI units."""
        return dict(zip(NAMES, np.exp(self._f["now"][4:]).tolist(), strict=True))

    def step(self, y: float, u: float, period: float) -> float:
        """One period; see `step`."""
        return float(step(self._f, y, u, period))

    def run(self, y: FloatArray, u: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
        """Filter a record.

        Parameters
        ----------
        y, u : ndarray (n,)
            Motor angle [rad], motor torque [N m], both on the link's side.
        period : float
            [s].

        Returns
        -------
        states : ndarray (n, 10)
            Corrected states.
        innovation : ndarray (n,)
            [rad].
        """
        out, innovation = np.zeros((y.size, N)), np.zeros(y.size)
        run(self._f, np.ascontiguousarray(y), np.ascontiguousarray(u), period, out, innovation)
        return out, innovation
