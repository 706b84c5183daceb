"""Teleoperation over a channel with delay, jitter and loss, in one of four ways.

operator -> leader --place, speed, energy--> follower -> environment
              ^------- force, energy ------'

`"passivity"`: observer and controller of the channel's energy (Ryu, Artigas & Preusche 2010), with
the goal's drift made up for (Coelho, Singh, Kanoulas & Hulin 2018).  `"waves"`: wave variables as
sums (Niemeyer & Slotine 2004), limited to the energy that arrived (Yokokohji, Imaida & Yoshikawa
1999).  `"tanks"`: two layers with energy tanks (Franken et al. 2011).  `"model"`: model-mediated
(Mitra & Niemeyer 2008), the environment identified at the follower, rendered at the leader.

What the channel gives out is bounded to what was put in by `"waves"`, beside the tanks at the start
by `"tanks"`, and beside `reserve` by `"passivity"`, as far as it counts: the force's work over the
steps of place.  Nothing bounds it with `"model"`, whose follower pushes towards where the leader
was.  Virtual fixtures (`hil.controllers.fixtures`) can stand beside any of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Any

import numba as nb
import numpy as np

from hil.controllers import dynamics, fixtures
from hil.controllers.fixtures import FixtureConfig
from hil.controllers.lawrence_config import AXES, ChannelConfig, schedule
from hil.errors import ConfigError, unknown
from hil.signals.device import FloatArray
from hil.signals.settable import SettableRange
from hil.teleop.sampled_loop import Cable, compliance

# Kernels of the law over a channel with delay: what each side commands, and the energy it counts.
#
# Per axis of the workspace; `T` is the period, `f` the force of the coupling ON the tip it acts on,
# `W` the energy that a side may still give out.  Every packet carries sums, not increments, so that
# a lost packet loses nothing and a late one adds nothing: both ends count what the other has sent.

#: Of an axis of an arm, in the state: where it started; the follower's goal; energies into and out
#: of the channel; sums of what is sent and of what of the other's is used; tank; force; local
#: stiffness and force at the start of the environment, the three numbers of their covariance, the
#: direction of the contact; place at the last tick; the other side's force behind the low-pass, and
#: the share of the force that is let out.
ORIGIN, _GOAL, INTO, OUT, SENT, SENT_POWER, USED, USED_POWER = 0, 1, 2, 3, 4, 5, 6, 7
TANK, FORCE, STIFFNESS, PUSH, _P11, _P12, _P22, TOUCH, LAST = 8, 9, 10, 11, 12, 13, 14, 15, 16
FELT, LET = 17, 18
FIELDS = 19
#: Variance of a force sensor's noise [N^2], and speed from which the tip moves [m/s].
_NOISE, _MOVES = 2.5e-3, 2e-3
#: Corner of the low-pass of the force that the leader feels [Hz], time in which a force that was
#: withheld comes back [s], and how much faster than the leader the goal makes up its drift [m/s].
#: Half: what is felt lags more, a fading force is a spring twice as stiff, and drift lasts longer;
#: double: the loop at the cables' resonance has twice the gain, a force that was withheld is missed
#: for longer, and the follower jolts where its goal was held back.
_FELT_HZ, _RISE, _CATCH = 60.0, 0.05, 0.2
#: Stiffness in units of the expected one below which there is no wall, and how a packet says so.
SOFTEST, NO_WALL = 0.3, 2.0
#: The state before the axes: started, tick of the start.
HEAD = 2
#: Of a packet, per axis: position, speed, force, sum sent, sum of its square, energy put into the
#: channel, stiffness, force at the start, direction of the contact.
_X, _V, F, _SUM, _POWER, _ENERGY, _K, _C, _SIDE = 0, 1, 2, 3, 4, 5, 6, 7, 8
_PACKET = 9
_PASSIVITY, _WAVES, _TANKS, _MODEL = 0, 1, 2, 3


@nb.njit(cache=True, nogil=True)
def drive(goal: float, rate: float, x: float, v: float, p: Any) -> float:
    """Force of the follower's spring and damper: f = K (goal - x) + B (rate - v)."""
    return float(p.stiffness * (goal - x) + p.damping * (rate - v))


@nb.njit(cache=True, nogil=True)
def _allowed(room: float, reserve: float) -> float:
    """Share of a force that the energy left allows: 1 from the reserve on, 0 where none is left.

    It fades with the energy, not with the sign of a noisy speed: the force stays continuous.
    """
    return min(max(room / reserve, 0.0), 1.0)


