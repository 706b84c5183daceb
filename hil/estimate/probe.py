"""A made-up motion that effects are tried on: each quantity within its range; changes of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.models.motion import Motion
from hil.models.phantom import Premium

FloatArray = NDArray[np.float64]
#: Speed over which the sign of the velocity is resolved [rad/s].
SOFT = 0.02
#: Ends of the tables: positions without an identified range [rad], speeds [rad/s], torques
#: [N m] (straight on beyond), time [s].
ENDS = {"q": (-2.5, 4.0), "v": (-30.0, 30.0), "load": (-1.0, 1.0), "gravity": (-1.0, 1.0),
        "t": (0.0, 1800.0)}  # fmt: skip
ROWS = 400
OTHERS = {"qdd": "an acceleration", "temperature": "a motor temperature", "tau_ext": "a force"}
_FIELDS = {"q": "q", "v": "qd", "load": "load", "gravity": "static"}


def kind_of(name: str) -> str:
    """Row of `ENDS` and `KNOTS`."""
    return name[0] if name[0] in "qvt" else name.rstrip("123")


def changed(motion: Motion, name: str, values: FloatArray) -> Motion:
    """The motion with one quantity replaced; the torque before compensation is load and command."""
    if name == "t":
        return motion.with_(t=values)
    # a sum or difference is its first speed where the second one rests
    name = name[:2] if name[0] == "v" else name
    kind, at, changes = name[:-1], int(name[-1]) - 1, {}
    for key in (_FIELDS[kind], *(("tau",) if kind == "load" else ())):
        array = getattr(motion, key).copy()
        array[:, at] = values
        changes[key] = array
    return motion.with_(**changes)


def stirred(motion: Motion, rows: slice) -> Motion:
    """The motion with other values of everything but time in some rows."""
    changes = {}
    for key in (*_FIELDS.values(), "tau", *OTHERS):
        array = getattr(motion, key).copy()
        array[rows] = array[rows][::-1] * 0.7
        changes[key] = array
    return motion.with_(**changes)


def made_up(ends: FloatArray, n: int = ROWS, still: bool = False) -> Motion:
    """Waves of every quantity within its range, four seconds long; or all at rest in the middle."""
    rng = np.random.default_rng(1)

    def fill(low: Any, high: Any) -> FloatArray:
        phase = rng.uniform(0, 2 * np.pi, (4, 3)), rng.uniform(0.01, 0.6, (4, 3))
        waves = np.sin(phase[0] + phase[1] * np.arange(n)[:, None, None]).sum(axis=1) / 2
        middle, half = np.add(low, high) / 2, np.subtract(high, low) / 2
        return np.asarray(middle + (0.0 if still else 1.0) * half * np.clip(waves, -1, 1))

    load = fill(-0.5, 0.5)
    return Motion(
        t=1e-2 * np.arange(n, dtype=np.float64), q=fill(*ends.T), qd=fill(-1, 1),
        qdd=fill(-1, 1), tau=load, tau_ext=fill(-1, 1), load=load, static=fill(-0.3, 0.3),
        v0=np.full(3, SOFT), resolution=np.full(3, 1e-3), span=np.array(ends),
        contact=np.full((3, 2), np.nan), robot=Premium(()),
        temperature=fill(20, 40) if not still else np.zeros((n, 3)),
    )  # fmt: skip
