"""Which channel of which box is which signal of which device; boxes opened."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from hil import registry
from hil.config import SIMULATED, RigConfig
from hil.errors import ConfigError, unknown
from hil.rigtables import BoxConfig, DeviceConfig
from hil.signals.bus import Bus
from hil.tapping import Taps
from hil.tomltable import parse, within

_PLACE = re.compile(r"(-?)([^/]+)/(\d+)")


@dataclass(frozen=True)
class Place:
    """One channel of one box, and whether its sign is turned (-1) or not (1)."""

    box: str
    channel: int
    sign: int


def wired(config: RigConfig) -> dict[str, DeviceConfig]:
    """Devices that have boxes instead of an ideal wire."""
    return {
        name: d for name, d in config.devices.items()
        if d.channels and config.backend_of(name) != "sim"
    }  # fmt: skip


def places(config: RigConfig, name: str) -> dict[str, list[Place]]:
    """Role -> places of a device.

    Raises
    ------
    ConfigError
        If a place is not written as ``BOX/CHANNEL``, or there is no such box.
    """
    found: dict[str, list[Place]] = {}
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
                raise ConfigError(f"[devices.{name}.channels]: {unknown('box', box, config.boxes)}")
            found.setdefault(role, []).append(Place(box, int(channel), -1 if sign else 1))
    return found


def only_gauges(name: str, spots: Mapping[str, list[Place]]) -> Place:
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


def plan(config: RigConfig) -> dict[str, dict[str, Any]]:
    """What a simulation must know of the boxes that it is to answer for."""
    found: dict[str, dict[str, Any]] = {}
    for box, backend in backends(config).items():
        if backend == "sim-wire":
            table = config.boxes[box]
            found[box] = {"driver": table.driver, "address": table.address,
                          "options": dict(table.options), "cables": []}  # fmt: skip
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
    return {name: open_box(config, name, used[name], simulated, stack, taps) for name in used}


def open_box(
    config: RigConfig, name: str, backend: str, simulated: Mapping[str, Bus], stack: ExitStack,
    taps: Taps | None = None,
) -> Any:  # fmt: skip
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
    box = driver.open_box(name, bus, table.address, options, channels)
    stack.callback(box.close)
    return box


def box_options(config: RigConfig, name: str) -> Any:
    """Options of a box, checked."""
    return options_of("hil.boxes", config.boxes[name], f"boxes.{name}")


def options_of(group: str, table: BoxConfig | DeviceConfig, where: str) -> Any:
    """Options in a table of a rig file, checked by the driver that it names."""
    with within(where):
        driver = registry.load(group, table.driver)
    return parse(driver.Config, table.options, f"{where}.options")


def describe(box: Any) -> str:
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
            raise ConfigError(
                f"[boxes.{name}]: {', '.join(same)} have one driver; give each an address of its "
                "own, the serial number that 'hil devices' shows."
            )


def check_bus(name: str, table: BoxConfig, backend: str, kind: str) -> None:
    """Refuse a box whose own table names a bus that it does not speak."""
    if table.backend and backend not in (*SIMULATED, "hardware", "replay", kind):
        raise ConfigError(
            f"[boxes.{name}]: driver {table.driver!r} speaks {kind!r}, not {backend!r}."
        )
