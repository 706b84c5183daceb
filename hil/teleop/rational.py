"""Rational functions of s with real coefficients: the four operations, values, poles, zeros.

And loops of two of them with one delay: which delays they bear, and their poles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from hil.errors import ConfigError

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: Two roots nearer than this, relative to their size, are the same root.
_SAME = 1e-6


def _sum(p: FloatArray, q: FloatArray) -> FloatArray:
    """Sum of two polynomials."""
    out = np.zeros(max(p.size, q.size))
    out[out.size - p.size :] += p
    out[out.size - q.size :] += q
    return out


def _trim(p: FloatArray) -> FloatArray:
    """Polynomial without leading zeros; never empty."""
    at = 0
    while at < p.size - 1 and p[at] == 0.0:
        at += 1
    return p[at:]


@dataclass(frozen=True, eq=False)
class Rational:
    """num(s) / den(s), coefficients from the highest power down.

    Parameters
    ----------
    num, den : ndarray (k,), (l,)
        Real coefficients.
    """

    num: FloatArray
    den: FloatArray

    @staticmethod
    def of(num: Any, den: Any = (1.0,)) -> Rational:
        """Ratio of two polynomials; common factors s are cancelled."""
        n, d = _trim(np.atleast_1d(np.asarray(num, float))), _trim(np.asarray(den, float))
        while n.size > 1 and d.size > 1 and n[-1] == 0.0 and d[-1] == 0.0:
            n, d = n[:-1], d[:-1]
        return Rational(n / d[0], d / d[0])

    @staticmethod
    def s() -> Rational:
        """Return the variable itself."""
        return Rational.of([1.0, 0.0])

    def __add__(self, other: Any) -> Rational:
        o = _lift(other)
        if self.den.shape == o.den.shape and np.array_equal(self.den, o.den):
            return Rational.of(_sum(self.num, o.num), self.den)
        top = _sum(np.convolve(self.num, o.den), np.convolve(o.num, self.den))
        return Rational.of(top, np.convolve(self.den, o.den))

    def __mul__(self, other: Any) -> Rational:
        o = _lift(other)
        return Rational.of(np.convolve(self.num, o.num), np.convolve(self.den, o.den))

    def __truediv__(self, other: Any) -> Rational:
        o = _lift(other)
        return Rational.of(np.convolve(self.num, o.den), np.convolve(self.den, o.num))

    def __neg__(self) -> Rational:
        return Rational(-self.num, self.den)

    def __sub__(self, other: Any) -> Rational:
        return self.__add__(-_lift(other))

    def __radd__(self, other: Any) -> Rational:
        return self.__add__(other)

    def __rmul__(self, other: Any) -> Rational:
        return self.__mul__(other)

    def __rsub__(self, other: Any) -> Rational:
        return _lift(other).__sub__(self)

    def __rtruediv__(self, other: Any) -> Rational:
        return _lift(other).__truediv__(self)

    def __call__(self, s: Any) -> Any:
        """Value at complex s."""
        return np.polyval(self.num, s) / np.polyval(self.den, s)

    def zeros(self) -> ComplexArray:
        """Zeros [rad/s] that no pole cancels, sorted by their real part from the right."""
        left = list(np.roots(self.den))
        kept = []
        for z in np.roots(self.num):
            near = [p for p in left if abs(p - z) <= _SAME * max(1.0, abs(z))]
            if near:
                left.remove(near[0])
            else:
                kept.append(z)
        return np.array(sorted(kept, key=lambda z: -z.real), np.complex128)


def _lift(x: Any) -> Rational:
    return x if isinstance(x, Rational) else Rational.of([float(x)])


@dataclass(frozen=True, eq=False)
class LateLoop:
    """p(s) - l(s) exp(-s T) = 0, a loop with one delay T, as two polynomials.

    Its roots move over the imaginary axis at frequencies w with abs(p(jw)) = abs(l(jw)) alone, to
    the right where abs(l / p) falls with w, at T = (arg(l / p) + 2 pi n) / w: those at a delay are
    counted from those without one (Walton & Marshall, IEE Proc. D 134(2), 1987).

    Parameters
    ----------
    p, l : ndarray (k,), (m,)
        Real coefficients from the highest power down.
    """

    p: FloatArray
    l: FloatArray  # noqa: E741

    @staticmethod
    def of(ahead: Rational, around: Rational, corners: Sequence[float]) -> LateLoop:
        """Loop ahead - around exp(-s T) without the factors that its denominators cancel.

        Parameters
        ----------
        corners : sequence of float
            Poles of the filters [rad/s], which with 0 are all that a denominator has.
        """
        parts: list[FloatArray] = [
            np.convolve(ahead.num, around.den),
            np.convolve(around.num, ahead.den),
            np.convolve(ahead.den, around.den),
        ]
        for root in (0.0, *(-w for w in corners)):
            while all(_divides(root, x) for x in parts):
                parts = [_quotient(x, root) for x in parts]
        p, around_p = _trim(parts[0]), _trim(parts[1])
        if abs(p[-1] - around_p[-1]) <= _DIVIDES * abs(p[-1]):
            # a place that is free: the root at 0 is one, and no slow crossing
            around_p[-1] = p[-1]
        return LateLoop(p, around_p)

    @property
    def drifts(self) -> bool:
        """Whether 0 is a root at every delay."""
        return bool(self.p[-1] == self.l[-1])

    @property
    def ends_at(self) -> float:
        """Gain abs(l / p) at the highest frequencies: from 1 on no delay at all is borne."""
        if self.l.size != self.p.size:
            return 0.0 if self.l.size < self.p.size else float("inf")
        return float(abs(self.l[0] / self.p[0]))

    @property
    def scale(self) -> float:
        """Mean size of the roots of p [rad/s]."""
        sizes = np.abs(np.roots(self.p))
        some = sizes[sizes > 0.0]
        return float(np.exp(np.log(some).mean())) if some.size else 1.0

    def still(self) -> ComplexArray:
        """Roots without delay."""
        return np.asarray(np.roots(_sum(self.p, -self.l)), np.complex128)

    def crossings(self) -> list[tuple[float, float, int]]:
        """Frequency w [rad/s], angle w T of the first delay [rad], +1 to the right or -1 back."""
        if not self.l.any():
            return []
        edges = self._edges()
        sizes = [self._excess(w) for w in edges]
        out = []
        for low, high, before, after in zip(
            edges[:-1], edges[1:], sizes[:-1], sizes[1:], strict=True
        ):
            if before * after < 0.0:
                w = float(brentq(self._excess, low, high, xtol=1e-13 * low, rtol=1e-13))
                turn = np.angle(np.polyval(self.l, 1j * w) / np.polyval(self.p, 1j * w))
                out.append((w, float(np.mod(turn, 2 * np.pi)), 1 if after > 0.0 else -1))
        return out

    def _excess(self, w: float) -> float:
        """Ln abs(p / l) at j w."""
        top, below = (float(abs(np.polyval(x, 1j * w))) for x in (self.p, self.l))
        return float(np.log(max(top, 1e-300)) - np.log(max(below, 1e-300)))

    def _edges(self) -> FloatArray:
        """Frequencies [rad/s] between any two of which ln abs(p / l) changes its sign once."""
        unit = self.scale
        ahead, around = (_square(_stretched(x, unit)) for x in (self.p, self.l))
        square = _sum(ahead, -around)
        sizes = np.sqrt(np.abs(np.roots(_trim(square))))
        near = np.unique(sizes[sizes > 1e-7]) * unit
        if not near.size:
            return np.array([1e-6, 1e6]) * unit
        return np.concatenate([near[:1] / 10, np.sqrt(near[1:] * near[:-1]), near[-1:] * 10])

    def unstable(self, delay: float) -> float:
        """How many roots are right of the imaginary axis at a delay [s]; may be infinite."""
        if delay > 0.0 and self.ends_at >= 1.0 - _SAME:
            return float("inf")
        count = float(np.sum(self.still().real > _AXIS * self.scale))
        for w, angle, way in self.crossings():
            count += 2 * way * max(np.floor((w * delay - angle) / (2 * np.pi)) + 1, 0.0)
        return count + self._through_zero(delay)

    def _through_zero(self, delay: float) -> float:
        """Real roots that have gone through a free place's root at 0, to the right [1]."""
        if not self.drifts or min(self.p.size, self.l.size) < 2 or self.l[-1] == 0.0:
            return 0.0
        # (p1 - l1 + l0 T) s + (p2 - l2 + l1 T - l0 T^2 / 2) s^2
        p, l = (np.append(np.zeros(3), x)[:-4:-1] for x in (self.p, self.l))  # noqa: E741
        when = (l[1] - p[1]) / l[0]
        beta = p[2] - l[2] + l[1] * when - l[0] * when**2 / 2
        return float(-np.sign(l[0] * beta)) if 0.0 < when <= delay else 0.0

    def margin(self, delay: float) -> float:
        """Longest further delay [s] up to which no root is right of the axis; see `unstable`."""
        if self.drifts or self.ends_at >= 1.0 - _SAME or self.unstable(delay) > 0.0:
            return 0.0
        on = [np.mod(a - w * delay, 2 * np.pi) / w for w, a, way in self.crossings() if way > 0]
        return float(min(on, default=float("inf")))

    def roots(self, delay: float) -> ComplexArray:
        """Roots at a delay [s], the rightmost first; of no end of them those that matter.

        Started from the eigenvalues of the loop with its delay line on Chebyshev nodes (Breda,
        Maset & Vermiglio 2005), each solved with the exact exponential, and counted.

        Raises
        ------
        ConfigError
            Where they cannot be had: no end of them, or another count right of the axis.
        """
        if not self.l.any():
            return _sorted(np.roots(self.p))
        exact = self.unstable(delay)
        if np.isinf(exact):
            raise ConfigError(
                f"the loop has no end of unstable poles with a delay of {1e3 * delay:.3g} ms: its "
                f"gain at the highest frequencies is {self.ends_at:.3g}, below 1 is needed; give "
                "the forces and accelerations filters (force_hz, acceleration_hz)"
            )
        found = self._solved(self._started(delay), delay)
        least, most = (int(np.sum(found.real > x * self.scale)) for x in (_NEAR, -_NEAR))
        if not least <= exact <= most:
            raise ConfigError(
                f"the poles with a delay of {1e3 * delay:.3g} ms are not sure: {least} were found "
                f"right of the axis and {exact:.0f} are there; 'delay_margin' is exact at any "
                "delay, and shorter delays have sure poles"
            )
        return found

    def _started(self, delay: float) -> ComplexArray:
        """Eigenvalues of x' = A x + B y(t - T), y = C x + D y(t - T), the line on nodes."""
        unit, fast = self.scale, max((w for w, _, _ in self.crossings()), default=0.0)
        n = _NODES + int(np.ceil(0.75 * max(fast, self.scale) * delay))
        if n > _MOST_NODES:
            raise ConfigError(
                f"a delay of {1e3 * delay:.3g} ms is too long for the poles of a loop that crosses "
                f"gain 1 at {fast:.3g} rad/s; 'delay_margin' is exact at any delay"
            )
        p, around = _stretched(self.p, unit), _stretched(self.l, unit)
        around, p = around / p[0], p / p[0]
        direct = around[0] if around.size == p.size else 0.0
        row = _sum(around, -direct * p)[-(p.size - 1) :]
        row = np.append(np.zeros(p.size - 1 - row.size), row)
        k = p.size - 1
        slopes = _chebyshev(n) * 2.0 / (delay * unit)
        a = np.zeros((k + n, k + n))
        a[0, :k], a[1:k, : k - 1], a[0, -1] = -p[1:], np.eye(k - 1), 1.0
        a[k:, k:] = slopes[1:, 1:]
        a[k:, :k] = np.outer(slopes[1:, 0], row)
        a[k:, -1] += slopes[1:, 0] * direct
        return np.asarray(np.linalg.eigvals(a) * unit, np.complex128)

    def _solved(self, start: ComplexArray, delay: float) -> ComplexArray:
        """Roots near where they are looked for, by Newton's method; each once."""
        s, dp, dl = start[start.real * delay > -60.0], np.polyder(self.p), np.polyder(self.l)
        near, step = s.copy(), s
        with np.errstate(all="ignore"):  # what does not settle is left out
            for _ in range(40):
                late, around = np.exp(-s * delay), np.polyval(self.l, s)
                slope = np.polyval(dp, s) - (np.polyval(dl, s) - delay * around) * late
                step = (np.polyval(self.p, s) - around * late) / slope
                s = s - step
            size = np.abs(s) + _AXIS * self.scale
            kept = (np.abs(step) < _SAME * size) & (np.abs(s - near) < 0.2 * size + 0.1 / delay)
        out: list[complex] = [0j] if self.drifts else []
        for z in s[kept]:
            if all(abs(z - o) > _SAME * (abs(z) + self.scale) for o in out):
                out.append(z)
        return _sorted(np.array(out))


