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

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from hil.models.correction import Correction
from hil.models.effect import Effect, Param
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


class _OfGeometry(Correction):
    """A law of several joints without a robot description."""

    family = "mass"
    explains = ("motor",)
    geometry = True
    shown_by = "all joints over their whole ranges, slowly and fast"
    source = "Khalil, Dombre, Modeling, Identification and Control of Robots, 2002, 9.3"
    caveat = "sums of unknown masses and lengths: give a URDF to get values with a meaning"

    def available(self, motion: Motion, j: int) -> str:
        """Several turning joints of which nothing is known."""
        if not isinstance(motion.robot, IndependentAxes) or motion.robot.units[j] != "rad":
            return "the robot's geometry is known, or it has no turning joints"
        if motion.d < 2 or not self._each(motion, j):
            return "needs two joints that move"
        return ""

    def terms(self, motion: Motion, j: int) -> tuple[Param, ...]:
        """One coefficient for each product."""
        count = self._each(motion, j)
        return tuple(Param(f"c{k}", "{F}", "coefficient of a product") for k in range(1, count + 1))

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """All products, (n, m)."""
        return np.stack(list(self._products(motion, j)), axis=1)

    def _each(self, motion: Motion, j: int) -> int:
        """Number of products."""
        raise NotImplementedError

    def _products(self, motion: Motion, j: int) -> Iterator[FloatArray]:
        """One column after the other (n,)."""
        raise NotImplementedError


class GenericGravity(_OfGeometry):
    """Gravity: any sum of the sines and cosines of single joint angles."""

    name, variables = "generic-gravity", "gravity of an unknown geometry"
    motion_only = True
    equation = "tau_j = sum_k a_k sin q_k + b_k cos q_k"
    signature = "an effort that stays at rest and varies with the posture"

    def _each(self, motion: Motion, j: int) -> int:
        return 2 * len(moving(motion, j))

    def _products(self, motion: Motion, j: int) -> Iterator[FloatArray]:
        for k in moving(motion, j):
            yield from waves(motion, k)


class GenericPosture(_OfGeometry):
    """Gravity: products of the sines and cosines of two joint angles."""

    name, variables = "generic-posture", "gravity of an unknown geometry, by pairs of joints"
    motion_only = True
    equation = "tau_j = sum_kl c_kl {sin, cos} q_k {sin, cos} q_l"
    signature = "an effort that stays at rest and varies with the posture of two joints"

    def _each(self, motion: Motion, j: int) -> int:
        count = len(moving(motion, j))
        return 2 * count * (count - 1)

    def _products(self, motion: Motion, j: int) -> Iterator[FloatArray]:
        for k, other in combinations(moving(motion, j), 2):
            for a in waves(motion, k):
                for b in waves(motion, other):
                    yield a * b


class GenericInertia(_OfGeometry):
    """Couplings: inertia of the other joints' motion, and what comes of their speeds."""

    name, variables = "generic-inertia", "inertia of an unknown geometry"
    equation = (
        "tau_j = sum_k qdd_k (a + b sin q_m + c cos q_m) + qdd_j (d sin q_k + e cos q_k) + "
        "(qd_k^2 and qd_j qd_k) {sin, cos} q_m,  m the farther of j and k"
    )
    signature = "an effort with the acceleration of other joints, and with squares of speeds"

    def _each(self, motion: Motion, j: int) -> int:
        return 9 * len([k for k in moving(motion, j) if k != j])

    def _products(self, motion: Motion, j: int) -> Iterator[FloatArray]:
        v, a = motion.qd, motion.qdd
        for k in (k for k in moving(motion, j) if k != j):
            yield a[:, k]
            for w in waves(motion, max(j, k)):
                yield a[:, k] * w
                yield v[:, k] ** 2 * w
                yield v[:, j] * v[:, k] * w
            for w in waves(motion, k):
                yield a[:, j] * w


EFFECTS: tuple[Effect, ...] = (GenericGravity(), GenericPosture(), GenericInertia())
