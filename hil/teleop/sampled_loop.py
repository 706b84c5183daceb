"""One axis in sampled time: stability, the delay it bears, and what must not run.

The law's own kernels (`hil.teleop.lawrence_filters`) and delay lines around an exactly
sampled plant: two masses with operator and environment, moved by held forces.  One period is a
linear map: its eigenvalues decide on stability, and driven by a force it predicts the hybrid matrix
that a session shows.  `refuse` stops improper gains, an unstable loop and a delay beyond the margin
before a motor moves; a refusal names the condition, its margin and the way out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.linalg import expm

from hil.errors import ConfigError
from hil.teleop import hybrid, lawrence_filters
from hil.teleop.architecture import IDEAL, MOTION, Design, Realisation
from hil.teleop.hybrid import FREE, GEL, HAND, ComplexArray, FloatArray, Impedance

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
    """Gains in the order of `hil.teleop.lawrence_filters.GAINS`, shape (16,)."""
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

    def __init__(self, loop: SampledLoop, zh: Impedance, ze: Impedance, period: float) -> None:
        self.loop, self.outside, self.period = loop, (zh, ze), period
        self._g = gains(loop.design)
        real = loop.real
        corners = np.array([real.velocity_hz, real.acceleration_hz, real.force_hz])
        self._shares = np.where(corners > 0, 1 - np.exp(-2 * np.pi * corners * period), 1.0)
        self.ages = (round(real.forward_s / period), round(real.backward_s / period))
        if max(self.ages) > _LONGEST:
            raise ConfigError(f"delays above {_LONGEST} ticks are not checked in sampled time")
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
        return self.plant + 4 + 2 * 4 + lawrence_filters.SIGNALS * sum(self.ages)

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
        now, sent = np.zeros((2, lawrence_filters.MEMORY)), np.zeros((2, lawrence_filters.SIGNALS))
        for r, f in enumerate(self.ports(z, push)):
            at, own = n + 2 + 4 * r, r * n // 2
            past = np.append(z[at : at + 4], 1.0)
            # encoders: the speed is a difference of positions
            v = (z[own] - z[n + 10 + r]) / self.period
            lawrence_filters.sense(z[own], v, f, self._shares, self.period, past, now[r], sent[r])
            out[at : at + 4], out[n + 10 + r] = now[r, :4], z[own]
        forth, back, lines = self._lines(z, sent)
        out[n + 12 :] = lines
        out[n] = self._shaped(0, lawrence_filters.master(self._g, sent[0], back), sent[0])
        out[n + 1] = self._shaped(1, lawrence_filters.slave(self._g, forth, sent[1]), sent[1])
        out[:n] = self._step @ np.array([*z[:n], out[n], out[n + 1], push])
        return out

    def speeds(self, z: Any, encoders: bool = False) -> tuple[Any, Any]:
        """Speeds v_m, v_s [m/s] of state z at the tips, or as encoders on the motors see them."""
        at = 1 if encoders else self._tip + 1
        return z[at], z[self.plant // 2 + at]

    def _lines(self, z: FloatArray, sent: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What arrives of master and slave, and the delay lines moved on."""
        n, heard, kept, at = lawrence_filters.SIGNALS, [], [], self.plant + 12
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


def _spectral_radius(loop: SampledLoop, zh: Impedance, ze: Impedance, period: float) -> float:
    """Largest magnitude of the eigenvalues of one period; stable below 1."""
    return _dominant_mode(loop, zh, ze, period)[0]


def _dominant_mode(
    loop: SampledLoop, zh: Impedance, ze: Impedance, period: float
) -> tuple[float, float]:
    """Magnitude of the largest eigenvalue of one period, and its frequency [Hz]."""
    values = np.linalg.eigvals(Axis(loop, zh, ze, period).matrix())
    top = values[np.abs(values).argmax()]
    return float(abs(top)), float(abs(np.angle(top)) / (2 * np.pi * period))


def _sampled_delay_margin(loop: SampledLoop, zh: Impedance, ze: Impedance, period: float) -> float:
    """Additional round-trip delay that the sampled loop bears [s], to half a millisecond or so.

    Half of it is added to each channel; the search doubles, then halves, and ends at 0.2 s.
    """

    def stable(extra: float) -> bool:
        real = replace(
            loop.real,
            forward_s=loop.real.forward_s + extra / 2,
            backward_s=loop.real.backward_s + extra / 2,
        )
        return _spectral_radius(replace(loop, real=real), zh, ze, period) < 1.0 + 1e-9

    if not stable(0.0):
        return 0.0
    step, low = 2 * period, 0.0
    while low < 0.2 and stable(low + step):
        low, step = low + step, 2 * step
    high = low + step
    while high - low > 2.5 * period and low < 0.2:
        mid = 2 * period * round((low + high) / 2 / (2 * period))
        low, high = (mid, high) if stable(mid) else (low, mid)
    return low


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


#: Beyond this per period a mode grows; a free position is a mode of exactly 1.
_GROWTH = 1e-7
#: From here on a growing mode is put down to the cable [Hz].
_CABLE_HZ = 80.0


