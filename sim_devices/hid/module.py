"""What hidapi's module ``hid`` is to a driver, with simulated devices on the bus.

It answers and fails as hidapi 0.15 does: `write` returns -1 when the device is gone, `read`
raises, at most 30 input reports wait and the oldest are dropped.  Nothing sleeps: a read that
waits asks `wait` to let time pass.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Protocol

QUEUE = 30


class HidFirmware(Protocol):
    """What a simulated device is to the bus.

    `inputs` holds input reports that wait; `descriptor` is what enumeration says of it.
    """

    plugged: bool
    readable: bool
    inputs: deque[bytes]
    descriptor: dict[str, Any]

    def output(self, report: bytes) -> None:
        """Take an output report, number first."""
        ...


class SimHid:
    """Stands for the module ``hid``.

    Parameters
    ----------
    wait : callable
        ``wait(milliseconds)`` lets time pass.
    """

    def __init__(self, wait: Callable[[int], None] = lambda milliseconds: None) -> None:
        self.devices: list[HidFirmware] = []
        self.wait = wait

    def enumerate(self, vendor_id: int = 0, product_id: int = 0) -> list[dict[str, Any]]:
        """Descriptors of what is on the bus; 0 = any."""
        return [
            dict(d.descriptor)
            for d in self.devices
            if d.plugged
            and vendor_id in (0, d.descriptor["vendor_id"])
            and product_id in (0, d.descriptor["product_id"])
        ]

    def device(self) -> SimDevice:
        """A handle that is not open yet."""
        return SimDevice(self)


class SimDevice:
    """A handle: hidapi's ``hid.device()``."""

    def __init__(self, bus: SimHid) -> None:
        self._bus = bus
        self._firmware: HidFirmware | None = None
        self._nonblocking = False

    def open_path(self, device_path: bytes) -> None:
        """Open the device of that path."""
        if self._firmware is not None:
            raise RuntimeError("already open")
        for d in self._bus.devices:
            if d.plugged and d.readable and d.descriptor["path"] == device_path:
                self._firmware = d
                return
        raise OSError("open failed")

    def open(
        self, vendor_id: int = 0, product_id: int = 0, serial_number: str | None = None
    ) -> None:
        """Open the first device of those numbers."""
        for d in self._bus.enumerate(vendor_id, product_id):
            if serial_number in (None, d["serial_number"]):
                self.open_path(d["path"])
                return
        raise OSError("open failed")

    def close(self) -> None:
        """Release; twice is once."""
        self._firmware = None

    def set_nonblocking(self, v: int) -> int:
        """Whether `read` without a time-out returns at once."""
        self._open()
        self._nonblocking = bool(v)
        return 0

    def write(self, buff: Sequence[int]) -> int:
        """Output report; the number of bytes, or -1."""
        firmware, report = self._firmware or self._open(), bytes(buff)
        if not firmware.plugged:
            return -1
        firmware.output(report)
        return len(report)

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        """Input report, or nothing when none comes in time."""
        firmware = self._open()
        left = timeout_ms
        while firmware.plugged and not firmware.inputs and left > 0:
            self._bus.wait(1)
            left -= 1
        if not firmware.plugged:
            raise OSError("read error")
        if not firmware.inputs and not timeout_ms and not self._nonblocking:
            raise RuntimeError("a blocking read of nothing would never return")
        return list(firmware.inputs.popleft()[:max_length]) if firmware.inputs else []

    def get_serial_number_string(self) -> str:
        """Serial number."""
        return str(self._open().descriptor["serial_number"])

    def get_product_string(self) -> str:
        """Product."""
        return str(self._open().descriptor["product_string"])

    def get_manufacturer_string(self) -> str:
        """Manufacturer."""
        return str(self._open().descriptor["manufacturer_string"])

    def error(self) -> str:
        """What the wheel says."""
        self._open()
        return "Success"

    def _open(self) -> HidFirmware:
        if self._firmware is None:
            raise ValueError("not open")
        return self._firmware
