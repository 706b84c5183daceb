"""Controllers of the Extended Lawrence Architecture on one axis, and the named designs among them.

A design is its gains c1..c8 and how they are realised; `DESIGNS` is one table of the named ones:
what each asks for and the gains it gives.  Then transparency: which condition a design meets, which
it misses, and every family that meets all.

Theorem (necessary and sufficient for Class I controllers, thesis 4.2.1; derived in this form):
f_m = kf f_s and v_s = kp v_m for every operator and environment if and only if

    c1 = kp (z_cs + c7),   c2 = kf (1 + c6),   kf c3 = 1 + c5,   kp c4 = -(z_cm + c8)

and the ports are determined, c1 c2 - c3 c4 != 0.  The local gains c5..c8 are free.

Thesis sections 3.2 and 3.5; D. A. Lawrence, IEEE Trans. Robot. Autom. 9(5), 1993.  Channel
numbers: c1 v_m -> slave, c2 f_s -> master, c3 f_m -> slave, c4 v_s -> master (forward and back);
c5 slave's own force, c6 master's own force, c7 slave's own motion, c8 master's own motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from typing import Any

import numpy as np

from hil.errors import ConfigError, unknown
from hil.teleop.rational import Rational

MOTION = ("c1", "c4", "c7", "c8")
FORCE_GAINS = ("c2", "c3", "c5", "c6")


@dataclass(frozen=True)
class MotionTerm:
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

    def __add__(self, other: MotionTerm) -> MotionTerm:
        return MotionTerm(self.k + other.k, self.b + other.b, self.a + other.a)

    def __mul__(self, x: float) -> MotionTerm:
        # + 0.0: nothing has no sign
        return MotionTerm(self.k * x + 0.0, self.b * x + 0.0, self.a * x + 0.0)

    def __neg__(self) -> MotionTerm:
        return self * -1.0

    def size(self) -> float:
        """Largest coefficient in magnitude, whatever its unit."""
        return max(abs(self.k), abs(self.b), abs(self.a))


@dataclass(frozen=True)
class RobotImpedance:
    """Controlled robot on one axis, z(s) = m s + b.

    Parameters
    ----------
    m, b : float
        Mass [kg] and damping [N s/m] at the tip.
    """

    m: float = 0.1
    b: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.m < np.inf or not 0.0 <= self.b < np.inf:
            raise ConfigError(f"robot: m = {self.m} kg must be positive, b = {self.b} not negative")

    @property
    def term(self) -> MotionTerm:
        """Impedance as a term."""
        return MotionTerm(0.0, self.b, self.m)


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
            if not 0.0 <= getattr(self, f.name) < np.inf:
                raise ConfigError(
                    f"{f.name} = {getattr(self, f.name)} must be finite, not negative"
                )

    def held(self, period: float) -> Realisation:
        """The same with the delays that a loop has: whole ticks of a period [s]."""
        forward, backward = (ticks(x, period) * period for x in (self.forward_s, self.backward_s))
        return replace(self, forward_s=forward, backward_s=backward)


def ticks(seconds: float, period: float) -> int:
    """First tick of a period [s] by which what takes so many seconds has arrived."""
    return math.ceil(seconds / period - _ROUND)


#: Part of a tick that is rounding: 5 ms are five ticks of 1 ms.
_ROUND = 1e-6
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

    c1: MotionTerm = MotionTerm()
    c2: float = 0.0
    c3: float = 0.0
    c4: MotionTerm = MotionTerm()
    c5: float = 0.0
    c6: float = 0.0
    c7: MotionTerm = MotionTerm()
    c8: MotionTerm = MotionTerm()
    master: RobotImpedance = field(default_factory=RobotImpedance)
    slave: RobotImpedance = field(default_factory=RobotImpedance)
    name: str = "own"
    motion_scale: float = 1.0
    force_scale: float = 1.0

    @property
    def D(self) -> float:
        """D = (1 + c5)(1 + c6) - c2 c3 = -det Q: zero where the forces cannot be estimated."""
        return (1.0 + self.c5) * (1.0 + self.c6) - self.c2 * self.c3


def require_finite(design: Design) -> None:
    """Refuse a design with a gain that is no finite number.

    Raises
    ------
    ConfigError
        Naming the gain.
    """
    for name in (*MOTION, *FORCE_GAINS):
        value = getattr(design, name)
        term = value if isinstance(value, MotionTerm) else MotionTerm(0.0, value)
        if not np.isfinite([term.k, term.b, term.a]).all():
            raise ConfigError(
                f"design {design.name!r}: {name} = {value} is not finite; every gain must be a "
                "finite number"
            )


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
        Laplace variable [rad/s]; `Rational.s()` gives rational blocks, which have no delay.
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
    if isinstance(s, Rational):
        raise ConfigError(
            f"a delay of {1e3 * seconds:g} ms is no rational function of s; 'hybrid.poles' and "
            "'hybrid.delay_margin' know loops with a delay, or leave forward_s and backward_s at 0"
        )
    return np.exp(-seconds * s)


@dataclass(frozen=True)
class Wish:
    """What a named design is made from.

    Parameters
    ----------
    stiffness, damping : float
        Position loop of the slave, K [N/m] and B [N s/m].
    master_stiffness, master_damping : float
        The same of the master, where the design has one.
    share : float
        Factor on the force channels c2, c3 of the transparent designs: 1 is transparent.
    slave_force, master_force : float
        Local force gains c5, c6 where the design leaves them free.
    motion_scale, force_scale : float
        kp and kf.
    master, slave : Robot
        Controlled robots.
    """

    stiffness: float = 200.0
    damping: float = 1.0
    master_stiffness: float = 200.0
    master_damping: float = 1.0
    share: float = 1.0
    slave_force: float = 0.0
    master_force: float = 0.0
    motion_scale: float = 1.0
    force_scale: float = 1.0
    master: RobotImpedance = field(default_factory=RobotImpedance)
    slave: RobotImpedance = field(default_factory=RobotImpedance)

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, float) and not np.isfinite(value):
                raise ConfigError(f"{f.name} = {value} must be a finite number")
        for name in ("stiffness", "damping", "master_stiffness", "master_damping"):
            if getattr(self, name) < 0.0:
                raise ConfigError(f"{name} = {getattr(self, name)} must not be negative")
        if self.motion_scale <= 0.0 or self.force_scale <= 0.0:
            raise ConfigError("motion_scale and force_scale must be positive")


def position_error(w: Wish) -> Design:
    """Both robots pulled to each other; no force is used."""
    pull = MotionTerm(w.stiffness, w.damping)
    back = MotionTerm(w.master_stiffness, w.master_damping)
    return Design(c1=pull * w.motion_scale, c4=-(back * (1 / w.motion_scale)), c7=pull, c8=back)


def position_force(w: Wish) -> Design:
    """Slave follows the master's position, master feels the slave's force."""
    pull = MotionTerm(w.stiffness, w.damping)
    return Design(
        c1=pull * w.motion_scale,
        c2=w.force_scale * w.share,
        c7=pull,
        c8=MotionTerm(0, w.master_damping),
    )


def _transparent(w: Wish, c5: float, c6: float, c7: MotionTerm, c8: MotionTerm) -> Design:
    """Channels that the theorem demands for given local loops."""
    kp, kf = w.motion_scale, w.force_scale
    return Design(
        c1=(w.slave.term + c7) * kp,
        c2=kf * (1 + c6) * w.share,
        c3=(1 + c5) / kf * w.share,
        c4=-(w.master.term + c8) * (1 / kp),
        c5=c5,
        c6=c6,
        c7=c7,
        c8=c8,
    )


def _inner_loops(w: Wish) -> tuple[float, float, MotionTerm, MotionTerm]:
    return (
        w.slave_force,
        w.master_force,
        MotionTerm(w.stiffness, w.damping),
        MotionTerm(w.master_stiffness, w.master_damping),
    )


def four_channel(w: Wish) -> Design:
    """All four channels; local loops free."""
    return _transparent(w, *_inner_loops(w))


def three_channel_1(w: Wish) -> Design:
    """Without v_m -> slave: c7 = -z_cs."""
    c5, c6, _, c8 = _inner_loops(w)
    return _transparent(w, c5, c6, -w.slave.term, c8)


def three_channel_2(w: Wish) -> Design:
    """Without f_s -> master: c6 = -1."""
    c5, _, c7, c8 = _inner_loops(w)
    return _transparent(w, c5, -1.0, c7, c8)


def three_channel_3(w: Wish) -> Design:
    """Without f_m -> slave: c5 = -1."""
    _, c6, c7, c8 = _inner_loops(w)
    return _transparent(w, -1.0, c6, c7, c8)


def three_channel_4(w: Wish) -> Design:
    """Without v_s -> master: c8 = -z_cm."""
    c5, c6, c7, _ = _inner_loops(w)
    return _transparent(w, c5, c6, c7, -w.master.term)


def motion_forward(w: Wish) -> Design:
    """Two channels, velocity forward and force back: c3 = c4 = 0, c5 = -1, c8 = -z_cm."""
    _, c6, c7, _ = _inner_loops(w)
    return _transparent(w, -1.0, c6, c7, -w.master.term)


def force_forward(w: Wish) -> Design:
    """Two channels, force forward and velocity back: c1 = c2 = 0, c6 = -1, c7 = -z_cs."""
    c5, _, _, c8 = _inner_loops(w)
    return _transparent(w, c5, -1.0, -w.slave.term, c8)


#: name -> maker.
DESIGNS: dict[str, Callable[[Wish], Design]] = {
    "position-error": position_error,
    "position-force": position_force,
    "four-channel": four_channel,
    "three-channel-1": three_channel_1,
    "three-channel-2": three_channel_2,
    "three-channel-3": three_channel_3,
    "three-channel-4": three_channel_4,
    "motion-forward": motion_forward,
    "force-forward": force_forward,
}


def named_design(name: str, wish: Wish | None = None) -> Design:
    """Named design for a wish.

    Raises
    ------
    ConfigError
        If there is no design of this name.
    """
    if name not in DESIGNS:
        raise ConfigError(unknown("design", name, DESIGNS))
    w = wish or Wish()
    return replace(
        DESIGNS[name](w),
        name=name,
        master=w.master,
        slave=w.slave,
        motion_scale=w.motion_scale,
        force_scale=w.force_scale,
    )


#: Channel -> the local gain that replaces it, and the value that makes it vanish.
LOCAL = {
    "c1": ("c7", "-z_cs"),
    "c2": ("c6", "-1"),
    "c3": ("c5", "-1"),
    "c4": ("c8", "-z_cm"),
}
_EQUATIONS = {
    "c1": "c1 = kp (z_cs + c7)",
    "c2": "c2 = kf (1 + c6)",
    "c3": "kf c3 = 1 + c5",
    "c4": "kp c4 = -(z_cm + c8)",
    "rank": "c1 c2 - c3 c4 != 0",
}
#: A condition holds if its two sides agree to this share of the larger one.
_TOLERANCE = 1e-9
#: Coefficients below this part of the largest are rounding, and not said.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class TransparencyCondition:
    """One condition of the theorem.

    Parameters
    ----------
    name, equation : str
        Channel, or ``"rank"``; what it demands.
    holds : bool
        Whether it is met.
    gap : float
        Largest difference of its two sides relative to the larger (for ``rank``: the size of
        c1 c2 - c3 c4 relative to its terms).
    text : str
        What to change.
    """

    name: str
    equation: str
    holds: bool
    gap: float
    text: str


@dataclass(frozen=True)
class Family:
    """One family of transparent controllers.

    Parameters
    ----------
    channels : tuple of str
        The channels that it uses.
    local : dict of str to str
        Local gains that replace the others.
    free : tuple of str
        Local gains that may be chosen.
    condition : str
        What must not vanish.
    """

    channels: tuple[str, ...]
    local: dict[str, str]
    free: tuple[str, ...]
    condition: str


def _wanted(design: Design) -> dict[str, MotionTerm]:
    """c1..c4 that the theorem demands for the local gains of this design."""
    kp, kf = design.motion_scale, design.force_scale
    return {
        "c1": (design.slave.term + design.c7) * kp,
        "c2": MotionTerm(0.0, kf * (1.0 + design.c6)),
        "c3": MotionTerm(0.0, (1.0 + design.c5) / kf),
        "c4": -(design.master.term + design.c8) * (1.0 / kp),
    }


def conditions(design: Design) -> list[TransparencyCondition]:
    """All five conditions with their gaps, the missed ones saying what to change."""
    goal = _wanted(design)
    found = []
    for name in LOCAL:
        value = getattr(design, name)
        have = value if isinstance(value, MotionTerm) else MotionTerm(0.0, value)
        difference = (have + (-goal[name])).size()
        gap = difference / max(have.size(), goal[name].size(), 1e-300)
        holds = gap <= _TOLERANCE or difference <= _TOLERANCE
        text = "" if holds else f"{name} is {_said(have)}, it should be {_said(goal[name])}"
        found.append(
            TransparencyCondition(name, _EQUATIONS[name], holds, 0.0 if holds else gap, text)
        )
    return [*found, _rank(design)]


def _rank(design: Design) -> TransparencyCondition:
    one, two = design.c1 * design.c2, design.c4 * design.c3
    gap = (one + (-two)).size() / max(one.size(), two.size(), 1e-300)
    holds = gap > _TOLERANCE
    text = "" if holds else "the channels cancel: the port variables are not determined"
    return TransparencyCondition("rank", _EQUATIONS["rank"], holds, gap, text)


def is_transparent(design: Design) -> bool:
    """Whether all five conditions hold."""
    return all(c.holds for c in conditions(design))


def families(channels: int) -> list[Family]:
    """Every family of transparent controllers with exactly so many channels.

    A vanishing channel needs the local gain of `LOCAL`.  Then c1 c2 - c3 c4 becomes
    (1 + c6)(z_cs + c7) + (1 + c5)(z_cm + c8); c1 or c2 takes its first part, c3 or c4 the
    second, and one of both must be left.

    Parameters
    ----------
    channels : int
        0 to 4.

    Raises
    ------
    ConfigError
        For another number.
    """
    if channels not in range(len(LOCAL) + 1):
        raise ConfigError(f"families of {channels} channels: there are {len(LOCAL)}, give 0 to 4")
    found = []
    for used in combinations(LOCAL, channels):
        gone = [c for c in LOCAL if c not in used]
        first, second = {"c1", "c2"}.isdisjoint(gone), {"c3", "c4"}.isdisjoint(gone)
        if not (first or second):
            continue
        local = {LOCAL[c][0]: LOCAL[c][1] for c in gone}
        parts = [("(1 + c6)(z_cs + c7)", first), ("(1 + c5)(z_cm + c8)", second)]
        condition = " + ".join(text for text, there in parts if there) + " != 0"
        free = tuple(c for c in ("c5", "c6", "c7", "c8") if c not in local)
        found.append(Family(used, local, free, condition))
    return found


def _said(term: MotionTerm) -> str:
    parts = [(term.k, "/s"), (term.b, ""), (term.a, " s")]
    least = _ROUNDING * term.size()
    text = " + ".join(f"{x:.6g}{unit}" for x, unit in parts if abs(x) > least)
    return text.replace("+ -", "- ") or "0"
