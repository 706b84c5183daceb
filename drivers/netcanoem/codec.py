"""Bytes of the ATI 9105-NETCANOEM board over CAN: requests out, fields in; no I/O.

Source: ATI manual 9610-05-1030-04, "F/T CAN Bus and Serial Bus Network Interface for OEM".
An identifier of 11 bits is ``base << 4 | operation``; all words are big-endian.
"""

from __future__ import annotations

import struct
from typing import Any

from hil.errors import DeviceError

READ_GAUGES, SECOND_HALF = 0x0, 0x1
READ_MATRIX, READ_SERIAL, SET_CALIBRATION = 0x2, 0x5, 0x6
READ_COUNTS, READ_UNITS, READ_DIAGNOSTIC = 0x7, 0x8, 0x9
RESET, SET_BASE, SET_BIT_RATE, READ_FIRMWARE = 0xC, 0xD, 0xE, 0xF

#: Operation of an answer -> its bytes.  Interfaces that hand a host its own frames back, or those
#: of another program on it, deliver requests too: they share the identifier, and not the length
#: (but for SET_CALIBRATION, whose request looks like its echo).
ANSWER_BYTES = {
    READ_GAUGES: 8,
    SECOND_HALF: 6,
    READ_MATRIX: 8,
    0x3: 8,
    0x4: 8,
    READ_SERIAL: 8,
    SET_CALIBRATION: 1,
    READ_COUNTS: 8,
    READ_UNITS: 2,
    READ_DIAGNOSTIC: 2,
    SET_BASE: 0,
    SET_BIT_RATE: 0,
    READ_FIRMWARE: 4,
}

_AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
SLOTS = 16
#: Firmware before this has neither counts per unit nor unit codes ...
UNITS_SINCE = (3, 7)
#: ... and counts a million per unit of force and of torque.
OLD_COUNTS = 1_000_000
#: A gauge at one of these is saturated; there is no status bit for it.
RAILS = (-32768, 32767)

#: Unit code -> name, newtons or newton metres.
FORCE_UNITS = {
    1: ("lbf", 4.4482216152605),
    2: ("N", 1.0),
    3: ("klbf", 4448.2216152605),
    4: ("kN", 1e3),
    5: ("kgf", 9.80665),
    6: ("gf", 9.80665e-3),
}
TORQUE_UNITS = {
    1: ("lbf-in", 0.1129848290276167),
    2: ("lbf-ft", 1.3558179483314004),
    3: ("N-m", 1.0),
    4: ("N-mm", 1e-3),
    5: ("kgf-cm", 9.80665e-2),
    6: ("kN-m", 1e3),
}

#: Status bit -> meaning, and whether a sample with it must not be used.
_STATUS_BITS = {
    0: ("watchdog reset happened", False),
    1: ("DAC/ADC check too high", True),
    2: ("DAC/ADC check too low", True),
    3: ("artificial analog ground out of range", True),
    4: ("supply too high", True),
    5: ("supply too low", True),
    6: ("bad active calibration", True),
    7: ("EEPROM failure", True),
    8: ("configuration invalid, defaults in use", False),
    11: ("sensor temperature too high", True),
    12: ("sensor temperature too low", True),
    14: ("CAN bus error", False),
    15: ("any error", False),
}
CRITICAL = sum(1 << bit for bit, (_, critical) in _STATUS_BITS.items() if critical)

_FIRST = struct.Struct(">Hhhh").unpack
_SECOND = struct.Struct(">hhh").unpack


def identifier(base: int, operation: int) -> int:
    """Identifier of 11 bits for a board's `base` (0..127) and an operation (0..15)."""
    return base << 4 | operation


def describe_status(word: int) -> str:
    """Meaning of every bit that is set in a status word."""
    known = [text for bit, (text, _) in _STATUS_BITS.items() if word >> bit & 1]
    return ", ".join(known) or ("no error" if word == 0 else f"reserved bits 0x{word:04x}")


def first_half(data: bytes, gauges: Any) -> int:
    """Status word; strain gauges 0, 2, 4 written into `gauges` (6,).  8 bytes."""
    status, gauges[0], gauges[2], gauges[4] = _FIRST(data)
    return int(status)


def second_half(data: bytes, gauges: Any) -> None:
    """Strain gauges 1, 3, 5 written into `gauges` (6,).  6 bytes."""
    gauges[1], gauges[3], gauges[5] = _SECOND(data)


def matrix_pair(data: bytes) -> tuple[float, float]:
    """Two neighbouring entries of a row of the calibration matrix."""
    _need("matrix row", data, 8)
    left, right = struct.unpack(">ff", data)
    return float(left), float(right)


def serial_number(data: bytes) -> str:
    """Serial number of the transducer, e.g. ``FT08577``.

    Raises
    ------
    DeviceError
        If it is not eight ASCII characters.
    """
    _need("serial number", data, 8)
    try:
        return data.decode("ascii").strip("\x00 ")
    except UnicodeDecodeError as error:
        raise DeviceError(f"serial number {data.hex()} is not ASCII text") from error


def counts_per_unit(data: bytes) -> tuple[int, int]:
    """Counts per unit of force and of torque.

    Raises
    ------
    DeviceError
        If one of them is zero, which no conversion survives.
    """
    _need("counts per unit", data, 8)
    force, torque = struct.unpack(">II", data)
    if not force or not torque:
        raise DeviceError(f"counts per unit are {force} and {torque}; neither may be zero")
    return int(force), int(torque)


def unit_codes(data: bytes) -> tuple[int, int]:
    """Codes of `FORCE_UNITS` and `TORQUE_UNITS`."""
    _need("unit codes", data, 2)
    force, torque = data
    if force not in FORCE_UNITS or torque not in TORQUE_UNITS:
        raise DeviceError(
            f"unit codes {force} and {torque}; known are {list(FORCE_UNITS)} for force and "
            f"{list(TORQUE_UNITS)} for torque"
        )
    return force, torque


def firmware(data: bytes) -> tuple[int, int, int]:
    """Major, minor and build number."""
    _need("firmware version", data, 4)
    major, minor, build = struct.unpack(">BBH", data)
    return int(major), int(minor), int(build)


def diagnostic(data: bytes) -> int:
    """Reading of a diagnostic converter channel."""
    _need("diagnostic reading", data, 2)
    return int.from_bytes(data, "big")


def _need(what: str, data: bytes, size: int) -> None:
    if len(data) != size:
        raise DeviceError(f"{what}: {len(data)} bytes ({data.hex() or 'none'}), not {size}")