@nb.njit(cache=True, nogil=True)
def let(room: float, reserve: float, s: Any, n: Any, p: Any) -> float:
    """Share of a force that is let out: it fades at once, and comes back within `_RISE`.

    A force F that fades over an energy E acts as a spring of F^2 / E, which at 8 N and 2 mJ is
    stiffer than any period of a millisecond bears.  One that comes back slowly does not.
    """
    n[LET] = min(_allowed(room, reserve), s[LET] + p.rise)
    return float(n[LET])


@nb.njit(cache=True, nogil=True)
def felt(force: float, s: Any, n: Any, p: Any) -> float:
    """Force of the coupling on the leader: the follower's, behind a low-pass.

    Without it the damper's force goes round through the resonance of a rotor before its cable, at
    about 200 Hz, and grows there: what the operator puts in is energy enough.
    """
    n[FELT] = s[FELT] + p.felt * (-force - s[FELT])
    return float(n[FELT])


@nb.njit(cache=True, nogil=True)
def observed(a: int, x: float, v: float, h: Any, s: Any, n: Any, p: Any) -> float:
    """Passivity observer and controller of one side.

    Leader    E_out(k) = sum max(f(k-1) (x(k) - x(k-1)), 0) <= E_in,follower(k - delay) + reserve
    Follower  the same for the steps of its goal.  The goal follows the leader's place, not its
              speed, so that what is withheld is made up for as energy arrives, at most `_CATCH`
              faster than the leader moves.
    """
    if a == 0:
        work = s[FORCE] * (x - s[LAST])
        n[OUT], n[INTO] = s[OUT] + max(work, 0.0), s[INTO] + max(-work, 0.0)
        return felt(h[F], s, n, p) * let(h[_ENERGY] + p.reserve - n[OUT], p.reserve, s, n, p)
    step, rate = h[_X] - s[_GOAL], h[_V]
    most = (abs(rate) + _CATCH) * p.period
    step = min(max(step, -most), most)
    f = drive(s[_GOAL], rate, x, v, p)
    if f * step > 0.0:
        part = _allowed(h[_ENERGY] + p.reserve - s[OUT], p.reserve)
        step, rate = part * step, part * rate
        f = drive(s[_GOAL] + step, rate, x, v, p)
    work = f * step
    n[OUT], n[INTO] = s[OUT] + max(work, 0.0), s[INTO] + max(-work, 0.0)
    n[_GOAL] = s[_GOAL] + step
    return f


@nb.njit(cache=True, nogil=True)
def arrived(h: Any, s: Any, n: Any, p: Any) -> float:
    """Wave out of the channel: all that has arrived, as far as its energy allows.

    u = (sum sent - sum used) / smooth,  T sum u^2 <= what was sent, for any jitter and loss: what
    arrives at once after a gap is given out within `smooth` seconds.
    """
    wave = (h[_SUM] - s[USED]) / max(p.smooth, p.period)
    room = max((h[_POWER] - s[USED_POWER]) / p.period, 0.0)
    if wave * wave > room:
        wave = sqrt(room) if wave > 0.0 else -sqrt(room)
    n[USED] = s[USED] + wave * p.period
    n[USED_POWER] = s[USED_POWER] + wave * wave * p.period
    return float(wave)


@nb.njit(cache=True, nogil=True)
def waved(a: int, x: float, v: float, h: Any, s: Any, n: Any, p: Any) -> float:
    """Wave variables of one side; b is the impedance of the waves [N s/m].

    Leader    u = sqrt(2 b) v - w,  f = sqrt(2 b) w - b v
    Follower  sqrt(2 b) u = b v_d + f_d,  w = u - sqrt(2/b) f_d,  f_d = K (x_d - x) + B (v_d - v)
    """
    b, root = p.wave, sqrt(2.0 * p.wave)
    wave = arrived(h, s, n, p)
    if a == 0:
        f, back = root * wave - b * v, root * v - wave
    else:
        rate = (root * wave - p.stiffness * (s[_GOAL] - x) + p.damping * v) / (b + p.damping)
        f = drive(s[_GOAL], rate, x, v, p)
        n[_GOAL] = s[_GOAL] + rate * p.period
        back = wave - sqrt(2.0 / b) * f
    n[SENT] = s[SENT] + back * p.period
    n[SENT_POWER] = s[SENT_POWER] + back * back * p.period
    return float(f)


