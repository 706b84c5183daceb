"""Measurement Computing USB-QUAD08: eight encoder counters, scanned over USB (pyusb).

The counters are configured register by register; a scan is started and read in the background.  The
newest whole scan stands for the time of a tick, on an even grid.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from math import inf

import numpy as np

from hil.drivers.links.uldaq import OWN, ULDAQ, UldaqCounts, check_route
from hil.drivers.usb_quad08 import codec, link
from hil.drivers.usb_quad08.link import UsbLink, attached
from hil.errors import ConfigError, DeviceError, unknown
from hil.signals.bus import Bus
from hil.signals.device import Status

_WORDS = {16: 1, 32: 2}
#: Counters of a box.
COUNTERS = 8


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
    route : str
        ``"own"``, or ``"uldaq"``, the vendor's library (`hil.drivers.links.uldaq`).
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
    route: str = OWN

    def __post_init__(self) -> None:
        check_route(self.route)
        if self.bits not in _WORDS:
            raise ConfigError(unknown("number of bits", str(self.bits), map(str, _WORDS)))
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

    @property
    def available(self) -> int:
        """Channels that the box has, from 0 on."""
        return COUNTERS


#: Clocks of host and box differ by at most this, by which the estimated delay may grow [ns/ns].
_DRIFT = 200e-6


class ScanClock:
    """Relates the loop's time to numbers of scans.

    Packets arrive at their own rate, so that the newest scan is up to one packet old, by another
    age at every tick.  A speed from such counts would be wrong by the change of age: hence the
    newest scan that is there *at every tick*, one packet behind the shortest delay seen.

    Parameters
    ----------
    period_ns : float
        Time between scans.
    packet_ns : float
        Time that a packet takes to fill.
    """

    def __init__(self, period_ns: float, packet_ns: float) -> None:
        self._period, self._packet = period_ns, packet_ns
        self._delay = float("inf")
        self._then = 0

    def choose(self, t_ns: int, newest: int) -> int:
        """Number of the scan for time `t_ns` when scan `newest` has arrived whole."""
        # scan k was taken at k period + delay, delay = min over time of t - newest period
        delay = t_ns - newest * self._period
        if delay < self._delay:
            self._delay = delay
        else:
            self._delay = min(delay, self._delay + _DRIFT * (t_ns - self._then))
        self._then = t_ns
        wanted = int((t_ns - self._delay - self._packet) // self._period)
        return min(wanted, newest)


def configure_counter(
    link: UsbLink, channel: int, config: Quad08Config, asynchronous: bool
) -> None:
    """Set a counter's debouncing and mode, which zeroes it; no limit."""
    byte = codec.debounce_byte(config.debounce_us)
    mode = codec.mode_word(config.edges, config.index, asynchronous)
    link.write_all(
        (
            (codec.BANK, channel),
            (codec.DEBOUNCE_AB, byte << 8 | byte),
            (codec.BANK, channel),
            (codec.DEBOUNCE_INDEX, codec.DEBOUNCE_OFF << 8 | byte),
            (codec.BANK, channel),
            (codec.MODE, mode),
        )
    )
    for bank, word in codec.NO_LIMIT:
        link.write_all(((codec.BANK, bank + channel), (codec.MODE, word)))


def start_scan(link: UsbLink, words: list[int], divisor: int) -> None:
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
    link.write_all(codec.ARM_SEQUENCE)
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


#: Words that the ring holds (a power of two), and scans read before counting begins.
_RING, _SETTLING, _MOST_PACKETS = 1 << 18, 4, 32
READ_TIMEOUT_MS = 20
#: Time between questions for the status, while data come and while none do.
STATUS_EVERY_NS, STATUS_EMPTY_NS = 1_000_000_000, 10_000_000
_FIRST_DATA_S, _STEP_S = 1.0, 0.005


