"""Reference motions of the test plants: wandering sines, shuttles, way points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hil.sim_devices.mujoco_plants.robots import Robot

FloatArray = NDArray[np.float64]
#: Seconds within which a motion swells, and comes to rest again.
SWELL = 1.5


def reference(robot: Robot, kind: str, seed: int, step: float) -> FloatArray:
    """Place, speed and acceleration of every joint, (n, d, 3) [rad or m, per s, per s^2].

    Parameters
    ----------
    robot : Robot
    kind : str
        One of `MOTIONS`.
    seed : int
        Chooses the motion.
    step : float
        Time between samples [s].
    """
    rng = np.random.default_rng([seed, sorted(MOTIONS).index(kind), 0x30CA])
    t = step * np.arange(round(robot.seconds / step), dtype=np.float64)
    out = np.empty((t.size, len(robot.links), 3))
    for k, link in enumerate(robot.links):
        x = MOTIONS[kind](rng, t, link.reach, link.speed)
        # within the reach and the speed of the joint
        x = x * min(1.0, link.reach / np.abs(x).max())
        speed = np.abs(np.gradient(x, t)).max()
        x = link.middle + _swell(t) * x * min(1.0, link.speed / speed)
        v = np.gradient(x, t, edge_order=2)
        out[:, k, 0], out[:, k, 1], out[:, k, 2] = x, v, np.gradient(v, t, edge_order=2)
    return out


def _swell(t: FloatArray) -> FloatArray:
    """Quintic from rest at both ends."""
    u: FloatArray = np.clip(np.minimum(t, t[-1] - t) / SWELL, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def _sines(rng: np.random.Generator, t: FloatArray, reach: float, speed: float) -> FloatArray:
    """Sines of no common period, each of which comes and goes."""
    out = np.zeros_like(t)
    for f in 0.07 * 26.0 ** rng.uniform(0.0, 1.0, 11):
        phase, slow = rng.uniform(0.0, 2 * np.pi, 2)
        height = min(0.55 * reach, 0.16 * speed / f)
        breath = 0.6 + 0.4 * np.cos(2 * np.pi * rng.uniform(0.02, 0.07) * t + slow)
        out += height * breath * np.sin(2 * np.pi * f * t + phase)
    return out


def _shuttle(rng: np.random.Generator, t: FloatArray, reach: float, speed: float) -> FloatArray:
    """There and back at speeds from a twentieth of the largest on; corners rounded."""
    knots, places, side = [0.0], [0.0], 1.0
    while knots[-1] < t[-1]:
        goal = side * reach * rng.uniform(0.35, 1.0)
        pace = speed * 14.0 ** rng.uniform(-1.0, 0.0) * 0.75
        knots.append(knots[-1] + max(abs(goal - places[-1]) / pace, 0.35))
        places.append(goal)
        side = -side
    return _rounded(np.interp(t, knots, places), t[1] - t[0], 0.12)


def _rounded(x: FloatArray, step: float, width: float) -> FloatArray:
    """Mean over `width` seconds, three times: corners of the third order."""
    m = max(1, round(width / step))
    kernel = np.ones(m) / m
    for _ in range(3):
        x = np.convolve(np.pad(x, (m // 2, m - 1 - m // 2), mode="edge"), kernel, "valid")
    return x


def _points(rng: np.random.Generator, t: FloatArray, reach: float, speed: float) -> FloatArray:
    """A cubic spline through random points at random times."""
    knots, places = [-1.0, 0.0], [0.0, 0.0]
    while knots[-1] < t[-1] + 1.0:
        goal = reach * rng.uniform(-1.0, 1.0)
        pause = rng.uniform(1.2, 3.4) * max(abs(goal - places[-1]), 0.15 * reach) / speed
        knots.append(knots[-1] + max(pause, 0.25))
        places.append(goal)
    x: FloatArray = CubicSpline(knots, places)(t)
    return x


Make = Callable[[np.random.Generator, FloatArray, float, float], FloatArray]
MOTIONS: dict[str, Make] = {"wander": _sines, "shuttle": _shuttle, "points": _points}


def push(robot: Robot, seed: int, step: float) -> FloatArray:
    """Force ON the tip in the base frame (n, 3) [N]: coloured by two poles, a few newtons' worth.

    Its size follows from the motors: a fifteenth of the weakest effort over the longest lever.
    """
    rng = np.random.default_rng([seed, 0x9054])
    n = round(robot.seconds / step)
    lever = 0.1 + sum(sum(x * x for x in link.along) ** 0.5 for link in robot.links)
    strong = max(link.effort if not link.slides else link.effort * lever for link in robot.links)
    knots = np.arange(-1.0, robot.seconds + 1.0, 0.22)
    x = CubicSpline(knots, rng.standard_normal((knots.size, 3)))(step * np.arange(n))
    return np.asarray(0.05 * strong / lever * x)
