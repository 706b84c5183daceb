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
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

N, _POINTS = 10, 21
#: Columns of the point arrays: a multiple of the register width; those beyond POINTS are idle.
_WIDE = 24
#: Rational tanh for wide registers, |error| < 3e-7 (coefficients as in Eigen's ptanh).
_TOP, _EDGE = (
    (
        4.89352455891786e-03,
        6.37261928875436e-04,
        1.48572235717979e-05,
        5.12229709037114e-08,
        -8.60467152213735e-11,
        2.00018790482477e-13,
        -2.76076847742355e-16,
    ),
    7.90531110763549805,
)
_BELOW = (4.89352518554385e-03, 2.26843463243900e-03, 1.18534705686654e-04, 1.19825839466702e-06)
_FAST = {"contract", "reassoc", "nsz", "arcp"}


@nb.njit(cache=True, nogil=True, fastmath=_FAST, inline="always")
def tanh(x: float) -> float:
    """Rational approximation of tanh, straight code for wide registers."""
    x = x if x < _EDGE else _EDGE
    x = x if x > -_EDGE else -_EDGE
    z = x * x
    top = ((_TOP[6] * z + _TOP[5]) * z + _TOP[4]) * z + _TOP[3]
    top = ((top * z + _TOP[2]) * z + _TOP[1]) * z + _TOP[0]
    below = ((_BELOW[3] * z + _BELOW[2]) * z + _BELOW[1]) * z + _BELOW[0]
    return x * top / below


@nb.njit(cache=True, nogil=True, fastmath=_FAST, inline="always")
def exp(x: float) -> float:
    """Exp of a small number (|x| < 2 to 2e-7) by its series of x/8, squared three times."""
    y = x * 0.125
    e = 1.0 + y * (1.0 + y * (0.5 + y * (1 / 6 + y * (1 / 24 + y * (1 / 120 + y * (1 / 720))))))
    e = e * e
    e = e * e
    return e * e


@nb.njit(cache=True, nogil=True, fastmath=_FAST, inline="always")
def _rates(a: float, b: float, q: float, v: float, u: float, p: Any, s: int, c: Any) -> Any:
    """Accelerations of motor and link; c[3] is a known torque on the link [N m]."""
    d = a - q
    cable = p[0, s] * d + p[1, s] * d * d * d
    motor = (u - p[2, s] * tanh(b * c[2]) - p[3, s] * b - cable) * c[0]
    link = (cable + c[3] - p[4, s] * tanh(v * c[2]) - p[5, s] * v) * c[1]
    return motor, link


@nb.njit(cache=True, nogil=True, fastmath=_FAST)
def _propagate(x: Any, p: Any, u: float, h: float, c: Any) -> None:
    """One Runge-Kutta step of all sigma points in place.

    Parameters
    ----------
    x : ndarray (4 or more, WIDE)
        q_m, q_m', q, q' of the points in the first four rows.
    p : ndarray (6, WIDE)
        Parameters of the points.
    u, h : float
        Motor torque [N m], step [s].
    c : ndarray (4,)
        1/Jm, 1/Jl, 1/v0, known torque ON the link [N m].
    """
    c = (c[0], c[1], c[2], c[3])
    for s in range(_WIDE):
        a, b, q, v = x[0, s], x[1, s], x[2, s], x[3, s]
        m1, l1 = _rates(a, b, q, v, u, p, s, c)
        b2, v2 = b + 0.5 * h * m1, v + 0.5 * h * l1
        m2, l2 = _rates(a + 0.5 * h * b, b2, q + 0.5 * h * v, v2, u, p, s, c)
        b3, v3 = b + 0.5 * h * m2, v + 0.5 * h * l2
        m3, l3 = _rates(a + 0.5 * h * b2, b3, q + 0.5 * h * v2, v3, u, p, s, c)
        b4, v4 = b + h * m3, v + h * l3
        m4, l4 = _rates(a + h * b3, b4, q + h * v3, v4, u, p, s, c)
        x[0, s] = a + h / 6 * (b + 2 * b2 + 2 * b3 + b4)
        x[1, s] = b + h / 6 * (m1 + 2 * m2 + 2 * m3 + m4)
        x[2, s] = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
        x[3, s] = v + h / 6 * (l1 + 2 * l2 + 2 * l3 + l4)


