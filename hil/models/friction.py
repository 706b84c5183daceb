"""Friction as a function of speed and position.

Friction set by more than the own speed: by the load, or by another joint's motion or place.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.models.effect import (
    STRICT,
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
    Waves,
    brakes,
    even_ratio,
    log_grid,
    motor_inertias,
    one_joint,
    other_ratios,
    position_orders,
    typical_speed,
)
from hil.models.motion import FloatArray, Motion
from hil.models.parts import JOINT

_OLSSON = "Olsson, Astrom, Canudas de Wit, Gafvert, Lischinsky, Eur. J. Control 4, 1998"


#: What `harmonics` makes, as text.
HARMONICS = (
    "sin(2 * pi * p * q)",
    "cos(2 * pi * p * q)",
    "sin(4 * pi * p * q)",
    "cos(4 * pi * p * q)",
)
#: Their coefficients.
AMPLITUDES = tuple(Param(n, "{F}", "amplitude over position") for n in ("a1", "b1", "a2", "b2"))
#: Speed of two joints against each other, by mode: of 0 the other one's alone.
_OWN = "min(1, 1e9 * abs(mode))"
_SIDE = f"abs(mode + 1 - {_OWN})"
_RELATIVE = f"({_OWN} * v + (mode + 1 - {_OWN}) * vk)"


def _column(values: FloatArray) -> FloatArray:
    return values[:, None]


def _coulomb_grid(motion: Motion, j: int) -> Shapes:
    """From the velocity resolution up to a tenth of the typical speed."""
    low = float(motion.resolution[j])
    return log_grid(low, max(0.1 * typical_speed(motion, j), 1.01 * low), 7)


class Coulomb(Effect):
    """Constant friction against the motion."""

    name, family = "coulomb", "friction"
    doc = Doc(
        equation="tau = fc tanh(v / v0)",
        signature="a step of the residual at every reversal, the same at all speeds",
        confused_with=("stribeck", "presliding", "torque-offset"),
        shown_by="slow motion in both directions",
        source=_OLSSON,
        over=Over.SPEED,
        formulas=("sign",),
    )
    params = (Param("fc", "{F}", "Coulomb friction", 0.0),)
    shape = (Param("v0", "{x}/s", "speed over which the sign is resolved", 0.0),)
    search = Grid(_coulomb_grid, sharpest=True, at_resolution=True)
    traits = Trait.GIVEN | Trait.DRY

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """tanh(v / v0)."""
        return _column(motion.sign(j, float(shape[0])))


class Viscous(Effect):
    """Friction proportional to speed."""

    name, family = "viscous", "friction"
    doc = Doc(
        equation="tau = fv v",
        signature="residual proportional to speed, odd",
        confused_with=("quadratic-drag", "stribeck"),
        shown_by="the same path at several speeds",
        source=_OLSSON,
        over=Over.SPEED,
        formulas=("v",),
    )
    params = (Param("fv", "{F} s/{x}", "viscous friction", 0.0),)
    traits = Trait.GIVEN | Trait.MOTION | Trait.VISCOUS

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Speed v."""
        return _column(motion.qd[:, j])


def _stribeck_grid(motion: Motion, j: int) -> Shapes:
    """From twice the sign resolution up to 0.7 of the typical speed."""
    speed = typical_speed(motion, j)
    slow = log_grid(max(2 * motion.v0[j], 0.03 * speed), 0.7 * speed, 8)
    return [(vs, n) for n in (2.0, 1.0, 0.5) for (vs,) in slow]


