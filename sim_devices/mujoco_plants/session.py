"""One recording of one robot on request (entry point ``mujoco`` of ``hil.sim_sessions``)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.sim_devices.mujoco_plants import describe, motions, sensors
from hil.sim_devices.mujoco_plants.kinds import NAMES, kinds
from hil.sim_devices.mujoco_plants.plant import Plant
from hil.sim_devices.mujoco_plants.robots import ROBOTS, Robot

__all__ = ["MOTIONS", "NOISES", "kinds", "robots", "simulate"]

FloatArray = NDArray[np.float64]
MOTIONS = tuple(sorted(motions.MOTIONS))
NOISES = ("coloured", "dac", "white")
#: Largest relative error of the inertias in a URDF.
WRONG = 0.2
#: A motion further than this from its reference, in reaches, is lost.
LOST = 1.5
#: Steps of a coarse DAC in standard deviations of the other noises.
COARSE = 1.8


def robots() -> dict[str, dict[str, Any]]:
    """Name -> ``joints``, ``units``, and ``urdf`` (text, empty for a single axis)."""
    return {
        name: {
            "joints": r.joints,
            "units": tuple("m" if link.slides else "rad" for link in r.links),
            "urdf": urdf(name),
        }
        for name, r in ROBOTS.items()
    }


def urdf(name: str, exact: bool = False) -> str:
    """URDF of a robot, with wrong inertias unless `exact`; empty where it has none."""
    robot = _robot(name)
    if not robot.described:
        return ""
    wrong = 0.0 if exact else WRONG
    return describe.urdf(name, robot, wrong, sorted(ROBOTS).index(name))


def simulate(
    robot: str,
    motion: tuple[str, int],
    hidden: list[dict[str, Any]],
    noise: str = "white",
    seed: int = 0,
    force: bool = False,
    lost: float = 0.0,
) -> dict[str, FloatArray]:
    """Record one session.

    Parameters
    ----------
    robot : str
        One of `robots`.
    motion : (str, int)
        One of `MOTIONS` and its seed.
    hidden : list of dict
        ``effect`` (of `kinds`), ``joint`` (from 0) and ``amplitude`` of every hidden effect.
    noise : str
        One of `NOISES`.
    seed : int
        Of noise and of what happens at random.
    force : bool
        Whether a force acts on the tip and is measured.
    lost : float
        Share of rows that the recording lacks.

    Returns
    -------
    dict
        ``t`` (n,) [s], ``q``, ``tau`` (n, d) [rad, N m or m, N], ``qd`` (n, d) where the robot
        records speeds, ``wrench`` (n, 6) [N, N m] in base axes where a force acts.  Rows after a
        motion that was lost are NaN.
    """
    table = _robot(robot)
    for row in hidden:
        if row["effect"] not in NAMES:
            raise ConfigError(unknown("hidden effect", row["effect"], NAMES))
    tick = table.step
    reference = motions.reference(table, *motion, tick)
    push = motions.push(table, motion[1], tick) if force else None
    std = table.noise * np.array([link.effort for link in table.links])
    plant = Plant(table, hidden, seed)
    acting = sensors.disturbance(noise, len(reference), std, tick, seed)
    dac = COARSE * std if noise == "dac" else 0.02 * std
    every = round(1.0 / (tick * table.rate))
    rows = plant.run(reference, push, acting, dac, noise == "dac", every, LOST)
    found = _recorded(table, rows, hidden, noise, std, seed, plant)
    return _lose(found, lost, seed)


def _robot(name: str) -> Robot:
    if name not in ROBOTS:
        raise ConfigError(unknown("robot of the test plants", name, ROBOTS))
    return ROBOTS[name]


def _recorded(
    table: Robot,
    rows: dict[str, FloatArray],
    hidden: list[dict[str, Any]],
    noise: str,
    std: FloatArray,
    seed: int,
    plant: Plant,
) -> dict[str, FloatArray]:
    """What the recorder writes of the true signals."""
    n, rate = len(rows["t"]), table.rate
    rows["tau"] = rows["tau"] + sensors.recorded_noise(noise, n, std, seed)
    force = rows.get("force", np.zeros((n, 3)))
    if "force" in rows:
        rng = np.random.default_rng([seed, 0xF0C3])
        force = force + 0.01 * np.std(force) * rng.standard_normal(force.shape)
    for place, row in zip(plant.places, hidden, strict=True):
        if row["effect"] in sensors.RECORDED:
            sensors.RECORDED[row["effect"]](rows["q"], force, rate, place)
    if "force" in rows:
        rows["wrench"] = np.hstack([force, np.zeros((n, 3))])
        del rows["force"]
    if not table.speeds:
        del rows["qd"]
    return rows


def _lose(rows: dict[str, FloatArray], share: float, seed: int) -> dict[str, FloatArray]:
    """Rows that remain where `share` of them are lost, singly and a dozen at a time."""
    if share <= 0.0:
        return rows
    n, rng = len(rows["t"]), np.random.default_rng([seed, 0x1057])
    keep = rng.random(n) >= 0.5 * share
    for start in rng.integers(0, n - 12, max(1, round(0.5 * share * n / 12))):
        keep[start : start + 12] = False
    return {key: x[keep] for key, x in rows.items()}
