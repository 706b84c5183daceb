"""A motion against the limits: margins, the check before it is played, and making it fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.excite.limits import Limits, places
from hil.excite.trajectory import Trajectory, grid, sample
from hil.models.robots import Robot

FloatArray = NDArray[np.float64]
#: Share of the speed and torque limits that a planned motion may use.
HEADROOM = 0.8
#: A motion is looked at this often [Hz].
RATE = 250.0


@dataclass(frozen=True)
class Margin:
    """Distance to one limit.

    Parameters
    ----------
    what : str
        E.g. ``"speed joint2"``.
    used, limit : float
        Largest magnitude and limit; for positions the smallest distance and zero.
    unit : str
        SI unit.
    """

    what: str
    used: float
    limit: float
    unit: str

    @property
    def broken(self) -> bool:
        """Whether the limit is passed."""
        if self.what.startswith(("speed", "torque")):
            return self.used > self.limit * (1 + 1e-9)
        return self.used < -1e-9


def margins(x: Trajectory, limits: Limits, robot: Robot, effort: FloatArray | None) -> list[Margin]:
    """Margins of a motion to each limit.

    Parameters
    ----------
    x : Trajectory
        The motion.
    limits : Limits
        The limits.
    robot : Robot
        Geometry and units.
    effort : ndarray (n, d) or None
        Predicted effort at `grid(x, RATE)` [N m or N]; None leaves torque out.
    """
    q, qd, _ = sample(x, grid(x, RATE))
    units = dict(zip(robot.joints, robot.units, strict=True))
    out = [
        Margin(name, float(np.min(d)), 0.0, "m" if name.startswith("work") else
               units.get(name.split()[1], "rad"))
        for name, d in places(limits, robot, q).items()
    ]  # fmt: skip
    for j, (name, unit) in enumerate(units.items()):
        speed = float(np.max(np.abs(qd[:, j])))
        out.append(Margin(f"speed {name}", speed, float(limits.speed[j]), f"{unit}/s"))
    if effort is not None:
        for j, (name, unit) in enumerate(units.items()):
            peak = float(np.max(np.abs(effort[:, j])))
            torque = float(limits.torque[j])
            out.append(Margin(f"torque {name}", peak, torque, "N" if unit == "m" else "N m"))
    return out


def check(x: Trajectory, limits: Limits, robot: Robot, rate: float) -> None:
    """Refuse a motion that does not fit the arm that is to play it.

    Raises
    ------
    ConfigError
        For other joints, a limit that is passed, or a motion too quick for the loop's rate.
    """
    if x.joints != robot.joints:
        raise ConfigError(
            f"trajectory {x.name!r} moves {', '.join(x.joints)}, the arm has "
            f"{', '.join(robot.joints)}; make one for this arm with 'hil excite'"
        )
    quick = min(float(np.min(x.blend)), x.period / max(x.series.shape[1], 1) / 2)
    if quick * rate < 10:
        raise ConfigError(
            f"trajectory {x.name!r} changes within {1e3 * quick:.3g} ms; at {rate:g} Hz at least "
            f"{1e4 / rate:.3g} ms are needed"
        )
    broken = [m for m in margins(x, limits, robot, None) if m.broken]
    if broken:
        m = broken[0]
        text = (
            f"{m.used:.3g} {m.unit} against {m.limit:.3g}"
            if m.limit
            else f"{-m.used:.3g} {m.unit} beyond the limit"
        )
        raise ConfigError(
            f"trajectory {x.name!r} leaves the limits of {limits.source or 'the arm'}: {m.what} is "
            f"{text}; nothing was moved"
        )
