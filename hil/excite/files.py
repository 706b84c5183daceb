"""Trajectory files: TOML of schema ``hil.trajectory/1``; reading checks everything."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.excite.trajectory import Trajectory

SCHEMA = "hil.trajectory/1"
_KEYS = ("schema", "name", "for", "joints", "units", "period", "path", "fourier")
FloatArray = NDArray[np.float64]


def is_trajectory(path: Path) -> bool:
    """Whether a file is a trajectory file, or empty."""
    try:
        text = path.read_text(encoding="utf-8")
        return not text.strip() or str(tomllib.loads(text).get("schema")).startswith(
            "hil.trajectory/"
        )
    except (OSError, ValueError):
        return False


def read(path: str | Path) -> Trajectory:
    """Read a trajectory file.

    Raises
    ------
    ConfigError
        If it is missing, of another kind, or wrong.
    """
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"trajectory {path}: no such file") from None
    except (OSError, ValueError) as error:
        raise ConfigError(f"trajectory {path} is not a readable TOML file: {error}") from error
    if table.get("schema") != SCHEMA:
        raise ConfigError(
            f"trajectory {path} is no trajectory file: its schema is {table.get('schema')!r}, "
            f"{SCHEMA!r} is needed; 'hil excite' writes one"
        )
    try:
        return _parse(table)
    except ConfigError as error:
        raise ConfigError(f"trajectory {path}: {error}") from error


def _parse(table: Mapping[str, Any]) -> Trajectory:
    _only(table, _KEYS)
    path, fourier = _table(table, "path"), _table(table, "fourier")
    _only(path, ("t", "blend", "q"))
    _only(fourier, ("sin", "cos"))
    joints = _names(table, "joints", ())
    units = _names(table, "units", ("rad",) * len(joints))
    period = float(_array(table, "period", 0))
    series = [_array(fourier, k, 2) if k in fourier else None for k in ("sin", "cos")]
    shapes = {s.shape for s in series if s is not None}
    if len(shapes) > 1:
        raise ConfigError("fourier: sin and cos must have the same shape")
    shape = shapes.pop() if shapes else (len(joints), 0)
    parts = [np.zeros(shape) if s is None else s for s in series]
    return Trajectory(
        joints, units, period, _array(path, "t", 1), _array(path, "q", 2),
        _array(path, "blend", 1), np.stack(parts, axis=-1),
        str(table.get("name", "motion")), _names(table, "for", ()),
    )  # fmt: skip


def _only(table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            raise ConfigError(unknown("key", key, known))


def _table(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, Mapping):
        raise ConfigError(f"{key} must be a table, not {value!r}")
    return value


def _names(table: Mapping[str, Any], key: str, default: tuple[str, ...]) -> tuple[str, ...]:
    value = table.get(key, list(default))
    if not isinstance(value, list) or not all(isinstance(x, str) for x in value):
        raise ConfigError(f"{key} must be a list of words, not {value!r}")
    return tuple(value)


def _array(table: Mapping[str, Any], key: str, ndim: int) -> FloatArray:
    """Numbers under `key` as an array of `ndim` dimensions."""
    if key not in table:
        raise ConfigError(f"the key {key!r} is missing")
    try:
        out = np.asarray(table[key], dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigError(f"{key} must hold numbers, all rows of one length") from None
    if out.ndim != ndim or _mixed(table[key]):
        raise ConfigError(f"{key} must be {('a number', 'a list', 'a list of rows')[ndim]}")
    return out


def _mixed(value: object) -> bool:
    """Whether anything in nested lists is not a number (a word that reads as one, a truth)."""
    if isinstance(value, list):
        return any(_mixed(x) for x in value)
    return isinstance(value, bool) or not isinstance(value, int | float)


def text(x: Trajectory, note: str = "") -> str:
    """TOML text of a trajectory."""
    lines = [f"# {line}" for line in note.splitlines()]
    words = {
        "schema": SCHEMA, "name": x.name, "for": list(x.purpose), "joints": list(x.joints),
        "units": list(x.units), "period": x.period,
    }  # fmt: skip
    lines += [f"{k} = {json.dumps(v)}" for k, v in words.items()]
    lines += ["", "[path] # straight lines through q [rad or m] at t [s], corners rounded"]
    lines += [f"t = {_row(x.times)}", f"blend = {_row(x.blend)}", f"q = {_rows(x.via)}"]
    if x.series.shape[1]:
        lines += ["", "[fourier] # rows: joints; columns: multiples of 1 / period"]
        lines += [f"sin = {_rows(x.series[..., 0])}", f"cos = {_rows(x.series[..., 1])}"]
    return "\n".join([*lines, ""])


def _row(values: FloatArray) -> str:
    return "[" + ", ".join(repr(float(f"{v:.12g}")) for v in values) + "]"


def _rows(values: FloatArray) -> str:
    return "[\n" + "".join(f"  {_row(v)},\n" for v in values) + "]"


def write(x: Trajectory, path: str | Path, note: str = "") -> None:
    """Write a trajectory file."""
    Path(path).write_text(text(x, note), encoding="utf-8")