@dataclass(frozen=True)
class Margins:
    """Margins of one axis over all pairs of operator and environment.

    Parameters
    ----------
    axis : str
        Which.
    pole : float
        Largest real part of the continuous closed-loop poles [rad/s].
    radius : float
        Largest magnitude of the sampled closed-loop eigenvalues.
    delay_s : float
        Additional round-trip delay that the continuous loop bears [s].
    pair : str
        Operator and environment with the largest `radius`.
    """

    axis: str
    pole: float
    radius: float
    delay_s: float
    pair: str


def _proper(loop: SampledLoop) -> None:
    """Refuse gains that cannot be realised or cannot hold a slave.

    Raises
    ------
    ConfigError
        Naming the gain.
    """
    d, where = loop.design, f"axis {loop.axis or '-'}"
    for name in MOTION:
        term = getattr(d, name)
        if not np.isfinite([term.k, term.b, term.a]).all():
            raise ConfigError(f"{where}: {name} has a gain that is not a finite number")
        if term.a and loop.real.acceleration_hz == 0.0:
            raise ConfigError(
                f"{where}: {name} has an acceleration term ({term.a:.3g} kg) without a filter, an "
                "improper gain; set acceleration_hz (30, say)"
            )
    for name in ("c2", "c3", "c5", "c6"):
        value = getattr(d, name)
        if not np.isfinite(value) or (name in ("c5", "c6") and value < -1.0):
            raise ConfigError(f"{where}: {name} = {value:.4g} is improper; c5, c6 >= -1 is needed")
    if d.c7.k < 0.0 or d.c7.b < 0.0:
        raise ConfigError(
            f"{where}: c7 = ({d.c7.k:.4g}, {d.c7.b:.4g}) pushes the slave away from its place; "
            "its stiffness and damping must not be negative"
        )


def margins(loop: SampledLoop, period: float) -> Margins:
    """Margins of one axis."""
    rows = []
    for zh, ze in _pairs(loop):
        found = hybrid.poles(loop.design, zh, ze, loop.real)
        rows.append(
            (
                float(found.real.max(initial=-np.inf)),
                _spectral_radius(loop, zh, ze, period),
                hybrid.delay_margin(loop.design, zh, ze, loop.real),
                _pair_text(zh, ze),
            )
        )
    worst = max(rows, key=lambda r: r[1])
    return Margins(loop.axis, max(r[0] for r in rows), worst[1], min(r[2] for r in rows), worst[3])


def refuse(loops: Iterable[SampledLoop], period: float) -> None:
    """Refuse a controller that must not run.

    Parameters
    ----------
    loops : iterable of Loop
        Its axes; axes that are equal but for their name are checked once.
    period : float
        Of the loop [s].

    Raises
    ------
    ConfigError
        Naming axis, condition and margin.
    """
    seen = set()
    for loop in loops:
        same = replace(loop, axis="")
        if same in seen:
            continue
        seen.add(same)
        _proper(loop)
        for zh, ze in _pairs(loop):
            _stable(loop, zh, ze, period)


def _stable(loop: SampledLoop, zh: Impedance, ze: Impedance, period: float) -> None:
    size, hz = _dominant_mode(loop, zh, ze, period)
    if size <= 1.0 + _GROWTH:
        return
    growth, pair = np.log(size) / period, _pair_text(zh, ze)
    where = f"axis {loop.axis or '-'}, {pair}"
    now = replace(loop.real, forward_s=0.0, backward_s=0.0)
    without = replace(loop, real=now)
    total = loop.real.forward_s + loop.real.backward_s
    if total > 0.0 and _spectral_radius(without, zh, ze, period) <= 1.0 + _GROWTH:
        bears = _sampled_delay_margin(without, zh, ze, period)
        raise ConfigError(
            f"{where}: the round-trip delay of {1e3 * total:.3g} ms is beyond the margin of "
            f"{1e3 * bears:.3g} ms; shorten the delay, or lower c2, c4 and the stiffness"
        )
    pole = hybrid.poles(loop.design, zh, ze, now).real.max(initial=-np.inf)
    if pole > 1e-6:
        raise ConfigError(
            f"{where}: the loop is unstable, a pole at +{pole:.3g} rad/s (it must be negative); "
            "run 'hil design RIG.toml' for the margins"
        )
    raise ConfigError(
        f"{where}: this pair is stable on paper, with its rightmost pole at {pole:.3g} rad/s, "
        f"but not when sampled every {1e3 * period:.3g} ms with these "
        f"filters: a mode of {hz:.3g} Hz grows by {growth:.3g} /s (eigenvalue {size:.5f}, at most "
        f"1); {_advice(loop, hz)}"
    )


def _advice(loop: SampledLoop, hz: float) -> str:
    if any(getattr(loop.design, c).a for c in MOTION):
        return (
            "lower acceleration_hz, or go further from the estimation singularity (smaller c2 c3)"
        )
    if loop.cable and hz > _CABLE_HZ:
        return "it is the cable between motor and tip: lower the damping of c7 and c8"
    return "lower the gains, or raise velocity_hz and force_hz"


def _pairs(loop: SampledLoop) -> Iterable[tuple[Impedance, Impedance]]:
    return product(loop.operators, loop.environments)


def _pair_text(zh: Impedance, ze: Impedance) -> str:
    def one(z: Impedance) -> str:
        return f"{z.m:g} kg, {z.b:g} N s/m, {z.k:g} N/m"

    return f"operator ({one(zh)}), environment ({one(ze)})"
