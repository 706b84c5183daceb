"""A law with estimators beside it: together they are a law again, for loop, record and replay.

State of the whole: all estimates, the law's own state, time and torques of the last tick, then
the memories of the estimators, which are not recorded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hil import registry
from hil.errors import ConfigError
from hil.rig.config import EstimatorConfig, RigConfig
from hil.signals.device import Controller, Estimator, FloatArray
from hil.signals.frame import WRENCH_COMPONENTS, FrameLayout
from hil.toml import parse


@dataclass(frozen=True)
class Companion:
    """One estimator in its place.

    Parameters
    ----------
    name : str
        In the rig file.
    arm : int
        Row of u and y.
    estimator : Estimator
        What it is.
    feeds : bool
        Whether the law gets its force in place of the sensor's.
    at, memory : slice
        Its estimates and its memory in the state.
    """

    name: str
    arm: int
    estimator: Estimator
    feeds: bool
    at: slice
    memory: slice

    @property
    def topic(self) -> str:
        """Channel of its estimates."""
        return f"/estimate/{self.name}"


class Accompanied:
    """Law and estimators; see `hil.signals.device.Controller`.

    Parameters
    ----------
    law : Controller
        The law.
    built : list of (str, int, Estimator, bool)
        Name, arm, estimator and whether it feeds the law.
    limits : ndarray (arms, 3)
        Torques that leave at most [N m].
    period : float
        Of the loop [s].
    """

    def __init__(
        self,
        law: Controller,
        built: list[tuple[str, int, Estimator, bool]],
        limits: FloatArray,
        period: float,
    ) -> None:
        self.law, self._limits, self._gap = law, limits, 1.5 * period
        first = sum(len(e.names) for _, _, e, _ in built)
        self._law = slice(first, first + len(law.state_names))
        self.flag = self._law.stop
        self._sent = slice(self.flag + 2, self.flag + 2 + limits.size)
        at, memory = 0, self._sent.stop
        self.companions: list[Companion] = []
        for name, arm, e, feeds in built:
            here = slice(at, at + len(e.names)), slice(memory, memory + e.memory)
            self.companions.append(Companion(name, arm, e, feeds, *here))
            at, memory = here[0].stop, here[1].stop
        estimates = (f"{c.name}_{n}" for c in self.companions for n in c.estimator.names)
        rest = (f"kept{k}" for k in range(memory - self.flag))
        self.state_names = (*estimates, *law.state_names, *rest)
        self._u = np.zeros((len(limits), 2 * limits.shape[1] + WRENCH_COMPONENTS))
        self._views: dict[int, tuple[Any, ...]] = {}

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period: estimators with the torques of the last tick, then the law."""
        _, own, sent, kept, _ = self._seen(x)
        _, own_next, sent_next, kept_next, estimates = self._seen(x_next)
        at = self.flag
        # kept: running, time of the last tick
        phase = (2 if t - x[at + 1] < self._gap else 1) if x[at] > 0.0 else 0
        x_next[at], x_next[at + 1] = 1.0, t
        self._u[:] = u
        for k, c in enumerate(self.companions):
            c.estimator.update(phase, kept[k], u[c.arm], sent[c.arm], kept_next[k], estimates[k])
            if c.feeds:
                first = c.estimator.force
                self._u[c.arm, 6:9] = estimates[k][first : first + 3]
        self.law.update(t, own, self._u, own_next, y)
        np.clip(y, -self._limits, self._limits, out=sent_next)

    def _seen(self, x: FloatArray) -> tuple[Any, ...]:
        """Parts of a state vector; the views of the loop's two vectors are made once."""
        found = self._views.get(id(x))
        if found is None:
            if len(self._views) > 8:
                self._views.clear()
            # the vector itself is kept: its id stays its own
            found = (
                x,
                x[self._law],
                x[self._sent].reshape(self._limits.shape),
                [x[c.memory] for c in self.companions],
                [x[c.at] for c in self.companions],
            )
            self._views[id(x)] = found
        return found


def accompanied(law: Controller, config: RigConfig) -> Controller:
    """The law, with the estimators of the rig file where there are any.

    Raises
    ------
    ConfigError
        If an estimator gives no force and is to replace a sensor, or two replace the same one.
    """
    if not config.estimators:
        return law
    arms, period = config.controller.arms, config.loop.period_ns * 1e-9
    if len(config.arms[arms[0]].joints) != 3:
        raise ConfigError("[estimators]: the estimators are of arms of three joints; take them out")
    built: list[tuple[str, int, Estimator, bool]] = []
    fed: set[str] = set()
    for name, table in config.estimators.items():
        estimator = _built(name, table, period)
        if table.replaces_force:
            _may_feed(name, table, estimator, fed)
            fed.add(table.arm)
            judge = getattr(law, "judge", None)
            if judge is not None:
                judge(estimator.corner_hz)
        built.append((name, arms.index(table.arm), estimator, table.replaces_force))
    limits = np.array([config.arms[arm].torque_limit for arm in arms])
    return Accompanied(law, built, limits, period)


def _built(name: str, table: EstimatorConfig, period: float) -> Estimator:
    kind = registry.load("hil.estimators", table.name)
    with registry.blaming("hil.estimators", table.name, f"estimator {name!r} cannot be built"):
        parameters = parse(kind.Config, table.parameters, f"estimators.{name}.parameters")
        estimator: Estimator = kind.build(parameters, period)
    return estimator


def _may_feed(name: str, table: EstimatorConfig, estimator: Estimator, fed: set[str]) -> None:
    if estimator.force < 0:
        raise ConfigError(
            f"[estimators.{name}]: {table.name!r} estimates no force; take replaces_force away"
        )
    if table.arm in fed:
        raise ConfigError(
            f"[estimators.{name}]: another one replaces the force of arm {table.arm!r} already"
        )


def anew(controller: Controller, before: Controller, x: FloatArray) -> FloatArray:
    """State in which a law begins; estimators that ran beside `before` keep what they learnt.

    Parameters
    ----------
    controller, before : Controller
        The law that begins, and the one that ran.
    x : ndarray
        State of the one that ran.
    """
    out = np.zeros(len(controller.state_names))
    old, new = estimators_beside(before), estimators_beside(controller)
    if new and [(c.name, c.estimator.memory) for c in old] == [
        (c.name, c.estimator.memory) for c in new
    ]:
        for a, b in zip(old, new, strict=True):
            out[b.memory] = x[a.memory]
        # long ago: the next tick is the first one after a pause
        at = _flag(controller)
        out[at], out[at + 1] = x[_flag(before)], -1e9
    return out


def _flag(controller: Controller) -> int:
    """Where a state says that it runs; the time of the last tick follows."""
    return controller.flag if isinstance(controller, Accompanied) else 0


def bare_law(controller: Controller) -> Controller:
    """The law without its estimators."""
    return controller.law if isinstance(controller, Accompanied) else controller


def estimators_beside(controller: Controller) -> list[Companion]:
    """Estimators beside a law."""
    return controller.companions if isinstance(controller, Accompanied) else []


def layout(arms: int, joints: int, controller: Controller) -> FrameLayout:
    """Row of the ring for this law and its estimators, of arms with so many joints."""
    estimates = sum(len(c.estimator.names) for c in estimators_beside(controller))
    return FrameLayout(arms, len(bare_law(controller).state_names), estimates, joints)
