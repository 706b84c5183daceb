"""Masses, springs and stops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.models.effect import Effect, Param, margins
from hil.models.motion import FloatArray, Motion

#: Share of an effort at mid-range by which it must vary over the range to depend on the position.
VARIES = 0.1


class RigidBody(Effect):
    """The robot's links: inertia, Coriolis and gravity efforts, all parameters free."""

    motion_only = True
    name, family = "rigid-body", "mass"
    equation = "tau = M(q) qdd + C(q, qd) qd + N(q) = Y(q, qd, qdd) pi"
    signature = "residual follows acceleration, gravity direction and products of speeds"
    confused_with = ("payload", "torque-gain", "spring")
    shown_by = "fast motion over the workspace, many postures"
    source = "Khalil and Dombre, Modeling, Identification and Control of Robots, 2002, ch. 12"
    whole_robot = True
    candidate = False

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Y, shape (n, d, p)."""
        return motion.robot.regressor(motion.q, motion.qd, motion.qdd)

    def terms(self, motion: Motion, j: int) -> tuple[Param, ...]:
        """The robot's own parameters."""
        robot = motion.robot
        return tuple(
            Param(name, unit, "rigid-body parameter", source="robot description")
            for name, unit in zip(robot.names, robot.param_units, strict=True)
        )


class Armature(Effect):
    """Inertia of the motor's rotor, reflected to the joint."""

    motion_only = True
    name, family = "armature", "mass"
    equation = "tau = ia qdd"
    signature = "residual proportional to the joint's own acceleration"
    confused_with = ("rigid-body",)
    shown_by = "fast motion of the joint in different postures"
    source = "Featherstone, Rigid Body Dynamics Algorithms, 2008, 9.6"
    params = (Param("ia", "{F} s^2/{x}", "reflected rotor inertia", 0.0),)
    candidate = False

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """The joint's acceleration qdd."""
        return motion.qdd[:, j : j + 1]

    def available(self, motion: Motion, j: int) -> str:
        """One inertia per independent axis is all there is."""
        return "" if motion.robot.has_armature else "the axis' inertia already contains it"


