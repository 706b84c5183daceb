"""Rig files that come with the package, for demonstrations and benchmarks."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from hil.errors import ConfigError, unknown

NAMES = ("identify", "teleop", "mechanical-operator", "lawrence")


def rig_path(name: str) -> Path:
    """Path of a shipped rig file.

    Raises
    ------
    ConfigError
        If there is none of that name.
    """
    if name not in NAMES:
        raise ConfigError(unknown("rig", name, NAMES))
    path = Path(str(files("rigs") / f"{name}.toml"))
    if not path.is_file():
        raise ConfigError(
            f"rig file {path} is missing from the installation; reinstall the package"
        )
    return path