class Stribeck(Effect):
    """Friction that rises as the speed goes to zero."""

    name, family = "stribeck", "friction"
    doc = Doc(
        equation="tau = fs exp(-|v / vs|^n) tanh(v / v0)",
        signature="friction peak at low speed that fades over vs",
        confused_with=("quadratic-drag", "presliding", "coulomb"),
        shown_by="slow constant-speed strokes in both directions, log-spaced speeds",
        source="Stribeck 1902; " + _OLSSON,
        shown=Sight.SLOW,
        over=Over.SPEED,
        formulas=("exp(-(abs(v / vs) ** n)) * sign",),
    )
    params = (Param("fs", "{F}", "excess of static over Coulomb friction", 0.0),)
    shape = (
        Param("vs", "{x}/s", "Stribeck speed", 0.0, size=True),
        Param(
            "n",
            "1",
            "exponent: 2 Gaussian, 1 exponential, less: long tail",
            0.25,
            2.0,
            codes=((2.0, "Gaussian"), (1.0, "exponential"), (0.5, "long tail")),
        ),
    )
    search = Grid(_stribeck_grid)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """exp(-|v / vs|^n) tanh(v / v0)."""
        return _column(np.exp(-(np.abs(motion.qd[:, j] / shape[0]) ** shape[1])) * motion.sign(j))


class AsymmetricCoulomb(Effect):
    """Coulomb friction that differs between the two directions."""

    name, family = "asymmetric-coulomb", "friction"
    doc = Doc(
        equation="tau = da |tanh(v / v0)|",
        signature="the same residual in both directions while moving, none at rest",
        confused_with=("torque-offset",),
        shown_by="motion with rests: an offset stays at rest, this does not",
        source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994",
        over=Over.SPEED,
        formulas=("abs(sign)",),
    )
    params = (Param("da", "{F}", "half the difference of the two directions"),)
    relations = Relations(causes=("constant",))

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """|tanh(v / v0)|."""
        return _column(np.abs(motion.sign(j)))