@nb.njit(cache=True, nogil=True, fastmath=_FAST)
def _cholesky(p: Any, scale: float, out: Any) -> bool:
    """Lower factor of scale * p into `out` (n, n); False where p is not positive."""
    n = p.shape[0]
    for j in range(n):
        d = scale * p[j, j]
        for k in range(j):
            d -= out[j, k] * out[j, k]
        if not d > 0.0:
            return False
        root = np.sqrt(d)
        out[j, j] = root
        over = 1.0 / root
        for i in range(j + 1, n):
            s = scale * p[i, j]
            for k in range(j):
                s -= out[i, k] * out[j, k]
            out[i, j] = s * over
    return True


@nb.njit(cache=True, nogil=True, fastmath=_FAST)
def _draw(x: Any, low: Any, points: Any, pars: Any) -> None:
    """Sigma points x, x + L_i, x - L_i: states (10, 21), parameters (6, 21) as they act."""
    n = x.size
    for r in range(n):
        points[r, 0] = x[r]
        for i in range(n):
            step = low[r, i] if i <= r else 0.0
            points[r, 1 + i] = x[r] + step
            points[r, 1 + n + i] = x[r] - step
    for r in range(6):
        base = np.exp(x[4 + r])
        pars[r, 0] = base
        for i in range(n):
            grow = exp(low[4 + r, i] if i <= 4 + r else 0.0)
            pars[r, 1 + i] = base * grow
            pars[r, 1 + n + i] = base / grow


@nb.njit(cache=True, nogil=True, fastmath=_FAST)
def _moments(points: Any, w: Any, noise: Any, x: Any, p: Any) -> None:
    """Mean into x (n,), covariance plus noise into p (n, n); `points` become deviations.

    Only the states moved: the parameters' rows are still x and its steps.
    """
    n, m = points.shape[0], _POINTS
    for r in range(4):
        mean = w[1] * points[r, 0]
        for s in range(1, m):
            mean += w[3] * points[r, s]
        x[r] = mean
    for r in range(n):
        for s in range(m):
            points[r, s] -= x[r]
    for r in range(n):
        # parameters: P stays as it was, but for noise
        for t in range(min(r + 1, 4)):
            total = w[2] * points[r, 0] * points[t, 0]
            for s in range(1, m):
                total += w[3] * points[r, s] * points[t, s]
            p[r, t] = total
            p[t, r] = total
        p[r, r] += noise[r]


@nb.njit(cache=True, nogil=True, fastmath=_FAST)
def correct(x: Any, p: Any, y: float, variance: float, gain: Any) -> float:
    """Measurement update with y = x_0; returns the innovation."""
    n = x.size
    innovation = y - x[0]
    over = 1.0 / (p[0, 0] + variance)
    for r in range(n):
        gain[r] = p[r, 0] * over
    for r in range(n):
        x[r] += gain[r] * innovation
    top = p[0, 0] + variance
    for r in range(n):
        for t in range(r + 1):
            p[r, t] -= gain[r] * gain[t] * top
            p[t, r] = p[r, t]
    return float(innovation)


@nb.njit(cache=True, nogil=True)
def foresee(f: Any, u: float, h: float, parts: int) -> bool:
    """Predict one period with u = tau [N m]; False once the covariance has lost its sign.

    `parts` Runge-Kutta steps a period: friction turns over within soft J / Fc seconds.
    """
    if not _cholesky(f.p, f.w[0], f.low):
        return False
    _draw(f.x, f.low, f.points, f.pars)
    for _ in range(parts):
        _propagate(f.points, f.pars, u, h / parts, f.c)
    _moments(f.points, f.w, f.noise, f.x, f.p)
    return True


@nb.njit(cache=True, nogil=True)
def _step(f: Any, y: float, u: float, h: float) -> float:
    """One period: correct with y = q_m [rad], then predict with u = tau [N m].

    Without a measurement, y not a number, it predicts only.

    Returns
    -------
    float
        Innovation [rad]; not a number without a measurement, or once the covariance has lost its
        sign.
    """
    innovation = np.nan if np.isnan(y) else correct(f.x, f.p, y, f.variance, f.gain)
    for r in range(f.x.size):
        f.now[r] = f.x[r]
    return innovation if foresee(f, u, h, 1) else np.nan


