"""Recordings of a case, from the simulators behind the entry points ``phantom`` and ``mujoco``.

The plants behind ``phantom`` are those that the diagnosis was tuned on; those behind ``mujoco``
(`testplants`) share neither code nor robots, motions and laws with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil import registry
from hil.bench.diagnosis import excitation, testplants
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]
JOINTS = ("joint1", "joint2", "joint3")
#: An effect with its joint and its amplitude (in the simulator's units).
Row = tuple[str, int, float]
#: Robots of the tuning plants, and the largest excursion of a session there [rad].
TUNING, SANE = ("arm", "axis"), 2.0


def plant(robot: str) -> str:
    """``"tuning"`` or ``"test"``: whose robot it is."""
    return "tuning" if robot in TUNING else "test"


def sane(run: Recording) -> bool:
    """Whether the control loop stood what is hidden."""
    # a test plant ends a motion that is lost with NaN
    most = SANE if run.metadata.get("plant") != "test" else float("inf")
    return bool(np.isfinite(run.q).all() and np.abs(run.q).max() <= most)


def _simulator() -> Any:
    return registry.load("hil.sim_sessions", "phantom")


@cache
def kinds(plant: str = "tuning") -> dict[str, tuple[str, float, float]]:
    """What can be hidden -> what it needs, its smallest and its largest amplitude.

    Needs: ``"force"`` (measured), ``"arm"`` (more than one joint), ``"runs"`` (a run with and
    one without), ``"urdf"`` (a described robot; test plants), or nothing.
    """
    simulator = _simulator() if plant == "tuning" else testplants.simulator()
    found: dict[str, tuple[str, float, float]] = simulator.kinds()
    return found


@lru_cache(maxsize=64)
def _motion(kind: str, seed: int, force: bool) -> tuple[FloatArray, FloatArray | None]:
    return excitation.reference(kind, seed), excitation.push(seed) if force else None


def record(
    robot: str, rows: Sequence[Row], noise: str, motion: tuple[str, int], seed: int,
    force: bool = False,
) -> Recording:  # fmt: skip
    """One session, of 25 s where the robot is one of `TUNING`.

    Parameters
    ----------
    robot : str
        ``"arm"``, ``"axis"``, or one of `testplants.robots`.
    rows : sequence of (effect, joint, amplitude)
        What is hidden.
    noise : str
        ``"white"``, ``"coloured"``, or for test plants ``"dac"``.
    motion : (str, int)
        Kind of the excitation and its seed.
    seed : int
        Of the noise.
    force : bool
        Whether a force acts at the tip and is measured.
    """
    if plant(robot) == "test":
        return testplants.record(robot, rows, noise, motion, seed, force)
    reference, push = _motion(*motion, force)
    hidden = [{"effect": e, "joint": j, "amplitude": a} for e, j, a in rows]
    s = _simulator().simulate(reference, push, hidden, noise, seed, robot == "axis")
    d = 1 if robot == "axis" else 3
    return Recording(
        f"run{seed}", "arm", JOINTS[:d], s["t"], s["q"][:, :d], s["tau"][:, :d],
        qd=s["qd"][:, :d], wrench=s.get("wrench"),
        robot=RobotSource("single-axis" if robot == "axis" else "phantom-premium-1.5"),
    )  # fmt: skip
