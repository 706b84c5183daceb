"""Masses and springs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hil.models.effect import (
    BOUNDS,
    STRICT,
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
    even_ratio,
    log_grid,
    turning_orders,
)
from hil.models.kernels import lag
from hil.models.motion import FloatArray, Motion
from hil.models.parts import JOINT
from hil.models.robots import IndependentAxes

_INERTIA = "{F} s^2/{x}"
#: Share of an effort at mid-range by which it must vary over the range to depend on the position.
_VARIES = 0.1


def _rigid_body_terms(motion: Motion, j: int) -> tuple[Param, ...]:
    """The robot's own parameters."""
    robot = motion.robot
    return tuple(
        Param(name, unit, "rigid-body parameter", source="robot description")
        for name, unit in zip(robot.names, robot.param_units, strict=True)
    )


class RigidBody(Effect):
    """The robot's links: inertia, Coriolis and gravity efforts, all parameters free."""

    name, family = "rigid-body", "mass"
    doc = Doc(
        equation="tau = M(q) qdd + C(q, qd) qd + N(q) = Y(q, qd, qdd) pi",
        signature="residual follows acceleration, gravity direction and products of speeds",
        confused_with=("payload", "torque-gain", "spring"),
        shown_by="fast motion over the workspace, many postures",
        source="Khalil and Dombre, Modeling, Identification and Control of Robots, 2002, ch. 12",
    )
    scope = Scope(Of.ROBOT, terms=_rigid_body_terms)
    traits = Trait.GIVEN | Trait.MOTION | Trait.BODY

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Y, shape (n, d, p)."""
        return motion.robot.regressor(motion.q, motion.qd, motion.qdd)


def _armature_lacks(motion: Motion, j: int) -> str:
    """One inertia per independent axis is all there is."""
    return "" if motion.robot.has_armature else "the axis' inertia already contains it"


class Armature(Effect):
    """Inertia of the motor's rotor, reflected to the joint."""

    name, family = "armature", "mass"
    doc = Doc(
        equation="tau = ia qdd",
        signature="residual proportional to the joint's own acceleration",
        confused_with=("rigid-body",),
        shown_by="fast motion of the joint in different postures",
        source="Featherstone, Rigid Body Dynamics Algorithms, 2008, 9.6",
        formulas=("a",),
    )
    params = (Param("ia", _INERTIA, "reflected rotor inertia", 0.0),)
    scope = Scope(lacks=_armature_lacks)
    traits = Trait.GIVEN | Trait.MOTION | Trait.ROTOR

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """The joint's acceleration qdd."""
        return motion.qdd[:, j : j + 1]


#: Largest turn of a base that a small angle stands for [rad].
_FAR = 0.8
_TURN = "turn of the base about its {} axis, against what the description says"


def _base_tilt_lacks(motion: Motion, j: int) -> str:
    """Needs a description with gravity along its z axis, and a fitted model."""
    tree = motion.robot.tree
    if tree is None:
        return "the robot has no description, so no direction of gravity"
    if np.any(tree.gravity[:2]):
        return "the description's gravity is not along its z axis"
    return "" if motion.response is not None else "needs the fitted model's masses; fit it first"


