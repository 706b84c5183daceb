"""From a fitted model to what the loop compensates: rigid-body parameters, and all its effects.

Any effect of the library, or a user's own, that `hil.estimate.online` can evaluate in the loop;
others are refused by name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.estimate import online
from hil.models import catalogue
from hil.models.effect import Trait
from hil.models.model import RobotModel, Value
from hil.models.phantom import Premium
from hil.models.robots import bare_robot

FloatArray = NDArray[np.float64]
#: Parts of a model that the rigid-body part of the loop holds.
RIGID = Trait.BODY | Trait.ROTOR
JOINTS = ("joint1", "joint2", "joint3")
#: What stands for an effect without values.
_NONE = Value(math.nan)


def rigid_parameters(model: RobotModel) -> FloatArray:
    """Pi (8,) of a Premium 1.5 from a fitted model, rotors and payload included.

    Raises
    ------
    ConfigError
        If it is another robot, or the model has no values.
    """
    if model.robot.preset != "phantom-premium-1.5":
        raise ConfigError(
            f"the loop computes the torques of a phantom-premium-1.5; this model is of "
            f"{model.robot.preset or 'a URDF'!r}"
        )
    values = model.values()
    body, rotors = _names(Trait.BODY), _names(Trait.ROTOR)
    pi = np.array([_value(values, f"{body[0]}.{n}") for n in Premium.names])
    for row, name in ((0, "j1"), (4, "j2"), (5, "j3")):
        for key, value in values.items():
            if key.startswith(tuple(f"{name}.{rotor}." for rotor in rotors)):
                pi[row] += value.value
    return pi


def _names(trait: Trait) -> list[str]:
    """Names of the effects with a trait."""
    return [name for name, effect in catalogue.table().items() if trait in effect.traits]


def effects(model: RobotModel) -> dict[str, float]:
    """All values of a fitted model but the rigid body's, as the loop takes them.

    Raises
    ------
    ConfigError
        Naming an effect that the loop cannot compensate, and why.
    """
    catalogue.load_files(model.plugins)
    found = {
        name: value.value
        for use in model.effects
        if not catalogue.get(use.type).traits & RIGID
        for name, value in (use.values or {f"j1.{use.type}.-": _NONE}).items()
    }
    online.tables(found, span(model))
    return found


def span(model: RobotModel) -> list[float]:
    """Lowest and highest position of each joint on which it was identified; empty if unknown."""
    known = {r.joint: r.position for r in model.valid}
    joints = tuple(bare_robot(model.robot, JOINTS).joints)
    return [x for j in joints for x in known[j]] if set(joints) <= set(known) else []


def _value(values: Mapping[str, Value], name: str) -> float:
    found = values.get(name)
    if found is None:
        raise ConfigError(
            f"the model has no value of {name}; identify it first with 'hil fit SESSION.mcap "
            "--model M.toml -o FITTED.toml'"
        )
    return float(found.value)
