"""What a law is told of an arm, and what an operator may change of it while it runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from hil.errors import ConfigError, unknown


@dataclass(frozen=True)
class ArmDescription:
    """An arm of d joints.

    Parameters
    ----------
    joints : tuple of str
        Names, in kinematic order, length d.
    urdf : str
        URDF text; empty for a preset.
    low, high, center : tuple of float
        Range of every joint and the posture in its middle [rad or m], length d.
    torque_limit : tuple of float
        [N m or N], length d.
    """

    joints: tuple[str, ...]
    urdf: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    center: tuple[float, ...]
    torque_limit: tuple[float, ...]

    @property
    def d(self) -> int:
        """Number of joints."""
        return len(self.joints)


@dataclass(frozen=True)
class SettableRange:
    """Values that a parameter may take, bounds included.

    Parameters
    ----------
    low, high : float
        Bounds, of every entry.
    unit : str
        SI; empty for a ratio.
    entries : int
        Numbers that it takes.
    """

    low: float
    high: float
    unit: str = ""
    entries: int = 1

    def __str__(self) -> str:
        many = f"{self.entries} x " if self.entries > 1 else ""
        return f"{many}{self.low:g}..{self.high:g}{self.unit and f' {self.unit}'}"


@runtime_checkable
class Settable(Protocol):
    """A law's parameters of which some may be set."""

    def settable(self) -> Mapping[str, SettableRange]:
        """Parameter -> range."""
        ...


def ranges(parameters: object) -> Mapping[str, SettableRange]:
    """Ranges that the parameters of a law declare; none where they declare nothing."""
    return parameters.settable() if isinstance(parameters, Settable) else {}


def told(known: Mapping[str, SettableRange]) -> str:
    """All of them in one line."""
    return ", ".join(f"{name} {known[name]}" for name in sorted(known)) or "none"


def checked(
    name: str, values: Sequence[float], known: Mapping[str, SettableRange]
) -> Sequence[float]:
    """`values` of the parameter `name`, within its range.

    Raises
    ------
    ConfigError
        For a parameter that cannot be set, another number of values, or one out of range.
    """
    if name not in known:
        raise ConfigError(f"{unknown('parameter', name, known)} Ranges: {told(known)}.")
    allowed = known[name]
    if len(values) != allowed.entries:
        raise ConfigError(f"{name} takes {allowed.entries} numbers, got {len(values)}: {allowed}.")
    for value in values:
        if not allowed.low <= value <= allowed.high:
            raise ConfigError(f"{name} = {value:g} is out of range: {allowed}.")
    return values
