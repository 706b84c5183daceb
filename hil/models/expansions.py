"""Sums of many terms with free coefficients: friction by a network, an arm of unknown geometry.

Wavelet network on a Coulomb and viscous backbone: any function of speeds and position.

It names nothing.  It shows how much a function of these variables could explain at all.  With
inputs x scaled to their range (95 % within -1 .. 1) and dyadic levels m, centres c = k 2^-m,

    tau = sum_i w_i psi(2^m (x - c_i)),   psi(z) = (dim - |z|^2) exp(-|z|^2 / 2).

Gravity and couplings of an arm whose geometry is not known.

Of a serial chain every entry of the gravity vector and of the inertia matrix is a polynomial in the
sines and cosines of the joint angles.  Without a robot description these laws take its terms with
free coefficients: inertias up to products of two joints, gravity of three in a row.  They are
corrections, not findings: they predict, and no link's mass follows from them.

Source: Khalil, Dombre, Modeling, Identification and Control of Robots, 2002, 9.3 (dynamics are
linear in sums of products of sines and cosines); Spong, Hutchinson, Vidyasagar, Robot Modeling and
Control, 2006, 7.3 (Christoffel symbols).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hil.models.effect import (
    Correction,
    Doc,
    Effect,
    Grid,
    Param,
    Relations,
    Scope,
    Shapes,
    Trait,
    typical_speed,
)
from hil.models.motion import FloatArray, Motion
from hil.models.robots import IndependentAxes

#: Inputs by the value of the shape: own speed; position and speed; above 0 the other joint.
SPEED, PLACE = 0.0, -1.0
#: Speed that counts as 1, in multiples of the rms speed (about the 95 % quantile of |v|).
UNIT_SPEED = 2.0


@lru_cache(maxsize=8)
def _lines(dim: int) -> tuple[FloatArray, ...]:
    """Centres along each input, level by level; finer where all are small.

    Coarse levels cover the range, fine ones the neighbourhood of zero, where friction changes.
    """
    reaches = (1.0, 1.5, 0.5, 0.25)[: 4 if dim == 1 else 2]
    return tuple(np.arange(-r, r + 1e-9, 2.0**-m) for m, r in enumerate(reaches))


def wavelets(x: FloatArray) -> FloatArray:
    """Mexican hats of inputs x (n, dim), one at every crossing of centres: shape (n, nodes)."""
    n, dim = x.shape
    out = []
    for level, line in enumerate(_lines(dim)):
        # z = 2^m (x - c); |z|^2 is a sum over the inputs, and its exponential a product
        square = (2.0**level * (x.T[:, None] - line[:, None])) ** 2
        bell = np.exp(-square / 2)
        total, hat = square[0], bell[0]
        for k in range(1, dim):
            total = (total[:, None] + square[k]).reshape(-1, n)
            hat = (hat[:, None] * bell[k]).reshape(-1, n)
        out.append((dim - total) * hat)
    return np.concatenate(out).T


def nodes(dim: int) -> int:
    """Wavelets of `dim` inputs."""
    return sum(len(line) ** dim for line in _lines(dim))


def dictionary(motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
    """Columns for one set of inputs and scales (see `FrictionNetwork.shape`), shape (n, m)."""
    inputs, size, other = (float(x) for x in shape)
    own = motion.qd[:, j] / max(size, 1e-12)
    parts = [wavelets(own[:, None])]
    if inputs == PLACE:
        place = np.clip(motion.scaled(j), -1.2, 1.2)
        parts.append(wavelets(np.stack([place, own], axis=1)))
    elif inputs > 0:
        w = motion.qd[:, int(inputs) - 1] / max(other, 1e-12)
        parts += [wavelets(w[:, None]), wavelets(np.stack([own, w], axis=1))]
    return np.concatenate(parts, axis=1)


def input_sets(motion: Motion, j: int) -> Shapes:
    """Shapes: own speed, position and speed, own and every other joint's speed."""
    size = UNIT_SPEED * typical_speed(motion, j)
    others = [
        (float(k + 1), size, UNIT_SPEED * typical_speed(motion, k))
        for k in range(motion.d)
        if k != j
    ]
    return [(SPEED, size, 1.0), (PLACE, size, 1.0), *others]