@nb.njit(cache=True, nogil=True)
def tanked(a: int, x: float, v: float, h: Any, s: Any, n: Any, p: Any) -> float:
    """Energy tank of one side: what moves the arm is taken from it, what brakes the arm fills it.

    Each side hands a share of its tank to the other; the leader brakes a little while its tank is
    below the level that is wanted.
    """
    tank = s[TANK] + h[_SUM] - s[USED] - s[FORCE] * (x - s[LAST])
    n[USED] = h[_SUM]
    f = felt(h[F], s, n, p) if a == 0 else drive(h[_X], h[_V], x, v, p)
    f *= let(tank, 0.5 * p.level, s, n, p)
    if a == 0 and tank < p.level:
        f -= p.fill * (p.level - max(tank, 0.0)) * v
    share = max(min(p.share * p.period, 1.0) * tank, 0.0)
    # what is more is given away: a full tank is a licence to be unstable for long
    n[TANK] = min(tank - share, p.level)
    n[SENT] = s[SENT] + share
    return float(f)


@nb.njit(cache=True, nogil=True)
def _learn(x: float, v: float, force: float, s: Any, n: Any, p: Any) -> None:
    """Environment of the follower by recursive least squares with forgetting: f = c - k x.

    Only in contact, and only while it moves.  A contact begins anew, from a surface where the
    force was first felt, so that one wall is not the last one.
    """
    if abs(force) < p.touch:
        n[TOUCH] = 0.0
        return
    if s[TOUCH] == 0.0:
        n[STIFFNESS], n[PUSH] = p.expected, force + p.expected * x
        # of a prior as wide as the stiffness, over the sensor's noise
        n[_P11], n[_P12], n[_P22] = p.expected**2 / _NOISE, 0.0, 0.1 / _NOISE
    n[TOUCH] = 1.0 if force > 0.0 else -1.0
    if abs(v) < _MOVES:
        return
    # r = (-x, 1):  g = P r / (lambda + r' P r),  theta += g (f - r' theta),  P = (P - g r' P) / l
    a, b, c = n[_P11], n[_P12], n[_P22]
    r1, r2 = -x * a + b, -x * b + c
    scale = p.forget + (-x * r1 + r2)
    miss = force - (n[PUSH] - n[STIFFNESS] * x)
    n[STIFFNESS] += r1 / scale * miss
    n[PUSH] += r2 / scale * miss
    # without forgetting where that would let the covariance grow beyond the prior's
    keep = p.forget if a < p.expected**2 / _NOISE and c < 0.1 / _NOISE else 1.0
    n[_P11] = (a - r1 * r1 / scale) / keep
    n[_P12] = (b - r1 * r2 / scale) / keep
    n[_P22] = (c - r2 * r2 / scale) / keep


@nb.njit(cache=True, nogil=True)
def modelled(a: int, x: float, v: float, force: float, h: Any, s: Any, n: Any, p: Any) -> float:
    """Model-mediated: the leader feels the environment's model at once, the follower follows.

    The model changes at the leader within `blend` seconds, where that gives it no energy.
    """
    if a == 1:
        _learn(x, v, force, s, n, p)
        return drive(h[_X], h[_V], x, v, p)
    if h[_SIDE] == NO_WALL:
        n[STIFFNESS] = s[STIFFNESS] * (1.0 - p.period / p.blend)
    elif h[_SIDE] != 0.0:
        known, stiffness, surface = n[TOUCH] != 0.0, min(h[_K], p.stiffest), h[_C] / h[_K]
        part = p.period / p.blend if known else 1.0
        n[STIFFNESS] = s[STIFFNESS] + part * (stiffness - s[STIFFNESS])
        n[PUSH] = s[PUSH] + part * (surface - s[PUSH])
        n[TOUCH] = h[_SIDE]
    f = n[STIFFNESS] * (n[PUSH] - x)
    if f * n[TOUCH] <= 0.0:
        return 0.0
    f -= p.brake * v
    return float(f) if f * n[TOUCH] > 0.0 else 0.0


