"""Boxes of a rig: which channel is which signal of which device, opening them, a device's wire."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from math import inf
from typing import Any, Protocol

import numpy as np

from hil import registry
from hil.errors import ConfigError, DeviceError, unknown
from hil.rig.config import SIMULATED, BoxConfig, DeviceConfig, RigConfig
from hil.rig.frame_capture import Taps
from hil.signals.bus import Bus
from hil.signals.device import FloatArray, IntArray, Status
from hil.toml import in_table, parse

_PLACE = re.compile(r"(-?)([^/]+)/(\d+)")


@dataclass(frozen=True)
class BoxPlace:
    """One channel of one box, and whether its sign is turned (-1) or not (1)."""

    box: str
    channel: int
    sign: int


def wired(config: RigConfig) -> dict[str, DeviceConfig]:
    """Devices that have boxes instead of an ideal wire."""
    return {
        name: d
        for name, d in config.devices.items()
        if d.channels and config.backend_of(name) != "sim"
    }


def places(config: RigConfig, name: str) -> dict[str, list[BoxPlace]]:
    """Role -> places of a device.

    Raises
    ------
    ConfigError
        If a place is not written as ``BOX/CHANNEL``, or there is no such box.
    """
    found: dict[str, list[BoxPlace]] = {}
    for role, texts in config.devices[name].channels.items():
        for text in texts:
            match = _PLACE.fullmatch(text)
            if match is None:
                raise ConfigError(
                    f"[devices.{name}.channels] {role}: {text!r} is not a place; write "
                    "BOX/CHANNEL, e.g. 'encoders/0', or '-encoders/0' for the other sign."
                )
            sign, box, channel = match.groups()
            if box not in config.boxes:
                raise ConfigError(
                    f"[devices.{name}.channels]: {unknown('box', box, config.boxes)} "
                    f"{_add(box, role)}"
                )
            found.setdefault(role, []).append(BoxPlace(box, int(channel), -1 if sign else 1))
    return found


#: Role -> a driver of boxes that have it.
_DRIVERS = {
    "drives": "damiao-can",
    "encoders": "usb-quad08",
    "motors": "usb-31xx",
    "gauges": "netcanoem",
}


def _add(box: str, role: str) -> str:
    """What to add to a rig file that has not a box of a role."""
    drivers = ", ".join(sorted(registry.names("hil.boxes")))
    return (
        f'Add a table [boxes.{box}] with driver = "{_DRIVERS.get(role, "NAME")}" (there are '
        f"{drivers}) and, where several are attached, its address."
    )


def only_gauges(name: str, spots: Mapping[str, list[BoxPlace]]) -> BoxPlace:
    """Place of a force sensor, which is wired to one box and to nothing else.

    Raises
    ------
    ConfigError
        If it has another role too, or more than one place.
    """
    if set(spots) != {"gauges"} or len(spots["gauges"]) != 1:
        raise ConfigError(
            f"[devices.{name}.channels]: a force sensor has the role gauges alone, with one "
            "place, e.g. gauges = ['leader-ft/0']."
        )
    return spots["gauges"][0]


def backends(config: RigConfig) -> dict[str, str]:
    """Boxes that are in use -> their back end.

    Raises
    ------
    ConfigError
        If two devices want one box on two back ends, or the channel map is wrong.
    """
    check_channels(config)
    found: dict[str, str] = {}
    for name in wired(config):
        for spots in places(config, name).values():
            for p in spots:
                own = config.boxes[p.box].backend or config.backend_of(name)
                if found.setdefault(p.box, own) != own:
                    raise ConfigError(
                        f"[boxes.{p.box}]: the box is wanted as {found[p.box]!r} and as {own!r}; "
                        "set its backend in its own table."
                    )
    return found


def check_channels(config: RigConfig) -> None:
    """Refuse a channel map that is wrong, also where ideal wires have no use for it.

    Raises
    ------
    ConfigError
        If a place is none, its box is unknown, or two roles or devices have one channel.
    """
    taken: dict[tuple[str, int, str], str] = {}
    for name in config.devices:
        for role, spots in places(config, name).items():
            for p in spots:
                key = (p.box, p.channel, role)
                if key in taken:
                    other = f"and in [devices.{taken[key]}.channels] too" * (taken[key] != name)
                    raise ConfigError(
                        f"[devices.{name}.channels]: {role} has {p.box}/{p.channel} "
                        f"{other or 'twice'}; it is one channel and can be cabled once."
                    )
                taken[key] = name


def used_channels(config: RigConfig, box: str) -> tuple[int, ...]:
    """Channels of a box that devices use."""
    spots = [p for d in wired(config) for row in places(config, d).values() for p in row]
    return tuple(sorted({p.channel for p in spots if p.box == box}))


def wiring_plan(config: RigConfig) -> dict[str, dict[str, Any]]:
    """What a simulation must know of the boxes that it is to answer for."""
    found: dict[str, dict[str, Any]] = {}
    for box, backend in backends(config).items():
        if backend == "sim-wire":
            table = config.boxes[box]
            found[box] = {
                "driver": table.driver,
                "address": table.address,
                "options": dict(table.options),
                "cables": [],
            }
    for name, device in wired(config).items():
        for role, spots in places(config, name).items():
            for k, p in enumerate(spots):
                if p.box in found:
                    found[p.box]["cables"].append((p.channel, role, device.arm, k, p.sign))
    return found


def open_boxes(
    config: RigConfig, simulated: Mapping[str, Bus], stack: ExitStack, taps: Taps | None = None
) -> dict[str, Any]:
    """Open every box in use; `stack` closes them.

    Parameters
    ----------
    simulated : mapping of str to Bus
        Kind -> simulated bus.

    Raises
    ------
    DeviceError
        If one is missing or refuses; says what to do.
    """
    used = backends(config)
    told_apart(config, used)
    taps = taps or Taps(config)
    return {
        name: open_simulated_or_real(config, name, used[name], simulated, stack, taps)
        for name in used
    }


def open_simulated_or_real(
    config: RigConfig,
    name: str,
    backend: str,
    simulated: Mapping[str, Bus],
    stack: ExitStack,
    taps: Taps | None = None,
) -> Any:
    """Open one box, see `open_boxes`."""
    table = config.boxes[name]
    options = box_options(config, name)
    driver = registry.load("hil.boxes", table.driver)
    check_bus(name, table, backend, driver.BUS)
    taps = taps or Taps(config)
    if backend == "replay":
        bus = taps.replayed(name, driver.BUS)
    else:
        plain = simulated[driver.BUS] if backend in SIMULATED else Bus(driver.BUS)
        bus = taps.recorded(name, plain)
    channels = used_channels(config, name)
    what = f"box {name!r} (driver {table.driver!r}) cannot be opened"
    with registry.blaming("hil.boxes", table.driver, what, DeviceError):
        box = driver.open_box(name, bus, table.address, options, channels)
    stack.callback(box.close)
    return box


def box_options(config: RigConfig, name: str) -> Any:
    """Options of a box, checked."""
    return options_of("hil.boxes", config.boxes[name], f"boxes.{name}")


def check_box(config: RigConfig, name: str, used: bool) -> None:
    """Refuse a table of a box that is wrong, also where no device uses it.

    Parameters
    ----------
    config : RigConfig
        The rig.
    name : str
        Of the box.
    used : bool
        Whether the session opens it; the library of another one may be missing.

    Raises
    ------
    ConfigError
        Names the table.
    """
    try:
        options = box_options(config, name)
    except ConfigError as error:
        if not used and isinstance(error.__cause__, ImportError):
            return
        raise
    available = float(getattr(options, "available", inf))
    for device in config.devices:
        for role, spots in places(config, device).items():
            over = [p.channel for p in spots if p.box == name and p.channel >= available]
            if over:
                raise ConfigError(
                    f"[devices.{device}.channels]: {role} has {name}/{over[0]}; the box "
                    f"({config.boxes[name].driver}) has the channels 0 to {available - 1:g}."
                )


def options_of(group: str, table: BoxConfig | DeviceConfig, where: str) -> Any:
    """Options in a table of a rig file, checked by the driver that it names."""
    with in_table(where):
        driver = registry.load(group, table.driver)
    return parse(driver.Config, table.options, f"{where}.options")


def describe_box(box: Any) -> str:
    """What an open box is and does, in its own words where it has some."""
    if hasattr(box, "describe"):
        return str(box.describe())
    return f"{type(box).__name__} {getattr(box, 'serial', '')}".rstrip()


def trouble(box: Any) -> str:
    """Why a box is lost; empty while it is not, or where it does not say."""
    return str(getattr(box, "trouble", ""))


def told_apart(config: RigConfig, used: Iterable[str]) -> None:
    """Refuse two boxes of one driver that may be the same device."""
    seen: dict[tuple[str, str], str] = {}
    rows = [(name, config.boxes[name]) for name in used]
    for name, table in rows:
        same = [n for n, t in rows if t.driver == table.driver]
        other = seen.setdefault((table.driver, table.address), name)
        if other != name or (not table.address and len(same) > 1):
            both = f" and the address {table.address!r}" if other != name and table.address else ""
            raise ConfigError(
                f"[boxes.{name}]: {', '.join(same)} have one driver{both}; give each an address of "
                f"its own, {_address_of(table.driver)}."
            )


def _address_of(driver: str) -> str:
    """What the address of a box is, as its driver says."""
    try:
        module = registry.load("hil.boxes", driver)
    except ConfigError:  # of a library that is not there
        module = None
    return str(getattr(module, "ADDRESS", "the serial number that 'hil devices' shows"))


def check_bus(name: str, table: BoxConfig, backend: str, kind: str) -> None:
    """Refuse a box whose own table names a bus that it does not speak."""
    if table.backend and backend not in (*SIMULATED, "hardware", "replay", kind):
        raise ConfigError(
            f"[boxes.{name}]: driver {table.driver!r} speaks {kind!r}, not {backend!r}."
        )


#: Looked up once: members of an enumeration are slow to find in the fast path.
_OK, _LOST = Status.OK, Status.LOST


class CountsBox(Protocol):
    """A box that counts.

    `channels` lists its open channels, `counts` (channels,) holds the counts of the last
    `receive` and stays the same array, `trouble` says why it is lost.
    """

    channels: tuple[int, ...]
    counts: IntArray
    trouble: str

    def receive(self, t_ns: int) -> Status:
        """Refresh `counts` for time `t_ns`; never waits or raises."""
        ...


class CodesBox(Protocol):
    """A box that gives voltages.

    `trouble` says why it is lost; `heartbeat` whether it shows an amplifier that the host lives.
    """

    trouble: str
    heartbeat: bool

    def put(self, channel: int, code: int) -> None:
        """Code -32768..32767 of a channel, which goes out as soon as the box can."""
        ...

    def rest(self) -> None:
        """Zeros as soon as possible and no sign of life any more; never waits."""
        ...

    def power(self, on: bool) -> None:
        """Start or stop the sign of life; stopping sends zeros first."""
        ...


class BoxWire:
    """Wire of one device through boxes: what `Wire` says, counts and codes from anywhere.

    Parameters
    ----------
    name : str
        Device.
    rows : dict
        Role -> (box, `BoxPlace`) in the order of the motors; roles ``encoders`` and ``motors``.
    advance : callable, optional
        Lets a simulated world run to a time [ns].

    Raises
    ------
    ConfigError
        If a role is unknown or does not have three places, or no box gives a heartbeat.
    """

    def __init__(
        self,
        name: str,
        rows: Mapping[str, list[tuple[Any, BoxPlace]]],
        advance: Callable[[int], None] | None,
    ) -> None:
        encoders, motors = _roles(name, rows)
        self.counts = np.zeros(len(encoders), np.int64)
        self.gauges = np.zeros(6, np.int64)
        self._offset = np.zeros(len(encoders), np.int64)
        self._in = [
            (i, b.counts, b.channels.index(p.channel), p.sign) for i, (b, p) in enumerate(encoders)
        ]
        self._out = [(i, b, p.channel, p.sign) for i, (b, p) in enumerate(motors)]
        self._readers: list[CountsBox] = _distinct(b for b, _ in encoders)
        self._writers: list[CodesBox] = _distinct(b for b, _ in motors)
        self._advance = advance
        self._lost = False

    @property
    def trouble(self) -> str:
        """Why the wire is lost; empty while it is not."""
        texts = [b.trouble for b in self._readers] + [b.trouble for b in self._writers]
        return " ".join(filter(None, texts))

    def home(self, counts: IntArray) -> None:
        """The arm rests where its encoders should read `counts` (3,)."""
        self._offset[:] = 0
        self._collect()
        self._offset[:] = counts - self.counts
        self.counts[:] = counts

    def receive(self, t_ns: int) -> Status:
        """Counts for time `t_ns`; LOST also when the way out is lost, and then for good."""
        if self._advance is not None:
            self._advance(t_ns)
        status = _OK
        for box in self._readers:
            said = box.receive(t_ns)
            status = status if said is _OK else max(status, said)
        self._collect()
        for writer in self._writers:
            if writer.trouble:
                status = _LOST
        if status is _LOST and not self._lost:
            self._lost = True
            for writer in self._writers:
                writer.rest()
        return _LOST if self._lost else status

    def _collect(self) -> None:
        counts, offset = self.counts, self._offset
        for i, source, at, sign in self._in:
            counts[i] = sign * source.item(at) + offset.item(i)

    def send(self, codes: IntArray) -> None:
        """DAC codes to their boxes."""
        for i, box, channel, sign in self._out:
            box.put(channel, sign * codes.item(i))

    def power(self, on: bool) -> None:
        """Sign of life on or off."""
        for writer in self._writers:
            writer.power(on and not self._lost)

    def close(self) -> None:
        """The boxes are the rig's and are closed by it."""


