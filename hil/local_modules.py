"""Python files that a user's plugin imports from beside it: found without running anything.

What is found is what runs: an import of such a module executes the text that was looked at, and
an import of a file from elsewhere (the working directory, a folder put on the path) is refused.
What is installed comes first, so that a file beside a plugin cannot take its place.
"""

from __future__ import annotations

import ast
import contextlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType

from hil.errors import ConfigError
from hil.userfile import LARGEST_TEXT, read_bytes

#: Files beside a plugin that it may import.
MOST_FILES = 200


@dataclass(frozen=True)
class LocalModule:
    """One file.

    Parameters
    ----------
    path : Path
        Where it lies.
    source : bytes
        Its text.
    package : bool
        Whether it is the ``__init__.py`` of a package.
    """

    path: Path
    source: bytes
    package: bool = False


def beside(plugin: Path, source: bytes) -> dict[str, LocalModule]:
    """Modules beside `plugin` that it imports, and what those import, by name.

    Parameters
    ----------
    plugin : Path
        The file.
    source : bytes
        Its text.

    Returns
    -------
    dict
        In the order of their names.  A package counts with all of its files.

    Raises
    ------
    ConfigError
        If there are more than `MOST_FILES`, or one cannot be read.
    """
    found: dict[str, LocalModule] = {}
    waiting = sorted(_imported(source))
    while waiting:
        name = waiting.pop()
        if name in found or _installed(name, plugin.parent):
            continue
        for called, module in _files(plugin.parent, name):
            found[called] = module
            waiting += sorted(_imported(module.source) - set(found))
            if len(found) > MOST_FILES:
                raise ConfigError(
                    f"plugin {plugin} imports more than {MOST_FILES} files beside it; install "
                    "them as a package"
                )
    return dict(sorted(found.items()))


def _imported(source: bytes) -> set[str]:
    """First parts of all names that a text imports, wherever in it; none of what is no Python."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return set()  # it is said when the text is run
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {a.name.partition(".")[0] for a in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            names.add(node.module.partition(".")[0])
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            # import_module("name") and __import__("name")
            value = node.args[0].value
            if isinstance(value, str) and value.partition(".")[0].isidentifier():
                names.add(value.partition(".")[0])
    return names


def _files(folder: Path, name: str) -> Iterator[tuple[str, LocalModule]]:
    """The file of a module, or all files of a package, in a folder."""
    package = folder / name
    if (package / "__init__.py").is_file():
        for path in sorted(package.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            whole = parts[-1] == "__init__"
            yield ".".join(parts[:-1] if whole else parts), _read(path, whole)
    elif (file := folder / f"{name}.py").is_file():
        yield name, _read(file)


def _read(path: Path, package: bool = False) -> LocalModule:
    try:
        return LocalModule(path, read_bytes(path, LARGEST_TEXT), package)
    except OSError as error:
        raise ConfigError(f"module {path} cannot be read: {error}") from error


def _installed(name: str, folder: Path) -> bool:
    """Whether a module is of Python or installed."""
    return _installed_at(name, _places(folder))


def _places(folder: Path) -> frozenset[str]:
    """Where modules are installed: not in the working directory, nor beside a plugin."""
    away = (Path.cwd(), folder.resolve())
    return frozenset(p for p in sys.path if p and Path(p).resolve() not in away)


def _installed_at(name: str, places: frozenset[str]) -> bool:
    if name in sys.stdlib_module_names or name in sys.builtin_module_names or name == "hil":
        return True
    return importlib.machinery.PathFinder.find_spec(name, sorted(places)) is not None


# ------------------------------------------------------------ imports of what was looked at


class _Looked(importlib.abc.MetaPathFinder, importlib.abc.InspectLoader):
    """Imports the modules that were looked at, from the text that was read."""

    def __init__(self) -> None:
        self.known: dict[str, LocalModule] = {}
        #: Folder of the plugin that is being loaded, and where modules may come from.
        self.loading: list[tuple[Path, frozenset[str]]] = []

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        module = self.known.get(fullname)
        if module is not None:
            spec = importlib.util.spec_from_loader(
                fullname, self, origin=str(module.path), is_package=module.package
            )
            if spec is not None:
                spec.has_location = True
            return spec
        if path is None and self.loading:
            self._refuse_strange(fullname)
        return None

    def _refuse_strange(self, name: str) -> None:
        folder, places = self.loading[-1]
        if _installed_at(name, places):
            return
        spec = importlib.machinery.PathFinder.find_spec(name)
        if spec is not None and spec.origin not in ("built-in", "frozen"):
            raise ImportError(
                f"module {name} is {spec.origin or spec.submodule_search_locations}, which nobody "
                f"has agreed to; put it beside the plugin, in {folder}, or install it"
            )

    def get_source(self, fullname: str) -> str:
        return importlib.util.decode_source(self.known[fullname].source)

    def get_code(self, fullname: str) -> CodeType:
        module = self.known[fullname]
        return compile(module.source, str(module.path), "exec", dont_inherit=True)

    def is_package(self, fullname: str) -> bool:
        return self.known[fullname].package


_looked = _Looked()


@contextlib.contextmanager
def loading(plugin: Path, modules: Mapping[str, LocalModule]) -> Iterator[None]:
    """Let a plugin import `modules`, within and later on, and no other file that is not installed.

    Raises
    ------
    ConfigError
        If another plugin brought another module of the same name.
    """
    for name, module in modules.items():
        known = _looked.known.get(name)
        if known is not None and known.path == module.path and known.source != module.source:
            sys.modules.pop(name, None)  # it was changed since
        elif known is not None and known != module:
            raise ConfigError(
                f"plugin {plugin} imports {module.path}, and another plugin {known.path}; one of "
                "the two needs another name"
            )
    _looked.known.update(modules)
    if _looked not in sys.meta_path:
        sys.meta_path.insert(0, _looked)
    _looked.loading.append((plugin.parent, _places(plugin.parent)))
    try:
        yield
    finally:
        _looked.loading.pop()
