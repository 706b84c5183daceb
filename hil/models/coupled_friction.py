"""Friction set by more than the own speed: by the load, or by another joint's motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.models.effect import (
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Over,
    Param,
    Scope,
    Shapes,
    Sight,
    Trait,
    brakes,
)
from hil.models.motion import FloatArray, Motion
from hil.models.param import JOINT


def _load_friction_grid(motion: Motion, j: int) -> Shapes:
    """The loads that differ."""
    static = [(1.0,)] if np.any(motion.static[:, j]) else []
    return [(0.0,), *static, (2.0,)]


class LoadFriction(Effect):
    """Friction that grows with the effort that the joint transmits."""

    name, family = "load-friction", "friction"
    doc = Doc(
        equation=(
            "tau = mu |load| tanh(v / v0),  "
            "load = all that is transmitted, its static part, "
            "or the motor's own effort (a gear or a cable around a capstan)"
        ),
        signature="friction grows with gravity, acceleration or contact load",
        confused_with=("torque-gain", "coulomb", "position-friction"),
        shown_by="the same motion under several static loads",
        source="Bittencourt, Gunnarsson, J. Dyn. Syst. Meas. Control 134, 2012",
        shown=Sight.LOAD,
        over=Over.LOAD,
    )
    params = (Param("mu", "1", "friction per transmitted effort", 0.0),)
    shape = (
        Param(
            "of",
            "1",
            "0: all that is transmitted; 1: gravity and springs only; 2: the motor's effort",
            0.0,
            2.0,
            codes=(
                (0.0, "all that is transmitted"),
                (1.0, "gravity and springs only"),
                (2.0, "the motor's own effort: driving and back-driving differ"),
            ),
            choice=True,
        ),
    )
    search = Grid(_load_friction_grid, refine=False)
    traits = Trait.LOAD

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """|load| sgn(v)."""
        of = int(shape[0])
        load = motion.driven(j) if of == 2 else (motion.load, motion.static)[of][:, j]
        return (np.abs(load) * motion.sign(j))[:, None]


def _coupled_friction_brakes(f: Fitted) -> bool:
    """Friction of a relative motion brakes it; which way another joint's cable rubs is open."""
    w = f.motion.qd[:, f.j] + f.shape[1] * f.motion.qd[:, int(f.shape[0]) - 1]
    return not f.shape[1] or brakes(w, f.beta, f.slack)


def _coupled_friction_grid(motion: Motion, j: int) -> Shapes:
    """Every other joint, alone and relative to this one."""
    others = [k + 1 for k in range(motion.d) if k != j]
    return [(float(k), mode) for k in others for mode in (0.0, 1.0, -1.0)]


def _alone(motion: Motion, j: int) -> str:
    """Needs a second joint."""
    return "" if motion.d > 1 else "the robot has one joint"


class CoupledFriction(Effect):
    """Friction on this joint caused by another joint's motion (cables over its pulleys)."""

    name, family = "coupled-friction", "friction"
    doc = Doc(
        equation="tau = fk tanh(w / v0) + vk w,  w = v_k, v + v_k or v - v_k",
        signature="residual follows the sign of another joint's speed",
        confused_with=("rigid-body", "coupled-transmission"),
        shown_by="one joint at a time, then pairs with all combinations of signs",
        source="Naerum thesis 3.1.2; Miyasaka, Haghighipanah, Li, Hannaford, ICRA 2016",
        over=Over.OTHER_SPEED,
    )
    params = (
        Param("fk", "{F}", "Coulomb part"),
        Param("vk", "{F} s/{x}", "viscous part"),
    )
    shape = (
        Param(JOINT, "1", "number of the other joint", 1.0, choice=True),
        Param(
            "mode",
            "1",
            "0: w = v_k; +1: w = v + v_k; -1: w = v - v_k",
            -1.0,
            1.0,
            codes=(
                (0.0, "the other joint's speed"),
                (1.0, "the sum of both speeds"),
                (-1.0, "the difference of both speeds"),
            ),
            choice=True,
        ),
    )
    scope = Scope(lacks=_alone)
    search = Grid(_coupled_friction_grid, refine=False)
    limits = (Limit("drives", _coupled_friction_brakes),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[tanh(w / v0), w]."""
        k, mode = int(shape[0]) - 1, shape[1]
        own, side = float(bool(mode)), mode or 1.0
        w = own * motion.qd[:, j] + side * motion.qd[:, k]
        slope = own * motion.qdd[:, j] + side * motion.qdd[:, k]
        v0 = float(max(motion.v0[j], motion.v0[k]))
        return np.stack([motion.sign_of(w, slope, v0), w], axis=1)


EFFECTS: tuple[Effect, ...] = (LoadFriction(), CoupledFriction())
