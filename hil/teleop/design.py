"""A controller of the Extended Lawrence Architecture on one axis: c1..c8 and how they are realised.

Thesis sections 3.2 and 3.5; D. A. Lawrence, IEEE Trans. Robot. Autom. 9(5), 1993.  Channel
numbers: c1 v_m -> slave, c2 f_s -> master, c3 f_m -> slave, c4 v_s -> master (forward and back);
c5 slave's own force, c6 master's own force, c7 slave's own motion, c8 master's own motion.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from hil.errors import ConfigError
from hil.teleop.rational import Rational, pade

MOTION = ("c1", "c4", "c7", "c8")
FORCE = ("c2", "c3", "c5", "c6")


@dataclass(frozen=True)
class Term:
    """Motion term c(s) = k / s + b + a s: on position, velocity, acceleration.

    Parameters
    ----------
    k, b, a : float
        [N/m], [N s/m], [kg]; all act on velocities.
    """

    k: float = 0.0
    b: float = 0.0
    a: float = 0.0

    def __call__(self, s: Any, velocity: Any = 1.0, acceleration: Any = 1.0) -> Any:
        """Value at s, with the filters of velocity and acceleration."""
        return self.k / s + self.b * velocity + self.a * s * acceleration

    def __add__(self, other: Term) -> Term:
        return Term(self.k + other.k, self.b + other.b, self.a + other.a)

    def __mul__(self, x: float) -> Term:
        return Term(self.k * x, self.b * x, self.a * x)

    def __neg__(self) -> Term:
        return self * -1.0

    def size(self) -> float:
        """Largest coefficient in magnitude, whatever its unit."""
        return max(abs(self.k), abs(self.b), abs(self.a))


@dataclass(frozen=True)
class Robot:
    """Controlled robot on one axis, z(s) = m s + b.

    Parameters
    ----------
    m, b : float
        Mass [kg] and damping [N s/m] at the tip.
    """

    m: float = 0.1
    b: float = 0.0

    def __post_init__(self) -> None:
        if not self.m > 0.0 or self.b < 0.0:
            raise ConfigError(f"robot: m = {self.m} kg must be positive, b = {self.b} not negative")

    @property
    def term(self) -> Term:
        """Impedance as a term."""
        return Term(0.0, self.b, self.m)


@dataclass(frozen=True)
class Realisation:
    """What a loop adds to the ideal terms: first-order filters and communication delay.

    Parameters
    ----------
    velocity_hz, acceleration_hz, force_hz : float
        Corners of first-order low-passes; 0 = none.
    forward_s, backward_s : float
        Delay master -> slave (c1, c3) and slave -> master (c2, c4) [s].
    """

    velocity_hz: float = 0.0
    acceleration_hz: float = 0.0
    force_hz: float = 0.0
    forward_s: float = 0.0
    backward_s: float = 0.0

    def __post_init__(self) -> None:
        for f in fields(self):
            if getattr(self, f.name) < 0.0:
                raise ConfigError(f"{f.name} must not be negative")


IDEAL = Realisation()


@dataclass(frozen=True)
class Design:
    """One axis: eight channels and the two robots they were made for.

    Parameters
    ----------
    c1, c4, c7, c8 : Term
        Motion terms.
    c2, c3, c5, c6 : float
        Force gains.
    master, slave : Robot
        z_cm, z_cs.
    name : str
        For people.
    motion_scale, force_scale : float
        Goals v_s = motion_scale v_m and f_m = force_scale f_s.
    """

    c1: Term = Term()
    c2: float = 0.0
    c3: float = 0.0
    c4: Term = Term()
    c5: float = 0.0
    c6: float = 0.0
    c7: Term = Term()
    c8: Term = Term()
    master: Robot = field(default_factory=Robot)
    slave: Robot = field(default_factory=Robot)
    name: str = "own"
    motion_scale: float = 1.0
    force_scale: float = 1.0

    @property
    def D(self) -> float:
        """D = (1 + c5)(1 + c6) - c2 c3 = -det Q: zero where the forces cannot be estimated."""
        return (1.0 + self.c5) * (1.0 + self.c6) - self.c2 * self.c3


@dataclass(frozen=True)
class Blocks:
    """Blocks of Q f + R v = 0, Q = [[a, -b], [c, -d]], R = [[-Zm, c4], [c1, Zs]], v = (v_m, -v_s).

    Each is a number, an array over s, or a `Rational`.
    """

    a: Any
    b: Any
    c: Any
    d: Any
    Zm: Any
    Zs: Any
    c1: Any
    c4: Any


def blocks(design: Design, s: Any, real: Realisation = IDEAL) -> Blocks:
    """Evaluate the blocks at s.

    Parameters
    ----------
    design : Design
        Controller.
    s : complex array (n,) or Rational
        Laplace variable [rad/s]; `Rational.s()` gives rational blocks, delays then by Pade.
    real : Realisation
        Filters and delays.
    """
    gv, ga, gf = (_filter(hz, s) for hz in (real.velocity_hz, real.acceleration_hz, real.force_hz))
    forth, back = _delay(real.forward_s, s), _delay(real.backward_s, s)
    m, n = design.master.term, design.slave.term
    return Blocks(
        a=1.0 + design.c6 * gf,
        b=design.c2 * gf * back,
        c=design.c3 * gf * forth,
        d=1.0 + design.c5 * gf,
        Zm=m(s) + design.c8(s, gv, ga),
        Zs=n(s) + design.c7(s, gv, ga),
        c1=design.c1(s, gv, ga) * forth,
        c4=design.c4(s, gv, ga) * back,
    )


def _filter(hz: float, s: Any) -> Any:
    """G = 1 / (1 + s / (2 pi f)); 1 without a corner."""
    return 1.0 if hz == 0.0 else 1.0 / (1.0 + s * (1.0 / (2.0 * np.pi * hz)))


def _delay(seconds: float, s: Any) -> Any:
    if seconds == 0.0:
        return 1.0
    return pade(seconds) if isinstance(s, Rational) else np.exp(-seconds * s)
