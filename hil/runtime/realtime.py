"""What the operating system can do for the fast loop, and a plain sentence where it may not."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

#: Of SCHED_FIFO: above threaded interrupts (50), below the kernel's own watchdogs (99).
PRIORITY = 80
#: Of the slow side: another program must not hold it up while it holds the interpreter's lock.
SLOW_PRIORITY = 40
#: How soon a thread that waits for the interpreter asks for it [s].
SWITCH_INTERVAL = 5e-5
_MCL_CURRENT_AND_FUTURE = 3
_PR_SET_TIMERSLACK = 29


@dataclass
class Arrangement:
    """What was granted, and what was not.

    Parameters
    ----------
    granted : list of str
        Names of measures that are in force.
    refused : list of str
        Sentences about the others.
    others : frozenset of int
        Processors beside the loop's; empty where it has none to itself.
    """

    granted: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    others: frozenset[int] = frozenset()

    def as_text(self) -> str:
        """One line for metadata."""
        return ", ".join(self.granted) or "default"


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _fifo() -> Callable[[], None]:
    """Real-time class for the calling thread; children do not inherit it."""
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    reset = getattr(os, "SCHED_RESET_ON_FORK", 0)
    os.sched_setscheduler(0, os.SCHED_FIFO | reset, os.sched_param(PRIORITY))
    return lambda: os.sched_setscheduler(0, policy, parameter)


def _core() -> Callable[[], None]:
    """The last allowed processor for the calling thread alone."""
    allowed = os.sched_getaffinity(0)
    if len(allowed) < 2:
        raise OSError(0, "there is only one processor")
    os.sched_setaffinity(0, {max(allowed)})
    return lambda: os.sched_setaffinity(0, allowed)


def _memory() -> Callable[[], None]:
    """Nothing of this process is paged out."""
    libc = _libc()
    if libc.mlockall(_MCL_CURRENT_AND_FUTURE) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

    def undo() -> None:
        libc.munlockall()

    return undo


def _slack() -> Callable[[], None]:
    """Timers of this thread fire at once, not up to 50 us later; needs no privilege."""
    if _libc().prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return lambda: None


#: Measure -> what applies it and returns its undoing, what it needs, what its lack means.
MEASURES: dict[str, tuple[Callable[[], Callable[[], None]], str, str]] = {
    "SCHED_FIFO 80": (_fifo, "root or CAP_SYS_NICE (an rtprio limit)", "other programs delay it"),
    "own core": (_core, "two processors", "it shares a core with the slow side"),
    "locked memory": (_memory, "root or a memlock limit", "a page fault can delay it"),
    "timer slack 1 ns": (_slack, "Linux", "timers fire up to 50 us late"),
}


@contextlib.contextmanager
def arranged(wanted: bool = True) -> Iterator[Arrangement]:
    """Arrange the calling thread for the fast loop; everything is undone at the end.

    The garbage collector is frozen and held back and the interpreter hands over faster in any
    case; `wanted` = False leaves out what concerns the rest of the machine.
    """
    found, undo = Arrangement(), []
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    for name, (apply, needs, else_) in MEASURES.items() if wanted else ():
        try:
            undo.append(apply())
            found.granted.append(name)
        except (OSError, AttributeError) as error:
            why = getattr(error, "strerror", None) or str(error)
            found.refused.append(f"no {name} ({why}; needs {needs}): {else_}")
    if "own core" in found.granted:
        found.others = frozenset(allowed - {max(allowed)})
    interval = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield found
    finally:
        gc.enable()
        gc.unfreeze()
        sys.setswitchinterval(interval)
        for step in reversed(undo):
            step()


def accompany(found: Arrangement) -> None:
    """Arrange the calling thread, the slow side: below the loop on its core, else on the others."""
    if "SCHED_FIFO 80" in found.granted:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(SLOW_PRIORITY))
    elif found.others:
        os.sched_setaffinity(0, found.others)
