"""The one table of effects: built in, from installed packages, and from a user's file.

Whether an effect is declared so that the rest can use it, and in words why not.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Iterable, Iterator
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType

from hil import trusted_code
from hil.errors import ConfigError, in_short, near_name, unknown
from hil.models.effect import FIXED, NEVER, Effect
from hil.models.parts import Doc, Relations, Scope, ShapeSearch, Trait, Variation
from hil.userfile import LARGEST_TEXT, read_bytes

#: Modules with a tuple `EFFECTS`; adding an effect touches its own file, its test, one line here.
MODULES = (
    "hil.models.friction",
    "hil.models.load_friction",
    "hil.models.mass",
    "hil.models.payload",
    "hil.models.actuator",
    "hil.models.contact",
    "hil.models.disturbance",
    "hil.models.sensors",
    "hil.models.encoders",
    "hil.models.transmission",
    "hil.models.correction",
    "hil.models.expansions",
)
_table: dict[str, Effect] = {}


def _add(module: ModuleType, origin: str) -> None:
    effects: Iterable[object] = getattr(module, "EFFECTS", ())
    for effect in effects:
        if not isinstance(effect, Effect):
            raise ConfigError(
                f"EFFECTS of {origin} holds {effect!r}, which is not an Effect instance; "
                "write EFFECTS = (MyEffect(),)"
            )
        if said := misdeclared(effect):
            raise ConfigError(f"EFFECTS of {origin}: {said}")
        listed = {
            "confused_with": effect.doc.confused_with,
            "replaces": effect.relations.replaces,
            "causes": effect.relations.causes,
        }
        for name, value in listed.items():
            if not isinstance(value, tuple):
                raise ConfigError(
                    f"effect {effect.name!r} of {origin}: {name} is {value!r}, expected a tuple "
                    'of names, e.g. ("stribeck",)'
                )
        known = _table.get(effect.name)
        if known is not None and type(known).__module__ != type(effect).__module__:
            raise ConfigError(
                f"effect {effect.name!r} of {origin} is already defined in {_home(known)}; "
                "give it another name"
            )
        _table[effect.name] = effect


def table() -> dict[str, Effect]:
    """All known effects by name; built-in modules and entry points are loaded at first use."""
    if not _table:
        for name in MODULES:
            _add(importlib.import_module(name), name)
        for point in entry_points(group=_GROUP):
            _add(point.load(), point.value)
    return _table


def get(name: str) -> Effect:
    """Effect by name.

    Raises
    ------
    ConfigError
        With the nearest name and the whole list, if there is none of that name.
    """
    if name not in table():
        raise ConfigError(unknown("effect", name, table()))
    return table()[name]


def load_plugin(path: Path, said_in: Path | None = None) -> None:
    """Load a user's effects from a Python file with a tuple `EFFECTS`.

    Parameters
    ----------
    path : Path
        The file.  Its text is run, never what was compiled of it before; it may import files
        beside it and what is installed.
    said_in : Path, optional
        Model file that names it; then it runs only if the user has agreed to it.

    Raises
    ------
    ConfigError
        If the file is missing, does not run, holds no effects, or was not agreed to.
    """
    if not path.is_file():
        raise ConfigError(f"plugin {path}: no such Python file")
    try:
        source = read_bytes(path, LARGEST_TEXT)
    except OSError as error:
        raise ConfigError(f"plugin {path} cannot be read: {error}") from error
    load_text(path, source, said_in)


def load_text(path: Path, source: bytes, said_in: Path | None = None) -> None:
    """Load the effects of a text as if it stood in a file, which need not hold it yet.

    Parameters
    ----------
    path : Path
        The file.
    source : bytes
        The text.
    said_in : Path, optional
        As of `load_plugin`.

    Raises
    ------
    ConfigError
        As `load_plugin`.
    """
    table()
    spec = importlib.util.spec_from_file_location(_MODULE + path.stem, path)
    if spec is None:
        raise ConfigError(f"plugin {path}: no such Python file")
    beside = trusted_code.local_modules(path, source)
    if said_in is not None:
        trusted_code.require(trusted_code.plugin(path, source, beside), str(said_in))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up by name
    called = near_name(str(path))
    try:
        code = compile(source, spec.origin or str(path), "exec", dont_inherit=True)
        with trusted_code.loading(path, beside):
            exec(code, module.__dict__)
    except ConfigError:
        raise
    except (Exception, SystemExit) as error:
        raise ConfigError(f"plugin {called} does not run: {in_short(error)}") from error
    effects = getattr(module, "EFFECTS", ())
    if not isinstance(effects, tuple | list) or not effects:
        raise ConfigError(f"plugin {called} has no EFFECTS = (MyEffect(),) at its end")
    _add(module, called)


#: How the module of a user's file begins, before the stem of the file.
_MODULE = "hil_plugin_"


def _home(effect: Effect) -> str:
    """Where an effect is defined, in words: a user's file, or what it came with."""
    module = type(effect).__module__
    if module.startswith(_MODULE):
        return near_name(str(getattr(sys.modules[module], "__file__", module)))
    return f"{module}, which comes with hil" if module.startswith("hil.") else module


