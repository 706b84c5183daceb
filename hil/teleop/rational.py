"""Rational functions of s with real coefficients: the four operations, values, poles, zeros."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


def pade(delay: float, order: int = 4) -> Rational:
    """All-pass rational stand-in for exp(-s delay) (Pade), for poles only.

    Parameters
    ----------
    delay : float
        [s].
    order : int
        Degree of numerator and denominator; the phase is good to about w delay = 2 order.
    """
    if delay == 0.0:
        return Rational.of([1.0])
    # coefficients (2n-k)! n! / ((2n)! k! (n-k)!) of (+-s T)^k
    c, p = 1.0, [1.0]
    for k in range(1, order + 1):
        c *= (order - k + 1) / (k * (2 * order - k + 1))
        p.append(c * delay**k)
    signs = (-1.0) ** np.arange(order + 1)
    return Rational.of((np.array(p) * signs)[::-1], np.array(p)[::-1])
