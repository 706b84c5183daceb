"""Ways out: a signal that ends the program unwinds it first, so that the motors get zero."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

#: Ctrl-C unwinds already, as KeyboardInterrupt.
SIGNALS = ("SIGTERM", "SIGHUP")


def _unwind(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


@contextlib.contextmanager
def unwinding_signals() -> Iterator[None]:
    """Turn the signals that would kill the process at once into SystemExit(128 + number).

    Outside of the main thread, where Python takes no signals, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    found = [getattr(signal, name) for name in SIGNALS if hasattr(signal, name)]
    old = {number: signal.signal(number, _unwind) for number in found}
    try:
        yield
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)
