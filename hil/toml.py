"""TOML tables to frozen dataclasses; every unknown key is an error that names the nearest."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

from hil.errors import ConfigError, unknown

T = TypeVar("T")
#: Of a number in a rig file, in SI units; infinity and what overflows is no quantity.
_LARGEST = 1e12


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of `over` merged into `base`, recursively; neither is changed."""
    result = dict(base)
    for key, value in over.items():
        below = result.get(key)
        both = isinstance(value, Mapping) and isinstance(below, Mapping)
        result[key] = merge(below, value) if both and below is not None else value
    return result


def parse(cls: type[T], table: Mapping[str, Any], where: str) -> T:
    """Dataclass of type `cls` from a TOML table; `where` names the table in messages."""
    hints = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    for key in table:
        if key not in fields:
            raise ConfigError(f"[{where}]: {unknown('key', key, fields)}")
    for name, f in fields.items():
        needed = f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
        if needed and name not in table:
            raise ConfigError(f"[{where}]: the key {name!r} is missing.")
    values = {k: _value(hints[k], v, f"{where}.{k}") for k, v in table.items()}
    with in_table(where):
        return cls(**values)


@contextmanager
def in_table(where: str) -> Iterator[None]:
    """Give a `ConfigError` the name of its table, unless it has one already."""
    try:
        yield
    except ConfigError as error:
        if str(error).startswith("["):
            raise
        raise ConfigError(f"[{where}]: {error}") from error.__cause__


def _value(kind: Any, value: Any, where: str) -> Any:
    """`value` as the annotated type `kind`, or a `ConfigError`."""
    origin, args = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return parse(kind, _table(value, where), where)
    if origin is not None and issubclass(origin, Mapping):
        inner = args[1]
        table = _table(value, where)
        return types.MappingProxyType(
            {k: v if inner is Any else _value(inner, v, f"{where}.{k}") for k, v in table.items()}
        )
    if origin is tuple:
        if not isinstance(value, (list, tuple)):
            raise ConfigError(f"[{where}]: a list is needed, not {value!r}.")
        if args[-1] is not Ellipsis and len(value) != len(args):
            raise ConfigError(f"[{where}]: {len(args)} entries are needed, not {len(value)}.")
        return tuple(_value(args[0], v, where) for v in value)
    return _scalar(kind, value, where)


def _scalar(kind: Any, value: Any, where: str) -> Any:
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise ConfigError(f"[{where}]: {value!r} should be of type {kind.__name__}.")
    if kind is float and value != value:
        raise ConfigError(f"[{where}]: not a number.")
    if kind is float and abs(value) > _LARGEST:
        raise ConfigError(f"[{where}]: {value!r} is beyond {_LARGEST:g}, as no quantity here is.")
    return value


def _table(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ConfigError(f"[{where}]: a table is needed, not {value!r}.")
    return value
