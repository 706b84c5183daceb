"""Hidden effects that are laws: forces on a joint, drives, encoders, the force sensor, and noise.

A force, a drive or an encoder is a closure that is asked at every step of the physics; what is
wrong with a record is put into it afterwards.  Effects of the mechanism are in `describe`.  Sizes
are in units of the joint: `Place.size` for effort, its reach and its speed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import atan, copysign, cos, exp, log1p, pi, sin, sqrt, tanh

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from hil.sim_devices.mujoco_plants.robots import Link, SimulatedRobot

#: Effort of amplitude 1, share of the motor's largest effort.
UNIT = 0.01


@dataclass
class PlantState:
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
class EffectPlace:
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

    robot: SimulatedRobot
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


EffortLaw = Callable[[PlantState], float]


def sign(place: EffectPlace, share: float = 0.004) -> Callable[[float], float]:
    """Smooth sign of a speed, algebraic."""
    w2 = (share * place.link.speed) ** 2
    return lambda v: v / sqrt(v * v + w2)


# friction ---------------------------------------------------------------------------------------


def stribeck(p: EffectPlace) -> EffortLaw:
    """Half exponential, half logistic in speed."""
    j, f, s, vs = p.j, p.size, sign(p), 0.07 * p.link.speed

    def law(x: PlantState) -> float:
        r = abs(x.w[j]) / vs
        return -f * s(x.w[j]) * (0.5 * exp(-r) + 0.5 * (1.0 - tanh(r)))

    return law


def asymmetric_coulomb(p: EffectPlace) -> EffortLaw:
    """Dry friction forward only."""
    j, f, s = p.j, p.size, sign(p)
    return lambda x: -f * max(0.0, s(x.w[j]))


def asymmetric_viscous(p: EffectPlace) -> EffortLaw:
    """Softened ramp of the speed: log(1 + exp(v))."""
    j, f, v0 = p.j, 2.5 * p.size / p.link.speed, 0.02 * p.link.speed

    def law(x: PlantState) -> float:
        r = x.w[j] / v0
        return -f * (x.w[j] if r > 30.0 else v0 * log1p(exp(r)))

    return law


def drag(p: EffectPlace) -> EffortLaw:
    """Churned oil: |v|^2.2."""
    j, f, top = p.j, 4.0 * p.size, p.link.speed
    return lambda x: -f * copysign((abs(x.w[j]) / top) ** 2.2, x.w[j])


def shear_thinning(p: EffectPlace) -> EffortLaw:
    """Carreau's fluid: thick where it is sheared slowly."""
    j, f, vc = p.j, 3.0 * p.size, 0.1 * p.link.speed

    def law(x: PlantState) -> float:
        r = x.w[j] / vc
        # v (1 + (v/vc)^2)^((n - 1)/2), n = 0.4
        return -f * 0.1 * r * float((1.0 + r * r) ** -0.3)

    return law


def presliding(p: EffectPlace) -> EffortLaw:
    """LuGre with a Stribeck bristle, or Bouc-Wen, on different joints."""
    j, f, z0, z = p.j, p.size, 0.02 * p.link.reach, 0.0
    vs = 0.05 * p.link.speed

    def lugre(x: PlantState) -> float:
        nonlocal z
        v = x.w[j]
        g = z0 * (1.0 + 0.4 * exp(-((v / vs) ** 2)))
        # z' = v - |v| z / g, implicit
        z = (z + x.dt * v) / (1.0 + x.dt * abs(v) / g)
        return -f * z / z0

    def bouc_wen(x: PlantState) -> float:
        nonlocal z
        v, n = x.w[j] / z0, 1.6
        z += x.dt * v * (1.0 - (0.6 * copysign(1.0, v * z) + 0.4) * float(abs(z) ** n))
        z = min(max(z, -1.0), 1.0)
        return -f * z

    return bouc_wen if p.odd else lugre


