"""Opens a bus of python-can; what is wrong where it does not open."""

from __future__ import annotations

import errno
from typing import Any

import can

from hil.errors import DeviceError


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
