"""Model TOML: reading with clear errors, writing with values, errors and units."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from hil.errors import ConfigError, unknown
from hil.models import catalogue
from hil.models.model import ALL, Band, RobotModel, Use, Value
from hil.record.recording import RobotSource

SCHEMA = "hil.model/1"
_TOP = ("schema", "robot", "effects", "signal", "plugins")
_ROBOT = ("urdf", "preset", "tip", "arm", "explains")
_OPTIONS = ("per_run", "fixed", "fixed_shape")
_EXPLAINS = ("motor", "external")


def read_model(path: str | Path) -> RobotModel:
    """Read a model file.

    Raises
    ------
    ConfigError
        If the file is missing, not TOML, of another schema, or names something unknown.
    """
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigError(f"model {path}: no such file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise ConfigError(f"model {path} cannot be read: {error}") from error
    try:
        return _model(data, path)
    except ConfigError as error:
        raise ConfigError(f"model {path}: {error}") from error


def _keys(table: dict[str, Any], known: tuple[str, ...], what: str) -> None:
    for key in table:
        if key not in known:
            raise ConfigError(unknown(f"key in {what}", key, known))


def _model(data: dict[str, Any], path: Path) -> RobotModel:
    if data.get("schema") != SCHEMA:
        raise ConfigError(f"schema is {data.get('schema')!r}, expected {SCHEMA!r}")
    _keys(data, _TOP, "the model")
    robot = data.get("robot", {})
    if not isinstance(robot, dict):
        raise ConfigError("[robot] must be a table with urdf = ... or preset = ...")
    _keys(robot, _ROBOT, "[robot]")
    plugins = tuple(str((path.parent / p).resolve()) for p in data.get("plugins", ()))
    for plugin in plugins:
        catalogue.load_plugin(Path(plugin))
    explains = robot.get("explains", "motor")
    if explains not in _EXPLAINS:
        raise ConfigError(unknown("value of robot.explains", str(explains), _EXPLAINS))
    signal = data.get("signal", {})
    _keys(signal, tuple(f.name for f in fields(Band)), "[signal]")
    effects = data.get("effects", [])
    if not isinstance(effects, list) or not effects:
        raise ConfigError("no [[effects]]; the base is rigid-body, armature, coulomb, viscous")
    model = RobotModel(
        robot=_source(robot, path),
        effects=(),
        arm=str(robot.get("arm", "")),
        explains=explains,
        band=Band(**{k: float(v) for k, v in signal.items()}),
        plugins=plugins,
        urdf_path=str(robot.get("urdf", "")),
    )
    for entry in effects:
        model = model + _use(entry)
    return model


def _source(robot: dict[str, Any], path: Path) -> RobotSource:
    if "urdf" in robot and "preset" in robot:
        raise ConfigError("[robot] has both urdf and preset; keep one")
    tip = str(robot.get("tip", ""))
    if "urdf" not in robot:
        return RobotSource(preset=str(robot.get("preset", "")), tip=tip)
    file = path.parent / str(robot["urdf"])
    try:
        return RobotSource(preset="", urdf=file.read_text(encoding="utf-8"), tip=tip)
    except OSError as error:
        raise ConfigError(f"[robot] urdf = {robot['urdf']!r}: no such file ({file})") from error


def _use(entry: Any) -> Use:
    if not isinstance(entry, dict) or "type" not in entry:
        raise ConfigError("every [[effects]] needs type = <name of an effect>")
    effect = catalogue.get(str(entry["type"]))
    _keys(entry, ("type", "joints", "parameters", *_OPTIONS), f"effect {effect.name!r}")
    joints = entry.get("joints", "all")
    names = ALL if joints == "all" else tuple([joints] if isinstance(joints, str) else joints)
    values = {name: _value(name, v) for name, v in entry.get("parameters", {}).items()}
    return Use(effect.name, names, {k: entry[k] for k in _OPTIONS if k in entry}, values)


def _value(name: str, entry: Any) -> Value:
    if isinstance(entry, int | float):
        return Value(float(entry))
    if not isinstance(entry, dict) or "value" not in entry:
        raise ConfigError(f"parameter {name!r}: expected a number or {{ value = ... }}")
    known = tuple(f.name for f in fields(Value) if f.name not in ("lower", "upper"))
    _keys(entry, (*known, "bounds"), f"parameter {name!r}")
    low, high = entry.get("bounds", (-math.inf, math.inf))
    rest = {k: v for k, v in entry.items() if k != "bounds"}
    return Value(**rest, lower=float(low), upper=float(high))


def write_model(model: RobotModel, path: str | Path) -> None:
    """Write a model with its values; the URDF is written beside it unless it has a path.

    Raises
    ------
    ConfigError
        If the folder does not exist.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise ConfigError(f"cannot write {path}: folder {path.parent} does not exist")
    robot = _robot_lines(model, path)
    lines = [f'schema = "{SCHEMA}"']
    if model.plugins:
        lines.append(f"plugins = {json.dumps(list(model.plugins))}")
    lines += ["", "[robot]", *robot]
    if model.band != Band():
        lines += ["", "[signal]", f"position_hz = {model.band.position_hz!r}"]
        lines += [f"effort_hz = {model.band.effort_hz!r}"]
    for use in model.effects:
        lines += ["", *_use_lines(use)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _robot_lines(model: RobotModel, path: Path) -> list[str]:
    lines = []
    if model.robot.urdf:
        file = path.with_suffix(".urdf")
        file.write_text(model.robot.urdf, encoding="utf-8")
        lines.append(f"urdf = {json.dumps(file.name)}")
    elif model.robot.preset:
        lines.append(f"preset = {json.dumps(model.robot.preset)}")
    if model.robot.tip:
        lines.append(f"tip = {json.dumps(model.robot.tip)}")
    if model.arm:
        lines.append(f"arm = {json.dumps(model.arm)}")
    if model.explains != "motor":
        lines.append(f"explains = {json.dumps(model.explains)}")
    return lines


def _use_lines(use: Use) -> list[str]:
    joints = "all" if use.joints == ALL else list(use.joints)
    lines = ["[[effects]]", f"type = {json.dumps(use.type)}", f"joints = {json.dumps(joints)}"]
    lines += [f"{key} = {json.dumps(value)}" for key, value in use.options.items()]
    if use.values:
        lines.append("[effects.parameters]")
    for name, v in use.values.items():
        parts = [f"value = {v.value!r}"]
        if math.isfinite(v.stderr):
            parts.append(f"stderr = {v.stderr!r}")
        parts.append(f"unit = {json.dumps(v.unit)}")
        if math.isfinite(v.lower) or math.isfinite(v.upper):
            parts.append(f"bounds = [{v.lower!r}, {v.upper!r}]")
        if v.at_bound:
            parts.append("at_bound = true")
        if not v.identifiable:
            parts.append("identifiable = false")
        if v.source:
            parts.append(f"source = {json.dumps(v.source)}")
        lines.append(f"{json.dumps(name)} = {{ {', '.join(parts)} }}")
    return lines


def with_values(model: RobotModel, uses: tuple[Use, ...]) -> RobotModel:
    """The same model with other uses (after a fit)."""
    return replace(model, effects=uses)
