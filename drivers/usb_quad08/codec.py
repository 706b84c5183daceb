"""Words of the USB-QUAD08: registers, counter modes, scan lists, images, scan data; no I/O.

Source: Measurement Computing "UL for Linux" 1.2.1 (MIT), src/usb/Usb{Iotech,Quad08}.cpp and
src/usb/{ctr,fw,tmr}; the family's manuals for what the source does not say (docs/hardware.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numba as nb

from hil.errors import ConfigError, DeviceError

VENDOR, LOADER, PRODUCT = 0x09DB, 0x0470, 0x00CA
STREAM = 0x82  # bulk IN endpoint
VENDOR_OUT, VENDOR_IN = 0x40, 0xC0  # vendor request, device recipient

# vendor requests
RAM, VERSION, FPGA_STATE, FPGA_DATA, REGISTER, ENDPOINT = 0xA0, 0xB0, 0xB2, 0xB3, 0xB4, 0xBB
CPU_CONTROL = 0xE600
INTERNAL_TOP = 0x3FFF
FIRMWARE_MIN = 0x0100
RECORD_MAX, FPGA_BLOCK, FPGA_HEADER = 16, 2048, 0x4E

# registers
ACQUIRE, SCAN_LIST = 0x00, 0x01
PACER = (0x02, 0x03, 0x05)
VARIABLE_RATE, DAC, DIO_CONTROL, DIO_DATA, DIO_DIRECTION = 0x0F, 0x10, 0x18, 0x22, 0x23
MODE, DEBOUNCE_AB, DEBOUNCE_INDEX, BANK = 0x28, 0x2C, 0x2D, 0x2E
COUNT = (0x30, 0x31, 0x32, 0x33)
DMA, TRIGGER, MARK = 0x58, 0x59, 0x5D

CLOCK_HZ = 48_000_000
#: Command codes of `ACQUIRE`, in the order in which ULDAQ writes them.
DISARM = (
    (TRIGGER, 0x0000),
    (TRIGGER, 0x0010),
    (ACQUIRE, 0x0030),
    (ACQUIRE, 0x0010),
    (ACQUIRE, 0x0003),
    (DMA, 0x0010),
)
#: What the initialisation writes for the five converters that the board might have: it is done
#: twice, and their enable words are known the second time.
DAC_WORDS = ((0, 0, 0, 0, 0), (0x20, 0x30, 0x40, 0x50, 0x60))
ARM_SEQUENCE = ((DMA, 0x0011), (ACQUIRE, 0x0071), (ACQUIRE, 0x0011))
RUN, STOPPED, RESET_LIST, NORMAL_PACER, RESET_RESULTS = 0x0031, 0x0000, 0x0004, 0x0060, 0x0003
BEFORE_LIST_ENDS = ((ACQUIRE, 0x0054), (ACQUIRE, 0x0040), (VARIABLE_RATE, 0))
#: (status & READY_MASK) == READY before the pacer may run.
READY_MASK, READY = 0x0018, 0x0010
_STATUS_BITS = {
    0x0004: "results FIFO overrun",
    0x0040: "ADC not ready",
    0x0080: "arbitration failure",
    0x0100: "pacer overrun",
}

RESOLUTIONS = {1: 0x00, 2: 0x08, 4: 0x10}
ENCODER, LATCH_ON_INDEX, CLEAR_ON_INDEX, CHANNEL_A, ASYNCHRONOUS = 5, 0x40, 0x100, 0x800, 0x2000
#: Longest bounce that a debounce code rejects [us]; None = no debouncing.
DEBOUNCE_US = (
    0.5,
    1.5,
    3.5,
    7.5,
    15.5,
    31.5,
    63.5,
    127.5,
    100.0,
    300.0,
    700.0,
    1500.0,
    3100.0,
    6300.0,
    12700.0,
    25500.0,
)
DEBOUNCE_OFF = 0x80
NO_LIMIT = ((0x30, 0xFFFF), (0x20, 0xFFFF), (0x10, 0xFFFF))  # bank offset, modulo word


def mode_word(edges: int, index: str = "", asynchronous: bool = False) -> int:
    """Mode word of an encoder counter.

    Parameters
    ----------
    edges : int
        1, 2 or 4 counts a line.
    index : str
        ``""``, ``"latch"`` or ``"clear"`` on the index pulse.
    asynchronous : bool
        For register reads; otherwise for scanning.

    Examples
    --------
    >>> hex(mode_word(4)), hex(mode_word(4, asynchronous=True))
    ('0x815', '0x2815')
    """
    word = ENCODER | CHANNEL_A | RESOLUTIONS[edges]
    word |= {"": 0, "latch": LATCH_ON_INDEX, "clear": CLEAR_ON_INDEX}[index]
    return word | (ASYNCHRONOUS if asynchronous else 0)


def disarm_all(words: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Registers and values that stop converters, with a row of `DAC_WORDS`, and scan."""
    converters = ((DAC, word) for word in words)
    return ((DAC, 0x0010), (DMA, 0x0000), *converters, (DAC, 0x0004), *DISARM)


