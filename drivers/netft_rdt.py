"""ATI Net F/T box over UDP, Raw Data Transfer (RDT): it streams, the tick takes the newest record.

Source: ATI manual 9620-05-NET FT, "UDP interface using RDT".  Big-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.drivers.ft_sensor import CountScale
from hil.drivers.links.udp import UdpLink, split_host
from hil.errors import ConfigError, DeviceError, DeviceTimeoutError
from hil.signals.bus import Bus
from hil.signals.device import IntArray, Status

_PORT = 49152
HEADER = 0x1234
STOP, REAL_TIME, SOFTWARE_BIAS = 0x0000, 0x0002, 0x0042
RECORD_BYTES = 36

_REQUEST = struct.Struct(">HHI").pack
_RECORD = struct.Struct(">III6i").unpack


def request(command: int, samples: int = 0) -> bytes:
    """Command of 8 bytes; 0 samples means without end."""
    return _REQUEST(HEADER, command, samples)


def record(data: bytes, words: Any) -> tuple[int, int, int]:
    """RDT sequence, F/T sequence and status; Fx Fy Fz Tx Ty Tz into `words` (6,).  36 bytes."""
    rdt, sequence, status, *words[:] = _RECORD(data)
    return int(rdt), int(sequence), int(status)


#: Records that one tick takes at most; at 7 kHz there are seven.
_CROWD = 256
#: Sequence numbers are modulo this.
_SPAN = 1 << 32
#: Wait between two looks for a record, when opening and taring [s]; and how often.
_STEP_S, _LOOKS = 1e-3, 50


@dataclass(frozen=True)
class NetFtRdtConfig(CountScale):
    """Options of the box ``netft-rdt``; the box's page sets the rate of its records.

    Parameters
    ----------
    stale_ms, restart_ms, lost_ms : float
        Age of a record from which it is STALE; from which the box is asked to stream again;
        from which it is lost [ms].
    """

    stale_ms: float = 2.5
    restart_ms: float = 10.0
    lost_ms: float = 50.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.stale_ms <= self.restart_ms <= self.lost_ms:
            raise ConfigError("0 < stale_ms <= restart_ms <= lost_ms is needed.")


class NetFtRdt:
    """Words of one box: a `GaugeSource`.

    Parameters
    ----------
    name : str
        Name of the box.
    bus : Bus
        UDP.
    host, port : str, int
        Of the box.
    config : NetFtRdtConfig
        Units and patience.

    Attributes
    ----------
    trouble : str
        Why the box is lost; empty while it is not.
    status : int
        Status of the last record; with any but 0 it is not used.
    missed, old, malformed : int
        Records that never came (gaps of the sequence), came after a newer one, had a wrong
        length.

    Raises
    ------
    DeviceError
        If the box does not stream.
    """

    def __init__(self, name: str, bus: Bus, host: str, port: int, config: NetFtRdtConfig) -> None:
        self.name, self.config = name, config
        self.gauges: IntArray = np.zeros(6, np.int64)
        self.calibration, self.certificate = config.calibration(), config.record()
        self.serial = f"{host}:{port}"
        self.status = self.missed = self.old = self.malformed = 0
        self.trouble = ""
        self._bus, self._words = bus, [0] * 6
        self._stale, self._restart, self._lost = (
            round(ms * 1e6) for ms in (config.stale_ms, config.restart_ms, config.lost_ms)
        )
        self._sequence = -1
        self._fresh_ns, self._asked_ns = -1, 0
        self._link = UdpLink(bus, host, port)
        self._link.send(request(REAL_TIME))
        try:
            self.sample(bus.now_ns())
        except OSError:
            self.close()
            raise

    def receive(self, t_ns: int) -> Status:
        """Take every record that has come and keep the newest; never waits or raises."""
        self._link.advance(t_ns)
        if self._fresh_ns < 0:
            self._fresh_ns = self._asked_ns = t_ns
        if self._drain():
            self._fresh_ns = self._asked_ns = t_ns
            return Status.OK
        age = t_ns - self._fresh_ns
        if age >= self._lost:
            if not self.trouble:
                said = f"status 0x{self.status:08x}" if self.status else self._link.trouble
                self.trouble = f"box {self.name!r}: no record for {age * 1e-6:.0f} ms; {said}."
            return Status.LOST
        if t_ns - self._asked_ns >= self._restart:
            # the stream has stopped, or the box has restarted with new numbers
            self._link.send(request(REAL_TIME))
            self._asked_ns, self._sequence = t_ns, -1
        return Status.STALE if age >= self._stale or self.status else Status.OK

    def _drain(self) -> bool:
        """Whether a good record newer than the last was among those that came."""
        good = False
        for _ in range(_CROWD):
            data = self._link.receive()
            if data is None:
                break
            if len(data) != RECORD_BYTES:
                self.malformed += 1
                continue
            sequence, _, status = record(data, self._words)
            ahead = (sequence - self._sequence) % _SPAN if self._sequence >= 0 else 1
            if not 0 < ahead < _SPAN // 2:
                self.old += 1
                continue
            self.missed += ahead - 1
            self._sequence, self.status = sequence, status
            if not status:
                self.gauges[:] = self._words
                good = True
        return good

    def sample(self, t_ns: int) -> int:
        """Wait for one new good record.

        Raises
        ------
        DeviceTimeoutError
            If none comes in 50 ms.
        DeviceError
            If the box reports an error.
        """
        self._fresh_ns, self.trouble = -1, ""
        for _ in range(_LOOKS):
            self._link.advance(t_ns)
            if self._drain():
                return t_ns + round(_STEP_S * 1e9)
            self._bus.pause(_STEP_S)
            t_ns += round(_STEP_S * 1e9)
        self.check()
        raise DeviceTimeoutError(
            f"{self.name}: no record from {self.serial} within 50 ms; is the box on, at this "
            "address, with RDT enabled on its page?"
            + (f" (the network says: {self._link.trouble})" if self._link.trouble else "")
        )

    def check(self) -> None:
        """Refuse while the box reports an error; the age of its record starts anew."""
        if self.status:
            raise DeviceError(
                f"{self.name}: the Net F/T box reports status 0x{self.status:08x}, not 0; its "
                "page says what that means"
            )
        self._fresh_ns = -1

    def describe(self) -> str:
        """What the box is, for `hil devices`."""
        return f"Net F/T box streaming from {self.serial}"

    def close(self) -> None:
        """Stop the stream and close the socket."""
        self._link.send(request(STOP))
        self._link.close()


def open_box(
    name: str, bus: Bus, address: str, config: NetFtRdtConfig, channels: tuple[int, ...]
) -> NetFtRdt:
    """Open a box at ``HOST`` or ``HOST:PORT``.

    Raises
    ------
    ConfigError
        If there is no address, or a channel other than 0 is wanted.
    DeviceError
        If the box does not stream.
    """
    if any(channels):
        raise ConfigError(f"box {name!r}: a sensor has the channel 0 alone, not {max(channels)}.")
    return NetFtRdt(name, bus, *split_host(name, address, _PORT), config)


#: What the registry looks for.
BUS = "udp"
#: What the address of a box is, for messages.
ADDRESS = "HOST or HOST:PORT as its page is reached"
Config = NetFtRdtConfig
