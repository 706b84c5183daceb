"""Friction of a joint by its own motion: speed, position, displacement since the last reversal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from hil.models.effect import (
    STRICT,
    VALUE_DEVIATIONS,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Over,
    Param,
    Relations,
    Shapes,
    Sight,
    Trait,
    Waves,
    log_grid,
    position_orders,
    typical_speed,
)
from hil.models.kernels import dahl_state, lugre_state, slip_state
from hil.models.motion import FloatArray, Motion
from hil.models.parts import Others

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
_SPOTS, _APART = (1 / 32, 1 / 10), 1.5
#: The widest, in shares of the range.  Half: a spot of a fifth of the range goes unnamed; double:
#: any smooth change is one.
_WIDEST = 1 / 8
#: Other widths about a found one.
NARROWER = (0.5, 0.7, 0.85, 0.95, 1.05, 1.18, 1.4, 2.0)


def _local_friction_grid(motion: Motion, j: int) -> Shapes:
    """Places over the range, as dense as each width asks for."""
    low, high = (float(x) for x in motion.span[j])
    length = max(high - low, 1e-9)
    return [
        (float(q0), length * share)
        for share in _SPOTS
        for q0 in np.linspace(low, high, int(1 / (_APART * share)) + 2)[1:-1]
    ]


def _local_friction_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Narrower and wider spots."""
    low, high = motion.span[j]
    most = max(float(high - low), 1e-9) * _WIDEST
    return [(shape[0], x) for x in (shape[1] * r for r in NARROWER) if x <= most]


