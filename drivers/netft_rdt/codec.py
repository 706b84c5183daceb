"""Bytes of ATI's Raw Data Transfer (RDT) over UDP; no I/O.

Source: ATI manual 9620-05-NET FT, "UDP interface using RDT".  Big-endian.
"""

from __future__ import annotations

import struct
from typing import Any

PORT = 49152
HEADER = 0x1234
STOP, REAL_TIME, SOFTWARE_BIAS = 0x0000, 0x0002, 0x0042
RECORD_BYTES = 36

_REQUEST = struct.Struct(">HHI").pack
_RECORD = struct.Struct(">III6i").unpack


def request(command: int, samples: int = 0) -> bytes:
    """Command of 8 bytes; 0 samples means without end."""
    return _REQUEST(HEADER, command, samples)


def record(data: bytes, words: Any) -> tuple[int, int, int]:
    """RDT sequence, F/T sequence and status; Fx Fy Fz Tx Ty Tz into `words` (6,).  36 bytes."""
    rdt, sequence, status, *words[:] = _RECORD(data)
    return int(rdt), int(sequence), int(status)
