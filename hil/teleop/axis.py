"""One axis in sampled time: the law's own kernels around an exactly sampled plant.

Two masses with operator and environment, moved by held forces; the law of `hil.controllers.ela`
with its filters and the delay lines.  One period is a linear map.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm

from hil.controllers import ela
from hil.errors import ConfigError
from hil.teleop.design import IDEAL, Design, Realisation
from hil.teleop.hybrid import FREE, GEL, HAND, FloatArray, Impedance

#: Longest delay line that is checked exactly [ticks].
LONGEST = 300


@dataclass(frozen=True)
class Cable:
    """Elastic transmission between motor and tip, seen at the tip.

    Parameters
    ----------
    k, b : float
        Stiffness [N/m], damping [N s/m].
    rotor : float
        Part of the mass that the motor side carries [kg].
    """

    k: float
    b: float
    rotor: float

    def tip(self, mass: float) -> float:
        """What is left of `mass` at the tip [kg]."""
        return max(mass - self.rotor, 0.2 * mass)


def _mechanics(
    mass: float, damping: float, cable: Cable | None, z: Impedance
) -> tuple[FloatArray, FloatArray]:
    """State matrix of a robot with what it touches, and the column of the motor's force."""
    if cable is None:
        # (m + m_z) x'' + (b + b_z) x' + k_z x = u
        m = mass + z.m
        return np.array([[0, 1], [-z.k / m, -(damping + z.b) / m]]), np.array([0, 1 / m])
    m, r, k, b = cable.tip(mass) + z.m, cable.rotor, cable.k, cable.b
    # r x'' + b_r x' = u - k (x - y) - b (x' - y');  m y'' = k (x - y) + b (x' - y') - z y'
    a = np.array([
        [0, 1, 0, 0],
        [-k / r, -(b + damping) / r, k / r, b / r],
        [0, 0, 0, 1],
        [k / m, b / m, -(k + z.k) / m, -(b + z.b) / m],
    ])  # fmt: skip
    return a, np.array([0, 1 / r, 0, 0])


@dataclass(frozen=True)
class Loop:
    """One axis as it will run.

    Parameters
    ----------
    design : Design
        Gains, and the masses they were made for.
    real : Realisation
        Filters and the longest delays of the channels.
    shape : str
        ``"natural"``, ``"force"`` or ``"acceleration"``: how the arm becomes the design's mass.
    tip : tuple of 2 floats
        Natural tip mass of master and slave on this axis [kg]; zeros = the design's.
    cable : Cable or None
        Elastic transmission; None = rigid.
    axis : str
        For messages.
    operators, environments : tuple of Impedance
        For every pair of which the loop must be stable.
    """

    design: Design
    real: Realisation = IDEAL
    shape: str = "natural"
    tip: tuple[float, float] = (0.0, 0.0)
    cable: Cable | None = None
    axis: str = ""
    operators: tuple[Impedance, ...] = (HAND, Impedance(0.0, 1.0, 0.0))
    environments: tuple[Impedance, ...] = (FREE, GEL)

    def masses(self) -> tuple[float, float]:
        """Natural masses of master and slave [kg]."""
        d = self.design
        return self.tip[0] or d.master.m, self.tip[1] or d.slave.m


def gains(design: Design) -> FloatArray:
    """Gains in the order of `hil.controllers.ela.GAINS`, shape (16,)."""
    terms = [x for c in (design.c1, design.c4, design.c7, design.c8) for x in (c.k, c.b, c.a)]
    return np.array([*terms, design.c2, design.c3, design.c5, design.c6])


