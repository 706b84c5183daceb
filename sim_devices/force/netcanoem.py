"""The firmware of an ATI 9105-NETCANOEM board, from its side of the wire (manual 1030-04).

Written from the manual and from frames recorded on a real board (protocol notes, 3.1); it shares
nothing with the driver.  Assumptions, where both are silent: an answer starts 60 us after the
request, a reset takes 5 ms, a request with a wrong length, axis or slot is not answered.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil.errors import ConfigError
from hil.sim_devices.canbus.line import CanFrame, Node
from hil.sim_devices.force.transducer import Certificate, SimulatedTransducer

LATENCY_NS = 60_000
RESET_NS = 5_000_000
DEFAULT_BASE, DEFAULT_BIT_RATE = 0x20, 250_000
#: A status word and three gauges, or three gauges; words of 16 bits, the high byte first.
_FOUR, _THREE = struct.Struct(">Hhhh").pack, struct.Struct(">hhh").pack
#: Diagnostic converter -> word, as read on a real board; how the thermistor's changes with
#: temperature is an assumption.
THERMISTOR = 2
DIAGNOSTICS = {0: 0x0201, THERMISTOR: 0x00B1, 3: 0x0118, 4: 0x001F, 5: 0x8009}
#: Bits of the status word.
_WATCHDOG, _BAD_CALIBRATION, _CAN_ERROR, _ANY_ERROR = 1 << 0, 1 << 6, 1 << 14, 1 << 15


@dataclass
class Faults:
    """What is wrong with a board; every field may be changed at any time.

    Parameters
    ----------
    mute : int
        Requests that will not be answered at all.
    lose_second, delay_second : int
        Answers whose second frame will be lost, or come `delay_ns` late.
    lose_first : int
        Answers whose first frame will be lost.
    twice_first, twice_second : int
        Answers whose first or second frame will be sent twice.
    short : int
        Answers whose frames will be one byte too short.
    delay_ns : int
        [ns].
    status : int
        Bits that are set in the status word.
    stuck : dict of int to int
        Gauge -> word that it stands at, e.g. ``{3: 32767}`` for a broken cable.
    """

    mute: int = 0
    lose_first: int = 0
    lose_second: int = 0
    delay_second: int = 0
    twice_first: int = 0
    twice_second: int = 0
    short: int = 0
    delay_ns: int = 4_000_000
    status: int = 0
    stuck: dict[int, int] = field(default_factory=dict)

    @property
    def counted(self) -> int:
        """Whether any fault of an answer's frames is left."""
        lost = self.lose_first or self.lose_second or self.delay_second
        return lost or self.twice_first or self.twice_second or self.short

    def strikes(self, name: str) -> bool:
        """Whether the fault that is counted in `name` strikes now; then it is counted down."""
        left: int = getattr(self, name)
        if left > 0:
            setattr(self, name, left - 1)
        return left > 0


