"""Features that a person would try on one joint: position, speed, slip, load, the other joints.

A feature is a function of a run's motion and of the effort that the rigid body takes there; it
gives columns (n, k) before the filter.  Its scales are those of the training runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray
from scipy.signal import lfilter

from hil.identify.problem import Problem
from hil.models.motion import Motion
from hil.models.presliding import slip_state

FloatArray = NDArray[np.float64]
#: Motion of a run and rigid-body effort (n, d) to columns (n, k).
Feature = Callable[[Motion, FloatArray], FloatArray]
Named = Iterator[tuple[str, Feature]]
#: A little beyond the range of the training runs polynomials stay where they end.
BEYOND = 1.05


@dataclass(frozen=True)
class Scales:
    """Scales of the training runs.

    Parameters
    ----------
    centre, half : ndarray (d,)
        Middle of each joint's range and half its width [rad or m].
    slow : ndarray (d,)
        Speed below which a sign is soft [rad/s or m/s].
    speed : ndarray (d,)
        Rms speed [rad/s or m/s].
    loaded : bool
        Whether an external effort was measured.
    """

    centre: FloatArray
    half: FloatArray
    slow: FloatArray
    speed: FloatArray
    loaded: bool

    @classmethod
    def of(cls, train: Problem) -> Scales:
        """Scales of the runs of a problem."""
        span, speeds = train.span, np.concatenate([m.qd for m in train.motions])
        return cls(
            centre=span.mean(axis=1),
            half=np.maximum(np.ptp(span, axis=1) / 2, 1e-9),
            slow=train.motions[0].v0,
            speed=np.sqrt(np.mean(speeds**2, axis=0)),
            loaded=any(bool(np.any(m.tau_ext)) for m in train.motions),
        )

    def place(self, m: Motion, j: int) -> FloatArray:
        """Position of joint j, -1 to 1 over its range (n,)."""
        x: FloatArray = np.clip((m.q[:, j] - self.centre[j]) / self.half[j], -BEYOND, BEYOND)
        return x

    def sign(self, m: Motion, j: int) -> FloatArray:
        """Soft sign of joint j's speed (n,)."""
        return np.asarray(np.tanh(m.qd[:, j] / self.slow[j]))

    def slip(self, m: Motion, j: int, share: float) -> FloatArray:
        """State of a spring that slips after a share of joint j's range (n,)."""
        width = share * 2 * float(self.half[j])
        return np.asarray(slip_state(np.ascontiguousarray(m.q[:, j]), width))

    def power(self, m: Motion, j: int, degree: int) -> FloatArray:
        """Chebyshev polynomials 1 to `degree` of joint j's position (n, degree)."""
        return np.asarray(chebvander(self.place(m, j), degree)[:, 1:])


def motor(s: Scales, j: int) -> dict[str, Feature]:
    """Features of the motor's effort on joint j, by name, in the order in which they are tried."""
    parts = (_place(s, j), _slip(s, j), _speed(s, j), _stop(s, j), _load(s, j), _others(s, j))
    return {name: feature for part in parts for name, feature in part}


def external(s: Scales, j: int) -> dict[str, Feature]:
    """Features of what an object does to joint j: of its position and speed alone."""
    parts = (_place(s, j), _slip(s, j), _speed(s, j), _stop(s, j), _object(s, j))
    return {name: feature for part in parts for name, feature in part}


def columns(*parts: FloatArray) -> FloatArray:
    """Columns (n,) each beside each other (n, k)."""
    return np.stack(parts, axis=1)


def _place(s: Scales, j: int) -> Named:
    """What depends on where the joint is: unbalanced mass, cogging, cables, springs."""
    for n in (1, 3, 6):
        yield f"poly{n}", _poly(s, j, n)
    yield "sincos", lambda m, _: columns(np.sin(m.q[:, j]), np.cos(m.q[:, j]))


def _poly(s: Scales, j: int, degree: int) -> Feature:
    return lambda m, _: s.power(m, j, degree)


def _slip(s: Scales, j: int) -> Named:
    """Hysteresis: three springs that slip one after the other, and friction by place."""
    for share in (0.001, 0.003, 0.01, 0.03):
        yield f"slip{share}", _slips(s, j, share)
    yield "dirpoly", lambda m, _: s.sign(m, j)[:, None] * s.power(m, j, 3)
    yield "slip*poly", lambda m, _: s.slip(m, j, 0.01)[:, None] * s.power(m, j, 3)


