"""Kernels of friction compensation from tables, and of friction with a state (presliding).

A term is a function of one or two of the quantities of `VARIABLES`, bilinear between knots.  What
any effect of the library gives such tables is `hil.estimate.compensation_tables`.
"""

from __future__ import annotations

from math import asinh, exp, floor, sinh
from typing import Any

import numba as nb
import numpy as np

#: What a term may depend on: positions [rad], speeds [rad/s], torques before compensation [N m]
#: and their part by gravity, of the three joints; time since the start [s]; sums and differences
#: of two speeds.
VARIABLES = (
    *(f"{what}{i}" for what in ("q", "v", "load", "gravity") for i in (1, 2, 3)),
    "t",
    "v1+v2",
    "v1+v3",
    "v2+v3",
    "v1-v2",
    "v1-v3",
    "v2-v3",
)
#: Knots over speed and time lie evenly in asinh(x / BEND) [rad/s, s]: dense about zero.
BEND = 0.005
#: Memory of one arm: last positions (3,), states of three elements per joint (3, 3).
MEMORY = 12

_AXIS = [("of", np.int64), ("start", np.float64), ("step", np.float64), ("count", np.int64)]
AXIS = np.dtype(_AXIS)
#: Joint from 0, the two axes, and where the values (count x, count y) start.
TERM = np.dtype([("joint", np.int64), ("x", AXIS), ("y", AXIS), ("at", np.int64)])
#: Joint, displacement [rad], 1 for Dahl and 0 for Maxwell slip, forces of the elements [N m].
SLIP = np.dtype(
    [
        ("joint", np.int64),
        ("scale", np.float64),
        ("dahl", np.int64),
        ("force", np.float64, (3,)),
    ]
)


@nb.njit(cache=True, nogil=True)
def locate(axis: Any, z: Any) -> Any:
    """Knot below and share of the way to the next.

    Held at the ends of positions and time, straight on beyond those of speeds and torques.  Speeds
    are placed between their knots BEND sinh(u_i) themselves: what is linear in speed stays so.
    """
    if axis.count < 2:
        return 0, 0.0
    value = z[axis.of]
    held, bent = axis.of < 3 or axis.of == 12, 3 <= axis.of < 6 or axis.of >= 12
    u = ((asinh(value / BEND) if bent else value) - axis.start) / axis.step
    i = min(max(floor(u), 0), axis.count - 2)
    if bent:
        low = BEND * sinh(axis.start + i * axis.step)
        high = BEND * sinh(axis.start + (i + 1) * axis.step)
        share = (value - low) / (high - low)
    else:
        share = u - i
    return i, min(max(share, 0.0), 1.0) if held else share


@nb.njit(cache=True, nogil=True)
def look(term: Any, values: Any, z: Any) -> float:
    """Torque [N m] of one term at the quantities `z` (19,)."""
    i, a = locate(term.x, z)
    j, b = locate(term.y, z)
    right = term.y.count if term.x.count > 1 else 0
    up = 1 if term.y.count > 1 else 0
    at = term.at + i * term.y.count + j
    low = values[at] + b * (values[at + up] - values[at])
    high = values[at + right] + b * (values[at + right + up] - values[at + right])
    return float(low + a * (high - low))


@nb.njit(cache=True, nogil=True)
def slide(slip: Any, started: bool, z: Any, past: Any, now: Any) -> float:
    """Torque [N m] of presliding friction; `past`, `now` (MEMORY,) hold the elements' states.

    Elements of displacement s, 3 s and 9 s:  z <- clip(z + dq / s, -1, 1) (Maxwell slip), or
    z <- sgn + (z - sgn) exp(-|dq| / s) (Dahl), exact for motion that is straight within a tick.
    """
    j, total, scale = slip.joint, 0.0, slip.scale
    step = z[j] - past[j] if started else 0.0
    for e in range(3):
        old, at = past[3 + 3 * j + e], 3 + 3 * j + e
        if slip.dahl:
            goal = 1.0 if step > 0.0 else -1.0
            now[at] = goal + (old - goal) * exp(-abs(step) / scale)
        else:
            now[at] = min(max(old + step / scale, -1.0), 1.0)
        total += slip.force[e] * now[at]
        scale *= 3.0
    return float(total)


@nb.njit(cache=True, nogil=True)
def friction(
    started: bool, z: Any, terms: Any, slips: Any, values: Any, past: Any, now: Any, out: Any
) -> None:
    """What the motors must supply for all terms of one arm, added to `out` (3,) [N m].

    Parameters
    ----------
    z : ndarray (19,)
        Quantities of `VARIABLES`; sums and differences are written here.
    past, now : ndarray (MEMORY,)
        Memory before (read) and after (written).
    """
    z[13], z[14], z[15] = z[3] + z[4], z[3] + z[5], z[4] + z[5]
    z[16], z[17], z[18] = z[3] - z[4], z[3] - z[5], z[4] - z[5]
    for k in range(terms.size):
        out[terms[k].joint] += look(terms[k], values, z)
    for i in range(MEMORY):
        now[i] = past[i]
    for k in range(slips.size):
        out[slips[k].joint] += slide(slips[k], started, z, past, now)
    for i in range(3):
        now[i] = z[i]
