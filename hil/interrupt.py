"""Ctrl-C at any moment: one line, exit code 130, whatever was going on.

While the program starts or ends there is nothing to undo, and it leaves at once.  While a command
runs, the first Ctrl-C unwinds it (motors off, record closed); what comes while it unwinds is
ignored, so that impatience costs neither.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

CODE = 130
#: Further Ctrl-C are ignored for so long after the one that unwinds [s].
UNWINDING_S = 5.0
#: Time after which one that got lost in a callback is given again [s].
AGAIN_S = 0.01


class Ended(SystemExit):
    """SIGTERM or SIGHUP, which ends the program once all is closed; its code is 128 + number.

    Parameters
    ----------
    number : int
        Of the signal.
    said : str
        Where the record is, where there is one.
    """

    def __init__(self, number: int, said: str = "") -> None:
        super().__init__(128 + number)
        self.number, self.said = number, said

    def __str__(self) -> str:
        return signal.Signals(self.number).name


class Interrupts:
    """What SIGINT does to the program; there is one, `interrupts`."""

    def __init__(self) -> None:
        self._name = "hil"
        self._running = False
        self._since = -float("inf")
        #: Whether a command was interrupted; an error after that is a consequence.
        self.seen = False
        self._told = False
        #: Exit code of a command that is done.
        self._code: int | None = None
        #: Parts that are done as a whole, one within the other, and what waits for their end.
        self._whole = 0
        self._waiting: Callable[[], None] | None = None

    def __enter__(self) -> None:
        """What follows is done as a whole: an interruption of the main thread waits for its end.

        For what is worse half done, e.g. a chunk that is written and counted.
        """
        if threading.current_thread() is threading.main_thread():
            self._whole += 1

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if threading.current_thread() is threading.main_thread():
            self._whole -= 1
            if not self._whole and self._waiting is not None:
                given, self._waiting = self._waiting, None
                given()

    def waits(self, given: Callable[[], None]) -> bool:
        """Whether a signal came within what is done as a whole; `given` is called at its end."""
        if self._whole:
            self._waiting = given
        return self._whole > 0

    def arm(self) -> None:
        """From here on Ctrl-C leaves at once; to be called before anything large is imported."""
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, self._handle)
            sys.unraisablehook = self._unraisable
            atexit.register(self._last)  # registered first, it runs last

    @contextlib.contextmanager
    def unwinding(self, name: str) -> Iterator[None]:
        """A command runs: Ctrl-C raises KeyboardInterrupt.

        Parameters
        ----------
        name : str
            Of the command, for the line.
        """
        self._name, self._running, self.seen = f"hil {name}", True, False
        self._since, self._told = -float("inf"), False
        try:
            yield
        finally:
            self._running = False

    def line(self, said: str = "") -> str:
        """What is printed at the end, once; `said` is where the record is, where there is one."""
        if self._told:
            return ""
        self._told = True
        return f"{self._name}: interrupted{f'; {said}' if said else ''}\n"

    def _handle(self, number: int, frame: FrameType | None) -> None:
        unwinds = time.monotonic() - self._since <= UNWINDING_S
        if not self._running:
            if unwinds:  # the line that says where the record is comes now
                return
            self.leave(self.line())
        while frame is not None:
            if frame.f_code is Interrupts._unraisable.__code__:  # it would be lost once more
                self._give_again()
                return
            frame = frame.f_back
        if not (unwinds or self.waits(self._unwind)):
            self._unwind()

    def _unwind(self) -> None:
        self._since, self.seen = time.monotonic(), True
        raise KeyboardInterrupt

    def done(self, code: int) -> None:
        """The command is done and all is said: the process ends with `code`."""
        self._code = code

    def _last(self) -> None:
        """What is left is taking the interpreter down, which would die of Ctrl-C without a word."""
        if self._code is None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        else:
            self.leave("", self._code)

    def leave(self, line: str, code: int = CODE) -> None:
        """Print a line and end the process, past everything that could still print or wait."""
        for stream in (sys.stdout, sys.stderr):
            # the interruption may have hit a write to the same stream, which refuses a second
            with contextlib.suppress(OSError, RuntimeError, ValueError):
                stream.flush()
        with contextlib.suppress(OSError):
            os.write(2, line.encode("utf-8", "replace"))
        _give_back_semaphores()
        os._exit(code)

    def end(self) -> None:
        """End the process of an interrupted command, whatever its threads still do.

        What libraries do at exit is done, but for waiting for threads: they calculate for nobody.
        """
        run: Callable[[], None] | None = getattr(atexit, "_run_exitfuncs", None)
        if run is not None:
            run()
        self.leave("")

    def _unraisable(self, told: Any) -> None:
        """An interruption that hit a callback or a destructor is given again outside of it."""
        if not issubclass(told.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(told)
            return
        self._since = -float("inf")
        self._give_again()

    def _give_again(self) -> None:
        again = threading.Timer(AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
        again.daemon = True
        again.start()


def _give_back_semaphores() -> None:
    """Semaphores of pools of processes: what is not given back is told of as leaked."""
    util, locks = (sys.modules.get(f"multiprocessing.{n}") for n in ("util", "synchronize"))
    known: dict[Any, Any] = getattr(util, "_finalizer_registry", {})
    cleanup = getattr(getattr(locks, "SemLock", None), "_cleanup", None)
    for last in list(known.values()):
        if cleanup is not None and getattr(last, "_callback", None) is cleanup:
            with contextlib.suppress(Exception):
                last()


interrupts = Interrupts()


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """No SIGINT for this thread, nor for threads and processes that it starts, which keep that.

    For pools of processes: a terminal sends Ctrl-C to all of them, and each would print its own
    traceback; their owner ends them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    # where it starts within, it lets the signal through again
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def with_its_parent() -> None:
    """End this process when the one that started it ends, however that happens.

    For workers of a pool: a parent that is killed closes nothing, and they would work on for hours.
    """
    from multiprocessing import parent_process

    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent.sentinel,), daemon=True).start()


def _follow(sentinel: int) -> None:
    from multiprocessing.connection import wait

    wait([sentinel])
    # nobody is left who could take a result
    os._exit(CODE)


@contextlib.contextmanager
def saying(where: Callable[[], str]) -> Iterator[None]:
    """Add to an interruption, or the end by a signal, where the record is.

    An error after an interruption is its consequence: a library that was interrupted in a
    callback says so in its own way.

    Parameters
    ----------
    where : callable
        Sentence, asked for after everything within has been closed.
    """
    try:
        yield
    except Ended as error:
        raise Ended(error.number, where()).with_traceback(error.__traceback__) from None
    except (KeyboardInterrupt, Exception) as error:
        if not (interrupts.seen or isinstance(error, KeyboardInterrupt)):
            raise
        raise KeyboardInterrupt(where()).with_traceback(error.__traceback__) from None
