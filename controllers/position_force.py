"""Position-force: the follower tracks the leader, the leader feels the follower's force.

operator -> leader --position--> PD -> follower -> environment
              ^------ J^T scale * measured force ------'
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Any

import numba as nb
import numpy as np

from hil.controllers import dynamics
from hil.errors import ConfigError, unknown
from hil.signals.device import FloatArray
from hil.signals.settable import SettableRange

_SPACES = ("joint", "workspace")


@dataclass(frozen=True)
class PositionForceConfig:
    """Parameters of the law.

    Parameters
    ----------
    space : str
        Where the follower's position error is formed: ``"joint"`` or ``"workspace"``.
    stiffness, damping : tuple of 3 floats
        [N m/rad] and [N m s/rad], or [N/m] and [N s/m] in the workspace.
    velocity_filter : float
        Time constant of the first-order filter on the rate of the error [s].
    force_scale : float
        Share of the follower's force that the leader feels.
    force_filter : float
        Time constant of the first-order filter on the force [s].
    leader_damping : float
        Added joint damping of the leader [N m s/rad].
    lengths : tuple of 2 floats
        Nominal l1, l2 [m] (Cavusoglu et al. 2002).
    leader_gravity, follower_gravity : tuple of 2 floats
        Nominal gravity: g2 cos th2, g3 sin th3 [N m].
    """

    space: str = "joint"
    stiffness: tuple[float, ...] = (8.0, 8.0, 4.0)
    damping: tuple[float, ...] = (0.14, 0.14, 0.07)
    velocity_filter: float = 0.003
    force_scale: float = 0.7
    force_filter: float = 0.004
    leader_damping: float = 0.004
    lengths: tuple[float, float] = dynamics.LINK_LENGTHS
    leader_gravity: tuple[float, ...] = (0.12, 0.03)
    follower_gravity: tuple[float, ...] = (0.0, -0.06)

    def __post_init__(self) -> None:
        if self.space not in _SPACES:
            raise ConfigError(unknown("space", self.space, _SPACES))

    def settable(self) -> dict[str, SettableRange]:
        """What an operator may set; at the bounds the simulated arms still move calmly."""
        joint = self.space == "joint"
        return {
            "stiffness": SettableRange(0.0, 20.0, "N m/rad", 3)
            if joint
            else SettableRange(0.0, 600.0, "N/m", 3),
            "damping": SettableRange(0.0, 0.2, "N m s/rad", 3)
            if joint
            else SettableRange(0.0, 5.0, "N s/m", 3),
            "velocity_filter": SettableRange(0.0005, 0.02, "s"),
            "force_scale": SettableRange(0.0, 2.0),
            "force_filter": SettableRange(0.0005, 0.05, "s"),
            "leader_damping": SettableRange(0.0, 0.05, "N m s/rad"),
        }


@nb.njit(cache=True, nogil=True)
def transpose(jacobian: Any, force: Any) -> None:
    """Replace `force` (3,) by the joint torques J^T force."""
    f0, f1, f2 = force[0], force[1], force[2]
    for j in range(3):
        force[j] = jacobian[0, j] * f0 + jacobian[1, j] * f1 + jacobian[2, j] * f2


@nb.njit(cache=True, nogil=True)
def apart(i: int, u: Any, workspace: bool, work: Any) -> tuple[float, float]:
    """Leader minus follower in joint [rad] or along axis [m] `i`, and the rate of it."""
    if not workspace:
        return u[0, i] - u[1, i], u[0, 3 + i] - u[1, 3 + i]
    rate = 0.0
    for j in range(3):
        rate += work[0, i, j] * u[0, 3 + j] - work[1, i, j] * u[1, 3 + j]
    return work[0, 3, i] - work[1, 3, i], rate


@nb.njit(cache=True, nogil=True)
def law(
    x: Any,
    u: Any,
    workspace: bool,
    gains: Any,
    gravity: Any,
    lengths: Any,
    scalars: Any,
    work: Any,
    x_next: Any,
    y: Any,
) -> None:
    """Leader and follower torques; rows of u and y: leader, follower.

    Parameters
    ----------
    x, x_next : ndarray (13,)
        1 once started; offset follower - leader [rad or m] (3,); filtered force on the
        follower [N] (3,); position error [rad or m] (3,);
        filtered rate of the error (3,).
    gains : ndarray (2, 3)
        Stiffness, damping.
    gravity : ndarray (2, 3)
        (0, g2, g3) of leader and follower [N m].
    scalars : ndarray (4,)
        Force scale, share of the force filter, leader damping, share of the rate filter.
    work : ndarray (2, 4, 3)
        Room for the Jacobians and, in the last row, the positions.
    """
    for a in range(2):
        dynamics.forward_kinematics(u[a], lengths, work[a, 3])
        dynamics.jacobian(u[a], lengths, work[a])
    x_next[0] = 1.0
    for i in range(3):
        gap, rate = apart(i, u, workspace, work)
        x_next[1 + i] = x[1 + i] if x[0] > 0.0 else -gap
        # f <- f + a (f_measured - f)
        x_next[4 + i] = x[4 + i] + scalars[1] * (u[1, 6 + i] - x[4 + i])
        x_next[7 + i] = gap + x_next[1 + i]
        x_next[10 + i] = x[10 + i] + scalars[3] * (rate - x[10 + i])
        y[1, i] = gains[0, i] * x_next[7 + i] + gains[1, i] * x_next[10 + i]
    if workspace:
        transpose(work[1], y[1])
    for j in range(3):
        # leader: tau = J^T scale f - b q'
        y[0, j] = -scalars[2] * u[0, 3 + j]
        for i in range(3):
            y[0, j] += work[0, i, j] * scalars[0] * x_next[4 + i]
    for a in range(2):
        y[a, 1] += gravity[a, 1] * cos(u[a, 1])
        y[a, 2] += gravity[a, 2] * sin(u[a, 2])


class PositionForce:
    """The law with its parameters; see `law`.

    Parameters
    ----------
    config : PositionForceConfig
        Parameters.
    arms : tuple of str
        Two names: leader, follower.
    period : float
        Of the loop [s].
    """

    #: The follower's, which the leader feels.
    needs_force = (1,)
    state_names = (
        "started",
        "offset1",
        "offset2",
        "offset3",
        "force_x",
        "force_y",
        "force_z",
        "error1",
        "error2",
        "error3",
        "rate1",
        "rate2",
        "rate3",
    )

    def __init__(self, config: PositionForceConfig, arms: tuple[str, ...], period: float) -> None:
        if len(arms) != 2:
            raise ConfigError(f"position-force needs leader and follower, not {len(arms)} arms.")
        self.config = config
        self._gains = np.array([config.stiffness, config.damping])
        gravity = (0.0, *config.leader_gravity), (0.0, *config.follower_gravity)
        self._gravity = np.array(gravity)
        self._lengths = np.array(config.lengths)
        force, rate = (
            1.0 - np.exp(-period / tau) for tau in (config.force_filter, config.velocity_filter)
        )
        self._scalars = np.array([config.force_scale, force, config.leader_damping, rate])
        self._work = np.zeros((2, 4, 3))

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period; see `hil.signals.device.Controller`."""
        law(
            x,
            u,
            self.config.space == "workspace",
            self._gains,
            self._gravity,
            self._lengths,
            self._scalars,
            self._work,
            x_next,
            y,
        )


Config = PositionForceConfig
build = PositionForce
