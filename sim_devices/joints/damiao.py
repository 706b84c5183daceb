"""A Damiao drive on a simulated CAN line: its frames, registers, time-out, and faults.

Written from the manual of DM-J4310-2EC (V1.1), without the driver's codec.
Not simulated: the gains of MIT mode (any but zero is a fault here), temperatures, saving to flash.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from hil.sim_devices.canbus.line import CanFrame, Node
from hil.sim_devices.joints.bench import TOP_POSITION, TOP_WORD, JointBench

#: Time in which a drive answers [ns].
ANSWER_NS = 20_000
_SPECIAL = b"\xff" * 7
_ALL = 0x7FF


class SimDrive(Node):
    """One drive.

    Parameters
    ----------
    ident, master : int
        Identifier of commands, and what answers add to it.
    bit_rate : int
        [bit/s].
    arm : SimArm
        The arm that it moves.
    joint, sign : int
        Its joint, and 1 or -1 where it turns the other way.

    Attributes
    ----------
    silent, spoilt : bool
        Takes commands and answers none; spoils the next answer.
    fault : int
        Status that it reports instead of on or off; 0 for none.
    """

    def __init__(
        self, ident: int, master: int, bit_rate: int, arm: Any, joint: int, sign: int
    ) -> None:
        super().__init__(bit_rate)
        self.ident, self.master = ident, master
        self._arm, self._joint, self._sign = arm, joint, sign
        self.silent = self.spoilt = False
        self.fault = 0
        self._heard_ns = 0
        self.registers: dict[int, bytes] = {
            7: struct.pack("<I", master + ident),
            8: struct.pack("<I", ident),
            9: struct.pack("<I", 0),
            10: struct.pack("<I", 1),
        }
        for rid, value in zip((21, 22, 23), arm.kinds[joint].ranges, strict=True):
            self.registers[rid] = struct.pack("<f", value)

    @property
    def on(self) -> bool:
        """Whether it gives torque."""
        return bool(self._arm.powered[self._joint])

    def _switch(self, on: bool) -> None:
        self._arm.powered[self._joint] = on
        self._arm.codes[self._joint] = 0

    def cut(self, powered: bool) -> None:
        """Cut its supply, or give it back; the motor is then off."""
        self.powered = powered
        self._switch(False)
        self.outbox.clear()
        self.fault = 0

    def hear(self, frame: CanFrame, t_ns: int) -> None:
        """A command, or something about registers."""
        data = frame.data
        if frame.ident == _ALL and len(data) >= 4:
            if struct.unpack_from("<H", data)[0] == self.ident:
                self._about(data, t_ns)
        elif frame.ident == self.ident and len(data) == 8:
            self._heard_ns = t_ns
            if data[:7] == _SPECIAL:
                self._obey(data[7])
            elif self.on:
                self._torque(data)
            self._answer(t_ns)

    def _about(self, data: bytes, t_ns: int) -> None:
        what, rid = data[2], data[3]
        if what == 0xCC:
            self._answer(t_ns)
            return
        if what == 0x55 and rid in self.registers and len(data) == 8:
            self.registers[rid] = bytes(data[4:])
        if what in (0x33, 0x55) and rid in self.registers:
            self._put(bytes(data[:4]) + self.registers[rid], t_ns)

    def _obey(self, what: int) -> None:
        if what == 0xFC and not self.fault:
            self._switch(True)
        elif what == 0xFD:
            self._switch(False)
        elif what == 0xFB:
            self.fault = 0

    def _torque(self, data: bytes) -> None:
        """MIT mode: kp and kd are 12 bits each from byte 3 on, torque the last 12 bits."""
        bits = int.from_bytes(data, "big")
        kp, kd, torque = bits >> 24 & 0xFFF, bits >> 12 & 0xFFF, bits & 0xFFF
        if kp or kd:
            self.fault = 0xE
            self._switch(False)
            return
        self._arm.codes[self._joint] = self._sign * (2 * torque - TOP_WORD)

    def _answer(self, t_ns: int) -> None:
        arm, j = self._arm, self._joint
        position = (self._sign * arm.counts.item(j) + TOP_POSITION) // 2
        speed = (self._sign * arm.rates.item(j) + TOP_WORD) // 2
        torque = (self._sign * arm.codes.item(j) + TOP_WORD) // 2
        position = min(max(position, 0), TOP_POSITION)
        speed = min(max(speed, 0), TOP_WORD)
        status = self.fault or int(self.on)
        bits = (status << 4 | self.ident & 0xF) << 56
        bits |= position << 40 | speed << 28 | torque << 16 | 35 << 8 | 32
        self._put(bits.to_bytes(8, "big"), t_ns)

    def _put(self, data: bytes, t_ns: int) -> None:
        if self.silent:
            return
        if self.spoilt:
            self.spoilt, data = False, data[:5]
        self.outbox.append((t_ns + ANSWER_NS, CanFrame(self.master + self.ident, data)))

    def tick(self, now_ns: int) -> None:
        """Its own time-out: silence of the host switches it off."""
        limit = struct.unpack("<I", self.registers[9])[0] * 50_000
        if limit and self.on and now_ns - self._heard_ns > limit:
            self.fault = 0xD
            self._switch(False)


def put(bench: JointBench, name: str, row: Mapping[str, Any]) -> None:
    """Drives of a box of a rig file, on their CAN line."""
    line = bench.line(row["address"] or "can0")
    options, bench.drives[name] = row["options"], []
    for channel, _, arm, joint, sign in row["cables"]:
        drive = SimDrive(
            channel,
            int(options.get("master", 0x10)),
            int(options.get("bit_rate", 1_000_000)),
            bench.arms[arm],
            joint,
            sign,
        )
        line.attach(drive)
        bench.drives[name].append(drive)
