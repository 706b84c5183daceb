"""One python-can bus with several sensors on it; frames go to their mailboxes by identifier.

The bus is opened here, with an error that says why it does not open; a tap writes every frame into
a log, or answers out of a recording.  Time is passed in: `advance` tells a simulated or replayed
bus what time it is, and means nothing to a bus of copper, on which time passes by itself.
"""

from __future__ import annotations

import errno
from collections.abc import Callable
from typing import Any, Protocol

import can

from hil.errors import ConfigError, DeviceError
from hil.signals.bus import Bus, FrameLog, Replay


def can_channels() -> list[str]:
    """CAN interfaces of this machine that SocketCAN shows, up or not."""
    return sorted(
        {str(c["channel"]) for c in can.detect_available_configs(["socketcan"]) if "channel" in c}
    )


def open_bus(interface: str, channel: str, bit_rate: int, **options: Any) -> can.BusABC:
    """Open a python-can bus.

    Parameters
    ----------
    interface : str
        Name of python-can's interface, e.g. ``socketcan``, ``pcan``, ``udp_multicast``.
    channel : str
        E.g. ``can0``.
    bit_rate : int
        [bit/s]; SocketCAN takes it from the network device and not from here.

    Raises
    ------
    DeviceError
        With what is missing and what to do.
    """
    try:
        return can.Bus(interface=interface, channel=channel, bitrate=bit_rate, **options)
    except (can.CanError, OSError, ImportError, ValueError, TypeError) as error:
        raise DeviceError(_why(interface, channel, bit_rate, error)) from error


def _why(interface: str, channel: str, bit_rate: int, error: Exception) -> str:
    """What is wrong with a bus that does not open, and what to do."""
    known = ", ".join(sorted(can.VALID_INTERFACES))
    if interface not in can.VALID_INTERFACES:
        return f"python-can has no interface {interface!r}; it has {known}."
    number = getattr(error, "errno", None) or getattr(error, "error_code", None)
    if interface == "socketcan":
        step = f"sudo ip link set {channel} up type can bitrate {bit_rate}"
        if number == errno.EAFNOSUPPORT:
            return (
                f"CAN bus {channel!r} cannot be opened ({error}): this kernel has no SocketCAN; "
                f"sudo modprobe can_raw, then {step}"
            )
        return f"CAN bus {channel!r} cannot be opened ({error}); is it there and up? {step}"
    if interface == "udp_multicast":
        return (
            f"multicast group {channel!r} cannot be used ({error}); this machine has no network "
            "interface with a multicast route, or the package msgpack is missing "
            "(pip install 'hil-teleop[hardware]')"
        )
    return f"CAN bus {interface}:{channel} cannot be opened ({error}; code {number})"


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


#: More frames than this do not fit into any wait of a driver: a bus that never falls silent.
_CROWD = 512

#: Bits of a request and its two answers at most, stuff bits and gaps included, with a fifth for
#: what else is on the bus; the board's own time [ns].
POLL_BITS, BOARD_NS = 408, 60_000

#: Takes the identifier and the data of a frame.
Mailbox = Callable[[int, bytes], None]


