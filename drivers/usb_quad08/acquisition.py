"""Register by register: a counter configured or read, and the scan started."""

from __future__ import annotations

from hil.drivers.usb_quad08 import codec
from hil.drivers.usb_quad08.config import Quad08Config
from hil.drivers.usb_quad08.link import Link
from hil.errors import DeviceError


def configure(link: Link, channel: int, config: Quad08Config, asynchronous: bool) -> None:
    """Set a counter's debouncing and mode, which zeroes it; no limit."""
    byte = codec.debounce_byte(config.debounce_us)
    mode = codec.mode_word(config.edges, config.index, asynchronous)
    link.write_all((
        (codec.BANK, channel), (codec.DEBOUNCE_AB, byte << 8 | byte),
        (codec.BANK, channel), (codec.DEBOUNCE_INDEX, codec.DEBOUNCE_OFF << 8 | byte),
        (codec.BANK, channel), (codec.MODE, mode),
    ))  # fmt: skip
    for bank, word in codec.NO_LIMIT:
        link.write_all(((codec.BANK, bank + channel), (codec.MODE, word)))


def read_count(link: Link, channel: int) -> int:
    """Number of a counter in asynchronous mode, 48 bits; the low word first, which latches it."""
    link.write(codec.BANK, channel)
    low, middle, high = (link.read(register) for register in codec.COUNT[:3])
    return low | middle << 16 | high << 32


def arm(link: Link, words: list[int], divisor: int) -> None:
    """Start a scan: scan list (twice over), pacer, endpoint, sequencer, then the pacer runs.

    Raises
    ------
    DeviceError
        If the sequencer does not become ready.
    """
    for _ in range(2):
        link.write(codec.ACQUIRE, codec.RESET_LIST)
        link.write_all((codec.SCAN_LIST, word) for word in words)
        link.write_all(codec.BEFORE_LIST_ENDS)
    link.write_all(codec.DISARM)
    link.write(codec.ACQUIRE, codec.NORMAL_PACER)
    link.write_all(zip(codec.PACER, codec.words16(divisor, 3), strict=True))
    link.write(codec.ACQUIRE, codec.RESET_RESULTS)
    link.out(codec.ENDPOINT, 1, 2)
    link.device.clear_halt(codec.STREAM)
    link.write_all(codec.ARM)
    for _ in range(100):
        status = link.read(codec.ACQUIRE)
        found = codec.faults(status)
        if found:
            raise DeviceError(f"box {link.name!r}: {', '.join(found)}; plug it in again.")
        if status & codec.READY_MASK == codec.READY:
            link.write(codec.ACQUIRE, codec.RUN)
            return
    raise DeviceError(
        f"box {link.name!r}: its sequencer did not become ready (status 0x{status:04x}); plug it "
        "in again."
    )
