"""A `usb.backend.IBackend` whose bus has simulated devices on it.

What libusb does, it does: logical indices that end by IndexError, partial counts of a bulk read
that times out with something in it, errors by number.  It never sleeps: an empty read calls
`wait`, which says at once that the time is over, or lets the world run on.
"""

from __future__ import annotations

import errno
from array import array
from collections.abc import Callable
from types import SimpleNamespace
from typing import Protocol

import usb.backend
from usb.core import USBError, USBTimeoutError

#: libusb's error codes.
CODES = {
    errno.EIO: -1,
    errno.EACCES: -3,
    errno.ENODEV: -4,
    errno.EBUSY: -6,
    errno.ETIMEDOUT: -7,
    errno.EOVERFLOW: -8,
    errno.EPIPE: -9,
}
TEXTS = {
    errno.EIO: "Input/Output Error",
    errno.EACCES: "Access denied (insufficient permissions)",
    errno.ENODEV: "No such device (it may have been disconnected)",
    errno.EBUSY: "Resource busy",
    errno.ETIMEDOUT: "Operation timed out",
    errno.EOVERFLOW: "Overflow",
    errno.EPIPE: "Pipe error",
}


def failure(number: int) -> USBError:
    """The error that pyusb raises for an error number."""
    kind = USBTimeoutError if number == errno.ETIMEDOUT else USBError
    return kind(TEXTS[number], CODES[number], number)


class UsbFirmware(Protocol):
    """What a simulated device is to the bus.

    Attributes
    ----------
    plugged, readable : bool
        On the bus at all; may be opened.
    vendor, product : int
        Identifiers, which may change when firmware is loaded.
    strings : tuple of str
        Manufacturer, product, serial number.
    endpoints : tuple of (int, int, int)
        Address, attributes and packet size.
    """

    plugged: bool
    readable: bool
    vendor: int
    product: int
    strings: tuple[str, str, str]
    endpoints: tuple[tuple[int, int, int], ...]

    def control(self, kind: int, request: int, value: int, index: int, data: array[int]) -> int:
        """Answer a control transfer; for IN fill `data` and return the number of bytes."""
        ...

    def read(self, endpoint: int, buffer: array[int] | memoryview) -> int:
        """Fill `buffer` with whole packets that wait; their bytes."""
        ...

    def halt_cleared(self, endpoint: int) -> None:
        """The host cleared a halt."""
        ...


