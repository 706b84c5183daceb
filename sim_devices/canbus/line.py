"""The pair of wires: who may send when, how long it takes, who hears it.

Simulated: frame time with stuff bits, one frame at a time, arbitration by identifier, no
acknowledge, nodes at different bit rates, two nodes that send one identifier at once, error
counters up to bus-off.  Not simulated: single bit errors, sample points, clock tolerance,
overload frames, extended identifiers.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple
from weakref import WeakValueDictionary

from sim_devices.canbus.frame import ERROR, PAUSE, Frame, bits
from sim_devices.simtime import SimTime

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


class _Flight(NamedTuple):
    """A frame on the wires, from its start to when the next may follow."""

    start_ns: int
    end_ns: int
    idle_ns: int
    senders: list[Node]
    fails: bool


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
            if self._flying is None:
                if self._idle_ns > until_ns:
                    return
                plan = self._arbitrate()
                if plan is None or plan.start_ns > until_ns:
                    return
                self._flying, self._idle_ns = plan, plan.idle_ns
            plan = self._flying
            if plan.end_ns > until_ns:
                return
            self._flying = None
            self._finish(plan)

    def next_ns(self) -> int | None:
        """When the next frame will be complete, as far as is known now; None if none is."""
        plan = self._flying or self._arbitrate()
        return None if plan is None else plan.end_ns

    def _arbitrate(self) -> _Flight | None:
        """Which frame goes next, and when; the lowest identifier of those that wait wins."""
        ready = [n for n in self.nodes if n.outbox and n.powered and n.failures < OFF]
        if not ready:
            return None
        if len(ready) == 1:
            at, frame = ready[0].outbox[0]
            return self._plan(at if at > self._idle_ns else self._idle_ns, frame, ready, False)
        start = max(self._idle_ns, min([n.outbox[0][0] for n in ready]))
        rivals = [n for n in ready if n.outbox[0][0] <= start]
        lowest = min([n.outbox[0][1].ident for n in rivals])
        winners = [n for n in rivals if n.outbox[0][1].ident == lowest]
        frame = winners[0].outbox[0][1]
        # one identifier, other bits: the bit error comes after the arbitration field
        clash = any(n.outbox[0][1] != frame for n in winners[1:])
        return self._plan(start, frame, winners, clash)

    def _plan(self, start: int, frame: Frame, winners: list[Node], clash: bool) -> _Flight:
        """A frame that starts at `start` [ns]."""
        fails = clash or not self._acknowledged(winners)
        bit_ns = 1e9 / winners[0].bit_rate
        end = start + round((ERROR + 13 if clash else bits(frame.ident, frame.data)) * bit_ns)
        idle = end + round((ERROR if fails else PAUSE) * bit_ns)
        return _Flight(start, end, idle, winners, fails)

    def _acknowledged(self, senders: list[Node]) -> bool:
        """Somebody else hears it at the same bit rate, and nobody at another destroys it."""
        rate, heard = senders[0].bit_rate, False
        for node in self.nodes:
            if node.powered and node.failures < OFF:
                if node.bit_rate != rate:
                    return False
                heard |= node not in senders
        return heard

    def _finish(self, flight: _Flight) -> None:
        """Deliver the frame in flight, or count the failure; it is then tried again."""
        senders = flight.senders
        if flight.fails:
            alone = len([n for n in self.nodes if n.powered]) == len(senders)
            for node in senders:
                # nobody else there: the counter stops at error-passive (ISO 11898-1)
                if not (alone and node.failures >= PASSIVE):
                    node.failures += FAILURE
                if node.off:
                    node.outbox.clear()
                node.error(flight.end_ns)
            return
        frame = senders[0].outbox[0][1]
        for node in senders:
            node.outbox.popleft()
            if node.failures:
                node.failures -= 1
        self.frames += 1
        for node in self.nodes:
            if node.powered and node.failures < OFF and node not in senders:
                node.hear(frame, flight.end_ns)


#: Channel name -> bus, so that `can.Bus(interface="hil-sim", channel=name)` finds it; who made
#: the bus keeps it.
LINES: WeakValueDictionary[str, CanLine] = WeakValueDictionary()
