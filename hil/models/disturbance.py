"""What changes with time and not with the motion: friction, offsets, gains that drift, a hum."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from hil.models.effect import (
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Lines,
    Over,
    Param,
    Relations,
    Scope,
    Shapes,
    Sight,
    Trait,
    Variation,
    log_grid,
)
from hil.models.kernels import lag
from hil.models.motion import FloatArray, Motion
from hil.models.parts import GAIN_CHANGES, always

#: Highest frequency of a disturbance that is looked for [Hz]; the effort filter passes no more.
_FASTEST = 25.0
#: Fewest periods in a run: what is slower is a drift.
_PERIODS = 4.0
#: Share of a motion's power at a frequency that is its own; share of one of which it mostly
#: consists, multiples of that which are its own, too, and how many bins of the spectrum apart two
#: frequencies are two.  A machine answers a sine with its multiples; beyond the eighth nothing that
#: it does is as large as a name.  Half: hums near a slow motion go unnamed; double: what a model
#: misses of a motion of few sines is a hum.
_A_LINE, _MOSTLY, _OVERTONES, _RESOLVED = 0.05, 0.8, 8, 1.5
#: Temperature at which friction is that of the model, whatever a drift adds [degC].
_ROOM = 25.0
#: Parts of a run in which a law's values may differ.
LAW_PARTS = 8
#: Shortest time constant of a drift, in lengths of the run.
SHORTEST_DRIFT = 0.1
#: Shortest time in which a machine warms up [s]; a motor's winding, its smallest part that heats,
#: takes 10 to 30 s (maxon, Technology - short and to the point, 2012: thermal time constant of the
#: winding).  Doubled, a machine that warms as fast as its winding is missed; halved, what a short
#: recording of a few seconds shows by chance is a drift.
WARMS_UP = 5.0


def _drift_lasts(f: Fitted) -> bool:
    """What is over within a tenth of the run is no drift: that run began differently.

    Nor is what no part of a machine warms up in.
    """
    shortest = max(SHORTEST_DRIFT * float(f.motion.since[-1]), WARMS_UP)
    return f.shape[1] == THERMOMETER or f.shape[0] > 1.01 * shortest


def _friction_drift_grid(motion: Motion, j: int) -> Shapes:
    """Temperature where it was recorded; a tenth of the run to three times its length.

    The time constant is that of the clock, or of a joint that its own motion warms.  What warms up
    is a state and time only its clock: time is for a run without a thermometer, or where it
    explains clearly more, as of a part that is warm before the thermometer is.
    """
    length = max(float(motion.since[-1]), WARMS_UP)
    slow = log_grid(max(SHORTEST_DRIFT * length, WARMS_UP), 3 * length, 7)
    times: Shapes = [(x, of) for of in (CLOCK, OWN_MOTION) for (x,) in slow]
    known = motion.temperature.shape == motion.q.shape and np.ptp(motion.temperature[:, j]) > 0
    return [(length, THERMOMETER), *times] if known else times


def _offset_drift_grid(motion: Motion, j: int) -> Shapes:
    """The same without the joint's own motion: amplifiers and gauges warm by themselves."""
    return [s for s in _friction_drift_grid(motion, j) if s[1] != OWN_MOTION]


#: What drifts with: the time since the start, the thermometer, the motion that warms the joint, the
#: losses of its winding.
CLOCK, THERMOMETER, OWN_MOTION, OWN_EFFORT = 0.0, 1.0, 2.0, 3.0


def _by_the_clock(shape: Sequence[float]) -> bool:
    """Whether the time since the start is what it drifts with."""
    return shape[1] == CLOCK


def _progress(*own: tuple[float, str, str]) -> tuple[Param, Param]:
    """Shape of what drifts: how fast, and with what; its own heat by number, name and words."""
    heats = "".join(f"; {code:g}: {what}" for code, what, _ in own)
    return (
        Param("T", "s", "time constant; much longer than the run: a linear drift", 0.0, size=True),
        Param(
            "of",
            "1",
            f"0: time; 1: measured motor temperature{heats}",
            CLOCK,
            max([THERMOMETER, *(code for code, _, _ in own)]),
            codes=(
                (CLOCK, "over time"),
                (THERMOMETER, "over measured motor temperature"),
                *((code, words) for code, _, words in own),
            ),
            choice=True,
        ),
    )


