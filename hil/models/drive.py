"""What the motor and its amplifier do to a command: delay, lag, and ripple that scales with it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hil.models.effect import (
    STRICT,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Over,
    Param,
    Relations,
    Shapes,
    Trait,
    Waves,
    log_grid,
)
from hil.models.friction import harmonics, position_orders
from hil.models.kernels import delayed, lag
from hil.models.motion import FloatArray, Motion
from hil.models.param import POLES

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
    """Every half order over the span."""
    return position_orders(motion, j)


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


EFFECTS: tuple[Effect, ...] = (Delay(), ActuatorLag(), TorqueRipple())
