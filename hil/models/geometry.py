"""Gravity and couplings of an arm whose geometry is not known.

Of a serial chain every entry of the gravity vector and of the inertia matrix is a polynomial in the
sines and cosines of the joint angles.  Without a robot description these laws take its terms up to
products of two joints, with free coefficients.  They are corrections, not findings: they predict,
and no link's mass follows from them.

Source: Khalil, Dombre, Modeling, Identification and Control of Robots, 2002, 9.3 (dynamics are
linear in sums of products of sines and cosines); Spong, Hutchinson, Vidyasagar, Robot Modeling and
Control, 2006, 7.3 (Christoffel symbols).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

import numpy as np

from hil.models.correction import Correction
from hil.models.effect import Doc, Effect, Param, Scope, Trait
from hil.models.motion import FloatArray, Motion
from hil.models.robots import IndependentAxes

#: Joints, nearest in the chain first, whose angles count; 72 products of two of them.
MOST = 6
#: Range of a joint below which it holds its place [rad].
LITTLE = 0.02


def moving(motion: Motion, j: int) -> list[int]:
    """Joints that move, at most `MOST`, those nearest to joint j first."""
    some = [k for k in range(motion.d) if np.ptp(motion.span[k]) > LITTLE]
    return sorted(sorted(some, key=lambda k: abs(k - j))[:MOST])


def waves(motion: Motion, k: int) -> tuple[FloatArray, FloatArray]:
    """Sine and cosine of joint k's angle (n,)."""
    return np.sin(motion.q[:, k]), np.cos(motion.q[:, k])


Count = Callable[[Motion, int], int]


def _doc(equation: str, signature: str, variables: str) -> Doc:
    """Documentation of a law of several joints."""
    return Doc(
        equation=equation,
        signature=signature,
        shown_by="all joints over their whole ranges, slowly and fast",
        source="Khalil, Dombre, Modeling, Identification and Control of Robots, 2002, 9.3",
        caveat="sums of unknown masses and lengths: give a URDF to get values with a meaning",
        variables=variables,
    )


def _scope(count: Count) -> Scope:
    """Several turning joints of which nothing is known, a coefficient for each of the products."""

    def lacks(motion: Motion, j: int) -> str:
        if not isinstance(motion.robot, IndependentAxes) or motion.robot.units[j] != "rad":
            return "the robot's geometry is known, or it has no turning joints"
        if motion.d < 2 or not count(motion, j):
            return "needs two joints that move"
        return ""

    def terms(motion: Motion, j: int) -> tuple[Param, ...]:
        names = (f"c{k}" for k in range(1, count(motion, j) + 1))
        return tuple(Param(name, "{F}", "coefficient of a product") for name in names)

    return Scope(lacks=lacks, terms=terms)


class _OfGeometry(Correction):
    """A law of several joints without a robot description."""

    family = "mass"
    traits = Correction.traits | Trait.GEOMETRY


def _single(motion: Motion, j: int) -> Iterator[FloatArray]:
    """Waves of single joints, one column after the other (n,)."""
    for k in moving(motion, j):
        yield from waves(motion, k)


class GenericGravity(_OfGeometry):
    """Gravity: any sum of the sines and cosines of single joint angles."""

    name = "generic-gravity"
    doc = _doc(
        "tau_j = sum_k a_k sin q_k + b_k cos q_k",
        "an effort that stays at rest and varies with the posture",
        "gravity of an unknown geometry",
    )
    scope = _scope(lambda motion, j: 2 * len(moving(motion, j)))
    traits = _OfGeometry.traits | Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """All products, (n, m)."""
        return np.stack(list(_single(motion, j)), axis=1)


def _pairs(motion: Motion, j: int) -> int:
    """Number of products of the waves of two joints."""
    count = len(moving(motion, j))
    return 2 * count * (count - 1)


def _paired(motion: Motion, j: int) -> Iterator[FloatArray]:
    """Products of the waves of two joints."""
    for k, other in combinations(moving(motion, j), 2):
        for a in waves(motion, k):
            for b in waves(motion, other):
                yield a * b


class GenericPosture(_OfGeometry):
    """Gravity: products of the sines and cosines of two joint angles."""

    name = "generic-posture"
    doc = _doc(
        "tau_j = sum_kl c_kl {sin, cos} q_k {sin, cos} q_l",
        "an effort that stays at rest and varies with the posture of two joints",
        "gravity of an unknown geometry, by pairs of joints",
    )
    scope = _scope(_pairs)
    traits = _OfGeometry.traits | Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """All products, (n, m)."""
        return np.stack(list(_paired(motion, j)), axis=1)


def _coupled(motion: Motion, j: int) -> Iterator[FloatArray]:
    """Accelerations of the other joints, and squares of speeds, times waves."""
    v, a = motion.qd, motion.qdd
    for k in (k for k in moving(motion, j) if k != j):
        yield a[:, k]
        for w in waves(motion, max(j, k)):
            yield a[:, k] * w
            yield v[:, k] ** 2 * w
            yield v[:, j] * v[:, k] * w
        for w in waves(motion, k):
            yield a[:, j] * w


class GenericInertia(_OfGeometry):
    """Couplings: inertia of the other joints' motion, and what comes of their speeds."""

    name = "generic-inertia"
    doc = _doc(
        "tau_j = sum_k qdd_k (a + b sin q_m + c cos q_m) + qdd_j (d sin q_k + e cos q_k) + "
        "(qd_k^2 and qd_j qd_k) {sin, cos} q_m,  m the farther of j and k",
        "an effort with the acceleration of other joints, and with squares of speeds",
        "inertia of an unknown geometry",
    )
    scope = _scope(lambda motion, j: 9 * len([k for k in moving(motion, j) if k != j]))

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """All products, (n, m)."""
        return np.stack(list(_coupled(motion, j)), axis=1)


EFFECTS: tuple[Effect, ...] = (GenericGravity(), GenericPosture(), GenericInertia())
