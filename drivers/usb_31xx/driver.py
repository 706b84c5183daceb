"""Measurement Computing USB-31xx: analog outputs, updated by reports over HID in the background.

Voltages are calibrated, and zero on every way out.  The outputs hold their last value when the host
dies.  While all is well a digital line is turned over every few milliseconds; the amplifiers need a
watchdog on that line (docs/hardware.md).
"""

from __future__ import annotations

import atexit
import importlib
import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

from hil.drivers.links.uldaq import OWN, ULDAQ, UldaqVolts, check_route
from hil.drivers.usb_31xx import codec
from hil.errors import ConfigError, DeviceError, DeviceTimeoutError, unknown
from hil.signals.bus import Attached, Bus

#: Frames of full-speed USB, one report each [1/s]; seen on hardware by users of the family.
REPORTS_PER_S = 1000.0
#: Reports that ask whether the box is alive, per second.
QUERIES_PER_S = 20.0
#: Longest time between two edges of the heartbeat [ms], see docs/hardware.md.
SLOWEST_BEAT_MS = 50.0


@dataclass(frozen=True)
class Usb31xxConfig:
    """Options of the box ``usb-31xx``.

    Parameters
    ----------
    model : str
        Of `codec.DAC_MODELS`.
    staged : bool
        All channels change at once: they are staged and then updated by a further report.
    heartbeat_bit : int
        Digital line that is turned over while all is well, for the watchdog of an amplifier.
    heartbeat_ms : float
        Time between its edges [ms], 2 to 50: amplifiers cut themselves off 60 ms after the last
        one; 0 = no heartbeat from this box.
    route : str
        ``"own"``, or ``"uldaq"``, the vendor's library (`hil.drivers.links.uldaq`).
    """

    model: str = "usb-3101"
    staged: bool = True
    heartbeat_bit: int = 0
    heartbeat_ms: float = 20.0
    route: str = OWN

    def __post_init__(self) -> None:
        check_route(self.route)
        if self.model not in codec.DAC_MODELS:
            raise ConfigError(unknown("model", self.model, codec.DAC_MODELS))
        if not 0 <= self.heartbeat_bit <= 7:
            raise ConfigError(f"heartbeat_bit = {self.heartbeat_bit}: 0 to 7 is needed.")
        if self.heartbeat_ms != 0 and not 2.0 <= self.heartbeat_ms <= SLOWEST_BEAT_MS:
            raise ConfigError(
                f"heartbeat_ms = {self.heartbeat_ms:g}: 2 to {SLOWEST_BEAT_MS:g} is needed, as the "
                "watchdog of an amplifier waits 60 ms at most; or 0, where another box of the arm "
                "gives the heartbeat."
            )

    @property
    def available(self) -> int:
        """Channels that the box has, from 0 on."""
        return codec.DAC_MODELS[self.model][1]

    def reports(self, channels: int) -> int:
        """Reports per update of so many channels."""
        return channels + (1 if self.staged and channels > 1 else 0)

    def rate_hz(self, channels: int) -> float:
        """Updates per second that so many channels get."""
        beats = 1e3 / self.heartbeat_ms if self.heartbeat_ms else 0.0
        return (REPORTS_PER_S - beats - QUERIES_PER_S) / self.reports(channels)


_FRAME_S, _PATIENCE_MS, _TRIES = 0.001, 500, 2
_RULE = 'KERNEL=="hidraw*", ATTRS{idVendor}=="09db", MODE="0666"'
USB_RULE = 'SUBSYSTEM=="usb", ATTR{idVendor}=="09db", MODE="0666"'
_RULE_FILE = "/etc/udev/rules.d/60-hil-mcc.rules"


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
    for model, (product, channels) in codec.DAC_MODELS.items():
        for row in enumerated(bus, product):
            what, serial = f"{model}, {channels} outputs", str(row["serial_number"] or "")
            handle = module(bus).device()
            try:
                handle.open_path(row["path"])
            except OSError as error:
                found.append(Attached(serial, f"{what}: {_refusal(error)}", False))
            else:
                handle.close()
                found.append(Attached(serial, what))
    return found


def _refusal(error: OSError) -> str:
    """Why a box that is attached cannot be opened, and what to do."""
    return (
        f"it cannot be opened ({error}): no permission, or another program holds it. Put "
        f"{USB_RULE!r} and {_RULE!r} into {_RULE_FILE}, then 'sudo udevadm control --reload' and "
        "plug it in again"
    )


