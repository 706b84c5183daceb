"""Transfers to one USB-QUAD08 through pyusb, with errors that say what to do.

A box that has just got power is brought up until its FPGA is proven.  pyusb finds the libusb of the
system, else the one that the package libusb-package brings.
"""

from __future__ import annotations

import errno
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import usb.core
import usb.util
from usb.backend import libusb1

from hil.drivers.usb_quad08 import codec
from hil.errors import ConfigError, DeviceError, DeviceTimeoutError
from hil.signals.bus import Attached, Bus


def libusb_backend(given: Any = None) -> Any:
    """Back end for `usb.core.find`: as given, or of the libusb that there is; None without any."""
    found = libusb1.get_backend() if given is None else given
    if found is not None:
        return found
    try:
        import libusb_package
    except ImportError:
        return None
    return libusb1.get_backend(find_library=libusb_package.find_library)


TIMEOUT_MS = 1000
_RULE = 'SUBSYSTEM=="usb", ATTR{idVendor}=="09db", MODE="0666"'
_RULE_FILE = "/etc/udev/rules.d/60-hil-mcc.rules"
_ADVICE = {
    errno.EACCES: f"no permission; put {_RULE!r} into {_RULE_FILE}, then "
    "'sudo udevadm control --reload' and plug it in again",
    errno.EBUSY: "another program holds it; stop that program",
    errno.ENODEV: "it was unplugged, or lost its supply",
    errno.EPIPE: "it refused the request; its FPGA may not be loaded, plug it in again",
    errno.ETIMEDOUT: "it does not answer; plug it in again",
}