def position_friction(p: EffectPlace) -> EffortLaw:
    """Dry friction that swells with three harmonics over position."""
    j, f, s, a = p.j, p.size, sign(p), p.phase(3.0)

    def law(x: PlantState) -> float:
        w = a(x.m[j])
        return -f * s(x.w[j]) * (sin(w) + 0.35 * sin(2 * w + 0.5) + 0.1 * cos(3 * w))

    return law


def tight_spot(p: EffectPlace) -> EffortLaw:
    """Dry friction that is higher over a dent with cosine flanks."""
    j, f, s = p.j, 4.0 * p.size, sign(p)
    at, half = p.link.middle + 0.1 * p.link.reach, 0.12 * p.link.reach

    def law(x: PlantState) -> float:
        d = (x.m[j] - at) / half
        return -f * s(x.w[j]) * 0.5 * (1.0 + cos(pi * d)) if -1.0 < d < 1.0 else 0.0

    return law


def load_friction(p: EffectPlace) -> EffortLaw:
    """Gear loss, a share of the motor-side effort; less where the load drives the motor."""
    j, s, mu = p.j, sign(p, 0.01), 0.06 * p.amplitude

    def law(x: PlantState) -> float:
        driving = x.u[j] * x.w[j] > 0.0
        return -mu * (1.0 if driving else 0.55) * abs(x.u[j]) * s(x.w[j])

    return law


def load_viscous(p: EffectPlace) -> EffortLaw:
    """Oil between loaded teeth: a loss by motor-side effort and speed; less where it is driven."""
    j, c = p.j, 0.06 * p.amplitude / p.link.speed

    def law(x: PlantState) -> float:
        driving = x.u[j] * x.w[j] > 0.0
        return -c * (1.0 if driving else 0.8) * abs(x.u[j]) * x.w[j]

    return law


def slewing_ring(p: EffectPlace) -> EffortLaw:
    """A ring of rollers under the arm drags by what the next joint's motor holds, to a power."""
    j, k, s = p.j, p.other, sign(p, 0.01)
    part, usual = 4.0 * p.size, p.robot.links[p.other].effort

    def law(x: PlantState) -> float:
        pressed: float = (abs(x.u[k]) / usual) ** 0.9
        return -part * pressed * s(x.v[j])

    return law


def coupled_friction(p: EffectPlace) -> EffortLaw:
    """Friction in a seal that turns with this and the next joint."""
    j, k, f, v0 = p.j, p.other, p.size, 0.01 * p.link.speed
    r = p.link.speed / p.robot.links[k].speed
    return lambda x: -f * atan((x.w[j] + r * x.w[k]) / v0) * 2.0 / pi


def bent_cable(p: EffectPlace) -> EffortLaw:
    """A cable past another joint: friction grows exponentially with the angle of its bend."""
    j, k, s, f = p.j, p.other, sign(p), 0.6 * p.size
    middle, reach = p.robot.links[k].middle, p.robot.links[k].reach

    def law(x: PlantState) -> float:
        bend = abs(x.q[k] - middle + 0.3 * reach) / reach
        return -f * (exp(1.1 * bend) - 1.0) * s(x.w[j])

    return law


def capstan(p: EffectPlace) -> EffortLaw:
    """A cable around a pulley of another joint: exp of the angle, times what the motor pulls."""
    j, k, s, mu = p.j, p.other, sign(p, 0.01), 0.05 * p.amplitude
    middle, reach = p.robot.links[k].middle, p.robot.links[k].reach

    def law(x: PlantState) -> float:
        bend = abs(x.q[k] - middle - 0.2 * reach) / reach
        return -mu * (exp(0.9 * bend) - 0.6) * abs(x.u[j]) * s(x.w[j])

    return law


def friction_drift(p: EffectPlace) -> EffortLaw:
    """Friction lost while it warms: a stretched exponential."""
    j, f, s = p.j, min(p.size, 0.7 * p.link.friction), sign(p)
    slow = 0.35 * p.robot.seconds

    def law(x: PlantState) -> float:
        return f * s(x.w[j]) * (1.0 - exp(-float((x.t / slow) ** 0.8)))

    return law


# position ---------------------------------------------------------------------------------------


