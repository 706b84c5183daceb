"""Kernels of wavelet friction networks that learn in the loop, their structure too.

    tau_f_j = fc_j tanh(v_j / v0) + fv_j v_j / S_j + sum_i c_ij psi_i(v),
    psi_(m,k)(v) = 2^(m d/2) psi(2^m S^-1 v - k),  d = 3,

one network a joint over all joint speeds, on one structure for the three (thesis section 3.1.2;
`hil.experiments.friction_network` is the same off line).  What is learnt from is seen through a
low-pass, so the regressors pass the same one: the weights do not notice.
"""

from __future__ import annotations

from math import exp, pi, sqrt, tanh
from typing import Any

import numba as nb

#: Numbers a node: level (NONE where the place is free), cell (3), mean psi^2, age, filtered psi,
#: weights (3).
NODE, NONE = 10, -100.0
#: Numbers before the nodes: weights fc, fv of the joints (6), their filtered columns (6), what
#: was removed, counter.
HEAD_NUMBERS = 14
_UNIT = 1.0 / sqrt(pi**1.5 * 15.0 / 4.0)


def memory_size(budget: int) -> int:
    """Memory of networks with at most so many nodes."""
    return HEAD_NUMBERS + NODE * budget


@nb.njit(cache=True, nogil=True)
def hat(x0: float, x1: float, x2: float) -> float:
    """Radial Mexican hat of unit energy in three dimensions."""
    square = x0 * x0 + x1 * x1 + x2 * x2
    return (3.0 - square) * exp(-square / 2) * _UNIT if square < 40.0 else 0.0


@nb.njit(cache=True, nogil=True)
def clear(past: Any) -> None:
    """Forget everything."""
    past[:] = 0.0
    for at in range(HEAD_NUMBERS, past.size, NODE):
        past[at] = NONE


@nb.njit(cache=True, nogil=True)
def predict_network(v: Any, c: Any, m: Any, psi: Any, now: Any, seen: Any) -> None:
    """Friction `now` (3,) [N m] at speeds v (3,), and `seen` (3,): through the low-pass.

    Advances the filtered columns in the memory m; psi (6 + nodes,) holds the columns.
    """
    for j in range(3):
        psi[2 * j], psi[2 * j + 1] = (
            c.backbone * tanh(v[j] / c.soft),
            c.backbone * v[j] / c.scale[j],
        )
        now[j] = m[2 * j] * psi[2 * j] + m[2 * j + 1] * psi[2 * j + 1]
        seen[j] = 0.0
        for e in (2 * j, 2 * j + 1):
            m[6 + e] += c.share * (psi[e] - m[6 + e])
            seen[j] += m[e] * m[6 + e]
    for i in range((m.size - HEAD_NUMBERS) // NODE):
        at = HEAD_NUMBERS + NODE * i
        if m[at] == NONE:
            continue
        zoom = 2.0 ** m[at]
        value = (
            zoom
            * sqrt(zoom)
            * hat(
                zoom * v[0] / c.scale[0] - m[at + 1],
                zoom * v[1] / c.scale[1] - m[at + 2],
                zoom * v[2] / c.scale[2] - m[at + 3],
            )
        )
        psi[6 + i] = value
        m[at + 4] += c.slow * (value * value - m[at + 4])
        m[at + 5] += 1.0
        m[at + 6] += c.share * (value - m[at + 6])
        for j in range(3):
            now[j] += m[at + 7 + j] * value
            seen[j] += m[at + 7 + j] * m[at + 6]


@nb.njit(cache=True, nogil=True)
def learn_weights(target: Any, seen: Any, c: Any, m: Any) -> None:
    """Lyapunov law with dead zone on the filtered columns phi, for every joint.

    e_D = e - clip(e, -d, d),  c += gain phi e_D / (floor + phi^T phi):  |c* - c|^2 never increases
    while |target - phi^T c*| <= d.

    Parameters
    ----------
    target, seen : ndarray (3,)
        Friction and its prediction, both through the low-pass [N m].
    """
    zone, energy = c.zone + m[12], c.floor
    for at in range(HEAD_NUMBERS, m.size, NODE):
        if m[at] != NONE:
            energy += m[at + 6] * m[at + 6]
    for j in range(3):
        e = target[j] - seen[j]
        e -= min(max(e, -zone), zone)
        own = m[6 + 2 * j] ** 2 + m[7 + 2 * j] ** 2
        e *= c.gain / (energy + own)
        m[2 * j] += e * m[6 + 2 * j]
        m[2 * j + 1] += e * m[7 + 2 * j]
        for at in range(HEAD_NUMBERS, m.size, NODE):
            if m[at] != NONE:
                m[at + 7 + j] += e * m[at + 6]


@nb.njit(cache=True, nogil=True)
def activity(m: Any, at: int) -> float:
    """A = max_j |c_j| rms(psi) of a node [N m]."""
    top = max(abs(m[at + 7]), abs(m[at + 8]), abs(m[at + 9]))
    return float(top * sqrt(m[at + 4]))


@nb.njit(cache=True, nogil=True)
def adapt_structure(v: Any, c: Any, m: Any) -> None:
    """Structure after Sanner & Slotine: a node where the motion is and its parent matters; out
    what does not matter.  At most one node comes and one goes per call.
    """
    level, free, going = c.coarsest, -1, True
    while going and level <= c.finest:
        zoom, found = 2.0**level, -1
        k0, k1, k2 = (
            round(zoom * v[0] / c.scale[0]),
            round(zoom * v[1] / c.scale[1]),
            round(zoom * v[2] / c.scale[2]),
        )
        for at in range(HEAD_NUMBERS, m.size, NODE):
            if m[at] == NONE:
                free = at
            elif m[at] == level and m[at + 1] == k0 and m[at + 2] == k1 and m[at + 3] == k2:
                found = at
        if found < 0:
            if free >= 0 and max(abs(k0), abs(k1), abs(k2)) <= 2.0 * max(zoom, 1.0):
                m[free], m[free + 1], m[free + 2], m[free + 3] = level, k0, k1, k2
                m[free + 4 : free + NODE] = 0.0
            going = False
        else:
            going = m[found + 5] > c.dwell and activity(m, found) > c.add
        level += 1.0
    m[13] += 1.0
    at = HEAD_NUMBERS + NODE * (int(m[13]) % ((m.size - HEAD_NUMBERS) // NODE))
    if m[at] > c.coarsest and m[at + 5] > c.dwell and activity(m, at) < c.remove:
        m[12] = min(m[12] + activity(m, at), c.zone)
        m[at] = NONE