def _friction_network_terms(motion: Motion, j: int) -> tuple[Param, ...]:
    """One weight a wavelet of the largest set of inputs."""
    one, two = nodes(1), nodes(2)
    most = 2 * one + two if motion.d > 1 else one + two
    return tuple(Param(f"w{k + 1}", "{F}", "weight of a wavelet") for k in range(most))


class FrictionNetwork(Effect):
    """Any function of own speed, and of position or another joint's speed beside it."""

    name, family = "friction-network", "friction"
    doc = Doc(
        equation="tau = sum_i w_i psi(2^m (x - c_i)),  x = (v), (q, v) or (v, v_k), scaled",
        signature="whatever is left over speed and position",
        confused_with=("stribeck", "position-friction", "coupled-friction", "quadratic-drag"),
        shown_by="motion that visits all combinations of its inputs",
        source=(
            "Naerum thesis 3.1.1 (wavelet friction network, Paper I); Mexican hat, dyadic levels"
        ),
    )
    params = (Param("w1", "{F}", "weight of a wavelet"),)
    shape = (
        Param(
            "inputs",
            "1",
            "0: own speed; -1: position and speed; k: own and joint k's",
            -1.0,
            codes=(
                (SPEED, "own speed"),
                (PLACE, "position and speed"),
                *((float(k), f"own speed and that of joint number {k}") for k in range(1, 8)),
            ),
            choice=True,
        ),
        Param("v", "{x}/s", "own speed that counts as 1", 0.0),
        Param("w", "{x}/s", "the other joint's speed that counts as 1", 0.0),
    )
    scope = Scope(terms=_friction_network_terms)
    search = Grid(input_sets, refine=False)
    traits = Trait.GIVEN

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Wavelets of the inputs; always as many as the largest set has, the others zero.

        Directions that move the effort by less than a noise unit are left out of every fit,
        which is what keeps the weights of overlapping wavelets bounded.
        """
        values = dictionary(motion, j, shape)
        out = np.zeros((motion.n, len(_friction_network_terms(motion, j))))
        out[:, : values.shape[1]] = values
        return out


# ------------------------------------------------------------ geometry that is not known

#: Joints, nearest in the chain first, whose angles count; 72 products of two of them.
MAX_ANGLES = 6
#: Range of a joint below which it holds its place [rad, m].
LITTLE_SHARE = {"rad": 0.02, "m": 0.002}


@dataclass(frozen=True)
class ArmAxes:
    """What is known of an arm without a description: units of its joints, and those that move."""

    units: tuple[str, ...]
    moves: tuple[int, ...]

    def near(self, j: int) -> list[int]:
        """Joints that move, at most `MAX_ANGLES`, those nearest to joint j first."""
        return sorted(sorted(self.moves, key=lambda k: abs(k - j))[:MAX_ANGLES])

    def waves(self, k: int) -> tuple[str, str]:
        """Sine and cosine of joint k's angle; of a slide its position and the square of it."""
        if self.units[k] == "rad":
            return f"sin(q{k + 1})", f"cos(q{k + 1})"
        return f"q{k + 1}", f"q{k + 1} ** 2"


def chain(motion: Motion) -> ArmAxes:
    """Of the robot of a run, and of all runs' ranges."""
    return _chain(motion.robot.units, motion.span.tobytes())


@lru_cache(maxsize=256)
def _chain(units: tuple[str, ...], span: bytes) -> ArmAxes:
    lengths = np.ptp(np.frombuffer(span).reshape(-1, 2), axis=1)
    little = [LITTLE_SHARE[unit] for unit in units]
    return ArmAxes(units, tuple(np.flatnonzero(lengths > little).tolist()))


#: Columns as formulas (`hil.models.formula`): products of at most `MOST_FACTORS` of `_FACTORS`.
Texts = Callable[[ArmAxes, int], Iterator[str]]
#: Factors of a column: of every joint its position, the square, sine, cosine, speed, square of the
#: speed, acceleration.
_FACTORS = ("q{0}", "q{0} ** 2", "sin(q{0})", "cos(q{0})", "v{0}", "v{0} ** 2", "a{0}")
MOST_FACTORS = 4


