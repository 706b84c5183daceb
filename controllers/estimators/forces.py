"""Force on the tip without a sensor: momentum observer or inverse dynamics, with any friction.

tau_s = M q'' + C q' + N + tau_f - tau_c acts ON the robot; F = J^-T tau_s (thesis 3.1, 3.3).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numba as nb
import numpy as np

from hil.controllers import dynamics
from hil.controllers.lawrence_config import PREMIUM
from hil.errors import ConfigError, unknown
from hil.estimate import compensation, compensation_tables
from hil.models import catalogue
from hil.signals.device import FloatArray

METHODS = ("momentum", "inverse-dynamics")
#: Memory: integral or last speed, filtered torque, last friction, slips, time.
_MEMORY = 10 + compensation.MEMORY
_NAMES = (
    *(f"force_{axis}" for axis in "xyz"),
    *(f"torque{j}" for j in (1, 2, 3)),
)
_UNITS = ("N",) * 3 + ("N m",) * 3


@dataclass(frozen=True)
class ForcesConfig:
    """Parameters of the estimator.

    Parameters
    ----------
    method : str
        ``"momentum"`` needs no acceleration; ``"inverse-dynamics"`` differentiates the speed.
    corner_hz : float
        First-order low-pass that the estimate is seen through.
    model : tuple of 8 floats
        Rigid-body parameters pi of the arm with its sensor.
    effects : mapping
        Friction and more, as a model file gives them: full name to value.
    span : tuple of 6 floats, or empty
        Lowest and highest position of each joint on which these were identified [rad].
    plugins : tuple of str
        Files with a user's own effects.
    lengths : tuple of 2 floats
        l1, l2 [m].
    """

    method: str = "momentum"
    corner_hz: float = 10.0
    model: tuple[float, ...] = PREMIUM
    effects: Mapping[str, float] = field(default_factory=dict)
    span: tuple[float, ...] = ()
    plugins: tuple[str, ...] = ()
    lengths: tuple[float, float] = dynamics.LINK_LENGTHS

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ConfigError(unknown("method", self.method, METHODS))
        if len(self.model) != 8 or self.corner_hz <= 0.0 or len(self.span) not in (0, 6):
            raise ConfigError(
                "force estimator: model needs 8 numbers, span 6 or none, corner_hz must be positive"
            )
        numbers = (*self.model, *self.span, *self.lengths, self.corner_hz)
        if not all(map(math.isfinite, numbers)) or min(self.lengths) <= 0 or not any(self.model):
            raise ConfigError(
                "force estimator: model, span and corner_hz must be finite, lengths positive, and "
                "model not all 0"
            )


@nb.njit(cache=True, nogil=True)
def differentiate(
    running: bool, q: Any, v: Any, sent: Any, c: Any, w: Any, past: Any, now: Any
) -> None:
    """Inverse dynamics with the speed differentiated, through a low-pass, into w.r (3,) [N m]."""
    share = c.gain * c.period / (1.0 + c.gain * c.period)
    for j in range(3):
        w.goal[j] = (v[j] - past[j]) / c.period if running else 0.0
        now[j] = v[j]
    dynamics.premium_inverse_dynamics(q, v, w.goal, c.model, w.flow)
    for j in range(3):
        # r <- r + share (tau_s - r)
        push = w.flow[j] + w.rub[j] - sent[j]
        w.r[j] = past[3 + j] + share * (push - past[3 + j]) if running else 0.0


@nb.njit(cache=True, nogil=True)
def _estimate(
    phase: int,
    q: Any,
    v: Any,
    sent: Any,
    c: Any,
    terms: Any,
    slips: Any,
    values: Any,
    w: Any,
    past: Any,
    now: Any,
    out: Any,
) -> None:
    """One period; see `Forces.update`."""
    z = w.known
    w.goal[:] = 0.0
    dynamics.premium_inverse_dynamics(q, w.goal, w.goal, c.model, w.flow)
    for j in range(3):
        z[j], z[3 + j], z[6 + j], z[9 + j] = q[j], v[j], sent[j] - past[6 + j], w.flow[j]
        w.rub[j] = 0.0
    now[9] = past[9] + c.period if phase > 0 else 0.0
    z[12] = now[9]
    compensation.friction(phase == 2, z, terms, slips, values, past[10:], now[10:], w.rub)
    if c.method == 0:
        dynamics.advance(
            phase == 2,
            q,
            v,
            sent,
            w.rub,
            c.model,
            c.gain,
            c.period,
            past,
            now,
            w.room,
            w.impulse,
            w.flow,
            w.r,
        )
    else:
        differentiate(phase == 2, q, v, sent, c, w, past, now)
    dynamics.jacobian(q, c.lengths, w.jacobian)
    dynamics.solve_transposed(w.jacobian, w.r, w.square, out)
    for j in range(3):
        now[3 + j] = out[3 + j] = w.r[j]
        now[6 + j] = w.rub[j]


_F = np.float64
_KNOWN = np.dtype(
    [
        ("model", _F, (8,)),
        ("lengths", _F, (2,)),
        ("gain", _F),
        ("period", _F),
        ("method", np.int64),
    ]
)
_WORK = np.dtype(
    [
        ("known", _F, (len(compensation.VARIABLES),)),
        ("rub", _F, (3,)),
        ("goal", _F, (3,)),
        ("flow", _F, (3,)),
        ("impulse", _F, (3,)),
        ("r", _F, (3,)),
        ("room", _F, (6, 3)),
        ("jacobian", _F, (3, 3)),
        ("square", _F, (3, 3)),
    ]
)


class Forces:
    """The estimator of one arm; see `hil.signals.device.Estimator`.

    Parameters
    ----------
    config : ForcesConfig
        Parameters.
    period : float
        Of the loop [s].
    """

    names, units, memory, force, message = _NAMES, _UNITS, _MEMORY, 0, "ForceEstimate"

    def __init__(self, config: ForcesConfig, period: float) -> None:
        catalogue.load_files(config.plugins)
        tables = compensation_tables.tables(config.effects, config.span)
        self.corner_hz = config.corner_hz
        self._tables = tables.terms, tables.slips, tables.values
        self._c, self._w = np.zeros(1, _KNOWN)[0], np.zeros(1, _WORK)[0]
        self._c["model"], self._c["lengths"] = config.model, config.lengths
        self._c["gain"], self._c["period"] = 2 * np.pi * config.corner_hz, period
        self._c["method"] = METHODS.index(config.method)

    def update(
        self,
        phase: int,
        past: FloatArray,
        u: FloatArray,
        sent: FloatArray,
        now: FloatArray,
        out: FloatArray,
    ) -> None:
        """One period; see `hil.signals.device.Estimator`."""
        _estimate(phase, u[:3], u[3:6], sent, self._c, *self._tables, self._w, past, now, out)


Config = ForcesConfig
build = Forces
