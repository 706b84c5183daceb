"""Eight quadrature counters of 48 bits, fed by edges; compiled."""

from __future__ import annotations

from typing import Any

import numba as nb

SPAN = 1 << 48


@nb.njit(cache=True, nogil=True)
def step(total: Any, edge: int, mode: int, per_turn: int) -> int:
    """Count of one channel after the encoder has gone from `total[0]` to `edge` quarter lines.

    Parameters
    ----------
    total : ndarray (2,) of int
        Quarter lines so far, and the count; both are replaced.
    mode : int
        Mode word: bits 3 and 4 X2 and X4, bit 8 clears on the index.
    per_turn : int
        Quarter lines a turn; the index stands at multiples of it.
    """
    # the edges that a counter takes: all (X4), those of A (X2), rising ones of A (X1)
    shift = 0 if mode & 0x10 else (1 if mode & 0x08 else 2)
    before = total[0]
    total[1] += (edge >> shift) - (before >> shift)
    if mode & 0x100 and edge // per_turn != before // per_turn:
        index = max(edge // per_turn, before // per_turn) * per_turn
        total[1] = (edge >> shift) - (index >> shift)
    total[0] = edge
    return int(total[1] % SPAN)


@nb.njit(cache=True, nogil=True)
def scans(
    total: Any,
    modes: Any,
    before: Any,
    now: Any,
    first: float,
    pace: float,
    n: int,
    channels: Any,
    words: int,
    per_turn: int,
    zero: bool,
    out: Any,
) -> None:
    """Words of `n` scans while the encoders go evenly from `before` to `now`.

    Parameters
    ----------
    total, modes : ndarray (8, 2), (8,)
        Counters and their mode words.
    before, now : ndarray (8,)
        Quarter lines at the start and at the end of the interval.
    first, pace : float
        Share of the interval at the first scan, and between scans.
    channels : ndarray (k,) of int
        In the order of the scan list.
    words : int
        16-bit words a counter, 1, 2 or 4.
    zero : bool
        The first of these scans is the first of all, which zeroes the counters.
    out : ndarray (n * k * words,) of uint16
        Written.
    """
    at = 0
    for k in range(n):
        share = first + k * pace
        for c in channels:
            edge = before[c] + (now[c] - before[c]) * share
            count = step(total[c], int(edge // 1), modes[c], per_turn)
            if zero and k == 0:
                total[c, 1] = 0
                count = 0
            for w in range(words):
                out[at] = (count >> (16 * w)) & 0xFFFF
                at += 1


@nb.njit(cache=True, nogil=True)
def settle(total: Any, modes: Any, now: Any, per_turn: int) -> None:
    """Take every counter to where its encoder stands; without a mode it does not count.

    Parameters
    ----------
    total, modes, now : ndarray (8, 2), (8,), (8,)
        Counters, mode words, quarter lines.
    per_turn : int
        Quarter lines a turn.
    """
    for c in range(modes.size):
        if modes[c] & 7 == 5:
            step(total[c], int(now[c] // 1), modes[c], per_turn)
        else:
            total[c, 0] = int(now[c] // 1)
