"""Corrections without a name: free functions that stand in a model for what no law explains.

A correction says on which variables an effort depends, and not why.  It is never a finding: the
search tries it where every named effect has failed and an error is left, so that the model that
is written predicts as much as the data allow.

Source: Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 2009, chapter 5 (basis
expansions); Lampaert, Swevers, Al-Bender, IEEE Trans. Automatic Control 47(4), 2002 (slip
elements); Nelles, Nonlinear System Identification, 2001.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from hil.models.effect import (
    RIPPLES,
    Correction,
    Doc,
    Grid,
    Param,
    Scope,
    Shapes,
    Trait,
    typical_speed,
)
from hil.models.friction import AMPLITUDES, HARMONICS, harmonics
from hil.models.kernels import SLIPS, lag, slip_state
from hil.models.motion import FloatArray, Motion

#: Beyond the range by this factor a function of the position stays where it ends.
RANGE_FACTOR = 1.05
#: Degree of a function of the position.  Half: a joint's cable or foam needs two corrections;
#: double: runs that go a little further than the fitted ones are predicted worse than without.
_DEGREE = 4
#: Displacements at which the elements of a hysteresis slip, as multiples of the least one.
_WIDER = (1.0, 3.0, 9.0)
#: Times in which something follows the position [s].
_TIMES = (0.02, 0.06, 0.2, 0.6, 2.0)
#: Share of the shortest run that such a time may take.  What was before a run is not known: after
#: three times that is forgotten, and three quarters of the run are left to show the past.
REMEMBERED = 1 / 12
#: Speeds between which a function of the speed is linear, in rms speeds: of what changes its sign
#: with the speed, and of what does not.  Half as many: a brake that fades is not followed; twice as
#: many: a stroke or two do not determine it.
_ODD = (0.0, 0.05, 0.15, 0.3, 0.5, 0.8, 1.2, 1.7, 2.4)
_EVEN = (0.0, 0.3, 1.0, 2.4)

#: Pieces of a function of the position in detail, and the length of one in halves of the range.
#: Half: it follows no more than a polynomial does; double: a stroke or two do not determine it.
_KNOTS = 16
_WIDTH = 2.0 / _KNOTS
#: Waves of a function of the angle within a turn.  Half: it follows no cam; double: what it holds
#: is a motor's, which has a name.
_WAVES = 10
#: Turns of a joint from which on its angles come again in different parts of a run.
_AGAIN = 1.5

_CENTRE = Param("centre", "{x}", "middle of the range of the position")
_HALF = Param("half", "{x}", "half the range of the position", 0.0)
_RMS = Param("rms", "{x}/s", "rms speed", 0.0)


def _coefficients(count: int, text: str) -> tuple[Param, ...]:
    return tuple(Param(f"c{k}", "{F}", text) for k in range(1, count + 1))


def _range(motion: Motion, j: int) -> tuple[float, float]:
    """Middle and half of joint j's range over all runs."""
    low, high = motion.span[j]
    return float(low + high) / 2, max(float(high - low) / 2, 1e-9)


def _range_grid(motion: Motion, j: int) -> Shapes:
    """The range that was recorded."""
    return [_range(motion, j)]


def _powers(q: FloatArray, centre: float, half: float, degree: int) -> FloatArray:
    """Chebyshev polynomials 0 to `degree` of a position over its range, shape (n, degree + 1)."""
    x = np.clip((q - centre) / half, -RANGE_FACTOR, RANGE_FACTOR)
    return np.asarray(chebvander(x, degree), dtype=np.float64)


#: Position over its range as text, and Chebyshev's polynomials of it.
_X = f"max({-RANGE_FACTOR}, min({RANGE_FACTOR}, (q - centre) / half))"
_CHEBYSHEV = (
    _X,
    f"2 * ({_X}) ** 2 - 1",
    f"4 * ({_X}) ** 3 - 3 * ({_X})",
    f"8 * ({_X}) ** 4 - 8 * ({_X}) ** 2 + 1",
)


def _doc(equation: str, variables: str, formulas: tuple[str, ...] = ()) -> Doc:
    """Documentation of a correction."""
    return Doc(
        equation=equation,
        signature="no law of the catalogue explains it",
        shown_by="the motion that was recorded: it predicts no other",
        source="Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 2009, 5",
        caveat=(
            "a function without a name: it predicts motions like the recorded ones and "
            "explains none"
        ),
        variables=variables,
        formulas=formulas,
    )


