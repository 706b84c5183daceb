"""One axis in sampled time: its map from tick to tick, eigenvalues, and hybrid matrix.

The law's own kernels (`hil.teleop.lawrence_filters`) and delay lines around an exactly
sampled plant: two masses with operator and environment, moved by held forces.  One period is a
linear map: its eigenvalues decide on stability, and driven by a force it predicts the hybrid matrix
that a session shows.  What must not run is decided in `hil.teleop.gate`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import expm

from hil.errors import ConfigError
from hil.teleop import lawrence_filters
from hil.teleop.architecture import IDEAL, Design, MotionTerm, Realisation, ticks
from hil.teleop.hybrid import FREE_MOTION, GEL, HAND, ComplexArray, FloatArray, Impedance

#: Longest delay line that is checked exactly [ticks].
_LONGEST = 300


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
    a = np.array(
        [
            [0, 1, 0, 0],
            [-k / r, -(b + damping) / r, k / r, b / r],
            [0, 0, 0, 1],
            [k / m, b / m, -(k + z.k) / m, -(b + z.b) / m],
        ]
    )
    return a, np.array([0, 1 / r, 0, 0])


def compliance(
    mass: float, damping: float, cable: Cable, hz: FloatArray, period: float
) -> ComplexArray:
    """What the encoder of a free arm moves by a held force at its motor, in sampled time [m/N].

    Parameters
    ----------
    mass, damping : float
        At its tip [kg], of its motor side [N s/m].
    cable : Cable
        Between motor and tip.
    hz : ndarray (n,)
        Frequencies [Hz].
    period : float
        Of the loop [s].
    """
    inner, push = _mechanics(mass, damping, cable, FREE_MOTION)
    n = push.size
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = inner, push
    step = expm(whole * period)
    z = np.exp(2j * np.pi * hz * period)[:, None, None]
    found = np.linalg.solve(
        z * np.eye(n) - step[:n, :n], np.broadcast_to(step[:n, n:], (len(hz), n, 1))
    )
    out: ComplexArray = found[:, 0, 0]
    return out


@dataclass(frozen=True)
class SampledLoop:
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
    tips : tuple of pairs of floats
        Natural masses at every pose at which it must be [kg]; empty = `tip` alone.
    friction, compensated : tuple of 2 floats
        Damping of the arms' own friction on the motor side, and what the law adds to the motors'
        force against it [N s/m].
    disturbance, observer_hz : float
        Share of the observed disturbance that the law takes away, and the observer's corner.
    fixture : tuple of 2 floats
        Stiffness [N/m] and damping [N s/m] of virtual fixtures, in which the master may be or not.
    """

    design: Design
    real: Realisation = IDEAL
    shape: str = "natural"
    tip: tuple[float, float] = (0.0, 0.0)
    cable: Cable | None = None
    axis: str = ""
    operators: tuple[Impedance, ...] = (HAND, Impedance(0.0, 1.0, 0.0))
    environments: tuple[Impedance, ...] = (FREE_MOTION, GEL)
    tips: tuple[tuple[float, float], ...] = ()
    friction: tuple[float, float] = (0.0, 0.0)
    compensated: tuple[float, float] = (0.0, 0.0)
    disturbance: float = 0.0
    observer_hz: float = 0.0
    fixture: tuple[float, float] = (0.0, 0.0)

    def within(self) -> SampledLoop:
        """The loop while the master is in its fixtures: a local gain more."""
        c8 = self.design.c8 + MotionTerm(*self.fixture)
        return replace(self, design=replace(self.design, c8=c8), fixture=(0.0, 0.0))

    def masses(self) -> tuple[float, float]:
        """Natural masses of master and slave [kg]."""
        d = self.design
        return self.tip[0] or d.master.m, self.tip[1] or d.slave.m


def gains(design: Design) -> FloatArray:
    """Gains in the order of `hil.teleop.lawrence_filters.GAINS`, shape (16,)."""
    terms = [x for c in (design.c1, design.c4, design.c7, design.c8) for x in (c.k, c.b, c.a)]
    return np.array([*terms, design.c2, design.c3, design.c5, design.c6])


