"""Errors of what is measured and commanded: force sensor, filters, amplifiers.

The force sensor says w_m where w acts.  What is fitted is  tau + tau_ext,m = model + J' (w_m - w),
so an error of the sensor is a column J' e on the model's side, e its error for unit coefficient.

Its channels lie along the axes of the base (a sensor under the object, or one whose reading is
turned in its own electronics) or of the tip (a sensor on the last link).  Without a wrench at the
tip the sensors are one a joint and J is the unit matrix.

The motor and its amplifier change a command: delay, lag, ripple that scales with it, a scale that
varies with speed or place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from hil.models.effect import (
    STRICT,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Of,
    Over,
    Param,
    Relations,
    Scope,
    Shapes,
    Trait,
    Twin,
    Waves,
    log_grid,
    position_orders,
    typical_speed,
)
from hil.models.friction import harmonics
from hil.models.kernels import delayed, lag
from hil.models.motion import FloatArray, Motion
from hil.models.parts import GAIN_CHANGES, POLES, TELLING_PUSH

_AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
#: Values of the shape parameter `frame`.
_BASE, _TIP = 0.0, 1.0
#: Cause of every lateness.
LATENESS = ("lateness",)
#: The whole effort is late, not a part of it; the margin is for errors of the form.
_WHOLE = Param("a", "1", "share of the effort that is late: 1 but for errors", 0.9, 1.1)


def late_grid(motion: Motion, j: int) -> Shapes:
    """Time constants of one pole, then of two, 0.5 to 60 ms late in all."""
    return [(t / n, n) for n in (1.0, 2.0) for (t,) in log_grid(5e-4, 0.06, 14)]


def _lag_grid(motion: Motion, j: int) -> Shapes:
    """The same to 200 ms: valves, propellers and muscles of air are slower than motors."""
    return [(t / n, n) for n in (1.0, 2.0) for (t,) in log_grid(5e-4, 0.2, 17)]


def _delay_grid(motion: Motion, j: int) -> Shapes:
    """0.5 to 60 ms: a slower motor is no motor."""
    return log_grid(5e-4, 0.06, 14)


class Delay(Effect):
    """The command acts late."""

    name, family = "delay", "actuator"
    doc = Doc(
        equation="tau(t) = model(t) + a (tau(t) - tau(t - T))",
        signature="phase that grows with frequency, loops over acceleration and at reversals",
        confused_with=("actuator-lag", "presliding", "filter-lag"),
        shown_by="fast motion; chirp",
        source="Naerum thesis 1.3 (transmission delay)",
        over=Over.EFFORT_RATE,
    )
    params = (_WHOLE,)
    shape = (Param("T", "s", "delay", 0.0, size=True),)
    relations = Relations(causes=LATENESS)
    search = Grid(_delay_grid)
    limits = (STRICT,)
    traits = Trait.REPLAYED | Trait.LATE | Trait.SHIFTS

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Command less its copy of T ago."""
        tau = motion.tau[:, j]
        return (tau - delayed(tau, float(shape[0]) / motion.dt))[:, None]


def _record_delay_lacks(motion: Motion, j: int) -> str:
    """Efforts that are all late are aligned before the first fit."""
    if motion.d > 1:
        return ""
    return (
        "the efforts of a single joint that were recorded late are taken earlier before the fit, "
        "as those of all joints are"
    )


def _record_delay_of_samples(f: Fitted) -> bool:
    """By a sample at least: what is less may be friction under load that turns a count late."""
    return float(f.shape[0]) >= f.motion.dt


class RecordDelay(Effect):
    """The effort of one joint was recorded late: by a slower bus, or a filter of its drive.

    No joint moves before its motor pushes, so that an effort behind its motion is the record's.
    """

    name, family = "record-delay", "sensor"
    doc = Doc(
        equation="tau(t) = model(t) + a (tau(t) - tau(t + T))",
        signature="an effort that follows the motion, on one joint beside others that are in time",
        confused_with=("elastic-transmission", "vibration-mode", "presliding"),
        shown_by="fast motion of this joint; chirp",
        source="Gautier, Vandanjon, Presse, CDC 1994 (filtering in identification)",
        over=Over.EFFORT_RATE,
    )
    params = (_WHOLE,)
    shape = (Param("T", "s", "by how much it was recorded late", 0.0, size=True),)
    scope = Scope(lacks=_record_delay_lacks)
    relations = Relations(causes=LATENESS)
    search = Grid(_delay_grid)
    limits = (
        Limit("samples", _record_delay_of_samples, says="it is late by less than a sample"),
        STRICT,
    )
    traits = Trait.REPLAYED | Trait.LATE | Trait.SHIFTS

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """What was recorded less what will be T later."""
        back = np.ascontiguousarray(motion.tau[::-1, j])
        ahead = delayed(back, float(shape[0]) / motion.dt)[::-1]
        return (motion.tau[:, j] - ahead)[:, None]


