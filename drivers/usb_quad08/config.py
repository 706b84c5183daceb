"""Options of a USB-QUAD08."""

from __future__ import annotations

from dataclasses import dataclass

from hil.drivers.usb_quad08 import codec
from hil.errors import ConfigError, unknown

WORDS = {16: 1, 32: 2}


@dataclass(frozen=True)
class Quad08Config:
    """Options of the box ``usb-quad08``.

    Parameters
    ----------
    rate_hz : float
        Scans per second; the box delivers whole packets, so that a higher rate means younger
        counts: at 50 kHz, 32 bits and six counters a packet lasts 0.43 ms.
    bits : int
        16 or 32 bits a counter.
    edges : int
        1, 2 or 4 counts a line (X1, X2, X4).
    index : str
        ``""``, ``"latch"`` or ``"clear"`` on the index pulse; "clear" makes counts start anew
        at every index and is of no use for homing a joint of several turns.
    debounce_us : float
        0 = off, or a time of the list in `codec.DEBOUNCE_US` [us].
    images : str
        Folder with ``loader.hex``, ``firmware.hex`` and ``fpga.bin`` for a box without power-up
        firmware; they are the vendor's, and are in the source of its MIT-licensed library.
    fastest : float
        Most counts per second that the encoders can make; more is a stream out of step, which
        nothing else shows.  A motor's 4860 turns a minute at 4096 counts are 332000.
    stale_ms, lost_ms : float
        Time without data from which the counts are STALE, and the box is LOST [ms].
    """

    rate_hz: float = 50_000.0
    bits: int = 32
    edges: int = 4
    index: str = ""
    debounce_us: float = 0.0
    images: str = ""
    fastest: float = 500_000.0
    stale_ms: float = 4.0
    lost_ms: float = 50.0

    def __post_init__(self) -> None:
        if self.bits not in WORDS:
            raise ConfigError(unknown("number of bits", str(self.bits), map(str, WORDS)))
        if self.edges not in codec.RESOLUTIONS:
            raise ConfigError(unknown("number of edges", str(self.edges), ("1", "2", "4")))
        if self.index not in ("", "latch", "clear"):
            raise ConfigError(unknown("index", self.index, ("latch", "clear")))
        if not 1_000.0 <= self.rate_hz <= 100_000.0:
            raise ConfigError(f"rate_hz = {self.rate_hz}: 1000 to 100000 is needed.")
        if not 0 < self.stale_ms <= self.lost_ms:
            raise ConfigError("0 < stale_ms <= lost_ms is needed.")
        codec.debounce_byte(self.debounce_us)
        if self.fastest * self.lost_ms * 1e-3 >= 2 ** (self.bits - 1):
            raise ConfigError(
                f"lost_ms = {self.lost_ms}: in that time {self.fastest:g} counts/s pass half of "
                f"{self.bits} bits, and a lost turn would go unnoticed; use less, or bits = 32."
            )
