"""Kernels of the Extended Lawrence Architecture on one axis: filters and the two control laws.

    f_cm = c6 f_m - c2 f_s - c4 v_s - c8 v_m,   f_cs = c1 v_m + c3 f_m - c5 f_s - c7 v_s

with c = k/s + b + a s on motion (thesis sections 3.2 and 3.5).  f_m is ON the master, f_s is BY
the slave on the environment.
"""

from __future__ import annotations

from typing import Any

import numba as nb

#: Signals of one robot on one axis: position [m], velocity [m/s], acceleration [m/s^2], force [N].
SIGNALS = 4
#: Memory of the filters on one axis: velocity, last raw velocity, acceleration, force, started.
FILTER_MEMORY = 5
#: Gains of one axis: k, b, a of c1, c4, c7, c8, then c2, c3, c5, c6.
GAINS = 16


@nb.njit(cache=True, nogil=True)
def filtered_axis(
    x: float, v: float, f: float, shares: Any, period: float, past: Any, now: Any, out: Any
) -> None:
    """Filter one robot's measurements on one axis.

    Parameters
    ----------
    x, v, f : float
        Position from the start [m], velocity [m/s], force [N].
    shares : ndarray (3,)
        1 - exp(-2 pi f T) of the velocity, acceleration and force filter; 1 = no filter.
    period : float
        T [s].
    past, now : ndarray (MEMORY,)
        Memory before (read) and after (written).
    out : ndarray (SIGNALS,)
        Written: position, velocity, acceleration, force.
    """
    first = past[4] == 0.0
    last = v if first else past[1]
    start = v if first else past[0]
    force = f if first else past[3]
    # v_f <- v_f + share (v - v_f);  a_f <- a_f + share ((v - v_last)/T - a_f)
    now[0] = start + shares[0] * (v - start)
    now[1] = v
    now[2] = past[2] + shares[1] * ((v - last) / period - past[2])
    now[3] = force + shares[2] * (f - force)
    now[4] = 1.0
    out[0], out[1], out[2], out[3] = x, now[0], now[2], now[3]


@nb.njit(cache=True, nogil=True)
def _motion(g: Any, at: int, w: Any) -> float:
    """C v = k x + b v + a v' of the term whose gains start at `at`."""
    return float(g[at] * w[0] + g[at + 1] * w[1] + g[at + 2] * w[2])


@nb.njit(cache=True, nogil=True)
def master(g: Any, m: Any, s: Any) -> float:
    """f_cm [N] from the master's own signals m and what arrived of the slave's, s."""
    return float(g[15] * m[3] - g[12] * s[3] - _motion(g, 3, s) - _motion(g, 9, m))


@nb.njit(cache=True, nogil=True)
def slave(g: Any, m: Any, s: Any) -> float:
    """f_cs [N] from what arrived of the master's signals, m, and the slave's own, s."""
    return float(_motion(g, 0, m) + g[13] * m[3] - g[14] * s[3] - _motion(g, 6, s))


@nb.njit(cache=True, nogil=True)
def believe(g: Any, m: Any, s: Any, pm: float, ps: float) -> Any:
    """Forces f_m, f_s [N] that the motion betrays: Q f = -R(v), solved for both at once.

    (1 + c6) f_m - c2 f_s = p_m + c4 v_s + c8 v_m,   c3 f_m - (1 + c5) f_s = p_s - c1 v_m + c7 v_s

    Parameters
    ----------
    pm, ps : float
        What moves the robots, z_cm v_m and z_cs v_s, from their own nonlinear models [N].
    """
    one = pm + _motion(g, 3, s) + _motion(g, 9, m)
    two = ps - _motion(g, 0, m) + _motion(g, 6, s)
    a, d = 1.0 + g[15], 1.0 + g[14]
    over = 1.0 / (a * d - g[12] * g[13])
    return (d * one - g[12] * two) * over, (g[13] * one - a * two) * over