def _drift_linear(motion: Motion, j: int, shape: Sequence[float]) -> FloatArray | None:
    """The measured temperature, where that is what drifts."""
    return _warmth(motion, j, shape) if shape[1] == THERMOMETER else None


def _friction_drift_foils(motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
    """Friction that changes at once, at the end of each of some parts of the run."""
    part = LAW_PARTS * motion.since / max(float(motion.since[-1]), 1e-9)
    rubs = np.stack([motion.sign(j), motion.qd[:, j]], axis=1)
    return [(part > k)[:, None] * rubs for k in np.arange(0.5, LAW_PARTS, 0.5)]


#: What no drift is.
_TRANSIENT = Limit(
    "transient",
    _drift_lasts,
    says="it is over within a tenth of the run, so that run began differently",
)


class FrictionDrift(Effect):
    """Friction that changes with time or temperature."""

    name, family = "friction-drift", "friction"
    doc = Doc(
        equation=(
            "tau = s (dc tanh(v / v0) + dv v),  "
            "s = 1 - exp(-t / T)  (t since the start of the run), "
            "s = temperature - 25 degC, or T s' + s = |v| (warmed by the motion)"
        ),
        signature="friction at the end of the run differs from that at its start, at all speeds",
        confused_with=("load-friction", "coulomb", "viscous", "gain-drift"),
        shown_by="the same motion at the start and at the end of a long run",
        source=(
            "Bittencourt, Axelsson, Jung, Brogardh, IFAC World Congress 2011; Maxon: winding 12 s"
        ),
        shown=Sight.MINUTES,
        over=Over.TIME,
    )
    params = (
        Param(
            "dc",
            "{F}",
            "change of Coulomb friction: in all, per kelvin, or per unit of the mean speed",
        ),
        Param(
            "dv",
            "{F} s/{x}",
            "change of viscous friction: in all, per kelvin, or per unit of the mean speed",
        ),
    )
    shape = _progress((OWN_MOTION, "the joint's own motion", "warmed by the joint's own motion"))
    variation = Variation(timed=_by_the_clock)
    relations = Relations(foils=_friction_drift_foils, linear=_drift_linear)
    search = Grid(_friction_drift_grid)
    limits = (_TRANSIENT,)
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[s tanh(v / v0), s v]."""
        s = _warmth(motion, j, shape)
        return np.stack([s * motion.sign(j), s * motion.qd[:, j]], axis=1)


def _offset_drift_foils(motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
    """An offset that changes at once, at the end of each of some parts of the run."""
    part = LAW_PARTS * motion.since / max(float(motion.since[-1]), 1e-9)
    return [(part > k)[:, None].astype(np.float64) for k in np.arange(0.5, LAW_PARTS, 0.5)]


class OffsetDrift(Effect):
    """An offset that changes with time or temperature: an amplifier or a gauge that warms up."""

    name, family = "offset-drift", "actuator"
    doc = Doc(
        equation=(
            "tau = s d0,  s = 1 - exp(-t / T)  (t since the start of the run), "
            "or s = temperature - 25 degC, the same for all runs"
        ),
        signature="the residual's mean wanders with time, moving or at rest",
        confused_with=("torque-offset", "friction-drift", "gain-drift", "payload-change"),
        shown_by="the same rest at the start and at the end of a long run",
        source="International Vocabulary of Metrology, JCGM 200:2012, 4.21 (instrumental drift)",
        shown=Sight.MINUTES,
        over=Over.TIME,
    )
    params = (Param("d0", "{F}", "change of the offset, per kelvin in the second form"),)
    shape = _progress()
    variation = Variation(timed=_by_the_clock)
    scope = Scope(explains=("motor", "external"))
    relations = Relations(foils=_offset_drift_foils, linear=_drift_linear)
    search = Grid(_offset_drift_grid)
    limits = (_TRANSIENT,)
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Progress of the drift s."""
        return _warmth(motion, j, shape)[:, None]


#: Largest change of a gain that warming makes.  Magnets lose 0.1 to 0.2 % a kelvin, and a motor
#: that may be used warms by less than 130 K.  Halved: ferrite that gets hot goes unnamed; doubled:
#: a load that is put down is a motor that weakens.
MOST_GAIN_CHANGES = 0.5


def _gain_drifts(f: Fitted) -> bool:
    """The gain changes within the run by more than chance, and by no more than warming makes."""
    course = f.beta[0] * _warmth(f.motion, f.j, f.shape)
    doubt = f.slack[0] / max(abs(f.beta[0]), 1e-12)
    change = float(np.ptp(course))
    return change * (1.0 + doubt) > GAIN_CHANGES and change * (1.0 - doubt) < MOST_GAIN_CHANGES


def _gain_drift_foils(motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
    """A gain or an inertia that changes at once, at the end of each of some parts of the run."""
    parts = _offset_drift_foils(motion, j, shape)
    return [part * x[:, None] for x in (motion.driven(j), motion.qdd[:, j]) for part in parts]


def _gain_drift_grid(motion: Motion, j: int) -> Shapes:
    """The same with the effort that warms the winding in the place of the motion."""
    warm = _friction_drift_grid(motion, j)
    return [(x, OWN_EFFORT if of == OWN_MOTION else of) for x, of in warm]


class GainDrift(Effect):
    """Efforts whose scale changes with time or temperature: magnets that weaken as they warm."""

    name, family = "gain-drift", "actuator"
    doc = Doc(
        equation=(
            "tau = model + g s tau,  s = 1 - exp(-t / T)  (t since the start of the run), "
            "s = temperature - 25 degC, or T s' + s = tau^2 (warmed by its losses)"
        ),
        signature="the residual grows with time and is proportional to all that the motor carries",
        confused_with=(
            "offset-drift",
            "friction-drift",
            "payload-change",
            "torque-saturation",
            "torque-gain",
        ),
        shown_by="the same motion under load at the start and at the end of a long run",
        source="Sebastian, IEEE Trans. Industry Applications 31(2), 1995 (torque of warm magnets)",
        shown=Sight.MINUTES,
        over=Over.TIME,
    )
    params = (
        Param(
            "g",
            "1",
            "share of the effort lost: in all, per kelvin, or per unit of the mean squared effort",
        ),
    )
    shape = _progress((OWN_EFFORT, "its squared effort", "warmed by the joint's own effort"))
    variation = Variation(timed=_by_the_clock)
    relations = Relations(foils=_gain_drift_foils, linear=_drift_linear)
    search = Grid(_gain_drift_grid)
    limits = (
        _TRANSIENT,
        Limit(
            "size",
            _gain_drifts,
            says="so small a change of the gain is chance, or so large a one no warming",
        ),
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort times s, as predicted: the measured one would explain its own noise."""
        return (_warmth(motion, j, shape) * motion.driven(j))[:, None]


def _warmed(heat: FloatArray, motion: Motion, time: float) -> FloatArray:
    """Mean heat (n,) of the last while, from cold at the start of the run (n,).

    What comes after a gap begins as if the joint had moved before as it does on average.
    """
    since = motion.since
    begins = -float(np.mean(heat)) * float(np.expm1(-since[0] / time))
    # T s' + s = heat
    kept = lag(heat, motion.dt, time)
    out: FloatArray = kept + (begins - heat[0]) * np.exp(-(since - since[0]) / time)
    return out


def _warmth(motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
    """Progress of a drift s (n,)."""
    if shape[1] == OWN_MOTION:
        return _warmed(np.abs(motion.qd[:, j]), motion, float(shape[0]))
    if shape[1] == OWN_EFFORT:
        return _warmed(motion.driven(j) ** 2, motion, float(shape[0]))
    if shape[1] and motion.temperature.shape == motion.q.shape:
        # a machine that is switched on warm is warm: no run has a zero of its own
        measured: FloatArray = motion.temperature[:, j] - _ROOM
        return measured
    # s = 1 - exp(-t / T)
    s: FloatArray = -np.expm1(-motion.since / max(float(shape[0]), 1e-9))
    return s


def _periodic_disturbance_foils(
    motion: Motion, j: int, shape: Sequence[float]
) -> Sequence[FloatArray]:
    """Inertia, friction or stiffness that is another one in each part of the run.

    What changes once leaves the motion's own lines, a little shifted.
    """
    part = np.floor(LAW_PARTS * motion.since / max(float(motion.since[-1]), 1e-9))
    here = part[:, None].clip(0, LAW_PARTS - 1) == np.arange(LAW_PARTS)
    own = (motion.qdd[:, j], motion.qd[:, j], motion.sign(j), motion.q[:, j])
    return [here * x[:, None] for x in own]


def _periodic_disturbance_foreign(f: Fitted) -> bool:
    """A frequency of the motion, or a multiple of the one of which it mostly consists, is its own.

    What answers the motion there is a wrong gain, a friction, a spring; it is no disturbance.
    """
    q, duration = f.motion.q[:, f.j], f.motion.n * f.motion.dt
    power = np.abs(np.fft.rfft((q - q.mean()) * np.hanning(q.size))) ** 2
    whole = float(power[1:].sum())
    if duration <= 0.0 or whole <= 0.0:
        return True

    def share(at: int, near: int) -> float:
        return float(power[max(at - near, 1) : at + near + 1].sum()) / whole

    # what is two bins away is another frequency, though a line of a Hann window is four bins wide
    if share(round(f.shape[0] * duration), 1) > _A_LINE:
        return False
    top = int(np.argmax(power[1:])) + 1
    multiple = f.shape[0] * duration / top
    nearest = round(multiple)
    apart = abs(multiple - nearest) * top > _RESOLVED
    return share(top, 2) < _MOSTLY or not 1 <= nearest <= _OVERTONES or apart


def _periodic_disturbance_grid(motion: Motion, j: int) -> Shapes:
    """Every half period over the run; read off the residual's spectrum, not tried one by one.

    The spacing 1 / (2 duration) is half of what a spectrum resolves.
    """
    step = 0.5 / max(float(motion.since[-1]), 1e-9)
    top = min(_FASTEST, 0.4 / motion.dt)
    first = max(2 * _PERIODS * step, step)
    return list(_steps(first, max(top, first + 1.5 * step), step))


class PeriodicDisturbance(Effect):
    """A sinusoid in time that the motion does not cause: a fan, a hum, a tremor."""

    name, family = "periodic-disturbance", "structure"
    doc = Doc(
        equation="tau = a sin(2 pi f t) + b cos(2 pi f t)  (t since the start of the run)",
        signature="one line of the residual over time, in moving and resting phases alike",
        confused_with=("cogging", "torque-offset"),
        shown_by="a motion that does not repeat itself, or a rest with the brakes open",
        source=(
            "Bodson, Douglas, Automatica 33(12), 1997 (periodic disturbances of unknown frequency)"
        ),
        over=Over.PERIOD,
    )
    params = (Param("a", "{F}", "sine's amplitude"), Param("b", "{F}", "cosine's amplitude"))
    shape = (Param("f", "Hz", "frequency", 0.0, size=True),)
    variation = Variation(per_run=True, own=always)
    relations = Relations(foils=_periodic_disturbance_foils)
    search = Lines(_periodic_disturbance_grid)
    limits = (
        Limit(
            "own-line",
            _periodic_disturbance_foreign,
            says="its frequency is one of the motion's own",
        ),
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[sin 2 pi f t, cos 2 pi f t]."""
        angle = 2 * np.pi * float(shape[0]) * motion.since
        return np.stack([np.sin(angle), np.cos(angle)], axis=1)


@lru_cache(maxsize=64)
def _steps(first: float, end: float, step: float) -> Shapes:
    """Thousands of frequencies, asked for again and again."""
    return [(float(f),) for f in np.arange(first, end, step)]


EFFECTS: tuple[Effect, ...] = (
    FrictionDrift(),
    OffsetDrift(),
    GainDrift(),
    PeriodicDisturbance(),
)