@nb.njit(cache=True, nogil=True)
def side(a: int, i: int, u: Any, heard: Any, s: Any, n: Any, p: Any, w: Any) -> float:
    """Force that arm `a` gets along axis `i`."""
    x, v, h = w.place[a, i], w.speed[a, i], heard[i]
    if p.scheme == _PASSIVITY:
        return observed(a, x, v, h, s, n, p)
    if p.scheme == _WAVES:
        return waved(a, x, v, h, s, n, p)
    if p.scheme == _TANKS:
        return tanked(a, x, v, h, s, n, p)
    return modelled(a, x, v, u[a, 6 + i], h, s, n, p)


@nb.njit(cache=True, nogil=True)
def law(
    tick: int,
    x: Any,
    u: Any,
    p: Any,
    walls: Any,
    line: Any,
    ages: Any,
    w: Any,
    x_next: Any,
    y: Any,
) -> None:
    """One period of `hil.controllers.delayed.Delayed`.

    Parameters
    ----------
    tick : int
        Number of the tick, from 1.
    x, x_next : ndarray (HEAD + 6 FIELDS,)
        State: started, tick of the start, then the fields of every axis of leader and follower.
    u : ndarray (2, 12)
        Leader, follower.
    walls : ndarray (k, fixtures.SIZE)
        Virtual fixtures of the leader.
    line : ndarray (2, length, 3, PACKET)
        What each arm has sent; slot tick % length.
    ages : ndarray (2, CYCLE)
        Age in ticks of what leader and follower act on.
    """
    x_next[0] = 1.0
    x_next[1] = x[1] if x[0] > 0.0 else tick
    for a in range(2):
        dynamics.forward_kinematics(u[a], p.lengths, w.place[a])
        dynamics.jacobian(u[a], p.lengths, w.jacobian[a])
        for i in range(3):
            at = HEAD + FIELDS * (3 * a + i)
            x_next[at : at + FIELDS] = x[at : at + FIELDS]
            if x[0] == 0.0:
                x_next[at + ORIGIN] = w.place[a, i]
                x_next[at + TANK], x_next[at + LET] = p.level, 1.0
            w.place[a, i] -= x_next[at + ORIGIN]
            w.speed[a, i] = 0.0
            for j in range(3):
                w.speed[a, i] += w.jacobian[a, i, j] * u[a, 3 + j]
    for a in range(2):
        age = ages[a, tick % ages.shape[1]]
        # what was sent before the start counts from another origin
        if tick - age < x_next[1] + 1.0:
            w.heard[:] = 0.0
        else:
            w.heard[:] = line[1 - a, (tick - age) % line.shape[1]]
        for i in range(3):
            at = HEAD + FIELDS * (3 * a + i)
            n = x_next[at : at + FIELDS]
            # the state of the last tick, with what the start has set
            w.past[:] = n
            f = side(a, i, u, w.heard, w.past, n, p, w)
            n[FORCE], n[LAST] = f, w.place[a, i]
            w.force[a, i] = p.scale * f if a == 0 else f
    for a in range(2):
        for i in range(3):
            at = HEAD + FIELDS * (3 * a + i)
            n, out = x_next[at : at + FIELDS], line[a, tick % line.shape[1], i]
            out[_X], out[_V], out[F] = w.place[a, i], w.speed[a, i], n[FORCE]
            out[_SUM], out[_POWER], out[_ENERGY] = n[SENT], n[SENT_POWER], n[INTO]
            out[_K], out[_C], out[_SIDE] = n[STIFFNESS], n[PUSH], n[TOUCH]
            # what hardly grows with the depth is friction along a wall, and has no surface
            if n[TOUCH] != 0.0 and n[STIFFNESS] < SOFTEST * p.expected:
                out[_SIDE] = NO_WALL
    fixtures.fixture_force(walls, w.place[0], w.speed[0], w.out, w.force[0])
    for a in range(2):
        for j in range(3):
            y[a, j] = w.gravity[a, j] - (p.leader_damping * u[0, 3 + j] if a == 0 else 0.0)
            for i in range(3):
                y[a, j] += w.jacobian[a, i, j] * w.force[a, i]


SCHEMES = ("passivity", "waves", "tanks", "model")
#: Beside the jitter, time in which what has gathered in a channel is given out [s].
GATHERED = 0.02
_F = np.float64


