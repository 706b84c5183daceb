"""ATI 9105-NETCANOEM: strain gauges in two CAN frames, calibrated by the matrix of the board.

At start-up and for a diagnosis the board is asked and its answer awaited; in the loop it is polled.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np

from hil.drivers.links.can import CanLink, can_channels, shared_link, split_address
from hil.drivers.links.polled import Patience, PolledGauges
from hil.drivers.netcanoem import codec
from hil.errors import ConfigError, DeviceError, DeviceTimeoutError, unknown
from hil.signals.bus import Attached, Bus
from hil.signals.device import FloatArray


@dataclass(frozen=True)
class NetCanOemConfig:
    """Options of the driver ``netcanoem``.

    Parameters
    ----------
    interface : str
        python-can's interface on hardware, e.g. ``socketcan``, ``pcan``, ``udp_multicast``.
    base : int
        Base identifier of the board (0..127) where the box's address does not say it; two
        boards on one bus need different ones.
    bit_rate : int
        Of the bus [bit/s]; the board's own default is 250000, and 1 kHz needs 1000000.
    calibration : int
        Slot 0..15 of the transducer in the board; after every reset the board is at slot 0.
    serial : str
        Serial number that the slot must hold; empty takes any.
    force_unit, torque_unit : str
        Units of the calibration; needed with firmware before 3.7 alone, which cannot tell.
    answer_ms, stale_ms, lost_ms : float
        Wait for an answer before it is asked for again, longer where the sensors on the bus
        need longer for one answer each; age of a sample from which it is STALE; age from which
        the sensor is lost and the device goes to FAULT [ms].
    """

    interface: str = "socketcan"
    base: int = 0x20
    bit_rate: int = 1_000_000
    calibration: int = 0
    serial: str = ""
    force_unit: str = ""
    torque_unit: str = ""
    answer_ms: float = 0.9
    stale_ms: float = 1.5
    lost_ms: float = 50.0

    def __post_init__(self) -> None:
        if not 0 <= self.base <= 0x7F:
            raise ConfigError(f"base = {self.base:#x}: 0 to 0x7f is needed.")
        if not 0 <= self.calibration < codec.SLOTS:
            raise ConfigError(f"calibration = {self.calibration}: a slot 0 to 15 is needed.")
        if not 0 < self.stale_ms <= self.lost_ms or self.answer_ms <= 0:
            raise ConfigError("0 < stale_ms <= lost_ms and answer_ms > 0 are needed.")
        _known("force_unit", self.force_unit, [n for n, _ in codec.FORCE_UNITS.values()])
        _known("torque_unit", self.torque_unit, [n for n, _ in codec.TORQUE_UNITS.values()])


def _known(kind: str, name: str, names: list[str]) -> None:
    if name and name not in names:
        raise ConfigError(unknown(kind, name, names))


#: An answer takes well under a millisecond; a board that resets, tens of them [s].  A rig file
#: that gives answers more time than this gives it to these questions too.
_PATIENCE_S = 0.05
_TRIES = 3


@dataclass(frozen=True)
class Identity:
    """What a board said of itself.

    Parameters
    ----------
    serial : str
        Of the transducer in the selected slot.
    firmware : tuple of 3 int
        Major, minor, build.
    counts : tuple of 2 int
        Counts per unit of force and of torque.
    units : tuple of 2 str
        Units of force and torque.
    matrix : ndarray (6, 6)
        As read: rows Fx Fy Fz Tx Ty Tz, columns gauges 0 to 5 [counts of force or torque].
    """

    serial: str
    firmware: tuple[int, int, int]
    counts: tuple[int, int]
    units: tuple[str, str]
    matrix: FloatArray

    def calibration(self) -> FloatArray:
        """Matrix (6, 6): wrench in the sensor frame per gauge count [N, N m]."""
        newton = dict(codec.FORCE_UNITS.values())[self.units[0]]
        newton_metre = dict(codec.TORQUE_UNITS.values())[self.units[1]]
        # f = G g / (counts per unit), rows 0-2 force, 3-5 torque (manual, "Converting")
        scale = [newton / self.counts[0]] * 3 + [newton_metre / self.counts[1]] * 3
        return np.asarray(self.matrix * np.array(scale)[:, None])

    def record(self) -> dict[str, str]:
        """All of it as text, for a session's metadata."""
        return {
            "transducer": self.serial,
            "firmware": ".".join(map(str, self.firmware)),
            "counts_per_unit": json.dumps(self.counts),
            "units": json.dumps(self.units),
            "matrix": json.dumps(self.matrix.tolist()),
        }