class ActuatorLag(Effect):
    """The effort follows its command as through a low-pass of one or two equal poles."""

    name, family = "actuator-lag", "actuator"
    doc = Doc(
        equation="tau(t) = model(t) + a (tau - y),  (1 + T s)^n y = tau,  n = 1 or 2",
        signature="the model is late where the effort changes fast, and too large there",
        confused_with=("delay", "filter-lag", "elastic-transmission"),
        shown_by="fast motion; chirp up to the current loop's bandwidth",
        source="Naerum thesis, appendix A (amplifier); first-order current loop",
    )
    params = (_WHOLE,)
    shape = (
        Param("T", "s", "time constant of a pole", 0.0, size=True),
        Param("n", "1", "number of poles", 1.0, 2.0, codes=POLES, choice=True),
    )
    relations = Relations(causes=LATENESS)
    search = Grid(_lag_grid)
    limits = (STRICT,)
    traits = Trait.REPLAYED | Trait.LATE

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Command less its lagged copy."""
        return behind(motion.tau[:, j], motion.dt, shape)


def _torque_ripple_ripples(f: Fitted) -> bool:
    """A motor whose constant changes its sign over position does not ripple, it is broken."""
    return max(math.hypot(*f.beta[:2]), math.hypot(*f.beta[2:])) < 1.0


def _torque_ripple_carrier(motion: Motion, j: int) -> FloatArray:
    """Effort."""
    return motion.tau[:, j]


def _torque_ripple_grid(motion: Motion, j: int) -> Shapes:
    """Every half order over the span, from a whole one on, and those of the motor's turns.

    With one period over the span a constant falls from the middle to both ends, or along the range.
    """
    return position_orders(motion, j, lowest=1.0, motor=True)


class TorqueRipple(Effect):
    """Ripple of the motor constant over position: it scales with the command."""

    name, family = "torque-ripple", "actuator"
    doc = Doc(
        equation="tau = tau (a1 sin kq + b1 cos kq + a2 sin 2kq + b2 cos 2kq),  k = 2 pi p",
        signature="lines over position that grow with the effort and vanish without it",
        confused_with=("cogging", "position-friction"),
        shown_by="the same slow strokes under several static loads",
        source="Holtz, Springob, IEEE Trans. Industrial Electronics 43(6), 1996",
    )
    params = tuple(Param(n, "1", "relative amplitude") for n in ("a1", "b1", "a2", "b2"))
    shape = (Param("p", "1/{x}", "periods per unit of position", 0.0, size=True),)
    relations = Relations(causes=("gain-over-place",))
    search = Waves(_torque_ripple_grid, carrier=_torque_ripple_carrier, at_resolution=True)
    limits = (
        Limit("broken", _torque_ripple_ripples, says="the motor constant would change its sign"),
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort times two harmonics over position."""
        return motion.tau[:, j : j + 1] * harmonics(motion.q[:, j], shape[0])


#: Forms of a gain that varies: with the speed, or about a place.
OF_SPEED, OF_PLACE = 0.0, 1.0
#: Places over the range about which a scale may vary.  Half: a coil that is centred off the middle
#: lies between two; double: twice the time, and the climb finds the same place.
CENTRES = 5


#: Least share of the effort that a load has where a scale that varies with the speed shows.  Half:
#: friction that curves with the speed is taken for one; double: a motor that weakens on an axis
#: with much friction goes unnamed.
CARRIES = 0.5


def _varying_gain_grid(motion: Motion, j: int) -> Shapes:
    """The speed, where the effort is more than friction; places over the range with both ends."""
    low, high = motion.span[j]
    load, every = (float(np.mean(x**2)) for x in (motion.load[:, j], motion.driven(j)))
    speed = [(0.0, OF_SPEED)] if load >= CARRIES**2 * every else []
    places = np.linspace(low, high, CENTRES)
    return [*speed, *((float(q0), OF_PLACE) for q0 in places)]


