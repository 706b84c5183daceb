"""Driver of the ATI 9105-NETCANOEM: strain gauges in two frames, calibrated by the board."""

from __future__ import annotations

from dataclasses import replace

from hil.drivers.links.can import CanLink, shared, split_address
from hil.drivers.links.can_open import can_channels
from hil.drivers.links.polled import Patience, PolledGauges
from hil.drivers.netcanoem import codec
from hil.drivers.netcanoem.config import NetCanOemConfig
from hil.drivers.netcanoem.dialogue import Dialogue, Identity
from hil.errors import ConfigError, DeviceError
from hil.signals.bus import Attached, Bus

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
    link = shared(bus, config.interface, channel, config.bit_rate)
    return NetCanOem(name, link, replace(config, base=base))