def _slips(s: Scales, j: int, share: float) -> Feature:
    return lambda m, _: columns(*(s.slip(m, j, k * share) for k in (1, 3, 9)))


def _speed(s: Scales, j: int) -> Named:
    """Curves of friction over speed, by direction and place."""
    for share in (0.03, 0.1, 0.3):
        yield f"stribeck{share}", _stribeck(s, j, share * float(s.speed[j]))
    yield "asym", lambda m, _: columns(np.abs(m.qd[:, j]), np.abs(s.sign(m, j)))
    yield "curve", partial(_curve, s, j)
    yield "viscous(q)", partial(_viscous, s, j)


def _stribeck(s: Scales, j: int, width: float) -> Feature:
    return lambda m, _: columns(np.exp(-((m.qd[:, j] / width) ** 2)) * s.sign(m, j))


def _curve(s: Scales, j: int, m: Motion, _: FloatArray) -> FloatArray:
    v = m.qd[:, j]
    return columns(v * np.abs(v), np.sqrt(np.abs(v)) * s.sign(m, j))


def _viscous(s: Scales, j: int, m: Motion, _: FloatArray) -> FloatArray:
    v, x = m.qd[:, j], s.place(m, j)
    return columns(v * x, v * x**2)


def _stop(s: Scales, j: int) -> Named:
    """Soft stops near the ends of the range."""
    for share in (0.9, 0.95, 0.98):
        yield f"stop{share}", _ends(s, j, share)


def _ends(s: Scales, j: int, share: float) -> Feature:
    def feature(m: Motion, _: FloatArray) -> FloatArray:
        x = s.place(m, j)
        return columns(np.maximum(0, x - share), np.minimum(0, x + share))

    return feature


def _load(s: Scales, j: int) -> Named:
    """Friction that grows with the load, and the ratio of a measured load."""
    if s.loaded:
        yield "extgain", lambda m, _: m.tau_ext[:, j : j + 1]
    yield "load*sgn", lambda m, load: columns(np.abs(load[:, j]) * s.sign(m, j))
    yield "load*slip", partial(_load_slip, s, j)


def _load_slip(s: Scales, j: int, m: Motion, load: FloatArray) -> FloatArray:
    slips = (s.slip(m, j, share) for share in (0.003, 0.01, 0.03))
    return np.abs(load[:, j : j + 1]) * columns(s.sign(m, j), *slips)


def _others(s: Scales, j: int) -> Named:
    """What another joint does to this one: coupled transmissions, cables across it."""
    for i in (i for i in range(s.half.size) if i != j):
        yield f"couple{i + 1}", partial(_coupled, s, i)
        for ratio in (1, -1):
            yield f"rel{i + 1}{ratio:+d}", _relative(s, j, i, ratio)
        yield f"poly3q{i + 1}", _poly(s, i, 3)


def _coupled(s: Scales, i: int, m: Motion, _: FloatArray) -> FloatArray:
    return columns(m.qd[:, i], s.sign(m, i), m.qdd[:, i])


def _relative(s: Scales, j: int, i: int, ratio: int) -> Feature:
    def feature(m: Motion, _: FloatArray) -> FloatArray:
        v, a = (x[:, j] + ratio * x[:, i] for x in (m.qd, m.qdd))
        return columns(v, np.tanh(v / s.slow[j]), a)

    return feature


def _object(s: Scales, j: int) -> Named:
    """What an object does: a damper, a damper with a spring in series, where contact begins."""
    yield "viscous", lambda m, _: m.qd[:, j : j + 1]
    for seconds in (0.03, 0.1, 0.3):
        yield f"maxwell{seconds}", _maxwell(j, seconds)
    for share in (-0.6, -0.2, 0.2, 0.6):
        yield f"onset{share}", _onset(s, j, share)


def _maxwell(j: int, seconds: float) -> Feature:
    return lambda m, _: columns(_relaxing(m, j, seconds))


def _onset(s: Scales, j: int, share: float) -> Feature:
    return lambda m, _: columns(np.maximum(0, s.place(m, j) - share))


def _relaxing(m: Motion, j: int, seconds: float) -> FloatArray:
    """Deflection of a spring behind a damper: its own speed is q's less its deflection / T (n,)."""
    keep = float(np.exp(-m.dt / seconds))
    steps = np.diff(m.q[:, j], prepend=m.q[:1, j])
    return np.asarray(lfilter([keep], [1.0, -keep], steps))