class DrivesBox(Protocol):
    """A bus of drives that measure and give efforts themselves.

    `channels` lists its drives; `counts`, `rates` (channels,) are positions and speeds in halves
    of a step about zero, and `scales` (channels, 3) their size: position [rad], speed [rad/s] and
    effort [N m] of one such half.
    """

    channels: tuple[int, ...]
    counts: IntArray
    rates: IntArray
    scales: FloatArray
    trouble: str

    def receive(self, t_ns: int) -> Status:
        """Refresh `counts` and `rates` for time `t_ns`; never waits or raises."""
        ...

    def send(self, codes: IntArray) -> None:
        """Effort of every drive (channels,), in halves of a step."""
        ...

    def rest(self) -> None:
        """Switch all drives off as soon as possible; never waits."""
        ...

    def power(self, on: bool) -> None:
        """Switch all drives on or off."""
        ...


class CanDrives:
    """Wire of an arm whose joints have drives of their own, on one bus or several.

    Parameters
    ----------
    name : str
        Device.
    places : list of (DrivesBox, BoxPlace)
        Drive of every joint, d of them.
    """

    def __init__(self, name: str, places: Sequence[tuple[Any, BoxPlace]]) -> None:
        d = len(places)
        self.name = name
        self.counts, self.rates = np.zeros(d, np.int64), np.zeros(d, np.int64)
        self.gauges = np.zeros(6, np.int64)
        self._boxes: list[DrivesBox] = _distinct(b for b, _ in places)
        self._rows = [
            (i, b, b.channels.index(p.channel), p.sign) for i, (b, p) in enumerate(places)
        ]
        self._codes = [np.zeros(len(b.channels), np.int64) for b in self._boxes]
        at = {id(b): codes for b, codes in zip(self._boxes, self._codes, strict=True)}
        self._out = [(i, at[id(b)], k, sign) for i, b, k, sign in self._rows]
        self.scales = np.stack([b.scales[k] for _, b, k, _ in self._rows])
        self._lost = False

    @property
    def trouble(self) -> str:
        """Why the wire is lost; empty while it is not."""
        return " ".join(filter(None, (b.trouble for b in self._boxes)))

    def home(self, counts: IntArray) -> None:
        """Nothing to do: drives know where they stand."""

    def receive(self, t_ns: int) -> Status:
        """Positions and speeds for time `t_ns`; LOST for good when a bus is."""
        status = _OK
        for box in self._boxes:
            said = box.receive(t_ns)
            status = status if said is _OK else max(status, said)
        for i, box, k, sign in self._rows:
            self.counts[i] = sign * box.counts.item(k)
            self.rates[i] = sign * box.rates.item(k)
        if status is _LOST and not self._lost:
            self._lost = True
            self.rest()
        return _LOST if self._lost else status

    def rest(self) -> None:
        """All drives off as soon as possible; never waits."""
        for box in self._boxes:
            box.rest()

    def send(self, codes: IntArray) -> None:
        """Efforts to their drives."""
        for i, own, k, sign in self._out:
            own[k] = sign * codes.item(i)
        for box, own in zip(self._boxes, self._codes, strict=True):
            box.send(own)

    def power(self, on: bool) -> None:
        """All drives on or off."""
        for box in self._boxes:
            box.power(on and not self._lost)

    def close(self) -> None:
        """The boxes are the rig's and are closed by it."""