class Spring(Effect):
    """A linear spring on the joint."""

    name, family = "spring", "stiffness"
    equation = "tau = k q  (rest position in the offset)"
    signature = "residual proportional to position"
    confused_with = ("rigid-body", "position-torque", "cogging")
    shown_by = "static poses over a wide range"
    source = "Cavusoglu, Feygin, Tendick, Presence 11(6), 2002 (balance of haptic arms)"
    params = (
        Param("k", "{F}/{x}", "stiffness"),
        Param("t0", "{F}", "effort at mid-range"),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[q - mid-range, 1]."""
        centred = motion.q[:, j] - motion.span[j].mean()
        return np.stack([centred, np.ones_like(centred)], axis=1)

    def credible(
        self, motion: Motion, j: int, shape: Sequence[float], beta: Sequence[float],
        error: Sequence[float] = (),
    ) -> bool:  # fmt: skip
        """A spring whose rest position is not far beyond the range: else it is an offset."""
        half, sure = 0.5 * float(np.ptp(motion.span[j])), margins(beta, error)
        varies = (abs(beta[0]) + sure[0]) * half >= VARIES * abs(beta[1])
        return varies and super().credible(motion, j, shape, beta, error)


class PositionTorque(Effect):
    """Smooth effort over position: an umbilical, a cable bundle, a bent hose."""

    name, family = "position-torque", "stiffness"
    equation = "tau = t0 + sum_{k=1..6} ck T_k(x),  x = position scaled to [-1, 1]"
    signature = "smooth residual over position, the same in both directions"
    confused_with = ("spring", "rigid-body", "cogging")
    shown_by = "slow strokes over the whole range"
    source = "WPI dVRK identification (joint cable torque), RA-L 2019"
    params = (
        Param("t0", "{F}", "effort at mid-range"),
        *(Param(f"c{k}", "{F}", "Chebyshev coefficient") for k in range(1, 7)),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Chebyshev polynomials T0..T6."""
        values = np.polynomial.chebyshev.chebvander(np.clip(motion.scaled(j), -1, 1), 6)
        return np.asarray(values, dtype=np.float64)

    def credible(
        self, motion: Motion, j: int, shape: Sequence[float], beta: Sequence[float],
        error: Sequence[float] = (),
    ) -> bool:  # fmt: skip
        """An effort that may vary over the range: else it is an offset."""
        most = sum(abs(b) + e for b, e in zip(beta[1:], margins(beta, error)[1:], strict=True))
        varies = most >= VARIES * abs(beta[0])
        return varies and super().credible(motion, j, shape, beta, error)

    def foils(self, motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
        """An inertia that varies with position, M' = 1 or q:  M qdd + M' v^2 / 2.

        About a spring-like swing the acceleration is a function of the position.
        """
        q, v, a = motion.q[:, j], motion.qd[:, j], motion.qdd[:, j]
        first, second = q * a + v * v / 2, q * q * a + q * v * v
        return [first[:, None], np.stack([first, second], axis=1)]


#: Share of a stop's squared effort that may pull: noise, and the form of its law.
PULL = 0.05


class EndStop(Effect):
    """A stop that pushes back beyond a position."""

    name, family = "end-stop", "stiffness"
    equation = "tau = k d + h d |d| + c |d| v,  d = max(0, q - q0) (upper), min(0, q - q0) (lower)"
    signature = "residual only at one end of the range"
    confused_with = ("spring", "position-torque")
    shown_by = "strokes that reach the end of the range, slowly and fast"
    source = "Hunt, Crossley, J. Applied Mechanics 42, 1975"
    params = (
        Param("k", "{F}/{x}", "stiffness at first touch", 0.0),
        Param("h", "{F}/{x}^2", "hardening"),
        Param("c", "{F} s/{x}^2", "damping per penetration"),
    )
    shape = (
        Param("q0", "{x}", "position of the stop"),
        Param(
            "side",
            "1",
            "+1 upper, -1 lower",
            -1.0,
            1.0,
            codes=((1.0, "upper stop"), (-1.0, "lower stop")),
            choice=True,
        ),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[d, d |d|, |d| v]."""
        side = 1.0 if shape[1] > 0 else -1.0
        depth = side * np.maximum(0.0, side * (motion.q[:, j] - shape[0]))
        return np.stack([depth, depth * np.abs(depth), np.abs(depth) * motion.qd[:, j]]).T

    def credible(
        self, motion: Motion, j: int, shape: Sequence[float], beta: Sequence[float],
        error: Sequence[float] = (),
    ) -> bool:  # fmt: skip
        """A stop pushes back and takes energy: it neither pulls nor drives.

        Its effort acts towards the range at (nearly) all instants of contact, and what drives in
        its damping is noise or next to nothing: another effect that is still missing on the joint
        tilts it by so much.  Friction that depends on the position fails this: it changes its sign
        with the speed.
        """
        side = 1.0 if shape[1] > 0 else -1.0
        parts = side * self.columns(motion, j, shape) * np.array(beta)
        push = parts.sum(axis=1)
        power = PULL * float(np.sum(push**2))
        pull = float(np.sum(np.minimum(push, 0.0) ** 2))
        brakes = beta[2] >= -margins(beta, error)[2] or float(np.sum(parts[:, 2] ** 2)) <= power
        return brakes and 0.0 < power and pull <= power

    def grid(self, motion: Motion, j: int) -> list[tuple[float, ...]]:
        """2 to 35 % of the span from either end."""
        low, high = motion.span[j]
        fractions = (0.02, 0.05, 0.1, 0.15, 0.2, 0.27, 0.35)
        upper: list[tuple[float, ...]]
        upper = [(float(high - f * (high - low)), 1.0) for f in fractions]
        return upper + [(float(low + f * (high - low)), -1.0) for f in fractions]


EFFECTS: tuple[Effect, ...] = (
    RigidBody(), Armature(), Spring(), PositionTorque(), EndStop(),
)  # fmt: skip