def _columns(texts: Texts, motion: Motion, j: int) -> FloatArray:
    """Columns (n, m) of products of factors in the joints' states.

    The simulation asks for them at every step, so that all factors are computed at once.
    """
    q, v = motion.q, motion.qd
    one = np.ones((len(q), 1))
    every = np.concatenate([one, q, q * q, np.sin(q), np.cos(q), v, v * v, motion.qdd], axis=1)
    first, *more = _factors(texts, chain(motion), j)
    out: FloatArray = every.take(first, 1)
    for other in more:
        if other.any():
            out *= every.take(other, 1)
    return out


@lru_cache(maxsize=1024)
def _factors(texts: Texts, arm: ArmAxes, j: int) -> NDArray[np.intp]:
    """Which factors (`MOST_FACTORS`, m) the columns are products of; 0 is one."""
    joints = range(1, len(arm.units) + 1)
    names = [form.format(k) for form in _FACTORS for k in joints]
    at = {name: k for k, name in enumerate(names, 1)}
    rows = [[at[x] for x in text.split(" * ")] for text in texts(arm, j)]
    out = np.zeros((MOST_FACTORS, len(rows)), dtype=np.intp)
    for k, row in enumerate(rows):
        out[: len(row), k] = row
    return out


def _geometry_doc(equation: str, signature: str, variables: str) -> Doc:
    """Documentation of a law of several joints."""
    return Doc(
        equation=equation,
        signature=signature,
        shown_by="all joints over their whole ranges, slowly and fast",
        source="Khalil, Dombre, Modeling, Identification and Control of Robots, 2002, 9.3",
        caveat="sums of unknown masses and lengths: give a URDF to get values with a meaning",
        variables=variables,
    )


def _scope(texts: Texts) -> Scope:
    """Several joints of which nothing is known, a coefficient for each of the products."""

    def lacks(motion: Motion, j: int) -> str:
        if not isinstance(motion.robot, IndependentAxes):
            return "the robot's geometry is known"
        if motion.d < 2 or not any(texts(chain(motion), j)):
            return "needs two joints that move"
        return ""

    def terms(motion: Motion, j: int) -> tuple[Param, ...]:
        names = (f"c{k}" for k, _ in enumerate(texts(chain(motion), j), 1))
        return tuple(Param(name, "{F}", "coefficient of a product") for name in names)

    def formulas(motion: Motion, j: int) -> tuple[str, ...]:
        return tuple(texts(chain(motion), j))

    return Scope(lacks=lacks, terms=terms, formulas=formulas)


class _OfGeometry(Correction):
    """A law of several joints without a robot description."""

    family = "mass"
    traits = Correction.traits | Trait.GEOMETRY
    #: Its columns as formulas.
    texts: ClassVar[staticmethod[[ArmAxes, int], Iterator[str]]]

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """All products, (n, m)."""
        return _columns(self.texts, motion, j)


def _single(arm: ArmAxes, j: int) -> Iterator[str]:
    """Waves of single angles, one column after the other: where a slide is turns no weight."""
    for k in arm.near(j):
        if arm.units[k] == "rad":
            yield from arm.waves(k)


class GenericGravity(_OfGeometry):
    """Gravity: any sum of the sines and cosines of single joint angles."""

    name = "generic-gravity"
    doc = _geometry_doc(
        "tau_j = sum_k a_k sin q_k + b_k cos q_k",
        "an effort that stays at rest and varies with the posture",
        "gravity of an unknown geometry",
    )
    texts = staticmethod(_single)
    scope = _scope(_single)
    traits = _OfGeometry.traits | Trait.MOTION


def _paired(arm: ArmAxes, j: int) -> Iterator[str]:
    """Products of the waves of two joints, one of which turns."""
    for k, other in combinations(arm.near(j), 2):
        if "rad" not in (arm.units[k], arm.units[other]):
            continue
        for a in arm.waves(k):
            for b in arm.waves(other):
                yield f"{a} * {b}"