class AsymmetricViscous(Effect):
    """Viscous friction that differs between the two directions."""

    name, family = "asymmetric-viscous", "friction"
    doc = Doc(
        equation="tau = dv |v|",
        signature="even residual that grows with speed",
        confused_with=("asymmetric-coulomb", "position-torque"),
        shown_by="the same path at several speeds, both directions",
        source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994",
        over=Over.SPEED,
        formulas=("abs(v)",),
    )
    params = (Param("dv", "{F} s/{x}", "half the difference of the two directions"),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """|v|."""
        return _column(np.abs(motion.qd[:, j]))


class QuadraticDrag(Effect):
    """Drag that grows with the square of the speed."""

    name, family = "quadratic-drag", "friction"
    doc = Doc(
        equation="tau = fd v |v|",
        signature="odd residual that curves upwards with speed",
        confused_with=("stribeck", "viscous"),
        shown_by="fast strokes beside slow ones",
        source="Swevers, Verdonck, De Schutter, IEEE Control Systems 27(5), 2007",
        over=Over.SPEED,
        formulas=("v * abs(v)",),
    )
    params = (Param("fd", "{F} s^2/{x}^2", "quadratic drag", 0.0),)
    limits = (STRICT,)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Signed square v |v|."""
        return _column(motion.qd[:, j] * np.abs(motion.qd[:, j]))


#: Exponents of a film that thins.  Below the least it is dry friction, above the largest viscous.
THINNING = (0.2, 0.35, 0.5, 0.65, 0.8, 0.95)


def _sublinear_viscous_grid(motion: Motion, j: int) -> Shapes:
    """Exponents between those of dry and of viscous friction."""
    return [(p,) for p in THINNING]


def _sublinear_viscous_between(f: Fitted) -> bool:
    """Neither dry nor viscous friction: the exponent lies within its range."""
    return THINNING[0] < f.shape[0] < THINNING[-1]


class SublinearViscous(Effect):
    """Viscous friction that grows less than the speed: grease that thins as it is sheared."""

    name, family = "sublinear-viscous", "friction"
    doc = Doc(
        equation="tau = fp |v|^p sgn v,  p < 1",
        signature="odd residual that bends downwards with speed",
        confused_with=("stribeck", "viscous", "coulomb"),
        shown_by="the same stroke at speeds over two decades",
        source=(
            "Waiboer, Aarts, Jonker, IUTAM Symposium on Vibration Control, 2005 (viscous friction "
            "with an exponent); Bair, High-Pressure Rheology, 2007 (lubricants that thin)"
        ),
        over=Over.SPEED,
        formulas=("sign * abs(v) ** p",),
    )
    params = (Param("fp", "{F}", "friction at unit speed", 0.0),)
    shape = (Param("p", "1", "exponent of the speed", 0.0, 1.0),)
    relations = Relations(replaces=("viscous",))
    search = Grid(_sublinear_viscous_grid)
    limits = (
        Limit(
            "between",
            _sublinear_viscous_between,
            says="its exponent is that of dry or of viscous friction",
        ),
        STRICT,
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Friction's state times |v|^p."""
        return _column(motion.sign(j) * np.abs(motion.qd[:, j]) ** float(shape[0]))


def _position_friction_foils(
    motion: Motion, j: int, shape: Sequence[float]
) -> Sequence[FloatArray]:
    """Viscous friction that varies with position, as fast and as slowly as can be."""
    v, q = motion.qd[:, j : j + 1], motion.q[:, j]
    return [v * harmonics(q, p) for p in {shape[0], _position_friction_grid(motion, j)[0][0]}]


def _position_friction_carrier(motion: Motion, j: int) -> FloatArray:
    """Sign of the speed."""
    return motion.sign(j)


def _position_friction_grid(motion: Motion, j: int) -> Shapes:
    """Every half order over the span, from half a period on."""
    return position_orders(motion, j, 25.0, 0.5)


class PositionFriction(Effect):
    """Friction that varies with position: an eccentric pulley, a tight spot, a worn range.

    With half a period over the span the harmonics are, beside Coulomb's constant, what a
    polynomial of fourth degree is: any smooth change.
    """

    name, family = "position-friction", "friction"
    doc = Doc(
        equation="tau = tanh(v / v0) (a1 sin kq + b1 cos kq + a2 sin 2kq + b2 cos 2kq), k = 2 pi p",
        signature="the friction's size repeats over position, its sign follows the direction",
        confused_with=("cogging",),
        shown_by="full slow strokes in both directions",
        source="Popovic, Goldenberg, IEEE Trans. Robotics and Automation 14(1), 1998",
        over=Over.POSITION,
        formulas=tuple(f"sign * {wave}" for wave in HARMONICS),
    )
    params = AMPLITUDES
    shape = (
        Param("p", "1/{x}", "periods per unit of position; least: a smooth change", 0.0, size=True),
    )
    relations = Relations(causes=("place",), foils=_position_friction_foils)
    search = Waves(_position_friction_grid, carrier=_position_friction_carrier, at_resolution=True)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """sgn(v) times two harmonics over position."""
        return motion.sign(j)[:, None] * harmonics(motion.q[:, j], shape[0])


#: Widths of a tight spot that are sought, in shares of the range, and how far apart its places are
#: in widths.  Half the widths: a spot of a few percent lies between two places; double: what is
#: found is a smooth change, which harmonics follow.
SPOTS, APART = (1 / 32, 1 / 10), 1.5
#: The widest, in shares of the range.  Half: a spot of a fifth of the range goes unnamed; double:
#: any smooth change is one.
WIDEST = 1 / 8
#: Other widths about a found one.
NARROWER = (0.5, 0.7, 0.85, 0.95, 1.05, 1.18, 1.4, 2.0)


def _local_friction_grid(motion: Motion, j: int) -> Shapes:
    """Places over the range, as dense as each width asks for."""
    low, high = (float(x) for x in motion.span[j])
    length = max(high - low, 1e-9)
    return [
        (float(q0), length * share)
        for share in SPOTS
        for q0 in np.linspace(low, high, int(1 / (APART * share)) + 2)[1:-1]
    ]


def _local_friction_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Narrower and wider spots."""
    low, high = motion.span[j]
    most = max(float(high - low), 1e-9) * WIDEST
    return [(shape[0], x) for x in (shape[1] * r for r in NARROWER) if x <= most]


def _local_friction_foils(motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
    """An effort at the same place that does not turn with the speed."""
    return [_spot(motion, j, shape)[:, None]]


def _local_friction_within(f: Fitted) -> bool:
    """The place lies within the range, and most of the range lies beside it."""
    low, high = f.motion.span[f.j]
    return bool(low <= f.shape[0] <= high and f.shape[1] <= WIDEST * (high - low))


def _spot(motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
    """exp(-((q - q0) / w)^2), shape (n,)."""
    out: FloatArray = np.exp(-(((motion.q[:, j] - shape[0]) / shape[1]) ** 2))
    return out


class LocalFriction(Effect):
    """Friction that is another one at one place: a worn bearing, a dent, a dry or a tight spot."""

    name, family = "local-friction", "friction"
    doc = Doc(
        equation="tau = exp(-((q - q0) / w)^2) (fl tanh(v / v0) + dl v)",
        signature="more or less friction in both directions about one position, none elsewhere",
        confused_with=("position-friction", "end-stop"),
        shown_by="slow strokes over the place, in both directions",
        source=(
            "Harris, Kotzalas, Essential Concepts of Bearing Technology, 2006 (brinelling and wear "
            "of a part of a race); the Gaussian is a choice of form"
        ),
        over=Over.POSITION,
        formulas=("exp(-(((q - q0) / w) ** 2)) * sign", "exp(-(((q - q0) / w) ** 2)) * v"),
    )
    params = (
        Param("fl", "{F}", "dry friction that is added at the place"),
        Param("dl", "{F} s/{x}", "viscous friction that is added at the place"),
    )
    shape = (
        Param("q0", "{x}", "the place"),
        Param("w", "{x}", "distance at which a third of it is left", 0.0, size=True),
    )
    relations = Relations(causes=("place",), foils=_local_friction_foils)
    search = Grid(_local_friction_grid, across=_local_friction_across, rounds=3)
    limits = (
        Limit(
            "outside",
            _local_friction_within,
            says="the place lies outside the range, or takes much of it",
        ),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """exp(-((q - q0) / w)^2) times [tanh(v / v0), v]."""
        moves = np.stack([motion.sign(j), motion.qd[:, j]], axis=1)
        return _spot(motion, j, shape)[:, None] * moves


def harmonics(q: FloatArray, p: float) -> FloatArray:
    """[sin kq, cos kq, sin 2kq, cos 2kq] with k = 2 pi p, shape (n, 4)."""
    phase = 2 * np.pi * p * q
    s, c = np.sin(phase), np.cos(phase)
    return np.stack([s, c, 2 * s * c, c * c - s * s]).T


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
    traits = Trait.LOAD

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """|load| sgn(v)."""
        of = int(shape[0])
        load = _transmitted(motion, j, of)
        load = load - shape[1] * motion.qdd[:, j] if shape[1] else load
        return (np.abs(load) * motion.sign(j))[:, None]


def _transmitted(motion: Motion, j: int, of: int) -> FloatArray:
    """The load of a form of load friction, shape (n,)."""
    return motion.driven(j) if of == 2 else (motion.load, motion.static)[of][:, j]


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
PLACES = 9


def _posture_friction_grid(motion: Motion, j: int) -> Shapes:
    """Places over the range of every other joint that moves, both ends among them."""
    ranges = [(k, *motion.span[k]) for k in _others(motion, j)]
    return [
        (float(q0), k + 1.0) for k, low, high in ranges for q0 in np.linspace(low, high, PLACES)
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
        Param("b", "{F}/{x}", "friction per angle of the bend"),
        Param("c", "{F}/{x}^2", "friction per square of it"),
    )
    shape = (
        Param("q0", "{x}", "the other joint's position from which the bend counts"),
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
        Param("b", "1/{x}", "friction per load and angle of the bend"),
        Param("c", "1/{x}^2", "friction per load and square of it"),
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


EFFECTS = (
    Coulomb(),
    Viscous(),
    Stribeck(),
    AsymmetricCoulomb(),
    AsymmetricViscous(),
    QuadraticDrag(),
    SublinearViscous(),
    PositionFriction(),
    LocalFriction(),
    LoadFriction(),
    LoadViscous(),
    CoupledFriction(),
    PostureFriction(),
    CapstanFriction(),
)
