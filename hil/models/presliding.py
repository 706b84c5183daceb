"""Presliding: friction as a state of the displacement since the last reversal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numba
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
    log_grid,
)
from hil.models.friction import Coulomb, QuadraticDrag, Stribeck
from hil.models.motion import FloatArray, Motion
from hil.models.parts import Others

#: Value of `form` that stands for LuGre's.
LUGRE = 2.0
#: Words for its values.
FORMS = ((0.0, "Maxwell slip"), (1.0, "Dahl"), (LUGRE, "LuGre"))
#: Displacements at which elements of a hysteresis slip, as shares of the range.
SLIPS = (0.001, 0.003, 0.01, 0.03)
#: Least displacement over which friction builds up, in units of the least that is tried.
FORM_REACH = 1.1
#: Share of the friction that loops carry at least, to be more than the error of a sign's form.
LOOP_SHARE = 0.02


@numba.njit(cache=True, nogil=True)
def dahl_state(q: FloatArray, scale: float) -> FloatArray:
    """Dahl's state for a measured position, exact between samples.

    dz/dq = (1 - z sgn v) / s   =>   z <- sgn + (z - sgn) exp(-|dq| / s)

    Parameters
    ----------
    q : ndarray (n,)
        Position [rad or m].
    scale : float
        Presliding displacement s [rad or m].

    Returns
    -------
    ndarray (n,)
        State in [-1, 1]; friction is fc z.
    """
    z = np.zeros(q.size)
    for k in range(1, q.size):
        step = q[k] - q[k - 1]
        goal = 1.0 if step > 0 else -1.0
        z[k] = goal + (z[k - 1] - goal) * np.exp(-abs(step) / scale)
    return z


@numba.njit(cache=True, nogil=True)
def slip_state(q: FloatArray, scale: float) -> FloatArray:
    """State of a Maxwell-slip element: a spring that slips at the displacement `scale`.

    z <- clip(z + dq / s, -1, 1)

    Parameters
    ----------
    q : ndarray (n,)
        Position [rad or m].
    scale : float
        Displacement s at which it slips [rad or m].

    Returns
    -------
    ndarray (n,)
        State in [-1, 1]; friction is fc z.
    """
    z = np.zeros(q.size)
    for k in range(1, q.size):
        z[k] = min(max(z[k - 1] + (q[k] - q[k - 1]) / scale, -1.0), 1.0)
    return z


@numba.njit(cache=True, nogil=True)
def lugre_state(q: FloatArray, level: FloatArray, scale: float) -> FloatArray:
    """LuGre's bristles for a measured position, exact for a level that is constant over a step.

    dz/dt = v / s - |v| / s z / g(v)   =>   z <- g sgn + (z - g sgn) exp(-|dq| / (s g))

    Parameters
    ----------
    q : ndarray (n,)
        Position [rad or m].
    level : ndarray (n,)
        g(v) > 0, in units of the Coulomb friction.
    scale : float
        Displacement s = Fc / sigma_0 [rad or m].

    Returns
    -------
    ndarray (n,)
        Deflection in units of s, within -g..g; friction is Fc z.
    """
    z = np.zeros(q.size)
    for k in range(1, q.size):
        step = q[k] - q[k - 1]
        g = 0.5 * (level[k] + level[k - 1])
        goal = g if step > 0 else -g
        z[k] = goal + (z[k - 1] - goal) * np.exp(-abs(step) / (scale * g))
    return z


def _loops(motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
    """Sign, and the three loops of a form, shape (n, 4)."""
    q, s = np.ascontiguousarray(motion.q[:, j]), float(shape[0])
    if shape[1] == LUGRE:
        loops = _lugre(q, motion.qd[:, j], s, float(shape[3]), motion.dt)
    else:
        state = slip_state if shape[1] == 0.0 else dahl_state
        loops = [state(q, k * s) for k in (1.0, 3.0, 9.0)]
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
    """LuGre's law without a rise of its level is Dahl's."""
    if values["form"] != LUGRE or values["f2"] > VALUE_DEVIATIONS * errors["f2"]:
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
        Param("form", "1", "0 Maxwell slip, 1 Dahl, 2 LuGre", 0.0, 2.0, codes=FORMS, choice=True),
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

EFFECTS: tuple[Effect, ...] = (Presliding(),)
