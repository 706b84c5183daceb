"""Firmware and FPGA of a simulated USB-QUAD08, register by register.

Written from the protocol notes alone (registers, states and order of ULDAQ 1.2.1); shares no
code with the driver.  Where the notes are silent it does the least: without its FPGA it stalls
every register request; data leave in full packets only.
"""

from __future__ import annotations

import errno
from array import array
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim_devices.usb import counters
from sim_devices.usb.backend import failure

#: Bytes of the real bit-stream without its header; bytes that the results FIFO holds (unknown).
FPGA_BYTES, FIFO_BYTES = 212_410, 65_536
PACKET = 512
#: The firmware takes this long to come up [ns].
BOOT_NS = 1_500_000_000
OVERRUN, SCANNING, PIPE_FULL = 0x0004, 0x0008, 0x0010


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
    endpoints: tuple[tuple[int, int, int], ...] = ((0x82, 2, PACKET),)

    def __init__(
        self, serial: str, edges: Callable[[NDArray[np.float64]], None], cold: bool = False,
        per_turn: int = 4096,
    ) -> None:  # fmt: skip
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
        self.registers = np.zeros(256, np.int64)
        self.modes = np.zeros(8, np.int64)
        self.totals = np.zeros((8, 2), np.int64)
        self._modulo = np.full((8, 3), 0xFFFF, np.int64)
        self._bank = 0
        self._place, self._before = np.zeros(8), np.zeros(8)
        self._edges(self._place)
        self.totals[:, 0] = np.floor(self._place)
        self._latched = 0
        self._stop()
        self._list: list[int] = []
        self._scanned = np.zeros(0, np.int64), 1
        self._pace_ns = 0.0
        self._internal = self._endpoint_reset = False

    def _stop(self) -> None:
        self._fifo = bytearray()
        self._status = 0
        self._armed = self._dma = self._running = self._virgin = False
        self._next_ns = 0.0

    # time

    def tick(self, now_ns: int) -> None:
        """The world is at `now_ns`: boot, count, scan."""
        if 0 <= self._boot_at <= now_ns:
            self._boot_at, self.plugged, self.product = -1, True, 0x00CA
        before, then = self._before, self.now_ns
        before[:] = self._place
        self._edges(self._place)
        self.now_ns = now_ns
        if self._running and not self.muted:
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
            self.totals, self.modes, before, self._place, (self._next_ns - then) / length,
            self._pace_ns / length, n, channels, words, self._per_turn, self._virgin, out,
        )  # fmt: skip
        self._virgin = False
        self._next_ns += n * self._pace_ns
        if len(self._fifo) + 2 * out.size > FIFO_BYTES:
            self._status |= OVERRUN
            self._running = False
            return
        self._fifo += out.tobytes()

    def _entries(self) -> tuple[NDArray[np.int64], int]:
        """Channels of the scan list, in order, and words of each."""
        found = [w >> 4 & 0x7F for w in self._list[::2]]
        order = list(dict.fromkeys(found))
        return np.array(order, np.int64), len(found) // len(order)

    # transfers

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
                return self._reply(data, self._read_register(index), 2)
            self._write_register(index, value)
            return 0
        if kind == 0x40 and request == 0xBB and self.configured and (value, index) == (1, 2):
            self._endpoint_reset = True
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

    # registers

    def _read_register(self, register: int) -> int:
        if register == 0x00:
            data = 0x0002 if self._fifo else 0
            return self._status | data | (SCANNING if self._running else 0)
        if 0x30 <= register <= 0x32:
            if register == 0x30:  # the low word latches the whole count
                self._latched = int(self.totals[self._bank & 7, 1]) % counters.SPAN
            return self._latched >> 16 * (register - 0x30) & 0xFFFF
        return int(self.registers[register & 0xFF]) & 0xFFFF

    def _write_register(self, register: int, value: int) -> None:
        self.registers[register & 0xFF] = value
        if register == 0x00:
            self._acquire(value)
        elif register == 0x01:
            self._list.append(value)
        elif register == 0x2E:
            self._bank = value
        elif register == 0x28:
            self._mode(value)
        elif register == 0x58:
            self._dma = value == 0x11 or (self._dma and value not in (0x10, 0x00))
        elif register in (0x02, 0x03, 0x05):
            words = [int(self.registers[r]) for r in (0x02, 0x03, 0x05)]
            divisor = words[0] | words[1] << 16 | words[2] << 32
            self._pace_ns = (divisor + 1) / 0.048

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
        if command == 0x0004:
            self._list = []
        elif command == 0x0003:
            self._fifo.clear()
            self._status = 0
        elif command in (0x0010, 0x0000):
            self._running = self._armed = False
            self._status &= ~PIPE_FULL
        elif command == 0x0060:
            self._internal = True
        elif command == 0x0011:
            good = self._list and self._endpoint_reset and self._dma and self._pace_ns > 0
            self._armed = bool(good) and self._synchronous()
            self._status |= PIPE_FULL if self._armed else 0
        elif command == 0x0031 and self._armed and self._internal:
            self._running = self._virgin = True
            self._scanned = self._entries()
            self._next_ns = self.now_ns + self._pace_ns
        elif command == 0x0030:
            self._running = False

    def _synchronous(self) -> bool:
        """Whether every scanned counter is an encoder in scanning mode, and the list ends."""
        channels = {w >> 4 & 0x7F for w in self._list[::2]}
        ends = [bool(w & 4) for w in self._list[::2]]
        modes = [int(self.modes[c]) for c in channels if c < 8]
        proper = len(modes) == len(channels) and all(m & 7 == 5 and not m & 0x2000 for m in modes)
        return proper and ends[-1] and not any(ends[:-1])

    # stream

    def read(self, endpoint: int, buffer: array[int] | memoryview) -> int:
        """Whole packets of the FIFO."""
        if len(buffer) % PACKET:
            raise failure(errno.EOVERFLOW)
        if self.muted:
            return 0
        if self.garbled and self._fifo:
            self.garbled -= 1
            del self._fifo[:2]
        n = min(len(self._fifo), len(buffer)) // PACKET * PACKET
        if n:
            memoryview(buffer)[:n] = self._fifo[:n]
            del self._fifo[:n]
        return n

    def halt_cleared(self, endpoint: int) -> None:
        """Nothing to do: the endpoint does not stall."""
