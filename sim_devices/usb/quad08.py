"""Firmware of a simulated USB-QUAD08: how it is loaded, vendor requests, and the stream.

Written from the protocol notes alone (registers, states and order of ULDAQ 1.2.1); shares no
code with the driver.  Where the notes are silent it does the least: without its FPGA it stalls
every register request; data leave in full packets only.
"""

from __future__ import annotations

import errno
from array import array
from collections.abc import Callable
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.sim_devices.usb.backend import failure

# Eight quadrature counters of 48 bits, fed by edges; compiled.

_SPAN = 1 << 48


@nb.njit(cache=True, nogil=True)
def step(total: Any, edge: int, mode: int, per_turn: int) -> int:
    """Count of one channel after the encoder has gone from `total[0]` to `edge` quarter lines.

    Parameters
    ----------
    total : ndarray (2,) of int
        Quarter lines so far, and the count; both are replaced.
    mode : int
        Mode word: bits 3 and 4 X2 and X4, bit 8 clears on the index.
    per_turn : int
        Quarter lines a turn; the index stands at multiples of it.
    """
    # the edges that a counter takes: all (X4), those of A (X2), rising ones of A (X1)
    shift = 0 if mode & 0x10 else (1 if mode & 0x08 else 2)
    before = total[0]
    total[1] += (edge >> shift) - (before >> shift)
    if mode & 0x100 and edge // per_turn != before // per_turn:
        index = max(edge // per_turn, before // per_turn) * per_turn
        total[1] = (edge >> shift) - (index >> shift)
    total[0] = edge
    return int(total[1] % _SPAN)


@nb.njit(cache=True, nogil=True)
def scans(
    total: Any,
    modes: Any,
    before: Any,
    now: Any,
    first: float,
    pace: float,
    n: int,
    channels: Any,
    words: int,
    per_turn: int,
    zero: bool,
    out: Any,
) -> None:
    """Words of `n` scans while the encoders go evenly from `before` to `now`.

    Parameters
    ----------
    total, modes : ndarray (8, 2), (8,)
        Counters and their mode words.
    before, now : ndarray (8,)
        Quarter lines at the start and at the end of the interval.
    first, pace : float
        Share of the interval at the first scan, and between scans.
    channels : ndarray (k,) of int
        In the order of the scan list.
    words : int
        16-bit words a counter, 1, 2 or 4.
    zero : bool
        The first of these scans is the first of all, which zeroes the counters.
    out : ndarray (n * k * words,) of uint16
        Written.
    """
    at = 0
    for k in range(n):
        share = first + k * pace
        for c in channels:
            edge = before[c] + (now[c] - before[c]) * share
            count = step(total[c], int(edge // 1), modes[c], per_turn)
            if zero and k == 0:
                total[c, 1] = 0
                count = 0
            for w in range(words):
                out[at] = (count >> (16 * w)) & 0xFFFF
                at += 1


@nb.njit(cache=True, nogil=True)
def settle(total: Any, modes: Any, now: Any, per_turn: int) -> None:
    """Take every counter to where its encoder stands; without a mode it does not count.

    Parameters
    ----------
    total, modes, now : ndarray (8, 2), (8,), (8,)
        Counters, mode words, quarter lines.
    per_turn : int
        Quarter lines a turn.
    """
    for c in range(modes.size):
        if modes[c] & 7 == 5:
            step(total[c], int(now[c] // 1), modes[c], per_turn)
        else:
            total[c, 0] = int(now[c] // 1)


# The FPGA of a simulated USB-QUAD08: registers, counters, scan list and results FIFO.
#
# Written from the protocol notes alone (registers, states and order of ULDAQ 1.2.1).  Where they
# are silent it does the least: it scans only after the whole initialisation has been done twice,
# as the vendor's code does; a digital line has a direction only after port control; a line that
# is driven with 1 is let go.

#: Bytes that the results FIFO holds (unknown).
FIFO_BYTES = 65_536
OVERRUN, SCANNING, PIPE_FULL = 0x0004, 0x0008, 0x0010
#: Words of the mark register that prove the bit-stream; all must be written and read.
MARKS = frozenset({0xFE, 0x02, 0xFB, 0x08, 0xEF, 0x20, 0xBF, 0x80})
#: Port control word that makes the digital lines a port.
_PORT = 0x30


class Fpga:
    """As it is after its bit-stream came in.

    Parameters
    ----------
    edges : callable
        ``edges(out)`` writes where the encoders stand now, in quarter lines (8,).
    per_turn : int
        Quarter lines a turn of the encoders.
    now_ns : int
        Time [ns].

    Attributes
    ----------
    fifo : bytearray
        Results that wait.
    running : bool
        Scans.
    endpoint_reset : bool
        Whether the host has reset the endpoint of the stream.
    initialised : int
        How often the whole initialisation was done.
    outside : int
        What the world does to the eight digital lines: 0 pulls a line to ground.
    """

    def __init__(
        self, edges: Callable[[NDArray[np.float64]], None], per_turn: int, now_ns: int
    ) -> None:
        self._edges, self._per_turn, self.now_ns = edges, per_turn, now_ns
        self.registers = np.zeros(256, np.int64)
        self.modes = np.zeros(8, np.int64)
        self.totals = np.zeros((8, 2), np.int64)
        self._modulo = np.full((8, 3), 0xFFFF, np.int64)
        self._bank = 0
        self._place, self._before = np.zeros(8), np.zeros(8)
        edges(self._place)
        self.totals[:, 0] = np.floor(self._place)
        self._latched = 0
        self.fifo = bytearray()
        self._status = 0
        self._armed = self._dma = self.running = self._virgin = False
        self._next_ns = 0.0
        self._list: list[int] = []
        self._scanned = np.zeros(0, np.int64), 1
        self._pace_ns = 0.0
        self._internal = self.endpoint_reset = False
        self.initialised, self._proven, self._quiet = 0, set[int](), False
        self.outside, self._outputs, self._driven = 0xFF, 0x00, 0x00

    def tick(self, now_ns: int, muted: bool) -> None:
        """The world is at `now_ns`: count, and scan unless `muted`."""
        before, then = self._before, self.now_ns
        before[:] = self._place
        self._edges(self._place)
        self.now_ns = now_ns
        if self.running and not muted:
            self._scan(before, then, now_ns)
        settle(self.totals, self.modes, self._place, self._per_turn)

    def _scan(self, before: NDArray[np.float64], then: int, now: int) -> None:
        """All scans that are due in (then, now]."""
        n = int((now - self._next_ns) // self._pace_ns) + 1 if now >= self._next_ns else 0
        if n <= 0 or now <= then:
            return
        channels, words = self._scanned
        out = np.zeros(n * len(channels) * words, np.uint16)
        length = now - then
        scans(
            self.totals,
            self.modes,
            before,
            self._place,
            (self._next_ns - then) / length,
            self._pace_ns / length,
            n,
            channels,
            words,
            self._per_turn,
            self._virgin,
            out,
        )
        self._virgin = False
        self._next_ns += n * self._pace_ns
        if len(self.fifo) + 2 * out.size > FIFO_BYTES:
            self._status |= OVERRUN
            self.running = False
            return
        self.fifo += out.tobytes()

    def _entries(self) -> tuple[NDArray[np.int64], int]:
        """Channels of the scan list, in order, and words of each."""
        found = [w >> 4 & 0x7F for w in self._list[::2]]
        order = list(dict.fromkeys(found))
        return np.array(order, np.int64), len(found) // len(order)

    def read(self, register: int) -> int:
        """Word of a register."""
        if register == 0x00:
            data = 0x0002 if self.fifo else 0
            return self._status | data | (SCANNING if self.running else 0)
        if 0x30 <= register <= 0x32:
            if register == 0x30:  # the low word latches the whole count
                self._latched = int(self.totals[self._bank & 7, 1]) % _SPAN
            return self._latched >> 16 * (register - 0x30) & 0xFFFF
        if register == 0x22:
            # pull-ups; outputs are open collectors
            return self.outside & (self._driven | ~self._outputs) & 0xFF
        if register == 0x5D:
            self._proven.add(int(self.registers[register]) & 0xFF)
        return int(self.registers[register & 0xFF]) & 0xFFFF

    def write(self, register: int, value: int) -> None:
        """Take a word, and do what it asks for."""
        self.registers[register & 0xFF] = value
        if register == 0x00:
            self._acquire(value)
        elif register == 0x01:
            self._list.append(value)
        elif register == 0x2E:
            self._bank = value
        elif register == 0x28:
            self._mode(value)
        elif register == 0x22:
            self._driven = value & 0xFF
        elif register == 0x23 and self.registers[0x18] == _PORT:
            self._outputs = value & 0xFF
        elif register == 0x10 and value == 0x0004:
            self._quiet = self._proven >= MARKS
        elif register == 0x58:
            self._initialise(value)
            self._dma = value == 0x11 or (self._dma and value not in (0x10, 0x00))
        elif register in (0x02, 0x03, 0x05):
            words = [int(self.registers[r]) for r in (0x02, 0x03, 0x05)]
            divisor = words[0] | words[1] << 16 | words[2] << 32
            self._pace_ns = (divisor + 1) / 0.048

    def _initialise(self, value: int) -> None:
        """The last word of an initialisation, if all before it came: marks, converters, stop."""
        if value == 0x10 and self._quiet and self.registers[0x59] == 0x0010:
            self.initialised += 1
            self._proven.clear()
            self._quiet = False

    def _mode(self, value: int) -> None:
        """Mode word of the selected counter, which resets it; or a word of its limit."""
        channel, part = self._bank & 0x0F, self._bank >> 4
        if channel > 7:
            return
        if part:
            self._modulo[channel, part - 1] = value
            return
        self.modes[channel] = value
        self.totals[channel] = int(self._place[channel] // 1), 0

    def _acquire(self, command: int) -> None:
        """Commands of the acquisition; a scan starts only after everything that it needs."""
        if 0 < command < 0x0008:  # resets, which may come together
            if command & 0x0004:
                self._list = []
            if command & 0x0002:
                self.fifo.clear()
                self._status = 0
        elif command in (0x0010, 0x0000):
            self.running = self._armed = False
            self._status &= ~PIPE_FULL
        elif command == 0x0060:
            self._internal = True
        elif command == 0x0011:
            good = self._list and self.endpoint_reset and self._dma and self._pace_ns > 0
            self._armed = bool(good) and self.initialised >= 2 and self._synchronous()
            self._status |= PIPE_FULL if self._armed else 0
        elif command == 0x0031 and self._armed and self._internal:
            self.running = self._virgin = True
            self._scanned = self._entries()
            self._next_ns = self.now_ns + self._pace_ns
        elif command == 0x0030:
            self.running = False

    def _synchronous(self) -> bool:
        """Whether every scanned counter is an encoder in scanning mode, and the list ends."""
        channels = {w >> 4 & 0x7F for w in self._list[::2]}
        ends = [bool(w & 4) for w in self._list[::2]]
        modes = [int(self.modes[c]) for c in channels if c < 8]
        proper = len(modes) == len(channels) and all(m & 7 == 5 and not m & 0x2000 for m in modes)
        return proper and ends[-1] and not any(ends[:-1])


#: Bytes of the real bit-stream without its header.
FPGA_BYTES = 212_410
_PACKET = 512
#: The firmware takes this long to come up [ns].
BOOT_NS = 1_500_000_000


class SimQuad08:
    """One box.

    Parameters
    ----------
    serial : str
        Serial number.
    edges : callable
        ``edges(out)`` writes where the encoders stand now, in quarter lines (8,).
    cold : bool
        Has neither firmware nor FPGA, as after power-up.
    per_turn : int
        Quarter lines a turn of the encoders.

    Attributes
    ----------
    ram : dict
        Address -> byte, as loaded.
    muted : bool
        Takes requests, answers none, sends no data.
    garbled : int
        Words of the stream to be lost.
    """

    vendor = 0x09DB
    endpoints: tuple[tuple[int, int, int], ...] = ((0x82, 2, _PACKET),)

    def __init__(
        self,
        serial: str,
        edges: Callable[[NDArray[np.float64]], None],
        cold: bool = False,
        per_turn: int = 4096,
    ) -> None:
        self.strings = ("MCC", "USB-QUAD08", serial)
        self.plugged = self.readable = True
        self.muted, self.garbled = False, 0
        self._edges, self._per_turn = edges, per_turn
        self.now_ns = 0
        self.fpga_size = FPGA_BYTES
        self.power_up(cold)

    def power_up(self, cold: bool) -> None:
        """Lose everything; come up with or without firmware."""
        self.product = 0x0470 if cold else 0x00CA
        self.version, self.configured = 0x0101, not cold
        self.ram: dict[int, int] = {}
        self._held = self._stage_one = False
        self._boot_at = -1
        self._image = 0
        self.fpga = Fpga(self._edges, self._per_turn, self.now_ns)

    def tick(self, now_ns: int) -> None:
        """The world is at `now_ns`: boot, count, scan."""
        if 0 <= self._boot_at <= now_ns:
            self._boot_at, self.plugged, self.product = -1, True, 0x00CA
        self.now_ns = now_ns
        self.fpga.tick(now_ns, self.muted)

    def control(self, kind: int, request: int, value: int, index: int, data: array[int]) -> int:
        """Vendor requests; anything unknown stalls."""
        if self.muted:
            raise failure(errno.ETIMEDOUT)
        cold = self.product == 0x0470
        if kind == 0x40 and request == 0xA0 and cold:
            return self._load(value, data)
        if kind == 0xC0 and request == 0xB0 and not cold:
            return self._reply(data, self.version, 2)
        if request == 0xB2 and not cold:
            return self._fpga_state(kind, data)
        if kind == 0x40 and request == 0xB3 and not cold and 0 < len(data) <= 2048:
            self._image += len(data)
            self.configured = self._image == self.fpga_size
            return len(data)
        if request == 0xB4 and self.configured:
            if kind == 0xC0:
                return self._reply(data, self.fpga.read(index), 2)
            self.fpga.write(index, value)
            return 0
        if kind == 0x40 and request == 0xBB and self.configured and (value, index) == (1, 2):
            self.fpga.endpoint_reset = True
            return 0
        raise failure(errno.EPIPE)

    @staticmethod
    def _reply(data: array[int], value: int, length: int) -> int:
        for k in range(min(length, len(data))):
            data[k] = value >> 8 * k & 0xFF
        return min(length, len(data))

    def _load(self, address: int, data: array[int]) -> int:
        """RAM of the controller, and its reset; external RAM only through the first stage."""
        if address == 0xE600:
            released = self._held and not data[0]
            self._held = bool(data[0])
            if released and self._stage_one and any(a > 0x3FFF for a in self.ram):
                self.plugged, self._boot_at = False, self.now_ns + BOOT_NS
            elif released and self.ram:
                self._stage_one = True
            return len(data)
        outside = address > 0x3FFF
        if len(data) > 16 or (not self._held and not outside) or (outside and not self._stage_one):
            raise failure(errno.EPIPE)
        for k, byte in enumerate(data):
            self.ram[address + k] = byte
        return len(data)

    def _fpga_state(self, kind: int, data: array[int]) -> int:
        if kind == 0xC0:
            return self._reply(data, int(self.configured), 1)
        self._image, self.configured = 0, False
        return 0

    def read(self, endpoint: int, buffer: array[int] | memoryview) -> int:
        """Whole packets of the FIFO."""
        fifo = self.fpga.fifo
        if len(buffer) % _PACKET:
            raise failure(errno.EOVERFLOW)
        if self.muted:
            return 0
        if self.garbled and fifo:
            self.garbled -= 1
            del fifo[:2]
        n = min(len(fifo), len(buffer)) // _PACKET * _PACKET
        if n:
            memoryview(buffer)[:n] = fifo[:n]
            del fifo[:n]
        return n

    def halt_cleared(self, endpoint: int) -> None:
        """Nothing to do: the endpoint does not stall."""


def put(wired: Any, name: str, row: dict[str, Any]) -> SimQuad08:
    """Box of a rig file on the bus of a bench, cabled to its encoders."""
    box = SimQuad08(row["address"] or f"SIM-{name}", wired.encoders(row["cables"]))
    wired.usb.devices.append(box)
    wired.bench.after.append(box.tick)
    return box