def load_files(paths: Iterable[str]) -> None:
    """Load a user's effects from several Python files; see `load_plugin`."""
    for path in paths:
        load_plugin(Path(path))


#: What a class may not leave out.
NEEDED = ("name", "family", "doc")
#: Part -> its type, how it is written, its default, and what was an attribute of its own once.
_PARTS: dict[str, tuple[type, str, object, tuple[str, ...]]] = {
    "doc": (
        Doc,
        "Doc(equation=..., signature=..., shown_by=..., source=...)",
        None,
        (
            "equation",
            "signature",
            "confused_with",
            "shown_by",
            "source",
            "caveat",
            "variables",
            "remark",
        ),
    ),
    "scope": (
        Scope,
        "Scope(Of.ROBOT, explains=..., lacks=..., terms=...)",
        Effect.scope,
        ("whole_robot", "jointless", "explains", "available", "terms"),
    ),
    "variation": (
        Variation,
        "PER_RUN",
        NEVER,
        ("per_run", "relative", "sudden", "belongs", "dated"),
    ),
    "relations": (
        Relations,
        "Relations(replaces=...)",
        Effect.relations,
        ("replaces", "twins", "limit", "foils", "state"),
    ),
    "search": (
        ShapeSearch,
        "Grid(shapes), shapes(motion, j) a function",
        FIXED,
        (
            "grid",
            "across",
            "others",
            "carrier",
            "powers",
            "rounds",
            "refine",
            "ends_at_resolution",
            "spectral",
        ),
    ),
    "limits": (
        tuple,
        "(Limit(code, met), BOUNDS)",
        Effect.limits,
        ("credible", "strict"),
    ),
    "traits": (
        Trait,
        "Trait.REPLAYED | ...",
        Trait.NONE,
        ("candidate", "uses_load", "motion_only", "replayed", "smooths", "correction", "geometry"),
    ),
}


def misdeclared(effect: Effect) -> str:
    """What is wrong with an effect's declaration and what to do; empty if nothing."""
    kind = type(effect)
    old = "; ".join(_old(kind))
    if old:
        return (
            f"{kind.__name__} is declared in the old way: {old} (docs/own-effects.md shows a "
            "whole one)"
        )
    missing = [name for name in NEEDED if not hasattr(kind, name)]
    if missing:
        return f"{kind.__name__} has no {', no '.join(missing)}; docs/own-effects.md shows one"
    for part, (expected, written, _, _) in _PARTS.items():
        value = getattr(kind, part)
        if not isinstance(value, expected):
            return f"{kind.__name__}.{part} is {value!r}, expected {written}"
    if kind.shape and kind.search.grid is FIXED.grid:
        return f"{kind.__name__} has shape parameters but no grid: write search = Grid(shapes)"
    return ""


def _old(kind: type[Effect]) -> Iterator[str]:
    """Where attributes of an earlier declaration belong, part by part."""
    for part, (_, written, default, names) in _PARTS.items():
        unset = getattr(kind, part, None) == default
        # a function of such a name may be what a part was made of
        found = [n for n in names if hasattr(kind, n) and (unset or not _callable(kind, n))]
        if found:
            listed = ", ".join(map(repr, found))
            yield f"{listed} belong{'s' if len(found) == 1 else ''} into {part} = {written}"


def _callable(kind: type[Effect], name: str) -> bool:
    return callable(getattr(kind, name))


#: Entry points of installed packages with effects.
_GROUP = "hil.effects"


def load_installed() -> None:
    """Fill the catalogue; warn of every package whose effects cannot be loaded, and go on.

    The catalogue stops at the first package that fails; what comes after it is put in here.
    """
    try:
        table()
        return
    except Exception:  # said below, package by package
        points = list(entry_points(group=_GROUP))
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
    there = table()  # filled by now, up to the first package that failed
    for effect in getattr(point.load(), "EFFECTS", ()):
        if not isinstance(effect, Effect):
            raise ConfigError(f"EFFECTS holds {effect!r}, which is not an Effect instance")
        known = there.setdefault(effect.name, effect)
        if type(known).__module__ != type(effect).__module__:
            raise ConfigError(f"effect {effect.name!r} is already in {type(known).__module__}")
