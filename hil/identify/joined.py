"""Several runs as one path of states, so that all of them are simulated at once.

A step of a simulation costs about the same for one window as for hundreds, whatever run they are
of: runs are joined where the terms of all models see the same in them but for the states.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from hil.models.motion import Motion

#: Fields that `Motion.at_states` replaces.
STATES = frozenset(
    "t q qd qdd load static tau tau_ext average drive friction".split()
)  # fmt: skip


class Joined(Motion):
    """Runs one after the other: states and efforts of all, everything else of the first."""

    runs: tuple[Motion, ...]


def joined(runs: Sequence[Motion]) -> Motion:
    """The run itself if there is but one, else all of them in one."""
    first = runs[0]
    if len(runs) == 1:
        return first
    out: Joined = object.__new__(Joined)
    names = ("t", "q", "qd", "qdd", "load", "static", "tau", "tau_ext")
    every = {name: np.concatenate([getattr(m, name) for m in runs]) for name in names}
    out.__dict__.update(first.__dict__, **every, runs=tuple(runs), _signs={})
    return out


def runs_of(motion: Motion) -> tuple[Motion, ...]:
    """The runs that a motion consists of."""
    return motion.runs if isinstance(motion, Joined) else (motion,)


def groups(motions: Sequence[Motion], seen: Collection[str]) -> list[list[int]]:
    """Numbers of the runs that may be joined, where `seen` fields of a motion are looked at."""
    out: list[list[int]] = []
    for k, m in enumerate(motions):
        own = next((g for g in out if alike(motions[g[0]], m, seen)), None)
        if own is None:
            out.append([k])
        else:
            own.append(k)
    return out


def alike(a: Motion, b: Motion, seen: Collection[str]) -> bool:
    """Whether two runs are the same in some fields, but for the states, and in their period."""
    return (
        a.dt == b.dt
        and a.robot is b.robot
        and all(_same(getattr(a, x), getattr(b, x)) for x in seen if x not in STATES)
    )


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return _equal(a, b)
    return a is b


def _equal(a: NDArray[np.generic], b: NDArray[np.generic]) -> bool:
    return a.shape == b.shape and a.tobytes() == b.tobytes()