class NetCanOemBoard(Node):
    """One board with its transducer.

    Parameters
    ----------
    transducer : Transducer
        The sensor on it.
    base, bit_rate : int
        As stored in its EEPROM.
    firmware : tuple of 3 int
        Major, minor, build; before 3.7 it ignores questions for units.
    slot : int
        Where the certificate of its transducer is stored; the others are empty.
    """

    def __init__(
        self,
        transducer: SimulatedTransducer,
        base: int = DEFAULT_BASE,
        bit_rate: int = DEFAULT_BIT_RATE,
        firmware: tuple[int, int, int] = (3, 8, 41),
        slot: int = 0,
    ) -> None:
        super().__init__(bit_rate)
        self.transducer = transducer
        self.firmware = firmware
        self.slots: dict[int, Certificate] = {slot: transducer.certificate}
        self.base, self.stored_base, self.stored_bit_rate = base, base, bit_rate
        self.switch_defaults = False
        self.active = 0
        self.faults = Faults()
        self._deaf_until_ns = 0
        #: (operation, length of the request) -> answer; anything else stays unanswered.
        self._answers: dict[tuple[int, int], Callable[[bytes, int], list[bytes]]] = {
            (0x0, 0): self._gauges,
            (0x2, 1): self._row,
            (0x5, 0): self._serial,
            (0x6, 1): self._select,
            (0x7, 0): self._counts,
            (0x8, 0): self._units,
            (0x9, 1): self._diagnostic,
            (0xC, 0): self._reset,
            (0xD, 1): self._set_base,
            (0xE, 1): self._set_bit_rate,
            (0xF, 0): self._version,
        }

    def power_cycle(self, t_ns: int) -> None:
        """Off and on: stored settings come into force, slot 0 is active again."""
        default = self.switch_defaults
        self.base = DEFAULT_BASE if default else self.stored_base
        self.bit_rate = DEFAULT_BIT_RATE if default else self.stored_bit_rate
        self.failures = 0
        self._restart(t_ns)

    def _restart(self, t_ns: int) -> None:
        self.active = 0
        self.outbox.clear()
        self._deaf_until_ns = t_ns + RESET_NS

    def hear(self, frame: CanFrame, t_ns: int) -> None:
        """Answer a request that is meant for this board."""
        ident, request = frame
        if ident >> 4 != self.base or t_ns < self._deaf_until_ns:
            return
        faults = self.faults
        if faults.mute and faults.strikes("mute"):
            return
        code, ready_ns = ident & 15, t_ns + LATENCY_NS
        answer = self._answers.get((code, len(request)))
        for payload in answer(request, t_ns) if answer else ():
            if code <= 1 and faults.counted:
                self._spoilt(code, payload, ready_ns)
            else:
                self.outbox.append((ready_ns, CanFrame(self.base << 4 | code, payload)))
            code += 1

    def _spoilt(self, code: int, payload: bytes, ready_ns: int) -> None:
        """A frame of a sample on its way out, past the faults."""
        faults = self.faults
        if faults.strikes("lose_second" if code else "lose_first"):
            return
        if code and faults.strikes("delay_second"):
            ready_ns += faults.delay_ns
        if faults.strikes("short"):
            payload = payload[:-1]
        frame = ready_ns, CanFrame(self.base << 4 | code, payload)
        self.outbox.append(frame)
        if faults.strikes("twice_second" if code else "twice_first"):
            self.outbox.append(frame)

    def status(self) -> int:
        """Status word now."""
        word = self.faults.status
        if self.active not in self.slots:
            word |= _BAD_CALIBRATION
        if self.failures >= 96:
            word |= _CAN_ERROR
        # on a real board every sample says 0x4000: trouble on the bus does not set the last bit
        return word | _ANY_ERROR if word & ~(_ANY_ERROR | _CAN_ERROR) else word

    def _gauges(self, request: bytes, t_ns: int) -> list[bytes]:
        g = self.transducer.read(t_ns).tolist()
        for k, word in self.faults.stuck.items():
            g[k] = word
        return [_FOUR(self.status(), g[0], g[2], g[4]), _THREE(g[1], g[3], g[5])]

    def _row(self, request: bytes, t_ns: int) -> list[bytes]:
        axis = request[0]
        if axis > 5:
            return []
        held = self.slots.get(self.active)
        row = held.matrix[axis] if held is not None else [0.0] * 6
        raw = b"".join(_single(float(x)) for x in row)
        return [raw[0:8], raw[8:16], raw[16:24]]

    def _serial(self, request: bytes, t_ns: int) -> list[bytes]:
        held = self.slots.get(self.active)
        return [(held.serial if held else "").encode("ascii").ljust(8, b"\x00")[:8]]

    def _select(self, request: bytes, t_ns: int) -> list[bytes]:
        if request[0] > 15:
            return []
        self.active = request[0]
        return [request]

    def _counts(self, request: bytes, t_ns: int) -> list[bytes]:
        held = self.slots.get(self.active)
        if self.firmware[:2] < (3, 7):
            return []
        pair = (held.force_counts, held.torque_counts) if held else (1_000_000, 1_000_000)
        return [b"".join(x.to_bytes(4, "big") for x in pair)]

    def _units(self, request: bytes, t_ns: int) -> list[bytes]:
        held = self.slots.get(self.active)
        if self.firmware[:2] < (3, 7):
            return []
        return [bytes([held.force_unit, held.torque_unit]) if held else bytes([2, 3])]

    def _diagnostic(self, request: bytes, t_ns: int) -> list[bytes]:
        if self.firmware[:2] < (3, 8) or request[0] not in DIAGNOSTICS:
            return []
        warm = round(40 * self.transducer.warming) if request[0] == THERMISTOR else 0
        return [(DIAGNOSTICS[request[0]] + warm).to_bytes(2, "big")]

    def _reset(self, request: bytes, t_ns: int) -> list[bytes]:
        self._restart(t_ns)
        return []

    def _set_base(self, request: bytes, t_ns: int) -> list[bytes]:
        self.stored_base = request[0] & 0x7F
        return [b""]

    def _set_bit_rate(self, request: bytes, t_ns: int) -> list[bytes]:
        self.stored_bit_rate = 2_000_000 // (request[0] + 1)
        return [b""]

    def _version(self, request: bytes, t_ns: int) -> list[bytes]:
        major, minor, build = self.firmware
        return [bytes([major, minor, build >> 8, build & 255])]


def _single(value: float) -> bytes:
    """IEEE 754 single precision, high byte first."""
    return np.array(value, ">f4").tobytes()


def place(address: str, base: int) -> tuple[str, int]:
    """Channel and base of ``CHANNEL/BASE``.

    Raises
    ------
    ConfigError
        If the base is not a number.
    """
    channel, _, text = (address or "can0").partition("/")
    try:
        return channel, int(text, 0) if text else base
    except ValueError:
        raise ConfigError(f"simulated board: {address!r} is not CHANNEL/BASE.") from None


def put(wired: Any, name: str, row: dict[str, Any]) -> NetCanOemBoard:
    """Board of a rig file at ``CHANNEL/BASE``, set as the driver expects it."""
    options = row["options"]
    channel, base = place(row["address"], int(options.get("base", DEFAULT_BASE)))
    board = NetCanOemBoard(
        wired.force.transducer(name, row["cables"]),
        base,
        options.get("bit_rate", 1_000_000),
        slot=options.get("calibration", 0),
    )
    wired.force.line(channel).attach(board)
    return board
