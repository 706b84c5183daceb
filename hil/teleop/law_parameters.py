"""Designs as tables of a rig file: the parameters of the law `lawrence`, there and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from hil.models.phantom import Premium
from hil.teleop import force_sensor_free
from hil.teleop.architecture import FORCE, MOTION, Design, MotionTerm, Realisation, RobotImpedance
from hil.teleop.hybrid import FREE, FloatArray, Impedance
from hil.teleop.sampled_loop import Cable, SampledLoop

_AXES = ("x", "y", "z")


class Way(Protocol):
    """One direction of the link."""

    @property
    def delay(self) -> float:
        """Shortest delay [s]."""

    @property
    def jitter(self) -> float:
        """What comes on top at most [s]."""


class LawParameters(Protocol):
    """What is read of a law's parameters; see `hil.controllers.lawrence.LawrenceConfig`."""

    @property
    def shape(self) -> str: ...  # noqa: D102
    @property
    def forces(self) -> str: ...  # noqa: D102
    @property
    def velocity_hz(self) -> float: ...  # noqa: D102
    @property
    def acceleration_hz(self) -> float: ...  # noqa: D102
    @property
    def force_hz(self) -> float: ...  # noqa: D102
    @property
    def forward(self) -> Way: ...  # noqa: D102
    @property
    def backward(self) -> Way: ...  # noqa: D102
    @property
    def leader_model(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def follower_model(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def cable(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def pose(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def operator(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def free(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def environment(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def motion_scale(self) -> float: ...  # noqa: D102
    @property
    def force_scale(self) -> float: ...  # noqa: D102

    def gains(self) -> FloatArray:
        """Gains per axis, (3, 16)."""

    def masses(self) -> FloatArray:
        """Design masses, (2, 3) [kg]."""


def table(designs: Sequence[Design]) -> dict[str, Any]:
    """Parameters c1..c8, masses and scales of one design for all axes, or of three."""
    out: dict[str, Any] = {}
    for name in MOTION:
        terms = [getattr(d, name) for d in designs]
        out[name] = [float(x) for c in terms for x in (c.k, c.b, c.a)]
    for name in FORCE:
        out[name] = [float(getattr(d, name)) for d in designs]
    out["leader_mass"] = [d.master.m for d in designs]
    out["follower_mass"] = [d.slave.m for d in designs]
    first = designs[0]
    return out | {"motion_scale": first.motion_scale, "force_scale": first.force_scale}


def tip_mass(pi: Any, pose: Any) -> FloatArray:
    """Diagonal of J^-T M J^-1 at a pose: what each axis weighs on its own [kg], (3,).

    Parameters
    ----------
    pi : sequence of 8 floats
        Rigid-body parameters of a Premium 1.5.
    pose : sequence of 3 floats
        Joint angles [rad].
    """
    arm, q = Premium(()), np.asarray(pose, float)[None]
    zero = np.zeros((1, 3))
    y = np.concatenate([arm.regressor(q, zero, np.eye(3)[i : i + 1]) for i in range(3)])
    rest = arm.regressor(q, zero, zero)
    m = np.einsum("ijk,k->ij", y - rest, np.asarray(pi, float))
    inverse = np.linalg.inv(arm.jacobian(q)[0])
    out: FloatArray = np.diag(inverse.T @ m @ inverse).copy()
    return out


def realisation(law: LawParameters) -> Realisation:
    """Filters, and the longest delay of each channel."""
    return Realisation(
        law.velocity_hz,
        law.acceleration_hz,
        law.force_hz,
        law.forward.delay + law.forward.jitter,
        law.backward.delay + law.backward.jitter,
    )


def designs_of(law: LawParameters) -> list[Design]:
    """Designs of the three axes."""
    out = []
    for g, m in zip(law.gains(), law.masses().T, strict=True):
        t = [MotionTerm(*map(float, g[3 * i : 3 * i + 3])) for i in range(4)]
        out.append(
            Design(
                c1=t[0],
                c4=t[1],
                c7=t[2],
                c8=t[3],
                c2=float(g[12]),
                c3=float(g[13]),
                c5=float(g[14]),
                c6=float(g[15]),
                master=RobotImpedance(float(m[0])),
                slave=RobotImpedance(float(m[1])),
                name="lawrence",
                motion_scale=law.motion_scale,
                force_scale=law.force_scale,
            )
        )
    return out


def loops_of(law: LawParameters) -> list[SampledLoop]:
    """Loops of the three axes at the law's pose, for the checks.

    Forces that are estimated from the motion make of a design its force-sensor-free equivalent
    for the arms as they are at this pose.

    Raises
    ------
    ConfigError
        If it is too close to the singularity where they cannot be.
    """
    real = realisation(law)
    tips = [tip_mass(pi, law.pose) for pi in (law.leader_model, law.follower_model)]
    operators = Impedance(*law.operator), Impedance(*law.free)
    cable = Cable(*law.cable) if law.cable else None
    designs = designs_of(law)
    if law.forces == "estimated":
        arms = tips if law.shape == "natural" else law.masses()
        designs = [
            force_sensor_free.transform(
                replace(d, master=RobotImpedance(float(m)), slave=RobotImpedance(float(s)))
            )
            for d, m, s in zip(designs, *arms, strict=True)
        ]
    return [
        SampledLoop(
            design,
            real,
            law.shape,
            (float(tips[0][i]), float(tips[1][i])),
            cable,
            _AXES[i],
            operators,
            (FREE, Impedance(*law.environment)),
        )
        for i, design in enumerate(designs)
    ]


def payload(pi: Any, mass: float) -> FloatArray:
    """Parameters pi of an arm that carries `mass` [kg] at its tip, (8,).

    M += m J^T J and N += m g J_z lie within the eight parameters.
    """
    l1, l2, g = Premium.l1, Premium.l2, 9.81
    # M11: m (l1^2 cos^2 th2 + l2^2 sin^2 th3 + 2 l1 l2 cos th2 sin th3)
    more = np.array(
        [
            (l1**2 + l2**2) / 2,
            l1**2 / 2,
            -(l2**2) / 2,
            2 * l1 * l2,
            l1**2,
            l2**2,
            g * l1,
            g * l2,
        ]
    )
    out: FloatArray = np.asarray(pi, float) + mass * more
    return out