class Dialogue:
    """One question at a time, asked again when the answer does not come.

    Parameters
    ----------
    name : str
        Of the device, for messages.
    link : CanLink
        The bus.
    config : NetCanOemConfig
        Base identifier and slot.
    """

    def __init__(self, name: str, link: CanLink, config: NetCanOemConfig) -> None:
        self.name, self._link, self._config = name, link, config
        self._heard: list[tuple[int, bytes]] = []

    def hear(self, operation: int, data: bytes) -> None:
        """Mailbox while a question is open; what cannot be an answer is a request come back."""
        if len(data) == codec.ANSWER_BYTES.get(operation):
            self._heard.append((operation, data))

    def ask(self, operation: int, request: bytes = b"", frames: int = 1) -> list[bytes]:
        """Data of the `frames` answers, operations `operation`, `operation` + 1, ...

        Raises
        ------
        DeviceTimeoutError
            If the board does not answer, or not in full, after three attempts.
        """
        wanted = list(range(operation, operation + frames))
        patience = max(_PATIENCE_S, self._config.answer_ms * 1e-3)
        for _ in range(_TRIES):
            self._link.poll()
            self._heard.clear()
            self._link.send(codec.identifier(self._config.base, operation), request)
            if self._link.wait(patience, lambda: self._last(frames) == wanted):
                return [d for _, d in self._heard[-frames:]]
        raise DeviceTimeoutError(self._silence(operation))

    def _last(self, frames: int) -> list[int]:
        return [o for o, _ in self._heard[-frames:]]

    def identify(self) -> Identity:
        """Select the slot of the configuration and read all that a conversion needs."""
        config = self._config
        version = codec.firmware(self.ask(codec.READ_FIRMWARE)[0])
        echo = self.ask(codec.SET_CALIBRATION, bytes([config.calibration]))[0]
        if echo != bytes([config.calibration]):
            raise DeviceError(
                f"{self.name}: asked for calibration {config.calibration}, the board echoes "
                f"{echo.hex() or 'nothing'}; nothing measured with it could be trusted"
            )
        serial = codec.serial_number(self.ask(codec.READ_SERIAL)[0])
        if config.serial and serial != config.serial:
            raise DeviceError(
                f"{self.name}: slot {config.calibration} holds transducer {serial!r}, the rig "
                f"file expects {config.serial!r}; choose the slot or the sensor"
            )
        counts, units = self._scale(version)
        return Identity(serial, version, counts, units, self._matrix())

    def _matrix(self) -> FloatArray:
        rows = [
            [x for d in self.ask(codec.READ_MATRIX, bytes([axis]), 3) for x in codec.matrix_pair(d)]
            for axis in range(6)
        ]
        matrix = np.array(rows)
        if not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix) < 6:
            raise DeviceError(
                f"{self.name}: slot {self._config.calibration} holds no usable calibration "
                "matrix (not finite, or not of full rank); is the slot empty?"
            )
        return matrix

    def _scale(self, version: tuple[int, int, int]) -> tuple[tuple[int, int], tuple[str, str]]:
        """Counts per unit and units, from the board or, with old firmware, from the rig file."""
        given = (self._config.force_unit, self._config.torque_unit)
        if version[:2] >= codec.UNITS_SINCE:
            counts = codec.counts_per_unit(self.ask(codec.READ_COUNTS)[0])
            force, torque = codec.unit_codes(self.ask(codec.READ_UNITS)[0])
            told = (codec.FORCE_UNITS[force][0], codec.TORQUE_UNITS[torque][0])
            if any(g and g != t for g, t in zip(given, told, strict=True)):
                raise DeviceError(
                    f"{self.name}: the board counts in {' and '.join(told)}, the rig file says "
                    f"{' and '.join(g or '(nothing)' for g in given)}; leave both out of it"
                )
            return counts, told
        if not all(given):
            raise DeviceError(
                f"{self.name}: firmware {version[0]}.{version[1]} cannot tell its units (3.7 "
                "can); give force_unit and torque_unit of the calibration sheet in the options"
            )
        return (codec.OLD_COUNTS, codec.OLD_COUNTS), given

    def _silence(self, operation: int) -> str:
        config, bus = self._config, self._link
        if bus.trouble:
            return f"{self.name}: the CAN bus failed: {bus.trouble}"
        heard = f"; {bus.errors} error frames on the bus" if bus.errors else ""
        return (
            f"{self.name}: no answer to operation {operation:#x} from base {config.base:#04x} at "
            f"{config.bit_rate} bit/s{heard}. Check supply (12-25 V), wiring and termination, the "
            "base, and the bit rate: boards come with base 0x20 at 250000 bit/s, and SW2-1 ON "
            "at power-up brings these back"
        )


_FIRST, _SECOND = codec.READ_GAUGES, codec.SECOND_HALF
_LOW, _HIGH = codec.RAILS


