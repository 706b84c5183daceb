"""Damiao actuators on one CAN bus, a box whose channels are their identifiers.

First the frames of MIT mode, bytes to words and back without I/O; then the bus: drives are asked
every tick, watched, switched on and off.

A command goes to the identifier of the drive, the answer comes from its master identifier.  Words
are unsigned; here they are halves of a step about zero, c = 2 w - top, so that turning a sign is
exact: position c PMAX / 65535, speed c VMAX / 4095, effort c TMAX / 4095.

Sources: manual of DM-J4310-2EC V1.1 ("MIT mode", "Feedback frame"); the vendor's DM_Control and
enactic/openarm_can, both MIT-licensed, agree with it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil.drivers.links.can import CanLink, can_frame, shared_link
from hil.errors import ConfigError, DeviceError
from hil.signals.bus import Bus
from hil.signals.device import IntArray, Status

#: Largest words: 16 bits of position, 12 of speed, gains and effort.
_TOP_POSITION, _TOP = 0xFFFF, 0xFFF
#: Last byte of eight, after seven times 0xff.
ENABLE, DISABLE, ZERO, CLEAR_FAULT = 0xFC, 0xFD, 0xFE, 0xFB
#: Identifier of everything about registers; the drive is named in the data.
REGISTERS = 0x7FF
READ, WRITE, REFRESH = 0x33, 0x55, 0xCC
#: Registers: silence after which the drive stops [50 us], mode, ranges of the words.
TIMEOUT, MODE_REGISTER, PMAX, VMAX, TMAX = 9, 10, 21, 22, 23
TIMEOUT_UNIT = 50e-6
MIT_MODE = 1
#: What the upper half of the first byte of an answer says.
_OFF, _ON = 0, 1
_FAULTS = {
    0x8: "over-voltage",
    0x9: "under-voltage",
    0xA: "over-current",
    0xB: "the driver stage is too hot",
    0xC: "the winding is too hot",
    0xD: "no command came for the time-out of the drive",
    0xE: "overload",
}


class Feedback(NamedTuple):
    """One answer: drive, its status, words about zero, temperatures [degC]."""

    drive: int
    status: int
    position: int
    speed: int
    effort: int
    stage: int
    winding: int


class Register(NamedTuple):
    """Value of a register, as its four bytes."""

    drive: int
    register: int
    raw: bytes

    @property
    def number(self) -> float:
        """As a float."""
        return float(struct.unpack("<f", self.raw)[0])

    @property
    def integer(self) -> int:
        """As an unsigned integer."""
        return int(struct.unpack("<I", self.raw)[0])


def unsigned(centred: int, top: int) -> int:
    """Unsigned word of a number of half steps about zero, the nearest one there is."""
    return (min(max(centred, -top), top) + top + (centred > 0)) // 2


def effort_command(effort: int) -> bytes:
    """Effort in half steps; both gains are zero, so position and speed asked for mean nothing."""
    w = unsigned(effort, _TOP)
    # p 16, v 12, kp 12, kd 12, t 12 bits, each from the top; p and v stand at their middle
    return bytes((0x7F, 0xFF, 0x7F, 0xF0, 0x00, 0x00, w >> 8, w & 0xFF))


def special(what: int) -> bytes:
    """`ENABLE`, `DISABLE`, `ZERO` or `CLEAR_FAULT`."""
    return b"\xff" * 7 + bytes((what,))


def refresh(drive: int) -> bytes:
    """Asks for an answer and commands nothing; goes to `REGISTERS`."""
    return struct.pack("<HBB4x", drive, REFRESH, 0)


def read_register(drive: int, register: int) -> bytes:
    """Asks for a register; goes to `REGISTERS`."""
    return struct.pack("<HBB4x", drive, READ, register)


def write_register(drive: int, register: int, value: int) -> bytes:
    """Sets a register that holds an integer, until the supply goes; goes to `REGISTERS`."""
    return struct.pack("<HBBI", drive, WRITE, register, value)


def feedback(data: bytes) -> Feedback | None:
    """An answer to a command; None where the bytes are none."""
    if len(data) != 8:
        return None
    first, p1, p0, v, vt, t, stage, winding = data
    return Feedback(
        first & 0xF,
        first >> 4,
        2 * (p1 << 8 | p0) - _TOP_POSITION,
        2 * (v << 4 | vt >> 4) - _TOP,
        2 * ((vt & 0xF) << 8 | t) - _TOP,
        stage,
        winding,
    )


def register(data: bytes) -> Register | None:
    """An answer about a register; None where the bytes are none."""
    if len(data) != 8 or data[2] not in (READ, WRITE):
        return None
    drive, _, which = struct.unpack_from("<HBB", data)
    return Register(drive, which, data[4:])


#: Bits of a command and its answer, stuff bits and gaps included at their most.
ROUND_BITS = 2 * 135
#: Highest identifier of a drive: an answer has four bits for it.
MOST_DRIVE = 15


@dataclass(frozen=True)
class DamiaoBusConfig:
    """Options of the box ``damiao-can``.

    Parameters
    ----------
    interface : str
        python-can's interface on hardware.
    bit_rate : int
        Of the bus [bit/s]; the drives leave the works at 1 Mbit/s.
    master : int
        What is added to the identifier of a drive in that of its answers (register MST_ID).
    answer_ms : float
        Wait for an answer while opening and switching on.
    lost_ms : float
        Silence of a drive after which it is lost.
    timeout_ms : float
        Silence of the host after which a drive switches off by itself; 0 leaves what is set in
        the drive.
    """

    interface: str = "socketcan"
    bit_rate: int = 1_000_000
    master: int = 0x10
    answer_ms: float = 20.0
    lost_ms: float = 20.0
    timeout_ms: float = 50.0

    def __post_init__(self) -> None:
        if min(self.answer_ms, self.lost_ms) <= 0 or self.timeout_ms < 0 or self.bit_rate <= 0:
            raise ConfigError("answer_ms, lost_ms and bit_rate are above 0, timeout_ms from 0 on.")
        if not MOST_DRIVE < self.master <= 0x7FF - MOST_DRIVE - 1:
            raise ConfigError(
                f"master = {self.master:#x}: from 0x10 on is needed, so that no answer has the "
                "identifier of a drive, and below 0x7f0."
            )

    def rate_hz(self, drives: int) -> float:
        """How often so many drives can be asked on one bus [Hz]."""
        return self.bit_rate / (ROUND_BITS * max(1, drives))


_OK, _STALE, _LOST = Status.OK, Status.STALE, Status.LOST


class DamiaoBus:
    """Drives of one bus; see `hil.rig.boxes.DrivesBox`.

    Parameters
    ----------
    name : str
        Box.
    link : CanLink
        Open bus.
    bus : Bus
        For its time.
    config : DamiaoBusConfig
        Options.
    drives : tuple of int
        Identifiers.

    Attributes
    ----------
    counts, rates, efforts : ndarray (drives,) of int
        Last answers, in half steps about zero.
    scales : ndarray (drives, 3)
        Of half a step: position [rad], speed [rad/s], effort [N m]; as the drives say.
    windings : ndarray (drives,) of int
        Temperatures [degC].
    trouble : str
        Why the bus is lost; empty while it is not.
    malformed : int
        Answers that were none.
    """

    def __init__(
        self, name: str, link: CanLink, bus: Bus, config: DamiaoBusConfig, drives: tuple[int, ...]
    ) -> None:
        n = len(drives)
        self.name, self.channels, self.config = name, drives, config
        self._link, self._bus = link, bus
        self.counts, self.rates, self.efforts = (np.zeros(n, np.int64) for _ in range(3))
        self.windings, self.status = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self.scales = np.zeros((n, 3))
        self.trouble, self.malformed = "", 0
        self._on = False
        self._fresh = np.zeros(n, np.bool_)
        self._heard_ns = np.zeros(n, np.int64)
        self._asked = False
        self._register: Register | None = None
        self._refresh = [can_frame(REGISTERS, refresh(i)) for i in drives]
        self._off = [can_frame(i, special(DISABLE)) for i in drives]
        self._command = [can_frame(i, effort_command(0)) for i in drives]
        for k, drive in enumerate(drives):
            at = config.master + drive
            link.subscribe(range(at, at + 1), self._mailbox(k))

    def _mailbox(self, k: int) -> Callable[[int, bytes], None]:
        drive = self.channels[k]

        def hear(identifier: int, data: bytes) -> None:
            told = register(data) if self._register_awaited else None
            if told is not None and told.drive == drive:
                self._register = told
                return
            said = feedback(data)
            if said is None or said.drive != drive & 0xF:
                self.malformed += 1
                return
            self.counts[k], self.rates[k], self.efforts[k] = said.position, said.speed, said.effort
            self.windings[k], self.status[k] = said.winding, said.status
            self._fresh[k] = True

        return hear

    _register_awaited = False

    def set_up(self) -> None:
        """Ask every drive for its scales and its mode, and give it its time-out.

        Raises
        ------
        DeviceError
            If one is silent, or not in MIT mode.
        """
        for k, drive in enumerate(self.channels):
            ranges = [self._read(drive, r).number for r in (PMAX, VMAX, TMAX)]
            if not all(0.0 < r < 1e4 for r in ranges):
                raise DeviceError(
                    f"box {self.name!r}: drive {drive} says that its ranges are {ranges}; set "
                    "PMAX, VMAX and TMAX with the vendor's tool"
                )
            self.scales[k] = np.array(ranges) / (_TOP_POSITION, _TOP, _TOP)
            mode = self._read(drive, MODE_REGISTER).integer
            if mode != MIT_MODE:
                raise DeviceError(
                    f"box {self.name!r}: drive {drive} is in mode {mode}, and 1 (MIT) is needed; "
                    "set CTRL_MODE with the vendor's tool"
                )
            if self.config.timeout_ms:
                ticks = round(self.config.timeout_ms * 1e-3 / TIMEOUT_UNIT)
                self._ask(drive, write_register(drive, TIMEOUT, ticks), TIMEOUT)
            self._fresh[k] = False
            self._link.post(self._refresh[k])
            if not self._wait(k):
                raise DeviceError(self._silent(drive))
        self._heard_ns[:] = self._bus.now_ns()

    def _read(self, drive: int, register: int) -> Register:
        return self._ask(drive, read_register(drive, register), register)

    def _ask(self, drive: int, data: bytes, register: int) -> Register:
        """Answer about a register, which is waited for."""
        self._register, self._register_awaited = None, True
        self._link.send(REGISTERS, data)

        def done() -> bool:
            told = self._told()
            return told is not None and told.register == register

        found = self._link.wait(self.config.answer_ms * 1e-3, done)
        self._register_awaited = False
        told = self._told()
        if not found or told is None:
            raise DeviceError(self._silent(drive))
        return told

    def _told(self) -> Register | None:
        """What a mailbox has taken of a register."""
        return self._register

    def _wait(self, k: int) -> bool:
        return self._link.wait(self.config.answer_ms * 1e-3, lambda: bool(self._fresh[k]))

    def _silent(self, drive: int) -> str:
        told = f" ({self._link.trouble})" if self._link.trouble else ""
        return (
            f"box {self.name!r}: drive {drive} on {self._link.bus.channel_info} does not answer "
            f"with identifier {self.config.master + drive:#x}{told}; look at its supply, the "
            "cable, the bit rate, ESC_ID and MST_ID"
        )

    def receive(self, t_ns: int) -> Status:
        """Answers that have come until `t_ns`: STALE where one is missing, LOST after a while."""
        self._link.advance(t_ns)
        self._link.poll()
        if self.trouble:
            return _LOST
        status, lost_ns = _OK, round(self.config.lost_ms * 1e6)
        for k, drive in enumerate(self.channels):
            if self._fresh[k]:
                self._heard_ns[k] = t_ns
                said = self.status.item(k)
                if self._on and said != _ON:
                    why = _FAULTS.get(said, f"it says status {said}, and was switched on")
                    self.trouble = f"{self.name}: drive {drive} stopped: {why}."
            elif self._asked:
                status = _STALE
                if t_ns - self._heard_ns.item(k) > lost_ns:
                    self.trouble = self._silent(drive)
            self._fresh[k] = False
        return _LOST if self.trouble else status

    def send(self, codes: IntArray) -> None:
        """Effort of every drive, in half steps; only asks for answers while it is off."""
        self._asked = True
        for k in range(len(self.channels)):
            if self._on:
                message = self._command[k]
                word = unsigned(codes.item(k), _TOP)
                message.data[6], message.data[7] = word >> 8, word & 0xFF
                self._link.post(message)
            else:
                # a full queue may have refused what switches it off: again until it says so
                off = self.status.item(k) == _OFF
                self._link.post(self._refresh[k] if off else self._off[k])

    def rest(self) -> None:
        """Switch all drives off as soon as the bus can; never waits."""
        if self._on:
            self._on = False
            for message in self._off:
                self._link.post(message)

    def power(self, on: bool) -> None:
        """Switch all drives on or off; waits for their answers, so never in the fast path.

        A drive that does not follow is lost.
        """
        if on and self._on:
            return
        self._on = False
        for k, drive in enumerate(self.channels):
            self.status[k] = -1
            if on:
                self._link.send(drive, special(CLEAR_FAULT))
            self._link.send(drive, special(ENABLE if on else DISABLE))
            wanted = _ON if on else _OFF
            if not self._reports(k, wanted) and on:
                why = _FAULTS.get(self.status.item(k), "")
                self.trouble = f"{self.name}: drive {drive} does not switch on{why and f': {why}'}."
                return
        self._on = on

    def _reports(self, k: int, status: int) -> bool:
        """Wait until a drive says that it is in this status; earlier answers may still come."""
        return self._link.wait(self.config.answer_ms * 1e-3, lambda: self.status.item(k) == status)

    def describe(self) -> str:
        """What the box is, for `hil devices`."""
        ranges = "; ".join(
            f"{drive}: {e * _TOP:.3g} N m, {v * _TOP:.3g} rad/s"
            for drive, (_, v, e) in zip(self.channels, self.scales.tolist(), strict=True)
        )
        return f"Damiao drives on {self._link.bus.channel_info} ({ranges})"

    def close(self) -> None:
        """Switch off and leave the bus."""
        self.power(False)
        for drive in self.channels:
            at = self.config.master + drive
            self._link.release(range(at, at + 1))


def open_box(
    name: str, bus: Bus, address: str, config: DamiaoBusConfig, channels: tuple[int, ...]
) -> DamiaoBus:
    """Open the drives of a channel, one channel of the box each: its identifier.

    Raises
    ------
    ConfigError
        If an identifier is not one of a drive.
    DeviceError
        If the bus or a drive is not there, or is not set as it must be.
    """
    wrong = [c for c in channels if not 1 <= c <= MOST_DRIVE]
    if wrong or not channels:
        raise ConfigError(
            f"box {name!r}: channels are the identifiers of drives, 1 to {MOST_DRIVE}, not "
            f"{wrong[0] if wrong else 'none'}."
        )
    link = shared_link(bus, config.interface, address or "can0", config.bit_rate)
    box = DamiaoBus(name, link, bus, config, channels)
    try:
        box.set_up()
    except OSError:
        box.close()
        raise
    return box


BUS = "can"
#: What the address of a box is, for messages.
ADDRESS = "the CAN channel, e.g. can0"
Config = DamiaoBusConfig

__all__ = ["BUS", "Config", "DamiaoBus", "DamiaoBusConfig", "open_box"]
