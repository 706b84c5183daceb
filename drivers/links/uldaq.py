"""USB-QUAD08 and USB-31xx by the vendor's own library, uldaq: a second route beside our drivers.

The library (UL for Linux, MIT) does everything here that `hil.drivers.usb_quad08` and
`hil.drivers.usb_31xx` do by themselves; with ``route = "uldaq"`` a rig file compares the two on one
real box.  Only its documented Python interface is called; functions that wait for the USB run
in the background.
"""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from hil.errors import ConfigError, DeviceError, unknown
from hil.signals.bus import Bus
from hil.signals.device import Status

#: Value of the option `route`: our own driver, or this one.
OWN, ULDAQ = "own", "uldaq"
ROUTES = (OWN, ULDAQ)
_NEEDS = (
    'route = "uldaq" needs the vendor\'s library: install libuldaq (UL for Linux), then '
    "'pip install uldaq'; or write route = \"own\""
)


def check_route(route: str) -> None:
    """Refuse a route that is none."""
    if route not in ROUTES:
        raise ConfigError(unknown("route", route, ROUTES))


def library(name: str, bus: Bus) -> Any:
    """The module ``uldaq``.

    Raises
    ------
    ConfigError
        If it is not installed, or the bus is simulated or replayed, of which it knows nothing.
    """
    if bus.simulated or bus.replay is not None:
        raise ConfigError(
            f'box {name!r}: route = "uldaq" speaks to real boxes only; set its backend to '
            '"hardware", or write route = "own"'
        )
    try:
        return importlib.import_module("uldaq")
    except (ImportError, OSError) as error:  # the module is there, the shared library is not
        raise ConfigError(f"box {name!r}: {_NEEDS} ({error})") from ImportError(str(error))


class Opened:
    """One box, connected by the library.

    Parameters
    ----------
    name : str
        Box.
    bus : Bus
        Hardware.
    product : str
        Product name, as the library lists it.
    serial : str
        Unique identifier; empty takes the only box.

    Raises
    ------
    ConfigError
        If the library is missing.
    DeviceError
        If the box is not there, or cannot be connected.
    """

    def __init__(self, name: str, bus: Bus, product: str, serial: str) -> None:
        self.ul, self.name = library(name, bus), name
        self.device: Any = None
        try:
            found = self.ul.get_daq_device_inventory(self.ul.InterfaceType.USB)
            mine = [d for d in found if d.product_name.upper() == product.upper()]
            fits = [d for d in mine if serial in ("", d.unique_id)]
            if not fits:
                seen = ", ".join(f"{d.product_name} {d.unique_id}" for d in found)
                raise DeviceError(
                    f"box {name!r}: uldaq lists no {product} {serial}".rstrip()
                    + f" (it lists {seen or 'nothing'}); plug it in, and end programs that hold it"
                )
            self.serial = str(fits[0].unique_id)
            self.device = self.ul.DaqDevice(fits[0])
            self.device.connect()
        except self.ul.ULException as error:
            self.close()
            raise self.trouble(error) from error

    def trouble(self, error: Exception) -> DeviceError:
        """What an error of the library means."""
        return DeviceError(f"box {self.name!r} (by uldaq): {error}; plug it in again.")

    def close(self) -> None:
        """Release the box, as far as it is still there."""
        device = self.device
        for leave in (device.disconnect, device.release) if device is not None else ():
            with suppress(self.ul.ULException):  # it may be gone
                leave()


class BoxClock(Protocol):
    """Chooses the scan that stands for a time (`hil.drivers.usb_quad08.driver.ScanClock`)."""

    def choose(self, t_ns: int, newest: int) -> int:
        """Number of the scan for `t_ns` when `newest` has arrived."""
        ...


#: Scans of the ring that the library fills, in seconds of the stream.
RING_S = 1.0
_FIRST_DATA_S, _STEP_S = 1.0, 0.005


