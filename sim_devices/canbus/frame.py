"""A CAN 2.0A data frame and how many bits it takes on the wire, stuff bits included."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba as nb

#: After the check sum: its delimiter, acknowledge slot and delimiter, 7 bits of end of frame.
TAIL = 10
#: Bits of silence before the next frame may start.
PAUSE = 3
#: Error flag, its echo and delimiter at most: 6 + 6 + 8.
ERROR = 20


class Frame(NamedTuple):
    """Identifier of 11 bits and up to 8 bytes.

    Parameters
    ----------
    ident : int
        Identifier; the lower, the sooner.
    data : bytes
        Payload.
    """

    ident: int
    data: bytes = b""


@nb.njit(cache=True, nogil=True)
def bits(ident: int, data: Any) -> int:
    """Bits from the start of a frame to the end of its end-of-frame field.

    Start, identifier, RTR, IDE, r0, length, data and a CRC of polynomial 0x4599 are stuffed:
    after five equal bits one of the opposite value goes in (ISO 11898-1).
    """
    size = len(data)
    crc, run, last, count = 0, 0, -1, 0
    head = ident << 7 | size  # start bit 0, 11 bits, RTR = IDE = r0 = 0, 4 bits of length
    total = 19 + 8 * size
    for k in range(total + 15):
        if k < 19:
            bit = head >> (18 - k) & 1
        elif k < total:
            bit = data[(k - 19) >> 3] >> (7 - ((k - 19) & 7)) & 1
        else:
            bit = crc >> (14 - (k - total)) & 1
        if k < total:
            crc = crc << 1 ^ (0x4599 if bit ^ (crc >> 14 & 1) else 0)
            crc &= 0x7FFF
        count += 1
        if bit == last:
            run += 1
        else:
            last, run = bit, 1
        if run == 5:
            # the stuff bit starts a run of its own
            count += 1
            last, run = 1 - bit, 1
    return count + TAIL


#: Lengths of frames without data, by identifier: requests, the same ones all the time.
_EMPTY: dict[int, int] = {}


def length(frame: Frame) -> int:
    """`bits` of a frame."""
    if frame.data:
        return int(bits(frame.ident, frame.data))
    found = _EMPTY.get(frame.ident)
    if found is None:
        found = _EMPTY[frame.ident] = int(bits(frame.ident, frame.data))
    return found