_POWERS = _coefficients(_DEGREE, "coefficient of T_k")


def _of_position_terms(motion: Motion, j: int) -> tuple[Param, ...]:
    """Without T_1 beside a spring that the model has already."""
    return _POWERS[int(_sprung(motion, j)) :]


class OfPosition(Correction):
    """Any smooth function of the position."""

    name = "correction-position"
    doc = _doc(
        equation=(
            "tau = sum_k c_k T_k(x),  "
            "x = (q - centre) / half, T_k Chebyshev's, k = 1 to 4 (beside a spring from 2 on)"
        ),
        variables="the position",
        formulas=_CHEBYSHEV,
    )
    params = _POWERS
    shape = (_CENTRE, _HALF)
    scope = replace(Correction.scope, terms=_of_position_terms)
    search = Grid(_range_grid, refine=False)
    traits = Correction.traits | Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """T_k(x)."""
        powers = _powers(motion.q[:, j], shape[0], shape[1], _DEGREE)
        return powers[:, 1 + int(_sprung(motion, j)) :]


def _sprung(motion: Motion, j: int) -> bool:
    """Whether the model has a spring on joint j: a surface that is touched throughout."""
    q0, side = motion.contact[j]
    return bool(np.isfinite(q0)) and bool(np.min(side * (motion.span[j] - q0)) >= 0)


class OfDetail(Correction):
    """A function of the position that bends where it will: what no smooth one follows."""

    name = "correction-detail"
    doc = _doc(
        equation=(
            f"tau = sum_k c_k max(0, 1 - |x - x_k| / w),  "
            f"x = (q - centre) / half, x_k = -1 + k w, k = 0 to {_KNOTS}"
        ),
        variables="the position in detail",
        formulas=tuple(
            "max(0, 1 - abs(max(-1, min(1, (q - centre) / half)) - "
            f"({-1 + k * _WIDTH})) / {_WIDTH})"
            for k in range(_KNOTS + 1)
        ),
    )
    params = tuple(Param(f"c{k}", "{F}", "effort at x_k") for k in range(_KNOTS + 1))
    shape = (_CENTRE, _HALF)
    search = Grid(_range_grid, refine=False)
    traits = Correction.traits | Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """max(0, 1 - |x - x_k| / w)."""
        x = np.clip((motion.q[:, j] - shape[0]) / shape[1], -1.0, 1.0)
        knots = -1.0 + _WIDTH * np.arange(_KNOTS + 1)
        hats: FloatArray = np.maximum(0.0, 1.0 - np.abs(x[:, None] - knots) / _WIDTH)
        return hats


def _of_turn_lacks(motion: Motion, j: int) -> str:
    """Needs an axis that turns, and that comes by the same angles again."""
    if motion.robot.units[j] != "rad":
        return "the joint slides"
    turns = float(np.ptp(motion.span[j])) / (2 * np.pi)
    return (
        "" if turns >= _AGAIN else f"the joint turns {turns:.1f} times, which is less than {_AGAIN}"
    )


class OfTurn(Correction):
    """A function of the angle within one turn of the joint: a cam, an index, a bearing."""

    name = "correction-turn"
    doc = _doc(
        equation=f"tau = sum_k a_k sin kq + b_k cos kq,  k = 1 to {_WAVES}",
        variables="the angle within a turn",
        formulas=tuple(f"{w}({k} * q)" for k in range(1, _WAVES + 1) for w in ("sin", "cos")),
    )
    params = tuple(
        Param(f"{name}{k}", "{F}", f"amplitude {k} times a turn")
        for k in range(1, _WAVES + 1)
        for name in ("a", "b")
    )
    scope = replace(Correction.scope, lacks=_of_turn_lacks)
    traits = Correction.traits | Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[sin kq, cos kq]."""
        angle = motion.q[:, j, None] * np.arange(1, _WAVES + 1)
        waves = np.stack([np.sin(angle), np.cos(angle)], axis=2)
        return waves.reshape(motion.n, 2 * _WAVES)


class OfWave(Correction):
    """A wave over the position beyond the named ones: a further harmonic, a third period."""

    name = "correction-wave"
    doc = _doc(
        equation="tau = a1 sin kq + b1 cos kq + a2 sin 2kq + b2 cos 2kq,  k = 2 pi p",
        variables="the position, in waves",
        formulas=HARMONICS,
    )
    params = AMPLITUDES
    shape = (Param("p", "1/{x}", "periods per unit of position", 0.0),)
    search = RIPPLES
    traits = Correction.traits | Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Two harmonics over position."""
        return harmonics(motion.q[:, j], shape[0])


