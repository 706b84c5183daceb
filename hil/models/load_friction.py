"""Friction set by more than the own joint's motion: by a load, or by another joint.

What a joint transmits rubs in its gear; what another one transmits, in a bearing that carries the
arm; another one's place bends a cable, and its motion drags one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hil.models.effect import (
    BOUNDS,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Over,
    Param,
    Relations,
    Scope,
    Shapes,
    Sight,
    Trait,
    brakes,
    even_ratio,
    motor_inertias,
    one_joint,
    other_ratios,
)
from hil.models.motion import FloatArray, Motion
from hil.models.parts import EFFORT_RATIO, JOINT

#: Speed of two joints against each other, by mode: of 0 the other one's alone.
_OWN = "min(1, 1e9 * abs(mode))"
_SIDE = f"abs(mode + 1 - {_OWN})"
_RELATIVE = f"({_OWN} * v + (mode + 1 - {_OWN}) * vk)"

#: The code of the motor's own effort.
OF_MOTOR = 2
#: Which load rubs.
_OF_LOAD = Param(
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
)


def _load_friction_grid(motion: Motion, j: int) -> Shapes:
    """The loads that differ."""
    static = [(1.0, 0.0)] if np.any(motion.static[:, j]) else []
    return [(0.0, 0.0), *static, (2.0, 0.0)]


def _loads_that_differ(motion: Motion, j: int) -> Shapes:
    """The loads of friction without a motor's share."""
    return [(of,) for of, _ in _load_friction_grid(motion, j)]


def _load_friction_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Other inertias of the motor within the model's masses; the present one first."""
    of, own = shape
    if of or motion.response is None:
        return []
    return [(of, own), *((of, x) for x in motor_inertias(motion, j, own))]


#: Share of the motor's own effort that friction may take.  A screw or worm that locks itself still
#: passes a fifth to a half (Budynas, Nisbett, Shigley's Mechanical Engineering Design, 2015, 8-2).
#: Half: self-locking gears go unnamed; all of it: whatever brakes is explained by the effort that
#: overcomes it.
MOST_TAKEN = 0.9
#: Share of a run's speeds up to which it does.
NEARLY_ALL = 0.95


def _load_friction_passes(f: Fitted) -> bool:
    """Friction of the motor's own effort leaves some of it: else any effort explains itself."""
    return int(f.shape[0]) != OF_MOTOR or f.beta[0] < MOST_TAKEN


def _load_viscous_passes(f: Fitted) -> bool:
    """The same at nearly every speed of the run."""
    fast = float(np.quantile(np.abs(f.motion.qd[:, f.j]), NEARLY_ALL))
    return int(f.shape[0]) != OF_MOTOR or f.beta[0] * fast < MOST_TAKEN


def _locked(passes: Callable[[Fitted], bool]) -> Limit:
    return Limit(
        "locked",
        passes,
        says="hardly any of the motor's effort would pass, and any effort explains itself",
    )


