"""CAN buses with a tap: every frame into a log, or out of a recording."""

from __future__ import annotations

from typing import Any, Protocol

import can

from hil.signals.bus import FrameLog, Replay


class CanBus(Protocol):
    """What a link needs of a python-can bus."""

    @property
    def channel_info(self) -> Any:
        """Name for messages."""
        ...

    def send(self, msg: can.Message) -> None:
        """Queue a frame."""
        ...

    def recv(self, timeout: float) -> can.Message | None:
        """Next frame within so many seconds."""
        ...

    def shutdown(self) -> None:
        """Release the bus."""
        ...


class TappedBus:
    """A bus whose frames go into a log too.

    Parameters
    ----------
    bus : CanBus
        The bus.
    log : FrameLog
        The log; an error frame has the key ``error``.
    """

    def __init__(self, bus: CanBus, log: FrameLog) -> None:
        self._bus, self._log = bus, log
        self.channel_info = bus.channel_info

    def send(self, msg: can.Message) -> None:
        """Send, then note."""
        self._bus.send(msg)
        self._log.add("tx", f"{msg.arbitration_id:03x}", bytes(msg.data))

    def recv(self, timeout: float) -> can.Message | None:
        """Receive and note."""
        message = self._bus.recv(timeout)
        if message is not None:
            key = "error" if message.is_error_frame else f"{message.arbitration_id:03x}"
            self._log.add("rx", key, bytes(message.data))
        elif timeout > 0.0:
            self._log.add("silence", "", b"")
        return message

    def shutdown(self) -> None:
        """Release the bus."""
        self._bus.shutdown()


class ReplayedBus:
    """A bus that a recording answers for.

    Parameters
    ----------
    replay : Replay
        The recording.
    channel : str
        Name for messages.
    """

    def __init__(self, replay: Replay, channel: str) -> None:
        self._replay = replay
        self.channel_info = f"replay:{channel}"

    def send(self, msg: can.Message) -> None:
        """What the driver sends is compared with the recording."""
        self._replay.put(f"{msg.arbitration_id:03x}", bytes(msg.data))

    def recv(self, timeout: float) -> can.Message | None:
        """Next frame of the recording that is due."""
        frame = self._replay.take(timeout > 0.0)
        if frame is None:
            return None
        if frame.key == "error":
            return can.Message(is_error_frame=True, is_extended_id=False)
        return can.Message(arbitration_id=int(frame.key, 16), is_extended_id=False, data=frame.data)

    def shutdown(self) -> None:
        """Nothing to release."""