class OfDirection(Correction):
    """Friction, and viscous friction, that are any smooth function of the position."""

    name = "correction-friction"
    doc = _doc(
        equation="tau = z sum_k c_k T_k(x) + v (c5 T_1(x) + c6 T_2(x)),  z the friction's state",
        variables="the position, by direction",
        formulas=(
            *(f"sign * ({power})" for power in _CHEBYSHEV),
            *(f"v / half * ({power})" for power in _CHEBYSHEV[:2]),
        ),
    )
    params = _coefficients(_DEGREE + 2, "coefficient of z T_k, then of v T_k")
    shape = (_CENTRE, _HALF)
    search = Grid(_range_grid, refine=False)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """State times T_k(x), and v T_1(x), v T_2(x); v in ranges a second."""
        powers = _powers(motion.q[:, j], shape[0], shape[1], _DEGREE)[:, 1:]
        state, v = motion.sign(j)[:, None], motion.qd[:, j : j + 1] / shape[1]
        return np.concatenate([state * powers, v * powers[:, :2]], axis=1)


def _of_speed_grid(motion: Motion, j: int) -> Shapes:
    """The rms speed of the run."""
    return [(typical_speed(motion, j),)]


def _hat(x: str, knots: Sequence[float], k: int) -> str:
    """Text of the piecewise linear function of x that is one at a knot and zero at the others."""
    rises = f"min(1, ({x} - {knots[k - 1]}) / {knots[k] - knots[k - 1]!r})"
    if k + 1 == len(knots):
        return f"max(0, {rises})"
    return f"max(0, min({rises}, ({knots[k + 1]} - {x}) / {knots[k + 1] - knots[k]!r}))"


def _hats(x: FloatArray, knots: Sequence[float]) -> FloatArray:
    """Piecewise linear functions that are one at a knot and zero at the others, without the first.

    Beyond the last knot they stay as they are there.
    """
    at = np.asarray(knots, dtype=np.float64)
    # each piece rises to its knot; the hat is that less the rise to the next one
    out: FloatArray = (x[:, None] - at[:-1]) / np.diff(at)
    np.maximum(np.minimum(out, 1.0, out=out), 0.0, out=out)
    out[:, :-1] -= out[:, 1:]
    return out


class OfSpeed(Correction):
    """Any function of the speed, another one in each direction."""

    name = "correction-speed"
    doc = _doc(
        equation=(
            "tau = sgn(v) sum_k c_k h_k(|v|) + sum_k d_k g_k(|v|),  "
            "h_k, g_k linear pieces between speeds, v in units of the rms speed"
        ),
        variables="the speed",
        formulas=(
            *(f"sign * {_hat('abs(v) / rms', _ODD, k)}" for k in range(1, len(_ODD))),
            *(_hat("abs(v) / rms", _EVEN, k) for k in range(1, len(_EVEN))),
        ),
    )
    params = (
        *(Param(f"c{k}", "{F}", f"effort at {x:g} rms speeds") for k, x in enumerate(_ODD[1:], 1)),
        *(
            Param(f"d{k}", "{F}", f"mean of both directions at {x:g} rms speeds")
            for k, x in enumerate(_EVEN[1:], 1)
        ),
    )
    shape = (_RMS,)
    search = Grid(_of_speed_grid, refine=False)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """sgn(v) h_k(|v|), g_k(|v|)."""
        size = np.abs(motion.qd[:, j]) / shape[0]
        odd = motion.sign(j)[:, None] * _hats(size, _ODD)
        return np.concatenate([odd, _hats(size, _EVEN)], axis=1)


def _steady(motion: Motion, j: int) -> FloatArray:
    """State of the joint's dry friction (n,), which its model has; of a surface it has none."""
    touches = bool(np.isfinite(motion.contact[j, 0]))
    return np.zeros(motion.n) if touches else motion.sign(j)


