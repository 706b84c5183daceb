"""Model TOML: writing with values, errors and units."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

from hil.errors import ConfigError
from hil.models.model import ALL, Band, RobotModel, Use
from hil.models.told import in_words

SCHEMA = "hil.model/1"


def write_model(model: RobotModel, path: str | Path) -> None:
    """Write a model with its values, and its URDF beside it under the same stem.

    Raises
    ------
    ConfigError
        If the folder does not exist, or another file stands where the URDF would go; then
        nothing is written.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise ConfigError(f"cannot write {path}: folder {path.parent} does not exist")
    urdf = _urdf_place(model, path)
    lines = [f'schema = "{SCHEMA}"']
    if model.plugins:
        lines.append(f"plugins = {_toml([_relative(p, path.parent) for p in model.plugins])}")
    lines += ["", "[robot]", *_robot_lines(model, urdf)]
    if model.band != Band():
        lines += ["", "[signal]", f"position_hz = {model.band.position_hz!r}"]
        lines += [f"effort_hz = {model.band.effort_hz!r}"]
        for key in ("rate_hz", "gap_s", "shift_s"):
            value = getattr(model.band, key)
            if value != getattr(Band(), key):
                lines += [f"{key} = {value!r}"]
    for use in model.effects:
        lines += ["", *_use_lines(use)]
    for r in model.valid:
        lines += ["", f"[valid.{_toml(r.joint)}]", f"position = {list(r.position)!r}"]
        lines += [f"speed = {list(r.speed)!r}", f"load = {list(r.load)!r}"]
    if urdf and not urdf.exists():
        urdf.write_text(model.robot.urdf, encoding="utf-8", newline="")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _toml(value: object) -> str:
    """Text, boolean or list as TOML; JSON writes them alike, but for surrogate pairs."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _relative(file: str, folder: Path) -> str:
    """Path from the model's folder, so that model and plugin move together."""
    try:
        return Path(os.path.relpath(file, folder.resolve())).as_posix()
    except ValueError:  # another drive
        return file


def _urdf_place(model: RobotModel, path: Path) -> Path | None:
    """Where the URDF goes, if there is one: a new file, or one that holds the same already."""
    if not model.robot.urdf:
        return None
    place = path.with_suffix(".urdf")
    if place == path:
        raise ConfigError(f"cannot write {path}: its URDF has that name; call the model *.toml")
    if place.exists() and not _holds(place, model.robot.urdf):
        raise ConfigError(
            f"cannot write {path}: its URDF goes into {place}, which holds something else, "
            "expected no file or the same URDF; nothing was written, choose another name or "
            "move that file away"
        )
    return place


def _holds(place: Path, urdf: str) -> bool:
    """Whether a file holds a URDF, however its lines end."""
    if not place.is_file():
        return False
    return place.read_bytes().splitlines() == urdf.encode("utf-8").splitlines()


def _robot_lines(model: RobotModel, urdf: Path | None) -> list[str]:
    lines = []
    if urdf:
        lines.append(f"urdf = {_toml(urdf.name)}")
    elif model.robot.preset:
        lines.append(f"preset = {_toml(model.robot.preset)}")
    if model.robot.tip:
        lines.append(f"tip = {_toml(model.robot.tip)}")
    if model.arm:
        lines.append(f"arm = {_toml(model.arm)}")
    if model.explains != "motor":
        lines.append(f"explains = {_toml(model.explains)}")
    return lines


def _use_lines(use: Use) -> list[str]:
    joints = "all" if use.joints == ALL else list(use.joints)
    lines = ["[[effects]]", f"type = {_toml(use.type)}", f"joints = {_toml(joints)}"]
    lines += [f"{key} = {_toml(value)}" for key, value in use.options.items()]
    if use.values:
        lines.append("[effects.parameters]")
    for name, v in use.values.items():
        parts = [f"value = {v.value!r}"]
        if math.isfinite(v.stderr):
            parts.append(f"stderr = {v.stderr!r}")
        parts.append(f"unit = {_toml(v.unit)}")
        if math.isfinite(v.lower) or math.isfinite(v.upper):
            parts.append(f"bounds = [{v.lower!r}, {v.upper!r}]")
        if v.at_bound:
            parts.append("at_bound = true")
        if not v.identifiable:
            parts.append("identifiable = false")
        if v.source:
            parts.append(f"source = {_toml(v.source)}")
        said = in_words(name, v.value)
        comment = f"  # {' '.join(said.split())}" if said else ""
        lines.append(f"{_toml(name)} = {{ {', '.join(parts)} }}{comment}")
    return lines