def _base_tilt_remark(values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    """The angle, for people."""
    return f"tilted by {math.degrees(math.hypot(*values.values())):.2g} degrees"


class BaseTilt(Effect):
    """The base does not stand upright: gravity has another direction than in the description.

    A robot on a wall, a wedge or a cart, or a floor that is not level.
    """

    name, family = "base-tilt", "mass"
    doc = Doc(
        equation="tau = rx dN/drx + ry dN/dry,  N(q) gravity of the model's masses under g - r x g",
        signature="gravity on a joint with a vertical axis, in proportion to the masses behind it",
        confused_with=("position-torque", "spring", "payload"),
        shown_by="slow motion of the first joint with the arm stretched out",
        source="Khalil, Dombre 2002, 9.3 (gravity vector of the base)",
        remark=_base_tilt_remark,
    )
    params = (
        Param("rx", "rad", _TURN.format("x"), -_FAR, _FAR),
        Param("ry", "rad", _TURN.format("y"), -_FAR, _FAR),
    )
    scope = Scope(Of.ROBOT, lacks=_base_tilt_lacks)
    limits = (STRICT,)
    traits = Trait.LOAD | Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort of a unit turn about x and about y, shape (n, d, 2)."""
        if motion.response is None:
            return np.zeros((motion.n, motion.d, 2))
        return motion.response.tilt


def _spring_varies(f: Fitted) -> bool:
    """A spring whose rest position is not far beyond the range: else it is an offset."""
    half, sure = 0.5 * float(np.ptp(f.motion.span[f.j])), f.slack
    return (abs(f.beta[0]) + sure[0]) * half >= _VARIES * abs(f.beta[1])


def _spring_pulls_back(f: Fitted) -> bool:
    """A spring returns to its rest: what pushes on is none."""
    return f.beta[0] + f.slack[0] >= 0.0


#: Column of a spring as text.
SPRING = "q - (low + high) / 2"


class Spring(Effect):
    """A linear spring on the joint."""

    name, family = "spring", "stiffness"
    doc = Doc(
        equation="tau = k (q - middle of the range) + t0  (rest at middle - t0 / k)",
        signature="residual proportional to position",
        confused_with=("rigid-body", "position-torque", "cogging"),
        shown_by="static poses over a wide range",
        source="Cavusoglu, Feygin, Tendick, Presence 11(6), 2002 (balance of haptic arms)",
        over=Over.POSITION,
        formulas=(SPRING, "1"),
    )
    params = (
        Param("k", "{F}/{x}", "stiffness"),
        Param("t0", "{F}", "effort at mid-range"),
    )
    limits = (
        Limit("constant", _spring_varies, says="it hardly varies over the range, like an offset"),
        Limit("pulls-back", _spring_pulls_back, says="it would push away from its rest position"),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[q - mid-range, 1]."""
        centred = motion.q[:, j] - motion.span[j].mean()
        return np.stack([centred, np.ones_like(centred)], axis=1)


#: Relaxation times that are tried: from what is told from a damper to what is told from a spring
#: [s], and how many.  Half as many: neighbours differ by a factor of 3 instead of 1.65, from which
#: the climb begins.
RELAXATIONS, RELAXATION_STEPS = (0.03, 20.0), 14
#: Share of a run that such a time may take: what was before it is not known.  At its end exp(-4) of
#: that is left; doubled, exp(-2); halved, a time of 4 s asks for a run of 32 s instead of 16.
FORGOTTEN = 1 / 4


def _relaxation_grid(motion: Motion, j: int) -> Shapes:
    """Times that the run forgets."""
    longest = FORGOTTEN * motion.n * motion.dt
    return [x for x in log_grid(*RELAXATIONS, RELAXATION_STEPS) if x[0] <= longest]


def _relaxation_lacks(motion: Motion, j: int) -> str:
    """Needs a run that is long enough to forget how it began."""
    return "" if _relaxation_grid(motion, j) else "needs a longer run"


def _relaxation_holds(f: Fitted) -> bool:
    """It takes energy."""
    return f.beta[0] > 0.0


class Relaxation(Effect):
    """A spring behind a damper, as of rubber or tissue: what is stretched yields with time."""

    name, family = "relaxation", "stiffness"
    doc = Doc(
        equation="tau = k (q - x),  T dx/dt + x = q  (damper: k T)",
        signature="effort that decays after every move, and loops over position that slow motion "
        "flattens",
        confused_with=("spring", "presliding", "viscous"),
        shown_by="steps that are held for several times T, and sines from slow to fast",
        source="Findley, Lai, Onaran, Creep and Relaxation of Nonlinear Viscoelastic Materials, "
        "1976, 5.2 (Maxwell element)",
    )
    params = (Param("k", "{F}/{x}", "stiffness that yields"),)
    shape = (Param("T", "s", "time in which the effort decays to 37 %", 0.0, size=True),)
    scope = Scope(lacks=_relaxation_lacks)
    search = Grid(_relaxation_grid)
    limits = (
        Limit("passive", _relaxation_holds, says="it would give energy to the joint"),
        STRICT,
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Stretch of the spring; the run begins relaxed."""
        q = np.ascontiguousarray(motion.q[:, j])
        return (q - lag(q, motion.dt, float(shape[0])))[:, None]


#: Ratios of the other joint's position from which the search climbs, of either sign.  Half as many:
#: a maximum between them is missed; beyond them one of the joints is hardly bent (`TAKES_PART`).
STRETCHES = (0.4, 1.0, 2.5)


def _coupled_spring_grid(motion: Motion, j: int) -> Shapes:
    """Differences and sums with every later joint (the pair is unordered)."""
    later = range(j + 1, motion.d)
    return [
        (s * x * even_ratio(motion, j, k), k + 1.0)
        for k in later
        for x in STRETCHES
        for s in (-1.0, 1.0)
    ]


#: Share of what bends a spring between two joints that either of them must have.  Half: the other
#: joint's motion mends what a spring of this joint misses; double: only joints that move alike.
TAKES_PART = 0.25


def _coupled_spring_between(f: Fitted) -> bool:
    """Both joints bend it: else it is a spring of one of them."""
    own, other = (float(np.std(f.motion.q[:, k])) for k in (f.j, int(f.shape[1]) - 1))
    other *= abs(f.shape[0])
    return min(own, other) >= TAKES_PART * (own + other)


def _coupled_spring_lacks(motion: Motion, j: int) -> str:
    """Needs a later joint."""
    return "" if j + 1 < motion.d else "no later joint to bend with"


def _stretch(motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
    """q_j + r q_k, each about its mid-range, shape (n,)."""
    q = motion.q - motion.span.mean(axis=1)
    out: FloatArray = q[:, j] + shape[0] * q[:, int(shape[1]) - 1]
    return out


def _coupled_spring_pulls_back(f: Fitted) -> bool:
    """Its mean stiffness over the motion is none that pushes away."""
    d = _stretch(f.motion, f.j, f.shape)
    k, k2, k3 = f.beta
    return k + 2 * k2 * float(d.mean()) + 3 * k3 * float(np.mean(d * d)) + f.slack[0] >= 0.0


class CoupledSpring(Effect):
    """A spring over two joints: a beam on two drives, a cable, a hose or a muscle."""

    name, family = "coupled-spring", "stiffness"
    doc = Doc(
        equation=(
            "tau_j = k d + k2 d^2 + k3 d^3,  tau_k = r tau_j,  d = q_j + r q_k about mid-range  "
            "(rest position in the offsets)"
        ),
        signature="residuals of two joints that follow the sum or difference of their positions",
        confused_with=("spring", "coupled-friction", "rigid-body"),
        shown_by="one joint at a time, then both with and against each other, slowly",
        source=(
            "Zajac, Crit. Rev. Biomed. Eng. 17, 1989 (muscles over two joints); Giam, Tan, Huang, "
            "ISA Trans. 46, 2007 (a gantry's beam on two drives)"
        ),
        over=Over.STRETCH,
    )
    params = (
        Param("k", "{F}/{x}", "stiffness at mid-range"),
        Param("k2", "{F}/{x}^2", "how it changes with the stretch"),
        Param("k3", "{F}/{x}^3", "how it stiffens to both sides"),
    )
    shape = (
        Param("r", "1", "ratio of the other joint's position, in this joint's unit"),
        Param(JOINT, "1", "number of the other joint", 1.0, choice=True),
    )
    scope = Scope(Of.JOINTS, lacks=_coupled_spring_lacks)
    search = Grid(_coupled_spring_grid)
    limits = (
        Limit("between", _coupled_spring_between, says="one of its joints hardly bends it"),
        Limit("pulls-back", _coupled_spring_pulls_back, says="it would push its joints away"),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Stretch d, d^2 and d^3 on joint j; on joint k times r: (n, d, 3)."""
        # tau = dU/dq with U = k d^2 / 2 + k2 d^3 / 3 + k3 d^4 / 4
        d = _stretch(motion, j, shape)
        out = np.zeros((motion.n, motion.d, 3))
        out[:, j] = d[:, None] ** np.arange(1, 4)
        out[:, int(shape[1]) - 1] = shape[0] * out[:, j]
        return out


def _unbalance_lacks(motion: Motion, j: int) -> str:
    """One turning axis of which no description holds the weight."""
    if not isinstance(motion.robot, IndependentAxes):
        return "the robot description holds the weight of the links"
    if motion.robot.units[j] != "rad":
        return "the weight of a sliding axis does not change: it is in the offset"
    return "" if motion.d == 1 else "the weight of several links without a description has no name"


class Unbalance(Effect):
    """Weight of a turning axis whose centre of mass lies beside it, as of a pendulum."""

    name, family = "unbalance", "mass"
    doc = Doc(
        equation="tau = gs sin q + gc cos q",
        signature="an effort at rest that repeats after one turn",
        confused_with=("spring", "position-torque", "cogging"),
        shown_by="static poses over half a turn and more",
        source="Khalil, Dombre, Modeling, Identification and Control of Robots, 2002, 9.3",
        over=Over.POSITION,
        formulas=("sin(q)", "cos(q)"),
    )
    params = (
        Param("gs", "{F}", "weight times lever, part of the sine of the position"),
        Param("gc", "{F}", "weight times lever, part of the cosine of the position"),
    )
    scope = Scope(lacks=_unbalance_lacks)
    traits = Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[sin q, cos q]."""
        return np.stack([np.sin(motion.q[:, j]), np.cos(motion.q[:, j])], axis=1)


#: Largest order of an inertia that varies with position, in periods over the span: a linkage
#: is smooth, and what is faster is a motor.
LINKAGE_ORDER = 6.0


def _variable_inertia_lacks(motion: Motion, j: int) -> str:
    """One axis of which no description holds the linkage."""
    if not isinstance(motion.robot, IndependentAxes):
        return "the robot description holds how its inertia varies"
    if motion.d > 1:
        return "the inertia of several links without a description has no name"
    return "" if motion.response is not None else "needs the fitted model's inertia; fit it first"


def _variable_inertia_grid(motion: Motion, j: int) -> Shapes:
    """Every half order over the span; of an axis that turns once and twice a turn, too."""
    return turning_orders(motion, j, LINKAGE_ORDER, 0.5)


def _variable_inertia_powers(motion: Motion, j: int) -> NDArray[np.complex128]:
    """(q'', i q'^2 / 2): J and J' of exp(i k q)."""
    v, a = motion.qd[:, j], motion.qdd[:, j]
    return np.stack([a + 0j, 0.5j * v**2], axis=1)


def _inertia_waves(q: FloatArray, p: float) -> tuple[FloatArray, FloatArray]:
    """[sin kq, cos kq, .., cos 3kq] with k = 2 pi p, and their derivatives by q, shape (n, 6)."""
    k = 2 * np.pi * p * np.arange(1, 4)
    s, c = np.sin(k * q[:, None]), np.cos(k * q[:, None])
    waves, slopes = np.stack([s, c], axis=2), np.stack([k * c, -k * s], axis=2)
    return waves.reshape(q.size, 6), slopes.reshape(q.size, 6)


def _variable_inertia_positive(f: Fitted) -> bool:
    """An inertia that is above zero at every position seen, but for its errors."""
    if f.motion.response is None:
        return True
    q = f.motion.q[:, f.j]
    vary = _inertia_waves(q, f.shape[0])[0] @ np.array(f.beta)
    return bool(np.min(f.motion.response.inertia[:, f.j, f.j] + vary) > -sum(f.slack))


class VariableInertia(Effect):
    """The inertia that a motor feels varies with its position: a crank, a cam, a linkage.

    Its speed costs effort, too: what drives the load faster without the motor's acceleration.
    """

    name, family = "variable-inertia", "mass"
    doc = Doc(
        equation=(
            "tau = J(q) qdd + J'(q) qd^2 / 2,  "
            "J = a1 sin kq + b1 cos kq + a2 sin 2kq + .. + b3 cos 3kq,  k = 2 pi p"
        ),
        signature="a ripple over position that grows with acceleration and square of the speed",
        confused_with=("encoder-eccentricity", "cogging", "position-torque", "unbalance"),
        shown_by="strokes over the whole range at several speeds and accelerations",
        source="Dresig, Holzweissig, Dynamics of Machinery, 2010, 2.4 (constraint-coupled drives)",
        over=Over.POSITION,
    )
    params = (
        Param("a1", _INERTIA, "inertia that goes with the sine"),
        Param("b1", _INERTIA, "inertia that goes with the cosine"),
        Param("a2", _INERTIA, "twice as often, with the sine"),
        Param("b2", _INERTIA, "twice as often, with the cosine"),
        Param("a3", _INERTIA, "three times as often, with the sine: a short connecting rod"),
        Param("b3", _INERTIA, "three times as often, with the cosine"),
    )
    shape = (Param("p", "1/{x}", "periods per unit of position", 0.0, size=True),)
    scope = Scope(lacks=_variable_inertia_lacks)
    search = Waves(_variable_inertia_grid, powers=_variable_inertia_powers, at_resolution=True)
    limits = (
        Limit(
            "positive",
            _variable_inertia_positive,
            says="the inertia would be negative at some positions",
        ),
    )
    traits = Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """J q'' + J' q'^2 / 2 for J = sin and cos of kq, 2kq and 3kq, shape (n, 6)."""
        inertia, slope = _inertia_waves(motion.q[:, j], float(shape[0]))
        v, a = motion.qd[:, j : j + 1], motion.qdd[:, j : j + 1]
        return inertia * a + 0.5 * v * v * slope


def _position_torque_varies(f: Fitted) -> bool:
    """An effort that may vary over the range: else it is an offset."""
    most = sum(abs(b) + e for b, e in zip(f.beta[1:], f.slack[1:], strict=True))
    return most >= _VARIES * abs(f.beta[0])


def _position_torque_foils(motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
    """An inertia that varies with position, M' = 1 or q:  M qdd + M' v^2 / 2.

    About a spring-like swing the acceleration is a function of the position.
    """
    q, v, a = motion.q[:, j], motion.qd[:, j], motion.qdd[:, j]
    first, second = q * a + v * v / 2, q * q * a + q * v * v
    return [first[:, None], np.stack([first, second], axis=1)]


#: Half ranges by which a function of the position goes on straight beyond the recorded range, and
#: stays where it then is.  Beyond a fifth a polynomial of degree six is no nearer to its tangent
#: than to its last value.
STRAIGHT_ON = 0.2
_RAW = "(2 * q - low - high) / (high - low)"
_X = f"max(-1, min(1, {_RAW}))"
_ABOVE = f"max(0, min({STRAIGHT_ON}, {_RAW} - 1))"
_BELOW = f"max(0, min({STRAIGHT_ON}, -1 - {_RAW}))"
#: Chebyshev polynomials T0..T6 of the position scaled to [-1, 1], with their tangents beyond it.
_CHEBYSHEV = (
    "1",
    *(
        f"{text} + {k * k} * ({_ABOVE} {'-' if k % 2 else '+'} {_BELOW})"
        for k, text in enumerate(
            (
                _X,
                f"2 * {_X} ** 2 - 1",
                f"4 * {_X} ** 3 - 3 * {_X}",
                f"8 * {_X} ** 4 - 8 * {_X} ** 2 + 1",
                f"16 * {_X} ** 5 - 20 * {_X} ** 3 + 5 * {_X}",
                f"32 * {_X} ** 6 - 48 * {_X} ** 4 + 18 * {_X} ** 2 - 1",
            ),
            1,
        )
    ),
)


class PositionTorque(Effect):
    """Smooth effort over position: an umbilical, a cable bundle, a bent hose."""

    name, family = "position-torque", "stiffness"
    doc = Doc(
        equation=(
            "tau = t0 + sum_{k=1..6} ck T_k(x),  x = position scaled to [-1, 1], straight on beyond"
        ),
        signature="smooth residual over position, the same in both directions",
        confused_with=("spring", "rigid-body", "cogging"),
        shown_by="slow strokes over the whole range",
        source="WPI dVRK identification (joint cable torque), RA-L 2019",
        shown=Sight.RANGE,
        over=Over.POSITION,
        formulas=_CHEBYSHEV,
    )
    params = (
        Param("t0", "{F}", "effort at mid-range"),
        *(Param(f"c{k}", "{F}", "Chebyshev coefficient") for k in range(1, 7)),
    )
    relations = Relations(foils=_position_torque_foils)
    limits = (
        Limit(
            "constant",
            _position_torque_varies,
            says="it hardly varies over the range, like an offset",
        ),
        BOUNDS,
    )
    traits = Trait.SERIES

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Chebyshev polynomials T0..T6, straight on beyond the range."""
        x = motion.scaled(j)
        inside = np.clip(x, -1.0, 1.0)
        beyond = np.clip(x - inside, -STRAIGHT_ON, STRAIGHT_ON)[:, None]
        values = np.polynomial.chebyshev.chebvander(inside, 6)
        k = np.arange(7.0)
        # T_k'(+-1) = (+-1)^(k - 1) k^2
        tangent = np.square(k) * np.where(beyond < 0, (-1.0) ** (k - 1), 1.0)
        return np.asarray(values + tangent * beyond, dtype=np.float64)


EFFECTS: tuple[Effect, ...] = (
    RigidBody(),
    Armature(),
    BaseTilt(),
    Spring(),
    Relaxation(),
    CoupledSpring(),
    Unbalance(),
    VariableInertia(),
    PositionTorque(),
)