def _of_displacement_grid(motion: Motion, j: int) -> Shapes:
    """A thousandth to three hundredths of the range."""
    half = _range(motion, j)[1]
    return [(2 * half * share,) for share in SLIPS]


class OfDisplacement(Correction):
    """Any hysteresis over the displacement since a reversal: three elements that slip."""

    name = "correction-hysteresis"
    doc = _doc(
        equation=(
            "tau = sum_k c_k (z(w_k) - sgn v),  z <- clip(z + dq / w, -1, 1),  w_k = s, 3 s, 9 s "
            "(of a surface: without sgn v)"
        ),
        variables="the displacement since a reversal",
    )
    params = _coefficients(len(_WIDER), "force at which an element slips")
    shape = (Param("s", "{x}", "displacement at which the first element slips", 0.0, size=True),)
    search = Grid(_of_displacement_grid, refine=False)
    traits = Correction.traits | Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """States of the elements, less the friction's: while they all slip they are none."""
        q, steady = np.ascontiguousarray(motion.q[:, j]), _steady(motion, j)
        return np.stack([slip_state(q, k * float(shape[0])) - steady for k in _WIDER], axis=1)


def _of_past_grid(motion: Motion, j: int) -> Shapes:
    """All pairs of times that are a factor of three or more apart and that the runs forget."""
    half, longest = _range(motion, j)[1], REMEMBERED * motion.n * motion.dt
    times = [x for x in _TIMES if x <= longest]
    return [(half, a, b) for k, a in enumerate(times) for b in times[k + 1 :]]


def _of_past_lacks(motion: Motion, j: int) -> str:
    """Needs a run that is long enough to forget how it began."""
    return "" if _of_past_grid(motion, j) else "needs a longer run"


class OfPast(Correction):
    """What follows the position late: something that creeps or relaxes."""

    name = "correction-relaxation"
    doc = _doc(
        equation="tau = sum_k c_k (q - q_k) / half,  T_k dq_k/dt + q_k = q",
        variables="the past of the position",
    )
    params = _coefficients(2, "force of a spring behind a damper")
    shape = (
        _HALF,
        Param("T1", "s", "time of the faster one", 0.0),
        Param("T2", "s", "time of the slower one", 0.0),
    )
    scope = replace(Correction.scope, lacks=_of_past_lacks)
    search = Grid(_of_past_grid, refine=False)
    traits = Correction.traits | Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Deflection of the springs behind the dampers."""
        q = np.ascontiguousarray(motion.q[:, j]) / shape[0]
        return np.stack([q - lag(q, motion.dt, float(t)) for t in shape[1:]], axis=1)


def _of_load_grid(motion: Motion, j: int) -> Shapes:
    """The rms load, and displacements from a thousandth of the range on."""
    size = max(float(np.sqrt(np.mean(motion.load[:, j] ** 2))), 1e-12)
    half = _range(motion, j)[1]
    return [(size, 2 * half * share) for share in SLIPS]


class OfLoad(Correction):
    """Friction that grows with the transmitted load, with and without memory."""

    name = "correction-load"
    doc = _doc(
        equation=("tau = |L| (c1 z + c2 (z(s) - z) + c3 (z(9 s) - z)) / Lrms + c4 (L / Lrms)^2 z"),
        variables="the load, by direction",
    )
    params = _coefficients(4, "coefficient of a function of the load")
    shape = (
        Param("load", "{F}", "rms load", 0.0),
        Param("s", "{x}", "displacement at which the first element slips", 0.0, size=True),
    )
    scope = Scope(explains=("motor",))
    search = Grid(_of_load_grid, refine=False)
    traits = Correction.traits | Trait.LOAD | Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """The load's size times friction's state, and times elements that slip."""
        q, load = np.ascontiguousarray(motion.q[:, j]), np.abs(motion.load[:, j]) / shape[0]
        sign, steady = motion.sign(j), _steady(motion, j)
        slips = (load * (slip_state(q, k * float(shape[1])) - steady) for k in (1.0, 9.0))
        return np.stack([load * sign, *slips, load**2 * sign], axis=1)


def _of_other_joint_lacks(motion: Motion, j: int) -> str:
    """Needs another joint that moves."""
    return "" if _of_other_joint_grid(motion, j) else "needs another joint that moves"


def _of_other_joint_grid(motion: Motion, j: int) -> Shapes:
    """Every other joint that moves, in either direction."""
    out: Shapes = []
    for k in range(motion.d):
        moves = float(np.ptp(motion.span[k])) > 0
        if k == j or not moves:
            continue
        about = (*_range(motion, k), typical_speed(motion, k))
        out += [(float(k + 1), r, *about) for r in (1.0, -1.0)]
    return out


class OfOtherJoint(Correction):
    """What the motion of another joint does to this one."""

    name = "correction-joint"
    doc = _doc(
        equation=(
            "tau = c1 vk + c2 sgn vk + c3 ak + c4 T_1(xk) + c5 T_2(xk) + c6 T_3(xk) + "
            "c7 sgn(v + r vk) + c8 (a + r ak)"
        ),
        variables="another joint's motion",
    )
    params = _coefficients(8, "coefficient of a function of the other joint's motion")
    shape = (
        Param("joint", "1", "number of the other joint", 0.0, choice=True),
        Param("r", "1", "ratio of the other joint's speed in the sum of both", -1.0, 1.0),
        Param("centre", "1", "middle of its range, in rad or m"),
        Param("half", "1", "half its range, in rad or m", 0.0),
        Param("scale", "1", "its rms speed, in rad/s or m/s", 0.0),
    )
    scope = replace(Correction.scope, lacks=_of_other_joint_lacks)
    search = Grid(_of_other_joint_grid, refine=False)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Speed, sign, acceleration and place of the other joint; friction between the two."""
        k = round(float(shape[0])) - 1
        v, a, r = motion.qd[:, k] / shape[4], motion.qdd[:, k], float(shape[1])
        both = motion.qd[:, j] + r * motion.qd[:, k]
        accelerated = motion.qdd[:, j] + r * a
        between = motion.sign_of(both, accelerated, float(motion.v0[j]))
        powers = _powers(motion.q[:, k], shape[2], shape[3], 3)[:, 1:]
        own = np.stack([v, motion.sign(k), a], axis=1)
        return np.concatenate([own, powers, np.stack([between, accelerated], axis=1)], axis=1)


