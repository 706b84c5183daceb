"""Damiao actuators on one CAN bus: asked every tick, watched, switched on and off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hil.drivers.damiao_can import codec
from hil.drivers.links.can import CanLink, frame, shared
from hil.errors import ConfigError, DeviceError
from hil.signals.bus import Bus
from hil.signals.device import IntArray, Status

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
        self._register: codec.Register | None = None
        self._refresh = [frame(codec.REGISTERS, codec.refresh(i)) for i in drives]
        self._off = [frame(i, codec.special(codec.DISABLE)) for i in drives]
        self._command = [frame(i, codec.effort_command(0)) for i in drives]
        for k, drive in enumerate(drives):
            at = config.master + drive
            link.subscribe(range(at, at + 1), self._mailbox(k))

    def _mailbox(self, k: int) -> Callable[[int, bytes], None]:
        drive = self.channels[k]

        def hear(identifier: int, data: bytes) -> None:
            told = codec.register(data) if self._register_awaited else None
            if told is not None and told.drive == drive:
                self._register = told
                return
            said = codec.feedback(data)
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
            ranges = [self._read(drive, r).number for r in (codec.PMAX, codec.VMAX, codec.TMAX)]
            if not all(0.0 < r < 1e4 for r in ranges):
                raise DeviceError(
                    f"box {self.name!r}: drive {drive} says that its ranges are {ranges}; set "
                    "PMAX, VMAX and TMAX with the vendor's tool"
                )
            self.scales[k] = np.array(ranges) / (codec.TOP_POSITION, codec.TOP, codec.TOP)
            mode = self._read(drive, codec.MODE).integer
            if mode != codec.MIT_MODE:
                raise DeviceError(
                    f"box {self.name!r}: drive {drive} is in mode {mode}, and 1 (MIT) is needed; "
                    "set CTRL_MODE with the vendor's tool"
                )
            if self.config.timeout_ms:
                ticks = round(self.config.timeout_ms * 1e-3 / codec.TIMEOUT_UNIT)
                self._ask(drive, codec.write_register(drive, codec.TIMEOUT, ticks), codec.TIMEOUT)
            self._fresh[k] = False
            self._link.post(self._refresh[k])
            if not self._wait(k):
                raise DeviceError(self._silent(drive))
        self._heard_ns[:] = self._bus.now_ns()

    def _read(self, drive: int, register: int) -> codec.Register:
        return self._ask(drive, codec.read_register(drive, register), register)

    def _ask(self, drive: int, data: bytes, register: int) -> codec.Register:
        """Answer about a register, which is waited for."""
        self._register, self._register_awaited = None, True
        self._link.send(codec.REGISTERS, data)

        def done() -> bool:
            told = self._told()
            return told is not None and told.register == register

        found = self._link.wait(self.config.answer_ms * 1e-3, done)
        self._register_awaited = False
        told = self._told()
        if not found or told is None:
            raise DeviceError(self._silent(drive))
        return told

    def _told(self) -> codec.Register | None:
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
                if self._on and said != codec.ON:
                    why = codec.FAULTS.get(said, f"it says status {said}, and was switched on")
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
                word = codec.word(codes.item(k), codec.TOP)
                message.data[6], message.data[7] = word >> 8, word & 0xFF
                self._link.post(message)
            else:
                # a full queue may have refused what switches it off: again until it says so
                off = self.status.item(k) == codec.OFF
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
                self._link.send(drive, codec.special(codec.CLEAR))
            self._link.send(drive, codec.special(codec.ENABLE if on else codec.DISABLE))
            wanted = codec.ON if on else codec.OFF
            if not self._reports(k, wanted) and on:
                why = codec.FAULTS.get(self.status.item(k), "")
                self.trouble = f"{self.name}: drive {drive} does not switch on{why and f': {why}'}."
                return
        self._on = on

    def _reports(self, k: int, status: int) -> bool:
        """Wait until a drive says that it is in this status; earlier answers may still come."""
        return self._link.wait(self.config.answer_ms * 1e-3, lambda: self.status.item(k) == status)

    def describe(self) -> str:
        """What the box is, for `hil devices`."""
        ranges = "; ".join(
            f"{drive}: {e * codec.TOP:.3g} N m, {v * codec.TOP:.3g} rad/s"
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
    link = shared(bus, config.interface, address or "can0", config.bit_rate)
    box = DamiaoBus(name, link, bus, config, channels)
    try:
        box.set_up()
    except OSError:
        box.close()
        raise
    return box


__all__ = ["DamiaoBus", "DamiaoBusConfig", "open_box"]
