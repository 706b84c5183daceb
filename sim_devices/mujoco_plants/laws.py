"""Hidden forces on a joint: friction, position, time; each a closure that is asked at every step.

All sizes are in units of the joint: `Place.size` for effort, its reach and its speed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import atan, copysign, cos, exp, log1p, pi, sin, sqrt, tanh

import numpy as np

from hil.sim_devices.mujoco_plants.robots import Link, Robot

#: Effort of amplitude 1, share of the motor's largest effort.
UNIT = 0.01


@dataclass
class State:
    """What a law sees: time and step [s], joint and motor positions and speeds, motor effort.

    Lists have one entry a joint [rad, rad/s, N m, or the same in m and N]; motor and joint differ
    where something lies between them.
    """

    t: float = 0.0
    dt: float = 1e-3
    q: list[float] = field(default_factory=list)
    v: list[float] = field(default_factory=list)
    m: list[float] = field(default_factory=list)
    w: list[float] = field(default_factory=list)
    u: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Place:
    """Where an effect is hidden, and how large.

    Parameters
    ----------
    robot : Robot
    j : int
        Joint.
    amplitude : float
    rng : numpy.random.Generator
        For what happens at random.
    """

    robot: Robot
    j: int
    amplitude: float
    rng: np.random.Generator

    @property
    def link(self) -> Link:
        """Link of the joint."""
        return self.robot.links[self.j]

    @property
    def size(self) -> float:
        """Effort of this amplitude [N m or N]."""
        return self.amplitude * UNIT * self.link.effort

    @property
    def other(self) -> int:
        """A neighbour: the next joint, or the one before the last."""
        return self.j + 1 if self.j + 1 < len(self.robot.links) else self.j - 1

    @property
    def odd(self) -> bool:
        """Chooses between two forms of one effect, by robot and joint."""
        return (len(self.robot.links) + self.j) % 2 == 1

    def phase(self, turns: float, at: float = 0.3) -> Callable[[float], float]:
        """Angle of a wave with `turns` waves over the whole motion of the joint."""
        k = pi * turns / self.link.reach
        return lambda q: k * q + at


Law = Callable[[State], float]


def sign(place: Place, share: float = 0.004) -> Callable[[float], float]:
    """Smooth sign of a speed, algebraic."""
    w2 = (share * place.link.speed) ** 2
    return lambda v: v / sqrt(v * v + w2)


# friction ---------------------------------------------------------------------------------------


def stribeck(p: Place) -> Law:
    """Half exponential, half logistic in speed."""
    j, f, s, vs = p.j, p.size, sign(p), 0.07 * p.link.speed

    def law(x: State) -> float:
        r = abs(x.w[j]) / vs
        return -f * s(x.w[j]) * (0.5 * exp(-r) + 0.5 * (1.0 - tanh(r)))

    return law


def asymmetric_coulomb(p: Place) -> Law:
    """Dry friction forward only."""
    j, f, s = p.j, p.size, sign(p)
    return lambda x: -f * max(0.0, s(x.w[j]))


def asymmetric_viscous(p: Place) -> Law:
    """Softened ramp of the speed: log(1 + exp(v))."""
    j, f, v0 = p.j, 2.5 * p.size / p.link.speed, 0.02 * p.link.speed

    def law(x: State) -> float:
        r = x.w[j] / v0
        return -f * (x.w[j] if r > 30.0 else v0 * log1p(exp(r)))

    return law


def drag(p: Place) -> Law:
    """Churned oil: |v|^2.2."""
    j, f, top = p.j, 4.0 * p.size, p.link.speed
    return lambda x: -f * copysign((abs(x.w[j]) / top) ** 2.2, x.w[j])


def presliding(p: Place) -> Law:
    """LuGre with a Stribeck bristle, or Bouc-Wen, on different joints."""
    j, f, z0, z = p.j, p.size, 0.02 * p.link.reach, 0.0
    vs = 0.05 * p.link.speed

    def lugre(x: State) -> float:
        nonlocal z
        v = x.w[j]
        g = z0 * (1.0 + 0.4 * exp(-((v / vs) ** 2)))
        # z' = v - |v| z / g, implicit
        z = (z + x.dt * v) / (1.0 + x.dt * abs(v) / g)
        return -f * z / z0

    def bouc_wen(x: State) -> float:
        nonlocal z
        v, n = x.w[j] / z0, 1.6
        z += x.dt * v * (1.0 - (0.6 * copysign(1.0, v * z) + 0.4) * float(abs(z) ** n))
        z = min(max(z, -1.0), 1.0)
        return -f * z

    return bouc_wen if p.odd else lugre


def position_friction(p: Place) -> Law:
    """Dry friction that swells with three harmonics over position."""
    j, f, s, a = p.j, p.size, sign(p), p.phase(3.0)

    def law(x: State) -> float:
        w = a(x.m[j])
        return -f * s(x.w[j]) * (sin(w) + 0.35 * sin(2 * w + 0.5) + 0.1 * cos(3 * w))

    return law


def load_friction(p: Place) -> Law:
    """Gear loss, a share of the motor-side effort; less where the load drives the motor."""
    j, s, mu = p.j, sign(p, 0.01), 0.06 * p.amplitude

    def law(x: State) -> float:
        driving = x.u[j] * x.w[j] > 0.0
        return -mu * (1.0 if driving else 0.55) * abs(x.u[j]) * s(x.w[j])

    return law


def coupled_friction(p: Place) -> Law:
    """Friction in a seal that turns with this and the next joint."""
    j, k, f, v0 = p.j, p.other, p.size, 0.01 * p.link.speed
    r = p.link.speed / p.robot.links[k].speed
    return lambda x: -f * atan((x.w[j] + r * x.w[k]) / v0) * 2.0 / pi


def friction_drift(p: Place) -> Law:
    """Friction lost while it warms: a stretched exponential."""
    j, f, s = p.j, min(p.size, 0.7 * p.link.friction), sign(p)
    slow = 0.35 * p.robot.seconds

    def law(x: State) -> float:
        return f * s(x.w[j]) * (1.0 - exp(-float((x.t / slow) ** 0.8)))

    return law


# position ---------------------------------------------------------------------------------------


def spring(p: Place) -> Law:
    """A balancing spring on a crank: sine and a little of the third."""
    j, f, mid, r = p.j, 1.6 * p.size, p.link.middle, p.link.reach

    def law(x: State) -> float:
        w = 0.6 * (x.q[j] - mid + 0.3 * r) / r
        return -f * (sin(w) - 0.04 * sin(3 * w)) / 0.56

    return law


def umbilical(p: Place) -> Law:
    """A cable bundle that straightens on one side."""
    j, f, mid, r = p.j, p.size, p.link.middle, p.link.reach

    def law(x: State) -> float:
        w = (x.q[j] - mid) / r
        return -f * (exp(1.4 * w) - 1.0 - 1.2 / (1.0 + (w + 0.4) ** 2 / 0.08))

    return law


def cogging(p: Place) -> Law:
    """Magnets' detents: three harmonics of unlike heights."""
    j, f, a = p.j, 1.2 * p.size, p.phase(7.0, 0.8)

    def law(x: State) -> float:
        w = a(x.m[j])
        return f * (sin(w) + 0.3 * cos(2 * w) + 0.12 * sin(3 * w + 1.0))

    return law


