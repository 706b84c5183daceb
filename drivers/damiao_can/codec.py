"""Frames of Damiao actuators in MIT mode: bytes to words and back; no I/O.

A command goes to the identifier of the drive, the answer comes from its master identifier.  Words
are unsigned; here they are halves of a step about zero, c = 2 w - top, so that turning a sign is
exact: position c PMAX / 65535, speed c VMAX / 4095, effort c TMAX / 4095.

Sources: manual of DM-J4310-2EC V1.1 ("MIT mode", "Feedback frame"); the vendor's DM_Control and
enactic/openarm_can, both MIT-licensed, agree with it.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

#: Largest words: 16 bits of position, 12 of speed, gains and effort.
TOP_POSITION, TOP = 0xFFFF, 0xFFF
#: Last byte of eight, after seven times 0xff.
ENABLE, DISABLE, ZERO, CLEAR = 0xFC, 0xFD, 0xFE, 0xFB
#: Identifier of everything about registers; the drive is named in the data.
REGISTERS = 0x7FF
READ, WRITE, REFRESH = 0x33, 0x55, 0xCC
#: Registers: silence after which the drive stops [50 us], mode, ranges of the words.
TIMEOUT, MODE, PMAX, VMAX, TMAX = 9, 10, 21, 22, 23
TIMEOUT_UNIT = 50e-6
MIT_MODE = 1
#: What the upper half of the first byte of an answer says.
OFF, ON = 0, 1
FAULTS = {
    0x8: "over-voltage",
    0x9: "under-voltage",
    0xA: "over-current",
    0xB: "the driver stage is too hot",
    0xC: "the winding is too hot",
    0xD: "no command came for the time-out of the drive",
    0xE: "overload",
}


class Feedback(NamedTuple):
    """One answer: drive, its status, words about zero, temperatures [degC]."""

    drive: int
    status: int
    position: int
    speed: int
    effort: int
    stage: int
    winding: int


class Register(NamedTuple):
    """Value of a register, as its four bytes."""

    drive: int
    register: int
    raw: bytes

    @property
    def number(self) -> float:
        """As a float."""
        return float(struct.unpack("<f", self.raw)[0])

    @property
    def integer(self) -> int:
        """As an unsigned integer."""
        return int(struct.unpack("<I", self.raw)[0])


def word(centred: int, top: int) -> int:
    """Unsigned word of a number of half steps about zero, the nearest one there is."""
    return (min(max(centred, -top), top) + top + (centred > 0)) // 2


def effort_command(effort: int) -> bytes:
    """Effort in half steps; both gains are zero, so position and speed asked for mean nothing."""
    w = word(effort, TOP)
    # p 16, v 12, kp 12, kd 12, t 12 bits, each from the top; p and v stand at their middle
    return bytes((0x7F, 0xFF, 0x7F, 0xF0, 0x00, 0x00, w >> 8, w & 0xFF))


def special(what: int) -> bytes:
    """`ENABLE`, `DISABLE`, `ZERO` or `CLEAR`."""
    return b"\xff" * 7 + bytes((what,))


def refresh(drive: int) -> bytes:
    """Asks for an answer and commands nothing; goes to `REGISTERS`."""
    return struct.pack("<HBB4x", drive, REFRESH, 0)


def read_register(drive: int, register: int) -> bytes:
    """Asks for a register; goes to `REGISTERS`."""
    return struct.pack("<HBB4x", drive, READ, register)


def write_register(drive: int, register: int, value: int) -> bytes:
    """Sets a register that holds an integer, until the supply goes; goes to `REGISTERS`."""
    return struct.pack("<HBBI", drive, WRITE, register, value)


def feedback(data: bytes) -> Feedback | None:
    """An answer to a command; None where the bytes are none."""
    if len(data) != 8:
        return None
    first, p1, p0, v, vt, t, stage, winding = data
    return Feedback(
        first & 0xF,
        first >> 4,
        2 * (p1 << 8 | p0) - TOP_POSITION,
        2 * (v << 4 | vt >> 4) - TOP,
        2 * ((vt & 0xF) << 8 | t) - TOP,
        stage,
        winding,
    )


def register(data: bytes) -> Register | None:
    """An answer about a register; None where the bytes are none."""
    if len(data) != 8 or data[2] not in (READ, WRITE):
        return None
    drive, _, which = struct.unpack_from("<HBB", data)
    return Register(drive, which, data[4:])
