"""The pair of wires: who may send when, how long it takes, who hears it.

Simulated: frame time with stuff bits, one frame at a time, arbitration by identifier, no
acknowledge, nodes at different bit rates, two nodes that send one identifier at once, error
counters up to bus-off.  Not simulated: single bit errors, sample points, clock tolerance,
overload frames, extended identifiers.
"""

from __future__ import annotations

from collections import deque
from weakref import WeakValueDictionary

from hil.sim_devices.canbus.frame import ERROR, PAUSE, Frame, length
from hil.sim_devices.simtime import SimTime

#: A transmitter counts 8 per failure, and leaves the bus above 255.
FAILURE, PASSIVE, OFF = 8, 128, 256


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
        self.outbox: deque[tuple[int, Frame]] = deque()
        self.powered = True
        self.failures = 0

    @property
    def off(self) -> bool:
        """Bus-off: too many failures."""
        return self.failures >= OFF

    def hear(self, frame: Frame, t_ns: int) -> None:
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
            if node.outbox and node.powered and node.failures < OFF:
                at = node.outbox[0][0]
                if at < start or start < 0:
                    start = at
        if start < 0:
            return None
        if start < self._idle_ns:
            start = self._idle_ns
        frame, winners, clash = None, [], False
        for node in self.nodes:
            if node.outbox and node.powered and node.failures < OFF:
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

    def _plan(self, start: int, frame: Frame, winners: list[Node], clash: bool) -> _Flight:
        """A frame that starts at `start` [ns]."""
        # acknowledged: somebody else hears it at this bit rate, nobody at another destroys it
        rate, heard, disturbed = winners[0].bit_rate, False, False
        for node in self.nodes:
            if node.powered and node.failures < OFF:
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
            if node.powered and node.failures < OFF and node not in senders:
                node.hear(frame, end_ns)

    def _count(self, senders: list[Node], end_ns: int) -> None:
        """A frame has failed."""
        alone = len([n for n in self.nodes if n.powered]) == len(senders)
        for node in senders:
            # nobody else there: the counter stops at error-passive (ISO 11898-1)
            if not (alone and node.failures >= PASSIVE):
                node.failures += FAILURE
            if node.off:
                node.outbox.clear()
            node.error(end_ns)


#: Channel name -> bus, so that `can.Bus(interface="hil-sim", channel=name)` finds it; who made
#: the bus keeps it.
LINES: WeakValueDictionary[str, CanLine] = WeakValueDictionary()
