"""Recordings of a case, from the simulators behind the entry points ``phantom`` and ``mujoco``.

The plants behind ``phantom`` are those that the diagnosis was tuned on; those behind ``mujoco``,
the test plants, share neither code nor robots, motions and laws with them, and nothing is tuned on
them.  The reference motions of an identification session and the force at the tip are made here.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil import registry
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]
MOTION_KINDS = ("repeated", "strokes")
_SECONDS, _TICK = 25.0, 1e-3
#: Middle and largest excursion [rad], largest speed [rad/s].
_CENTER, _REACH, _SPEED = np.array([0.0, 0.4, 0.3]), np.array([0.6, 0.45, 0.45]), 2.2
_PERIOD, _HARMONICS = 10.0, 25


def reference_motion(kind: str, seed: int) -> FloatArray:
    """Place, speed and acceleration of three joints, (n, 3, 3), swelling within a second.

    Parameters
    ----------
    kind : str
        ``"repeated"``: a Fourier motion of 10 s, 2.5 times; ``"strokes"``: strokes of minimum
        jerk between random poses with an inharmonic multisine on top, never the same again.
    seed : int
        Chooses the motion.
    """
    rng = np.random.default_rng([seed, MOTION_KINDS.index(kind), 0xE8C])
    n = round(_SECONDS / _TICK)
    t: FloatArray = _TICK * np.arange(n, dtype=np.float64)
    make = _fourier if kind == "repeated" else _strokes
    parts = np.stack([make(rng, t) for _ in range(3)], 1)
    scale = np.minimum(_REACH / np.abs(parts[0]).max(1), _SPEED / np.abs(parts[1]).max(1))
    place, speed, push = parts * scale[None, :, None]
    # r = center + ramp * motion
    ramp = np.clip(t, 0.0, 1.0)
    rate = np.where(ramp < 1.0, np.pi / 2 * np.sin(np.pi * ramp), 0.0)
    ramp = (1.0 - np.cos(np.pi * ramp)) / 2
    place, speed, push = place, ramp * speed + rate * place, ramp * push
    return np.ascontiguousarray(
        np.stack([_CENTER[:, None] + ramp * place, speed, push], -1).transpose(1, 0, 2)
    )


def _fourier(rng: np.random.Generator, t: FloatArray) -> FloatArray:
    """Slow harmonics, and fast ones that swell and fade within one period, (3, n)."""
    w: FloatArray = 2 * np.pi / _PERIOD * np.arange(1.0, _HARMONICS + 1)[:, None]
    phase = rng.uniform(0.0, 2 * np.pi, (_HARMONICS, 1))
    slow = _sines(t, w[:3], phase[:3], 1.0 / w[:3])
    fast = _sines(t, w[3:], phase[3:], 1.6 / w[3:])
    first = float(rng.uniform(0.0, 2 * np.pi))
    return slow + _swell(t, fast, 2 * np.pi / _PERIOD, first)


def _sines(t: FloatArray, w: FloatArray, phase: FloatArray, size: FloatArray) -> FloatArray:
    """Sum of size sin(w t + phase) and its two derivatives, (3, n)."""
    angle = w * t + phase
    s, c = np.sin(angle), np.cos(angle)
    return np.stack([(size * s).sum(0), (size * w * c).sum(0), -(size * w**2 * s).sum(0)])


def _swell(t: FloatArray, x: FloatArray, w: float, phase: float) -> FloatArray:
    """(1 - cos(w t + phase)) / 2 times x, with both derivatives, (3, n)."""
    e = (1.0 - np.cos(w * t + phase)) / 2
    e1, e2 = w * np.sin(w * t + phase) / 2, w * w * np.cos(w * t + phase) / 2
    return np.stack([e * x[0], e1 * x[0] + e * x[1], e2 * x[0] + 2 * e1 * x[1] + e * x[2]])


def _strokes(rng: np.random.Generator, t: FloatArray) -> FloatArray:
    """Minimum-jerk strokes of 0.3 to 2.5 s with short rests, and twelve sines on top, (3, n)."""
    out, now, at = np.zeros((3, t.size)), 0.0, 0.0
    while now < t[-1]:
        goal = rng.uniform(-1.0, 1.0)
        length = max(0.3 * (2.5 / 0.3) ** rng.uniform(), 0.5 * abs(goal - at))
        rest = rng.uniform(0.0, 0.3)
        u = np.clip((t - now) / length, 0.0, 1.0)
        inside = (t >= now) & (t < now + length + rest)
        step = goal - at
        # at + step (10 u^3 - 15 u^4 + 6 u^5)
        out[0, inside] = (at + step * (10 * u**3 - 15 * u**4 + 6 * u**5))[inside]
        out[1, inside] = (step / length * 30 * u**2 * (1 - u) ** 2)[inside]
        out[2, inside] = (step / length**2 * 60 * u * (1 - u) * (1 - 2 * u))[inside]
        now, at = now + length + rest, goal
    w = 2 * np.pi * 0.15 * (2.3 / 0.15) ** rng.uniform(0.0, 1.0, (12, 1))
    phase = rng.uniform(0.0, 2 * np.pi, (12, 1))
    return out + _sines(t, w, phase, 0.1 / (1.0 + w / 3.0))


def push_forces(seed: int) -> FloatArray:
    """Force ON the tip in the base frame (n, 3) [N]: eight sines of 0.1 to 2.5 Hz, 0.3 N rms."""
    rng = np.random.default_rng([seed, 0xF0])
    t: FloatArray = _TICK * np.arange(round(_SECONDS / _TICK), dtype=np.float64)
    out = np.zeros((t.size, 3))
    for k in range(3):
        w = 2 * np.pi * 0.1 * 25.0 ** rng.uniform(0.0, 1.0, (8, 1))
        out[:, k] = _sines(t, w, rng.uniform(0.0, 2 * np.pi, (8, 1)), np.ones((8, 1)))[0]
    return np.asarray(0.3 * out / np.sqrt(np.mean(out**2, 0)) * np.minimum(1.0, t / 2)[:, None])


_GROUP, _MUJOCO = "hil.sim_sessions", "mujoco"
#: How to get them.
MUJOCO_EXTRA = "pip install 'hil-teleop[mujoco]'"
#: Share of rows that every fourth seed loses.
_LOST_SHARE = 0.006


def mujoco_available() -> bool:
    """Whether MuJoCo and the plants are installed."""
    return find_spec("mujoco") is not None and _MUJOCO in registry.names(_GROUP)


def _mujoco_simulator() -> Any:
    """Module of the plants."""
    return registry.load(_GROUP, _MUJOCO)


@cache
def mujoco_robots() -> dict[str, dict[str, Any]]:
    """Name -> ``joint_count``, ``units``, ``urdf``."""
    found: dict[str, dict[str, Any]] = _mujoco_simulator().robots()
    return found


def _record_mujoco(
    robot: str,
    rows: Sequence[tuple[str, int, float]],
    noise: str,
    motion: tuple[str, int],
    seed: int,
    force: bool = False,
) -> Recording:
    """One session of a test plant.

    Parameters
    ----------
    robot : str
        One of `mujoco_robots`.
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
    described = mujoco_robots()[robot]
    hidden = [{"effect": e, "joint": j, "amplitude": a} for e, j, a in rows]
    s = _mujoco_simulator().simulate(robot, motion, hidden, noise, seed, force, lost_share(seed))
    source = RobotSource("", described["urdf"]) if described["urdf"] else RobotSource("single-axis")
    return Recording(
        f"run{seed}",
        "arm",
        described["joints"],
        s["t"],
        s["q"],
        s["tau"],
        qd=s.get("qd"),
        wrench=s.get("wrench"),
        robot=source,
        metadata={"plant": "test"},
    )


