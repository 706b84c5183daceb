"""Rig files that come with the package: which devices, which law, which simulation."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from hil.errors import ConfigError, unknown

NAMES = (
    "identify",
    "teleop",
    "mechanical-operator",
    "lawrence",
    "delayed",
    "arm6",
    "inverse3",
    "surgical",
)


def rig_path(name: str) -> Path:
    """Path of a shipped rig file.

    Raises
    ------
    ConfigError
        If there is none of that name.
    """
    if name not in NAMES:
        raise ConfigError(unknown("rig", name, NAMES))
    path = Path(str(files("hil.rigs") / f"{name}.toml"))
    if not path.is_file():
        raise ConfigError(
            f"rig file {path} is missing from the installation; reinstall the package"
        )
    return path


def packaged(path: str | Path) -> Path:
    """The file `path`, or the shipped rig file of that name where no such file is there."""
    place = Path(path)
    return rig_path(str(path)) if str(path) in NAMES and not place.exists() else place
