"""ATI's Net F/T box from its side of the wire: basic CAN protocol (short form), RDT over UDP.

The box converts: its words are counts of force and torque, not gauges.  Assumptions: an answer
over CAN starts 60 us after the request; a record takes 100 us through the network.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.sim_devices.canbus.line import CanFrame, Node
from hil.sim_devices.force.netcanoem import LATENCY_NS, Faults, place
from hil.sim_devices.force.transducer import SimulatedTransducer
from hil.sim_devices.simtime import SimTime

#: Counts per N and per N m of both boxes here.
_COUNTS = 1_000_000
NETWORK_NS = 100_000
#: Records that the host's socket keeps, the oldest first; what comes on top is lost.
SOCKET_RECORDS = 128


class Converter:
    """Gauges to counts of force and torque, with the box's bias.

    Parameters
    ----------
    transducer : Transducer
        The sensor.
    """

    def __init__(self, transducer: SimulatedTransducer) -> None:
        self.transducer = transducer
        self._matrix = transducer.certificate.wrench_per_word() * _COUNTS
        self._bias = np.zeros(6)

    def counts(self, t_ns: int) -> NDArray[np.int64]:
        """Fx Fy Fz Tx Ty Tz (6,) at `t_ns` [counts]."""
        raw = self._matrix @ self.transducer.read(t_ns)
        return np.round(raw - self._bias).astype(np.int64)

    def bias(self, t_ns: int) -> None:
        """What is measured now becomes zero."""
        self._bias = self._matrix @ self.transducer.read(t_ns)


class NetFtCanBox(Node):
    """The box on a CAN line.

    Parameters
    ----------
    transducer : Transducer
        The sensor.
    base, bit_rate : int
        As set by its switches.
    factors : tuple of 6 floats
        Counts per 16-bit word.
    """

    def __init__(
        self, transducer: SimulatedTransducer, base: int, bit_rate: int, factors: tuple[float, ...]
    ) -> None:
        super().__init__(bit_rate)
        self.converter = Converter(transducer)
        self.base, self.factors = base, np.array(factors)
        self.faults = Faults()
        self._number = 0

    def hear(self, frame: CanFrame, t_ns: int) -> None:
        """Answer a request; a new one aborts what has not been sent yet."""
        if frame.ident != self.base or len(frame.data) != 1 or self.faults.strikes("mute"):
            return
        if frame.data[0] == 4:
            self.converter.bias(t_ns)
        elif frame.data[0] == 2:
            self.outbox.clear()
            self._short(t_ns)

    def _short(self, t_ns: int) -> None:
        self._number = self._number + 1 & 0xFFFF
        words = np.clip(np.round(self.converter.counts(t_ns) / self.factors), -32768, 32767)
        fx, fy, fz, tx, ty, tz = (int(w) for w in words)
        frames = [(5, (fx, tx, fy, ty)), (6, (fz, tz, self.faults.status, self._number))]
        for k, (code, four) in enumerate(frames):
            lost = self.faults.strikes("lose_second" if k else "lose_first")
            data = b"".join((w & 0xFFFF).to_bytes(2, "little") for w in four)
            if self.faults.strikes("short"):
                data = data[:-1]
            ready = t_ns + LATENCY_NS
            if k and self.faults.strikes("delay_second"):
                ready += self.faults.delay_ns
            if not lost:
                self.outbox.append((ready, CanFrame(self.base + code, data)))


class RdtBox:
    """The box on a network; `open` is what a driver uses in place of a socket.

    Parameters
    ----------
    transducer : Transducer
        The sensor.
    time : SimTime
        Time of box and network.
    rate_hz : float
        Records per second.

    Attributes
    ----------
    here, mute : bool
        On the network; streaming when asked to.
    status : int
        Status that it reports.
    spoil : int
        Records that will be cut short; `drop` and `swap` the like for loss and order.
    """

    def __init__(
        self, transducer: SimulatedTransducer, time: SimTime, rate_hz: float = 3500.0
    ) -> None:
        self.converter = Converter(transducer)
        self.time, self._step = time, round(1e9 / rate_hz)
        self.here, self.mute = True, False
        self.status = self.spoil = self.drop = self.swap = 0
        self._left, self._due_ns = 0, 0
        self._numbers = [0, 0]
        self.arrived: deque[tuple[int, bytes]] = deque()

    def open(self, host: str, port: int) -> RdtBox:
        """Stand-in for a socket that is connected to this box."""
        return self

    def send(self, data: bytes) -> int:
        """A command of the host arrives."""
        if not self.here:
            raise ConnectionRefusedError(111, "Connection refused")
        self.run()
        if len(data) != 8 or data[:2] != b"\x12\x34" or self.mute:
            return len(data)
        code, count = int.from_bytes(data[2:4], "big"), int.from_bytes(data[4:8], "big")
        if code == 0:
            self._left = 0
        elif code == 2:
            self._left, self._due_ns = count or -1, self.time.now_ns + self._step
            self._numbers[0] = 0
        elif code == 0x42:
            self.converter.bias(self.time.now_ns)
        return len(data)

    def run(self) -> None:
        """Everything that is due by now is measured and sent."""
        while self._left and self._due_ns <= self.time.now_ns:
            if self.here and not self.mute:
                self._emit(self._due_ns)
            self._due_ns += self._step

    def _emit(self, t_ns: int) -> None:
        self._left -= self._left > 0
        self._numbers = [(n + 1) & 0xFFFFFFFF for n in self._numbers]
        head = [*self._numbers, self.status]
        values = [*head, *(int(c) & 0xFFFFFFFF for c in self.converter.counts(t_ns))]
        data = b"".join(v.to_bytes(4, "big") for v in values)
        if self.drop > 0:
            self.drop -= 1
            return
        if self.spoil > 0:
            self.spoil -= 1
            data = data[:-5]
        if len(self.arrived) >= SOCKET_RECORDS:
            return
        self.arrived.append((t_ns + NETWORK_NS, data))
        if self.swap > 0 and len(self.arrived) > 1:
            self.swap -= 1
            (t0, first), (t1, second) = self.arrived[-2], self.arrived[-1]
            self.arrived[-2], self.arrived[-1] = (t0, second), (t1, first)

    def recv(self, size: int) -> bytes:
        """Next record that is through the network by now."""
        if not self.here:
            raise ConnectionRefusedError(111, "Connection refused")
        self.run()
        if not self.arrived or self.arrived[0][0] > self.time.now_ns:
            raise BlockingIOError(11, "Resource temporarily unavailable")
        return self.arrived.popleft()[1][:size]

    def close(self) -> None:
        """The host's socket is gone; the box does not notice."""
        self.arrived.clear()


def put_on_can(wired: Any, name: str, row: dict[str, Any]) -> NetFtCanBox:
    """Box of a rig file on a CAN line of a bench."""
    options = row["options"]
    channel, base = place(row["address"], int(options.get("base", 0x1B0)))
    factors = tuple(float(f) for f in options.get("scale_factors", (1.0,) * 6))
    rate = options.get("bit_rate", 1_000_000)
    box = NetFtCanBox(wired.force.transducer(name, row["cables"]), base, rate, factors)
    wired.force.line(channel).attach(box)
    return box


def put_on_network(wired: Any, name: str, row: dict[str, Any]) -> RdtBox:
    """Box of a rig file on the network of a bench."""
    host, _, port = row["address"].partition(":")
    box = RdtBox(wired.force.transducer(name, row["cables"]), wired.force.time)
    wired.force.hosts[f"{host}:{port or 49152}"] = box
    return box
