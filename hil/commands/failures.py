"""What a failure says to the user, and its exit code; the traceback only with ``--debug``."""

from __future__ import annotations

import sys
import traceback
from pathlib import Path

from hil.errors import HilError

#: Modules of the program itself; effects from anywhere else are the user's.
_OWN = "hil."


def explain(error: Exception, command: str) -> tuple[str, int]:
    """Sentence and exit code of any error.

    Parameters
    ----------
    error : Exception
        What went wrong.
    command : str
        Name of the command, for the way to the traceback.
    """
    if isinstance(error, HilError):
        place = _place(error.__cause__)
        return f"{error}{f' ({place})' if place else ''}", error.exit_code
    place = _place(error)
    if place:
        return f"an effect of your own failed in {place}: {_what(error)}; mend it there", 2
    if isinstance(error, OSError) and error.strerror:
        where = error.filename or "a file or the standard output"
        return f"cannot read or write {where}: {error.strerror}", 2
    return (
        f"internal error: {_what(error)}; run 'hil --debug {command} ...' for the traceback, "
        f"and please report it{_suspects()}"
    ), 1


def _what(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _place(error: BaseException | None) -> str:
    """File and line of the user's code that an error passed through last; empty if none did."""
    if error is None:
        return ""
    files = user_files()
    if isinstance(error, SyntaxError) and error.filename in files:
        return f"{error.filename}, line {error.lineno}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename in files]
    return f"{frames[-1].filename}, line {frames[-1].lineno}" if frames else ""


def _suspects() -> str:
    files = sorted(Path(f).name for f in user_files())
    if not files:
        return ""
    return (
        f"; effects of your own are loaded ({', '.join(files)}): "
        "hil.testing.check_effect tells whether they keep to the rules"
    )


def user_files() -> set[str]:
    """Files of effects that do not come with the program."""
    names = {name for name in sys.modules if name.startswith("hil_plugin_")}
    if "hil.models.effect" in sys.modules:
        kinds = _below(sys.modules["hil.models.effect"].Effect)
        names |= {k.__module__ for k in kinds if not k.__module__.startswith(_OWN)}
    found = (getattr(sys.modules.get(name), "__file__", None) for name in names)
    return {file for file in found if file}


def _below(kind: type) -> set[type]:
    """All classes that a class is a base of."""
    direct: set[type] = set(kind.__subclasses__())
    return direct.union(*(_below(k) for k in direct))
