"""From a fitted model to what the loop compensates: rigid-body parameters and friction tables.

Any effect of the library, or a user's own, can be compensated if its torque depends on the own
joint's speed alone; that is tried, not looked up.  Others are refused by name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.models import catalogue
from hil.models.effect import Effect
from hil.models.model import RobotModel, Use, Value
from hil.models.motion import Motion
from hil.models.phantom import Premium
from hil.models.robots import bare_robot

FloatArray = NDArray[np.float64]
#: Parts of a model that the rigid-body part of the loop holds.
RIGID = ("rigid-body", "armature", "payload")
#: Knots of a friction table [rad/s]: fine where friction changes sign.
SPEEDS: FloatArray = np.concatenate([
    -np.geomspace(10.0, 0.005, 24), [0.0], np.geomspace(0.005, 10.0, 24)
])  # fmt: skip
JOINTS = ("joint1", "joint2", "joint3")
#: Speed over which the sign of the velocity is resolved [rad/s].
SOFT = 0.02


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
    pi = np.array([_value(values, f"rigid-body.{n}") for n in Premium.names])
    for row, name in ((0, "j1"), (4, "j2"), (5, "j3")):
        for key, value in values.items():
            if key.startswith(f"{name}.armature."):
                pi[row] += value.value
    return pi


def friction_tables(model: RobotModel, speeds: FloatArray = SPEEDS) -> FloatArray:
    """Friction of every joint at the knots [N m], shape (3, n), from all other effects.

    Raises
    ------
    ConfigError
        Naming an effect that is not a function of the own joint's speed.
    """
    joints = tuple(bare_robot(model.robot, JOINTS).joints)
    out = np.zeros((len(joints), speeds.size))
    for use in model.effects:
        if use.type in RIGID:
            continue
        effect = catalogue.get(use.type)
        for j, joint in enumerate(joints):
            if use.joints == ("*",) or joint in use.joints:
                out[j] += _torque(effect, use, j, speeds, model)
    return out


def _torque(effect: Effect, use: Use, j: int, speeds: FloatArray, model: RobotModel) -> FloatArray:
    """Torque of one effect on joint j; refused unless it is a function of the own speed."""
    if effect.whole_robot or effect.replayed:
        raise _refusal(effect, "it acts on the whole robot, or has states of its own")
    shape, theta = _numbers(effect, use, j)
    plain = effect.columns(_motion(speeds, j, model, 0.0), j, shape)
    moved = effect.columns(_motion(speeds, j, model, 0.3), j, shape)
    if plain.shape[1] != theta.size:
        raise _refusal(effect, f"{theta.size} values are given for {plain.shape[1]} columns")
    if not np.allclose(plain, moved, rtol=1e-6, atol=1e-12):
        raise _refusal(effect, "it depends on more than the own joint's speed")
    out: FloatArray = plain @ theta
    return out


def _refusal(effect: Effect, why: str) -> ConfigError:
    return ConfigError(
        f"effect {effect.name!r} cannot be compensated in the loop: {why}; fit a model without it, "
        "or take it out of the file"
    )


def _numbers(effect: Effect, use: Use, j: int) -> tuple[tuple[float, ...], FloatArray]:
    """Shape and coefficients of an effect on joint j."""
    start = f"j{j + 1}.{effect.name}."
    shapes = [p.name for p in effect.shape]
    given = {k[len(start) :]: v.value for k, v in use.values.items() if k.startswith(start)}
    missing = [n for n in (*shapes, *(p.name for p in effect.params)) if n not in given]
    if missing or any(not math.isfinite(v) for v in given.values()):
        raise _refusal(effect, f"its {', '.join(missing) or 'values'} on joint {j + 1} are unknown")
    theta = [v for k, v in given.items() if k not in shapes]
    return tuple(given[n] for n in shapes), np.array(theta)


def _motion(speeds: FloatArray, j: int, model: RobotModel, other: float) -> Motion:
    """Joint j at the given speeds; `other` moves everything else."""
    n, robot = speeds.size, bare_robot(model.robot, JOINTS)
    d = len(robot.joints)
    rest = np.full((n, d), other)
    qd = rest.copy()
    qd[:, j] = speeds
    return Motion(
        t=np.linspace(0.0, 1.0, n), q=rest, qd=qd, qdd=np.zeros((n, d)), tau=rest, tau_ext=rest,
        load=rest, static=rest, v0=np.full(d, SOFT), resolution=np.full(d, 1e-3),
        span=np.tile([-1.0, 1.0], (d, 1)), contact=np.full((d, 2), np.nan), robot=robot,
    )  # fmt: skip


def _value(values: Mapping[str, Value], name: str) -> float:
    found = values.get(name)
    if found is None:
        raise ConfigError(
            f"the model has no value of {name}; identify it first with 'hil fit SESSION.mcap "
            "--model M.toml -o FITTED.toml'"
        )
    return float(found.value)
