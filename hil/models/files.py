"""Model TOML: reading with clear errors (writing: `hil.models.files`).

Model TOML: writing with values, errors and units.
"""

from __future__ import annotations

import json
import math
import os
import re
import tomllib
from collections.abc import Iterable
from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any

from hil.errors import ConfigError, unknown
from hil.models import catalogue
from hil.models.effect import Effect
from hil.models.model import (
    ALL,
    BASE_EFFECTS,
    Band,
    Range,
    RobotModel,
    Use,
    Value,
    as_model,
    in_words,
)
from hil.record.recording import RobotSource, number, signal_value
from hil.userfile import LARGEST_TEXT, parse_toml, read_bytes, read_text, write_text

__all__ = ["SCHEMA", "is_model", "read_model", "write_model"]
_TOP = ("schema", "robot", "effects", "signal", "plugins", "valid", "fitted")
_RANGES = ("position", "speed", "load")
_ROBOT = ("urdf", "preset", "tip", "arm", "explains")
_OPTIONS = ("per_run", "fixed", "fixed_shape")
#: Run that values of other runs are differences to.
_REFERENCE = "reference"
_EXPLAINS = ("motor", "external")


def read_model(path: str | Path) -> RobotModel:
    """Read a model file.

    Raises
    ------
    ConfigError
        If the file is missing, not TOML, of another schema, or names something unknown, or no
        path was given.
    """
    if not isinstance(path, str | PathLike):
        raise ConfigError(
            f"hil.read_model takes the path of a model file, not {type(path).__name__}"
        )
    path = Path(path)
    try:
        text = read_text(path)
        if text.lstrip().startswith("<"):
            raise ConfigError(
                f"model {path} is a robot's description; give it to 'hil import --robot', which "
                "writes the model file (.toml) beside the session"
            )
        data = parse_toml(text)
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
    files = _texts(data.get("plugins", []), "plugins", "['./my_effects.py']")
    plugins = tuple(str((path.parent / p).resolve()) for p in files)
    for plugin in plugins:
        catalogue.load_plugin(Path(plugin), said_in=path)
    explains = robot.get("explains", "motor")
    if explains not in _EXPLAINS:
        raise ConfigError(unknown("value of robot.explains", str(explains), _EXPLAINS))
    model = RobotModel(
        robot=_source(robot, path),
        effects=(),
        arm=str(robot.get("arm", "")),
        explains=explains,
        band=_band(data.get("signal", {}), "signal"),
        fitted=_band(data.get("fitted", {}), "fitted"),
        plugins=plugins,
        urdf_path=str(robot.get("urdf", "")),
        valid=_valid(data.get("valid", {})),
    )
    for entry in _effects(data, explains):
        model = model + _use(entry)
    return model


def _effects(data: dict[str, Any], explains: str) -> list[Any]:
    """Tables of the effects, those of the base model where the file lists none."""
    effects = data["effects"] if "effects" in data else _base(explains)
    if not isinstance(effects, list) or not effects:
        raise ConfigError(
            "no [[effects]]; leave effects out altogether for the base model "
            f"({', '.join(BASE_EFFECTS)}), or write one [[effects]] table with type = ... for each"
        )
    return effects


def _base(explains: str) -> list[dict[str, str]]:
    """Effects of a file that lists none: the base model; contact has no law that goes without."""
    if explains == "external":
        raise ConfigError(
            "a model that explains the external effort needs its law of contact: [[effects]] with "
            'type = "contact-stiffness", for example'
        )
    return [{"type": name} for name in BASE_EFFECTS]


def _texts(value: Any, what: str, example: str) -> list[str]:
    if isinstance(value, list) and all(isinstance(x, str) and "\0" not in x for x in value):
        return value
    raise ConfigError(f"{what} = {value!r}: expected a list of texts, e.g. {example}")


def _band(table: Any, of: str) -> Band:
    if not isinstance(table, dict):
        raise ConfigError(
            f"[{of}] must be a table with some of {', '.join(f.name for f in fields(Band))}"
        )
    _keys(table, tuple(f.name for f in fields(Band)), f"[{of}]")
    values: dict[str, Any] = {k: signal_value(k, v, f"{of}.{k}") for k, v in table.items()}
    return Band(**values)