class GenericPosture(_OfGeometry):
    """Gravity: products of the sines and cosines of two joint angles."""

    name = "generic-posture"
    doc = _geometry_doc(
        "tau_j = sum_kl c_kl {sin, cos} q_k {sin, cos} q_l",
        "an effort that stays at rest and varies with the posture of two joints",
        "gravity of an unknown geometry, by pairs of joints",
    )
    texts = staticmethod(_paired)
    scope = _scope(_paired)
    traits = _OfGeometry.traits | Trait.MOTION


def _tripled(arm: ArmAxes, j: int) -> Iterator[str]:
    """Products of the waves of three joints that follow each other, one of them joint j."""
    turning = [k for k in arm.moves if arm.units[k] == "rad"]
    for three in zip(turning, turning[1:], turning[2:], strict=False):
        if j in three:
            for waves in product(*map(arm.waves, three)):
                yield " * ".join(waves)


class GenericReach(_OfGeometry):
    """Gravity: products of the sines and cosines of three joint angles that follow each other."""

    name = "generic-reach"
    doc = _geometry_doc(
        "tau_j = sum c {sin, cos} q_k {sin, cos} q_l {sin, cos} q_m,  k, l, m one after the other",
        "an effort that stays at rest and varies with the posture of three joints",
        "gravity of an unknown geometry, by three joints in a row",
    )
    texts = staticmethod(_tripled)
    scope = _scope(_tripled)
    traits = _OfGeometry.traits | Trait.MOTION


def _coupled(arm: ArmAxes, j: int) -> Iterator[str]:
    """Accelerations of the other joints, and squares of speeds, times waves."""
    for k in (k for k in arm.near(j) if k != j):
        v, a = f"v{k + 1}", f"a{k + 1}"
        yield a
        for w in arm.waves(max(j, k)):
            yield f"{a} * {w}"
            yield f"{v} ** 2 * {w}"
            yield f"v{j + 1} * {v} * {w}"
        for w in arm.waves(k):
            yield f"a{j + 1} * {w}"


class GenericInertia(_OfGeometry):
    """Couplings: inertia of the other joints' motion, and what comes of their speeds."""

    name = "generic-inertia"
    doc = _geometry_doc(
        "tau_j = sum_k qdd_k (a + b sin q_m + c cos q_m) + qdd_j (d sin q_k + e cos q_k) + "
        "(qd_k^2 and qd_j qd_k) {sin, cos} q_m,  m the farther of j and k",
        "an effort with the acceleration of other joints, and with squares of speeds",
        "inertia of an unknown geometry",
    )
    texts = staticmethod(_coupled)
    scope = _scope(_coupled)


#: Sum of whole multiples of angles: pairs of a joint and its multiple.
Angle = tuple[tuple[int, int], ...]
#: Largest multiple: an inertia is of second degree in sines and cosines.
MOST_TURNS = 2
#: Joints next to one, behind it or before it, that count.  Double: 20 columns more for each.
NEXT = 2


def _angles(first: int, *more: int) -> list[Angle]:
    """All sums over one joint or two in which the first one counts, with its sign left out."""
    turns = range(-MOST_TURNS, MOST_TURNS + 1)
    rests: list[Angle] = [(), *(((k, n),) for k in more[:1] for n in turns if n)]
    return [((first, n), *rest) for n in range(1, MOST_TURNS + 1) for rest in rests]


def _summed(angle: Angle, letter: str) -> str:
    """The sum as a formula: of angles ``q``, or of speeds ``v``."""
    return " + ".join(f"{n} * {letter}{k + 1}" for k, n in angle)


#: Angles of a law, each with the joint whose motion it belongs to.
Angles = Callable[[ArmAxes, int], Iterable[tuple[int, Angle]]]


