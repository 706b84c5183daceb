"""How large an effect must be to leave a given excess over the noise floor.

Excess of a session = sqrt(max_j (rms_j^2 - rms0_j^2) / rms0_j^2), rms of the base model's
residual with the effect and rms0 without it, same motion and same noise.  The amplitude for an
excess is found on the plant by secant steps and kept in ``amplitudes.json``, which
``python -m hil.bench.diagnosis.runner`` makes anew.
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
FILE = "amplitudes.json"
LEVELS = (0.5, 1.5, 5.0)
#: Motion on which amplitudes are calibrated, and the largest excursion of a session [rad].
MOTION, SANE = 901, 2.0


def base_rms(recordings: list[Recording]) -> FloatArray:
    """Residual of the base model, fitted to these runs, by joint (d,) [N m]."""
    problem = Problem(recordings, recordings[0].robot)
    return fit(problem, base_model(recordings[0].robot)).rms


@lru_cache(maxsize=256)
def quiet_rms(robot: str, noise: str, motion: tuple[str, int], seed: int, force: bool) -> bytes:
    """`base_rms` without any hidden effect, as bytes (cached)."""
    return base_rms([session.record(robot, [], noise, motion, seed, force)]).tobytes()


def excess(
    recordings: list[Recording], robot: str, noise: str, motion: tuple[str, int], seed: int,
    force: bool,
) -> float:  # fmt: skip
    """Excess of `recordings` over the same sessions without hidden effects [floors]."""
    rms = base_rms(recordings)
    floor = np.frombuffer(quiet_rms(robot, noise, motion, seed, force))
    return float(np.sqrt(max(0.0, np.max((rms**2 - floor**2) / floor**2))))


def amplitude(effect: str, joint: int, robot: str, excitation: str, level: float) -> float:
    """Amplitude of an effect that leaves about `level` floors.

    Where no amplitude does (the base model imitates the effect), the largest that was tried.
    """
    key = name(effect, joint, robot, excitation)
    found = table()[key] if key in table() else calibrate(effect, joint, robot, excitation)
    return float(np.exp(np.interp(np.log(level), np.log(LEVELS), np.log(found))))


def name(effect: str, joint: int, robot: str, excitation: str) -> str:
    """Key of the table."""
    return f"{effect}/{joint + 1}/{robot}/{excitation}"


@cache
def table() -> dict[str, list[float]]:
    """Committed amplitudes by `name`, one for each of `LEVELS`."""
    path = resources.files(__package__) / FILE
    text = path.read_text(encoding="utf-8") if path.is_file() else "{}"
    found: dict[str, list[float]] = json.loads(text)
    return found


@cache
def calibrate(effect: str, joint: int, robot: str, excitation: str) -> list[float]:
    """Amplitudes for `LEVELS`; deterministic.

    Where the effect's largest amplitude, or the largest that the control loop stands, leaves
    less, that amplitude.
    """
    _, least, most = session.kinds()[effect]
    found: list[float] = []
    a = max(0.1, least)
    for level in LEVELS:
        a = min(2.0 * a, most) if found or not least else least
        a = _reach(lambda a: _excess_at(effect, joint, robot, excitation, a), level, a, least, most)
        found.append(float(f"{a:.3g}"))
    return found


def _reach(
    leaves: Callable[[float], float], level: float, start: float, least: float, most: float
) -> float:
    """Amplitude in `least`..`most` that leaves `level` floors: secant kept in a bracket."""
    low, high, a = 0.0, float("inf"), start
    for _ in range(7):
        e = leaves(a)
        if 0.85 < e / level < 1.18 or (e < level and a == most) or (e > level and a == least):
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
    need, motion, seed = session.kinds()[effect][0], (excitation, MOTION), MOTION
    force = need == "force"
    run = session.record(robot, [(effect, joint, a)], "coloured", motion, seed, force)
    if not np.isfinite(run.q).all() or np.abs(run.q).max() > SANE:
        return float("inf")
    runs = [run]
    if need == "runs":
        runs = [session.record(robot, [], "coloured", motion, seed, force), run]
    return excess(runs, robot, "coloured", motion, seed, force)
