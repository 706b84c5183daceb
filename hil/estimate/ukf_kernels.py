"""Kernels of the elastic-transmission filter: sigma points, Runge-Kutta step, moments, update."""

from __future__ import annotations

from typing import Any

import numba as nb
import numpy as np

N, POINTS = 10, 21
#: Columns of the point arrays: a multiple of the register width; those beyond POINTS are idle.
WIDE = 24
#: Rational tanh for wide registers, |error| < 3e-7 (coefficients as in Eigen's ptanh).
_TOP, _EDGE = (
    4.89352455891786e-03, 6.37261928875436e-04, 1.48572235717979e-05, 5.12229709037114e-08,
    -8.60467152213735e-11, 2.00018790482477e-13, -2.76076847742355e-16,
), 7.90531110763549805  # fmt: skip
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
def propagate(x: Any, p: Any, u: float, h: float, c: Any) -> None:
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
    for s in range(WIDE):
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
def cholesky(p: Any, scale: float, out: Any) -> bool:
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
def draw(x: Any, low: Any, points: Any, pars: Any) -> None:
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
def moments(points: Any, w: Any, noise: Any, x: Any, p: Any) -> None:
    """Mean into x (n,), covariance plus noise into p (n, n); `points` become deviations.

    Only the states moved: the parameters' rows are still x and its steps.
    """
    n, m = points.shape[0], POINTS
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
    if not cholesky(f.p, f.w[0], f.low):
        return False
    draw(f.x, f.low, f.points, f.pars)
    for _ in range(parts):
        propagate(f.points, f.pars, u, h / parts, f.c)
    moments(f.points, f.w, f.noise, f.x, f.p)
    return True


@nb.njit(cache=True, nogil=True)
def step(f: Any, y: float, u: float, h: float) -> float:
    """One period: correct with y = q_m [rad], then predict with u = tau [N m].

    Returns
    -------
    float
        Innovation [rad]; not a number once the covariance has lost its sign.
    """
    innovation = correct(f.x, f.p, y, f.variance, f.gain)
    for r in range(f.x.size):
        f.now[r] = f.x[r]
    return innovation if foresee(f, u, h, 1) else np.nan


@nb.njit(cache=True, nogil=True)
def run(f: Any, y: Any, u: Any, h: float, out: Any, innovation: Any) -> None:
    """Filter a record: y (n,) [rad], u (n,) [N m] into out (n, 10), innovation (n,) [rad]."""
    for k in range(y.size):
        innovation[k] = step(f, y[k], u[k], h)
        for r in range(f.now.size):
            out[k, r] = f.now[r]
