"""Effects of installed packages: one that does not load is named, and the others are used."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint, entry_points

from hil.errors import ConfigError
from hil.models import catalogue
from hil.models.effect import Effect

GROUP = "hil.effects"


def load_installed() -> None:
    """Fill the catalogue; warn of every package whose effects cannot be loaded, and go on.

    The catalogue stops at the first package that fails; what comes after it is put in here.
    """
    try:
        catalogue.table()
        return
    except Exception:  # said below, package by package
        points = list(entry_points(group=GROUP))
    for point in points:
        try:
            _put(point)
        except Exception as error:
            where = f" of package {point.dist.name}" if point.dist else ""
            sys.stderr.write(
                f"warning: the effects {point.name!r}{where} ({point.value}) cannot be loaded and "
                f"are left out: {type(error).__name__}: {error}; mend or uninstall the package\n"
            )


def _put(point: EntryPoint) -> None:
    """Effects of one package into the catalogue, unless they are there."""
    table = catalogue.table()  # filled by now, up to the first package that failed
    for effect in getattr(point.load(), "EFFECTS", ()):
        if not isinstance(effect, Effect):
            raise ConfigError(f"EFFECTS holds {effect!r}, which is not an Effect instance")
        known = table.setdefault(effect.name, effect)
        if type(known).__module__ != type(effect).__module__:
            raise ConfigError(f"effect {effect.name!r} is already in {type(known).__module__}")