@dataclass(frozen=True)
class WallConfig:
    """Virtual fixture: a plane that the leader must not pass.

    Parameters
    ----------
    normal : tuple of 3 floats
        Out of the wall, in the base frame; any length but 0.
    place : float
        Distance of the plane behind the tip's start along the normal [m].
    stiffness, damping : float
        [N/m], [N s/m]; stiffness 0: no wall.
    """

    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    place: float = 0.01
    stiffness: float = 0.0
    damping: float = 0.0

    def fixture(self) -> FixtureConfig:
        """The same among the other fixtures."""
        behind = -self.place * np.asarray(self.normal) / np.linalg.norm(self.normal)
        place = float(behind[0]), float(behind[1]), float(behind[2])
        return FixtureConfig("wall", place, self.normal, 0.0, self.stiffness, self.damping)


@dataclass(frozen=True)
class DelayedConfig:
    """Parameters of the law.

    Parameters
    ----------
    scheme : str
        ``"passivity"``, ``"waves"``, ``"tanks"`` or ``"model"``.
    stiffness, damping : float
        Of the follower's drive to its goal [N/m], [N s/m].
    force_scale : float
        Share of the coupling's force that the leader feels.
    leader_damping : float
        Added joint damping of the leader [N m s/rad].
    forward, backward : table
        Channels leader -> follower and back: delay, jitter [s], loss.
    seed : int
        Of jitter and loss.
    reserve : float
        Energy that the channel may give out before any has come in, an axis and side [J]
        (``"passivity"``).
    wave, smooth : float
        Impedance of the waves [N s/m], what free motion feels; time in which what has gathered
        behind lost and late packets is given out [s]; 0: as long as the channel's jitter and 20 ms
        more (``"waves"``).
    level, share, fill : float
        Energy that a tank should hold [J], share of it that goes to the other side [1/s], and the
        leader's brake while less is in its tank [N s/m an J] (``"tanks"``).
    touch, forget, expected, blend, stiffest, brake : float
        Force from which there is contact [N], forgetting factor of a tick, stiffness that a new
        contact begins with [N/m], time in which the leader's model follows the follower's [s], and
        the stiffest that it renders [N/m] and the damping beside it [N s/m] (``"model"``).
    wall : table
        One wall beside the fixtures.
    fixtures : list of tables
        Virtual fixtures of the leader, see `hil.controllers.fixtures`.
    lengths : tuple of 2 floats
        Nominal l1, l2 [m].
    leader_gravity, follower_gravity : tuple of 2 floats
        Nominal gravity: g2 cos th2, g3 sin th3 [N m].
    """

    scheme: str = "passivity"
    stiffness: float = 200.0
    damping: float = 1.5
    force_scale: float = 1.0
    leader_damping: float = 0.004
    forward: ChannelConfig = field(default_factory=ChannelConfig)
    backward: ChannelConfig = field(default_factory=ChannelConfig)
    seed: int = 0
    reserve: float = 5e-3
    wave: float = 1.5
    smooth: float = 0.0
    level: float = 0.004
    share: float = 10.0
    fill: float = 250.0
    touch: float = 0.15
    forget: float = 0.998
    expected: float = 100.0
    blend: float = 0.05
    stiffest: float = 500.0
    brake: float = 1.0
    wall: WallConfig = field(default_factory=WallConfig)
    fixtures: tuple[FixtureConfig, ...] = ()
    lengths: tuple[float, float] = dynamics.LINK_LENGTHS
    leader_gravity: tuple[float, float] = (0.12, 0.03)
    follower_gravity: tuple[float, float] = (0.0, -0.06)

    def __post_init__(self) -> None:
        if self.scheme not in SCHEMES:
            raise ConfigError(unknown("scheme", self.scheme, SCHEMES))
        positive = (
            "reserve",
            "stiffness",
            "damping",
            "wave",
            "level",
            "share",
            "expected",
            "blend",
            "stiffest",
        )
        for name in positive:
            _need(name, getattr(self, name), getattr(self, name) > 0.0, "above 0")
        for name in ("force_scale", "leader_damping", "smooth", "fill", "touch", "brake", "seed"):
            _need(name, getattr(self, name), getattr(self, name) >= 0.0, "0 or more")
        _need("forget", self.forget, 0.9 <= self.forget < 1.0, "within 0.9 and 1")
        _need("lengths", min(self.lengths), min(self.lengths) > 0.0, "above 0")
        wall = self.wall
        _need("wall.normal", max(map(abs, wall.normal)), any(wall.normal), "a direction")
        for name in ("stiffness", "damping"):
            value = getattr(wall, name)
            _need(f"wall.{name}", value, value >= 0.0, "0 or more")

    def settable(self) -> dict[str, SettableRange]:
        """What an operator may set; none of it lets the channel give out more."""
        return {
            "force_scale": SettableRange(0.0, 1.0),
            "leader_damping": SettableRange(0.0, 0.05, "N m s/rad"),
        }


