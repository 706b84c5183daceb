"""The FPGA of a simulated USB-QUAD08: registers, counters, scan list and results FIFO.

Written from the protocol notes alone (registers, states and order of ULDAQ 1.2.1).  Where they are
silent it does the least: it scans only after the whole initialisation has been done twice, as the
vendor's code does; a digital line has a direction only after port control; a line that is driven
with 1 is let go.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hil.sim_devices.usb import counters

#: Bytes that the results FIFO holds (unknown).
FIFO_BYTES = 65_536
OVERRUN, SCANNING, PIPE_FULL = 0x0004, 0x0008, 0x0010
#: Words of the mark register that prove the bit-stream; all must be written and read.
MARKS = frozenset({0xFE, 0x02, 0xFB, 0x08, 0xEF, 0x20, 0xBF, 0x80})
#: Port control word that makes the digital lines a port.
PORT = 0x30


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
        counters.settle(self.totals, self.modes, self._place, self._per_turn)

    def _scan(self, before: NDArray[np.float64], then: int, now: int) -> None:
        """All scans that are due in (then, now]."""
        n = int((now - self._next_ns) // self._pace_ns) + 1 if now >= self._next_ns else 0
        if n <= 0 or now <= then:
            return
        channels, words = self._scanned
        out = np.zeros(n * len(channels) * words, np.uint16)
        length = now - then
        counters.scans(
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
                self._latched = int(self.totals[self._bank & 7, 1]) % counters.SPAN
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
        elif register == 0x23 and self.registers[0x18] == PORT:
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