class HidLink:
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
            raise DeviceError(f"box {name!r}: {_refusal(error)}.") from error
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
        self._bus.pause(_FRAME_S)

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
        for _ in range(_TRIES):
            self.say(report)
            for _ in range(_PATIENCE_MS):
                reply = self.poll()
                if reply and reply[0] == report[0] and len(reply) > length:
                    return reply[1 : 1 + length]
                if not reply:
                    self._bus.pause(_FRAME_S)
        raise DeviceTimeoutError(
            f"box {self.name!r} (USB-31xx) does not answer report 0x{report[0]:02x}; plug it in "
            "again."
        )

    def close(self) -> None:
        """Release the box."""
        self._device.close()


_FRAME_NS = round(_FRAME_S * 1e9)
_QUERY_NS = round(1e9 / QUERIES_PER_S)
_STATUS = bytes([codec.GET_STATUS])


class Usb31xx:
    """Analog outputs of +/- 10 V.

    Parameters
    ----------
    name : str
        Name of the box.
    bus : Bus
        HID.
    serial : str
        Serial number; empty takes the first box.
    config : Usb31xxConfig
        Model, staging, heartbeat.
    channels : tuple of int
        Channels that are used.

    Attributes
    ----------
    trouble : str
        Why the box is lost; empty while it is not.
    heartbeat : bool
        Whether it shows an amplifier that the host lives.

    Raises
    ------
    DeviceError
        If the box is not there, does not answer, or is not calibrated.
    """

    def __init__(
        self, name: str, bus: Bus, serial: str, config: Usb31xxConfig, channels: tuple[int, ...]
    ) -> None:
        product, available = codec.DAC_MODELS[config.model]
        if any(c >= available for c in channels):
            raise ConfigError(
                f"box {name!r}: {config.model} has the channels 0 to {available - 1}, not "
                f"{max(channels)}."
            )
        self.name, self.config, self.channels = name, config, channels
        self.heartbeat = config.heartbeat_ms > 0
        self._bus = bus
        self._link = HidLink(name, bus, product, serial)
        self.serial = self._link.serial
        self.trouble = ""
        self._lock = threading.Lock()
        self._wanted = dict.fromkeys(channels, 0)
        self._sent: dict[int, int] = {}
        self._dirty: dict[int, bool] = {}
        self._queue: deque[bytes] = deque()
        self._beating, self._beat = False, 0
        self._next_ns = self._beat_ns = self._query_ns = self._asked_ns = 0
        self._stop = _nothing
        try:
            self._start()
        except BaseException:
            self._link.close()
            raise

    def _start(self) -> None:
        """0 V in the right range, calibration, master of the sync line, heartbeat line low."""
        config, link = self.config, self._link
        for channel in self.channels:
            link.say(codec.aout_config(channel))
        self._cal = {
            c: codec.decode_calibration(
                link.query(codec.memory_read(codec.calibration_address(c), 8), codec.FLASH_BYTES),
                f"box {self.name!r}, channel {c}",
            )
            for c in self.channels
        }
        link.say(bytes([codec.SET_SYNC, codec.MASTER]))
        if not link.query(_STATUS, 1)[0] & 1:
            raise DeviceError(f"box {self.name!r} does not become master of its sync line.")
        if config.heartbeat_ms:
            link.say(bytes([codec.DIO_BIT, config.heartbeat_bit, 0]))
            link.say(bytes([codec.DIO_DIRECTION_BIT, config.heartbeat_bit, 0]))
        self._zero()
        self._next_ns = self._query_ns = self._bus.now_ns()
        atexit.register(self.close)
        self._stop = self._bus.run(self.name, self._pump)

    def _zero(self) -> None:
        """0 V now, all channels, past every queue."""
        self._queue.clear()
        for channel in self.channels:
            self._wanted[channel] = 0
            value = codec.dac_code(0, *self._cal[channel])
            self._link.say(codec.aout(channel, value, codec.NOW))
            self._sent[channel] = value

    def describe(self) -> str:
        """What the box does, for `hil devices`."""
        n, beat = len(self.channels), self.config.heartbeat_ms
        sign = f"heartbeat on DIO{self.config.heartbeat_bit}" if beat else "no heartbeat"
        return (
            f"{self.config.model} {self.serial}: {n} of its outputs at {self.rate_hz:.0f} "
            f"updates/s, {sign}"
        )

    @property
    def rate_hz(self) -> float:
        """Updates per second that every channel gets."""
        return self.config.rate_hz(len(self.channels))

    # the fast path

    def put(self, channel: int, code: int) -> None:
        """Code -32768..32767 for a channel; it goes out as soon as the box can."""
        if self._wanted[channel] != code:
            self._wanted[channel] = code
            self._dirty[channel] = True

    def rest(self) -> None:
        """Zeros as soon as possible, and no heartbeat any more; does not wait."""
        for channel in self.channels:
            self.put(channel, 0)
        self._beating = False

    # the background

    def _pump(self) -> float:
        """Send the report that is most urgent; time until the next one may go [s]."""
        now = self._bus.now_ns()
        if self.trouble:
            return 1.0
        if now < self._next_ns:
            return (self._next_ns - now) * 1e-9
        if not self._lock.acquire(blocking=False):  # zeros are going out
            return _FRAME_S
        try:
            report = self._urgent(now)
            if report:
                due = self._next_ns + _FRAME_NS
                self._next_ns = due if due > now else now
                self._link.write(report)
            if self._asked_ns:
                self._listen(now)
        except DeviceError as error:
            self.trouble = str(error)
            return 1.0
        finally:
            self._lock.release()
        return 0.0 if report else _FRAME_S / 4

    def _urgent(self, now: int) -> bytes:
        """Heartbeat, question, next report of an update, or nothing."""
        queue = self._queue
        if self._beating and self.heartbeat and now >= self._beat_ns:
            self._beat_ns = now + round(self.config.heartbeat_ms * 1e6)
            self._beat ^= 1
            return bytes([codec.DIO_BIT, self.config.heartbeat_bit, self._beat])
        if not queue:
            if not self._asked_ns and now >= self._query_ns:
                self._asked_ns, self._query_ns = now, now + _QUERY_NS
                return _STATUS
            if self._dirty:
                self._update(queue)
        return queue.popleft() if queue else b""

    def _update(self, queue: deque[bytes]) -> None:
        """Queue what has changed: staged and synced, or at once."""
        dirty, self._dirty = self._dirty, {}  # first: a code that comes now is not lost
        sent, changed = self._sent, []
        for c in dirty:
            slope, offset = self._cal[c]
            value = codec.dac_code(self._wanted[c], slope, offset)
            if value != sent[c]:
                sent[c] = value
                changed.append(c)
        staged = self.config.staged and len(changed) > 1
        when = codec.ON_SYNC if staged else codec.NOW
        for c in changed:
            queue.append(codec.aout(c, sent[c], when))
        if staged:
            queue.append(bytes([codec.AOUT_SYNC]))

    def _listen(self, now: int) -> None:
        """The answer to the question whether the box is alive, and still as it was set up."""
        reply = self._link.poll()
        if reply and reply[0] == codec.GET_STATUS and len(reply) > 1:
            if not reply[1] & 1:
                raise DeviceError(
                    f"box {self.name!r} has lost its settings (it was reset); start anew."
                )
            self._asked_ns = 0
        elif self._asked_ns and now - self._asked_ns > 2 * _QUERY_NS:
            raise DeviceError(f"box {self.name!r} (USB-31xx) does not answer; plug it in again.")

    # the ways in and out

    def power(self, on: bool) -> None:
        """Heartbeat on; or zeros, at once and waiting for them, and no heartbeat."""
        if on:
            self._beating = True
            return
        self._beating = False
        with self._lock:
            try:
                self._zero()
                self._bus.pause(2 * _FRAME_S)
            except DeviceError as error:
                self.trouble = self.trouble or str(error)

    def close(self) -> None:
        """Zeros, then release the box, as far as it is still there."""
        stop, self._stop = self._stop, _nothing
        if stop is _nothing:
            return
        stop()
        self.power(False)
        atexit.unregister(self.close)
        self._link.close()


def _nothing() -> None:
    """What stops a pump that does not run."""


def open_box(
    name: str, bus: Bus, address: str, config: Usb31xxConfig, channels: tuple[int, ...]
) -> Usb31xx | UldaqVolts:
    """Open a box by the route of its options."""
    if config.route == ULDAQ:
        return UldaqVolts(name, bus, address, config, channels)
    return Usb31xx(name, bus, address, config, channels)


BUS = "hid"
Config = Usb31xxConfig