#: Roles of a device that is wired to boxes: encoders and motors apart, or drives that are both.
ROLES = (("encoders", "motors"), ("drives",))


def check_roles(name: str, rows: Mapping[str, Sequence[object]], d: int = 3) -> None:
    """Refuse a device whose roles are not one row of `ROLES`, with a place for each of d joints.

    Raises
    ------
    ConfigError
        Names the table.
    """
    needed = ROLES[1] if "drives" in rows else ROLES[0]
    for role in rows:
        if role not in needed:
            known = needed if "drives" in rows else [r for row in ROLES for r in row]
            raise ConfigError(f"[devices.{name}.channels]: {unknown('role', role, known)}")
    for role in needed:
        if len(rows.get(role, ())) != d:
            raise ConfigError(f"[devices.{name}.channels]: {role} needs {d} places BOX/CHANNEL.")


def _roles(
    name: str, rows: Mapping[str, list[tuple[Any, BoxPlace]]]
) -> tuple[list[tuple[Any, BoxPlace]], list[tuple[Any, BoxPlace]]]:
    check_roles(name, rows)
    if not any(box.heartbeat for box, _ in rows["motors"]):
        raise ConfigError(
            f"[devices.{name}.channels]: none of its motor boxes gives a heartbeat, and its "
            "amplifiers would go on when the host dies; set heartbeat_ms in the options of one of "
            "them."
        )
    return rows["encoders"], rows["motors"]


def _distinct(boxes: Any) -> list[Any]:
    return list({id(b): b for b in boxes}.values())