def _local_friction_foils(motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
    """An effort at the same place that does not turn with the speed."""
    return [_spot(motion, j, shape)[:, None]]


def _local_friction_within(f: Fitted) -> bool:
    """The place lies within the range, and most of the range lies beside it."""
    low, high = f.motion.span[f.j]
    return bool(low <= f.shape[0] <= high and f.shape[1] <= _WIDEST * (high - low))


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


# ------------------------------------------------------------ presliding

#: Value of `form` that stands for LuGre's.
LUGRE = 2.0
#: Words for its values.
_FORMS = ((0.0, "Maxwell slip"), (1.0, "Dahl"), (LUGRE, "LuGre"))
#: Displacement of each loop, in units of s.
WIDTHS = {"f1": 1, "f2": 3, "f3": 9}
#: Least displacement over which friction builds up, in units of the least that is tried.
FORM_REACH = 1.1
#: Share of the friction that loops carry at least, to be more than the error of a sign's form.
LOOP_SHARE = 0.02


def _loops(motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
    """Sign, and the three loops of a form, shape (n, 4)."""
    q, s = np.ascontiguousarray(motion.q[:, j]), float(shape[0])
    if shape[1] == LUGRE:
        loops = _lugre(q, motion.qd[:, j], s, float(shape[3]), motion.dt)
    else:
        state = slip_state if shape[1] == 0.0 else dahl_state
        loops = [state(q, k * s) for k in WIDTHS.values()]
    return np.stack([motion.sign(j, float(shape[2])), *loops]).T


def _presliding_state(
    motion: Motion, j: int, shape: Sequence[float], beta: Sequence[float]
) -> FloatArray | None:
    """Nested loops by their shares of the sliding friction, sum f z / sum f."""
    count = 2 if shape[1] == LUGRE else len(beta)  # in LuGre's form the rest fades in sliding
    share = np.array(beta[:count], dtype=np.float64)
    if float(share.sum()) <= 0.0:
        return None
    out: FloatArray = _loops(motion, j, shape)[:, :count] @ (share / share.sum())
    return out


def _presliding_remark(values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    """LuGre's law without a rise of its level is Dahl's; s is not the width of every loop."""
    if values["form"] != LUGRE:
        most = max(WIDTHS, key=lambda n: values[n])
        times = WIDTHS[most]
        if times == 1:
            return ""
        return f"{most} builds up over {times} s = {times * values['s']:.4g}, in the unit of s"
    if values["f2"] > VALUE_DEVIATIONS * errors["f2"]:
        return ""
    return (
        f"its rise at low speed (f2) is within {VALUE_DEVIATIONS:g} standard errors of zero: read "
        "it as Dahl's law, without vs"
    )


#: A displacement is the least that is tried from this share of it on.
AT_THE_END = 1.02


def _least(motion: Motion, j: int) -> float:
    """Least displacement that is tried for joint j [rad or m]."""
    span = float(np.ptp(motion.span[j])) or 1.0
    grain = float(motion.grain[j]) if motion.grain.size else 0.0
    return min(max(1e-4 * span, 2 * grain), 4e-2 * span)


def _presliding_grid(motion: Motion, j: int) -> Shapes:
    """From 1e-4 of the span, and from twice what the encoder resolves, to 5e-2 of the span."""
    span, least = float(np.ptp(motion.span[j])) or 1.0, _least(motion, j)
    v0, scales = float(motion.v0[j]), log_grid(least, 5e-2 * span, 10)
    return [(s, form, v0, 0.0) for form in (0.0, 1.0) for (s,) in scales]


def _presliding_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Sign resolutions (without the loops Coulomb's sign was smeared out to imitate them)."""
    return [(*shape[:2], v0, shape[3]) for (v0,) in Coulomb.search.grid(motion, j)]


def _presliding_carries(f: Fitted) -> bool:
    """Loops that carry a part of the friction, one of them surely; else it is a blunt sign."""
    sure = any(b > e for b, e in zip(f.beta[1:], f.slack[1:], strict=True))
    part = sum(f.beta[1:]) > LOOP_SHARE * sum(f.beta)
    return sure and part


def _presliding_wide(f: Fitted) -> bool:
    """Over more than the least displacement that is tried: else a sign that turns a little late.

    Bristles that carry and are damped show by their damping, however stiff they are, but at the
    end of what is tried.
    """
    least = LOOP_SHARE * sum(f.beta)
    carries = [b > max(e, least) for b, e in zip(f.beta, f.slack, strict=True)]
    inside = f.shape[0] > AT_THE_END * _least(f.motion, f.j)
    if f.shape[1] == LUGRE and carries[1] and carries[3] and inside:
        return True
    widest = 1.0 if f.shape[1] == LUGRE or not carries[3] else 9.0
    return widest * f.shape[0] >= FORM_REACH * _least(f.motion, f.j)


def _presliding_others(motion: Motion, j: int, shape: Sequence[float]) -> Others | None:
    """LuGre's form, against the usual one with a Stribeck curve and a drag beside it."""
    s, _, v0, _ = shape
    speeds = [vs for vs, n in Stribeck.search.grid(motion, j) if n == 2.0]
    lugre = [(x, LUGRE, v0, vs) for vs in speeds for (x,) in log_grid(0.7 * s, 6 * s, 5)]
    # the stiffest of several loops may be a ninth of what single bristles are
    some = [(x, form) for form in (0.0, 1.0) for (x,) in log_grid(s, 9 * s, 4)]
    beside: Shapes = [(x, form, v0, vs) for vs in speeds for x, form in some]
    return [tuple(map(float, x)) for x in lugre], _BESIDE, beside


class Presliding(Effect):
    """Friction that needs a displacement to build up after each reversal.

    It takes the place of Coulomb friction: what builds up within less than the data resolve
    stays as a sign.  LuGre's form, with a Stribeck curve inside its level, is taken where it
    leaves less than loops, a Stribeck curve and a drag beside each other; f2 = 0 and f2 = f1 are
    then LuGre's equation, between them lies a mean of the two.
    """

    name, family = "presliding", "friction"
    doc = Doc(
        equation=(
            "tau = f0 tanh(v / v0) + f1 z(s) + f2 z(3 s) + f3 z(9 s),  "
            "z <- clip(z + dq / s, -1, 1) (Maxwell slip) or dz/dq = (1 - z sgn v) / s (Dahl); "
            "LuGre: f1 z + f2 (z' - z) + f3 s/vs dz/dt, "
            "z' with g = 1 + exp(-(v/vs)^2) in dz/dq = (1 - z sgn v / g) / s, z with g = 1"
        ),
        signature="a loop over the displacement since reversal, independent of speed",
        confused_with=("backlash", "elastic-transmission", "stribeck", "delay"),
        shown_by="small reversals below break-away, at two or more frequencies",
        source=(
            "Dahl 1968; Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Trans. Automatic "
            "Control 40(3), 1995; Lampaert, Swevers, Al-Bender, IEEE Trans. Automatic Control "
            "47(4), 2002"
        ),
        caveat=(
            "dry friction of a link behind a stiff cable or belt builds up over a displacement, "
            "too: below the resonance a motor's data do not say which of the two gives"
        ),
        remark=_presliding_remark,
        shown=Sight.SLOW | Sight.REVERSALS,
        over=Over.DISPLACEMENT,
    )
    params: ClassVar[tuple[Param, ...]] = (
        Param("f0", "{F}", "sliding friction that builds up at once", 0.0),
        Param("f1", "{F}", "sliding friction of the stiffest element", 0.0),
        Param("f2", "{F}", "of the element three times as soft; LuGre: Fs - Fc", 0.0),
        Param("f3", "{F}", "of the element nine times as soft; LuGre: sigma_1 vs", 0.0),
    )
    shape = (
        Param("s", "{x}", "presliding displacement", 0.0, size=True),
        Param("form", "1", "0 Maxwell slip, 1 Dahl, 2 LuGre", 0.0, 2.0, codes=_FORMS, choice=True),
        Param("v0", "{x}/s", "speed over which the sign of f0 is resolved", 0.0),
        Param(
            "vs",
            "{x}/s",
            "LuGre: Stribeck speed; else 0",
            0.0,
            codes=((0.0, "not in this form"),),
            size=True,
        ),
    )
    relations = Relations(replaces=("coulomb",), state=_presliding_state)
    search = Grid(_presliding_grid, across=_presliding_across, others=_presliding_others)
    limits = (
        Limit(
            "stiff",
            _presliding_wide,
            says="it slides within the least displacement that can be seen",
            unseen=True,
        ),
        Limit("blunt", _presliding_carries, says="its loops carry too little of the friction"),
        STRICT,
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[sign, z(q; s), z(q; 3 s), z(q; 9 s)]: nested loops; or LuGre's three parts."""
        return _loops(motion, j, shape)


def _lugre(q: FloatArray, v: FloatArray, s: float, vs: float, dt: float) -> list[FloatArray]:
    """Bristles at a constant level, their rise at low speed, and their damping, each (n,)."""
    even = lugre_state(q, np.ones(q.size), s)
    # g(v) = 1 + exp(-(v / vs)^2)
    risen = lugre_state(q, 1.0 + np.exp(-((v / vs) ** 2)), s)
    return [even, risen - even, s / vs * np.gradient(risen, dt)]


class _Beside(Presliding):
    """Loops, a Stribeck curve and a drag beside each other: what LuGre's form has to beat.

    A level that rises over most of the speeds would else stand for a curve that bends upwards.
    """

    name = "presliding-stribeck-and-drag"
    params = (*Presliding.params, *Stribeck.params, *QuadraticDrag.params)
    traits = Presliding.traits | Trait.GIVEN

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """The four of presliding, exp(-(v / vs)^2) sgn, and v |v|."""
        loops, v = _loops(motion, j, (*shape[:3], 0.0)), motion.qd[:, j]
        curves = np.stack([np.exp(-((v / shape[3]) ** 2)) * loops[:, 0], v * np.abs(v)], axis=1)
        return np.concatenate([loops, curves], axis=1)


_BESIDE = _Beside()


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
    Presliding(),
)
