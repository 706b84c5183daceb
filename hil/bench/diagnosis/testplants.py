"""The test plants: robots in MuJoCo behind the entry point ``mujoco``; nothing is tuned on them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from hil import registry
from hil.record.recording import Recording, RobotSource

GROUP, NAME = "hil.sim_sessions", "mujoco"
#: How to get them.
WANTED = "pip install 'hil-teleop[mujoco]'"
#: Share of rows that every fourth seed loses.
LOST = 0.006


def available() -> bool:
    """Whether MuJoCo and the plants are installed."""
    return find_spec("mujoco") is not None and NAME in registry.names(GROUP)


def simulator() -> Any:
    """Module of the plants."""
    return registry.load(GROUP, NAME)


@cache
def robots() -> dict[str, dict[str, Any]]:
    """Name -> ``joints``, ``units``, ``urdf``."""
    found: dict[str, dict[str, Any]] = simulator().robots()
    return found


def record(
    robot: str, rows: Sequence[tuple[str, int, float]], noise: str, motion: tuple[str, int],
    seed: int, force: bool = False,
) -> Recording:  # fmt: skip
    """One session of a test plant.

    Parameters
    ----------
    robot : str
        One of `robots`.
    rows : sequence of (effect, joint, amplitude)
        What is hidden; joints from 0.
    noise : str
        ``"white"``, ``"coloured"`` or ``"dac"``.
    motion : (str, int)
        ``"wander"``, ``"shuttle"`` or ``"points"``, and its seed.
    seed : int
        Of noise and of what happens at random.
    force : bool
        Whether a force acts at the tip and is measured.
    """
    described = robots()[robot]
    hidden = [{"effect": e, "joint": j, "amplitude": a} for e, j, a in rows]
    s = simulator().simulate(robot, motion, hidden, noise, seed, force, lost(seed))
    source = RobotSource("", described["urdf"]) if described["urdf"] else RobotSource("single-axis")
    return Recording(
        f"run{seed}", "arm", described["joints"], s["t"], s["q"], s["tau"],
        qd=s.get("qd"), wrench=s.get("wrench"), robot=source, metadata={"plant": "test"},
    )  # fmt: skip


def lost(seed: int) -> float:
    """Share of rows that a recording lacks; seeds come in pairs, the runs of a case."""
    return LOST if (seed // 2) % 4 == 3 else 0.0


def fitting(needs: str) -> list[str]:
    """Robots on which an effect with these needs can be seen."""
    least = {"arm": 2, "runs": 2, "urdf": 1, "force": 3}.get(needs, 0)
    return [
        name
        for name, r in sorted(robots().items())
        if not least or (r["urdf"] and len(r["joints"]) >= least)
    ]


def joints(robot: str) -> int:
    """Number of joints of a robot."""
    return int(np.size(robots()[robot]["joints"]))