def debounce_byte(microseconds: float) -> int:
    """Byte for a debounce time [us] of the list `DEBOUNCE_US`; 0 = off; rising edge."""
    if microseconds == 0.0:
        return DEBOUNCE_OFF
    if microseconds not in DEBOUNCE_US:
        raise ConfigError(f"debounce_us = {microseconds}: one of 0, {DEBOUNCE_US} is needed.")
    return DEBOUNCE_OFF | 0x10 | DEBOUNCE_US.index(microseconds)


def scan_list(channels: Sequence[int], words: int) -> list[int]:
    """Scan-list words: two for every 16-bit `words` (1, 2 or 4) of every counter.

    Examples
    --------
    >>> [hex(w) for w in scan_list([0, 1], 1)]
    ['0x3', '0x60', '0x1f', '0x60']
    """
    found: list[int] = []
    for channel in channels:
        for part in range(words):
            # bit 0 digital, 1 internal, 2 last entry, 3 clear on the very first one alone
            found += [channel << 4 | 0x3 | (0x8 if found else 0), COUNT[part] * 2]
    found[-2] |= 0x4
    return found


def pacer_divisor(rate_hz: float) -> int:
    """Divisor of the 48 MHz clock: floor(48 MHz / rate) - 1."""
    return int(CLOCK_HZ // rate_hz) - 1


def scan_period_ns(divisor: int) -> float:
    """Time between scans [ns]."""
    return (divisor + 1) * 1e9 / CLOCK_HZ


def words16(value: int, n: int) -> list[int]:
    """The n low 16-bit words of a number, lowest first."""
    return [value >> 16 * k & 0xFFFF for k in range(n)]


def channel_number(data: bytes) -> int:
    """Little-endian unsigned number of a reply."""
    return int.from_bytes(data, "little")


def mark_patterns() -> list[int]:
    """The eight words that prove the FPGA: bit i for odd i, all but bit i for even i."""
    return [1 << i if i % 2 else 0xFF & ~(1 << i) for i in range(8)]


def faults(status: int) -> list[str]:
    """What a status word complains of."""
    return [text for bit, text in _STATUS_BITS.items() if status & bit]


def hex_records(text: str, source: str) -> list[tuple[int, bytes]]:
    """Data records of an Intel-hex image: address and at most 16 bytes.

    Raises
    ------
    DeviceError
        If a line is not a record, or its checksum is wrong.
    """
    records = []
    for row, line in enumerate(text.split(), 1):
        try:
            raw = bytes.fromhex(line.removeprefix(":"))
            good = line[0] == ":" and len(raw) == raw[0] + 5 and sum(raw) & 0xFF == 0
        except (ValueError, IndexError):
            good = False
        if not good:
            raise DeviceError(f"{source}, line {row}: not an Intel-hex record; extract it anew.")
        address, kind, data = int.from_bytes(raw[1:3], "big"), raw[3], raw[4:-1]
        if kind == 1:
            break
        if kind == 0:
            records += [
                (address + k, data[k : k + RECORD_MAX]) for k in range(0, len(data), RECORD_MAX)
            ]
    return records


def fpga_blocks(image: bytes) -> Iterator[bytes]:
    """Blocks of a bit-stream image, without the header that its array in ULDAQ starts with."""
    for k in range(FPGA_HEADER, len(image), FPGA_BLOCK):
        yield image[k : min(k + FPGA_BLOCK, len(image))]


@nb.njit(cache=True, nogil=True)
def unwrap(
    ring: Any, first: int, scans: int, words: int, most: float, last: Any, counts: Any
) -> int:
    """Add to `counts` what the counters moved over some scans; the largest move if too large.

    Parameters
    ----------
    ring : ndarray of uint16
        Words of the stream, a power of two long.
    first, scans : int
        Index of the first scan's first word, and number of scans.
    words : int
        16-bit words per counter, 1 or 2.
    most : float
        Counts that a counter can move between two scans.
    last : ndarray (n,) of int
        Raw numbers of the scan before; replaced.
    counts : ndarray (n,) of int
        Signed totals; left at the last good scan.

    Returns
    -------
    int
        0, or a move that no encoder makes: the stream is out of step.
    """
    mask, n = ring.size - 1, counts.size
    span = 1 << (16 * words)
    for k in range(scans):
        at = first + k * n * words
        for i in range(n):
            raw = int(ring[(at + i * words) & mask])
            if words == 2:
                raw |= int(ring[(at + i * words + 1) & mask]) << 16
            # nearest equivalent: d in -span/2 .. span/2 - 1
            moved = (raw - last[i] + span // 2) % span - span // 2
            if abs(moved) > most:
                return int(abs(moved))
            last[i] = raw
            counts[i] += moved
    return 0
