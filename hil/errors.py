"""The error tree: five families, each also a standard library type.

A message names the object, its state, what was expected, what is available and what to do
next.  `exit_code` is what the command line returns (0 done, 2 bad input, 3 device fault).
"""

from __future__ import annotations

import difflib
import functools
import os
import re
import sys
from collections.abc import Callable, Iterable
from typing import Any, Self


class HilError(Exception):
    """Any failure that the user can do something about.

    The message says what is wrong and what to do on the command line or in Python.  A program in
    which something else is to be done, such as the studio, knows it by the topic.
    """

    exit_code = 2
    #: What the advice is on; empty where it holds everywhere.
    topic = ""
    #: The message without its advice, where there is a topic.
    what = ""

    def about(self, topic: str, what: str) -> Self:
        """The same error with its topic, and what is wrong without the advice.

        Parameters
        ----------
        topic : str
            Name, e.g. ``"time"``.
        what : str
            One sentence without its full stop.
        """
        self.topic, self.what = topic, what
        return self


class ConfigError(HilError, ValueError):
    """A rig, model, map file or an option is wrong."""


class DataError(HilError, ValueError):
    """A recording is unreadable, incomplete or contradicts itself."""


class FitError(HilError, ArithmeticError):
    """The parameters cannot be determined from these data."""


class DeviceError(HilError, OSError):
    """A device refused, vanished or answered nonsense."""

    exit_code = 3


class DeviceTimeoutError(DeviceError, TimeoutError):
    """A device did not answer in time."""


#: What a terminal or a page obeys in place of showing it: controls (C0 but tab and line feed, C1),
#: bidirectional and invisible marks, line separators; and halves of pairs, which no file can hold.
_OBEYED = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    r"\ud800-\udfff\U000e0000-\U000e007f]"
)


def printable(text: str) -> str:
    """Text that shows what it holds: control, bidirectional and invisible characters as escapes.

    Tab and line feed stay.  Names and values of a user's files get onto terminals and pages only
    through this: at the streams of the program, and where a report escapes its text.
    """
    return _OBEYED.sub(_escape, text) if not text.isascii() or not text.isprintable() else text


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    if code < 256:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 65536 else f"\\U{code:08x}"


#: Characters of a name, and names, from which on a message shows only some: a file may hold
#: names of any length, and the search for near ones takes the square of that.
_LONG, _MOST = 120, 200


def unknown(kind: str, name: str, known: Iterable[str]) -> str:
    """Sentence for an unknown name: a known one that is truly near first, then all of them.

    Parameters
    ----------
    kind : str
        What the name should have been, e.g. ``"effect"``.
    name : str
        What was given.
    known : iterable of str
        What there is.
    """
    names = sorted(known)
    short = [n for n in names if len(n) <= _LONG] if len(name) <= _LONG else []
    near = difflib.get_close_matches(name, short, n=1, cutoff=0.6)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    listed = ", ".join(map(_cut, names[:_MOST])) or "none"
    more = f" and {len(names) - _MOST} more" if len(names) > _MOST else ""
    return f"unknown {kind} {_cut(name)!r}.{hint} Available: {listed}{more}."


def _cut(name: str) -> str:
    return name if len(name) <= _LONG else f"{name[: _LONG - 3]}..."


def families(names: Iterable[str]) -> list[str]:
    """Names for a message, those that only count up as one: ``q1 .. q7``, ``state.q[0] .. [6]``.

    Parameters
    ----------
    names : iterable of str
        In their order; a family stands where its first name does.
    """
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(_DIGITS.sub("#", name), []).append(name)
    return [x for group in groups.values() for x in _family(group)]


_DIGITS = re.compile(r"[0-9]+")


def _family(names: list[str]) -> list[str]:
    """First and last name where three or more differ in one number alone, which counts up."""
    numbers = list(zip(*(map(int, _DIGITS.findall(n)) for n in names), strict=True))
    counting = [c for c in numbers if len(set(c)) > 1]
    if len(names) < 3 or len(counting) != 1:
        return [_cut(n) for n in names]
    (count,) = counting
    if count != tuple(range(count[0], count[0] + len(names))):
        return [_cut(n) for n in names]
    return [f"{_cut(names[0])} .. {_cut(names[-1])}"]