class Axis:
    """One axis in sampled time, as a map from one tick to the next.

    State: position and speed of each robot (with a cable: motor side, then tip), held forces
    u_m, u_s, two filter memories, last positions, two delay lines.

    Parameters
    ----------
    loop : Loop
        The axis.
    zh, ze : Impedance
        Operator and environment.
    period : float
        T [s].
    """

    def __init__(self, loop: Loop, zh: Impedance, ze: Impedance, period: float) -> None:
        self.loop, self.outside, self.period = loop, (zh, ze), period
        self._g = gains(loop.design)
        real = loop.real
        corners = np.array([real.velocity_hz, real.acceleration_hz, real.force_hz])
        self._shares = np.where(corners > 0, 1 - np.exp(-2 * np.pi * corners * period), 1.0)
        self.ages = (round(real.forward_s / period), round(real.backward_s / period))
        if max(self.ages) > LONGEST:
            raise ConfigError(f"delays above {LONGEST} ticks are not checked in sampled time")
        robots = (loop.design.master, loop.design.slave)
        both = [
            _mechanics(m, robot.b, loop.cable, z)
            for m, robot, z in zip(loop.masses(), robots, self.outside, strict=True)
        ]
        n = len(both[0][0])
        self.plant, self._tip = 2 * n, n - 2
        a = np.zeros((2 * n + 3, 2 * n + 3))
        for r, (inner, push) in enumerate(both):
            a[r * n : (r + 1) * n, r * n : (r + 1) * n] = inner
            a[r * n : (r + 1) * n, 2 * n + r] = push
        # the operator's own force acts on the master's tip
        inertia = (loop.cable.tip(loop.masses()[0]) if loop.cable else loop.masses()[0]) + zh.m
        a[self._tip + 1, 2 * n + 2] = 1.0 / inertia
        self._rate, self._step = a[: 2 * n], expm(a * period)[: 2 * n]

    @property
    def size(self) -> int:
        """Number of states."""
        return self.plant + 4 + 2 * 4 + ela.SIGNALS * sum(self.ages)

    def ports(self, z: FloatArray, push: float = 0.0) -> tuple[float, float]:
        """Measured f_m and f_s [N] at state z, with the operator's own force f_h* [N].

        f_m = f_h* - z_h v_m,  f_s = z_e v_s, at the tips.
        """
        n = self.plant
        rate = self._rate @ np.array([*z[: n + 2], push])
        zh, ze = self.outside
        m, s = self._tip, n // 2 + self._tip
        fm = push - (zh.m * rate[m + 1] + zh.b * z[m + 1] + zh.k * z[m])
        fs = ze.m * rate[s + 1] + ze.b * z[s + 1] + ze.k * z[s]
        return float(fm), float(fs)

    def advance(self, z: FloatArray, push: float = 0.0) -> FloatArray:
        """State after one period; f_h* = `push` [N] is held."""
        out, n = np.empty_like(z), self.plant
        now, sent = np.zeros((2, ela.MEMORY)), np.zeros((2, ela.SIGNALS))
        for r, f in enumerate(self.ports(z, push)):
            at, own = n + 2 + 4 * r, r * n // 2
            past = np.append(z[at : at + 4], 1.0)
            # encoders: the speed is a difference of positions
            v = (z[own] - z[n + 10 + r]) / self.period
            ela.sense(z[own], v, f, self._shares, self.period, past, now[r], sent[r])
            out[at : at + 4], out[n + 10 + r] = now[r, :4], z[own]
        forth, back, lines = self._lines(z, sent)
        out[n + 12 :] = lines
        out[n] = self._shaped(0, ela.master(self._g, sent[0], back), sent[0])
        out[n + 1] = self._shaped(1, ela.slave(self._g, forth, sent[1]), sent[1])
        out[:n] = self._step @ np.array([*z[:n], out[n], out[n + 1], push])
        return out

    def speeds(self, z: Any, encoders: bool = False) -> tuple[Any, Any]:
        """Speeds v_m, v_s [m/s] of state z at the tips, or as encoders on the motors see them."""
        at = 1 if encoders else self._tip + 1
        return z[at], z[self.plant // 2 + at]

    def _lines(self, z: FloatArray, sent: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What arrives of master and slave, and the delay lines moved on."""
        n, heard, kept, at = ela.SIGNALS, [], [], self.plant + 12
        for r, age in enumerate(self.ages):
            line = z[at : at + n * age].reshape(age, n)
            heard.append(line[0] if age else sent[r])
            kept.append(np.vstack([line[1:], sent[r]]) if age else line)
            at += n * age
        return heard[0], heard[1], np.concatenate([k.reshape(-1) for k in kept])

    def _shaped(self, r: int, f: float, own: FloatArray) -> float:
        """Tip force of the arm that is to behave as the design's mass [N]."""
        d, natural = self.loop.design, self.loop.masses()[r]
        goal = (d.master, d.slave)[r].m
        if self.loop.shape == "acceleration":
            # u = f_c - (m_w - m_x) a
            return f - (goal - natural) * float(own[2])
        if self.loop.shape == "force":
            # u = m_x/m_w (f_c + F) - F
            force = float(own[3]) if r == 0 else -float(own[3])
            return natural / goal * (f + force) - force
        return f

    def matrix(self) -> FloatArray:
        """Map of one period, (size, size)."""
        return np.stack([self.advance(e) for e in np.eye(self.size)], axis=1)