def hum(p: Place) -> Law:
    """A pump on the frame: a line with a weak second harmonic."""
    f, w = p.size, 2 * pi * (2.1 + 0.37 * p.j)
    return lambda x: f * (sin(w * x.t) + 0.2 * sin(2 * w * x.t + 1.0))


# kinds without a name -----------------------------------------------------------------------------


def hose(p: Place) -> Law:
    """A hose that creeps: three Maxwell arms of 1.3, 6 and 28 s beside a weak spring."""
    j, f, r, mid = p.j, 1.5 * p.size, p.link.reach, p.link.middle
    slow, s = (1.3, 6.0, 28.0), [0.0, 0.0, 0.0]

    def law(x: State) -> float:
        w = (x.q[j] - mid) / r
        for i, tau in enumerate(slow):
            s[i] += x.dt * (w - s[i]) / tau
        return -f * (0.2 * w + 0.5 * (w - s[0]) + 0.6 * (w - s[1]) + 0.5 * (w - s[2]))

    return law


def latch(p: Place) -> Law:
    """A magnet that pulls towards one place."""
    j, f, at, width = p.j, 4.0 * p.size, p.link.middle + 0.15 * p.link.reach, 0.06 * p.link.reach

    def law(x: State) -> float:
        w = (x.q[j] - at) / width
        return -f * w * exp(0.5 - 0.5 * w * w) if abs(w) < 7.0 else 0.0

    return law


def gusts(p: Place) -> Law:
    """Wind: an Ornstein-Uhlenbeck process of 0.8 s, squared with its sign."""
    j, f, rng, z = p.j, p.size, p.rng, 0.0

    def law(x: State) -> float:
        nonlocal z
        z += -x.dt * z / 0.8 + sqrt(2.0 * x.dt / 0.8) * rng.standard_normal()
        return f * z * (0.4 + 0.6 * abs(z)) * (1.0 + 0.1 * sin(x.q[j]))

    return law


def brake(p: Place) -> Law:
    """A brake that drags for a part of a second, at random instants."""
    j, f, s, rng, until = p.j, 5.0 * p.size, sign(p, 0.02), p.rng, 0.0
    start = rng.exponential(2.0)

    def law(x: State) -> float:
        nonlocal start, until
        if x.t >= start:
            until, start = x.t + rng.uniform(0.08, 0.4), x.t + 0.6 + rng.exponential(2.0)
        return -f * s(x.w[j]) if x.t < until else 0.0

    return law


#: Forces on the motor's side: name -> law.
MOTOR: dict[str, Callable[[Place], Law]] = {
    "stribeck": stribeck,
    "asymmetric-coulomb": asymmetric_coulomb,
    "asymmetric-viscous": asymmetric_viscous,
    "quadratic-drag": drag,
    "presliding": presliding,
    "position-friction": position_friction,
    "load-friction": load_friction,
    "coupled-friction": coupled_friction,
    "friction-drift": friction_drift,
    "cogging": cogging,
    "outside-brake": brake,
}
#: Forces on the link.
LINK: dict[str, Callable[[Place], Law]] = {
    "spring": spring,
    "position-torque": umbilical,
    "periodic-disturbance": hum,
    "outside-creeping-hose": hose,
    "outside-magnetic-latch": latch,
    "outside-wind": gusts,
}
