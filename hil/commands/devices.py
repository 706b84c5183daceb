"""`hil devices`: what a rig needs, what of it is reachable, and what to do about the rest."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from types import ModuleType

from hil import registry, terminal
from hil.commands.run import with_rig_name
from hil.errors import ConfigError, HilError
from hil.rig import boxes
from hil.rig.check import check_tables
from hil.rig.config import SIMULATED, RigConfig, load_rig
from hil.rig.open import bench_of, open_rig
from hil.runtime import guard
from hil.signals.bus import Bus

# What is attached and reachable: for a rig, box by box and device by device, or in general.

DeviceRow = dict[str, str]


def _device_row(name: str, driver: str, backend: str, reachable: str, what: str) -> DeviceRow:
    """One line of the table; `reachable` is yes, no, or none where nothing was asked for."""
    return {
        "device": name,
        "driver": driver,
        "backend": backend,
        "reachable": reachable,
        "what": what,
    }


def everything() -> list[DeviceRow]:
    """What every driver of a box finds on its bus, and the devices that are wired to boxes."""
    rows = []
    for name in sorted(registry.names("hil.boxes")):
        try:
            module = registry.load("hil.boxes", name)
        except HilError as error:
            rows.append(_device_row("-", name, "-", "no", f"{error} {EXTRA}"))
        else:
            rows += list(_on_the_bus(name, module))
    for name in sorted(registry.names("hil.drivers")):
        rows.append(_device_row("-", name, "sim", "yes", "simulated, or wired to boxes"))
    return rows


def _on_the_bus(name: str, module: ModuleType) -> Iterator[DeviceRow]:
    if not hasattr(module, "attached"):
        yield _device_row("-", name, module.BUS, "none", UNLISTED.format(bus=module.BUS))
        return
    try:
        found = module.attached(Bus(module.BUS))
    except HilError as error:
        yield _device_row("-", name, module.BUS, "no", str(error))
        return
    for one in found:
        yield _device_row(
            one.address or "-", name, module.BUS, "yes" if one.usable else "no", one.what
        )
    if not found:
        yield _device_row("-", name, module.BUS, "none", _NOTHING.format(bus=module.BUS))


#: What a box whose library is missing needs.
EXTRA = "pip install 'hil-teleop[hardware]' brings the libraries of the buses"
UNLISTED = "{bus} does not list what is on it; 'hil devices RIG.toml' asks for those of a rig"
_NOTHING = (
    "none is attached, as far as {bus} shows; plug it in, and if this machine is virtual, hand "
    "the device through to it"
)


def _reachability(config: RigConfig) -> list[DeviceRow]:
    """One row per box in use, then one per device; why it is not reachable and what to do.

    Raises
    ------
    ConfigError
        If the rig file itself is wrong.
    """
    try:
        check_tables(config)
    except ConfigError as error:
        _only_reach(error)
    rows, trouble = _boxes(config)
    whole = ""
    if not trouble:
        whole = _whole(config)
    for name, device in config.devices.items():
        backend = config.backend_of(name)
        broken = [b for b in _boxes_of(name, config) if b in trouble]
        problem = f"its {_list('box', broken)} cannot be used" if broken else whole
        what = problem or _ready(name, config)
        rows.append(_device_row(name, device.driver, backend, "no" if problem else "yes", what))
    return rows


def _boxes(config: RigConfig) -> tuple[list[DeviceRow], dict[str, str]]:
    """Rows of the boxes, each opened alone, and what is wrong with them."""
    rows, trouble = [], {}
    used = boxes.backends(config)
    boxes.told_apart(config, used)
    bench = bench_of(config, 0) if "sim-wire" in used.values() else None
    buses = bench.buses(boxes.wiring_plan(config)) if bench else {}
    for name, backend in used.items():
        table = config.boxes[name]
        try:
            with ExitStack() as stack:
                box = boxes.open_simulated_or_real(config, name, backend, buses, stack)
                what = boxes.describe_box(box)
        except HilError as error:
            _only_reach(error)
            what = trouble[name] = str(error)
        answer = "no" if name in trouble else "yes"
        rows.append(_device_row(name, table.driver, backend, answer, what))
    return rows, trouble


def _boxes_of(name: str, config: RigConfig) -> list[str]:
    if name not in boxes.wired(config):
        return []
    spots = boxes.places(config, name)
    return list(dict.fromkeys(p.box for places in spots.values() for p in places))


def _whole(config: RigConfig) -> str:
    """Open and close the rig; the error, or nothing."""
    try:
        open_rig(config, seed=0).close()
    except HilError as error:
        _only_reach(error)
        return str(error)
    return ""


def _only_reach(error: HilError) -> None:
    """Let a mistake in the rig file pass on: it is no matter of what can be reached."""
    if isinstance(error, ConfigError) and not isinstance(error.__cause__, ImportError):
        raise error


def _ready(name: str, config: RigConfig) -> str:
    """What a device that works is like: over which boxes, and how often its motors change."""
    boxes = _boxes_of(name, config)
    if boxes:
        rate = _rate(config, boxes)
        return f"ready, over {_list('box', boxes)}{rate and f'; {rate}'}"
    if config.backend_of(name) not in SIMULATED:
        return "ready"
    wired = replace(
        config,
        backend="sim-wire",
        devices={n: replace(d, backend="") for n, d in config.devices.items()},
    )
    try:
        rate = _rate(wired, _boxes_of(name, wired))
    except ConfigError:  # the library of a box is missing, which ideal wires do not need
        rate = ""
    return f"ready, at signal level{rate and f'; over its boxes {rate}'}"


def _rate(config: RigConfig, some: list[str]) -> str:
    """How often motors on these boxes change; empty where none gives a rate."""
    rates = []
    for box in some:
        options = boxes.box_options(config, box)
        if callable(getattr(options, "rate_hz", None)):
            rates.append(options.rate_hz(len(boxes.used_channels(config, box))))
    if not rates:
        return ""
    return f"motors change {min(rates):.0f} times/s in a loop of {config.loop.rate_hz:g} Hz"


def _list(kind: str, names: list[str]) -> str:
    return f"{kind} {names[0]}" if len(names) == 1 else f"{kind}es {', '.join(names)}"


EXAMPLE = "hil devices teleop"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("rig", metavar="RIG.toml", nargs="?", help="rig file")
    parser.add_argument("--json", action="store_true", help="rows as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Print one row per box and device of a rig, or what is attached at all."""
    if args.rig is None:
        rows = everything()
    else:
        config = load_rig(args.rig)
        with with_rig_name(args.rig):
            rows = _reachability(config)
        found = guard.watchdog_state(config.safety, args.rig)
        if found is not None:
            able, what = found
            rows.append(_device_row("watchdog", "cut", "-", "yes" if able else "no", what))
    if args.json:
        sys.stdout.write(json.dumps({"schema": "hil.devices/1", "devices": rows}) + "\n")
    else:
        terminal.out(text(rows))
    return 3 if any(row["reachable"] == "no" for row in rows) else 0


def text(rows: list[dict[str, str]]) -> str:
    """Rows as a table within the terminal."""
    names = ("device", "driver", "backend", "reachable", "what")
    return terminal.table(names, [[row[n] for n in names] for row in rows], range(len(names)))
