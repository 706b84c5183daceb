"""How far long work has come: the work says it, and whoever listens shows it.

The work knows neither a terminal nor a page, and pays nothing where nobody listens.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

#: Told what is being done, and what share of all work lies behind it, from 0 to 1.
Listener = Callable[[str, float], None]
_listeners: list[Listener] = []


def at(what: str, done: float) -> None:
    """Say what begins now.

    Parameters
    ----------
    what : str
        The piece of work, in a few words.
    done : float
        Share of the whole work that lies behind, from 0 to 1.
    """
    for listener in _listeners:
        listener(what, done)


@contextlib.contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Give `listener` what is said, within."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)