#: Largest share of the effort that a scale which varies takes: beyond it hardly anything is left.
MOST_VARIES = 0.8
#: Order up to which a change over the place is smooth.
_SMOOTH = 3
#: Widths of signs of the speed, in typical speeds, that stand for any curve of friction.
CURVES = (0.1, 0.3, 1.0)


def _varying_gain_foils(motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
    """Friction that curves with the speed or is another one over the place; inertia over the place.

    Beside them a gain shows in what they leave out: gravity at all speeds, friction at all places.
    """
    v, top = motion.qd[:, j : j + 1], max(float(np.max(np.abs(motion.qd[:, j]))), 1e-12)
    x = np.clip(motion.scaled(j), -1, 1)
    place = np.asarray(np.polynomial.chebyshev.chebvander(x, 2 * _SMOOTH), dtype=np.float64)
    near = place[:, 1 : _SMOOTH + 1]
    if shape[1] == OF_SPEED:
        curves = [np.tanh(v / (w * typical_speed(motion, j))) for w in CURVES]
        fast = v / top
        curves += [fast * np.abs(fast), fast**3]
        return [np.hstack(curves), np.abs(fast) * place[:, : _SMOOTH + 1]]
    return [motion.qdd[:, j : j + 1] * place[:, 1:], motion.sign(j)[:, None] * near, place[:, 1:]]


def _varied(motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
    """What the scale varies with: |v| or (q - q0)^2, shape (n,)."""
    of_place = shape[1] == OF_PLACE
    out = (motion.q[:, j] - shape[0]) ** 2 if of_place else np.abs(motion.qd[:, j])
    return np.asarray(out)


def _varying_gain_varies(f: Fitted) -> bool:
    """The scale changes by more than chance and leaves a part of the effort everywhere."""
    varied = _varied(f.motion, f.j, f.shape)
    most = (abs(f.beta[0]) + f.slack[0]) * float(np.ptp(varied))
    return GAIN_CHANGES < most and abs(f.beta[0]) * float(np.max(varied)) < MOST_VARIES


class VaryingGain(Effect):
    """Efforts whose scale varies with the speed or the place: back EMF, a coil off its centre."""

    name, family = "varying-gain", "actuator"
    doc = Doc(
        equation="tau = model + g |v| tau,  or  tau = model + g (q - q0)^2 tau",
        signature="residual proportional to what the motor carries, more at speed or off centre",
        confused_with=("torque-gain", "asymmetric-viscous", "position-torque", "gain-drift"),
        shown_by="the same load at several speeds, and at several places",
        source=(
            "Hendershot, Miller, Design of Brushless Permanent-Magnet Machines, 2010 (voltage "
            "limit and iron losses at speed); Gomis-Bellmunt, Campanile, Design Rules for "
            "Actuators in Active Mechanical Systems, 2010 (force of a coil over its stroke)"
        ),
    )
    params = (Param("g", "1", "share of the effort lost: per unit of speed, or of place squared"),)
    shape = (
        Param("q0", "{x}", "the place about which the scale varies"),
        Param(
            "of",
            "1",
            "0: the speed; 1: the place",
            OF_SPEED,
            OF_PLACE,
            codes=((OF_SPEED, "per unit of speed"), (OF_PLACE, "per square of the way from q0")),
            choice=True,
        ),
    )
    relations = Relations(causes=("gain-over-place",), foils=_varying_gain_foils)
    search = Grid(_varying_gain_grid)
    limits = (
        Limit("size", _varying_gain_varies, says="so small a change is chance, or so large none"),
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort times what its scale varies with, as predicted: no noise explains itself."""
        return (_varied(motion, j, shape) * motion.driven(j))[:, None]


def behind(u: FloatArray, dt: float, shape: Sequence[float]) -> FloatArray:
    """A signal (n,) less its copy behind a low-pass of shape (T, number of poles), (n, 1)."""
    y = np.ascontiguousarray(u)
    for _ in range(round(shape[1])):
        y = lag(y, dt, float(shape[0]))
    return (u - y)[:, None]


def _filter_lag_lacks(motion: Motion, j: int) -> str:
    """Structural: without an external effort it is a delay of the command."""
    if np.std(motion.tau_ext[:, j]) > TELLING_PUSH * np.std(motion.tau[:, j]):
        return ""
    return (
        "without a measured external force of some size a lag of the measured motion is the "
        "same as 'delay' (or 'actuator-lag'): both let the effort lead the motion"
    )


class FilterLag(Effect):
    """The motion is measured late: a low-pass in the drive or in the encoder's interface.

    Where the motor's effort is all that acts, a late motion and a late command are the same
    thing: both let the effort lead the measured motion.  A measured external effort leads with
    a late motion, too, but not with a late command: then the two differ.
    """

    name, family = "filter-lag", "sensor"
    doc = Doc(
        equation="tau + tau_ext = model(t) + a (u - y),  (1 + T s)^n y = u,  u = tau + tau_ext",
        signature="motor effort and external effort both lead the measured motion",
        confused_with=("delay", "actuator-lag"),
        shown_by="pushes by hand while the motor moves",
        source="Gautier, Vandanjon, Presse, CDC 1994 (filtering in identification)",
        over=Over.EFFORT_RATE,
    )
    params = (_WHOLE,)
    shape = (
        Param("T", "s", "time constant of a pole", 0.0, size=True),
        Param("n", "1", "number of poles", 1.0, 2.0, codes=POLES, choice=True),
    )
    scope = Scope(lacks=_filter_lag_lacks)
    relations = Relations(causes=LATENESS)
    search = Grid(late_grid)
    limits = (STRICT,)
    traits = Trait.REPLAYED | Trait.LATE | Trait.WHOLE

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Motor and external effort less their lagged copy."""
        return behind(motion.tau[:, j] + motion.tau_ext[:, j], motion.dt, shape)


def at_tip(motion: Motion) -> bool:
    """Whether the external effort comes from a wrench at the tip."""
    return bool(motion.wrench.shape[0] == motion.n)


def _channels(motion: Motion) -> list[int]:
    """Sensor channels: the wrench's three forces (and torques, if it has any), or the joints."""
    if not at_tip(motion):
        return list(range(motion.d))
    return list(range(6 if np.any(motion.wrench[:, 3:]) else 3))


def _pairs(motion: Motion) -> list[tuple[int, int]]:
    """Pairs (a, b) of different channels of one kind, b with a reading."""
    of = _channels(motion)
    kinds = [of[:3], of[3:]] if at_tip(motion) else [of]
    return [(a, b) for kind in kinds for a in kind for b in kind if a != b]


def lever(motion: Motion, frame: float) -> FloatArray:
    """Effort of unit readings (n, d, channels): J' with the channels along the frame's axes."""
    count = len(_channels(motion))
    if not at_tip(motion):
        return np.broadcast_to(np.eye(motion.d), (motion.n, motion.d, motion.d))
    axes = _axes(motion, frame)
    parts = []
    for k in range(count):
        unit = np.zeros((motion.n, 6))
        unit[:, 3 * (k // 3) : 3 * (k // 3) + 3] = axes[:, :, k % 3]
        parts.append(motion.robot.external(motion.q, unit))
    return np.stack(parts, axis=2)


def _readings(motion: Motion, frame: float) -> FloatArray:
    """What the channels say (n, channels)."""
    if not at_tip(motion):
        return motion.tau_ext
    axes, w = _axes(motion, frame), motion.wrench
    parts = [np.einsum("nij,ni->nj", axes, w[:, k : k + 3]) for k in (0, 3)]
    return np.concatenate(parts, axis=1)[:, : len(_channels(motion))]


def _axes(motion: Motion, frame: float) -> FloatArray:
    """Axes of the channels as columns in base axes (n, 3, 3)."""
    turned = motion.robot.tip_axes(motion.q) if frame == _TIP else None
    return np.broadcast_to(np.eye(3), (motion.n, 3, 3)) if turned is None else turned


#: Share of the motor's effort from which a force is more than the noise of its sensor.
SENSED_PUSH = 0.05
_SOURCE = "Cao, Laws, Rodriguez y Baena, IEEE Sensors J. 21(18), 2021 (six-axis force sensors)"


def _frames(motion: Motion, j: int) -> Shapes:
    """Base axes; those of the tip where there is one that turns."""
    turned = motion.robot.tip_axes(motion.q[:2]) if at_tip(motion) else None
    return [(_BASE,)] if turned is None else [(_BASE,), (_TIP,)]


def _missing(motion: Motion, j: int) -> str:
    """Needs a force sensor."""
    some = np.any(motion.wrench) if at_tip(motion) else np.any(motion.tau_ext)
    return "" if some else "no external force was measured"


def _each(letter: str, unit: str = "{unit}") -> Callable[[Motion, int], tuple[Param, ...]]:
    """One coefficient a channel; ``{unit}`` stands for the channel's own unit."""

    def terms(motion: Motion, j: int) -> tuple[Param, ...]:
        tip = at_tip(motion)
        names = [_AXES[k] if tip else str(k + 1) for k in _channels(motion)]
        units = ["N m" if tip and k > 2 else "N" if tip else "{F}" for k in _channels(motion)]
        return tuple(
            Param(f"{letter}{n}", unit.replace("{unit}", u), f"{letter} of channel {n}")
            for n, u in zip(names, units, strict=True)
        )

    return terms


def _felt(motion: Motion, frame: float, own: bool = False) -> FloatArray:
    """J' e of every channel, e = 1 or its own reading, (n, d, channels); zero without a sensor."""
    if _missing(motion, 0):
        return np.zeros((motion.n, motion.d, len(_channels(motion))))
    shown = _readings(motion, frame)
    return lever(motion, frame) * (shown if own else np.ones_like(shown))[:, None, :]


def _stands(f: Fitted, warmth: FloatArray | float = 1.0) -> bool:
    """What a sensor adds to its reading stands in the reading: no more than twice its size."""
    shown = _readings(f.motion, f.shape[-1])
    if len(f.beta) != shown.shape[1]:
        return True
    added = np.ones_like(shown) * np.array(f.beta) * warmth
    return float(np.sum(added**2)) <= 4.0 * float(np.sum(shown**2))


_FRAME = Param(
    "frame",
    "1",
    "axes of the channels: 0 base, 1 tip",
    _BASE,
    _TIP,
    codes=((_BASE, "along the base's axes"), (_TIP, "along the tip's axes")),
    choice=True,
)
_BOTH = ("motor", "external")


class _ForceSensor(Effect):
    """An error of every channel of the force sensor, with one coefficient each."""

    family = "sensor"
    shape: ClassVar[tuple[Param, ...]] = (_FRAME,)
    search = Grid(_frames, refine=False)
    traits = Trait.REPLAYED | Trait.MOTION


def _by_joint(motion: Motion) -> bool:
    """The sensors are one a joint.

    Then a sensor's constant is an actuator's; and too much force is too little motor, for all else
    scales along.
    """
    return not at_tip(motion)


class ForceBias(_ForceSensor):
    """A constant that the force sensor adds: it was not zeroed."""

    name = "force-bias"
    doc = Doc(
        equation="tau = J' b  (b in the sensor's channels, along base or tip axes)",
        signature="a residual like that of a constant force at the tip, with no contact, too",
        confused_with=("torque-offset", "rigid-body", "payload"),
        shown_by="rests without contact in several postures",
        source=_SOURCE,
    )
    params = (Param("b", "{F}", "bias of a channel"),)
    scope = Scope(Of.TIP, explains=_BOTH, lacks=_missing, terms=_each("b"))
    relations = Relations(twins=(Twin("torque-offset", _by_joint),))
    limits = (Limit("size", _stands, says="it is larger than what the sensor reads"),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """J' of every channel, shape (n, d, channels)."""
        return _felt(motion, shape[0])


def _warmth(motion: Motion, time: float) -> FloatArray:
    """T (1 - exp(-t / T)), shape (n, 1)."""
    return (-time * np.expm1(-motion.since / time))[:, None]


def _times(motion: Motion, j: int) -> Shapes:
    """Straight (a hundred times the run), and from ten times to a twentieth of it."""
    times = motion.since[-1] * np.array([100.0, 10.0, 1.0, 0.5, 0.2, 0.1, 0.05])
    return [(float(t), *frame) for frame in _frames(motion, j) for t in times]


class ForceDrift(_ForceSensor):
    """A reading of the force sensor that wanders with time."""

    name = "force-drift"
    doc = Doc(
        equation="tau = J' d T (1 - exp(-t / T))  (t since the start of the run)",
        signature="a residual that grows with time, whatever the motion",
        confused_with=("force-bias", "friction-drift", "missed-counts"),
        shown_by="the same rest without contact at the start and at the end",
        source=_SOURCE,
        over=Over.TIME,
    )
    params = (Param("d", "{F}/s", "drift of a channel at the start"),)
    shape = (Param("T", "s", "time constant", 0.0, size=True), _FRAME)
    scope = Scope(Of.TIP, explains=_BOTH, lacks=_missing, terms=_each("d", "{unit}/s"))
    search = Grid(_times)
    limits = (
        Limit(
            "size",
            lambda f: _stands(f, _warmth(f.motion, f.shape[0])),
            says="it is larger than what the sensor reads",
        ),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """J' T (1 - exp(-t / T)) of every channel, shape (n, d, channels)."""
        return _felt(motion, shape[1]) * _warmth(motion, shape[0])[:, :, None]


def _pushed(motion: Motion) -> str:
    """Why an error that grows with the force cannot be seen; empty where a force of size acts."""
    size = np.std(motion.tau_ext, axis=0) > SENSED_PUSH * np.std(motion.tau, axis=0)
    return "" if np.any(size) else "the measured force is no more than noise beside the effort"


class ForceGain(_ForceSensor):
    """Channels of the force sensor that show too much or too little."""

    name = "force-gain"
    doc = Doc(
        equation="tau = J' diag(g) w_m  (w_m measured; g = share of the reading that is too much)",
        signature="residual proportional to the measured external force",
        confused_with=("torque-gain", "force-crosstalk"),
        shown_by="known weights on the tip, each axis by itself",
        source=_SOURCE,
    )
    params = (Param("g", "1", "relative error of a channel"),)
    scope = Scope(
        Of.TIP,
        lacks=lambda motion, j: _missing(motion, j) or _pushed(motion),
        terms=_each("g", "1"),
    )
    relations = Relations(twins=(Twin("torque-gain", _by_joint),))
    # a channel that shows half as much again is broken, not out of calibration
    limits = (
        Limit(
            "broken",
            lambda f: max(abs(b) for b in f.beta) < 0.5,
            says="the gain would be wrong by more than half",
        ),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """J' times the channel's own reading, shape (n, d, channels)."""
        if _pushed(motion):
            return np.zeros((motion.n, motion.d, len(_channels(motion))))
        return _felt(motion, shape[0], own=True)


def _crossed(f: Fitted) -> bool:
    """A channel that shows more of another than of itself is swapped, not crossed."""
    return all(abs(b) < 1.0 + e for b, e in zip(f.beta, f.slack, strict=True))


def _each_pair(motion: Motion, j: int) -> tuple[Param, ...]:
    """One coefficient a pair."""
    names = _AXES if at_tip(motion) else tuple(str(k + 1) for k in range(motion.d))
    found = [(names[a], names[b]) for a, b in _pairs(motion)]
    return tuple(Param(f"e{a}-{b}", "1", f"what {a} shows of {b}") for a, b in found)


def _one_channel(motion: Motion, j: int) -> str:
    """Needs two channels that carry something."""
    return (
        _missing(motion, j)
        or _pushed(motion)
        or ("" if _pairs(motion) else "the force sensor has one channel")
    )


class ForceCrosstalk(_ForceSensor):
    """One channel of the force sensor answers the force of another."""

    name = "force-crosstalk"
    doc = Doc(
        equation="tau = J' E w_m  (E without diagonal; forces with forces, torques with torques)",
        signature="residual in one direction of force that follows the force in another",
        confused_with=("force-gain", "rigid-body"),
        shown_by="forces along one axis at a time",
        source=_SOURCE,
    )
    params = (Param("e", "1", "share of another channel's reading"),)
    scope = Scope(Of.TIP, explains=_BOTH, lacks=_one_channel, terms=_each_pair)
    limits = (
        Limit("swapped", _crossed, says="a channel would show more of another one than of itself"),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """J' e_a w_b for every pair of channels (a, b), shape (n, d, pairs)."""
        if _one_channel(motion, j):
            return np.zeros((motion.n, motion.d, len(_pairs(motion))))
        w, arm = _readings(motion, shape[0]), lever(motion, shape[0])
        return np.stack([arm[:, :, a] * w[:, b : b + 1] for a, b in _pairs(motion)], axis=2)


EFFECTS = (
    ForceBias(),
    ForceDrift(),
    ForceGain(),
    ForceCrosstalk(),
    FilterLag(),
    Delay(),
    RecordDelay(),
    ActuatorLag(),
    TorqueRipple(),
    VaryingGain(),
)