class CanLink:
    """Bus, mailboxes, and what went wrong on it.

    Parameters
    ----------
    bus : CanBus
        Open bus, python-can's or one with a tap.
    advance : callable, optional
        Called with the time [ns] at every `advance`; for buses whose time is passed in.
    bit_rate : int
        As asked for [bit/s].

    Attributes
    ----------
    trouble : str
        What the bus last refused, until a frame comes again; empty where all is well.
    errors, strangers : int
        Error frames, and frames for no mailbox.
    round_ns : int
        Time in which every sensor on the bus has been asked and has answered [ns].
    """

    def __init__(
        self, bus: CanBus, advance: Callable[[int], None] | None = None, bit_rate: int = 0
    ) -> None:
        self.bus = bus
        self.bit_rate = bit_rate
        self.trouble = ""
        self.errors = 0
        self.strangers = 0
        self._advance = advance
        self._boxes: dict[int, Mailbox] = {}
        self._sensors = 0
        self.round_ns = BOARD_NS

    def _count(self, change: int) -> None:
        self._sensors += change
        bits = POLL_BITS * self._sensors
        self.round_ns = BOARD_NS + (bits * 1_000_000_000 // self.bit_rate if self.bit_rate else 0)

    def subscribe(self, identifiers: range, mailbox: Mailbox) -> None:
        """Send the frames of `identifiers` to `mailbox`.

        Raises
        ------
        ConfigError
            If another sensor has one of them already.
        """
        taken = [i for i in identifiers if i in self._boxes]
        if taken:
            raise ConfigError(
                f"two sensors on bus {self.bus.channel_info!r} answer with identifier "
                f"{taken[0]:#05x}; set one board to another base (one board connected at a time)"
            )
        self._boxes.update(dict.fromkeys(identifiers, mailbox))
        self._count(1)

    def advance(self, t_ns: int) -> None:
        """It is `t_ns` now."""
        if self._advance is not None:
            self._advance(t_ns)

    def send(self, identifier: int, data: bytes = b"") -> None:
        """Put one frame out, see `post`."""
        self.post(can_frame(identifier, data))

    def post(self, message: can.Message) -> None:
        """Put one frame out; a refusal is kept in `trouble`, and the answer will be missed."""
        try:
            self.bus.send(message)
        except (can.CanError, OSError) as error:
            self.trouble = str(error) or type(error).__name__

    def poll(self) -> None:
        """Deliver every frame that has arrived; never waits."""
        for _ in range(_CROWD):
            if not self._one(0.0):
                return

    def wait(self, seconds: float, done: Callable[[], bool]) -> bool:
        """Deliver frames until `done`, until none comes for `seconds`, or an error frame does."""
        for _ in range(_CROWD):
            errors = self.errors
            if done() or not self._one(seconds) or self.errors > errors:
                break
        return done()

    def _one(self, seconds: float) -> bool:
        try:
            message = self.bus.recv(seconds)
        except (can.CanError, OSError) as error:
            self.trouble = str(error) or type(error).__name__
            return False
        if message is None:
            return False
        self._deliver(message)
        return True

    def _deliver(self, message: can.Message) -> None:
        if message.is_error_frame:
            self.errors += 1
            return
        self.trouble = ""
        box = self._boxes.get(message.arbitration_id)
        if box is None or message.is_extended_id or message.is_remote_frame:
            self.strangers += 1
        else:
            box(message.arbitration_id, bytes(message.data))

    def release(self, identifiers: range) -> None:
        """These mailboxes are no more; without any the bus is shut down."""
        known = [i for i in identifiers if self._boxes.pop(i, None) is not None]
        self._count(-1 if known else 0)
        if not self._boxes:
            self.bus.shutdown()
            for key in [k for k, link in _OPEN.items() if link is self]:
                del _OPEN[key]


def can_frame(identifier: int, data: bytes = b"") -> can.Message:
    """A frame with an identifier of 11 bits; may be sent any number of times."""
    return can.Message(arbitration_id=identifier, is_extended_id=False, data=data)


#: (interface, channel) -> link that several boxes share.
_OPEN: dict[tuple[str, str], CanLink] = {}


def shared_link(bus: Bus, interface: str, channel: str, bit_rate: int) -> CanLink:
    """The link of a channel, opened by the first box on it and closed by the last.

    Parameters
    ----------
    bus : Bus
        Hardware, or the simulated bus, whose handle then names the interface and what stands
        before the channel.
    interface, channel : str
        Of python-can.
    bit_rate : int
        [bit/s].

    Raises
    ------
    ConfigError
        If two boxes on one channel want different bit rates.
    DeviceError
        If the bus cannot be opened.
    """
    if bus.replay is not None:
        interface = "replay"
    elif bus.simulated:
        interface, channel = bus.handle["interface"], bus.handle["prefix"] + channel
    key = (interface, channel)
    link = _OPEN.get(key)
    if link is None:
        opened: CanBus
        if bus.replay is not None:
            opened = ReplayedBus(bus.replay, channel)
        elif bus.log is not None:
            opened = TappedBus(open_bus(interface, channel, bit_rate), bus.log)
        else:
            opened = open_bus(interface, channel, bit_rate)
        link = CanLink(opened, bus.advance, bit_rate)
        _OPEN[key] = link
    if link.bit_rate != bit_rate:
        raise ConfigError(
            f"CAN bus {channel!r} is wanted at {link.bit_rate} and at {bit_rate} bit/s; all "
            "boxes on one bus have one bit_rate"
        )
    return link


def split_address(name: str, address: str, base: int) -> tuple[str, int]:
    """Channel and base identifier of an address ``CHANNEL`` or ``CHANNEL/BASE``.

    Raises
    ------
    ConfigError
        If the base is not a number.
    """
    channel, _, text = (address or "can0").partition("/")
    try:
        return channel, int(text, 0) if text else base
    except ValueError:
        raise ConfigError(
            f"box {name!r}: address {address!r} is not CHANNEL/BASE, e.g. 'can0/0x20'."
        ) from None
