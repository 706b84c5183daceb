"""What operator's commands need of a rig, made on the slow side: laws with other parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from hil import registry
from hil.errors import ConfigError, unknown
from hil.rig.check import limits_of_arm
from hil.rig.config import RigConfig, robot_source
from hil.rig.open import Rig, build_controller, check_forces
from hil.signals import settable
from hil.signals.device import Controller
from hil.toml import parse

#: Time in which the arms go home [s].
HOMING = 2.0


class Shop:
    """Workshop of one session.

    Parameters
    ----------
    rig : Rig or None
        Open devices; None where there are none to enable (replay).
    config : RigConfig
        Of the session.
    bounded : bool
        An operator sets what the law declares, within its ranges; a replay anything.
    """

    def __init__(self, rig: Rig | None, config: RigConfig, bounded: bool = True) -> None:
        self._rig, self._config, self._bounded = rig, config, bounded
        self._parameters: dict[str, Any] = dict(config.controller.parameters)

    def enable(self) -> None:
        """Enable the devices."""
        if self._rig is not None:
            self._rig.enable()

    def settable(self) -> Mapping[str, settable.SettableRange]:
        """What an operator may set of the law, and how far."""
        return settable.ranges(self._in_force())

    def values(self) -> dict[str, list[float]]:
        """What an operator may set, as it is now."""
        now = self._in_force()
        found = {name: getattr(now, name) for name in settable.ranges(now)}
        return {
            n: [float(x) for x in (v if isinstance(v, tuple) else (v,))] for n, v in found.items()
        }

    def law(self, changes: Mapping[str, Sequence[float]]) -> Controller:
        """The law of the session with some of its numbers changed; the changes stay."""
        now, parameters = self._in_force(), dict(self._parameters)
        for name, values in changes.items():
            if self._bounded:
                settable.checked(name, values, settable.ranges(now))
            elif not hasattr(now, name):
                raise ConfigError(unknown("parameter", name, (f.name for f in fields(now))))
            listed = isinstance(getattr(now, name), tuple)
            parameters[name] = list(values) if listed or len(values) > 1 else values[0]
        config = self._with(self._config.controller.name, parameters)
        law = build_controller(config)
        if self._bounded:
            check_forces(config, law)
        self._parameters = parameters
        return law

    def home(self) -> Controller:
        """Joint tracking to the middle posture of the arms in two seconds, and there it stays."""
        first = self._config.arms[self._config.controller.arms[0]]
        center = limits_of_arm(first, robot_source(first)).center
        if first.own:
            kept = {k: v for k, v in self._parameters.items() if k in ("armature", "friction")}
            goal = {**kept, "center": [float(q) for q in center], "blend": HOMING}
            return build_controller(self._with("joint-pd", goal))
        # a motion without amplitude has no shape
        still = {
            "center": [float(q) for q in center],
            "amplitude": [1e-9] * 3,
            "blend": HOMING,
        }
        return build_controller(self._with("joint-tracking", still))

    def _in_force(self) -> Any:
        """Parameters of the law as they are now."""
        kind = registry.load("hil.controllers", self._config.controller.name).Config
        return parse(kind, self._parameters, "controller.parameters")

    def _with(self, name: str, parameters: dict[str, Any]) -> RigConfig:
        table = dataclasses.replace(self._config.controller, name=name, parameters=parameters)
        return dataclasses.replace(self._config, controller=table)