class NetCanOem(PolledGauges):
    """Words of one board: a `GaugeSource`.

    Parameters
    ----------
    name : str
        Name of the box.
    link : CanLink
        Bus that it hangs on.
    config : NetCanOemConfig
        Address, slot and patience.

    Attributes
    ----------
    identity : Identity
        What the board said of itself; `serial` is that of the transducer.
    status : int
        Status word of the last sample.

    Raises
    ------
    DeviceError
        If the board does not answer or cannot be trusted.
    """

    def __init__(self, name: str, link: CanLink, config: NetCanOemConfig) -> None:
        times = (round(ms * 1e6) for ms in (config.answer_ms, config.stale_ms, config.lost_ms))
        request = (codec.identifier(config.base, _FIRST), b"")
        super().__init__(name, link, request, Patience(*times))
        self.config = config
        self.status = self._state = 0
        self._dialogue: Dialogue | None = None
        self._identifiers = range(config.base << 4, (config.base << 4) + 16)
        link.subscribe(self._identifiers, self._hear)
        self.identity = self._identify()
        self.calibration = self.identity.calibration()
        self.serial = self.identity.serial
        self.certificate = self.identity.record()

    def _identify(self) -> Identity:
        dialogue = self._dialogue = Dialogue(self.name, self._link, self.config)
        try:
            return dialogue.identify()
        except DeviceError:
            self.close()
            raise
        finally:
            self._dialogue = None

    def _hear(self, identifier: int, data: bytes) -> None:
        """Mailbox: halves of a sample while polling, everything while a question is open."""
        operation = identifier & 0xF
        if self._dialogue is not None:
            self._dialogue.hear(operation, data)
        elif operation == _FIRST and len(data) == 8:
            self._state = codec.first_half(data, self._pending)
            self._got = 1
        elif operation == _SECOND and len(data) == 6:
            if self._got == 1:
                codec.second_half(data, self._pending)
                self._got = 2
            else:
                self.halves += 1
        elif data or operation != _FIRST:
            # an empty one is our own request, handed back
            self.malformed += 1

    def _take(self) -> bool:
        """Keep a whole sample unless it is not usable: critical status, or a gauge at a rail."""
        self.status = self._state
        usable = not self._state & codec.CRITICAL
        for word in self._pending.tolist():
            if word == _LOW or word == _HIGH:
                usable = False
        if usable:
            self.gauges[:] = self._pending
        return usable

    def unusable_text(self) -> str:
        """Why the last sample could not be used."""
        if self.status & codec.CRITICAL:
            return (
                f"{self.name}: the board reports: {codec.describe_status(self.status)} "
                f"(status 0x{self.status:04x})"
            )
        rails = [k for k, w in enumerate(self._pending.tolist()) if w in codec.RAILS]
        return (
            f"{self.name}: gauges {', '.join(map(str, rails))} are saturated (word at a rail): "
            "an overload, a broken cable, or a transducer that does not belong to this slot"
        )

    def describe(self) -> str:
        """What the box is, for `hil devices`."""
        told, config = self.identity, self.config
        version = ".".join(map(str, told.firmware))
        return (
            f"NETCANOEM {version} at base {config.base:#x}: transducer {told.serial} in slot "
            f"{config.calibration}, {config.bit_rate / 1e6:g} Mbit/s"
        )

    def close(self) -> None:
        """Leave the bus."""
        self._link.release(self._identifiers)


def attached(bus: Bus) -> list[Attached]:
    """Boards at the two usual bases on every CAN interface that SocketCAN shows.

    A board at another base or bit rate does not answer; the interface alone is then listed.
    """
    rows = []
    for channel in can_channels():
        found = []
        for base in (0x20, 0x21):
            config = NetCanOemConfig(base=base)
            try:
                box = open_box("-", bus, f"{channel}/{base:#x}", config, (0,))
            except DeviceError as error:
                found.append(Attached(channel, str(error).removeprefix("-: "), False))
            else:
                found.append(Attached(f"{channel}/{base:#x}", box.describe()))
                box.close()
        rows += [row for row in found if row.usable] or found[:1]
    return rows


def open_box(
    name: str, bus: Bus, address: str, config: NetCanOemConfig, channels: tuple[int, ...]
) -> NetCanOem:
    """Open a board; `address` is ``CHANNEL`` or ``CHANNEL/BASE``, e.g. ``can0/0x21``.

    Raises
    ------
    ConfigError
        If the address is not written like this, or a channel other than 0 is wanted.
    DeviceError
        If the bus or the board is not there.
    """
    if any(channels):
        raise ConfigError(f"box {name!r}: a sensor has the channel 0 alone, not {max(channels)}.")
    channel, base = split_address(name, address, config.base)
    link = shared_link(bus, config.interface, channel, config.bit_rate)
    return NetCanOem(name, link, replace(config, base=base))


BUS = "can"
#: What the address of a box is, for messages.
ADDRESS = "CHANNEL/BASE as the board is set, e.g. can0/0x21"
Config = NetCanOemConfig