def _need(name: str, value: float, fine: bool, wanted: str) -> None:
    if not (fine and math.isfinite(value)):
        raise ConfigError(f"delayed: {name} = {value:g}; {wanted} is needed.")


def lowpass(period: float) -> float:
    """Share of a new value in the low-pass of the force that the leader feels."""
    return 1.0 - math.exp(-2.0 * math.pi * _FELT_HZ * period)


def constants(config: DelayedConfig, period: float) -> Any:
    """Record of what does not change, for the kernels."""
    numbers = (
        "stiffness damping leader_damping reserve wave smooth level share fill touch forget "
        "expected blend stiffest brake"
    ).split()
    kind = np.dtype(
        [(name, _F) for name in numbers]
        + [
            ("scheme", np.int64),
            ("scale", _F),
            ("period", _F),
            ("lengths", _F, (2,)),
            ("felt", _F),
            ("rise", _F),
        ]
    )
    c = np.zeros(1, kind)[0]
    for name in numbers:
        c[name] = getattr(config, name)
    ways = config.forward, config.backward
    if config.smooth == 0.0:  # a tick is a delay: waves that are given out at once ring
        c["smooth"] = max(way.jitter for way in ways) + GATHERED
    c["scheme"], c["scale"] = SCHEMES.index(config.scheme), config.force_scale
    c["period"], c["lengths"] = period, config.lengths
    c["rise"], c["felt"] = period / _RISE, lowpass(period)
    return c


#: Scratch of one tick.
_WORK = np.dtype(
    [
        ("place", _F, (2, 3)),
        ("speed", _F, (2, 3)),
        ("jacobian", _F, (2, 3, 3)),
        ("force", _F, (2, 3)),
        ("gravity", _F, (2, 3)),
        ("out", _F, (3,)),
        ("heard", _F, (3, _PACKET)),
        ("past", _F, (FIELDS,)),
    ]
)
_NAMES = (
    "origin goal energy_in energy_out sent sent_power used used_power tank force "
    "environment_stiffness environment_push p11 p12 p22 contact place felt let"
).split()


#: What a drive's encoder sees at once: the rotor before its cable [kg], 10.3 g cm^2 behind gears of
#: 11 to 13 at 0.2 m.
ROTOR = 0.0035


def borne(period: float) -> float:
    """K T + 2 B that a sampled spring and damper on the rotor may ask for [N s/m].

    K T + 2 B < 2 m / T (Colgate & Schenkel 1997).
    """
    return 2.0 * ROTOR / period


def asked(config: DelayedConfig, period: float) -> dict[str, float]:
    """K T + 2 B [N s/m] of every spring and damper that the law renders, by what sets it."""
    waves, model = config.scheme == "waves", config.scheme == "model"
    rows = [
        ("stiffness and damping", config.stiffness, config.damping),
        ("wave, the leader's damper,", 0.0, config.wave if waves else 0.0),
        ("fill level, the leader's brake,", 0.0, config.fill * config.level),
        ("stiffest and brake", *((config.stiffest, config.brake) if model else (0.0, 0.0))),
        ("wall.stiffness and wall.damping", config.wall.stiffness, config.wall.damping),
        *((f"fixture {f.kind}", f.stiffness, f.damping) for f in config.fixtures),
    ]
    return {what: k * period + 2.0 * b for what, k, b in rows if k or b}


#: Both arms of a loop through the channel: a cable between rotor and tip as seen there, tip masses
#: from a bare follower to a leader with its sensor [kg], and what friction damps for certain
#: [N s/m].
_CABLE, _TIPS, _RUB = Cable(3500.0, 0.5, ROTOR), (0.035, 0.13), 0.2
#: What a hand does not do [Hz].
FAST_HZ = 40.0