def _valid(table: Any) -> tuple[Range, ...]:
    """Identified ranges; files without them are as good."""
    if not isinstance(table, dict) or not all(isinstance(v, dict) for v in table.values()):
        raise ConfigError("[valid.JOINT] must be a table with position, speed and load")
    out = []
    for joint, entry in table.items():
        _keys(entry, (*_RANGES, "span"), f"[valid.{joint}]")
        place, speed, load = (_ends(entry.get(key), f"valid.{joint}.{key}") for key in _RANGES)
        span = _ends(entry["span"], f"valid.{joint}.span") if "span" in entry else None
        out.append(Range(str(joint), place, speed, load, span))
    return tuple(out)


def _ends(value: Any, what: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise ConfigError(f"{what} = {value!r}: expected [lowest, highest]")
    low, high = (number(x, what) for x in value)
    if not low <= high:
        raise ConfigError(f"{what} = {value!r}: expected [lowest, highest] as finite numbers")
    return low, high


def _source(robot: dict[str, Any], path: Path) -> RobotSource:
    if "urdf" in robot and "preset" in robot:
        raise ConfigError("[robot] has both urdf and preset; keep one")
    tip = str(robot.get("tip", ""))
    if "urdf" not in robot:
        return RobotSource(preset=str(robot.get("preset", "")), tip=tip)
    file = path.parent / str(robot["urdf"])
    try:
        return RobotSource(preset="", urdf=read_text(file), tip=tip)
    except OSError as error:
        raise ConfigError(f"[robot] urdf = {robot['urdf']!r}: no such file ({file})") from error


def _use(entry: Any) -> Use:
    if not isinstance(entry, dict) or "type" not in entry:
        raise ConfigError("every [[effects]] needs type = <name of an effect>")
    effect = catalogue.get(str(entry["type"]))
    known = ("type", "joints", "parameters", *_OPTIONS, _REFERENCE)
    _keys(entry, known, f"effect {effect.name!r}")
    what, options = f"effect {effect.name!r}", {k: entry[k] for k in _OPTIONS if k in entry}
    for key, value in options.items():
        if not isinstance(value, bool):
            raise ConfigError(f"{what}: {key} = {value!r}: expected true or false")
    if _REFERENCE in entry:
        options[_REFERENCE] = entry[_REFERENCE]
        if not isinstance(entry[_REFERENCE], str):
            raise ConfigError(
                f"{what}: {_REFERENCE} = {entry[_REFERENCE]!r}: expected the name of a run"
            )
    parameters = entry.get("parameters", {})
    if not isinstance(parameters, dict):
        raise ConfigError(f"{what}: parameters must be a table of names with values")
    _known(effect, parameters)
    values = {name: _value(name, v) for name, v in parameters.items()}
    return Use(effect.name, _joints(entry.get("joints", "all"), what), options, values)


def _known(effect: Effect, names: Iterable[str]) -> None:
    """Refuse values that an effect does not have: of a slip, or of an earlier version."""
    if effect.scope.terms is not None:  # they are the robot's
        return
    own = [p.name for p in (*effect.params, *effect.shape)]
    full = re.compile(rf"(?:j\d+\.)?{re.escape(effect.name)}\.(\w+)(?:\[.*)?")
    for name in names:
        found = full.fullmatch(name)
        if found and found[1] not in own:
            raise ConfigError(
                f"effect {effect.name!r} has no value {found[1]!r} ({name}), "
                f"it has {', '.join(own)}; delete the line and fit again with 'hil fit'"
            )


def _joints(joints: Any, what: str) -> tuple[str, ...]:
    if joints == "all":
        return ALL
    if isinstance(joints, str):
        return (joints,)
    names = _texts(joints, f"{what}: joints", '["joint2"], or "all"')
    if not names or len(set(names)) < len(names):
        raise ConfigError(f'{what}: joints = {names!r}: name each joint once, or write "all"')
    return tuple(names)


def _value(name: str, entry: Any) -> Value:
    what = f"parameter {name!r}"
    if not isinstance(entry, dict):
        return Value(number(entry, what))
    if "value" not in entry:
        raise ConfigError(f"{what}: expected a number or {{ value = ... }}")
    known = tuple(f.name for f in fields(Value) if f.name not in ("lower", "upper"))
    _keys(entry, (*known, "bounds"), what)
    bounds = entry.get("bounds", [-math.inf, math.inf])
    if not isinstance(bounds, list) or len(bounds) != 2:
        raise ConfigError(f"{what}: bounds = {bounds!r}: expected [lower, upper]")
    low, high = (number(x, f"{what}: bounds") for x in bounds)
    numbers = ("value", "stderr", "bounds")
    rest = {k: v for k, v in entry.items() if k not in numbers}
    value = number(entry["value"], f"{what}: value")
    stderr = number(entry.get("stderr", math.nan), f"{what}: stderr")
    return Value(value, stderr, lower=low, upper=high, **rest)


SCHEMA = "hil.model/1"


def write_model(model: RobotModel, path: str | Path) -> None:
    """Write a model with its values, and its URDF beside it under the same stem.

    Raises
    ------
    ConfigError
        If an argument is of another kind, the name does not end in .toml, the folder does not
        exist, or another file stands there or where the URDF would go; then nothing is written.
    """
    if isinstance(path, RobotModel) or not isinstance(path, str | PathLike):
        raise ConfigError(
            f"hil.write_model takes (model, path); path is {type(path).__name__}, expected the "
            "name of a file, e.g. hil.write_model(model, 'm.toml')"
        )
    model, path = as_model(model, "hil.write_model"), Path(path)
    if not path.parent.is_dir():
        raise ConfigError(f"cannot write {path}: folder {path.parent} does not exist")
    _refuse_place(path)
    urdf = _urdf_place(model, path)
    lines = [f'schema = "{SCHEMA}"']
    if model.plugins:
        lines.append(f"plugins = {_toml([_relative(p, path.parent) for p in model.plugins])}")
    lines += ["", "[robot]", *_robot_lines(model, urdf)]
    lines += _band_lines("signal", model.band) + _band_lines("fitted", model.fitted)
    for use in model.effects:
        lines += ["", *_use_lines(use)]
    for r in model.valid:
        lines += ["", f"[valid.{_toml(r.joint)}]", f"position = {list(r.position)!r}"]
        lines += [f"speed = {list(r.speed)!r}", f"load = {list(r.load)!r}"]
        lines += [f"span = {list(r.span)!r}"] if r.span else []
    if urdf and not urdf.exists():
        write_text(urdf, model.robot.urdf)
    write_text(path, "\n".join(lines) + "\n")


def is_model(path: Path) -> bool:
    """Whether a file is a model file, or empty."""
    try:
        text = read_text(path)
        return not text.strip() or str(parse_toml(text).get("schema")).startswith("hil.model/")
    except (OSError, ValueError):
        return False


def _refuse_place(path: Path) -> None:
    """Refuse what is no place for a model: another ending, a folder, a file of another kind."""
    if path.suffix.lower() != ".toml":
        raise ConfigError(f"cannot write {path}: a model file ends in .toml; nothing was written")
    if path.is_dir():
        raise ConfigError(f"cannot write {path}: it is a folder; name a file in it")
    # nothing is lost by writing to a device or a pipe
    if path.is_file() and not is_model(path):
        raise ConfigError(
            f"cannot write {path}: a file is there that is not a model file; nothing was written, "
            "choose another name or move it away"
        )


def _band_lines(of: str, band: Band) -> list[str]:
    """Table of filters, where there is anything to say."""
    if band == Band():
        return []
    lines = ["", f"[{of}]", f"position_hz = {band.position_hz!r}"]
    lines += [f"effort_hz = {band.effort_hz!r}"]
    for key in ("rate_hz", "gap_s", "shift_s", "lag_s", "lag_poles", "clock_ppm", "accuracy"):
        value = getattr(band, key)
        if value != getattr(Band(), key):
            lines += [f"{key} = {value!r}"]
    lines += [f"effort_step = {list(band.effort_step)!r}"] if band.effort_step else []
    return lines


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
    return read_bytes(place, LARGEST_TEXT).splitlines() == urdf.encode("utf-8").splitlines()


def _robot_lines(model: RobotModel, urdf: Path | None) -> list[str]:
    lines = []
    if urdf:
        lines.append(f"urdf = {_toml(urdf.name)}  # as it was given; what the data say is below")
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
