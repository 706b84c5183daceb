"""The simulated bus behind python-can: ``can.Bus(interface="hil-sim", channel=...)``.

The class stands in the entry point group ``can.interface``; who uses it sees nothing but
python-can.  It has the time of its line: `recv` waits in that time and never sleeps.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import can

from hil.sim_devices.canbus.line import LINES, CanFrame, Node

#: Frames that the transmit queue takes, as a SocketCAN device does by default.
_QUEUE = 10
#: A `recv` without time-out gives up after this much simulated time without any frame.
FOREVER_NS = 3_600_000_000_000


class _Host(Node):
    """The computer's CAN controller."""

    def __init__(self, bit_rate: int, channel: str) -> None:
        super().__init__(bit_rate)
        self.inbox: deque[can.Message] = deque()
        self.channel = channel

    def hear(self, frame: CanFrame, t_ns: int) -> None:
        self.inbox.append(
            can.Message(
                timestamp=t_ns * 1e-9,
                arbitration_id=frame.ident,
                is_extended_id=False,
                data=frame.data,
                channel=self.channel,
            )
        )

    def error(self, t_ns: int) -> None:
        self.inbox.append(
            can.Message(timestamp=t_ns * 1e-9, is_error_frame=True, is_extended_id=False)
        )


class SimBus(can.BusABC):
    """A host on a simulated CAN line.

    Parameters
    ----------
    channel : str
        Name of the line in `hil.sim_devices.canbus.line.LINES`.
    can_filters : sequence, optional
        As everywhere in python-can.
    bitrate : int
        Of this host [bit/s]; nodes at another one do not understand it.
    """

    def __init__(
        self, channel: Any, can_filters: Any = None, bitrate: int = 1_000_000, **kwargs: object
    ) -> None:
        if channel not in LINES:
            raise can.CanInitializationError(
                f"no simulated CAN line {channel!r}; there is {', '.join(LINES) or 'none'}"
            )
        self._line = LINES[channel]
        self._host = _Host(bitrate, str(channel))
        self._line.attach(self._host)
        self.channel_info = f"hil-sim:{channel}"
        super().__init__(channel, can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a frame; it goes when the bus is free and nothing more urgent waits.

        Raises
        ------
        can.CanOperationError
            If the queue is full, the controller is off the bus, or the bus was shut down.
        """
        if self._is_shutdown or msg.is_extended_id or msg.is_remote_frame or msg.is_fd:
            raise can.CanOperationError("bus is shut down, or not a data frame of 11 bits")
        if self._host.off:
            raise can.CanOperationError("the controller is bus-off: too many transmit errors")
        if len(self._host.outbox) >= _QUEUE:
            raise can.CanOperationError("Failed to transmit: No buffer space available")
        self._host.outbox.append(
            (self._line.time.now_ns, CanFrame(msg.arbitration_id, bytes(msg.data)))
        )

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Next frame that passes the filters, within `timeout` [s] of the line's time."""
        if self._is_shutdown:
            raise can.CanOperationError("bus is shut down")
        line, inbox = self._line, self._host.inbox
        if not inbox:
            line.run(line.time.now_ns)
            if timeout == 0 and not inbox:
                return None
        limit = line.time.now_ns + (FOREVER_NS if timeout is None else round(timeout * 1e9))
        while True:
            while inbox:
                message = inbox.popleft()
                if message.is_error_frame or self._matches_filters(message):
                    return message
            following = line.next_ns() if limit > line.time.now_ns else None
            if following is None or following > limit:
                line.time.wait(limit)
                line.run(limit)
                return inbox.popleft() if inbox else None
            line.time.wait(following)
            line.run(line.time.now_ns)

    def shutdown(self) -> None:
        """Leave the line."""
        super().shutdown()
        self._line.detach(self._host)
