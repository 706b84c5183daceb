"""Where the messages of a chunk lie: a compiled walk, for files that are worth its import."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

#: Bytes of a record's opcode and length; of what a message has before its payload.
HEAD, BEFORE = 9, 22
#: Opcode of a message.
MESSAGE = 5


@numba.njit(cache=True)
def _number(data: NDArray[np.uint8], at: int, size: int) -> np.uint64:
    """Little-endian number of `size` bytes."""
    out = np.uint64(0)
    for k in range(size):
        out |= np.uint64(data[at + k]) << np.uint64(8 * k)
    return out


@numba.njit(cache=True)
def messages(
    data: NDArray[np.uint8], at: int, known: NDArray[np.bool_],
    where: NDArray[np.int64], stamps: NDArray[np.uint64],
) -> tuple[int, int]:  # fmt: skip
    """Walk messages of known channels from byte `at` on, up to the first other record.

    Parameters
    ----------
    data : ndarray of uint8
        Records of a chunk.
    at : int
        Where the first of them begins.
    known : ndarray of bool (65536,)
        Whether a channel has been declared.
    where : ndarray of int64 (n, 4)
        Filled: channel, sequence number, start and size of the payload.
    stamps : ndarray of uint64 (n,)
        Filled: log times [ns].

    Returns
    -------
    count, at : int
        How many messages, and where the record after them begins.
    """
    count, size = 0, data.size
    while count < stamps.size and at + HEAD + BEFORE <= size and data[at] == MESSAGE:
        # one beyond 2^63 is negative, and as wrong as any that is too long
        length = np.int64(_number(data, at + 1, 8))
        if length < BEFORE or length > size - at - HEAD:
            break
        body = at + HEAD
        channel = _number(data, body, 2)
        if not known[channel]:
            break
        where[count, 0] = channel
        where[count, 1] = _number(data, body + 2, 4)
        where[count, 2] = body + BEFORE
        where[count, 3] = length - BEFORE
        stamps[count] = _number(data, body + 6, 8)
        at = int(body + length)
        count += 1
    return count, at
