"""Reports to one USB-31xx through hidapi, with errors that say what to do."""

from __future__ import annotations

import importlib
from typing import Any

from hil.drivers.usb_31xx import codec
from hil.errors import DeviceError, DeviceTimeoutError
from hil.signals.bus import Attached, Bus

FRAME_S, PATIENCE_MS, TRIES = 0.001, 500, 2
RULE = 'KERNEL=="hidraw*", ATTRS{idVendor}=="09db", MODE="0666"'
USB_RULE = 'SUBSYSTEM=="usb", ATTR{idVendor}=="09db", MODE="0666"'
RULE_FILE = "/etc/udev/rules.d/60-hil-mcc.rules"


def module(bus: Bus) -> Any:
    """What stands for the module ``hid``.

    Raises
    ------
    DeviceError
        If the package is missing, or it is the other one of that name.
    """
    if bus.handle is not None:
        return bus.handle
    try:
        found = importlib.import_module("hid")
    except ImportError as error:
        raise DeviceError(
            f"hidapi cannot be loaded ({error}); 'pip install hidapi' brings it."
        ) from error
    if not hasattr(found, "device"):
        raise DeviceError(
            "the package 'hid' is installed where 'hidapi' is needed; 'pip uninstall hid', then "
            "'pip install --force-reinstall hidapi'."
        )
    return found


def enumerated(bus: Bus, product: int) -> list[dict[str, Any]]:
    """What hidapi enumerates of one product id."""
    return list(module(bus).enumerate(codec.VENDOR, product))


def attached(bus: Bus) -> list[Attached]:
    """Boxes of the family on the bus, whether they can be opened or not."""
    found = []
    for model, (product, channels) in codec.MODELS.items():
        for row in enumerated(bus, product):
            what, serial = f"{model}, {channels} outputs", str(row["serial_number"] or "")
            handle = module(bus).device()
            try:
                handle.open_path(row["path"])
            except OSError as error:
                found.append(Attached(serial, f"{what}: {refusal(error)}", False))
            else:
                handle.close()
                found.append(Attached(serial, what))
    return found


def refusal(error: OSError) -> str:
    """Why a box that is attached cannot be opened, and what to do."""
    return (
        f"it cannot be opened ({error}): no permission, or another program holds it. Put "
        f"{USB_RULE!r} and {RULE!r} into {RULE_FILE}, then 'sudo udevadm control --reload' and "
        "plug it in again"
    )


class Link:
    """Reports to one box.

    Parameters
    ----------
    name : str
        Name of the box for messages.
    bus : Bus
        HID.
    product : int
        Product id.
    serial : str
        Serial number; empty takes the first.
    """

    def __init__(self, name: str, bus: Bus, product: int, serial: str) -> None:
        self.name, self._bus = name, bus
        found = enumerated(bus, product)
        fits = [d for d in found if not serial or d["serial_number"] == serial]
        if not fits:
            seen = ", ".join(str(d["serial_number"]) for d in found)
            what = f" with serial number {serial} (attached: {seen or 'none'})" if serial else ""
            raise DeviceError(
                f"box {name!r}: no USB-31xx 09db:{product:04x}{what} is attached; plug it in."
            )
        self.serial = str(fits[0]["serial_number"])
        self._device = module(bus).device()
        try:
            self._device.open_path(fits[0]["path"])
        except OSError as error:
            raise DeviceError(f"box {name!r}: {refusal(error)}.") from error
        self._device.set_nonblocking(1)
        while self._device.read(codec.REPLY_MAX):  # what a crashed program left
            pass

    def write(self, report: bytes) -> None:
        """One report, at most one a frame; raises a `DeviceError` if the box is gone."""
        try:
            done = self._device.write(report)
        except (OSError, ValueError) as error:
            raise self._trouble(str(error)) from error
        if done != len(report):
            raise self._trouble("it is gone")

    def _trouble(self, text: str) -> DeviceError:
        return DeviceError(f"box {self.name!r} (USB-31xx): {text}; plug it in again.")

    def say(self, report: bytes) -> None:
        """One report and the frame that it takes; for opening and closing."""
        self.write(report)
        self._bus.pause(FRAME_S)

    def poll(self) -> bytes:
        """An input report that waits, or nothing."""
        try:
            return bytes(self._device.read(codec.REPLY_MAX))
        except (OSError, ValueError) as error:
            raise self._trouble(str(error)) from error

    def query(self, report: bytes, length: int) -> bytes:
        """Answer of `length` bytes, without its number; replies to older questions are skipped.

        Raises
        ------
        DeviceTimeoutError
            If none comes, asked twice.
        """
        for _ in range(TRIES):
            self.say(report)
            for _ in range(PATIENCE_MS):
                reply = self.poll()
                if reply and reply[0] == report[0] and len(reply) > length:
                    return reply[1 : 1 + length]
                if not reply:
                    self._bus.pause(FRAME_S)
        raise DeviceTimeoutError(
            f"box {self.name!r} (USB-31xx) does not answer report 0x{report[0]:02x}; plug it in "
            "again."
        )

    def close(self) -> None:
        """Release the box."""
        self._device.close()
