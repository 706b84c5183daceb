"""A UDP socket to one address, never waiting; or what stands for it in a simulation."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Protocol

from hil.errors import ConfigError, DeviceError
from hil.signals.bus import Bus, Replay


class Datagrams(Protocol):
    """What a driver needs of a socket: non-blocking, connected to the far end."""

    def send(self, data: bytes) -> object:
        """Send one datagram."""
        ...

    def recv(self, size: int) -> bytes:
        """Next datagram; `BlockingIOError` when there is none."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


class UdpLink:
    """Datagrams to and from one device.

    Parameters
    ----------
    bus : Bus
        Time, and in a simulation the socket's stand-in.
    host, port : str, int
        The device.

    Attributes
    ----------
    trouble : str
        What the network last refused; empty where all is well.

    Raises
    ------
    DeviceError
        If the address cannot be used.
    """

    def __init__(self, bus: Bus, host: str, port: int) -> None:
        self.trouble = ""
        self._bus = bus
        opener: Callable[[str, int], Datagrams] = bus.handle or _socket
        try:
            self._socket: Datagrams = (
                ReplayedDatagrams(bus.replay) if bus.replay is not None else opener(host, port)
            )
        except OSError as error:
            raise DeviceError(f"{host}:{port} cannot be reached over UDP ({error})") from error
        self._log = bus.log

    def advance(self, t_ns: int) -> None:
        """It is `t_ns` now."""
        self._bus.advance(t_ns)

    def send(self, data: bytes) -> None:
        """Send one datagram; a refusal is kept in `trouble`."""
        try:
            self._socket.send(data)
            if self._log is not None:
                self._log.add("tx", "", data)
        except OSError as error:
            self.trouble = str(error)

    def receive(self) -> bytes | None:
        """Next datagram, or None; never waits."""
        try:
            data = self._socket.recv(2048)
        except BlockingIOError:
            return None
        except OSError as error:
            # a closed port answers with ICMP, which comes out here
            self.trouble = str(error)
            return None
        self.trouble = ""
        if self._log is not None:
            self._log.add("rx", "", data)
        return data

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class ReplayedDatagrams:
    """A socket that a recording answers for."""

    def __init__(self, replay: Replay) -> None:
        self._replay = replay

    def send(self, data: bytes) -> None:
        """What the driver sends is compared with the recording."""
        self._replay.put("", data)

    def recv(self, size: int) -> bytes:
        """Next datagram of the recording that is due."""
        frame = self._replay.take(False)
        if frame is None:
            raise BlockingIOError(11, "nothing is due")
        return frame.data[:size]

    def close(self) -> None:
        """Nothing to release."""


def _socket(host: str, port: int) -> Datagrams:
    """A real socket, connected and non-blocking."""
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        found.connect((host, port))
    except OSError:
        found.close()
        raise
    found.setblocking(False)
    return found


def split_host(name: str, address: str, port: int) -> tuple[str, int]:
    """Host and port of an address ``HOST`` or ``HOST:PORT``.

    Raises
    ------
    ConfigError
        If there is no host, or the port is not a number.
    """
    host, _, text = address.partition(":")
    if not host or (text and not text.isdigit()):
        raise ConfigError(
            f"box {name!r}: address {address!r} is not HOST or HOST:PORT, e.g. '192.168.1.1'."
        )
    return host, int(text) if text else port
