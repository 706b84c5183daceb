"""The pair of wires and the frames on it: who may send when, how long it takes, who hears it.

Frames are data frames of CAN 2.0A.  Simulated: frame time with stuff bits, one frame at a time,
arbitration by identifier, no acknowledge, nodes at different bit rates, two nodes that send one
identifier at once, error counters up to bus-off.  Not simulated: single bit errors, sample points,
clock tolerance, overload frames, extended identifiers.
"""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numba as nb

from hil.sim_devices.simtime import SimTime

#: After the check sum: its delimiter, acknowledge slot and delimiter, 7 bits of end of frame.
_TAIL = 10
#: Bits of silence before the next frame may start.
PAUSE = 3
#: Error flag, its echo and delimiter at most: 6 + 6 + 8.
ERROR = 20


class CanFrame(NamedTuple):
    """Identifier of 11 bits and up to 8 bytes.

    Parameters
    ----------
    ident : int
        Identifier; the lower, the sooner.
    data : bytes
        Payload.
    """

    ident: int
    data: bytes = b""


@nb.njit(cache=True, nogil=True)
def bits(ident: int, data: Any) -> int:
    """Bits from the start of a frame to the end of its end-of-frame field.

    Start, identifier, RTR, IDE, r0, length, data and a CRC of polynomial 0x4599 are stuffed:
    after five equal bits one of the opposite value goes in (ISO 11898-1).
    """
    size = len(data)
    crc, run, last, count = 0, 0, -1, 0
    head = ident << 7 | size  # start bit 0, 11 bits, RTR = IDE = r0 = 0, 4 bits of length
    total = 19 + 8 * size
    for k in range(total + 15):
        if k < 19:
            bit = head >> (18 - k) & 1
        elif k < total:
            bit = data[(k - 19) >> 3] >> (7 - ((k - 19) & 7)) & 1
        else:
            bit = crc >> (14 - (k - total)) & 1
        if k < total:
            crc = crc << 1 ^ (0x4599 if bit ^ (crc >> 14 & 1) else 0)
            crc &= 0x7FFF
        count += 1
        if bit == last:
            run += 1
        else:
            last, run = bit, 1
        if run == 5:
            # the stuff bit starts a run of its own
            count += 1
            last, run = 1 - bit, 1
    return count + _TAIL


#: Lengths of frames without data, by identifier: requests, the same ones all the time.
_EMPTY: dict[int, int] = {}


def length(frame: CanFrame) -> int:
    """`bits` of a frame."""
    if frame.data:
        return int(bits(frame.ident, frame.data))
    found = _EMPTY.get(frame.ident)
    if found is None:
        found = _EMPTY[frame.ident] = int(bits(frame.ident, frame.data))
    return found


#: A transmitter counts 8 per failure, and leaves the bus above 255.
_FAILURE, _PASSIVE, _OFF = 8, 128, 256


class Node:
    """A station: a queue to send from, and an ear.

    Parameters
    ----------
    bit_rate : int
        [bit/s].

    Attributes
    ----------
    outbox : deque of (int, Frame)
        Frames with the time from which each may go [ns]; the first goes first.
    powered : bool
        Without power a node neither sends nor hears nor acknowledges.
    failures : int
        Transmit error counter.
    """

    def __init__(self, bit_rate: int) -> None:
        self.bit_rate = bit_rate
        self.outbox: deque[tuple[int, CanFrame]] = deque()
        self.powered = True
        self.failures = 0

    @property
    def off(self) -> bool:
        """Bus-off: too many failures."""
        return self.failures >= _OFF

    def hear(self, frame: CanFrame, t_ns: int) -> None:
        """A frame has gone over the bus, complete at `t_ns`."""

    def error(self, t_ns: int) -> None:
        """An error frame has gone over the bus."""


#: A frame on the wires: start, end and when the next may follow [ns], who sends it, whether it
#: fails.  A plain tuple: thousands are made in a second.
_Flight = tuple[int, int, int, list[Node], bool]


