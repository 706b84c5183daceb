"""A mistake in a rig file is told with the name of the file, also where it shows on opening."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hil.errors import ConfigError
from hil.rig.config import RigConfig
from hil.rig.open import Rig, open_rig


@contextmanager
def named(path: str) -> Iterator[None]:
    """Put the name of the rig file in front of a `ConfigError`."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error.__cause__


def opener(path: str) -> Callable[[RigConfig, int], Rig]:
    """`hil.rig.open.open_rig` whose mistakes have the name of the rig file."""

    def opened(config: RigConfig, seed: int) -> Rig:
        with named(path):
            return open_rig(config, seed)

    return opened
