"""What a file would run with the user's rights, and what of it the user has agreed to.

A model file may name Python files, a rig file a program that takes the power off.  Neither runs
because a file was read: the user agrees to it as it is (`hil trust`), and a digest of its content
is remembered.  Whatever is changed is asked for anew.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.errors import ConfigError
from hil.local_modules import LocalModule, beside
from hil.userfile import write_text

#: Environment variable that names the folder in which things are remembered.
VARIABLE = "HIL_STATE"
#: Endings of scripts that an interpreter runs without a right to be run.
_SCRIPTS = (".bash", ".js", ".lua", ".pl", ".py", ".rb", ".sh", ".tcl", ".zsh")


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
    named = os.environ.get(VARIABLE)
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
        What `hil.local_modules.beside` has found.

    Raises
    ------
    ConfigError
        As of `hil.local_modules.beside`.
    """
    digest = hashlib.sha256(b"plugin\0" + source)
    modules = beside(path, source) if modules is None else modules
    for name, module in modules.items():
        digest.update(b"\0" + name.encode() + b"\0" + hashlib.sha256(module.source).digest())
    parts = tuple(str(m.path) for m in modules.values())
    return Executable("plugin", str(path), digest.hexdigest(), parts)


def cut_program(words: Sequence[str]) -> Executable:
    """A command, `words[0]` an absolute path.

    The content counts of the program and of every script that the other words name; what they name
    else, such as a log, may change.
    """
    digest = hashlib.sha256(b"cut")
    for k, word in enumerate(words):
        digest.update(b"\0" + word.encode())
        path = Path(word)
        # a word may be a whole script, longer than the name of a file may be
        if os.path.isfile(word) and (k == 0 or _script(path)):
            digest.update(b"\0" + _content(path))
    return Executable("cut program", " ".join(words), digest.hexdigest())


def _content(path: Path) -> bytes:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def _script(path: Path) -> bool:
    """Whether another program would run the file: it may be run, or is called like a script."""
    return path.suffix in _SCRIPTS or os.access(path, os.X_OK)


def _place(what: Executable) -> Path:
    return folder() / "trusted" / what.digest


def prepare(place: Path) -> None:
    """Make a folder within `folder`.

    Raises
    ------
    ConfigError
        If it cannot be made.
    """
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(_unwritable(error)) from error


def _unwritable(error: OSError) -> str:
    return (
        f"{error.filename}: {error.strerror}; agreements and latches are kept in {folder()}, give "
        f"{VARIABLE} = FOLDER to keep them elsewhere"
    )


def give(what: Executable) -> None:
    """Remember that the user has agreed to it as it is now; `ConfigError` where it cannot be."""
    place = _place(what)
    prepare(place.parent)
    try:
        write_text(place, f"{what.kind}: {what.text}\n")
    except OSError as error:
        raise ConfigError(_unwritable(error)) from error


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
        raise ConfigError(
            f"{what.kind} {what.text} would run with your rights, and you have not agreed to it as "
            f"it is now; look at it, then 'hil trust {source}' remembers that you do"
        )
