"""Driver of the ATI 9105-NETCANOEM: polls gauges, one request at a time, over a CAN link.

The tick collects the answer to the request of the tick before and asks again, so that the bus
works while the loop waits for its next tick.  The price is one period of delay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.links.can import CanLink, shared, split_address
from drivers.netcanoem import codec
from drivers.netcanoem.config import NetCanOemConfig
from drivers.netcanoem.dialogue import Dialogue, Identity
from hil.errors import ConfigError, DeviceError, DeviceTimeoutError
from hil.signals.bus import Bus
from hil.signals.device import Status

_FIRST, _SECOND = codec.READ_GAUGES, codec.SECOND_HALF
_LOW, _HIGH = codec.RAILS
#: What the time moves on by for one sample of a tare [ns].
PACE_NS = 1_000_000


class NetCanOem:
    """Words of one board: a `GaugeSource`.

    Parameters
    ----------
    name : str
        Name of the device.
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
    unusable : bool
        The last sample could not be used: critical status, or a saturated gauge.
    timeouts, halves, malformed : int
        Requests without a whole answer, second frames without a first, frames of a wrong length.

    Raises
    ------
    DeviceError
        If the board does not answer or cannot be trusted.
    """

    def __init__(self, name: str, link: CanLink, config: NetCanOemConfig) -> None:
        self.name, self.config = name, config
        self.gauges = np.zeros(6, np.int64)
        self.unusable = False
        self.status = self.timeouts = self.halves = self.malformed = 0
        self._link = link
        self._dialogue: Dialogue | None = None
        self._pending = np.zeros(6, np.int64)
        self._request = codec.identifier(config.base, _FIRST)
        self._patience, self._stale, self._lost = (
            round(ms * 1e6) for ms in (config.answer_ms, config.stale_ms, config.lost_ms)
        )
        self._asked_ns: int | None = None
        #: Time of the last sample; negative = counted from the next tick on.
        self._fresh_ns = -1
        self._state = self._got = 0
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
        else:
            self.malformed += 1

    def receive(self, t_ns: int) -> Status:
        """Take the sample that has arrived, ask for the next one; never waits or raises."""
        link = self._link
        link.advance(t_ns)
        link.poll()
        if self._fresh_ns < 0:
            self._fresh_ns = t_ns
        good = self._got == 2 and self._take()
        if good:
            self._fresh_ns = t_ns
        if self._got == 2:
            self._asked_ns = None
        elif self._asked_ns is not None and t_ns - self._asked_ns >= self._patience:
            # what comes late belongs to the old request: one more tick for it to pass
            self.timeouts += 1
            self._asked_ns, self._got = None, 0
            return self._age(t_ns, good)
        if self._asked_ns is None:
            self._got = 0
            link.send(self._request)
            self._asked_ns = t_ns
        return self._age(t_ns, good)

    def _take(self) -> bool:
        """Keep a whole sample unless it is not usable: critical status, or a gauge at a rail."""
        self.status = self._state
        self.unusable = bool(self._state & codec.CRITICAL)
        for word in self._pending.tolist():
            if word == _LOW or word == _HIGH:
                self.unusable = True
        if not self.unusable:
            self.gauges[:] = self._pending
        return not self.unusable

    def _age(self, t_ns: int, good: bool) -> Status:
        """Status of the last good sample by its age; a sample that is not usable ages it."""
        age = t_ns - self._fresh_ns
        if age >= self._lost:
            return Status.LOST
        if good or (age < self._stale and not self.unusable):
            return Status.OK
        return Status.STALE

    def sample(self, t_ns: int) -> int:
        """Ask for a sample, wait for it, and keep it.

        Raises
        ------
        DeviceTimeoutError
            If the board does not answer within its patience, three times.
        DeviceError
            If the sample is not usable.
        """
        self._asked_ns = None
        for _ in range(3):
            self._link.advance(t_ns)
            self._link.poll()
            self._got = 0
            self._link.send(self._request)
            self._link.wait(self._patience * 1e-9, lambda: self._got == 2)
            if self._got == 2:
                t_ns += PACE_NS
                self._got = 0
                self._fresh_ns = -1
                if not self._take():
                    raise DeviceError(self._unusable())
                return t_ns
            t_ns += self._patience
            self.timeouts += 1
        raise DeviceTimeoutError(
            f"{self.name}: no whole sample within {self.config.answer_ms} ms, three times"
            + (f" (the bus failed: {self._link.trouble})" if self._link.trouble else "")
        )

    def check(self) -> None:
        """Refuse while the board reports an error that makes its samples unusable."""
        if self._link.trouble:
            raise DeviceError(f"{self.name}: the CAN bus failed: {self._link.trouble}")
        if self.status & codec.CRITICAL:
            raise DeviceError(self._unusable())
        self._fresh_ns = -1

    def _unusable(self) -> str:
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

    def close(self) -> None:
        """Leave the bus."""
        self._link.release(self._identifiers)


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
