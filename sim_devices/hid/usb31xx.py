"""Firmware of a simulated USB-31xx: converters, sync, flash, digital lines, one report a frame.

Written from the protocol notes alone; shares no code with the driver.  What the notes leave
open: an unknown or short report is ignored; outputs are 0 V at power-up; the sync line is a slave
until told otherwise; a digital line that is wired to nothing reads 0; a block of the flash takes
what is written as NOR cells do, ones to zeros alone; the calibration is read at power-up.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from hil.sim_devices.hid.module import QUEUE

FRAME_NS = 1_000_000
PRODUCTS = {
    "usb-3101": (0x009A, 4),
    "usb-3103": (0x009C, 8),
    "usb-3105": (0x009E, 16),
    "usb-3110": (0x00A2, 4),
    "usb-3112": (0x00A3, 8),
    "usb-3114": (0x00A4, 16),
}
#: Spread of gain [1] and offset [codes] of the converters, which the flash corrects.
GAIN_SPREAD, OFFSET_SPREAD = 0.004, 40.0
#: Memory: free for the user, calibration, end; blocks and sectors of the flash; where the word that
#: unlocks the flash is written.
_FLASH, _MEMORY_END, _BLOCK, _SECTOR, _UNLOCK, _KEY = 0x100, 0x500, 32, 64, 0x500, 0xAA55
READ_MOST, WRITE_MOST = 62, 59


class Sim31xx:
    """One box.

    Parameters
    ----------
    model, serial : str
        Model and serial number.
    edge : callable, optional
        ``edge(bit, level, now_ns)`` is called when a digital output changes.
    seed : int
        Of its converters.

    Attributes
    ----------
    volts : ndarray (channels,)
        What stands at the terminals [V].
    executed : int
        Reports that have taken effect.
    muted : bool
        Takes reports, answers none.
    garbled : int
        Answers to come that are spoilt.
    outside : int
        Levels that the world puts on the eight digital lines.
    events : int
        Pulses that the counter has seen since it was zeroed.
    blinks : int
        How often the LED was told to blink.
    """

    def __init__(
        self,
        model: str,
        serial: str,
        edge: Callable[[int, int, int], None] | None = None,
        seed: int = 0,
    ) -> None:
        product, self.channels = PRODUCTS[model]
        self.descriptor: dict[str, Any] = {
            "path": f"sim-{serial}".encode(),
            "vendor_id": 0x09DB,
            "product_id": product,
            "serial_number": serial,
            "release_number": 0x0102,
            "manufacturer_string": "MCC",
            "product_string": model.upper(),
            "usage_page": 0xFF00,
            "usage": 1,
            "interface_number": 0,
        }
        rng = np.random.default_rng([seed, product, *serial.encode()])
        # the converter's own errors; the flash holds what corrects them
        self._gain = 1.0 + GAIN_SPREAD * rng.standard_normal(self.channels)
        self._offset = OFFSET_SPREAD * rng.standard_normal(self.channels)
        self.volts = np.zeros(self.channels)
        self._flash = self._calibration()
        self._eeprom = bytearray(_FLASH)
        self.outside = 0x00
        self._edge = edge
        #: Number -> length of the whole report (0: the report says it), action.
        self._actions: dict[int, tuple[int, Callable[[bytes], None]]] = {
            0x01: (2, self._direction_all),
            0x02: (3, self._direction_bit),
            0x03: (1, self._pins),
            0x04: (2, self._lines_all),
            0x05: (2, self._pin),
            0x06: (3, self._line),
            0x14: (5, self._aout),
            0x15: (1, self._sync),
            0x1C: (3, self._config),
            0x20: (1, self._zero_events),
            0x21: (1, self._told_events),
            0x30: (5, self._memory),
            0x31: (0, self._write),
            0x40: (2, self._blink),
            0x41: (1, self._reset),
            0x43: (2, self._set_sync),
            0x44: (1, self._state),
        }
        self.plugged = self.readable = True
        self.muted, self.garbled = False, 0
        self.now_ns = 0
        self.power_up()

    def power_up(self) -> None:
        """Forget everything but the flash."""
        self.inputs: deque[bytes] = deque(maxlen=QUEUE)
        self.volts[:] = 0.0
        self._staged: dict[int, int] = {}
        self._bipolar = [False] * self.channels
        self._master = False
        self._direction, self._lines = 0xFF, 0
        self.events = self.blinks = 0
        self._unlocked = False
        self._pending: deque[tuple[int, bytes]] = deque()
        self._free_ns = 0
        self.executed = 0

    def _calibration(self) -> bytearray:
        flash = bytearray(b"\xff" * 0x400)
        for c in range(self.channels):
            # k_terminal = gain k + offset, so that k = (k_ideal - offset) / gain
            pair = struct.pack("<ff", 1.0 / self._gain[c], -self._offset[c] / self._gain[c])
            for base in (0x000, 0x008):
                at = 0x10 * c + base
                flash[at : at + 8] = pair
        return flash

    def output(self, report: bytes) -> None:
        """A report is on its way; it takes effect a frame later, one after the other."""
        free = self._free_ns if self._free_ns > self.now_ns else self.now_ns
        self._free_ns = free + FRAME_NS
        self._pending.append((free + FRAME_NS, report))

    def tick(self, now_ns: int) -> bool:
        """It is `now_ns`: execute what has arrived; whether anything had."""
        self.now_ns = now_ns
        pending = self._pending
        if not pending or pending[0][0] > now_ns:
            return False
        while pending and pending[0][0] <= now_ns:
            self._execute(pending.popleft()[1])
            pending = self._pending  # a reset empties it
        return True

    def _execute(self, report: bytes) -> None:
        act = self._actions.get(report[0]) if report else None
        if act is None or (act[0] and len(report) != act[0]):
            return
        self.executed += 1
        act[1](report)

    def _aout(self, report: bytes) -> None:
        channel, value, on_sync = report[1], report[2] | report[3] << 8, report[4]
        if channel < self.channels and on_sync in (0, 1):
            if on_sync:
                self._staged[channel] = value
            else:
                if self._staged:
                    self._staged.pop(channel, None)
                self._convert(channel, value)

    def _sync(self, report: bytes) -> None:
        if self._master:
            for channel, value in self._staged.items():
                self._convert(channel, value)
            self._staged.clear()

    def _convert(self, channel: int, value: int) -> None:
        code = self._gain.item(channel) * value + self._offset.item(channel)
        if self._bipolar[channel]:
            self.volts[channel] = (code - 32768.0) / 32768.0 * 10.0
        else:
            self.volts[channel] = code / 65536.0 * 10.0

    def _config(self, report: bytes) -> None:
        channel, code = report[1], report[2]
        if channel < self.channels and code in (0, 1):
            self._bipolar[channel] = bool(code)
            self.volts[channel] = 0.0

    def _direction_all(self, report: bytes) -> None:
        self._direction = 0xFF if report[1] else 0x00

    def _direction_bit(self, report: bytes) -> None:
        mask = 1 << (report[1] & 7)
        self._direction = self._direction | mask if report[2] else self._direction & ~mask

    def _levels(self) -> int:
        """What stands on the lines: of the box where it drives them, of the world elsewhere."""
        return (self._lines & ~self._direction | self.outside & self._direction) & 0xFF

    def _pins(self, report: bytes) -> None:
        self._answer(bytes([0x03, self._levels()]))

    def _pin(self, report: bytes) -> None:
        self._answer(bytes([0x05, self._levels() >> (report[1] & 7) & 1]))

    def _lines_all(self, report: bytes) -> None:
        for bit in range(8):
            self._line(bytes([0x06, bit, report[1] >> bit & 1]))

    def _line(self, report: bytes) -> None:
        bit, level = report[1] & 7, report[2] & 1
        before = self._lines >> bit & 1
        self._lines = self._lines & ~(1 << bit) | level << bit
        if self._edge is not None and level != before and not self._direction >> bit & 1:
            self._edge(bit, level, self.now_ns)

    def count(self, pulses: int) -> None:
        """The event counter sees some pulses; it has 32 bits."""
        self.events = self.events + pulses & 0xFFFF_FFFF

    def _zero_events(self, report: bytes) -> None:
        self.events = 0

    def _told_events(self, report: bytes) -> None:
        self._answer(bytes([0x21]) + self.events.to_bytes(4, "little"))

    def _blink(self, report: bytes) -> None:
        self.blinks += report[1]

    def _memory(self, report: bytes) -> None:
        address, count = report[1] | report[2] << 8, min(report[4], READ_MOST)
        memory = self._eeprom + self._flash
        self._answer(bytes([0x30]) + memory[address : address + count].ljust(READ_MOST, b"\0"))

    def _write(self, report: bytes) -> None:
        """Memory: the user's at any address, the flash in whole blocks and unlocked alone."""
        address, data = int.from_bytes(report[1:3], "little"), report[4:]
        if not 4 < len(report) == 4 + report[3] or len(data) > WRITE_MOST:
            return
        if address == _UNLOCK:
            self._unlocked = self._unlocked or data == _KEY.to_bytes(2, "little")
        elif address + len(data) <= _FLASH:
            self._eeprom[address : address + len(data)] = data
        elif _FLASH <= address < _MEMORY_END and self._unlocked:
            self._program((address & ~(_BLOCK - 1)) - _FLASH, data[:_BLOCK])

    def _program(self, at: int, data: bytes) -> None:
        """A block of the flash; its sector is erased before where the block is the first of it."""
        if not at & _BLOCK:
            self._flash[at : at + _SECTOR] = b"\xff" * _SECTOR
        for k, byte in enumerate(data):
            self._flash[at + k] &= byte

    def _state(self, report: bytes) -> None:
        self._answer(bytes([0x44, 1 if self._master else 0]))

    def _set_sync(self, report: bytes) -> None:
        self._master = report[1] == 0

    def _reset(self, report: bytes) -> None:
        self.plugged = False
        self.power_up()

    def _answer(self, report: bytes) -> None:
        if self.muted:
            return
        if self.garbled:
            self.garbled -= 1
            report = bytes([report[0] ^ 0x55]) + report[1:1]
        self.inputs.append(report)


def put(wired: Any, name: str, row: dict[str, Any]) -> Sim31xx:
    """Box of a rig file on the bus of a bench, cabled to its motors and amplifiers."""
    cables, model = row["cables"], row["options"].get("model", "usb-3101")
    box = Sim31xx(model, row["address"] or f"SIM-{name}", wired.watch(cables, name))
    wired.hid.devices.append(box)
    wired.bench.before.append(wired.motors(cables, box))
    if wired.amplifiers not in wired.bench.before:
        wired.bench.before.append(wired.amplifiers)
    return box
