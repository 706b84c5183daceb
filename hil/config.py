"""Rig files: what may stand in them, and reading one."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.errors import ConfigError, unknown
from hil.rigs import NAMES, packaged
from hil.rigtables import (
    ArmConfig,
    BoxConfig,
    ControllerConfig,
    DeviceConfig,
    EstimatorConfig,
    LoopConfig,
    RecordConfig,
    SafetyConfig,
)
from hil.tomltable import merge, parse

SCHEMA = "hil.rig/1"
#: sim: ideal wires.  sim-wire: the same drivers as on hardware, on simulated buses.  The others
#: are the hardware: "hardware" every box on its own bus, or the name of that bus; and "replay",
#: the frames of a session.
BACKENDS = ("sim", "sim-wire", "hardware", "usb", "hid", "can", "udp", "replay")
SIMULATED = ("sim", "sim-wire")


@dataclass(frozen=True)
class RigConfig:
    """A whole rig file.

    Parameters
    ----------
    name : str
        Of the rig.
    backend : str
        Back end of every device that does not name its own.
    simulation : mapping
        Table that the simulator reads; it never reaches a session.
    """

    controller: ControllerConfig
    arms: Mapping[str, ArmConfig]
    devices: Mapping[str, DeviceConfig]
    boxes: Mapping[str, BoxConfig] = field(default_factory=dict)
    schema: str = SCHEMA
    name: str = "rig"
    backend: str = "sim"
    loop: LoopConfig = field(default_factory=LoopConfig)
    record: RecordConfig = field(default_factory=RecordConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    estimators: Mapping[str, EstimatorConfig] = field(default_factory=dict)
    simulation: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.schema != SCHEMA:
            raise ConfigError(f"schema = {self.schema!r}; this version reads {SCHEMA!r}.")
        for device in self.devices.values():
            _one_of("arm", device.arm, self.arms)
        for arm in self.controller.arms:
            _one_of("arm of the controller", arm, self.arms)
        for estimator in self.estimators.values():
            _one_of("arm of an estimator", estimator.arm, self.controller.arms)
        own = [d.backend for d in self.devices.values()] + [b.backend for b in self.boxes.values()]
        for backend in (self.backend, *filter(None, own)):
            _one_of("backend", backend, BACKENDS)

    @property
    def hardware(self) -> bool:
        """Whether any device or box is not simulated."""
        own = [self.boxes[b].backend for b in self.boxes if self.boxes[b].backend]
        used = {*own, *(self.backend_of(d) for d in self.devices)}
        return not used <= {*SIMULATED, "replay"}

    @property
    def clock(self) -> str:
        """Clock of a session: hardware knows real time alone."""
        return "real" if self.hardware else self.loop.clock

    def backend_of(self, device: str) -> str:
        """Back end of `device`: its own, or the rig's."""
        return self.devices[device].backend or self.backend


def _one_of(kind: str, name: str, known: Iterable[str]) -> None:
    if name not in known:
        raise ConfigError(unknown(kind, name, known))


def load_rig(path: str | Path, overrides: Mapping[str, Any] | None = None) -> RigConfig:
    """Read a rig file.

    Parameters
    ----------
    path : str or Path
        TOML file, or the name of a rig file that comes with the package, e.g. ``"teleop"``.
    overrides : mapping, optional
        Tables that are merged over the file, e.g.
        ``{"simulation": {"hidden": [{"effect": "stribeck", "joint": "joint2"}]}}``.
    """
    path = packaged(path)
    try:
        text = path.read_text(encoding="utf-8")
        table = tomllib.loads(text)
    except FileNotFoundError:
        raise ConfigError(
            f"{path}: no such rig file. Name a file, or a rig that comes with the package: "
            f"{', '.join(NAMES)} ('hil init teleop' copies one to edit)."
        ) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: not a readable TOML file ({error}).") from error
    try:
        return parse(RigConfig, merge(_beside(table, path), overrides or {}), "rig")
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def _beside(table: dict[str, Any], path: Path) -> dict[str, Any]:
    """The table with the path of its controller's trajectory taken from the file's folder."""
    controller = table.get("controller")
    parameters = controller.get("parameters") if isinstance(controller, Mapping) else None
    name = parameters.get("trajectory") if isinstance(parameters, Mapping) else None
    if not isinstance(name, str) or not name:
        return table
    return merge(table, {"controller": {"parameters": {"trajectory": str(path.parent / name)}}})
