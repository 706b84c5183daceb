"""Manual excitation: what a hand, the motors, or both determine (thesis paper II).

Synthetic motion of a Premium 1.5 with friction and wrong motor constants; the torques follow
from the equation of motion, plus noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.estimate import manual
from hil.estimate.manual import FloatArray, Identified
from hil.models.phantom import Premium

#: Friction fc, fv of the joints, then kappa of the motors.
TRUE: FloatArray = np.array([
    *Premium.prior, 0.012, 0.001, 0.010, 0.0008, 0.009, 0.0006, 1.04, 0.97, 1.02,
])  # fmt: skip
NOISE = 1e-3


@dataclass(frozen=True)
class Row:
    """One excitation.

    Parameters
    ----------
    name : str
        What moves the arm.
    found : Identified
        Result.
    worst : float
        Largest relative error of the parameters that are said to be determined.
    """

    name: str
    found: Identified
    worst: float


def motion(seed: int, seconds: float = 16.0, sines: int = 12) -> tuple[FloatArray, ...]:
    """Hand-like motion at 250 Hz: t (n,), q, q', q'' (n, 3) of random sines up to 3 Hz."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 4e-3)
    w, phase = 2 * np.pi * rng.uniform(0.2, 3.0, (3, sines)), rng.uniform(0, 6.28, (3, sines))
    a = rng.uniform(0.02, 0.08, (3, sines))
    angle = w * t[:, None, None] + phase
    q = (a * np.sin(angle)).sum(-1) + np.array([0.0, 0.4, 0.3])
    return t, q, (a * w * np.cos(angle)).sum(-1), (-a * w**2 * np.sin(angle)).sum(-1)


def study(seed: int = 1) -> list[Row]:
    """Motors alone, hand alone, hand with a small motor torque."""
    t, q, qd, qdd = motion(seed)
    rng, zero = np.random.default_rng(seed), np.zeros_like(q)
    bare = (manual.regressor(q, qd, qdd, zero) @ TRUE).reshape(-1, 3)
    dither = 0.02 * np.sin(2 * np.pi * t[:, None] * np.array([1.1, 1.7, 0.6]))
    cases = {
        "motors, no hand": (bare / TRUE[14:], zero),
        "hand, motors off": (zero, bare),
        "hand and dither": (dither, bare - dither * TRUE[14:]),
    }
    rows = []
    for name, (u, tau_s) in cases.items():
        noise = NOISE * rng.normal(size=q.shape) if tau_s.any() else zero
        found = manual.identify(q, qd, qdd, u, tau_s + noise)
        known = [n for n in manual.NAMES if n not in found.undetermined]
        errors = [abs(found.values[n] / TRUE[manual.NAMES.index(n)] - 1) for n in known]
        rows.append(Row(name, found, max(errors, default=float("nan"))))
    return rows
