"""Designs as tables of a rig file: the parameters of the law `lawrence`, there and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Protocol

import numpy as np

from hil.errors import ConfigError
from hil.models.phantom import Premium
from hil.teleop import force_sensor_free, gate
from hil.teleop.architecture import (
    FORCE_GAINS,
    MOTION,
    Design,
    MotionTerm,
    Realisation,
    RobotImpedance,
)
from hil.teleop.hybrid import FloatArray, Impedance
from hil.teleop.sampled_loop import Cable, SampledLoop

_AXES = ("x", "y", "z")
#: Condition of the Jacobian from which a pose counts as singular; 2 in the middle of the workspace.
_SINGULAR = 30.0


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
    def workspace(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def friction_damping(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def friction_share(self) -> float: ...  # noqa: D102
    @property
    def disturbance(self) -> float: ...  # noqa: D102
    @property
    def observer_hz(self) -> float: ...  # noqa: D102
    @property
    def motion_scale(self) -> float: ...  # noqa: D102
    @property
    def force_scale(self) -> float: ...  # noqa: D102

    def gains(self) -> FloatArray:
        """Gains per axis, (3, 16)."""

    def masses(self) -> FloatArray:
        """Design masses, (2, 3) [kg]."""

    def fixture(self) -> tuple[float, float]:
        """Stiffness [N/m] and damping [N s/m] of all virtual fixtures."""

    def friction(self, arm: int, speed: float) -> FloatArray:
        """Friction of the arm's joints as declared, moving alone at a speed [rad/s], (3,) [N m]."""


def law_table(designs: Sequence[Design]) -> dict[str, Any]:
    """Parameters c1..c8, masses and scales of one design for all axes, or of three."""
    out: dict[str, Any] = {}
    for name in MOTION:
        terms = [getattr(d, name) for d in designs]
        out[name] = [float(x) for c in terms for x in (c.k, c.b, c.a)]
    for name in FORCE_GAINS:
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

    Raises
    ------
    ConfigError
        At a singular pose, and for a model whose inertia is not positive there.
    """
    arm, q = Premium(()), np.asarray(pose, float)[None]
    zero = np.zeros((1, 3))
    y = np.concatenate([arm.regressor(q, zero, np.eye(3)[i : i + 1]) for i in range(3)])
    rest = arm.regressor(q, zero, zero)
    m = np.einsum("ijk,k->ij", y - rest, np.asarray(pi, float))
    jacobian, said = arm.jacobian(q)[0], ", ".join(f"{x:g}" for x in np.asarray(pose, float))
    if not np.linalg.cond(jacobian) < _SINGULAR:
        raise ConfigError(
            f"pose = ({said}) rad is singular: the tip cannot move along every axis there; choose "
            "one inside the workspace, (0, 0.4, 0.3) say"
        )
    if not np.linalg.eigvalsh(m)[0] > 0.0:
        raise ConfigError(
            f"a model of the arms has no positive inertia at the pose ({said}) rad; write the "
            "parameters of 'hil fit' into leader_model and follower_model, or leave them out"
        )
    inverse = np.linalg.inv(jacobian)
    out: FloatArray = np.diag(inverse.T @ m @ inverse).copy()
    return out


def realisation(law: LawParameters) -> Realisation:
    """Filters, and the longest delay of each channel; a loop has whole ticks of it."""
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
    """Loops of the three axes with the set for which they must be stable.

    The set: operators up to a firm one, environments up to the declared one, poses over the
    workspace, and every delay up to the longest; see `hil.teleop.gate`.

    Forces that are estimated from the motion make of a design its force-sensor-free equivalent
    for the arms as they are at this pose.

    Raises
    ------
    ConfigError
        If it is too close to the singularity where they cannot be.
    """
    real = realisation(law)
    models = (law.leader_model, law.follower_model)
    tips = [tip_mass(pi, law.pose) for pi in models]
    # a law that estimates its forces has other gains at every pose
    where = [] if law.forces == "estimated" else judged_poses(law.pose, law.workspace)
    over = np.array([tips, *([tip_mass(pi, q) for pi in models] for q in where)])
    operators = tuple(gate.operators_up_to(Impedance(*law.operator), Impedance(*law.free)))
    environments = tuple(gate.surroundings(Impedance(*law.environment)))
    own, compensated = _friction(law)
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
            environments,
            tuple(dict.fromkeys((round(m, 5), round(s, 5)) for m, s in over[:, :, i].tolist())),
            (float(own[0, i]), float(own[1, i])),
            (float(compensated[0, i]), float(compensated[1, i])),
            law.disturbance,
            law.observer_hz if law.disturbance else 0.0,
            law.fixture(),
        )
        for i, design in enumerate(designs)
    ]


#: Speed [rad/s] at which friction counts as damping: 5 cm/s at the tip, a calm hand.
_SPEED = 0.25
#: Part of identified friction that is there for certain.
_CERTAIN = 0.9


def _friction(law: LawParameters) -> tuple[FloatArray, FloatArray]:
    """Damping at the tip: the arms' own for certain, and the compensation's, (2, 3) [N s/m].

    Both are secants of the declared friction.  What is compensated must be declared, so that a
    share up to `_CERTAIN` adds no energy; a larger one may, as negative damping.  Friction that is
    declared negative is none of the arms' own, and its compensation a damper, as the law has it.
    """
    inverse = np.linalg.inv(Premium(()).jacobian(np.asarray([law.pose], float))[0])
    slopes = [law.friction(arm, _SPEED) / _SPEED for arm in range(2)]
    tip = np.array([np.diag(inverse.T @ np.diag(s) @ inverse) for s in slopes])
    own = np.maximum(_CERTAIN * tip, np.reshape(law.friction_damping, (2, 1)))
    return own, law.friction_share * tip


def judged_poses(pose: Sequence[float], extent: Sequence[float]) -> list[FloatArray]:
    """Joint angles at the corners of a box about the tip of a pose.

    Parameters
    ----------
    pose : sequence of 3 floats
        Joint angles [rad].
    extent : sequence of 3 floats, or empty
        Half of the box's sides [m]; empty = no further pose.

    Raises
    ------
    ConfigError
        If a corner is out of reach.
    """
    if not extent:
        return []
    centre = Premium(()).tip(np.asarray([pose], float))[0]
    corners = [centre + np.asarray(extent) * signs for signs in product((-1, 1), repeat=3)]
    return [_joints(p) for p in corners]


def _joints(p: FloatArray) -> FloatArray:
    """Joint angles (3,) at which the tip is at p (3,), elbow up."""
    l1, l2 = Premium.l1, Premium.l2
    radial = float(np.hypot(p[0], p[1]))
    length = float(np.hypot(radial, p[2]))
    lift = (l1**2 + length**2 - l2**2) / (2.0 * l1 * length)
    bend = (l1**2 + l2**2 - length**2) / (2.0 * l1 * l2)
    if max(abs(lift), abs(bend)) >= 1.0:
        raise ConfigError(
            f"workspace: its corner ({', '.join(f'{x:.3g}' for x in p)}) m is out of the arms' "
            f"reach of {l1 + l2:.3g} m; make workspace smaller, or choose another pose"
        )
    upper = np.arctan2(p[2], radial) + np.arccos(lift)
    return np.array([np.arctan2(p[1], p[0]), upper, upper + np.arccos(bend) - np.pi / 2])


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
