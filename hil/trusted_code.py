"""What a file would run with the user's rights, and what of it the user has agreed to.

A model file may name Python files, a rig file a program that takes the power off.  Neither runs
because a file was read: the user agrees to it as it is (`hil trust`), and a digest of its content
is remembered.  Whatever is changed is asked for anew.

Python files that a plugin imports from beside it are found without running anything.  What is
found is what runs: an import of such a module executes the text that was looked at, and an import
of a file from elsewhere (the working directory, a folder put on the path) is refused.  What is
installed comes first, so that a file beside a plugin cannot take its place.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib.abc
import importlib.machinery
import importlib.util
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType

from hil.errors import ConfigError
from hil.userfile import LARGEST_TEXT, read_bytes, write_text

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


def local_modules(plugin: Path, source: bytes) -> dict[str, LocalModule]:
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


#: Environment variable that names the folder in which things are remembered.
STATE_VARIABLE = "HIL_STATE"
#: Endings of scripts that an interpreter runs without a right to be run.
_SCRIPTS = (".bash", ".js", ".lua", ".pl", ".py", ".rb", ".sh", ".tcl", ".zsh")
#: Programs that run what they are given, whatever it is called; options of theirs with a value.
_INTERPRETER = re.compile(r"(ba|da|k|z|a|fi)?sh|pythonw?[\d.]*|pypy[\d.]*|perl|ruby|node|lua|tclsh")
_VALUED = ("-o", "+o", "-O", "+O", "-W", "-X", "--rcfile", "--init-file")
#: Characters that may make one word look like two, or like another.
_DOUBTFUL = frozenset(" '\"\\")


@dataclass(frozen=True)
class Executable:
    """Something that would run.

    Parameters
    ----------
    kind : str
        ``"plugin"`` or ``"cut program"``.
    text : str
        The file, or the words of the command.
    digest : str
        Of its content and that of `parts`: SHA-256, hexadecimal.
    parts : tuple of str
        Further files that it brings in.
    """

    kind: str
    text: str
    digest: str
    parts: tuple[str, ...] = ()

    @property
    def trusted(self) -> bool:
        """Whether the user has agreed to it as it is now."""
        return _place(self).is_file()


def folder() -> Path:
    """Where this user's agreements and latches are kept."""
    named = os.environ.get(STATE_VARIABLE)
    if named:
        return Path(named)
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(base) / "hil"


def plugin(
    path: Path, source: bytes, modules: Mapping[str, LocalModule] | None = None
) -> Executable:
    """The Python file `path` with the content `source`, and the files beside it that it imports.

    Parameters
    ----------
    path : Path
        The file.
    source : bytes
        Its text.
    modules : mapping, optional
        What `hil.trusted_code.local_modules` has found.

    Raises
    ------
    ConfigError
        As of `hil.trusted_code.local_modules`.
    """
    digest = hashlib.sha256(b"plugin\0" + source)
    modules = local_modules(path, source) if modules is None else modules
    for name, module in modules.items():
        digest.update(b"\0" + name.encode() + b"\0" + hashlib.sha256(module.source).digest())
    parts = tuple(_shown(m.path) for m in modules.values())
    return Executable("plugin", _shown(path), digest.hexdigest(), parts)


def _shown(path: Path) -> str:
    """A path as one line."""
    return str(path) if str(path).isprintable() else repr(str(path))


def cut_program(words: Sequence[str]) -> Executable:
    """A command, `words[0]` an absolute path.

    The content counts of the program and of every script that the other words name, also of what
    an interpreter is given by another name; what they name else, such as a log, may change.
    """
    digest, given = hashlib.sha256(b"cut"), interpreted(words)
    for k, word in enumerate(words):
        digest.update(b"\0" + word.encode())
        path = Path(word)
        # a word may be a whole script, longer than the name of a file may be
        if os.path.isfile(word) and (k == 0 or word == given or is_script(path)):
            digest.update(b"\0" + _content(path))
    return Executable("cut program", quoted_command(words), digest.hexdigest())


def quoted_command(words: Sequence[str]) -> str:
    """A command as one line: a word that could be taken for more, or for none, stands in quotes."""
    return " ".join(w if w and w.isprintable() and not _DOUBTFUL & {*w} else repr(w) for w in words)


def interpreted(words: Sequence[str]) -> str:
    """Name of the script that an interpreter would run; empty where the command runs none."""
    words = found_by_env(words)
    if not words or not _INTERPRETER.fullmatch(Path(words[0]).name):
        return ""
    rest = iter(words[1:])
    for word in rest:
        if word in _VALUED:
            next(rest, "")
        elif not word.startswith(("-", "+")):
            return word
        elif word[1:2] != "-" and {*word} & {*"cme"}:
            return ""  # the script itself, or the name of a module, comes next
    return ""


def found_by_env(words: Sequence[str]) -> Sequence[str]:
    """The command that `env` would run; any other command as it is."""
    if not words or Path(words[0]).name != "env" or any(w.startswith("-S") for w in words):
        return words
    rest = list(words[1:])
    while rest and (rest[0].startswith("-") or "=" in rest[0]):
        if rest.pop(0) in ("-u", "-C", "--unset", "--chdir") and rest:
            del rest[0]
    return rest


def _content(path: Path) -> bytes:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def is_script(path: Path) -> bool:
    """Whether another program would run the file: it may be run, or is called like a script."""
    return path.suffix in _SCRIPTS or os.access(path, os.X_OK)


def _place(what: Executable) -> Path:
    return folder() / "trusted" / what.digest


def ask_consent(place: Path) -> None:
    """Make a folder within `folder`.

    Raises
    ------
    ConfigError
        If it cannot be made.
    """
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(unwritable(error, place)) from error


def unwritable(error: OSError, place: Path) -> str:
    """Sentence about an error at `place`, within `folder`; a full disk names no file."""
    return (
        f"{error.filename or place}: {error.strerror}; agreements and latches are "
        f"kept in {folder()}, give {STATE_VARIABLE} = FOLDER to keep them elsewhere"
    )


def give(what: Executable) -> None:
    """Remember that the user has agreed to it as it is now; `ConfigError` where it cannot be."""
    place = _place(what)
    ask_consent(place.parent)
    try:
        write_text(place, f"{what.kind}: {what.text}\n")
    except OSError as error:
        raise ConfigError(unwritable(error, place)) from error


def withdraw(what: Executable) -> None:
    """Forget it."""
    _place(what).unlink(missing_ok=True)


def require(what: Executable, source: str) -> None:
    """Go on only with what the user has agreed to.

    Parameters
    ----------
    what : Executable
        What would run.
    source : str
        The file that asks for it.

    Raises
    ------
    ConfigError
        Says what would run and how to agree.
    """
    if not what.trusted:
        said = (
            f"{what.kind} {what.text} would run with your rights, and you have not agreed to it as "
            "it is now"
        )
        raise ConfigError(
            f"{said}; look at it, then 'hil trust {source}' remembers that you do"
        ).about("trust", said)