class UldaqCounts:
    """Counts of a USB-QUAD08, see `hil.rig.boxes.CountsBox`.

    Parameters
    ----------
    name, bus, serial
        As of `Opened`.
    config : Quad08Config
        Rates and modes; ``images`` is not needed, the library brings them.
    channels : tuple of int
        Channels; all from the lowest to the highest are scanned.
    clock : callable
        ``clock(period_ns, packet_ns)`` makes a `BoxClock`.
    """

    def __init__(
        self,
        name: str,
        bus: Bus,
        serial: str,
        config: Any,
        channels: tuple[int, ...],
        clock: Callable[[float, float], BoxClock],
    ) -> None:
        if config.debounce_us:
            raise ConfigError(f'box {name!r}: debounce_us is of route = "own" alone; write 0.')
        self.name, self.config, self.channels = name, config, channels
        self.counts = np.zeros(len(channels), np.int64)
        self.trouble = ""
        self._low, self._high = min(channels), max(channels)
        self._box = Opened(name, bus, "USB-QUAD08", serial)
        self.serial, self._half = self._box.serial, 1 << (config.bits - 1)
        self._columns = [c - self._low for c in channels]
        self._last = [0] * len(channels)
        self._used, self._fresh_ns = -1, 0
        try:
            self._start(bus, clock)
        except self._box.ul.ULException as error:
            self.close()
            raise self._box.trouble(error) from error
        except BaseException:
            self.close()
            raise

    def _start(self, bus: Bus, clock: Callable[[float, float], BoxClock]) -> None:
        """Configure the counters, start the scan, wait for data."""
        ul, config = self._box.ul, self.config
        self._counters = self._box.device.get_ctr_device()
        mode = getattr(ul.CounterMeasurementMode, f"ENCODER_X{config.edges}")
        if config.index:
            mode |= getattr(ul.CounterMeasurementMode, f"ENCODER_{config.index.upper()}_ON_Z")
        for counter in range(self._low, self._high + 1):
            self._counters.c_config_scan(
                counter,
                ul.CounterMeasurementType.ENCODER,
                mode,
                ul.CounterEdgeDetection.RISING_EDGE,
                ul.CounterTickSize.TICK_20ns,
                ul.CounterDebounceMode.NONE,
                ul.CounterDebounceTime.DEBOUNCE_0ns,
                ul.CConfigScanFlag.DEFAULT,
            )
        self._width = self._high - self._low + 1
        self._ring = round(RING_S * config.rate_hz)
        self._data = ul.create_int_buffer(self._width, self._ring)
        rate = self._counters.c_in_scan(
            self._low,
            self._high,
            self._ring,
            config.rate_hz,
            ul.ScanOption.CONTINUOUS,
            getattr(ul.CInScanFlag, f"CTR{config.bits}_BIT"),
            self._data,
        )
        self._running = ul.ScanStatus.RUNNING
        filling = 512 / (self._width * config.bits // 8)
        self._clock = clock(1e9 / rate, filling * 1e9 / rate)
        self._most = 1.0 + config.fastest / rate
        for _ in range(round(_FIRST_DATA_S / _STEP_S)):
            if self._scans() > 1:
                break
            bus.pause(_STEP_S)
        else:
            raise DeviceError(f"box {self.name!r} (by uldaq) delivers no counts; plug it in again.")
        # where the counters stand now is home
        self._used = self._scans() - 1
        self._last = self._read(self._used)

    def _scans(self) -> int:
        """Whole scans that have arrived; the library keeps count."""
        status, transfer = self._counters.get_scan_status()
        if status != self._running:
            raise DeviceError(f"box {self.name!r} (by uldaq): its scan has stopped.")
        return int(transfer.current_scan_count)

    def _read(self, scan: int) -> list[int]:
        at = scan % self._ring * self._width
        return [int(self._data[at + column]) for column in self._columns]

    def receive(self, t_ns: int) -> Status:
        """Refresh `counts` for time `t_ns`."""
        if self.trouble:
            return Status.LOST
        try:
            newest = self._scans() - 1
        except DeviceError as error:
            self.trouble = str(error)
            return Status.LOST
        except self._box.ul.ULException as error:
            self.trouble = str(self._box.trouble(error))
            return Status.LOST
        wanted = max(self._clock.choose(t_ns, newest), newest - self._ring + 2)
        if wanted > self._used:
            self._fresh_ns = t_ns
            return self._take(wanted)
        self._fresh_ns = self._fresh_ns or t_ns
        age = (t_ns - self._fresh_ns) * 1e-6
        if age > self.config.lost_ms:
            self.trouble = f"box {self.name!r} has not sent counts for {age:.0f} ms."
            return Status.LOST
        return Status.STALE if age > self.config.stale_ms else Status.OK

    def _take(self, scan: int) -> Status:
        """Go on to a scan; between two, a counter moves less than half of its range."""
        most, words = self._most * (scan - self._used), self._read(scan)
        for k, word in enumerate(words):
            moved = (word - self._last[k] + self._half) % (2 * self._half) - self._half
            if abs(moved) > most:
                self.trouble = (
                    f"box {self.name!r}: a counter moved by {moved} counts between two ticks, "
                    "faster than any encoder here; the stream is out of step, or 'fastest' is too "
                    "low."
                )
                return Status.LOST
            self.counts[k] += moved
        self._used, self._last = scan, words
        return Status.OK

    def describe(self) -> str:
        """What the box does, for `hil devices`."""
        return (
            f"USB-QUAD08 {self.serial} by uldaq: {len(self.channels)} encoders at "
            f"{self.config.rate_hz:g} scans/s"
        )

    def close(self) -> None:
        """Stop the scan and release the box."""
        box, counters = self._box, getattr(self, "_counters", None)
        try:
            if counters is not None:
                counters.scan_stop()
        except box.ul.ULException as error:
            self.trouble = self.trouble or str(box.trouble(error))
        box.close()


class UldaqVolts:
    """Analog outputs of a USB-31xx, see `hil.rig.boxes.CodesBox`.

    Parameters
    ----------
    name, bus, serial
        As of `Opened`.
    config : Usb31xxConfig
        Model, staging, heartbeat.
    channels : tuple of int
        Channels that are used.
    """

    def __init__(
        self, name: str, bus: Bus, serial: str, config: Any, channels: tuple[int, ...]
    ) -> None:
        self.name, self.config, self.channels = name, config, channels
        self.heartbeat, self.trouble = config.heartbeat_ms > 0, ""
        self._bus = bus
        self._box = Opened(name, bus, config.model, serial)
        self.serial = self._box.serial
        self._wanted = dict.fromkeys(channels, 0)
        self._sent: dict[int, int] = {}
        self._beating, self._beat, self._beat_ns = False, 0, 0
        self._lock = threading.Lock()
        self._stop: Callable[[], None] | None = None
        ul = self._box.ul
        self._together = config.staged and len(channels) > 1
        try:
            self._outputs = self._box.device.get_ao_device()
            if self.heartbeat:
                self._lines = self._box.device.get_dio_device()
                self._port = self._lines.get_info().get_port_types()[0]
                self._lines.d_config_bit(
                    self._port, config.heartbeat_bit, ul.DigitalDirection.OUTPUT
                )
                self._lines.d_bit_out(self._port, config.heartbeat_bit, 0)
            self._write(self._wanted)
        except ul.ULException as error:
            self._box.close()
            raise self._box.trouble(error) from error
        self._stop = bus.run(name, self._pump)

    def _write(self, codes: dict[int, int]) -> None:
        """Hand codes to the library, as volts that it calibrates; waits for the USB."""
        ul, volts = self._box.ul, {c: 10.0 * code / 32768.0 for c, code in codes.items()}
        low, high = min(self.channels), max(self.channels)
        if self._together and len(self.channels) == high - low + 1:
            every = [
                volts.get(c, 10.0 * self._sent.get(c, 0) / 32768.0) for c in range(low, high + 1)
            ]
            ranges = [ul.Range.BIP10VOLTS] * len(every)
            self._outputs.a_out_list(low, high, ranges, ul.AOutListFlag.SIMULTANEOUS, every)
        else:
            for channel, value in volts.items():
                self._outputs.a_out(channel, ul.Range.BIP10VOLTS, ul.AOutFlag.DEFAULT, value)
        self._sent.update(codes)

    def put(self, channel: int, code: int) -> None:
        """Code -32768..32767 for a channel; it goes out as soon as the library can."""
        self._wanted[channel] = code

    def rest(self) -> None:
        """Zeros as soon as possible, and no heartbeat any more; does not wait."""
        self._beating = False
        for channel in self.channels:
            self._wanted[channel] = 0

    def _pump(self) -> float:
        """Write what has changed, and the heartbeat.  Runs in the background."""
        if self.trouble:
            return 1.0
        if not self._lock.acquire(blocking=False):  # zeros are going out
            return 1e-3
        try:
            now = self._bus.now_ns()
            if self._beating and self.heartbeat and now >= self._beat_ns:
                self._beat_ns, self._beat = (
                    now + round(self.config.heartbeat_ms * 1e6),
                    self._beat ^ 1,
                )
                self._lines.d_bit_out(self._port, self.config.heartbeat_bit, self._beat)
            changed = {c: v for c, v in self._wanted.items() if v != self._sent[c]}
            if changed:
                self._write(changed)
        except self._box.ul.ULException as error:
            self.trouble = str(self._box.trouble(error))
            return 1.0
        finally:
            self._lock.release()
        return 2.5e-4

    def power(self, on: bool) -> None:
        """Heartbeat on; or zeros, at once and waiting for them, and no heartbeat."""
        if on:
            self._beating = True
            return
        self.rest()
        with self._lock:
            try:
                self._write(dict(self._wanted))
            except self._box.ul.ULException as error:
                self.trouble = self.trouble or str(self._box.trouble(error))

    def describe(self) -> str:
        """What the box does, for `hil devices`."""
        beat = f"heartbeat on bit {self.config.heartbeat_bit}" if self.heartbeat else "no heartbeat"
        return f"{self.config.model} {self.serial} by uldaq: {len(self.channels)} outputs, {beat}"

    def close(self) -> None:
        """Zeros, then release the box."""
        stop, self._stop = self._stop, None
        if stop is None:
            return
        stop()
        self.power(False)
        self._box.close()
