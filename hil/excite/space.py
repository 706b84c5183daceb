"""How far each joint may go from the middle posture, alone and together with the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.excite.limits import Limits, allowed
from hil.excite.margins import HEADROOM
from hil.models.robots import Robot

FloatArray = NDArray[np.float64]
#: Share of the way to a position limit that is used.
SHARE = 0.95
#: Speed of a joint whose limit nobody knows: its range in two seconds.
CROSSING = 2.0


@dataclass(frozen=True)
class Space:
    """Room for motions around a posture.

    Parameters
    ----------
    robot : Robot
        Joints and geometry.
    limits : Limits
        The limits.
    center : ndarray (d,)
        Middle posture [rad or m].
    alone : ndarray (d, 2)
        Range of each joint while the others stay in the middle.
    together : ndarray (d, 2)
        Range of each joint in which all of them may move at once.
    speed : ndarray (d,)
        Largest planned speed [rad/s or m/s].
    """

    robot: Robot
    limits: Limits
    center: FloatArray
    alone: FloatArray
    together: FloatArray
    speed: FloatArray


def explore(limits: Limits, robot: Robot) -> Space:
    """Measure the room around the middle posture of the limits.

    Raises
    ------
    ConfigError
        If that posture itself is outside.
    """
    center = limits.center
    if not allowed(limits, robot, center[None])[0]:
        raise ConfigError(
            f"the middle posture {np.round(center, 3).tolist()} is outside the limits of "
            f"{limits.source}; give the rig file another center or wider limits"
        )
    d = center.size
    alone = np.array([_along(limits, robot, j) for j in range(d)])
    reach = alone - center[:, None]
    together = center[:, None] + _common(limits, robot, reach) * reach
    width = np.ptp(alone, axis=1)
    speed = HEADROOM * np.where(np.isfinite(limits.speed), limits.speed, width / CROSSING)
    return Space(robot, limits, center, alone, together, speed)


def _along(limits: Limits, robot: Robot, j: int) -> tuple[float, float]:
    """Positions that joint j reaches either way before a limit, less a margin."""
    ends = []
    for end in (limits.low[j], limits.high[j]):
        steps = np.linspace(0.0, 1.0, 200)
        q = np.tile(limits.center, (steps.size, 1))
        q[:, j] += steps * (end - limits.center[j])
        ok = allowed(limits, robot, q)
        far = steps[-1] if ok.all() else steps[int(np.argmin(ok)) - 1]
        ends.append(float(limits.center[j] + SHARE * far * (end - limits.center[j])))
    return ends[0], ends[1]


def _common(limits: Limits, robot: Robot, reach: FloatArray) -> float:
    """Largest factor by which all ranges may be used at once: corners and points between."""
    rng = np.random.default_rng(0)
    sides = rng.integers(0, 2, (256, reach.shape[0]))
    inner = rng.uniform(0.0, 1.0, (256, reach.shape[0]))
    inner[:64] = 1.0
    corners = np.take_along_axis(reach[None], sides[:, :, None], axis=2)[..., 0] * inner
    for factor in np.linspace(1.0, 0.05, 39):
        if np.all(allowed(limits, robot, limits.center + factor * corners)):
            return float(factor)
    return 0.05
