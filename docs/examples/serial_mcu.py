"""A microcontroller that counts three encoders and gives three voltages, over a serial port.

Host, every tick: A5, 1 = motors may run, three codes (int16), sum of the bytes before.
Board, at once:   5A, three counts (int32), sum of the bytes before.  All little-endian.
The board sets its outputs to zero when it has not been asked for 20 ms.
"""

import struct
from dataclasses import dataclass

import numpy as np
import serial

from hil.errors import DeviceError
from hil.signals.device import Status

BUS = "serial"
ASK, ANSWER = struct.Struct("<BB3hB"), struct.Struct("<B3iB")


@dataclass(frozen=True)
class Config:  # options in the rig file
    baud: int = 1_000_000
    stale_ms: float = 3.0
    lost_ms: float = 30.0


def checked(data):
    return data[:-1] + bytes([sum(data[:-1]) & 255])


class SerialMcu:
    channels = (0, 1, 2)
    heartbeat = True  # the board's own watchdog

    def __init__(self, name, bus, address, config, channels):
        self.name, self.serial, self.config, self.trouble = name, address, config, ""
        self.counts, self._codes, self._on = np.zeros(3, np.int64), [0, 0, 0], 0
        self._buffer, self._fresh_ns = b"", -1
        opener = bus.handle or serial.Serial  # a simulation hands in its own
        try:
            self._port = opener(address, config.baud, timeout=0)
            for _ in range(100):
                self._ask()
                bus.pause(1e-3)
                if self._read():
                    return
        except OSError as error:
            raise DeviceError(f"box {name!r}: {address}: {error}; plug the board in") from error
        self._port.close()
        raise DeviceError(f"box {name!r}: nothing answers on {address}; is it the right port?")

    def _ask(self):
        self._port.write(checked(ASK.pack(0xA5, self._on, *self._codes, 0)))

    def _read(self):  # whether a new whole answer has come; the newest is kept
        self._buffer, fresh = self._buffer + self._port.read(self._port.in_waiting), False
        while len(self._buffer) >= ANSWER.size:
            one = self._buffer[: ANSWER.size]
            if one[0] == 0x5A and checked(one) == one:
                self.counts[:] = ANSWER.unpack(one)[1:4]
                self._buffer, fresh = self._buffer[ANSWER.size :], True
            else:
                self._buffer = self._buffer[1:]  # look for the next start
        return fresh

    def receive(self, t_ns):  # in the fast path: never wait, never raise
        try:
            fresh = not self.trouble and self._read()
        except OSError as error:
            fresh, self.trouble = False, f"box {self.name!r}: {error}."
        if fresh or self._fresh_ns < 0:
            self._fresh_ns = t_ns
        age = (t_ns - self._fresh_ns) * 1e-6
        if age > self.config.lost_ms and not self.trouble:
            self.trouble = f"box {self.name!r}: no answer for {age:.0f} ms."
        stale = Status.STALE if age > self.config.stale_ms else Status.OK
        return Status.LOST if self.trouble else stale

    def put(self, channel, code):
        self._codes[channel] = code if self._on else 0
        if channel == 2:  # the last one of a tick sends all three, and asks
            self._send()

    def _send(self):
        try:
            self._ask()
        except OSError as error:
            self.trouble = f"box {self.name!r}: {error}."

    def power(self, on):
        self._on, self._codes = int(on), [0, 0, 0]
        self._send()

    def rest(self):
        self.power(False)

    def close(self):
        self.rest()
        self._port.close()


open_box = SerialMcu