@lru_cache(maxsize=256)
def _sums(angles: Angles, arm: ArmAxes, j: int) -> tuple[NDArray[np.intp], FloatArray]:
    """Those joints (m,), and the multiples of all joints' angles (d, m)."""
    found = list(angles(arm, j))
    orders = np.zeros((len(arm.units), len(found)))
    for column, (_, angle) in enumerate(found):
        for k, n in angle:
            orders[k, column] = n
    return np.array([k for k, _ in found], dtype=np.intp), orders


def _turns(cos: FloatArray, sin: FloatArray) -> FloatArray:
    """Columns of cosines and sines (n, m) in turn, (n, 2 m)."""
    return np.stack([cos, sin], axis=2).reshape(len(cos), -1)


def _beside(arm: ArmAxes, j: int) -> Iterator[tuple[int, Angle]]:
    """Sums and differences of joint j's angle and those of the joints nearest to it."""
    if arm.units[j] != "rad":
        return
    turning = [k for k in arm.near(j) if k != j and arm.units[k] == "rad"]
    for k in sorted(turning, key=lambda k: abs(k - j))[:NEXT]:
        yield from ((k, ((j, 1), (k, sign))) for sign in (-1, 1))


def _parallel(arm: ArmAxes, j: int) -> Iterator[str]:
    """What energies qd_j qd_k {cos, sin} (q_j -+ q_k) cost joint j."""
    for k, angle in _beside(arm, j):
        sum_, a, v = f"({_summed(angle, 'q')})", f"a{k + 1}", f"v{k + 1} ** 2"
        less, more = ("-", "+") if angle[1][1] > 0 else ("+", "-")
        yield f"cos{sum_} * {a} {less} sin{sum_} * {v}"
        yield f"sin{sum_} * {a} {more} cos{sum_} * {v}"


class GenericParallel(_OfGeometry):
    """Inertia of links whose angles are all against the base: a parallelogram's, of few terms."""

    name = "generic-parallel"
    doc = _geometry_doc(
        "tau_j = sum_k c (cos x qdd_k +- sin x qd_k^2) + s (sin x qdd_k -+ cos x qd_k^2),  "
        "x = q_j -+ q_k",
        "an effort with accelerations of other joints that follows a difference of two angles",
        "inertia of an unknown geometry, driven from the base",
    )
    texts = staticmethod(_parallel)
    scope = _scope(_parallel)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """d(f qd_k)/dt - qd_j qd_k df/dq_j for every f, (n, m)."""
        who, orders = _sums(_beside, chain(motion), j)
        angle, a, v = motion.q @ orders, motion.qdd[:, who], motion.qd[:, who] ** 2
        cos, sin = np.cos(angle), np.sin(angle)
        sign = orders[who, np.arange(who.size)]
        return _turns(cos * a - sign * (sin * v), sin * a + sign * (cos * v))


def _behind(arm: ArmAxes, j: int) -> list[int]:
    """Joints that turn behind joint j, the next one first: the inertia about it follows them."""
    return [k for k in arm.moves if k > j and arm.units[k] == "rad"]


def _swung(arm: ArmAxes, j: int) -> Iterator[tuple[int, Angle]]:
    """Angles of the inertia about joint j: of the two joints behind it."""
    behind = _behind(arm, j)[:NEXT]
    for at, k in enumerate(behind):
        yield from ((j, angle) for angle in _angles(k, *behind[at + 1 :]))


def _swing(arm: ArmAxes, j: int) -> Iterator[str]:
    """Rates of the angular momentum f qd_j, f = cos or sin of a sum of angles behind j."""
    v, a = f"v{j + 1}", f"a{j + 1}"
    for _, angle in _swung(arm, j):
        sum_, rate = f"({_summed(angle, 'q')})", f"({_summed(angle, 'v')})"
        yield f"cos{sum_} * {a} - sin{sum_} * ({rate} * {v})"
        yield f"sin{sum_} * {a} + cos{sum_} * ({rate} * {v})"


