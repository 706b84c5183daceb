"""Limits of a robot; margins of a motion to them, its check before it is played, making it fit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.excite.trajectory import Trajectory, grid, sample
from hil.models.robots import Robot
from hil.record.recording import RobotSource
from hil.record.urdf_joints import urdf_joints

FloatArray = NDArray[np.float64]
INF = float("inf")


@runtime_checkable
class HasTip(Protocol):
    """A robot that knows where its tip is."""

    def tip(self, q: FloatArray) -> FloatArray:
        """Tip position (n, 3) [m]."""
        ...


@dataclass(frozen=True)
class Limits:
    """What a motion of d joints must keep to.

    Parameters
    ----------
    low, high : ndarray (d,)
        Positions [rad or m].
    speed, torque : ndarray (d,)
        Largest magnitudes [rad/s or m/s], [N m or N]; infinite where none is known.
    center : ndarray (d,)
        A safe posture in the middle.
    folds : tuple of (int, int, float, float)
        Joints i, k and the range of q_i - q_k that the mechanism allows.
    box : ndarray (2, 3) or None
        Lowest and highest tip coordinates in the base frame [m].
    source : str
        Where they come from.
    """

    low: FloatArray
    high: FloatArray
    speed: FloatArray
    torque: FloatArray
    center: FloatArray
    folds: tuple[tuple[int, int, float, float], ...] = ()
    box: FloatArray | None = None
    source: str = ""


#: Premium 1.5: th1 +-90, th2 -124..119, th3 -29..214, th2 - th3 -55..65 degrees (Cavusoglu et
#: al. 2002), less 1 degree; the workspace of the data sheet (191 x 381 x 267 mm) about the tip at
#: the posture (0, 0.4, 0.3); speed that the drives track and torque of the rig's default.
_PREMIUM = Limits(
    np.radians([-89.0, -123.0, -28.0]),
    np.radians([89.0, 118.0, 213.0]),
    np.full(3, 3.0),
    np.full(3, 0.8),
    np.array([0.0, 0.4, 0.3]),
    ((1, 2, -0.95, 1.13),),
    np.array([[0.152, -0.190, -0.212], [0.344, 0.190, 0.055]]),
    "PHANTOM Premium 1.5",
)
#: Omni: workspace 160 x 120 x 70 mm of the data sheet within 1.8 rad/s, centred likewise.
_OMNI = Limits(
    np.radians([-45.0, 0.0, -20.0]),
    np.radians([45.0, 90.0, 60.0]),
    np.full(3, 1.8),
    np.full(3, 0.3),
    np.array([0.0, 0.6, 0.3]),
    source="PHANTOM Omni",
)
PRESETS = {"phantom-premium-1.5": _PREMIUM, "phantom-omni": _OMNI}


def of_robot(source: RobotSource) -> Limits | None:
    """Limits that come with a robot; None where it brings none (independent axes)."""
    return _of_urdf(source.urdf) if source.urdf else PRESETS.get(source.preset)


def _of_urdf(text: str) -> Limits:
    """Limits of a URDF; a joint without range gets half a turn, without speed 1 rad/s."""
    joints = urdf_joints(text)
    low = np.array([j.lower if math.isfinite(j.lower) else -np.pi / 2 for j in joints])
    high = np.array([j.upper if math.isfinite(j.upper) else np.pi / 2 for j in joints])
    speed = np.array([j.velocity if math.isfinite(j.velocity) else 1.0 for j in joints])
    torque = np.array([j.effort for j in joints])
    return Limits(low, high, speed, torque, (low + high) / 2, source="the URDF")


def of_data(q: FloatArray, qd: FloatArray, tau: FloatArray) -> Limits:
    """What a recording itself shows to be safe: its range, twice its speed, twice its effort."""
    low, high = q.min(axis=0), q.max(axis=0)
    speed, torque = 2 * np.abs(qd).max(axis=0), 2 * np.abs(tau).max(axis=0)
    return Limits(low, high, speed, torque, (low + high) / 2, source="the recording")


def places(limits: Limits, robot: Robot, q: FloatArray) -> dict[str, FloatArray]:
    """Distance of each posture (n, d) to every position limit: positive inside, (n,) each."""
    out: dict[str, FloatArray] = {}
    for j, name in enumerate(robot.joints):
        out[f"position {name}"] = np.minimum(q[:, j] - limits.low[j], limits.high[j] - q[:, j])
    for i, k, low, high in limits.folds:
        fold = q[:, i] - q[:, k]
        name = f"fold {robot.joints[i]} - {robot.joints[k]}"
        out[name] = np.minimum(fold - low, high - fold)
    if limits.box is not None and isinstance(robot, HasTip):
        p = robot.tip(q)
        for axis, name in enumerate("xyz"):
            inside = np.minimum(p[:, axis] - limits.box[0, axis], limits.box[1, axis] - p[:, axis])
            out[f"workspace {name}"] = inside
    return out


def allowed(limits: Limits, robot: Robot, q: FloatArray) -> NDArray[np.bool_]:
    """Whether postures (n, d) keep to every position limit."""
    return np.asarray(np.min(list(places(limits, robot, q).values()), axis=0) >= -1e-9)


#: Share of the speed and torque limits that a planned motion may use.
HEADROOM = 0.8
#: A motion is looked at this often [Hz].
CHECK_RATE = 250.0


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


def margins(x: Trajectory, limits: Limits, robot: Robot) -> list[Margin]:
    """Margins of a motion to each limit of position and speed; `torques` has the others.

    Parameters
    ----------
    x : Trajectory
        The motion.
    limits : Limits
        The limits.
    robot : Robot
        Geometry and units.
    """
    q, qd, _ = sample(x, grid(x, CHECK_RATE))
    units = dict(zip(robot.joints, robot.units, strict=True))
    out = [
        Margin(
            name,
            float(np.min(d)),
            0.0,
            "m" if name.startswith("work") else units.get(name.split()[1], "rad"),
        )
        for name, d in places(limits, robot, q).items()
    ]
    for j, (name, unit) in enumerate(units.items()):
        speed = float(np.max(np.abs(qd[:, j])))
        out.append(Margin(f"speed {name}", speed, float(limits.speed[j]), f"{unit}/s"))
    return out


def torques(limits: Limits, robot: Robot, effort: FloatArray) -> list[Margin]:
    """Margins of predicted efforts (n, d) [N m or N] to each torque limit."""
    out = []
    for j, (name, unit) in enumerate(zip(robot.joints, robot.units, strict=True)):
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
    broken = [m for m in margins(x, limits, robot) if m.broken]
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