def spring(p: EffectPlace) -> EffortLaw:
    """A balancing spring on a crank: sine and a little of the third."""
    j, f, mid, r = p.j, 1.6 * p.size, p.link.middle, p.link.reach

    def law(x: PlantState) -> float:
        w = 0.6 * (x.q[j] - mid + 0.3 * r) / r
        return -f * (sin(w) - 0.04 * sin(3 * w)) / 0.56

    return law


def umbilical(p: EffectPlace) -> EffortLaw:
    """A cable bundle that straightens on one side."""
    j, f, mid, r = p.j, p.size, p.link.middle, p.link.reach

    def law(x: PlantState) -> float:
        w = (x.q[j] - mid) / r
        return -f * (exp(1.4 * w) - 1.0 - 1.2 / (1.0 + (w + 0.4) ** 2 / 0.08))

    return law


def cushions(p: EffectPlace) -> EffortLaw:
    """Cushions at both ends, unlike in depth and in what they take; each stiffens exponentially."""
    j, f, mid, r = p.j, 2.5 * p.size, p.link.middle, p.link.reach

    def law(x: PlantState) -> float:
        up, down = (x.q[j] - mid) / r - 0.45, (mid - x.q[j]) / r - 0.3
        out = -f * (exp(3.0 * up) - 1.0) if up > 0.0 else 0.0
        return out + (0.7 * f * (exp(3.5 * down) - 1.0) if down > 0.0 else 0.0)

    return law


def cogging(p: EffectPlace) -> EffortLaw:
    """Magnets' detents: three harmonics of unlike heights."""
    j, f, a = p.j, 1.2 * p.size, p.phase(7.0, 0.8)

    def law(x: PlantState) -> float:
        w = a(x.m[j])
        return f * (sin(w) + 0.3 * cos(2 * w) + 0.12 * sin(3 * w + 1.0))

    return law


def hum(p: EffectPlace) -> EffortLaw:
    """A pump on the frame: a line with a weak second harmonic."""
    f, w = p.size, 2 * pi * (2.1 + 0.37 * p.j)
    return lambda x: f * (sin(w * x.t) + 0.2 * sin(2 * w * x.t + 1.0))


# kinds without a name -----------------------------------------------------------------------------


def _hose(p: EffectPlace) -> EffortLaw:
    """A hose that creeps: three Maxwell arms of 1.3, 6 and 28 s beside a weak spring."""
    j, f, r, mid = p.j, 1.5 * p.size, p.link.reach, p.link.middle
    slow, s = (1.3, 6.0, 28.0), [0.0, 0.0, 0.0]

    def law(x: PlantState) -> float:
        w = (x.q[j] - mid) / r
        for i, tau in enumerate(slow):
            s[i] += x.dt * (w - s[i]) / tau
        return -f * (0.2 * w + 0.5 * (w - s[0]) + 0.6 * (w - s[1]) + 0.5 * (w - s[2]))

    return law


def latch(p: EffectPlace) -> EffortLaw:
    """A magnet that pulls towards one place."""
    j, f, at, width = p.j, 4.0 * p.size, p.link.middle + 0.15 * p.link.reach, 0.06 * p.link.reach

    def law(x: PlantState) -> float:
        w = (x.q[j] - at) / width
        return -f * w * exp(0.5 - 0.5 * w * w) if abs(w) < 7.0 else 0.0

    return law


def gusts(p: EffectPlace) -> EffortLaw:
    """Wind: an Ornstein-Uhlenbeck process of 0.8 s, squared with its sign."""
    j, f, rng, z = p.j, p.size, p.rng, 0.0

    def law(x: PlantState) -> float:
        nonlocal z
        z += -x.dt * z / 0.8 + sqrt(2.0 * x.dt / 0.8) * rng.standard_normal()
        return f * z * (0.4 + 0.6 * abs(z)) * (1.0 + 0.1 * sin(x.q[j]))

    return law


