"""What a driver needs of a bus: a library's own back end or a simulated one, time, and a pump."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

#: One step of background work; returns how long to wait before the next [s].  Never raises.
BackgroundStep = Callable[[], float]


def threaded(name: str, step: BackgroundStep) -> Callable[[], None]:
    """Call `step` again and again in a thread of its own; returns what stops it."""
    done = threading.Event()

    def work() -> None:
        while not done.is_set():
            delay = step()
            if delay > 0.0:
                done.wait(delay)

    thread = threading.Thread(target=work, name=name, daemon=True)
    thread.start()

    def stop() -> None:
        done.set()
        thread.join(2.0)

    return stop


class FrameLog(Protocol):
    """Takes the frames of a bus (`hil.record.frames.BoundedFrameLog`)."""

    def add(self, kind: str, key: str, data: bytes) -> None:
        """A frame went over the bus; `kind` is ``tx`` or ``rx``."""
        ...


class RecordedFrame(Protocol):
    """A frame of a recording."""

    @property
    def key(self) -> str:
        """What tells frames of one bus apart."""
        ...

    @property
    def data(self) -> bytes:
        """Payload."""
        ...


class Replay(Protocol):
    """Answers for a device (`hil.record.frames.RecordedAnswers`)."""

    def put(self, key: str, data: bytes) -> None:
        """The driver sends a frame."""
        ...

    def take(self, wait: bool, name: str = "") -> RecordedFrame | None:
        """Next answer of a stream that is due; with `wait`, that comes next at all."""
        ...

    def take_any(self) -> RecordedFrame | None:
        """Next answer of whatever stream that is due."""
        ...


@dataclass(frozen=True)
class Attached:
    """What a driver sees on its bus, before anything is opened.

    Parameters
    ----------
    address : str
        What to write into the rig file; empty where it may not be read.
    what : str
        What it is, or why it cannot be used and what to do.
    usable : bool
        Whether it can be opened.
    """

    address: str
    what: str
    usable: bool = True


@dataclass(frozen=True)
class Bus:
    """A bus as a driver sees it; the defaults are the hardware's.

    Parameters
    ----------
    kind : str
        ``"usb"``, ``"hid"``, ``"can"``, ``"udp"`` or ``"ws"``.
    handle : object
        usb: back end for `usb.core.find`, None for libusb.  hid: what stands for the module
        ``hid``.  can: in a simulation, python-can's interface and what stands before the name of
        a channel.  udp, ws: what opens a socket.
    run : callable
        ``run(name, step)`` calls `step` as often as data may come and returns what stops it: a
        thread, or in virtual time once a tick.
    pause : callable
        Wait so many seconds; for opening and closing, never in the fast path.
    now_ns : callable
        Time [ns].
    advance : callable
        ``advance(t_ns)`` lets a simulated world run to the time of the loop; nothing otherwise.
    simulated : bool
        Whether the far end is simulated.
    log : FrameLog, optional
        Where the driver's link notes every frame.
    replay : Replay, optional
        A recording that answers in place of a device.
    """

    kind: str
    handle: Any = None
    run: Callable[[str, BackgroundStep], Callable[[], None]] = threaded
    pause: Callable[[float], None] = time.sleep
    now_ns: Callable[[], int] = time.monotonic_ns
    advance: Callable[[int], None] = lambda t_ns: None
    simulated: bool = False
    log: FrameLog | None = None
    replay: Replay | None = None