class SimUsb(usb.backend.IBackend):  # type: ignore[misc]
    """A bus of simulated devices.

    Parameters
    ----------
    wait : callable, optional
        ``wait(milliseconds)``, called by a bulk read that finds nothing; True when something may
        have come since.
    """

    def __init__(self, wait: Callable[[int], bool] = lambda milliseconds: False) -> None:
        self.devices: list[UsbFirmware] = []
        self.wait = wait
        self.opened = 0

    # identity

    def enumerate_devices(self) -> list[UsbFirmware]:
        """All devices on the bus."""
        return [d for d in self.devices if d.plugged]

    def get_device_descriptor(self, dev: UsbFirmware) -> SimpleNamespace:
        """Device descriptor."""
        return SimpleNamespace(
            bLength=18,
            bDescriptorType=1,
            bcdUSB=0x0200,
            bDeviceClass=0xFF,
            bDeviceSubClass=0,
            bDeviceProtocol=0,
            bMaxPacketSize0=64,
            idVendor=dev.vendor,
            idProduct=dev.product,
            bcdDevice=0x0100,
            iManufacturer=1,
            iProduct=2,
            iSerialNumber=3,
            bNumConfigurations=1,
            bus=1,
            address=self.devices.index(dev) + 1,
            port_number=None,
            port_numbers=None,
            speed=3,
        )

    def get_configuration_descriptor(self, dev: UsbFirmware, config: int) -> SimpleNamespace:
        """Configuration descriptor."""
        _only(config)
        return SimpleNamespace(
            bLength=9,
            bDescriptorType=2,
            wTotalLength=9,
            bNumInterfaces=1,
            bConfigurationValue=1,
            iConfiguration=0,
            bmAttributes=0x80,
            bMaxPower=250,
            extra_descriptors=[],
        )

    def get_interface_descriptor(
        self, dev: UsbFirmware, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Interface descriptor."""
        _only(config, intf, alt)
        return SimpleNamespace(
            bLength=9,
            bDescriptorType=4,
            bInterfaceNumber=0,
            bAlternateSetting=0,
            bNumEndpoints=len(dev.endpoints),
            bInterfaceClass=0xFF,
            bInterfaceSubClass=0,
            bInterfaceProtocol=0,
            iInterface=0,
            extra_descriptors=[],
        )

    def get_endpoint_descriptor(
        self, dev: UsbFirmware, ep: int, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Endpoint descriptor."""
        _only(config, intf, alt)
        address, attributes, size = dev.endpoints[ep]
        return SimpleNamespace(
            bLength=7,
            bDescriptorType=5,
            bEndpointAddress=address,
            bmAttributes=attributes,
            wMaxPacketSize=size,
            bInterval=0,
            bRefresh=0,
            bSynchAddress=0,
            extra_descriptors=[],
        )

    # opening and claiming

    def open_device(self, dev: UsbFirmware) -> UsbFirmware:
        """Open a device."""
        if not dev.plugged:
            raise failure(errno.ENODEV)
        if not dev.readable:
            raise failure(errno.EACCES)
        self.opened += 1
        return dev

    def close_device(self, dev_handle: UsbFirmware) -> None:
        """Close a device."""
        self.opened -= 1

    def set_configuration(self, dev_handle: UsbFirmware, config_value: int) -> None:
        """There is one configuration."""
        _here(dev_handle)

    def get_configuration(self, dev_handle: UsbFirmware) -> int:
        """Value of the active configuration."""
        _here(dev_handle)
        return 1

    def set_interface_altsetting(self, dev_handle: UsbFirmware, intf: int, altsetting: int) -> None:
        """There is one setting."""
        _here(dev_handle)

    def claim_interface(self, dev_handle: UsbFirmware, intf: int) -> None:
        """Claim the interface."""
        _here(dev_handle)

    def release_interface(self, dev_handle: UsbFirmware, intf: int) -> None:
        """Release the interface."""
        _here(dev_handle)

    def clear_halt(self, dev_handle: UsbFirmware, ep: int) -> None:
        """Clear a halt."""
        _here(dev_handle)
        dev_handle.halt_cleared(ep)

    def reset_device(self, dev_handle: UsbFirmware) -> None:
        """Reset the port."""
        _here(dev_handle)

    def is_kernel_driver_active(self, dev_handle: UsbFirmware, intf: int) -> bool:
        """No kernel driver takes a vendor class."""
        return False

    # transfers

    def ctrl_transfer(
        self,
        dev_handle: UsbFirmware,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: array[int],
        timeout: int,
    ) -> int:
        """Control transfer; strings are answered here."""
        _here(dev_handle)
        if bmRequestType == 0x80 and bRequest == 6 and wValue >> 8 == 3:
            return _fill(data, _string(dev_handle.strings, wValue & 0xFF))
        return dev_handle.control(bmRequestType, bRequest, wValue, wIndex, data)

    def bulk_read(
        self, dev_handle: UsbFirmware, ep: int, intf: int, buff: array[int], timeout: int
    ) -> int:
        """Bulk read until the buffer is full; after the time is over, what came until then."""
        _here(dev_handle)
        n, again = dev_handle.read(ep, buff), True
        while n < len(buff) and again:
            again = self.wait(timeout)
            _here(dev_handle)
            if again or not n:
                n += dev_handle.read(ep, memoryview(buff)[n:])
        if not n:
            raise failure(errno.ETIMEDOUT)
        return n


def _only(*indices: int) -> None:
    """There is one of each; that is how pyusb's iterations end."""
    if any(indices):
        raise IndexError


def _here(dev: UsbFirmware) -> None:
    if not dev.plugged:
        raise failure(errno.ENODEV)


def _fill(data: array[int], reply: bytes) -> int:
    n = min(len(data), len(reply))
    data[:n] = array("B", reply[:n])
    return n


def _string(strings: tuple[str, ...], index: int) -> bytes:
    """String descriptor: length, type 3, UTF-16; number 0 lists the languages."""
    body = b"\x09\x04" if index == 0 else strings[index - 1].encode("utf-16-le")
    return bytes([len(body) + 2, 3]) + body
