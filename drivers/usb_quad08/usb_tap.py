"""A pyusb back end with a tap: every transfer into a log, or out of a recording.

Keys: ``desc:`` descriptors as JSON, ``ctrl:`` control transfers, ``bulk:`` the stream; an error has
``error N`` in its key.  Devices of other vendors are left out.
"""

from __future__ import annotations

import errno
import json
from array import array
from types import SimpleNamespace
from typing import Any

from usb.backend import IBackend
from usb.core import NoBackendError, USBError, USBTimeoutError

from hil.drivers.usb_quad08.codec import VENDOR
from hil.drivers.usb_quad08.link import libusb_backend
from hil.signals.bus import Bus, FrameLog, Replay

_HEAD = "bLength bDescriptorType"
_FIELDS = {
    "device": f"{_HEAD} bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 "
    "idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations bus "
    "address port_number port_numbers speed",
    "configuration": f"{_HEAD} wTotalLength bNumInterfaces bConfigurationValue iConfiguration "
    "bmAttributes bMaxPower",
    "interface": f"{_HEAD} bInterfaceNumber bAlternateSetting bNumEndpoints bInterfaceClass "
    "bInterfaceSubClass bInterfaceProtocol iInterface",
    "endpoint": f"{_HEAD} bEndpointAddress bmAttributes wMaxPacketSize bInterval bRefresh "
    "bSynchAddress",
}


def recorded(bus: Bus, log: FrameLog) -> Any:
    """Back end whose transfers go into a log too.

    Raises
    ------
    NoBackendError
        If there is no libusb.
    """
    real = libusb_backend(bus.handle)
    if real is None:
        raise NoBackendError("No backend available")
    return _Recorded(real, log)


def replayed(replay: Replay) -> Any:
    """Back end that a recording answers for."""
    return _Replayed(replay)


def _key(number: int, kind: int, request: int, value: int, index: int, length: int) -> str:
    return f"ctrl:{number} {kind:02x} {request:02x} {value:04x} {index:04x} {length}"


class _Recorded(IBackend):  # type: ignore[misc]
    def __init__(self, real: Any, log: FrameLog) -> None:
        self._real, self._log = real, log
        self._devices: list[Any] = []
        self._numbers: dict[int, int] = {}

    def __getattribute__(self, name: str) -> Any:
        """What is not tapped goes to the real one, whatever the base class says."""
        if name.startswith("_") or name in _TAPPED:
            return object.__getattribute__(self, name)
        return getattr(object.__getattribute__(self, "_real"), name)

    def enumerate_devices(self) -> Any:
        every = list(self._real.enumerate_devices())
        self._devices = [d for d in every if self._real.get_device_descriptor(d).idVendor == VENDOR]
        self._log.add("rx", "desc:devices", str(len(self._devices)).encode())
        return iter(self._devices)

    def _described(self, kind: str, found: Any, *place: int) -> Any:
        held = {f: _plain(getattr(found, f, None)) for f in _FIELDS[kind].split()}
        held["extra_descriptors"] = list(getattr(found, "extra_descriptors", None) or [])
        key = " ".join([f"desc:{kind}", *map(str, place)])
        self._log.add("rx", key, json.dumps(held).encode())
        return found

    def get_device_descriptor(self, dev: Any) -> Any:
        found = self._real.get_device_descriptor(dev)
        return self._described("device", found, self._devices.index(dev))

    def get_configuration_descriptor(self, dev: Any, config: int) -> Any:
        found = self._real.get_configuration_descriptor(dev, config)
        return self._described("configuration", found, self._devices.index(dev), config)

    def get_interface_descriptor(self, dev: Any, intf: int, alt: int, config: int) -> Any:
        found = self._real.get_interface_descriptor(dev, intf, alt, config)
        return self._described("interface", found, self._devices.index(dev), intf, alt, config)

    def get_endpoint_descriptor(self, dev: Any, ep: int, intf: int, alt: int, config: int) -> Any:
        found = self._real.get_endpoint_descriptor(dev, ep, intf, alt, config)
        at = (self._devices.index(dev), ep, intf, alt, config)
        return self._described("endpoint", found, *at)

    def open_device(self, dev: Any) -> Any:
        handle = self._real.open_device(dev)
        self._numbers[id(handle)] = self._devices.index(dev)
        return handle

    def ctrl_transfer(
        self,
        handle: Any,
        kind: int,
        request: int,
        value: int,
        index: int,
        data: Any,
        timeout: int,
    ) -> int:
        out = not kind & 0x80
        key = _key(self._numbers[id(handle)], kind, request, value, index, len(data))
        self._log.add("tx", key, bytes(data) if out else b"")
        try:
            n = int(self._real.ctrl_transfer(handle, kind, request, value, index, data, timeout))
        except USBError as error:
            self._log.add("rx", f"ctrl:error {error.errno or 0}", b"")
            raise
        self._log.add("rx", key, n.to_bytes(4, "little") if out else bytes(data[:n]))
        return n

    def bulk_read(self, handle: Any, ep: int, intf: int, buff: Any, timeout: int) -> int:
        try:
            n = int(self._real.bulk_read(handle, ep, intf, buff, timeout))
        except USBTimeoutError:
            raise
        except USBError as error:
            self._log.add("rx", f"bulk:error {error.errno or 0}", b"")
            raise
        self._log.add("rx", f"bulk:{ep:02x}", bytes(buff[:n]))
        return n


