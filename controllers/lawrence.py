"""Extended Lawrence Architecture in the workspace: c1..c8 per axis over computed torque.

operator -> leader --c1 motion, c3 force--> follower -> environment
              ^---- c4 motion, c2 force ----'

What the kernels of the Lawrence law take: its constants, friction tables and scratch.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hil.controllers import lawrence_config, lawrence_kernels
from hil.controllers.lawrence_config import SHAPES, LawrenceConfig
from hil.errors import ConfigError
from hil.estimate import compensation, compensation_tables
from hil.models import catalogue
from hil.signals.device import FloatArray
from hil.teleop import lawrence_filters
from hil.teleop.gate import refuse
from hil.teleop.law_parameters import loops_of

_F = np.float64
#: Scratch of one tick.
WORK = np.dtype(
    [
        ("tip", _F, (2, 3)),
        ("jacobian", _F, (2, 3, 3)),
        ("signals", _F, (2, 3, lawrence_filters.SIGNALS)),
        ("heard", _F, (3, lawrence_filters.SIGNALS)),
        ("force", _F, (3,)),
        ("push", _F, (3,)),
        ("goal", _F, (3,)),
        ("bend", _F, (3,)),
        ("impulse", _F, (3,)),
        ("room", _F, (6, 3)),
        ("pull", _F, (2, 3)),
        ("square", _F, (3, 3)),
        ("rub", _F, (2, 3)),
        ("known", _F, (len(compensation.VARIABLES),)),
    ]
)


def constants(config: LawrenceConfig, period: float) -> Any:
    """Record of what does not change, for the kernels."""
    n = len(config.friction_speeds)
    kind = np.dtype(
        [
            ("gains", _F, (3, lawrence_filters.GAINS)),
            ("masses", _F, (2, 3)),
            ("models", _F, (2, 8)),
            ("shares", _F, (3,)),
            ("lengths", _F, (2,)),
            ("period", _F),
            ("shape", np.int64),
            ("observer", _F),
            ("share", _F),
            ("estimated", np.int64),
            ("speeds", _F, (max(n, 1),)),
            ("friction", _F, (2, 3, max(n, 1))),
        ]
    )
    c = np.zeros(1, kind)[0]
    c["gains"], c["masses"] = config.gains(), config.masses()
    c["models"] = np.stack([config.leader_model, config.follower_model])
    c["shares"], c["lengths"], c["period"] = config.shares(period), config.lengths, period
    c["observer"] = 2 * np.pi * config.observer_hz
    c["share"], c["estimated"] = config.friction_share, config.forces == "estimated"
    c["shape"] = SHAPES.index(config.shape)
    if n:
        c["speeds"] = config.friction_speeds
        c["friction"][0] = np.reshape(config.leader_friction, (3, n))
        c["friction"][1] = np.reshape(config.follower_friction, (3, n))
    return c


def friction_of(config: LawrenceConfig) -> tuple[tuple[Any, Any, Any], ...]:
    """Terms, presliding and table values of leader and follower, for the kernels."""
    catalogue.load_files(config.plugins)
    both = (
        (config.leader_effects, config.leader_span),
        (config.follower_effects, config.follower_span),
    )
    found = (compensation_tables.kept(tuple(e.items()), tuple(span)) for e, span in both)
    return tuple((t.terms, t.slips, t.values) for t in found)


class Lawrence:
    """The law with its parameters; see `lawrence_kernels.law`.

    Parameters
    ----------
    config : LawrenceConfig
        Parameters.
    arms : tuple of str
        Two names: leader, follower.
    period : float
        Of the loop [s].

    Raises
    ------
    ConfigError
        If the design must not run: improper gains, an unstable loop, a delay beyond the margin.
    """

    state_names = lawrence_config.NAMES

    def __init__(self, config: LawrenceConfig, arms: tuple[str, ...], period: float) -> None:
        if len(arms) != 2:
            raise ConfigError(f"lawrence needs leader and follower, not {len(arms)} arms.")
        refuse(loops_of(config), period)
        self.config = config
        self.period = period
        self._ages = np.stack(
            [
                lawrence_config.schedule(way, period, config.seed + k)
                for k, way in enumerate((config.backward, config.forward))
            ]
        )
        self._line = np.zeros((2, int(self._ages.max()) + 2, 3, lawrence_filters.SIGNALS))
        self._c = constants(config, period)
        self._tables = friction_of(config)
        self._w = np.zeros(1, WORK)[0]

    def judge(self, corner_hz: float) -> None:
        """Refuse the law if it is not stable with forces that are seen through one more low-pass.

        Both filters count as one whose time constant is their sum.

        Raises
        ------
        ConfigError
            Naming axis, condition and margin.
        """
        own = 1.0 / self.config.force_hz if self.config.force_hz else 0.0
        seen = replace(self.config, force_hz=1.0 / (own + 1.0 / corner_hz))
        refuse(loops_of(seen), self.period)

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period; see `hil.signals.device.Controller`.

        The channel's memory is filled by tick number: the same call gives the same answer.
        """
        tick = round(t / self.period)
        lawrence_kernels.law(
            tick, x, u, self._c, self._tables, self._w, self._line, self._ages, x_next, y
        )


Config = LawrenceConfig
build = Lawrence
