"""A motion as a table for a rig that is not run by this package: t, q, qd, qdd, SI, a header line.

It begins and ends at rest:  r(t) = q0 + s(t) (q(t) - q0),  s from 0 to 1 by

    s = 10 u^3 - 15 u^4 + 6 u^5,

u the share of the lead-in that has passed, and back again behind the last period; between them the
motion is played as it was planned.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.excite.trajectory import Trajectory, sample

FloatArray = NDArray[np.float64]
#: Lengths of the lead-in that are tried [s].
LEADS = (2.0, 4.0, 8.0, 16.0, 32.0)


@dataclass(frozen=True)
class Played:
    """Samples of a motion from rest to rest.

    Parameters
    ----------
    t : ndarray (n,)
        From 0 [s].
    q, qd, qdd : ndarray (n, d)
        Position, speed, acceleration [rad or m, per s, per s^2].
    lead : float
        Length of the lead-in, and of the way back to rest [s].
    rounds : int
        Whole periods between them.
    """

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    lead: float
    rounds: int


def played(x: Trajectory, seconds: float, rate: float, speed: FloatArray) -> Played:
    """As many whole periods as `seconds` hold, one at least, from rest to rest.

    Parameters
    ----------
    x : Trajectory
        The motion.
    seconds : float
        Wanted length without lead-in [s].
    rate : float
        Rows a second [Hz].
    speed : ndarray (d,)
        Limits that the lead-in keeps to as well [rad/s or m/s].
    """
    rounds = max(1, int(seconds / x.period + 1e-9))
    for lead in LEADS:
        out = _from_rest(x, rounds, lead, rate)
        if np.all(np.abs(out.qd) <= speed):
            break
    return out


def _from_rest(x: Trajectory, rounds: int, lead: float, rate: float) -> Played:
    whole = rounds * x.period + 2 * lead
    t = np.arange(int(whole * rate + 1e-6) + 1) / rate
    q, qd, qdd = sample(x, t - lead)
    at = sample(x, np.zeros(1))[0]
    up, down = np.clip(t / lead, 0.0, 1.0), np.clip((whole - t) / lead, 0.0, 1.0)
    u, sign = np.minimum(up, down)[:, None], np.where(up < down, 1.0, -1.0)[:, None] / lead
    s = u**3 * (10 - 15 * u + 6 * u**2)
    ds = 30 * u**2 * (1 - u) ** 2 * sign
    dds = 60 * u * (1 - u) * (1 - 2 * u) / lead**2
    # r = q0 + s (q - q0) and its derivatives
    return Played(
        t, at + s * (q - at), ds * (q - at) + s * qd, dds * (q - at) + 2 * ds * qd + s * qdd,
        lead, rounds,
    )  # fmt: skip


def header(d: int) -> list[str]:
    """Names of the columns for d joints."""
    return ["t", *(f"{kind}{j + 1}" for kind in ("q", "qd", "qdd") for j in range(d))]


def write(p: Played, path: str | Path) -> None:
    """Write the table."""
    rows = np.column_stack([p.t, p.q, p.qd, p.qdd])
    names = ",".join(header(p.q.shape[1]))
    with open(path, "w", encoding="utf-8", newline="") as file:
        np.savetxt(file, rows, fmt="%.9g", delimiter=",", header=names, comments="")


def is_table(path: Path) -> bool:
    """Whether a file is such a table, or empty: never a recording, which has efforts."""
    try:
        with path.open(encoding="utf-8") as file:
            names = file.readline().strip().split(",")
    except (OSError, ValueError):
        return False
    return names == [""] or names == header((len(names) - 1) // 3)
