"""Virtual fixtures at the leader: what guides the hand, and what it must not enter.

Each fixture gives a depth d and a direction n out of it; the leader gets the force

    f = n max(K d - B n v, 0)   where d > 0

    wall   everything behind a plane:     d = -n (x - p)
    ball   everything within a radius:    d = R - |x - p|,  n = (x - p) / |x - p|
    line   away from a line by more than R, which guides along it:  r = x - p across the line,
           d = |r| - R,  n = -r / |r|
    plane  the same of a plane: r = x - p along its normal

Rosenberg 1993; Abbott, Marayong & Okamura 2007.  A spring and damper that never pull back are
passive in continuous time; sampled, they are a local gain of the leader, and are judged as such.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numba as nb
import numpy as np

from hil.errors import ConfigError, unknown
from hil.signals.device import FloatArray

_KINDS = ("wall", "ball", "line", "plane")
#: Of a fixture as numbers: kind, p (3,), direction (3,), R, K, B.
_SIZE = 10
#: Distance from a middle or a line below which there is no direction [m].
_NOWHERE = 1e-6


@dataclass(frozen=True)
class FixtureConfig:
    """One fixture; places are relative to the tip's start, in the base frame.

    Parameters
    ----------
    kind : str
        ``"wall"``, ``"ball"``: regions that are forbidden; ``"line"``, ``"plane"``: guides.
    place : tuple of 3 floats
        A point of the plane or line, the middle of the ball [m].
    direction : tuple of 3 floats
        Normal out of the wall or of the plane, direction of the line; any length but 0.
    radius : float
        Of the ball; how far off line or plane is free [m].
    stiffness, damping : float
        K [N/m], B [N s/m].
    """

    kind: str = "wall"
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    radius: float = 0.0
    stiffness: float = 400.0
    damping: float = 0.5

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise ConfigError(unknown("fixture", self.kind, _KINDS))
        numbers = (*self.place, *self.direction, self.radius, self.stiffness, self.damping)
        if not all(map(math.isfinite, numbers)):
            raise ConfigError(f"fixture {self.kind}: every number must be finite.")
        if not any(self.direction):
            raise ConfigError(f"fixture {self.kind}: direction is zero; a direction is needed.")
        for name in ("radius", "stiffness", "damping"):
            if getattr(self, name) < 0.0:
                raise ConfigError(f"fixture {self.kind}: {name} must not be negative.")
        if self.kind == "ball" and self.radius == 0.0:
            raise ConfigError("fixture ball: radius = 0 forbids nothing; above 0 is needed.")

    def numbers(self) -> FloatArray:
        """The fixture for the kernel, (SIZE,)."""
        direction = np.asarray(self.direction) / np.linalg.norm(self.direction)
        size = (self.radius, self.stiffness, self.damping)
        return np.array([_KINDS.index(self.kind), *self.place, *direction, *size])


def fixture_records(fixtures: Sequence[FixtureConfig]) -> FloatArray:
    """All of them for the kernel, (n, SIZE)."""
    return np.array([f.numbers() for f in fixtures]).reshape(-1, _SIZE)


@nb.njit(cache=True, nogil=True)
def off(f: Any, x: Any, n: Any) -> float:
    """Depth [m] of tip `x` (3,) in fixture `f` (SIZE,); the direction out of it goes into `n`."""
    along = 0.0
    for i in range(3):
        n[i] = x[i] - f[1 + i]
        along += n[i] * f[4 + i]
    if f[0] == 0.0:
        for i in range(3):
            n[i] = f[4 + i]
        return -along
    for i in range(3):
        if f[0] == 2.0:
            n[i] -= along * f[4 + i]
        elif f[0] == 3.0:
            n[i] = along * f[4 + i]
    far = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if far < _NOWHERE:
        n[:] = 0.0
        return float(f[7] - far) if f[0] == 1.0 else 0.0
    sign = 1.0 if f[0] == 1.0 else -1.0
    for i in range(3):
        n[i] *= sign / far
    return float(sign * (f[7] - far))


@nb.njit(cache=True, nogil=True)
def fixture_force(fixtures: Any, x: Any, v: Any, n: Any, force: Any) -> None:
    """Add what all fixtures do to the leader to `force` (3,) [N]; `n` (3,) is scratch.

    Parameters
    ----------
    fixtures : ndarray (k, SIZE)
        See `fixture_records`.
    x, v : ndarray (3,)
        Tip from its start [m], its velocity [m/s].
    """
    for k in range(fixtures.shape[0]):
        depth = off(fixtures[k], x, n)
        if depth <= 0.0:
            continue
        speed = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
        size = max(fixtures[k, 8] * depth - fixtures[k, 9] * speed, 0.0)
        for i in range(3):
            force[i] += size * n[i]
