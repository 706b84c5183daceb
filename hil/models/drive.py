"""What the motor and its amplifier do to a command: lag, and ripple that scales with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.models.effect import Effect, Param, log_grid
from hil.models.friction import harmonics, position_orders
from hil.models.kernels import lag
from hil.models.motion import FloatArray, Motion


class ActuatorLag(Effect):
    """The effort follows its command as through a first-order low-pass."""

    replayed = strict = True
    name, family = "actuator-lag", "actuator"
    equation = "tau(t) = model(t) + a (tau - y),  T y' + y = tau"
    signature = "the model is late where the effort changes fast, and too large there"
    confused_with = ("delay", "filter-lag", "elastic-transmission")
    shown_by = "fast motion; chirp up to the current loop's bandwidth"
    source = "Naerum thesis, appendix A (amplifier); first-order current loop"
    params = (Param("a", "1", "share of the effort that lags: 1 but for errors", 0.5, 1.5),)
    shape = (Param("T", "s", "time constant", 0.0),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Command less its lagged copy."""
        tau = np.ascontiguousarray(motion.tau[:, j])
        return (tau - lag(tau, motion.dt, float(shape[0])))[:, None]

    def grid(self, motion: Motion, j: int) -> list[tuple[float, ...]]:
        """1 to 60 ms: a slower motor is no motor."""
        return log_grid(1e-3, 0.06, 9)


class TorqueRipple(Effect):
    """Ripple of the motor constant over position: it scales with the command."""

    replayed = True
    name, family = "torque-ripple", "actuator"
    equation = "tau = tau (a1 sin kq + b1 cos kq + a2 sin 2kq + b2 cos 2kq),  k = 2 pi p"
    signature = "lines over position that grow with the effort and vanish without it"
    confused_with = ("cogging", "position-friction")
    shown_by = "the same slow strokes under several static loads"
    source = "Holtz, Springob, IEEE Trans. Industrial Electronics 43(6), 1996"
    params = tuple(Param(n, "1", "relative amplitude") for n in ("a1", "b1", "a2", "b2"))
    shape = (Param("p", "1/{x}", "periods per unit of position", 0.0),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort times two harmonics over position."""
        return motion.tau[:, j : j + 1] * harmonics(motion.q[:, j], shape[0])

    def carrier(self, motion: Motion, j: int) -> FloatArray:
        """Effort."""
        return motion.tau[:, j]

    def grid(self, motion: Motion, j: int) -> list[tuple[float, ...]]:
        """Every half order over the span."""
        return position_orders(motion, j)


EFFECTS: tuple[Effect, ...] = (ActuatorLag(), TorqueRipple())
