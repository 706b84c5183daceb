"""The board of `serial_mcu` from its side of the wire, with an arm that stands where told."""

import numpy as np

from hil.testing import FarEnd

GEAR = np.array([13.3, 11.2, 11.2])


class SimulatedMcu(FarEnd):
    here, silent, spoilt = True, False, 0

    def __call__(self, address, baud, timeout):  # stands in for serial.Serial
        self.codes, self.heard, self.out = np.zeros(3), b"", b""
        self.write(b"")
        return self

    def write(self, data):
        if not self.here:
            raise OSError(5, "Input/output error")
        self.heard += data
        while len(self.heard) >= 9:
            one, self.heard = self.heard[:9], self.heard[9:]
            if one[0] == 0xA5 and sum(one[:8]) % 256 == one[8]:
                self.codes = np.frombuffer(one, "<i2", 3, 2) * float(one[1])
                counts = np.floor(self.pose * GEAR * 4096 / (2 * np.pi)).astype("<i4")
                answer = b"\x5a" + counts.tobytes()
                answer += bytes([(sum(answer) + self.spoilt) % 256])
                self.out, self.spoilt = self.out + answer * (not self.silent), 0

    @property
    def in_waiting(self):
        self.write(b"")
        return len(self.out)

    def read(self, size):
        data, self.out = self.out[:size], self.out[size:]
        return data

    def close(self):
        pass  # the host lets the port go

    # what check_driver does to it: `pose` is where the joints stand
    def place(self, position):
        self.pose = position.copy()

    def effort(self):
        return self.codes * GEAR * 0.0234 * 0.5513 * 10 / 32768

    def unplug(self):
        self.here, self.codes = False, np.zeros(3)

    def replug(self):
        self.here = True

    def mute(self, on):
        self.silent = on

    def garble(self):
        self.spoilt = 1