class GenericSwing(_OfGeometry):
    """Inertia about a joint that varies with the angles behind it: an arm that is stretched out."""

    name = "generic-swing"
    doc = _geometry_doc(
        "tau_j = sum_f c_f d(f qd_j)/dt,  f = {cos, sin}(m q_k + n q_l), the next two joints",
        "an effort with the joint's own acceleration that follows the posture behind it",
        "inertia of an unknown geometry, about this joint",
    )
    texts = staticmethod(_swing)
    scope = _scope(_swing)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """d(f qd_j)/dt for every f, (n, m)."""
        who, orders = _sums(_swung, chain(motion), j)
        angle, a, v = motion.q @ orders, motion.qdd[:, who], motion.qd[:, who]
        cos, sin, turns = np.cos(angle), np.sin(angle), motion.qd @ orders * v
        return _turns(cos * a - sin * turns, sin * a + cos * turns)


def _flung(arm: ArmAxes, j: int) -> Iterator[tuple[int, Angle]]:
    """The two joints before j, and the angles of the inertia about each in which j counts."""
    if arm.units[j] != "rad" or j not in arm.moves:
        return
    for k in [k for k in reversed(arm.moves) if k < j and arm.units[k] == "rad"][:NEXT]:
        beside = sorted((x for x in _behind(arm, k) if x != j), key=lambda x: abs(x - j))
        yield from ((k, angle) for angle in _angles(j, *beside))


def _centrifugal(arm: ArmAxes, j: int) -> Iterator[str]:
    """Squares of the speeds of joints before j times cos and sin of sums of angles with j's."""
    for k, angle in _flung(arm, j):
        yield from (f"v{k + 1} ** 2 * {wave}({_summed(angle, 'q')})" for wave in ("cos", "sin"))


class GenericCentrifugal(_OfGeometry):
    """What the turning of a joint before does to this one: it flings the links outwards."""

    name = "generic-centrifugal"
    doc = _geometry_doc(
        "tau_j = sum_k qd_k^2 {cos, sin}(m q_j + n q_l),  k before j",
        "an effort with the square of an earlier joint's speed that follows the posture",
        "inertia of an unknown geometry, about the joints before",
    )
    texts = staticmethod(_centrifugal)
    scope = _scope(_centrifugal)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """All products, (n, m)."""
        who, orders = _sums(_flung, chain(motion), j)
        angle, square = motion.q @ orders, motion.qd[:, who] ** 2
        return _turns(square * np.cos(angle), square * np.sin(angle))


#: Other joints with which a closed chain is sought, nearest first.  Double: 64 columns more.
LOOPED = 2


def _looped(arm: ArmAxes, j: int) -> Iterator[str]:
    """Accelerations and products of speeds of two joints times waves of both: what no chain has."""
    others = sorted((k for k in arm.near(j) if k != j), key=lambda k: abs(k - j))
    known = set(_coupled(arm, j))
    for k in others[:LOOPED]:
        v, w = f"v{j + 1}", f"v{k + 1}"
        own, other = arm.waves(j), arm.waves(k)
        both = [f"{a} * {b}" for a in own for b in other]
        for rate in (f"a{j + 1}", f"a{k + 1}", f"{v} ** 2", f"{w} ** 2", f"{v} * {w}"):
            every = (f"{rate} * {wave}" for wave in (*own, *other, *both))
            yield from (text for text in every if text not in known)


class GenericLoop(_OfGeometry):
    """Inertias and couplings that vary with two angles: a parallelogram, a five-bar linkage."""

    name = "generic-loop"
    doc = _geometry_doc(
        "tau_j = sum_k {qdd_j, qdd_k, qd_j^2, qd_k^2, qd_j qd_k} {1, sin, cos} q_j "
        "{1, sin, cos} q_k",
        "an effort with accelerations and squares of speeds that varies with two angles",
        "inertia of an unknown closed chain",
    )
    texts = staticmethod(_looped)
    scope = _scope(_looped)
    relations = Relations(
        extends=("generic-inertia", "generic-parallel", "generic-swing", "generic-centrifugal")
    )


EFFECTS: tuple[Effect, ...] = (
    FrictionNetwork(),
    GenericGravity(),
    GenericPosture(),
    GenericReach(),
    GenericInertia(),
    GenericParallel(),
    GenericSwing(),
    GenericCentrifugal(),
    GenericLoop(),
)