def find_devices(backend: Any, product: int, serial: str) -> list[Any]:
    """Attached devices of one product id, with that serial number if it is not empty.

    Raises
    ------
    DeviceError
        If there is no libusb.
    """
    try:
        found = usb.core.find(
            find_all=True,
            idVendor=codec.VENDOR,
            idProduct=product,
            backend=libusb_backend(backend),
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
    for device in find_devices(bus.handle, codec.LOADER, ""):
        what = "USB-QUAD08 without firmware; give images = FOLDER, see docs/hardware.md"
        found.append(Attached("", f"{what} (bus {device.bus})", False))
    for device in find_devices(bus.handle, codec.PRODUCT, ""):
        try:
            serial = str(device.serial_number)
        except (usb.core.USBError, ValueError) as error:
            why = _ADVICE.get(getattr(error, "errno", None) or errno.EACCES, str(error))
            found.append(Attached("", f"USB-QUAD08: {why}", False))
        else:
            found.append(Attached(serial, "USB-QUAD08, eight encoder counters"))
    return found


class UsbLink:
    """Control and bulk transfers to one device.

    Parameters
    ----------
    name : str
        Name of the box for messages.
    device : usb.core.Device
        From `find_devices`.
    """

    def __init__(self, name: str, device: Any) -> None:
        self.name = name
        self.device = device

    def out(self, request: int, value: int = 0, index: int = 0, data: bytes = b"") -> None:
        """Vendor request to the device."""
        try:
            sent = self.device.ctrl_transfer(
                codec.VENDOR_OUT, request, value, index, data, TIMEOUT_MS
            )
        except usb.core.USBError as error:
            raise self.trouble(error) from error
        if sent != len(data):
            raise DeviceError(f"box {self.name!r}: {sent} of {len(data)} bytes were taken.")

    def ask(self, request: int, length: int, index: int = 0) -> int:
        """Vendor request from the device: a little-endian number of `length` bytes."""
        try:
            reply = self.device.ctrl_transfer(
                codec.VENDOR_IN, request, 0, index, length, TIMEOUT_MS
            )
        except usb.core.USBError as error:
            raise self.trouble(error) from error
        if len(reply) != length:
            raise DeviceError(
                f"box {self.name!r}: request 0x{request:02x} was answered with {len(reply)} "
                f"bytes instead of {length}; plug it in again."
            )
        return codec.channel_number(bytes(reply))

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
        advice = _ADVICE.get(error.errno, f"{error.strerror or error}; plug it in again")
        return kind(f"box {self.name!r} (USB-QUAD08): {advice}.")

    def close(self) -> None:
        """Release the interface; a device that is gone is released already."""
        usb.util.dispose_resources(self.device)


#: Longest time that the box takes to come back with its firmware [s]; ULDAQ waits a flat 5 s.
_COMEBACK_S, _STEP_S = 8.0, 0.25
IMAGES = ("loader.hex", "firmware.hex", "fpga.bin")


def open_link(
    name: str, backend: Any, serial: str, images: str, pause: Callable[[float], None]
) -> UsbLink:
    """Find a box, load what it lacks, and prove it.

    Raises
    ------
    DeviceError
        If none is attached, or it cannot be started; says what to do.
    """
    found = find_devices(backend, codec.PRODUCT, serial)
    if not found:
        cold = find_devices(backend, codec.LOADER, "")
        if not cold:
            what = f" with serial number {serial}" if serial else ""
            raise DeviceError(
                f"box {name!r}: no USB-QUAD08{what} is attached (09db:00ca, or 09db:0470 before "
                "its firmware is loaded); plug it in."
            )
        load_firmware(UsbLink(name, cold[0]), _folder(name, images))
        found = _come_back(name, backend, serial, pause)
    link = UsbLink(name, found[0])
    if link.ask(codec.FPGA_STATE, 1) != 1:
        check_version(link)
        load_fpga(link, _folder(name, images))
    for words in codec.DAC_WORDS:  # all of it twice, as ULDAQ does
        check_version(link)
        prove(link)
        link.write_all(codec.disarm_all(words))
    return link


def check_version(link: UsbLink) -> None:
    """Refuse firmware that is too old."""
    version = link.ask(codec.VERSION, 2)
    if version < codec.FIRMWARE_MIN:
        raise DeviceError(
            f"box {link.name!r}: firmware {version:#06x} is older than {codec.FIRMWARE_MIN:#06x}; "
            "load the images of UL for Linux 1.2.1 or later."
        )


def _folder(name: str, images: str) -> Path:
    """Folder of the images, complete."""
    where = "the options of the box: images = FOLDER"
    if not images:
        raise DeviceError(
            f"box {name!r}: it has no firmware (it loses it with its supply); give {where}, "
            f"with {', '.join(IMAGES)}, or run a program of UL for Linux once. See "
            "docs/hardware.md."
        )
    folder = Path(images).expanduser()
    missing = [file for file in IMAGES if not (folder / file).is_file()]
    if missing:
        raise ConfigError(f"box {name!r}: {folder} lacks {', '.join(missing)}; see {where}.")
    return folder


def load_firmware(link: UsbLink, folder: Path) -> None:
    """Load the loader, through it the firmware, and start it; the box drops off the bus."""
    loader, firmware = (
        codec.hex_records((folder / file).read_text(encoding="ascii"), str(folder / file))
        for file in IMAGES[:2]
    )
    outside = [r for r in firmware if r[0] > codec.INTERNAL_TOP]
    inside = [r for r in firmware if r[0] <= codec.INTERNAL_TOP]
    link.device.set_interface_altsetting(0, 0)
    _reset(link, True)
    _write(link, [r for r in loader if r[0] <= codec.INTERNAL_TOP])
    _reset(link, False)
    _write(link, outside)
    _reset(link, True)
    _write(link, inside)
    _reset(link, True)
    _reset(link, False)
    link.close()


def _reset(link: UsbLink, hold: bool) -> None:
    link.out(codec.RAM, codec.CPU_CONTROL, 0, bytes([hold]))


def _write(link: UsbLink, records: list[tuple[int, bytes]]) -> None:
    for address, data in records:
        link.out(codec.RAM, address, 0, data)


def _come_back(name: str, backend: Any, serial: str, pause: Callable[[float], None]) -> list[Any]:
    for _ in range(round(_COMEBACK_S / _STEP_S)):
        pause(_STEP_S)
        found = find_devices(backend, codec.PRODUCT, serial)
        if found:
            return found
    raise DeviceError(
        f"box {name!r}: it did not come back within {_COMEBACK_S:g} s after its firmware was "
        "loaded; check the images, and plug it in again."
    )


def load_fpga(link: UsbLink, folder: Path) -> None:
    """Configure the FPGA."""
    link.out(codec.FPGA_STATE)
    for block in codec.fpga_blocks((folder / IMAGES[2]).read_bytes()):
        link.out(codec.FPGA_DATA, data=block)
    if link.ask(codec.FPGA_STATE, 1) != 1:
        raise DeviceError(
            f"box {link.name!r}: its FPGA refused {folder / IMAGES[2]}; extract the image anew."
        )


def prove(link: UsbLink) -> None:
    """Write and read back the eight patterns that only a working FPGA returns."""
    for pattern in codec.mark_patterns():
        link.write(codec.MARK, pattern)
        seen = link.read(codec.MARK) & 0xFF
        if seen != pattern:
            raise DeviceError(
                f"box {link.name!r}: the FPGA returned 0x{seen:02x} for 0x{pattern:02x}; plug it "
                "in again, so that it is loaded anew."
            )