def brake(p: EffectPlace) -> EffortLaw:
    """A brake that drags for a part of a second, at random instants."""
    j, f, s, rng, until = p.j, 5.0 * p.size, sign(p, 0.02), p.rng, 0.0
    start = rng.exponential(2.0)

    def law(x: PlantState) -> float:
        nonlocal start, until
        if x.t >= start:
            until, start = x.t + rng.uniform(0.08, 0.4), x.t + 0.6 + rng.exponential(2.0)
        return -f * s(x.w[j]) if x.t < until else 0.0

    return law


#: Forces on the motor's side: name -> law.
MOTOR: dict[str, Callable[[EffectPlace], EffortLaw]] = {
    "stribeck": stribeck,
    "asymmetric-coulomb": asymmetric_coulomb,
    "asymmetric-viscous": asymmetric_viscous,
    "quadratic-drag": drag,
    "sublinear-viscous": shear_thinning,
    "presliding": presliding,
    "position-friction": position_friction,
    "local-friction": tight_spot,
    "load-friction": load_friction,
    "load-viscous": load_viscous,
    "coupled-load-friction": slewing_ring,
    "coupled-friction": coupled_friction,
    "posture-friction": bent_cable,
    "capstan-friction": capstan,
    "friction-drift": friction_drift,
    "cogging": cogging,
    "outside-brake": brake,
}
#: Forces on the link.
LINK: dict[str, Callable[[EffectPlace], EffortLaw]] = {
    "spring": spring,
    "position-torque": umbilical,
    "two-stops": cushions,
    "periodic-disturbance": hum,
    "relaxation": _hose,
    "outside-magnetic-latch": latch,
    "outside-wind": gusts,
}


#: Effort of all motors, changed in place, at every step of the physics.
Drive = Callable[[list[float], PlantState], None]


def gain(p: EffectPlace) -> Drive:
    """A torque constant that is off."""
    j, g = p.j, 0.05 * p.amplitude

    def drive(u: list[float], x: PlantState) -> None:
        u[j] *= 1.0 + g

    return drive


def offset(p: EffectPlace) -> Drive:
    """An amplifier's offset."""
    j, f = p.j, p.size

    def drive(u: list[float], x: PlantState) -> None:
        u[j] += f

    return drive


def ripple(p: EffectPlace) -> Drive:
    """Commutation: two harmonics, times the effort."""
    j, r, a = p.j, 0.08 * p.amplitude, p.phase(9.0, 0.2)

    def drive(u: list[float], x: PlantState) -> None:
        w = a(x.m[j])
        u[j] *= 1.0 + r * (sin(w) + 0.3 * cos(2 * w))

    return drive


def saturation(p: EffectPlace) -> Drive:
    """An iron core that saturates: L tanh(u / L)."""
    j, top = p.j, p.link.effort / p.amplitude

    def drive(u: list[float], x: PlantState) -> None:
        u[j] = top * tanh(u[j] / top)

    return drive


def crosstalk(p: EffectPlace) -> Drive:
    """A share of the neighbour's effort, of the same share of its motor."""
    j, k = p.j, p.other
    e = 0.05 * p.amplitude * p.link.effort / p.robot.links[k].effort

    def drive(u: list[float], x: PlantState) -> None:
        u[j] += e * u[k]

    return drive


def lag(p: EffectPlace) -> Drive:
    """Current loop of first order, or of second (damping ratio 0.6)."""
    j, slow, y, rate = p.j, 4e-3 * p.amplitude, 0.0, 0.0

    def first(u: list[float], x: PlantState) -> None:
        nonlocal y
        y += (1.0 - exp(-x.dt / slow)) * (u[j] - y)
        u[j] = y

    def second(u: list[float], x: PlantState) -> None:
        nonlocal y, rate
        w = 1.2 / slow
        rate += x.dt * (w * w * (u[j] - y) - 1.2 * w * rate)
        y += x.dt * rate
        u[j] = y

    return second if p.odd and slow > 2e-3 else first


def delay(p: EffectPlace) -> Drive:
    """A queue; what lies between two steps is interpolated."""
    j, late = p.j, 5e-3 * p.amplitude
    queue: deque[float] = deque()

    def drive(u: list[float], x: PlantState) -> None:
        whole, part = divmod(late / x.dt, 1.0)
        queue.appendleft(u[j])
        while len(queue) > int(whole) + 2:
            queue.pop()
        near, far = (queue[min(int(whole) + i, len(queue) - 1)] for i in (0, 1))
        u[j] = (1.0 - part) * near + part * far

    return drive


