"""A periodic joint motion: a path through via points plus a Fourier series."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """Motion of d joints that repeats after `period`.

    q(t) = path(t) + sum_k S_k sin(k w t) + C_k cos(k w t),  w = 2 pi / period.

    Parameters
    ----------
    joints, units : tuple of str
        Names and ``"rad"`` or ``"m"``, length d.
    period : float
        [s]
    times : ndarray (m,)
        Of the via points, from 0 to the period [s].
    via : ndarray (m, d)
        Positions there; the last is the first [rad or m].
    blend : ndarray (m,)
        Time over which the speed changes around each via point [s].
    series : ndarray (d, h, 2)
        Factors of sin(k w t) and cos(k w t), k = 1..h [rad or m].
    name : str
        Of the motion.
    purpose : tuple of str
        Effects that it is for.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    period: float
    times: FloatArray
    via: FloatArray
    blend: FloatArray
    series: FloatArray
    name: str = "motion"
    purpose: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        for text in _faults(self):
            raise ConfigError(text)

    @property
    def d(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def shrunk(self, factor: float, center: FloatArray) -> Trajectory:
        """The same motion, smaller by `factor` about a posture (d,)."""
        return replace(self, via=center + factor * (self.via - center), series=factor * self.series)


def sample(x: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, speed and acceleration (n, d) at times t (n,) [s]."""
    t = np.mod(t, x.period)
    q, qd, qdd = _path(x, t)
    for total, part in zip((q, qd, qdd), _series(x, t), strict=True):
        total += part
    return q, qd, qdd


def _series(x: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fourier series and its two derivatives (n, d); by FFT on a grid over one period."""
    w, h = 2 * np.pi / x.period, x.series.shape[1]
    k = np.arange(1, h + 1)
    even = t.size > 2 * h and np.allclose(t, np.arange(t.size) * (x.period / t.size), atol=1e-9)
    if even:
        spectrum = np.zeros((3, t.size // 2 + 1, x.d), dtype=np.complex128)
        part = (x.series[..., 1] - 1j * x.series[..., 0]).T * (t.size / 2)
        for order in range(3):
            spectrum[order, 1 : h + 1] = part * (1j * w * k[:, None]) ** order
        out = np.asarray(np.fft.irfft(spectrum, n=t.size, axis=1), dtype=np.float64)
        return out[0], out[1], out[2]
    angle = w * np.outer(t, k)
    s, c = np.sin(angle), np.cos(angle)
    a, b, kw = x.series[..., 0].T, x.series[..., 1].T, w * k[:, None]
    return s @ a + c @ b, c @ (kw * a) - s @ (kw * b), -s @ (kw**2 * a) - c @ (kw**2 * b)


def _path(x: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Straight lines through the via points, each corner rounded over its blend time.

    A corner where the speed changes by dv adds dv r(t - tk), with u = (t - tk) / b + 1/2:
    r'' = (1 - cos 2 pi u) / b,  r' = u - sin(2 pi u) / 2 pi,
    r = b (u^2 / 2 - (1 - cos 2 pi u) / 4 pi^2)  for 0 < u < 1.
    """
    slope = np.diff(x.via, axis=0) / np.diff(x.times)[:, None]
    piece = np.clip(np.searchsorted(x.times, t, side="right") - 1, 0, len(slope) - 1)
    q = x.via[piece] + (t - x.times[piece])[:, None] * slope[piece]
    qd, qdd = slope[piece].copy(), np.zeros_like(q)
    before = np.concatenate([slope[-1:], slope])
    after = np.concatenate([slope, slope[:1]])
    ordered = bool(np.all(np.diff(t) >= 0))
    for k, (tk, b) in enumerate(zip(x.times, x.blend, strict=True)):
        low, high = np.searchsorted(t, [tk - b / 2, tk + b / 2]) if ordered else (0, t.size)
        part = t[low:high] - tk
        u = part / b + 0.5
        inside = (u > 0) & (u < 1)
        dv = (after[k] - before[k]) * inside[:, None]
        turn = 2 * np.pi * u
        # what the sharp corner max(0, t - tk) has already
        sharp = np.maximum(part, 0.0)
        r = b * (u**2 / 2 - (1 - np.cos(turn)) / (4 * np.pi**2)) - sharp
        q[low:high] += dv * r[:, None]
        qd[low:high] += dv * (u - np.sin(turn) / (2 * np.pi) - (part >= 0))[:, None]
        qdd[low:high] += dv * ((1 - np.cos(turn)) / b)[:, None]
    return q, qd, qdd


def grid(x: Trajectory, rate: float) -> FloatArray:
    """Times over one period at about `rate` [s]."""
    n = max(2, round(x.period * rate))
    out: FloatArray = np.arange(n, dtype=np.float64) * (x.period / n)
    return out


def _faults(x: Trajectory) -> list[str]:
    """What is wrong with a trajectory, one sentence each; empty if nothing is."""
    d, m = len(x.joints), x.times.size
    if d == 0 or len(x.units) != d or any(u not in ("rad", "m") for u in x.units):
        return ["joints and units need one entry a joint, units 'rad' or 'm'"]
    if not 0.01 <= x.period <= 3600:
        return [f"period = {x.period:g} s; 0.01 to 3600 s is needed"]
    if m < 2 or x.via.shape != (m, d) or x.blend.shape != (m,):
        return [f"path: t, blend and q need as many entries, two at least, q {d} in each"]
    if x.series.ndim != 3 or x.series.shape[0] != d or x.series.shape[2] != 2:
        return [f"fourier: sin and cos need {d} rows, one a joint, all of one length"]
    arrays = (x.times, x.via, x.blend, x.series)
    if not all(np.all(np.isfinite(a)) for a in arrays):
        return ["a number of the trajectory is not finite"]
    gaps = np.diff(x.times)
    if x.times[0] != 0 or abs(x.times[-1] - x.period) > 1e-9 * x.period or np.any(gaps <= 0):
        return ["path: t must increase from 0 to the period"]
    if np.any(np.abs(x.via[-1] - x.via[0]) > 1e-9):
        return ["path: the last point must be the first one, for the motion repeats"]
    return _blends(x, gaps)


def _blends(x: Trajectory, gaps: FloatArray) -> list[str]:
    half = x.blend / 2
    if np.any(x.blend <= 0) or np.any(half[:-1] + half[1:] > gaps * (1 + 1e-9)):
        return ["path: each blend must be positive, and two neighbours end before they meet"]
    if x.blend[0] != x.blend[-1]:
        return ["path: the first and the last blend are of one corner and must agree"]
    return []
