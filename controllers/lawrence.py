"""Extended Lawrence Architecture in the workspace: c1..c8 per axis over computed torque.

operator -> leader --c1 motion, c3 force--> follower -> environment
              ^---- c4 motion, c2 force ----'
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.controllers import channel, ela, lawrence_kernels, lawrence_records, lawrence_state
from hil.controllers.lawrence_config import LawrenceConfig
from hil.errors import ConfigError
from hil.signals.device import FloatArray
from hil.teleop.law_parameters import loops_of
from hil.teleop.sampled_loop import refuse


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

    state_names = lawrence_state.NAMES

    def __init__(self, config: LawrenceConfig, arms: tuple[str, ...], period: float) -> None:
        if len(arms) != 2:
            raise ConfigError(f"lawrence needs leader and follower, not {len(arms)} arms.")
        refuse(loops_of(config), period)
        self.config = config
        self.period = period
        self._ages = np.stack([
            channel.schedule(way, period, config.seed + k)
            for k, way in enumerate((config.backward, config.forward))
        ])  # fmt: skip
        self._line = np.zeros((2, int(self._ages.max()) + 2, 3, ela.SIGNALS))
        self._c = lawrence_records.constants(config, period)
        self._tables = lawrence_records.friction_of(config)
        self._w = np.zeros(1, lawrence_records.WORK)[0]

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
