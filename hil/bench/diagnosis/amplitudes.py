"""How large an effect must be to leave a given excess over the noise floor.

Excess of a session = sqrt(max_j (rms_j^2 - rms0_j^2) / rms0_j^2), rms of the base model's
residual with the effect and rms0 without it, same motion and same noise.  The amplitude for an
excess is found on the plant by secant steps and kept in ``amplitudes.json``, those of the test
plants in ``test_amplitudes.json``; ``python -m hil.bench.diagnosis.runner`` makes them anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache, lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from hil.bench.diagnosis import session
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models.model import base_model
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
#: Plant -> file of its amplitudes, levels [floors], noise with which they are calibrated.
FILES = {"tuning": "amplitudes.json", "test": "test_amplitudes.json"}
EXCESS_LEVELS = {"tuning": (0.5, 1.5, 5.0), "test": (0.7, 1.5, 5.0)}
_NOISE = {"tuning": "coloured", "test": "white"}
#: Sessions tried for one level, and share of the level by which it may be missed.
_STEPS, _NEAR = {"tuning": 7, "test": 4}, {"tuning": 1.18, "test": 1.4}
#: First amplitude that is tried where an effect has no smallest one.
_START = {"tuning": 0.2, "test": 0.5}
#: Motion on which amplitudes are calibrated.
_MOTION = 901


def base_rms(recordings: list[Recording], offset: bool = False) -> FloatArray:
    """Residual of the base model, fitted to these runs, by joint (d,) [N m].

    Amplitudes are calibrated without an offset, which some effects would vanish in.
    """
    problem = Problem(recordings, recordings[0].robot)
    model = base_model(recordings[0].robot)
    return fit(problem, model if offset else model - "torque-offset").rms


@lru_cache(maxsize=256)
def _quiet_rms(
    robot: str, noise: str, motion: tuple[str, int], seed: int, force: bool, offset: bool = False
) -> bytes:
    """`base_rms` without any hidden effect, as bytes (cached)."""
    return base_rms([session.record_case(robot, [], noise, motion, seed, force)], offset).tobytes()


def excess(
    recordings: list[Recording],
    robot: str,
    noise: str,
    motion: tuple[str, int],
    seed: int,
    force: bool,
    offset: bool = True,
) -> float:
    """Excess of `recordings` over the same sessions without hidden effects [floors].

    `offset`: whether the model that leaves it has an offset a joint.
    """
    rms = base_rms(recordings, offset)
    floor = np.frombuffer(_quiet_rms(robot, noise, motion, seed, force, offset))
    return float(np.sqrt(max(0.0, np.max((rms**2 - floor**2) / floor**2))))


def amplitude(effect: str, joint: int, robot: str, excitation: str, level: float) -> float:
    """Amplitude of an effect that leaves about `level` floors.

    Where no amplitude does (the base model imitates the effect), the largest that was tried.
    """
    key, plant = name(effect, joint, robot, excitation), session.plant_of_robot(robot)
    known = amplitude_table(plant)
    found = known[key] if key in known else calibrate(effect, joint, robot, excitation)
    return float(np.exp(np.interp(np.log(level), np.log(EXCESS_LEVELS[plant]), np.log(found))))


def name(effect: str, joint: int, robot: str, excitation: str) -> str:
    """Key of the table."""
    return f"{effect}/{joint + 1}/{robot}/{excitation}"


@cache
def amplitude_table(plant: str) -> dict[str, list[float]]:
    """Committed amplitudes by `name`, one for each of the plant's `EXCESS_LEVELS`."""
    path = resources.files(__package__) / FILES[plant]
    text = path.read_text(encoding="utf-8") if path.is_file() else "{}"
    found: dict[str, list[float]] = json.loads(text)
    return found


@cache
def calibrate(effect: str, joint: int, robot: str, excitation: str) -> list[float]:
    """Amplitudes for `EXCESS_LEVELS`; deterministic.

    Where the effect's largest amplitude, or the largest that the control loop stands, leaves
    less, that amplitude.
    """
    plant = session.plant_of_robot(robot)
    _, least, most = session.kinds_of_plant(plant)[effect]
    found: list[float] = []
    a = least or _START[plant]
    for level in EXCESS_LEVELS[plant]:
        a = _reach(
            lambda a: _excess_at(effect, joint, robot, excitation, a),
            level,
            a,
            (least, most),
            _STEPS[plant],
            _NEAR[plant],
        )
        found.append(float(f"{a:.3g}"))
        a = min(2.0 * a, most)
    return found


def _reach(
    leaves: Callable[[float], float],
    level: float,
    start: float,
    between: tuple[float, float],
    steps: int,
    near: float,
) -> float:
    """Amplitude `between` that leaves `level` floors: secant kept in a bracket."""
    (least, most), low, high, a = between, 0.0, float("inf"), start
    for _ in range(steps):
        e = leaves(a)
        if 1.0 / near < e / level < near or (e < level and a == most) or (e > level and a == least):
            return a
        low, high = (a, high) if e < level else (low, a)
        known = np.isfinite(e) and e > 0.02
        guess = (
            a * float(np.clip(level / e, 0.2, 8.0)) if known else a * (5.0 if e < level else 0.5)
        )
        if not low < guess < high:
            guess = float(np.sqrt(low * high)) if low else high / 3.0
        a = min(max(guess, least), most)
    return low or a


def _excess_at(effect: str, joint: int, robot: str, excitation: str, a: float) -> float:
    """Excess that amplitude `a` leaves; infinite where the loop does not stand it."""
    plant, motion, seed = session.plant_of_robot(robot), (excitation, _MOTION), _MOTION
    need, noise = session.kinds_of_plant(plant)[effect][0], _NOISE[plant]
    force = need == "force"
    run = session.record_case(robot, [(effect, joint, a)], noise, motion, seed, force)
    if not session.sane(run):
        return float("inf")
    runs = [run]
    if need == "runs":
        runs = [session.record_case(robot, [], noise, motion, seed, force), run]
    return excess(runs, robot, noise, motion, seed, force)
