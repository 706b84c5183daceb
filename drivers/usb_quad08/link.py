"""Transfers to one USB-QUAD08 through pyusb, with errors that say what to do."""

from __future__ import annotations

import errno
from array import array
from typing import Any

import usb.core
import usb.util

from hil.drivers.links import libusb
from hil.drivers.usb_quad08 import codec
from hil.errors import DeviceError, DeviceTimeoutError
from hil.signals.bus import Attached, Bus

TIMEOUT_MS = 1000
RULE = 'SUBSYSTEM=="usb", ATTR{idVendor}=="09db", MODE="0666"'
RULE_FILE = "/etc/udev/rules.d/60-hil-mcc.rules"
ADVICE = {
    errno.EACCES: f"no permission; put {RULE!r} into {RULE_FILE}, then "
    "'sudo udevadm control --reload' and plug it in again",
    errno.EBUSY: "another program holds it; stop that program",
    errno.ENODEV: "it was unplugged, or lost its supply",
    errno.EPIPE: "it refused the request; its FPGA may not be loaded, plug it in again",
    errno.ETIMEDOUT: "it does not answer; plug it in again",
}


def find(backend: Any, product: int, serial: str) -> list[Any]:
    """Attached devices of one product id, with that serial number if it is not empty.

    Raises
    ------
    DeviceError
        If there is no libusb.
    """
    try:
        found = usb.core.find(
            find_all=True, idVendor=codec.VENDOR, idProduct=product, backend=libusb.backend(backend)
        )
        devices = list(found)
    except usb.core.NoBackendError:
        raise DeviceError(
            "libusb is missing, so that pyusb finds no device; install it: 'pip install "
            "libusb-package', or the system's own, 'sudo apt install libusb-1.0-0'."
        ) from None
    return [d for d in devices if not serial or serial_of(d) == serial]


def serial_of(device: Any) -> str:
    """Serial number of a device; empty where it may not be read."""
    try:
        return str(usb.util.get_string(device, device.iSerialNumber) or "")
    except (usb.core.USBError, ValueError):
        return ""


def attached(bus: Bus) -> list[Attached]:
    """Boxes on the bus, with and without firmware, readable or not."""
    found = []
    for device in find(bus.handle, codec.LOADER, ""):
        what = "USB-QUAD08 without firmware; give images = FOLDER, see docs/hardware.md"
        found.append(Attached("", f"{what} (bus {device.bus})", False))
    for device in find(bus.handle, codec.PRODUCT, ""):
        try:
            serial = str(device.serial_number)
        except (usb.core.USBError, ValueError) as error:
            why = ADVICE.get(getattr(error, "errno", None) or errno.EACCES, str(error))
            found.append(Attached("", f"USB-QUAD08: {why}", False))
        else:
            found.append(Attached(serial, "USB-QUAD08, eight encoder counters"))
    return found


class Link:
    """Control and bulk transfers to one device.

    Parameters
    ----------
    name : str
        Name of the box for messages.
    device : usb.core.Device
        From `find`.
    """

    def __init__(self, name: str, device: Any) -> None:
        self.name = name
        self.device = device

    def out(self, request: int, value: int = 0, index: int = 0, data: bytes = b"") -> None:
        """Vendor request to the device."""
        try:
            sent = self.device.ctrl_transfer(codec.OUT, request, value, index, data, TIMEOUT_MS)
        except usb.core.USBError as error:
            raise self.trouble(error) from error
        if sent != len(data):
            raise DeviceError(f"box {self.name!r}: {sent} of {len(data)} bytes were taken.")

    def ask(self, request: int, length: int, index: int = 0) -> int:
        """Vendor request from the device: a little-endian number of `length` bytes."""
        try:
            reply = self.device.ctrl_transfer(codec.IN, request, 0, index, length, TIMEOUT_MS)
        except usb.core.USBError as error:
            raise self.trouble(error) from error
        if len(reply) != length:
            raise DeviceError(
                f"box {self.name!r}: request 0x{request:02x} was answered with {len(reply)} "
                f"bytes instead of {length}; plug it in again."
            )
        return codec.number(bytes(reply))

    def write(self, register: int, value: int) -> None:
        """Write a register of the FPGA."""
        self.out(codec.REGISTER, value, register)

    def read(self, register: int) -> int:
        """Read a register of the FPGA."""
        return self.ask(codec.REGISTER, 2, register)

    def write_all(self, pairs: Any) -> None:
        """Write registers in order."""
        for register, value in pairs:
            self.write(register, value)

    def packet_size(self) -> int:
        """Largest packet of the stream [byte]."""
        for endpoint in self.device[0][(0, 0)]:
            if endpoint.bEndpointAddress == codec.STREAM:
                return int(endpoint.wMaxPacketSize)
        raise DeviceError(f"box {self.name!r} has no scan endpoint 0x82; is it a USB-QUAD08?")

    def stream(self, buffer: array[int], timeout_ms: int) -> int:
        """Read the scan stream into `buffer`; bytes read, 0 when none came in time.

        Raises
        ------
        DeviceError
            If the device is gone.
        """
        try:
            return int(self.device.read(codec.STREAM, buffer, timeout_ms))
        except usb.core.USBTimeoutError:
            return 0
        except usb.core.USBError as error:
            raise self.trouble(error) from error

    def trouble(self, error: Any) -> DeviceError:
        """What a USB error means for the user."""
        kind = DeviceTimeoutError if error.errno == errno.ETIMEDOUT else DeviceError
        advice = ADVICE.get(error.errno, f"{error.strerror or error}; plug it in again")
        return kind(f"box {self.name!r} (USB-QUAD08): {advice}.")

    def close(self) -> None:
        """Release the interface; a device that is gone is released already."""
        usb.util.dispose_resources(self.device)