class LoadFriction(Effect):
    """Friction that grows with the effort that the joint transmits."""

    name, family = "load-friction", "friction"
    doc = Doc(
        equation=(
            "tau = mu |load - i qdd| tanh(v / v0),  "
            "load = all that is transmitted (without the motor's own inertia), its static part, "
            "or the motor's own effort (a gear or a cable around a capstan); i: what the model's "
            "masses hold of the motor's inertia"
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
        _OF_LOAD,
        Param("i", "{F} s^2/{x}", "inertia of the motor within the model's masses"),
    )
    search = Grid(_load_friction_grid, across=_load_friction_across, refine=False, rounds=4)
    limits = (BOUNDS, _locked(_load_friction_passes))
    traits = Trait.LOAD

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """|load| sgn(v)."""
        of = int(shape[0])
        load = _transmitted(motion, j, of)
        load = load - shape[1] * motion.qdd[:, j] if shape[1] else load
        return (np.abs(load) * motion.sign(j))[:, None]


def _transmitted(motion: Motion, j: int, of: int) -> FloatArray:
    """The load of a form of load friction, shape (n,)."""
    return motion.driven(j) if of == OF_MOTOR else (motion.load, motion.static)[of][:, j]


class LoadViscous(Effect):
    """Friction that grows with the effort that the joint transmits and with its speed."""

    name, family = "load-viscous", "friction"
    doc = Doc(
        equation=(
            "tau = b |load| v,  load = all that is transmitted, its static part, or the motor's "
            "own effort (a gear that drives otherwise than it is driven back)"
        ),
        signature="viscous friction that grows with gravity, acceleration or contact load",
        confused_with=("load-friction", "viscous", "varying-gain", "torque-gain"),
        shown_by="the same motion at several speeds under several static loads",
        source="Hamon, Gautier, Garrec, IEEE/RSJ IROS 2010, 187-193",
        shown=Sight.LOAD,
        over=Over.LOAD,
    )
    params = (Param("b", "s/{x}", "friction per transmitted effort and speed", 0.0),)
    shape = (_OF_LOAD,)
    search = Grid(_loads_that_differ)
    limits = (BOUNDS, _locked(_load_viscous_passes))
    traits = Trait.LOAD

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """|load| v."""
        return (np.abs(_transmitted(motion, j, int(shape[0]))) * motion.qd[:, j])[:, None]


def _coupled_friction_brakes(f: Fitted) -> bool:
    """Friction of a relative motion brakes it; which way another joint's cable rubs is open."""
    w = f.motion.qd[:, f.j] + f.shape[1] * f.motion.qd[:, int(f.shape[0]) - 1]
    return not f.shape[1] or brakes(w, f.beta, f.slack)


def _coupled_friction_grid(motion: Motion, j: int) -> Shapes:
    """Every other joint, alone and relative to this one."""
    others = [k for k in range(motion.d) if k != j]
    return [(k + 1.0, s * even_ratio(motion, j, k)) for k in others for s in (0.0, 1.0, -1.0)]


def _coupled_friction_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Other ratios of the joint that was found: pulleys of other radii; the present one first."""
    k, mode = shape
    even = even_ratio(motion, j, int(k) - 1)
    return [(k, mode), *((k, x) for x in other_ratios(mode, even) if mode)]


class CoupledFriction(Effect):
    """Friction on this joint caused by another joint's motion (cables over its pulleys)."""

    name, family = "coupled-friction", "friction"
    doc = Doc(
        equation="tau = fk tanh(w / v0) + vk w,  w = v_k or v + r v_k",
        signature="residual follows the sign of another joint's speed",
        confused_with=("rigid-body", "coupled-transmission"),
        shown_by="one joint at a time, then pairs with all combinations of signs",
        source="Naerum thesis 3.1.2; Miyasaka, Haghighipanah, Li, Hannaford, ICRA 2016",
        over=Over.OTHER_SPEED,
        formulas=(f"tanh({_RELATIVE} / max({_OWN} * v0, {_SIDE} * v0k))", _RELATIVE),
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
            "0: w = v_k; else w = v + r v_k, r = the mode",
            -10.0,
            10.0,
            codes=(
                (0.0, "the other joint's speed"),
                (1.0, "the sum of both speeds"),
                (-1.0, "the difference of both speeds"),
            ),
        ),
    )
    scope = Scope(lacks=one_joint)
    search = Grid(_coupled_friction_grid, across=_coupled_friction_across, refine=False, rounds=4)
    limits = (Limit("drives", _coupled_friction_brakes, says="it would drive the joint"),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[tanh(w / v0), w]."""
        k, mode = int(shape[0]) - 1, shape[1]
        own, side = float(bool(mode)), mode or 1.0
        w = own * motion.qd[:, j] + side * motion.qd[:, k]
        slope = own * motion.qdd[:, j] + side * motion.qdd[:, k]
        v0 = float(max(own * motion.v0[j], abs(side) * motion.v0[k]))
        return np.stack([motion.sign_of(w, slope, v0), w], axis=1)


#: Places over another joint's range from which its bend may count.  Half: the climb ends beside a
#: kink that lies between two of them; double: twice the time, and it finds the same one.
_PLACES = 9


def _posture_friction_grid(motion: Motion, j: int) -> Shapes:
    """Places over the range of every other joint that moves, both ends among them."""
    ranges = [(k, *motion.span[k]) for k in _others(motion, j)]
    return [
        (float(q0), k + 1.0) for k, low, high in ranges for q0 in np.linspace(low, high, _PLACES)
    ]


def _others(motion: Motion, j: int) -> list[int]:
    """The other joints that move."""
    return [k for k in range(motion.d) if k != j and motion.span[k, 1] > motion.span[k, 0]]


def _no_other(motion: Motion, j: int) -> str:
    """Why there is no other joint's position to follow; empty where there is."""
    return one_joint(motion, j) or ("" if _others(motion, j) else "no other joint moves")


def _posture_friction_foils(motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
    """Viscous friction that varies with the other joint, and an effort that does not turn."""
    bends, v = _bends(motion, shape), motion.qd[:, j : j + 1]
    return [bends * v, bends]


def _bends(motion: Motion, shape: Sequence[float]) -> FloatArray:
    """[|q_k - q0|, (q_k - q0)^2], shape (n, 2)."""
    away = np.abs(motion.q[:, int(shape[1]) - 1] - shape[0])
    return np.stack([away, away * away], axis=1)


class PostureFriction(Effect):
    """Friction that varies with another joint's position: its bend presses this joint's cable."""

    name, family = "posture-friction", "friction"
    doc = Doc(
        equation="tau = tanh(v / v0) (b |q_k - q0| + c (q_k - q0)^2)",
        signature="the friction's size follows another joint's position, its sign the own speed",
        confused_with=("load-friction", "position-friction", "coupled-friction"),
        shown_by="one joint moves to and fro while another one stands at several places",
        source=(
            "Kaneko, Wada, Maekawa, Tanie, IEEE ICRA, 1991; Palli, Borghesan, Melchiorri, IEEE "
            "Trans. Robotics 28(2), 2012 (friction of a tendon grows with the angle of its bends); "
            "the polynomial is a choice of form"
        ),
        shown=Sight.REVERSALS,
        formulas=("sign * abs(qk - q0)", "sign * (qk - q0) ** 2"),
    )
    params = (
        Param("b", "{F}/{y}", "friction per angle of the bend"),
        Param("c", "{F}/{y}^2", "friction per square of it"),
    )
    shape = (
        Param("q0", "{y}", "the other joint's position from which the bend counts"),
        Param(JOINT, "1", "number of the other joint", 1.0, choice=True),
    )
    relations = Relations(foils=_posture_friction_foils)
    scope = Scope(lacks=_no_other)
    search = Grid(_posture_friction_grid)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """tanh(v / v0) times [|q_k - q0|, (q_k - q0)^2]."""
        return motion.sign(j)[:, None] * _bends(motion, shape)


def _capstan_friction_grid(motion: Motion, j: int) -> Shapes:
    """The places of friction that follows a bend, for every load that differs."""
    loads = [of for of, _ in _load_friction_grid(motion, j)]
    return [(*place, of) for of in loads for place in _posture_friction_grid(motion, j)]


class CapstanFriction(Effect):
    """Load friction of a cable that another joint bends: it grows with tension and angle."""

    name, family = "capstan-friction", "friction"
    doc = Doc(
        equation=(
            "tau = tanh(v / v0) |load| (b |q_k - q0| + c (q_k - q0)^2),  beside load friction; "
            "the series of exp(mu |q_k - q0|) - 1"
        ),
        signature="friction per load follows another joint's position",
        confused_with=("posture-friction", "load-friction"),
        shown_by="the same load moved while another joint stands at several places",
        source="Palli, Borghesan, Melchiorri, IEEE Trans. Robotics 28(2), 2012 (capstan equation)",
        shown=Sight.LOAD,
    )
    params = (
        Param("b", "1/{y}", "friction per load and angle of the bend"),
        Param("c", "1/{y}^2", "friction per load and square of it"),
    )
    shape = (*PostureFriction.shape, _OF_LOAD)
    relations = Relations(extends=("load-friction",))
    scope = Scope(lacks=_no_other)
    search = Grid(_capstan_friction_grid)
    traits = Trait.LOAD

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """tanh(v / v0) |load| [|q_k - q0|, (q_k - q0)^2]."""
        rubs = np.abs(_transmitted(motion, j, int(shape[2]))) * motion.sign(j)
        return rubs[:, None] * _bends(motion, shape)


#: Which load of another joint rubs, in words.
_OF_ANOTHER = ("all that it transmits", "its gravity and springs only", "the effort of its motor")


def _coupled_load_friction_grid(motion: Motion, j: int) -> Shapes:
    """Every other joint that moves, with its loads that differ."""
    return [(k + 1.0, of) for k in _others(motion, j) for of, _ in _load_friction_grid(motion, k)]


def _coupled_load_friction_foils(
    motion: Motion, j: int, shape: Sequence[float]
) -> Sequence[FloatArray]:
    """Viscous friction under the same load, and an effort that does not turn with the speed."""
    load = np.abs(_transmitted(motion, int(shape[0]) - 1, int(shape[1])))[:, None]
    return [load * motion.qd[:, j : j + 1], load]


class CoupledLoadFriction(Effect):
    """Friction that grows with another joint's effort: a slewing ring, a cable over this pulley."""

    name, family = "coupled-load-friction", "friction"
    doc = Doc(
        equation=(
            "tau = mu |load_k| tanh(v / v0),  load_k = all that another joint transmits, its "
            "static part, or its motor's effort"
        ),
        signature="friction grows with the gravity, acceleration or contact load of another joint",
        confused_with=("posture-friction", "load-friction", "coupled-friction"),
        shown_by="this joint moves to and fro while another one carries several static loads",
        source=(
            "Harris, Kotzalas, Essential Concepts of Bearing Technology, 5th ed., 2006, ch. 10 "
            "(Palmgren: friction of a bearing grows in proportion to its load); Palli, Borghesan, "
            "Melchiorri, IEEE Trans. Robotics 28(2), 2012 (a cable's with its tension)"
        ),
        shown=Sight.LOAD,
    )
    params = (Param("mu", EFFORT_RATIO, "friction per effort of the other joint", 0.0),)
    shape = (
        Param(JOINT, "1", "number of the other joint", 1.0, choice=True),
        replace(_OF_LOAD, codes=tuple(zip((0.0, 1.0, 2.0), _OF_ANOTHER, strict=True))),
    )
    relations = Relations(foils=_coupled_load_friction_foils)
    scope = Scope(lacks=_no_other)
    search = Grid(_coupled_load_friction_grid)
    traits = Trait.LOAD

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """|load_k| tanh(v / v0)."""
        load = _transmitted(motion, int(shape[0]) - 1, int(shape[1]))
        return (np.abs(load) * motion.sign(j))[:, None]


EFFECTS = (
    LoadFriction(),
    LoadViscous(),
    CoupledFriction(),
    PostureFriction(),
    CapstanFriction(),
    CoupledLoadFriction(),
)