class CanLine:
    """One bus.

    Parameters
    ----------
    time : SimTime
        Time of all who hang on it.
    """

    def __init__(self, time: SimTime) -> None:
        self.time = time
        self.nodes: list[Node] = []
        self.frames = 0
        self._idle_ns = 0
        self._flying: _Flight | None = None

    def attach(self, node: Node) -> None:
        """Connect a node."""
        self.nodes.append(node)

    def detach(self, node: Node) -> None:
        """Disconnect a node, if it is connected."""
        if node in self.nodes:
            self.nodes.remove(node)

    def run(self, until_ns: int) -> None:
        """Everything that happens on the bus up to `until_ns`."""
        while True:
            plan = self._flying
            if plan is None:
                if self._idle_ns > until_ns:
                    return
                plan = self._arbitrate()
                if plan is None or plan[0] > until_ns:
                    return
                self._flying, self._idle_ns = plan, plan[2]
            if plan[1] > until_ns:
                return
            self._flying = None
            self._finish(plan)

    def next_ns(self) -> int | None:
        """When the next frame will be complete, as far as is known now; None if none is."""
        plan = self._flying or self._arbitrate()
        return None if plan is None else plan[1]

    def _arbitrate(self) -> _Flight | None:
        """Which frame goes next, and when; the lowest identifier of those that wait wins."""
        start = -1
        for node in self.nodes:
            if node.outbox and node.powered and node.failures < _OFF:
                at = node.outbox[0][0]
                if at < start or start < 0:
                    start = at
        if start < 0:
            return None
        if start < self._idle_ns:
            start = self._idle_ns
        frame, winners, clash = None, [], False
        for node in self.nodes:
            if node.outbox and node.powered and node.failures < _OFF:
                at, mine = node.outbox[0]
                if at > start:
                    continue
                if frame is None or mine.ident < frame.ident:
                    frame, winners, clash = mine, [node], False
                elif mine.ident == frame.ident:
                    winners.append(node)
                    # one identifier, other bits: the bit error comes after the arbitration field
                    clash = clash or mine != frame
        return None if frame is None else self._plan(start, frame, winners, clash)

    def _plan(self, start: int, frame: CanFrame, winners: list[Node], clash: bool) -> _Flight:
        """A frame that starts at `start` [ns]."""
        # acknowledged: somebody else hears it at this bit rate, nobody at another destroys it
        rate, heard, disturbed = winners[0].bit_rate, False, False
        for node in self.nodes:
            if node.powered and node.failures < _OFF:
                if node.bit_rate != rate:
                    disturbed = True
                elif not heard:
                    heard = node not in winners
        fails = clash or disturbed or not heard
        bit_ns = 1e9 / rate
        end = start + round((ERROR + 13 if clash else length(frame)) * bit_ns)
        return start, end, end + round((ERROR if fails else PAUSE) * bit_ns), winners, fails

    def _finish(self, flight: _Flight) -> None:
        """Deliver the frame in flight, or count the failure; it is then tried again."""
        _, end_ns, _, senders, fails = flight
        if fails:
            self._count(senders, end_ns)
            return
        frame = senders[0].outbox[0][1]
        for node in senders:
            node.outbox.popleft()
            if node.failures:
                node.failures -= 1
        self.frames += 1
        for node in self.nodes:
            if node.powered and node.failures < _OFF and node not in senders:
                node.hear(frame, end_ns)

    def _count(self, senders: list[Node], end_ns: int) -> None:
        """A frame has failed."""
        alone = len([n for n in self.nodes if n.powered]) == len(senders)
        for node in senders:
            # nobody else there: the counter stops at error-passive (ISO 11898-1)
            if not (alone and node.failures >= _PASSIVE):
                node.failures += _FAILURE
            if node.off:
                node.outbox.clear()
            node.error(end_ns)


#: Channel name -> bus, so that `can.Bus(interface="hil-sim", channel=name)` finds it; who made
#: the bus keeps it.
LINES: WeakValueDictionary[str, CanLine] = WeakValueDictionary()
