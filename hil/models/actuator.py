"""What lies between the commanded and the real motor effort, and between motor and link."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.models.effect import (
    PER_RUN,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Of,
    Over,
    Param,
    Relations,
    Scope,
    Shapes,
    Sight,
    Trait,
    Waves,
    brakes,
)
from hil.models.friction import harmonics, position_orders
from hil.models.motion import FloatArray, Motion
from hil.models.param import JOINT


class TorqueOffset(Effect):
    """A constant between commanded and real effort."""

    name, family = "torque-offset", "actuator"
    doc = Doc(
        equation="tau = t0  (one value a run)",
        signature="the residual's mean, moving or at rest",
        confused_with=("asymmetric-coulomb", "rigid-body"),
        shown_by="rests in several postures",
        source="Janot, Gautier, Brunot, 2019 (offset of the EMPS)",
    )
    params = (Param("t0", "{F}", "offset"),)
    scope = Scope(explains=("motor", "external"))
    variation = PER_RUN
    relations = Relations(causes=("constant",))
    traits = Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """1."""
        return np.ones((motion.n, 1))


def _torque_gain_forwards(f: Fitted) -> bool:
    """A command that acts backwards is a wrong sign, not a gain."""
    return f.beta[0] > -0.9


def _torque_gain_lacks(motion: Motion, j: int) -> str:
    """Structural: without an external force the gain scales every parameter alike."""
    if np.any(motion.tau_ext[:, j]) or motion.d > 1:
        return ""
    return "without a measured external force the gain only scales all other parameters"


class TorqueGain(Effect):
    """The motor constant is not what the command assumes."""

    name, family = "torque-gain", "actuator"
    doc = Doc(
        equation="tau = (1 + g) load  (g = 1/kappa - 1, load = rigid body minus external effort)",
        signature="residual proportional to everything the motor carries, external force included",
        confused_with=("rigid-body", "payload", "load-friction"),
        shown_by="hand force and motor effort together, or a known payload",
        source="Naerum thesis 3.1.3 (motor constants by manual excitation)",
        shown=Sight.FORCE,
        over=Over.LOAD,
    )
    params = (Param("g", "1", "relative error of the command"),)
    scope = Scope(lacks=_torque_gain_lacks)
    limits = (Limit("backwards", _torque_gain_forwards),)
    traits = Trait.LOAD | Trait.GAIN

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Transmitted load."""
        return motion.load[:, j : j + 1]


def _cogging_carrier(motion: Motion, j: int) -> FloatArray:
    """1."""
    return np.ones(motion.n)


def _cogging_grid(motion: Motion, j: int) -> Shapes:
    """Every half order over the span."""
    return position_orders(motion, j)


class Cogging(Effect):
    """Effort over motor position that does not depend on the command."""

    name, family = "cogging", "actuator"
    doc = Doc(
        equation="tau = a1 sin kq + b1 cos kq + a2 sin 2kq + b2 cos 2kq,  k = 2 pi p",
        signature="lines of the residual over position at fixed orders, whatever the speed",
        confused_with=("position-friction", "spring", "encoder-eccentricity"),
        shown_by="several constant speeds over two periods or more",
        source="Holtz, Springob, IEEE Trans. Industrial Electronics 43(6), 1996",
        shown=Sight.RANGE,
        over=Over.POSITION,
    )
    params = tuple(Param(n, "{F}", "amplitude over position") for n in ("a1", "b1", "a2", "b2"))
    shape = (Param("p", "1/{x}", "periods per unit of position", 0.0, size=True),)
    search = Waves(_cogging_grid, carrier=_cogging_carrier)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Two harmonics over position."""
        return harmonics(motion.q[:, j], shape[0])


def _coupled_transmission_brakes(f: Fitted) -> bool:
    """Friction brakes the relative motion; the inertia is shared with the arm's own."""
    w = f.motion.qd[:, f.j] + f.shape[1] * f.motion.qd[:, int(f.shape[0]) - 1]
    return brakes(w, f.beta[1:], f.slack[1:])


def _coupled_transmission_grid(motion: Motion, j: int) -> Shapes:
    """Every later joint (the pair is unordered), equal or opposite."""
    return [(float(k + 1), r) for k in range(j + 1, motion.d) for r in (1.0, -1.0)]


def _coupled_transmission_lacks(motion: Motion, j: int) -> str:
    """Needs a later joint."""
    return "" if j + 1 < motion.d else "no later joint to couple with"


class CoupledTransmission(Effect):
    """The motor of one joint also turns with another (a wrist's differential)."""

    name, family = "coupled-transmission", "transmission"
    doc = Doc(
        equation="tau_j = I w' + fc tanh(w / v0) + fv w,  tau_k = r tau_j,  w = v_j + r v_k",
        signature="residuals of two joints that follow the sum or difference of their motions",
        confused_with=("coupled-friction", "rigid-body"),
        shown_by="the two joints together with equal and with opposite signs",
        source="Khalil, Dombre 2002, 9.2 (kinematic coupling of wrists)",
        over=Over.OTHER_SPEED,
    )
    params = (
        Param("i", "{F} s^2/{x}", "inertia on the relative motion"),
        Param("fc", "{F}", "Coulomb friction of the relative motion"),
        Param("fv", "{F} s/{x}", "viscous friction of the relative motion"),
    )
    shape = (
        Param(JOINT, "1", "number of the other joint", 1.0, choice=True),
        Param("r", "1", "ratio of the other joint's motion"),
    )
    scope = Scope(Of.JOINTS, lacks=_coupled_transmission_lacks)
    search = Grid(_coupled_transmission_grid, refine=False)
    limits = (Limit("drives", _coupled_transmission_brakes),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Columns (n, d, 3), on joint j and, times r, on the other joint."""
        k, r = int(shape[0]) - 1, shape[1]
        w = motion.qd[:, j] + r * motion.qd[:, k]
        slope = motion.qdd[:, j] + r * motion.qdd[:, k]
        v0 = float(max(motion.v0[j], motion.v0[k]))
        parts = np.stack([slope, motion.sign_of(w, slope, v0), w], axis=1)
        out = np.zeros((motion.n, motion.d, 3))
        out[:, j], out[:, k] = parts, r * parts
        return out


EFFECTS: tuple[Effect, ...] = (
    TorqueOffset(), TorqueGain(), Cogging(), CoupledTransmission(),
)  # fmt: skip