@nb.njit(cache=True, nogil=True)
def run(f: Any, y: Any, u: Any, h: float, out: Any, innovation: Any) -> None:
    """Filter a record: y (n,) [rad], u (n,) [N m] into out (n, 10), innovation (n,) [rad]."""
    for k in range(y.size):
        innovation[k] = _step(f, y[k], u[k], h)
        for r in range(f.now.size):
            out[k, r] = f.now[r]


FloatArray = NDArray[np.float64]
ELASTIC_PARAMETERS = ("k1", "k3", "fcm", "fvm", "fcl", "fvl")


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
        Variance of the log parameters at the start, positive.
    soft : float
        v0 of the friction's sign [rad/s].
    alpha, beta, kappa : float
        Scaling of the sigma points: alpha positive, kappa above -10, beta any number.

    Raises
    ------
    ConfigError
        For a number that is none, or out of its range.
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
        # comparisons that no NaN passes
        if len(self.start) != 6 or not all(0.0 < x < np.inf for x in self.start):
            raise ConfigError("UKF: start needs six positive numbers: k1, k3, Fcm, Fvm, Fcl, Fvl")
        if len(self.noise) != 5 or not all(0.0 <= x < np.inf for x in self.noise):
            raise ConfigError("UKF: noise needs five numbers that are not negative")
        for name in ("motor_inertia", "link_inertia", "resolution", "spread", "soft", "alpha"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigError(
                    f"UKF: {name} = {getattr(self, name)}; inertias, resolution, spread, soft and "
                    "alpha must be positive"
                )
        if not -N < self.kappa < np.inf or not np.isfinite(self.beta):
            raise ConfigError(
                f"UKF: kappa = {self.kappa}, beta = {self.beta}; kappa must be above -{N}, for "
                f"there are {N} states, and beta a number"
            )

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
UKF_DTYPE = np.dtype([
    ("x", _F, (N,)), ("now", _F, (N,)), ("p", _F, (N, N)), ("low", _F, (N, N)),
    ("points", _F, (N, _WIDE)), ("pars", _F, (6, _WIDE)), ("gain", _F, (N,)),
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
        self._f = np.zeros(1, UKF_DTYPE)[0]
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
        return dict(zip(ELASTIC_PARAMETERS, np.exp(self._f["now"][4:]).tolist(), strict=True))

    def step(self, y: float, u: float, period: float) -> float:
        """One period; see `_step`.  Without a measurement, y not a number, it predicts only."""
        return float(_step(self._f, y, u, period))

    def run(self, y: FloatArray, u: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
        """Filter a record.

        Parameters
        ----------
        y, u : ndarray (n,)
            Motor angle [rad], motor torque [N m], both on the link's side.  Where y is not a
            number there was no measurement, and the filter predicts only.
        period : float
            [s].

        Returns
        -------
        states : ndarray (n, 10)
            Corrected states.
        innovation : ndarray (n,)
            [rad]; not a number where there was no measurement.

        Raises
        ------
        ConfigError
            If y and u are not of one length, a torque is not a number, or a value is infinite.
        """
        y, u = (np.ascontiguousarray(x, dtype=np.float64) for x in (y, u))
        _refuse_record(y, u, period)
        out, innovation = np.zeros((y.size, N)), np.zeros(y.size)
        run(self._f, y, u, period, out, innovation)
        return out, innovation


def _refuse_record(y: FloatArray, u: FloatArray, period: float) -> None:
    """Refuse what the kernel would read beyond, or carry on into every later sample."""
    if y.ndim != 1 or y.shape != u.shape:
        raise ConfigError(
            f"UKF: y has the shape {y.shape}, u {u.shape}; expected one motor angle [rad] and one "
            "torque [N m] a sample, both (n,)"
        )
    bad = np.flatnonzero(~np.isfinite(u) | np.isinf(y))
    if bad.size:
        k = int(bad[0])
        raise ConfigError(
            f"UKF: sample {k} of {y.size} has y = {y[k]}, u = {u[k]}; a torque must be a number "
            "(fill it in, or filter the parts apart), an angle a number or NaN for none"
        )
    if not 0.0 < period < np.inf:
        raise ConfigError(f"UKF: period = {period} s; it must be positive")
