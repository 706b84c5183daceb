"""Hidden effects between the effort that is sent and the effort that acts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import copysign, cos, exp, sin, tanh

from hil.sim_devices.mujoco_plants.laws import Place, State

#: Effort of all motors, changed in place, at every step of the physics.
Drive = Callable[[list[float], State], None]


def gain(p: Place) -> Drive:
    """A torque constant that is off."""
    j, g = p.j, 0.05 * p.amplitude

    def drive(u: list[float], x: State) -> None:
        u[j] *= 1.0 + g

    return drive


def offset(p: Place) -> Drive:
    """An amplifier's offset."""
    j, f = p.j, p.size

    def drive(u: list[float], x: State) -> None:
        u[j] += f

    return drive


def ripple(p: Place) -> Drive:
    """Commutation: two harmonics, times the effort."""
    j, r, a = p.j, 0.08 * p.amplitude, p.phase(9.0, 0.2)

    def drive(u: list[float], x: State) -> None:
        w = a(x.m[j])
        u[j] *= 1.0 + r * (sin(w) + 0.3 * cos(2 * w))

    return drive


def saturation(p: Place) -> Drive:
    """An iron core that saturates: L tanh(u / L)."""
    j, top = p.j, p.link.effort / p.amplitude

    def drive(u: list[float], x: State) -> None:
        u[j] = top * tanh(u[j] / top)

    return drive


def crosstalk(p: Place) -> Drive:
    """A share of the neighbour's effort, of the same share of its motor."""
    j, k = p.j, p.other
    e = 0.05 * p.amplitude * p.link.effort / p.robot.links[k].effort

    def drive(u: list[float], x: State) -> None:
        u[j] += e * u[k]

    return drive


def lag(p: Place) -> Drive:
    """Current loop of first order, or of second (damping ratio 0.6)."""
    j, slow, y, rate = p.j, 4e-3 * p.amplitude, 0.0, 0.0

    def first(u: list[float], x: State) -> None:
        nonlocal y
        y += (1.0 - exp(-x.dt / slow)) * (u[j] - y)
        u[j] = y

    def second(u: list[float], x: State) -> None:
        nonlocal y, rate
        w = 1.2 / slow
        rate += x.dt * (w * w * (u[j] - y) - 1.2 * w * rate)
        y += x.dt * rate
        u[j] = y

    return second if p.odd and slow > 2e-3 else first


def delay(p: Place) -> Drive:
    """A queue; what lies between two steps is interpolated."""
    j, late = p.j, 5e-3 * p.amplitude
    queue: deque[float] = deque()

    def drive(u: list[float], x: State) -> None:
        whole, part = divmod(late / x.dt, 1.0)
        queue.appendleft(u[j])
        while len(queue) > int(whole) + 2:
            queue.pop()
        near, far = (queue[min(int(whole) + i, len(queue) - 1)] for i in (0, 1))
        u[j] = (1.0 - part) * near + part * far

    return drive


def dead_zone(p: Place) -> Drive:
    """Nothing comes through below a threshold."""
    j, width = p.j, 1.5 * p.size

    def drive(u: list[float], x: State) -> None:
        u[j] = 0.0 if abs(u[j]) < width else u[j] - copysign(width, u[j])

    return drive


def warm_gain(p: Place) -> Drive:
    """Magnets that weaken as the winding warms with the square of the effort."""
    j, g, heat = p.j, 0.3 * p.amplitude, 0.0
    usual, slow = (0.15 * p.link.effort) ** 2, 0.3 * p.robot.seconds

    def drive(u: list[float], x: State) -> None:
        nonlocal heat
        heat += x.dt * (u[j] * u[j] / usual - heat) / slow
        u[j] *= 1.0 - g * heat / (1.0 + 2.0 * g * heat)

    return drive


DRIVES: dict[str, Callable[[Place], Drive]] = {
    "torque-gain": gain,
    "torque-offset": offset,
    "torque-ripple": ripple,
    "torque-saturation": saturation,
    "torque-crosstalk": crosstalk,
    "actuator-lag": lag,
    "delay": delay,
    "outside-dead-zone": dead_zone,
    "outside-warm-gain": warm_gain,
}
