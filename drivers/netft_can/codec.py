"""Bytes of the ATI Net F/T box's basic CAN protocol, short form; no I/O.

Source: ATI manual 9620-05-NET FT, "CAN".  Little-endian, two's complement, converted counts.  The
long form (request 0x01, four frames) is not used: the order of its fields is not confirmed here.
"""

from __future__ import annotations

import struct
from typing import Any

#: The host asks and commands with the base identifier and one byte.
REQUEST_SHORT, BIAS = b"\x02", b"\x04"
#: The box answers with base + 5 and base + 6.
FIRST, SECOND = 5, 6

_FIRST = struct.Struct("<hhhh").unpack
_SECOND = struct.Struct("<hhHH").unpack


def first_frame(data: bytes, words: Any) -> None:
    """Fx, Tx, Fy, Ty into `words` (6,) = Fx Fy Fz Tx Ty Tz.  8 bytes."""
    words[0], words[3], words[1], words[4] = _FIRST(data)


def second_frame(data: bytes, words: Any) -> tuple[int, int]:
    """Fz, Tz into `words` (6,); status and sample number.  8 bytes."""
    words[2], words[5], status, sample = _SECOND(data)
    return int(status), int(sample)
