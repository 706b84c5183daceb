"""HID reports of the USB-31xx family: bytes <-> fields; no I/O.

Source: Measurement Computing "UL for Linux" 1.2.1 (MIT) and W. Jasper's Linux drivers (LGPL),
which agree on every report used here.  Byte 0 is the report's number; writes are not answered.
"""

from __future__ import annotations

import struct

from hil.errors import DeviceError

VENDOR = 0x09DB
#: Model -> product id, channels.  The models with current outputs (3102, 3104, 3106) are left
#: out: their range code is another.
DAC_MODELS = {
    "usb-3101": (0x009A, 4),
    "usb-3103": (0x009C, 8),
    "usb-3105": (0x009E, 16),
    "usb-3110": (0x00A2, 4),
    "usb-3112": (0x00A3, 8),
    "usb-3114": (0x00A4, 16),
}

DIO_DIRECTION_BIT, DIO_BIT = 0x02, 0x06
AOUT, AOUT_SYNC, AOUT_CONFIG = 0x14, 0x15, 0x1C
MEMORY_READ, SET_SYNC, GET_STATUS = 0x30, 0x43, 0x44
BIPOLAR, NOW, ON_SYNC, MASTER = 1, 0, 1, 0
#: Codes of 0 V and of the largest voltage in the range of +/- 10 V.
_ZERO, _TOP = 32768, 65535
FLASH_BIPOLAR, FLASH_STEP, FLASH_BYTES = 0x108, 0x10, 8
REPLY_MAX = 64
#: A calibration further than this from slope 1 and offset 0 is none.
SLOPE_ERROR, OFFSET_MAX = 0.1, 3000.0


def aout(channel: int, value: int, when: int) -> bytes:
    """Set a channel's converter (0..65535) now, or stage it for the next sync."""
    return bytes([AOUT, channel, value & 0xFF, value >> 8, when])


def aout_config(channel: int) -> bytes:
    """Range +/- 10 V, which also sets 0 V."""
    return bytes([AOUT_CONFIG, channel, BIPOLAR])


def memory_read(address: int, count: int) -> bytes:
    """Ask for bytes of the memory."""
    return bytes([MEMORY_READ, address & 0xFF, address >> 8, 0, count])


def calibration_address(channel: int) -> int:
    """Where slope and offset of a channel stand, range +/- 10 V."""
    return FLASH_BIPOLAR + FLASH_STEP * channel


def decode_calibration(data: bytes, where: str) -> tuple[float, float]:
    """Slope and offset [codes] of a channel.

    Raises
    ------
    DeviceError
        If they are not those of a calibrated box.
    """
    slope, offset = struct.unpack("<ff", data)
    if not (abs(slope - 1.0) <= SLOPE_ERROR and abs(offset) <= OFFSET_MAX):
        raise DeviceError(
            f"{where}: slope {slope:g}, offset {offset:g} in its flash are no calibration; have "
            "the box calibrated, and do not drive motors with it."
        )
    return slope, offset


def dac_code(code: int, slope: float, offset: float) -> int:
    """Converter value for a signed code -32768..32767, in which 32768 stands for 10 V.

    Clamped before and after the calibration, in floating point: an integer would wrap.

    Examples
    --------
    >>> converter(0, 1.0, 0.0), converter(16384, 1.0, 0.0), converter(99999, 1.01, 5.0)
    (32768, 49152, 65535)
    """
    # k' = slope k + offset
    ideal = float(code + _ZERO)
    if not 0.0 <= ideal <= _TOP:
        ideal = 0.0 if ideal < 0.0 else float(_TOP)
    real = slope * ideal + offset
    if not 0.0 <= real <= _TOP:
        return 0 if real < 0.0 else _TOP
    return int(real + 0.5)