class Axis:
    """One axis in sampled time, as a map from one tick to the next.

    State: position and speed of each robot (with a cable: motor side, then tip), held forces
    u_m, u_s, two filter memories, last positions, with disturbance observers two memories of
    them, two delay lines.

    Parameters
    ----------
    loop : Loop
        The axis.
    zh, ze : Impedance
        Operator and environment.
    period : float
        T [s].
    """

    def __init__(self, loop: SampledLoop, zh: Impedance, ze: Impedance, period: float) -> None:
        self.loop, self.outside, self.period = loop, (zh, ze), period
        self._g = gains(loop.design)
        real = loop.real
        corners = np.array([real.velocity_hz, real.acceleration_hz, real.force_hz])
        self._shares = np.where(corners > 0, 1 - np.exp(-2 * np.pi * corners * period), 1.0)
        self.ages = (ticks(real.forward_s, period), ticks(real.backward_s, period))
        if max(self.ages) > _LONGEST:
            raise ConfigError(f"delays above {_LONGEST} ticks are not checked in sampled time")
        robots = (loop.design.master, loop.design.slave)
        both = [
            _mechanics(m, robot.b + own, loop.cable, z)
            for m, robot, own, z in zip(
                loop.masses(), robots, loop.friction, self.outside, strict=True
            )
        ]
        n = len(both[0][0])
        self.plant, self._tip = 2 * n, n - 2
        self._gain = 2 * np.pi * loop.observer_hz
        #: Where the delay lines start.
        self.first_line = 2 * n + 12 + (4 if loop.disturbance else 0)
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
        return self.first_line + lawrence_filters.SIGNALS * sum(self.ages)

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
        sent, speeds, forces = self._measured(z, push, out)
        forth, back, lines = self._lines(z, sent)
        out[self.first_line :] = lines
        asked = (
            lawrence_filters.master(self._g, sent[0], back),
            lawrence_filters.slave(self._g, forth, sent[1]),
        )
        for r, f in enumerate(asked):
            out[n + r] = self._shaped(r, f, sent[r]) + self.loop.compensated[r] * speeds[r]
            out[n + r] -= self._disturbed(r, z, speeds[r], forces[r], out)
        out[:n] = self._step @ np.array([*z[:n], out[n], out[n + 1], push])
        return out

    def _disturbed(self, r: int, z: FloatArray, v: float, force: float, out: FloatArray) -> float:
        """Force that the law takes for a disturbance of robot r; the memory goes into `out`.

        As `hil.controllers.dynamics.advance` of a mass, beside the sensor behind the same low-pass.
        """
        if not self.loop.disturbance:
            return 0.0
        at, gain = self.plant + 12 + 2 * r, self._gain * self.period
        known = z[at] + self.period * (z[self.plant + r] - self.loop.compensated[r] * v)
        seen = self._gain * (self.loop.masses()[r] * v - known) / (1.0 + gain)
        out[at] = known + self.period * seen
        # f_m = +F, f_s = -F with F ON the robot
        on_robot = force if r == 0 else -force
        out[at + 1] = z[at + 1] + gain / (1.0 + gain) * (on_robot - z[at + 1])
        return self.loop.disturbance * float(seen - out[at + 1])

    def _measured(
        self, z: FloatArray, push: float, out: FloatArray
    ) -> tuple[FloatArray, list[float], tuple[float, float]]:
        """Signals of both robots, raw speeds, forces; the filters' memory goes into `out`."""
        n, speeds, forces = self.plant, [0.0, 0.0], self.ports(z, push)
        now, sent = (
            np.zeros((2, lawrence_filters.FILTER_MEMORY)),
            np.zeros((2, lawrence_filters.SIGNALS)),
        )
        for r, f in enumerate(forces):
            at, own = n + 2 + 4 * r, r * n // 2
            past = np.append(z[at : at + 4], 1.0)
            # encoders: the speed is a difference of positions
            v = speeds[r] = (z[own] - z[n + 10 + r]) / self.period
            lawrence_filters.filtered_axis(
                z[own], v, f, self._shares, self.period, past, now[r], sent[r]
            )
            out[at : at + 4], out[n + 10 + r] = now[r, :4], z[own]
        return sent, speeds, forces

    def apart(self) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Master and slave alone, without delay: a, b, c of z' = a z + b heard, asked = c z.

        `heard` is the force that the other arm asks for [N], `asked` what this one asks of it.
        """
        n, g, size = self.plant, self._g, self.first_line
        nothing = np.zeros(lawrence_filters.SIGNALS)
        a = np.zeros((size, size))
        asked = np.zeros((2, size))
        for k, e in enumerate(np.eye(size)):
            sent, speeds, forces = self._measured(e, 0.0, a[:, k])
            own = (
                lawrence_filters.master(g, sent[0], nothing),
                lawrence_filters.slave(g, nothing, sent[1]),
            )
            for r, f in enumerate(own):
                a[n + r, k] = self._shaped(r, f, sent[r]) + self.loop.compensated[r] * speeds[r]
                a[n + r, k] -= self._disturbed(r, e, speeds[r], forces[r], a[:, k])
            a[:n, k] = self._step @ np.array([*e[:n], a[n, k], a[n + 1, k], 0.0])
            asked[0, k] = lawrence_filters.slave(g, sent[0], nothing)
            asked[1, k] = lawrence_filters.master(g, nothing, sent[1])
        out = []
        for r in range(2):
            at = [*range(r * n // 2, (r + 1) * n // 2), n + r, *range(n + 2 + 4 * r, n + 6 + 4 * r)]
            at.append(n + 10 + r)
            at += range(n + 12 + 2 * r, n + 14 + 2 * r) if size > n + 12 else ()
            push = np.zeros(size)
            push[n + r] = self._shaped(r, 1.0, nothing)
            push[:n] = self._step[:, n + r] * push[n + r]
            out.append((a[np.ix_(at, at)], push[at], asked[r, at]))
        return out

    def speeds(self, z: Any, encoders: bool = False) -> tuple[Any, Any]:
        """Speeds v_m, v_s [m/s] of state z at the tips, or as encoders on the motors see them."""
        at = 1 if encoders else self._tip + 1
        return z[at], z[self.plant // 2 + at]

    def _lines(self, z: FloatArray, sent: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What arrives of master and slave, and the delay lines moved on."""
        n, heard, kept, at = lawrence_filters.SIGNALS, [], [], self.first_line
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


