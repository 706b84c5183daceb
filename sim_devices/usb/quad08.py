"""Firmware of a simulated USB-QUAD08: how it is loaded, vendor requests, and the stream.

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

from hil.sim_devices.usb.backend import failure
from hil.sim_devices.usb.quad08_fpga import Fpga

#: Bytes of the real bit-stream without its header.
FPGA_BYTES = 212_410
PACKET = 512
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
    endpoints: tuple[tuple[int, int, int], ...] = ((0x82, 2, PACKET),)

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
        if len(buffer) % PACKET:
            raise failure(errno.EOVERFLOW)
        if self.muted:
            return 0
        if self.garbled and fifo:
            self.garbled -= 1
            del fifo[:2]
        n = min(len(fifo), len(buffer)) // PACKET * PACKET
        if n:
            memoryview(buffer)[:n] = fifo[:n]
            del fifo[:n]
        return n

    def halt_cleared(self, endpoint: int) -> None:
        """Nothing to do: the endpoint does not stall."""