def differential(p: EffectPlace) -> Drive:
    """Two motors with seals of their own, which turn with sum and difference of two joints."""
    j, k, f, v0 = p.j, p.other, 0.6 * p.size, 0.01 * p.link.speed
    r = p.link.speed / p.robot.links[k].speed

    def drive(u: list[float], x: PlantState) -> None:
        for side, share in ((1.0, 1.0), (-1.0, 0.8)):
            rubs = share * f * atan((x.w[j] + side * r * x.w[k]) / v0) * 2.0 / pi
            u[j] -= rubs
            u[k] -= side * r * rubs

    return drive


def uneven(p: EffectPlace) -> Drive:
    """A drive that pulls weaker than it pushes; around zero it goes over from one to the other."""
    j, g, u0 = p.j, min(0.1 * p.amplitude, 0.7), 5e-3 * p.link.effort

    def drive(u: list[float], x: PlantState) -> None:
        u[j] *= 1.0 - g * (0.5 - atan(u[j] / u0) / pi)

    return drive


def dead_zone(p: EffectPlace) -> Drive:
    """Nothing comes through below a threshold."""
    j, width = p.j, 1.5 * p.size

    def drive(u: list[float], x: PlantState) -> None:
        u[j] = 0.0 if abs(u[j]) < width else u[j] - copysign(width, u[j])

    return drive


def warm_gain(p: EffectPlace) -> Drive:
    """Magnets that weaken as the winding warms with the square of the effort."""
    j, g, heat = p.j, 0.3 * p.amplitude, 0.0
    usual, slow = (0.15 * p.link.effort) ** 2, 0.3 * p.robot.seconds

    def drive(u: list[float], x: PlantState) -> None:
        nonlocal heat
        heat += x.dt * (u[j] * u[j] / usual - heat) / slow
        u[j] *= 1.0 - g * heat / (1.0 + 2.0 * g * heat)

    return drive


def weakening(p: EffectPlace) -> Drive:
    """Iron losses that grow with the speed, or a coil that leaves its magnet."""
    j, g, link = p.j, min(0.06 * p.amplitude, 0.6), p.link

    def at_speed(u: list[float], x: PlantState) -> None:
        v = x.w[j] / link.speed
        u[j] *= 1.0 - g * (sqrt(v * v + 1e-4) + 0.15 * v * v)

    def off_centre(u: list[float], x: PlantState) -> None:
        u[j] *= 1.0 - g * (1.0 - cos(1.3 * ((x.m[j] - link.middle) / link.reach - 0.15)))

    return at_speed if p.odd else off_centre


DRIVES: dict[str, Callable[[EffectPlace], Drive]] = {
    "torque-gain": gain,
    "torque-offset": offset,
    "torque-ripple": ripple,
    "torque-saturation": saturation,
    "dead-zone": dead_zone,
    "asymmetric-gain": uneven,
    "differential": differential,
    "torque-crosstalk": crosstalk,
    "actuator-lag": lag,
    "delay": delay,
    "gain-drift": warm_gain,
    "varying-gain": weakening,
}


FloatArray = NDArray[np.float64]
#: What the encoder of a joint sees beside its motor's angle.
Encoder = Callable[[PlantState], float]


def eccentricity(p: EffectPlace) -> Encoder:
    """A disc that sits off its axis: once a turn, and a little twice."""
    j, e, a = p.j, 2e-3 * p.amplitude * p.link.reach, p.phase(3.5, 1.1)

    def seen(x: PlantState) -> float:
        w = a(x.m[j])
        return e * (sin(w) + 0.15 * cos(2 * w))

    return seen