#: Highest sum of the degrees in the positions of two joints.  Of 2, a stiffening harness is left;
#: 4 takes 14 coefficients instead of 9.
BOTH_DEGREES = 3
#: Degrees of the products that are summed: (own, other), but for the constant.
TOGETHER = tuple(
    (a, b)
    for b in range(BOTH_DEGREES + 1)
    for a in range(BOTH_DEGREES + 1)
    if 0 < a + b <= BOTH_DEGREES
)


def _of_two_positions_grid(motion: Motion, j: int) -> Shapes:
    """Every other joint that moves, over both ranges."""
    others = [k for k in range(motion.d) if k != j and float(np.ptp(motion.span[k])) > 0]
    return [(float(k + 1), *_range(motion, j), *_range(motion, k)) for k in others]


class OfTwoPositions(Correction):
    """Any smooth function of this joint's position and another one's: what spans both."""

    name = "correction-posture"
    doc = _doc(
        equation="tau = sum_ab c_ab T_a(x) T_b(xk),  0 < a + b <= 3, T Chebyshev's",
        variables="its position and another joint's",
    )
    params = _coefficients(len(TOGETHER), "coefficient of T_a T_b")
    shape = (
        Param("joint", "1", "number of the other joint", 0.0, choice=True),
        _CENTRE,
        _HALF,
        Param("centre_k", "1", "middle of the other one's range, in rad or m"),
        Param("half_k", "1", "half the other one's range, in rad or m", 0.0),
    )
    scope = replace(Correction.scope, lacks=_of_other_joint_lacks)
    search = Grid(_of_two_positions_grid, refine=False)
    traits = Correction.traits | Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """T_a(x) T_b(xk)."""
        k = round(float(shape[0])) - 1
        own = _powers(motion.q[:, j], shape[1], shape[2], BOTH_DEGREES)
        other = _powers(motion.q[:, k], shape[3], shape[4], BOTH_DEGREES)
        return np.stack([own[:, a] * other[:, b] for a, b in TOGETHER], axis=1)


EFFECTS = (
    OfPosition(),
    OfDetail(),
    OfTurn(),
    OfWave(),
    OfDirection(),
    OfSpeed(),
    OfDisplacement(),
    OfPast(),
    OfLoad(),
    OfOtherJoint(),
    OfTwoPositions(),
)