#: Nodes of a delay line beside those that the fastest crossing asks for, and most that are taken.
_NODES, _MOST_NODES = 40, 600
#: A root is right of the axis from here on, and near it below, in parts of the loop's `scale`.
_AXIS, _NEAR = 1e-9, 1e-6
#: A remainder below this part of a polynomial's size is rounding.
_DIVIDES = 1e-11


def _sorted(roots: Any) -> ComplexArray:
    """Roots from the right."""
    return np.array(sorted(roots, key=lambda z: -z.real), np.complex128)


def _divides(root: float, p: FloatArray) -> bool:
    """Whether a polynomial has a root, up to rounding."""
    size = float(np.polyval(np.abs(p), abs(root)))
    return p.size > 1 and abs(float(np.polyval(p, root))) <= _DIVIDES * size * (root != 0.0)


def _quotient(p: FloatArray, root: float) -> FloatArray:
    """Polynomial p without a root, from both ends to its largest term (Peters & Wilkinson 1971)."""
    n = p.size - 1
    if root == 0.0:
        return p[:-1]
    middle = int(np.argmax(np.abs(p) * abs(root) ** np.arange(n, -1.0, -1.0)))
    out, high, low = np.empty(n), 0.0, 0.0
    for i in range(middle):
        high = out[i] = p[i] + root * high
    for i in range(n, middle, -1):
        low = out[i - 1] = (low - p[i]) / root
    return out


def _stretched(p: FloatArray, unit: float) -> FloatArray:
    """Coefficients of p(unit x)."""
    out: FloatArray = p * unit ** np.arange(p.size - 1.0, -1.0, -1.0)
    return out


def _square(p: FloatArray) -> FloatArray:
    """Coefficients of abs(p(jw))^2 as a polynomial of w^2."""
    powers = np.arange(p.size)[::-1]
    even: FloatArray = np.convolve(p, p * (-1.0) ** powers)[::2]
    out: FloatArray = even * (-1.0) ** np.arange(even.size)[::-1]
    return out


def _chebyshev(n: int) -> FloatArray:
    """Slopes at the nodes cos(pi j / n) of what is known there, (n + 1, n + 1) (Trefethen 2000)."""
    x = np.cos(np.pi * np.arange(n + 1) / n)
    c = np.concatenate([[2.0], np.ones(n - 1), [2.0]]) * (-1.0) ** np.arange(n + 1)
    out: FloatArray = np.outer(c, 1.0 / c) / (x[:, None] - x[None] + np.eye(n + 1))
    return out - np.diag(out.sum(axis=1))