def ringing(config: DelayedConfig, period: float) -> float:
    """Gain round leader, channel and follower above 40 Hz; from 1 on the loop rings at some delay.

    L = scale F P_l C / (1 + C P_f),  C = K + B (1 - 1/z) / T, F the low-pass of the leader's force,
    P_l and P_f an effort's way to the encoder.  What bounds energy does not stop it: an operator
    who moves puts in more than it takes.  0 where no force goes round.
    """
    if config.scheme not in ("passivity", "tanks"):
        return 0.0
    hz = np.geomspace(FAST_HZ, max(0.48 / period, 2.0 * FAST_HZ), 150)
    back = np.exp(-2j * np.pi * hz * period)
    drive = config.stiffness + config.damping * (1.0 - back) / period
    share = lowpass(period)
    ahead = config.force_scale * np.abs(share / (1.0 - (1.0 - share) * back) * drive)
    arms = [compliance(m, _RUB, _CABLE, hz, period) for m in _TIPS]
    return float(max(np.max(ahead * np.abs(p / (1.0 + drive * q))) for p in arms for q in arms))


def refuse_ringing(config: DelayedConfig, period: float) -> None:
    """Refuse a drive whose force rings round the channel, with the nearest one that does not."""
    gain = ringing(config, period)
    if gain < 1.0:
        return
    said = (
        f"delayed: stiffness = {config.stiffness:g} N/m and damping = {config.damping:g} N s/m "
        f"ring between leader and follower: the gain round the loop is {gain:.3g} at the cables' "
        "resonance, where it must be below 1"
    )

    def other(name: str, value: float) -> DelayedConfig:
        stiff = name == "stiffness"
        return replace(config, stiffness=value) if stiff else replace(config, damping=value)

    for name in ("stiffness", "damping"):
        low, high = 0.0, float(getattr(config, name))
        for _ in range(30):
            middle = 0.5 * (low + high)
            fine = ringing(other(name, middle), period) < 1.0
            low, high = (middle, high) if fine else (low, middle)
        if low > 0.0:
            raise ConfigError(f"{said}; the nearest that may run is {name} = {_below(low):g}")
    raise ConfigError(f"{said}; lower stiffness and damping, or force_scale")


def _below(value: float) -> float:
    """The value with two digits, rounded down."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / step) * step:.3g}")


class Delayed:
    """The law with its parameters; see `law`.

    Parameters
    ----------
    config : DelayedConfig
        Parameters.
    arms : tuple of str
        Two names: leader, follower.
    period : float
        Of the loop [s].

    Raises
    ------
    ConfigError
        If there are not two arms, or a spring and damper of the law is too much for the period.
    """

    state_names = (
        "started",
        "start",
        *(f"{arm}_{axis}_{n}" for arm in ("leader", "follower") for axis in AXES for n in _NAMES),
    )

    def __init__(self, config: DelayedConfig, arms: tuple[str, ...], period: float) -> None:
        if len(arms) != 2:
            raise ConfigError(f"delayed needs leader and follower, not {len(arms)} arms.")
        most = borne(period)
        for what, value in asked(config, period).items():
            if value >= most:
                raise ConfigError(
                    f"delayed: {what} ask for K T + 2 B = {value:.3g} N s/m at a "
                    f"period of {1e3 * period:g} ms; below {most:g} N s/m is needed, or a shorter "
                    "period"
                )
        refuse_ringing(config, period)
        self.config, self.period = config, period
        # the other schemes feel the coupling, not a sensor
        self.needs_force = (1,) if config.scheme == "model" else ()
        ways = enumerate((config.backward, config.forward))
        # what is sent at the end of a tick is heard at the next one, at the earliest
        sent = [schedule(way, period, config.seed + k) for k, way in ways]
        self._ages = np.maximum(np.stack(sent), 1)
        self._line = np.zeros((2, int(self._ages.max()) + 2, 3, _PACKET))
        self._c = constants(config, period)
        self._w = np.zeros(1, _WORK)[0]
        wall = (config.wall.fixture(),) if config.wall.stiffness else ()
        self._walls = fixtures.fixture_records((*wall, *config.fixtures))
        self._gravity = np.array([config.leader_gravity, config.follower_gravity])

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period; see `hil.signals.device.Controller`.

        The channel's memory is filled by tick number: the same call gives the same answer.
        """
        gravity = self._w["gravity"]
        gravity[:, 1] = self._gravity[:, 0] * np.cos(u[:, 1])
        gravity[:, 2] = self._gravity[:, 1] * np.sin(u[:, 2])
        tick = round(t / self.period)
        law(tick, x, u, self._c, self._walls, self._line, self._ages, self._w, x_next, y)


Config = DelayedConfig
build = Delayed