class Quad08:
    """Counts of some channels, streamed.

    Parameters
    ----------
    name : str
        Name of the box.
    bus : Bus
        USB.
    serial : str
        Serial number; empty takes the first box.
    config : Quad08Config
        Rates and modes.
    channels : tuple of int
        Channels that are scanned.

    Attributes
    ----------
    counts : ndarray (channels,) of int
        Counts since the box was opened, of the last `receive`; stays the same array.
    trouble : str
        Why the box is lost; empty while it is not.

    Raises
    ------
    DeviceError
        If the box is not there, cannot be started, or delivers nothing.
    """

    def __init__(
        self, name: str, bus: Bus, serial: str, config: Quad08Config, channels: tuple[int, ...]
    ) -> None:
        self.name, self.config, self.channels = name, config, channels
        self._bus = bus
        self._words = _WORDS[config.bits]
        self._stride = self._words * len(channels)
        self.counts = np.zeros(len(channels), np.int64)
        self._last = np.zeros(len(channels), np.int64)
        self._ring = np.zeros(_RING, np.uint16)
        self._got = 0  # bytes that arrived; published last
        self._used = -1  # scan that `counts` stands for
        self._fresh_ns = self._checked_ns = 0
        self.trouble = ""
        self._link = link.open_link(name, bus.handle, serial, config.images, bus.pause)
        self.serial = str(self._link.device.serial_number or "")
        try:
            self._start()
        except BaseException:
            self._link.close()
            raise

    def _start(self) -> None:
        """Configure, start the scan, wait for data."""
        packet = self._link.packet_size()
        # a thread waits for one packet; in virtual time everything that came in a tick is there
        length = packet * (_MOST_PACKETS if self._bus.simulated else 1)
        self._buffer = array("B", bytes(length))
        divisor = codec.pacer_divisor(self.config.rate_hz)
        period = codec.scan_period_ns(divisor)
        filling = packet / (2 * self._stride) * period
        self._clock, self._age_ms = ScanClock(period, filling), 2e-6 * filling
        self._most = 1.0 + self.config.fastest * period * 1e-9
        for channel in self.channels:
            configure_counter(self._link, channel, self.config, asynchronous=False)
        start_scan(self._link, codec.scan_list(self.channels, self._words), divisor)
        self._checked_ns = self._bus.now_ns()
        self._stop = self._bus.run(self.name, self._pump)
        for _ in range(round(_FIRST_DATA_S / _STEP_S)):
            if self._scans > _SETTLING or self.trouble:
                break
            self._bus.pause(_STEP_S)
        if self._scans <= _SETTLING:
            self.close()
            raise DeviceError(
                self.trouble or f"box {self.name!r} delivers no counts; plug it in again."
            )
        # a start zeroes the counters, and the first scan may do so again: where they stand at
        # the last one so far is home
        self._used = self._scans - 2
        self._unwrap(self._scans - 1, inf)
        self.counts[:] = 0

    def describe(self) -> str:
        """What the box does, for `hil devices`."""
        return (
            f"USB-QUAD08 {self.serial}: {len(self.channels)} encoders at "
            f"{self.config.rate_hz:g} scans/s, counts at most {self._age_ms:.2g} ms old"
        )

    @property
    def _scans(self) -> int:
        """Whole scans that have arrived."""
        return self._got // (2 * self._stride)

    def _pump(self) -> float:
        """Move what has arrived into the ring.  Runs in the background."""
        if self.trouble:
            return 1.0
        try:
            n = self._link.stream(self._buffer, READ_TIMEOUT_MS)
            if n:
                self._store(n)
            now = self._bus.now_ns()
            if now - self._checked_ns >= (STATUS_EVERY_NS if n else STATUS_EMPTY_NS):
                self._checked_ns = now
                self._check()
        except DeviceError as error:
            self.trouble = str(error)
        return 0.0

    def _store(self, n: int) -> None:
        if n % 2:
            raise DeviceError(f"box {self.name!r}: {n} bytes, half a word; plug it in again.")
        words = np.frombuffer(self._buffer, np.uint16, n // 2)
        at = self._got // 2 % _RING
        first = min(_RING - at, n // 2)
        self._ring[at : at + first] = words[:first]
        self._ring[: n // 2 - first] = words[first:]
        self._got += n

    def _check(self) -> None:
        found = codec.faults(self._link.read(codec.ACQUIRE))
        if found:
            raise DeviceError(
                f"box {self.name!r}: {', '.join(found)}; the host did not read fast enough, or "
                "the box is faulty. Lower rate_hz, and start anew."
            )

    def receive(self, t_ns: int) -> Status:
        """Refresh `counts` for time `t_ns`."""
        if self.trouble:
            return Status.LOST
        wanted = self._clock.choose(t_ns, self._scans - 1)
        if wanted > self._used:
            self._fresh_ns = t_ns
            return self._unwrap(wanted, self._most)
        if not self._fresh_ns:
            self._fresh_ns = t_ns
        age = (t_ns - self._fresh_ns) * 1e-6
        if age > self.config.lost_ms:
            self.trouble = f"box {self.name!r} has not sent counts for {age:.0f} ms."
            return Status.LOST
        return Status.STALE if age > self.config.stale_ms else Status.OK

    def _unwrap(self, scan: int, most: float) -> Status:
        """Go on through the stream to one scan; between two, a counter moves `most` counts."""
        gap = scan - self._used
        if self._got // 2 - (self._used + 1) * self._stride > _RING - self._stride:
            # nobody asked for longer than the ring holds, e.g. while a force sensor was tared:
            # one step over the gap, as long as a counter cannot have gone once round in it
            if most * gap >= 1 << (16 * self._words - 1):
                self.trouble = (
                    f"box {self.name!r}: nobody took its counts for {gap} scans, in which a turn "
                    "may have been lost; use bits = 32."
                )
                return Status.LOST
            self._used, most = scan - 1, most * gap
        n, first = scan - self._used, (self._used + 1) * self._stride
        moved = codec.unwrap(self._ring, first, n, self._words, most, self._last, self.counts)
        self._used = scan
        if moved:
            self.trouble = (
                f"box {self.name!r}: a counter moved by {moved} counts between two scans, faster "
                "than any encoder here; the stream is out of step, or 'fastest' is too low."
            )
            return Status.LOST
        return Status.OK

    def close(self) -> None:
        """Stop the scan and release the box, as far as it is still there."""
        stop, self._stop = self._stop, _nothing
        stop()
        if stop is _nothing:
            return
        try:
            self._link.write_all((*codec.DISARM, (codec.ACQUIRE, codec.STOPPED)))
        except DeviceError as error:
            self.trouble = self.trouble or str(error)
        self._link.close()


def _nothing() -> None:
    """What stops a pump that does not run."""


def open_box(
    name: str, bus: Bus, address: str, config: Quad08Config, channels: tuple[int, ...]
) -> Quad08 | UldaqCounts:
    """Open a box by the route of its options."""
    if config.route == ULDAQ:
        return UldaqCounts(name, bus, address, config, channels, ScanClock)
    return Quad08(name, bus, address, config, channels)


BUS = "usb"
Config = Quad08Config

__all__ = ["BUS", "Config", "Quad08", "Quad08Config", "ScanClock", "attached", "open_box"]
