"""Errors of the measured motion: an eccentric disc, lost counts, a lag of the filter.

An error e of joint j's measured position is an error of the model's effort on every joint i, to
first order  -(M_ij e'' + D_ij e' + G_ij e)  with the model's own inertia M, viscous friction D and
static stiffness G.

What the motor and its amplifier do to a command: delay, lag, and ripple that scales with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

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
    Variation,
    Waves,
    log_grid,
)
from hil.models.friction import harmonics, position_orders
from hil.models.kernels import delayed, eccentric, lag
from hil.models.motion import FloatArray, Motion
from hil.models.parts import POLES, TELLING_PUSH

#: Cause of every lateness.
LATENESS = ("lateness",)
#: The whole effort is late, not a part of it; the margin is for errors of the form.
WHOLE = Param("a", "1", "share of the effort that is late: 1 but for errors", 0.9, 1.1)


def late_grid(motion: Motion, j: int) -> Shapes:
    """Time constants of one pole, then of two, 0.5 to 60 ms late in all."""
    return [(t / n, n) for n in (1.0, 2.0) for (t,) in log_grid(5e-4, 0.06, 14)]


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
    params = (WHOLE,)
    shape = (Param("T", "s", "delay", 0.0, size=True),)
    relations = Relations(causes=LATENESS)
    search = Grid(_delay_grid)
    limits = (STRICT,)
    traits = Trait.REPLAYED | Trait.LATE | Trait.SHIFTS

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Command less its copy of T ago."""
        tau = motion.tau[:, j]
        return (tau - delayed(tau, float(shape[0]) / motion.dt))[:, None]


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
    params = (WHOLE,)
    shape = (
        Param("T", "s", "time constant of a pole", 0.0, size=True),
        Param("n", "1", "number of poles", 1.0, 2.0, codes=POLES, choice=True),
    )
    relations = Relations(causes=LATENESS)
    search = Grid(late_grid)
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
    """Every half order over the span, and those of the motor's turns."""
    return position_orders(motion, j, motor=True)


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
    search = Waves(_torque_ripple_grid, carrier=_torque_ripple_carrier)
    limits = (Limit("broken", _torque_ripple_ripples),)
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort times two harmonics over position."""
        return motion.tau[:, j : j + 1] * harmonics(motion.q[:, j], shape[0])


def behind(u: FloatArray, dt: float, shape: Sequence[float]) -> FloatArray:
    """A signal (n,) less its copy behind a low-pass of shape (T, number of poles), (n, 1)."""
    y = np.ascontiguousarray(u)
    for _ in range(round(shape[1])):
        y = lag(y, dt, float(shape[0]))
    return (u - y)[:, None]


#: Orders of an eccentric disc beyond this many periods over the span are a motor's cogging.
DISC_ORDER = 40.0
#: Shape of jumps that are recorded, and the coefficient that says that they were lost counts.
SEEN = (0.0,)
CONFIRMED = Param("a", "1", "share of the recorded jumps that the effort confirms as lost", 0.0)
#: Largest such share beside a model that was fitted with the jumps as motion.
DILUTED = 5.0
_SHIFT = Param("s", "{x}", "shift of the measured position")
_UNFITTED = "needs the fitted model's inertia; fit the model first"


def _encoder_eccentricity_powers(motion: Motion, j: int) -> NDArray[np.complex128] | None:
    """-(G, i (M q'' + D q'), -M q'^2) on the own joint: e, e' and e'' of exp(i k q)."""
    if motion.response is None:
        return None
    m, g = motion.response.inertia[:, j, j], motion.response.gradient[:, j, j]
    v, damping = motion.qd[:, j], motion.response.damping[j]
    parts = (g, 1j * (m * motion.qdd[:, j] + damping * v), -m * v**2)
    return -np.stack(parts, axis=1).astype(np.complex128)


def _encoder_eccentricity_grid(motion: Motion, j: int) -> Shapes:
    """Every half order over the span."""
    return position_orders(motion, j, DISC_ORDER)


def _encoder_eccentricity_lacks(motion: Motion, j: int) -> str:
    """Needs a fitted model."""
    return _UNFITTED if motion.response is None else ""


class EncoderEccentricity(Effect):
    """The encoder's disc sits off centre: its error repeats once per turn.

    Cogging repeats over position, too, but has one size at all speeds; this grows with the
    square of the speed and with the acceleration, for it is inertia that it falsifies.  A tilted
    or oval disc errs twice a turn, too; and what is a sine over the true position is a bent one
    over the measured one, and a third harmonic counts nine times in the acceleration.
    """

    name, family = "encoder-eccentricity", "sensor"
    doc = Doc(
        equation=(
            "tau = -(M e'' + D e' + G e),  "
            "e = es sin kq + ec cos kq + es2 sin 2kq + .. + ec3 cos 3kq, k = 2 pi p"
        ),
        signature="a ripple over position that grows with the square of the speed",
        confused_with=("cogging", "position-friction"),
        shown_by="the same stroke at several speeds",
        source="Kavanagh, IEEE Trans. Instrumentation and Measurement 50(6), 2001 (encoder errors)",
    )
    params = (
        Param("es", "{x}", "error that goes with the sine"),
        Param("ec", "{x}", "error that goes with the cosine"),
        Param("es2", "{x}", "twice a turn, with the sine: a tilted or oval disc"),
        Param("ec2", "{x}", "twice a turn, with the cosine"),
        Param("es3", "{x}", "three times a turn, with the sine"),
        Param("ec3", "{x}", "three times a turn, with the cosine"),
    )
    shape = (Param("p", "1/{x}", "turns of the disc per unit of position", 0.0, size=True),)
    scope = Scope(Of.JOINTS, lacks=_encoder_eccentricity_lacks)
    search = Waves(_encoder_eccentricity_grid, powers=_encoder_eccentricity_powers)
    traits = Trait.LOAD | Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """-(M e'' + D e' + G e) for e = sin and cos of kq, 2kq and 3kq, shape (n, d, 6)."""
        if motion.response is None:
            return np.zeros((motion.n, motion.d, 6))
        r, k, q = motion.response, 2 * np.pi * float(shape[0]), motion.q[:, j]
        out = np.empty((motion.n, motion.d, 6))
        for h in (1, 2, 3):
            angle = (h * k) * q
            eccentric(
                np.sin(angle),
                np.cos(angle),
                h * k,
                motion.qd[:, j],
                motion.qdd[:, j],
                r.inertia[:, :, j],
                r.gradient[:, :, j],
                float(r.damping[j]),
                j,
                out[:, :, 2 * h - 2 : 2 * h],
            )
        return out


def _missed_counts_grid(motion: Motion, j: int) -> Shapes:
    """The recorded jumps if there are any, else fifteen instants from 5 to 95 % of the run."""
    if motion.jumps(j):
        return [SEEN]
    return [(float(t),) for t in np.linspace(0.05, 0.95, 15) * motion.since[-1]]


def _missed_counts_terms(motion: Motion, j: int) -> tuple[Param, ...]:
    """Share of the recorded jumps, or the shift."""
    return (CONFIRMED,) if motion.jumps(j) else (_SHIFT,)


def _missed_counts_small(f: Fitted) -> bool:
    """No shift beyond half a radian; recorded jumps are nearer to lost counts than to motion.

    Beside jumps a model finds too small an inertia, so that the first share may exceed 1.
    A run without jumps has none (0).
    """
    if not _missed_counts_dated(f.shape):
        return max(map(abs, f.beta)) < 0.5
    return all(0.5 < b < DILUTED for b in f.beta if b)


def _missed_counts_dated(shape: Sequence[float]) -> bool:
    """Recorded jumps are."""
    return tuple(shape) == SEEN


def _missed_counts_own(shape: Sequence[float]) -> bool:
    """A shift does, to the run in which it happened."""
    return not _missed_counts_dated(shape)


def _missed_counts_lacks(motion: Motion, j: int) -> str:
    """Needs gravity or a spring, unless the jumps are recorded."""
    if motion.response is None:
        return _UNFITTED
    if motion.jumps(j) or np.any(motion.response.gradient[:, :, j]):
        return ""
    return "no gravity or spring of the model depends on the position, so a shift has no effect"


class MissedCounts(Effect):
    """The encoder lost counts: all positions after that are shifted.

    Lost within a sample, they are seen as jumps of the recorded position; then instants and
    sizes are known, and what is fitted is whether the effort confirms that the joint did not
    jump: a share of 1.  Lost little by little they are one shift at an instant that is searched;
    only gravity and springs feel it, and without them it cannot be seen in the effort.
    """

    name, family = "missed-counts", "sensor"
    doc = Doc(
        equation=(
            "tau = f(q - a e) - f(q), e = jumps of the recorded position, each staying; "
            "without any tau = -G s for t > t0 (s = shift of the measured position)"
        ),
        signature=(
            "the position jumps and the effort does not; or gravity fits before an instant only"
        ),
        confused_with=("force-drift", "torque-offset", "vibration-mode"),
        shown_by="a return to a mechanical reference at the end of the run",
        source=(
            "Naerum thesis, appendix A (counts lost above the decoder's rate are a lasting offset)"
        ),
        over=Over.TIME,
    )
    params = (_SHIFT,)
    shape = (
        Param(
            "t0",
            "s",
            "instant, from the start; 0: the jumps that are recorded",
            0.0,
            codes=((SEEN[0], "at the jumps that are recorded"),),
        ),
    )
    scope = Scope(Of.JOINTS, lacks=_missed_counts_lacks, terms=_missed_counts_terms)
    variation = Variation(per_run=True, dated=_missed_counts_dated, own=_missed_counts_own)
    search = Grid(_missed_counts_grid)
    limits = (Limit("size", _missed_counts_small),)
    traits = Trait.LOAD | Trait.REPLAYED | Trait.JUMPS

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """f(q - e) - f(q), or -G after t0, shape (n, d, 1)."""
        if motion.response is None:
            return np.zeros((motion.n, motion.d, 1))
        if _missed_counts_dated(shape):
            return motion.response.unslipped(j)[:, :, None]
        after = np.clip((motion.since - float(shape[0])) / motion.dt + 0.5, 0.0, 1.0)
        out: FloatArray = -(motion.response.gradient[:, :, j] * after[:, None])[:, :, None]
        return out


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
    params = (WHOLE,)
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


EFFECTS = (
    EncoderEccentricity(),
    MissedCounts(),
    FilterLag(),
    Delay(),
    ActuatorLag(),
    TorqueRipple(),
)