_TAPPED = frozenset(n for n in vars(_Recorded) if not n.startswith("_"))


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, (tuple, list)) else value


class _Replayed(IBackend):  # type: ignore[misc]
    def __init__(self, replay: Replay) -> None:
        self._replay = replay
        self._count = 0
        self._held: dict[str, SimpleNamespace] = {}
        while (frame := replay.take(True, "desc")) is not None:
            if frame.key == "desc:devices":
                self._count = max(self._count, int(frame.data))
            else:
                self._held[frame.key] = SimpleNamespace(**json.loads(frame.data))

    def enumerate_devices(self) -> Any:
        return iter(range(self._count))

    def _of(self, kind: str, *place: int) -> Any:
        key = " ".join([f"desc:{kind}", *map(str, place)])
        if key not in self._held:
            raise IndexError(key)
        return self._held[key]

    def get_device_descriptor(self, dev: int) -> Any:
        return self._of("device", dev)

    def get_configuration_descriptor(self, dev: int, config: int) -> Any:
        return self._of("configuration", dev, config)

    def get_interface_descriptor(self, dev: int, intf: int, alt: int, config: int) -> Any:
        return self._of("interface", dev, intf, alt, config)

    def get_endpoint_descriptor(self, dev: int, ep: int, intf: int, alt: int, config: int) -> Any:
        return self._of("endpoint", dev, ep, intf, alt, config)

    def open_device(self, dev: int) -> int:
        return dev

    def get_configuration(self, handle: int) -> int:
        return 1

    def is_kernel_driver_active(self, handle: int, intf: int) -> bool:
        return False

    def _done(self, *args: object) -> None:
        """Nothing to do, and nothing to tell."""

    close_device = set_configuration = claim_interface = release_interface = _done
    clear_halt = reset_device = set_interface_altsetting = _done

    def ctrl_transfer(
        self,
        handle: int,
        kind: int,
        request: int,
        value: int,
        index: int,
        data: array[int],
        timeout: int,
    ) -> int:
        out = not kind & 0x80
        key = _key(handle, kind, request, value, index, len(data))
        self._replay.put(key, bytes(data) if out else b"")
        frame = self._replay.take(True, "ctrl")
        if frame is None:
            raise USBTimeoutError("nothing in the recording", -7, errno.ETIMEDOUT)
        _raise(frame.key)
        if out:
            return len(data)
        n = min(len(frame.data), len(data))
        data[:n] = array("B", frame.data[:n])
        return n

    def bulk_read(self, handle: int, ep: int, intf: int, buff: array[int], timeout: int) -> int:
        frame = self._replay.take(False, "bulk")
        if frame is None:
            raise USBTimeoutError("nothing is due", -7, errno.ETIMEDOUT)
        _raise(frame.key)
        n = min(len(frame.data), len(buff))
        buff[:n] = array("B", frame.data[:n])
        return n


def _raise(key: str) -> None:
    """Raise the error that was recorded, if it was one."""
    _, mark, number = key.partition("error ")
    if mark:
        raise USBError("as in the recording", None, int(number))
