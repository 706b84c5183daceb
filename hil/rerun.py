"""The law, the limits and the driver's conversion once more, over the rows of a session."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil import companions, registry
from hil.config import RigConfig
from hil.errors import DataError
from hil.played import Played
from hil.runtime import commands, safety, watch
from hil.shop import Shop
from hil.signals.device import Controller, FloatArray, IntArray, ServoJf, Status
from hil.signals.state import OperatingState
from hil.tomltable import parse

_ENABLED = int(OperatingState.ENABLED)


class _Nowhere:
    """Wire that leads nowhere: a driver converts, nothing moves."""

    trouble = ""

    def __init__(self) -> None:
        self.counts, self.gauges = np.zeros(3, np.int64), np.zeros(6, np.int64)

    def home(self, counts: IntArray) -> None: ...

    def receive(self, t_ns: int) -> Status:
        return Status.OK

    def send(self, codes: IntArray) -> None: ...

    def power(self, on: bool) -> None: ...

    def close(self) -> None: ...


class Run:
    """The law over the rows of a record; what commands do to the loop, done to this.

    Parameters
    ----------
    record : Played
        What the session holds.
    changes : dict of str to float
        Parameters of the law that are to be others.
    """

    def __init__(self, record: Played, changes: dict[str, float]) -> None:
        self.record = record
        self.shop = Shop(None, record.config, bounded=False)
        self.law: Controller = self.shop.law({k: (v,) for k, v in changes.items()})
        self.x = np.zeros(len(self.law.state_names))
        self.x_next = np.zeros_like(self.x)
        self.period_ns = record.config.loop.period_ns
        self.zero_ns = self.tick = 0
        self.state = _ENABLED
        self.drivers = [_driver(record.config, arm) for arm in record.config.controller.arms]
        limits = [record.config.arms[arm] for arm in record.config.controller.arms]
        self.limits = [(np.array(a.torque_limit), np.array(a.speed_limit)) for a in limits]

    @property
    def powered(self) -> bool:
        """ENABLED or PAUSED in the tick before."""
        return self.state in (_ENABLED, int(OperatingState.PAUSED))

    def begin(self) -> None:
        """To ENABLED."""
        if self.state == OperatingState.DISABLED:
            self.zero_ns = max(0, self.tick - 1) * self.period_ns

    def pause(self) -> None:
        """To PAUSED; the record says so."""

    def finish(self) -> None:
        """End; the record says so."""

    def follow(self, controller: Controller, restart: bool) -> None:
        """As `hil.runtime.loop.Loop.follow`."""
        before, self.law = self.law, controller
        size = len(controller.state_names)
        if restart or size != len(self.x):
            self.x, self.x_next = companions.anew(controller, before, self.x), np.zeros(size)
            self.zero_ns = (self.tick - 1) * self.period_ns

    def all(self) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Efforts and codes of every row, (n, arms, 3), and where the law's state was known."""
        r = self.record
        sent, codes = np.zeros_like(r.sent), np.zeros_like(r.codes)
        known = np.ones(r.ticks.size, bool)
        gap = np.diff(r.ticks, prepend=0) - np.diff(r.timing["missed"], prepend=0.0)
        lost = False
        for k, tick in enumerate(r.ticks.tolist()):
            self.tick = tick
            for text in r.commands.get(tick, ()):
                commands.parse(text, self.shop).apply(self)
            lost = lost or gap[k] > 1
            self.state = int(r.timing["state"][k])
            if not lost:
                self.row(k, sent[k], codes[k])
            known[k] = not lost
            if lost and tick in r.states and r.states[tick].size == self.x.size:
                self.x[:] = r.states[tick]
                lost = False
        return sent, codes, known

    def row(self, k: int, sent: FloatArray, codes: FloatArray) -> None:
        """One tick: law if it ran, limits, conversion."""
        u, y = self.record.u[k], np.zeros((len(self.drivers), 3))
        if self.state == _ENABLED:
            t = (self.tick * self.period_ns - self.zero_ns) * 1e-9
            self.law.update(t, self.x, u, self.x_next, y)
            self.x, self.x_next = self.x_next, self.x
        for a, driver in enumerate(self.drivers):
            safety.limit(y[a], u[a, 3:6], *self.limits[a])
            driver.servo_jf(y[a], sent[a])
            if "conditions" in self.record.timing:
                watch.snap(sent[a], watch.EFFORT_GRID)
            codes[a] = driver.codes  # type: ignore[attr-defined]


def _driver(config: RigConfig, arm: str) -> ServoJf:
    """Driver that takes the efforts of an arm, enabled on a wire to nowhere."""
    for name, device in config.devices.items():
        kind = registry.load("hil.drivers", device.driver)
        if device.arm == arm and hasattr(kind.open_device, "servo_jf"):
            options = parse(kind.Config, device.options, f"devices.{name}.options")
            driver = kind.open_device(name, _Nowhere(), options, config.loop.period_ns * 1e-9)
            driver.enable()
            return driver  # type: ignore[no-any-return]
    raise DataError(f"the rig file of the session has no device that drives arm {arm!r}")