def lost_share(seed: int) -> float:
    """Share of rows that a recording lacks; seeds come in pairs, the runs of a case."""
    return _LOST_SHARE if (seed // 2) % 4 == 3 else 0.0


def robots_showing(needs: str) -> list[str]:
    """Robots on which an effect with these needs can be seen."""
    least = {"arm": 2, "runs": 2, "urdf": 1, "force": 3, "chain": 3}.get(needs, 0)
    return [
        name
        for name, r in sorted(mujoco_robots().items())
        if not least or (r["urdf"] and len(r["joints"]) >= least)
    ]


def joint_count(robot: str) -> int:
    """Number of joints of a robot."""
    return int(np.size(mujoco_robots()[robot]["joints"]))


_JOINTS = ("joint1", "joint2", "joint3")
#: An effect with its joint and its amplitude (in the simulator's units).
HiddenRow = tuple[str, int, float]
#: Robots of the tuning plants, and the largest excursion of a session there [rad].
_TUNING, _SANE = ("arm", "axis"), 2.0


def plant_of_robot(robot: str) -> str:
    """``"tuning"`` or ``"test"``: whose robot it is."""
    return "tuning" if robot in _TUNING else "test"


def sane(run: Recording) -> bool:
    """Whether the control loop stood what is hidden."""
    # a test plant ends a motion that is lost with NaN
    most = _SANE if run.metadata.get("plant") != "test" else float("inf")
    return bool(np.isfinite(run.q).all() and np.abs(run.q).max() <= most)


def _tuning_simulator() -> Any:
    return registry.load("hil.sim_sessions", "phantom")


@cache
def kinds_of_plant(plant: str = "tuning") -> dict[str, tuple[str, float, float]]:
    """What can be hidden -> what it needs, its smallest and its largest amplitude.

    Needs: ``"force"`` (measured), ``"arm"`` (more than one joint), ``"runs"`` (a run with and
    one without), ``"urdf"`` (a described robot; test plants), ``"chain"`` (one of three joints or
    more; test plants), or nothing.
    """
    simulator = _tuning_simulator() if plant == "tuning" else _mujoco_simulator()
    found: dict[str, tuple[str, float, float]] = simulator.kinds()
    return found


@lru_cache(maxsize=64)
def _motion(kind: str, seed: int, force: bool) -> tuple[FloatArray, FloatArray | None]:
    return reference_motion(kind, seed), push_forces(seed) if force else None


def record_case(
    robot: str,
    rows: Sequence[HiddenRow],
    noise: str,
    motion: tuple[str, int],
    seed: int,
    force: bool = False,
) -> Recording:
    """One session, of 25 s where the robot is one of `_TUNING`.

    Parameters
    ----------
    robot : str
        ``"arm"``, ``"axis"``, or one of `mujoco_robots`.
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
    if plant_of_robot(robot) == "test":
        return _record_mujoco(robot, rows, noise, motion, seed, force)
    positions, force_at_tip = _motion(*motion, force)
    hidden = [{"effect": e, "joint": j, "amplitude": a} for e, j, a in rows]
    s = _tuning_simulator().simulate(positions, force_at_tip, hidden, noise, seed, robot == "axis")
    d = 1 if robot == "axis" else 3
    return Recording(
        f"run{seed}",
        "arm",
        _JOINTS[:d],
        s["t"],
        s["q"][:, :d],
        s["tau"][:, :d],
        qd=s["qd"][:, :d],
        wrench=s.get("wrench"),
        robot=RobotSource("single-axis" if robot == "axis" else "phantom-premium-1.5"),
    )