def plural(n: int, what: str) -> str:
    """Number and noun, e.g. ``1 joint`` and ``3 joints``."""
    return f"{n} {what}" if n == 1 else f"{n} {what}s"


def listed_names(given: object, what: str) -> tuple[str, ...]:
    """Names that an argument lists; one text stands for a list of one.

    Parameters
    ----------
    given : object
        A name, or several.
    what : str
        The argument, for the message, e.g. ``"joints"``.

    Raises
    ------
    ConfigError
        If it is something else.
    """
    if isinstance(given, str):
        return (given,)
    listed = tuple(given) if isinstance(given, Iterable) else (given,)
    wrong = [x for x in listed if not isinstance(x, str)]
    if wrong:
        raise ConfigError(
            f"{what} is a list of names, not of {type(wrong[0]).__name__}; "
            f"give e.g. {what}=['joint1']"
        )
    return listed


@functools.cache
def public(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of `hil` that refuses arguments that it does not have in one sentence.

    Parameters
    ----------
    function : callable
        The function; the same one gives the same result.
    """
    import inspect  # `import hil` costs nothing

    signature = inspect.signature(function)
    called = f"hil.{function.__name__}"

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        try:
            signature.bind(*args, **kwargs)
        except TypeError as error:
            known = tuple(signature.parameters)
            strange = next((k for k in kwargs if k not in known), None)
            said = str(error) if strange is None else unknown("argument", strange, known)
            raise ConfigError(f"{called}({', '.join(known)}): {said}") from None
        return function(*args, **kwargs)

    # where it is found by its name, for one that is sent to another process
    checked.__module__, checked.__qualname__ = "hil", function.__name__
    return checked


# ------------------------------------------------------------ errors of a user's own effects


def in_short(error: BaseException) -> str:
    """Kind and message of any error in one line.

    Parameters
    ----------
    error : BaseException
        The error.
    """
    said = error.msg if isinstance(error, SyntaxError) else str(error)
    text = " ".join(said.split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def with_place(error: HilError) -> str:
    """The message of an error, and the line of the user's own effects that it comes from, if any.

    Parameters
    ----------
    error : HilError
        The error.
    """
    place = own_place(error.__cause__)
    return f"{error} ({place})" if place else str(error)


def own_place(error: BaseException | None) -> str:
    """File and line of a user's own effects that an error passed through last; empty if none did.

    Parameters
    ----------
    error : BaseException or None
        The error.
    """
    import traceback  # `import hil` costs nothing

    if error is None:
        return ""
    files = user_files()
    if isinstance(error, SyntaxError) and error.filename in files:
        return f"{near_name(error.filename)}, line {error.lineno}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename in files]
    return f"{near_name(frames[-1].filename)}, line {frames[-1].lineno}" if frames else ""


def near_name(file: str) -> str:
    """Name of a file as it is given in the current folder; its whole path where it is elsewhere.

    Parameters
    ----------
    file : str
        Its path.
    """
    here = os.path.join(os.getcwd(), "")
    return file.removeprefix(here)


#: Modules of the program itself; effects from anywhere else are the user's.
_OWN = "hil."


def user_files() -> set[str]:
    """Files of effects that do not come with the program."""
    names = {name for name in sys.modules if name.startswith("hil_plugin_")}
    if "hil.models.effect" in sys.modules:
        kinds = _below(sys.modules["hil.models.effect"].Effect)
        made = {k.__module__ for k in kinds if not k.__module__.startswith(_OWN)}
        # a class that the program makes while it runs is said to be of the library that makes it
        names |= {name for name in made if name.split(".")[0] not in sys.stdlib_module_names}
    found = (getattr(sys.modules.get(name), "__file__", None) for name in names)
    return {file for file in found if file}


def _below(kind: type) -> set[type]:
    """All classes that a class is a base of."""
    direct: set[type] = set(kind.__subclasses__())
    return direct.union(*(_below(k) for k in direct))
