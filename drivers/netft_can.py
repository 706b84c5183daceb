"""ATI Net F/T box over CAN, basic protocol, short form: converted counts in two frames, asked for.

Source: ATI manual 9620-05-NET FT, "CAN".  Little-endian, two's complement, converted counts.  The
long form (request 0x01, four frames) is not used: the order of its fields is not confirmed here.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import Any

from hil.drivers.ft_sensor import CountScale
from hil.drivers.links.can import CanLink, shared_link, split_address
from hil.drivers.links.polled import Patience, PolledGauges
from hil.errors import ConfigError
from hil.signals.bus import Bus

#: The host asks and commands with the base identifier and one byte.
REQUEST_SHORT, BIAS = b"\x02", b"\x04"
#: The box answers with base + 5 and base + 6.
FIRST, SECOND = 5, 6

_FIRST = struct.Struct("<hhhh").unpack
_SECOND = struct.Struct("<hhHH").unpack


def first_frame(data: bytes, words: Any) -> None:
    """Fx, Tx, Fy, Ty into `words` (6,) = Fx Fy Fz Tx Ty Tz.  8 bytes."""
    words[0], words[3], words[1], words[4] = _FIRST(data)


def second_frame(data: bytes, words: Any) -> tuple[int, int]:
    """Fz, Tz into `words` (6,); status and sample number.  8 bytes."""
    words[2], words[5], status, sample = _SECOND(data)
    return int(status), int(sample)


#: A word at one of these is at the end of its range.
_RAILS = (-32768, 32767)


@dataclass(frozen=True)
class NetFtCanConfig(CountScale):
    """Options of the box ``netft-can``.

    Parameters
    ----------
    interface : str
        python-can's interface on hardware.
    base : int
        Base identifier, set by the switches of the box (0..0x7f8), where the address does not
        say it.
    bit_rate : int
        Of the bus, set by the switches of the box [bit/s].
    scale_factors : tuple of 6 floats
        Counts per 16-bit word of Fx Fy Fz Tx Ty Tz, from the box's page; there is no default,
        for the wrong ones give plausible wrong forces.
    answer_ms, stale_ms, lost_ms : float
        As of ``netcanoem``.
    """

    interface: str = "socketcan"
    base: int = 0x1B0
    bit_rate: int = 1_000_000
    scale_factors: tuple[float, ...] = ()
    answer_ms: float = 0.9
    stale_ms: float = 1.5
    lost_ms: float = 50.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.base <= 0x7FF - SECOND:
            raise ConfigError(f"base = {self.base:#x}: base + 6 must fit into 11 bits.")
        if len(self.scale_factors) != 6 or min(self.scale_factors) <= 0:
            raise ConfigError(
                "scale_factors: six positive numbers for Fx Fy Fz Tx Ty Tz are needed; the box's "
                "configuration page shows them."
            )
        if not 0 < self.stale_ms <= self.lost_ms or self.answer_ms <= 0:
            raise ConfigError("0 < stale_ms <= lost_ms and answer_ms > 0 are needed.")


class NetFtCan(PolledGauges):
    """Words of one box: a `GaugeSource`.

    Attributes
    ----------
    status, number : int
        Status and sample number of the last sample; any status but 0 makes it unusable, for the
        meaning of its bits in the short form is not confirmed.
    """

    def __init__(self, name: str, link: CanLink, config: NetFtCanConfig) -> None:
        times = (round(ms * 1e6) for ms in (config.answer_ms, config.stale_ms, config.lost_ms))
        super().__init__(name, link, (config.base, REQUEST_SHORT), Patience(*times))
        self.config = config
        self.status = self.number = self._status = 0
        self._last = -1
        self._identifiers = range(config.base + FIRST, config.base + SECOND + 1)
        self.calibration = config.calibration(config.scale_factors)
        self.serial = f"{link.bus.channel_info}/{config.base:#x}"
        self.certificate = config.record()
        link.subscribe(self._identifiers, self._hear)

    def _hear(self, identifier: int, data: bytes) -> None:
        """Mailbox: the two frames of a sample, in order."""
        if len(data) != 8:
            self.malformed += 1
        elif identifier == self._identifiers[0]:
            first_frame(data, self._pending)
            self._got = 1
        elif self._got == 1:
            self._status, self.number = second_frame(data, self._pending)
            self._got = 2
        else:
            self.halves += 1

    def _take(self) -> bool:
        """Keep a sample unless its status is not 0, a word is at its end, or it is an old one."""
        self.status = self._status
        usable = self._status == 0 and self.number != self._last
        self._last = self.number
        for word in self._pending.tolist():
            if word in _RAILS:
                usable = False
        if usable:
            self.gauges[:] = self._pending
        return usable

    def unusable_text(self) -> str:
        """Why the last sample could not be used."""
        if self.status:
            return f"{self.name}: the Net F/T box reports status 0x{self.status:04x}, not 0"
        return (
            f"{self.name}: the sample is saturated, or the box sends one sample again; words "
            f"{self._pending.tolist()}, number {self.number}"
        )

    def describe(self) -> str:
        """What the box is, for `hil devices`."""
        return f"Net F/T box over CAN at base {self.config.base:#x}"

    def close(self) -> None:
        """Leave the bus."""
        self._link.release(self._identifiers)


def open_box(
    name: str, bus: Bus, address: str, config: NetFtCanConfig, channels: tuple[int, ...]
) -> NetFtCan:
    """Open a box and take one sample, so that silence is noticed at once.

    Raises
    ------
    ConfigError
        If `address` is not ``CHANNEL`` or ``CHANNEL/BASE``, or a channel other than 0 is wanted.
    DeviceError
        If the bus or the box is not there.
    """
    if any(channels):
        raise ConfigError(f"box {name!r}: a sensor has the channel 0 alone, not {max(channels)}.")
    channel, base = split_address(name, address, config.base)
    link = shared_link(bus, config.interface, channel, config.bit_rate)
    box = NetFtCan(name, link, replace(config, base=base))
    try:
        box.sample(bus.now_ns())
    except OSError:
        box.close()
        raise
    return box


#: What the registry looks for.
BUS = "can"
#: What the address of a box is, for messages.
ADDRESS = "CHANNEL/BASE as its switches are set, e.g. can0/0x20"
Config = NetFtCanConfig