def missed(p: EffectPlace) -> Encoder:
    """Counts lost at speed, some at a time, at random instants."""
    j, some, rng, lost = p.j, 4e-3 * p.amplitude * p.link.reach, p.rng, 0.0
    start = rng.uniform(2.0, 0.3 * p.robot.seconds)

    def seen(x: PlantState) -> float:
        nonlocal lost, start
        if x.t > start and abs(x.w[j]) > 0.25 * p.link.speed:
            lost -= some * (1.0 if x.w[j] > 0.0 else -1.0)
            start = x.t + rng.uniform(0.15, 0.4) * p.robot.seconds
        return lost

    return seen


def homed(p: EffectPlace) -> Encoder:
    """A home that lies beside the one of the drawing."""
    error = 0.03 * p.amplitude * p.link.reach
    return lambda x: error


def geared(p: EffectPlace) -> Encoder:
    """A pulley of another diameter than the drawing's."""
    j, share = p.j, 0.03 * p.amplitude
    return lambda x: share * x.m[j]


ENCODERS: dict[str, Callable[[EffectPlace], Encoder]] = {
    "encoder-eccentricity": eccentricity,
    "missed-counts": missed,
    "joint-zero": homed,
    "joint-ratio": geared,
}

#: Change of what was recorded: positions (n, d), forces (n, 3), rows a second, place.
Recorded = Callable[[FloatArray, FloatArray, float, EffectPlace], None]


def late(q: FloatArray, force: FloatArray, rate: float, p: EffectPlace) -> None:
    """A first-order filter on the recorded position."""
    a = float(np.exp(-1.0 / (rate * 4e-3 * p.amplitude)))
    x = q[:, p.j]
    shifted = np.asarray(scipy.signal.lfilter([1.0 - a], [1.0, -a], x - x[0]))
    q[:, p.j] = shifted + x[0]


def bias(q: FloatArray, force: FloatArray, rate: float, p: EffectPlace) -> None:
    """A bridge that was not zeroed."""
    force[:, p.j % 3] += 0.1 * p.amplitude * _rms(force)


def drift(q: FloatArray, force: FloatArray, rate: float, p: EffectPlace) -> None:
    """Warming of the gauges: a square-root ramp that saturates."""
    u = np.arange(len(q)) / len(q)
    force[:, p.j % 3] += 0.2 * p.amplitude * _rms(force) * u / (0.3 + u)


def force_gain(q: FloatArray, force: FloatArray, rate: float, p: EffectPlace) -> None:
    """A channel whose reading grows by its square root's worth."""
    k = p.j % 3
    force[:, k] *= 1.0 + 0.08 * p.amplitude


def force_crosstalk(q: FloatArray, force: FloatArray, rate: float, p: EffectPlace) -> None:
    """A share of another channel."""
    k = p.j % 3
    force[:, k] += 0.1 * p.amplitude * force[:, (k + 1) % 3]


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


RECORDED: dict[str, Recorded] = {
    "filter-lag": late,
    "force-bias": bias,
    "force-drift": drift,
    "force-gain": force_gain,
    "force-crosstalk": force_crosstalk,
}


def disturbance(kind: str, n: int, std: FloatArray, step: float, seed: int) -> FloatArray:
    """Effort (n, d) that acts on the plant beside the motors' [N m or N].

    ``"coloured"`` is first-order noise of 4 Hz with a little white; ``"white"`` and ``"dac"`` have
    none: their noise lies between the effort that acts and the recorded one.
    """
    if kind != "coloured":
        return np.zeros((n, std.size))
    rng = np.random.default_rng([seed, 0xC010])
    a = float(np.exp(-2 * np.pi * 4.0 * step))
    drive = rng.standard_normal((n, std.size)) * np.sqrt(1.0 - a * a)
    low = np.asarray(scipy.signal.lfilter([1.0], [1.0, -a], drive, axis=0))
    return np.asarray(std * (0.22 * low + 0.25 * rng.standard_normal(low.shape)))


def recorded_noise(kind: str, n: int, std: FloatArray, seed: int) -> FloatArray:
    """Noise (n, d) of the recorded effort [N m or N]: white for a measured current, else none."""
    rng = np.random.default_rng([seed, 0x3117E])
    white: FloatArray = rng.standard_normal((n, std.size))
    return std * white * (1.0 if kind == "white" else 0.0)