def dominant_mode(
    loop: SampledLoop, zh: Impedance, ze: Impedance, period: float
) -> tuple[float, float]:
    """Magnitude of the largest eigenvalue of one period, and its frequency [Hz]."""
    values = np.linalg.eigvals(Axis(loop, zh, ze, period).matrix())
    top = values[np.abs(values).argmax()]
    return float(abs(top)), float(abs(np.angle(top)) / (2 * np.pi * period))


def hybrid_at(
    loop: SampledLoop, w: FloatArray, period: float, encoders: bool = False
) -> ComplexArray:
    """Hybrid matrix that the sampled loop shows at w [rad/s], (n, 2, 2).

    Two experiments per frequency, free and against a spring, driven by the operator's force:
    from [f_m; -v_s] of both and [v_m; f_s] of both.  With `encoders` the speeds are those that
    encoders on the motors see, which lack the cables' stretch.
    """
    y, u = [], []
    for ze in (Impedance(0.0, 0.5, 0.0), Impedance(0.0, 2.0, 200.0)):
        axis = Axis(loop, Impedance(0.2, 3.0, 80.0), ze, period)
        a, n = axis.matrix(), axis.size
        b = axis.advance(np.zeros(n), 1.0)
        ports = np.stack([np.array(axis.ports(e)) for e in np.eye(n)], axis=1)
        direct = np.array(axis.ports(np.zeros(n), 1.0))
        z = [np.linalg.solve(np.exp(1j * x * period) * np.eye(n) - a, b) for x in w]
        f = np.stack([ports @ v + direct for v in z])
        vm, vs = axis.speeds(np.stack(z).T, encoders)
        y.append(np.stack([f[:, 0], -vs], -1))
        u.append(np.stack([vm, f[:, 1]], -1))
    out: Any = np.stack(y, -1) @ np.linalg.inv(np.stack(u, -1))
    return np.asarray(out, np.complex128)
