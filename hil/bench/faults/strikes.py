"""What can be done to a session: each makes, or is, the strike of a fault."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hil.bench.faults.tamper import Tampered


def hook(name: str, make: Callable[[], Any]) -> Callable[[Tampered], None]:
    """Set a hook of the session."""
    return lambda t: setattr(t, name, make())


def counts(change: Callable[[Any], None]) -> Callable[[Tampered], None]:
    """Change the counts (arms, 3) after every tick of the simulation from now on."""
    return hook("words", lambda: lambda counts, gauges: change(counts))


def gauges(change: Callable[[Any], None]) -> Callable[[Tampered], None]:
    """Change the gauge words (arms, 6) after every tick of the simulation from now on."""
    return hook("words", lambda: lambda counts, gauges: change(gauges))


def add(row: int, column: int, value: int) -> Callable[[Any], None]:
    """Add to one word."""

    def change(words: Any) -> None:
        words[row, column] += value

    return change


def put(row: int, column: int | slice, value: int) -> Callable[[Any], None]:
    """Write over words of one arm."""

    def change(words: Any) -> None:
        words[row, column] = value

    return change


def shake(words: Any) -> None:
    """Move the counts of the first arm to and fro."""
    words[0] += np.array([60, -60, 60]) * (1 if words[0, 0] % 2 else -1)


def failing(t: Tampered) -> None:
    """The law raises an exception."""

    def broken(y: Any) -> None:
        raise ZeroDivisionError("the law divides by zero")

    t.law = broken


def late_every_tick(t: Tampered) -> None:
    """The law takes longer than a period, in every tick."""

    def slow(y: Any) -> None:
        t.skip = 1

    t.law = slow


def box(name: str, **attributes: Any) -> Callable[[Tampered], None]:
    """Set attributes of a simulated box, or of its faults (``faults.mute``)."""

    def strike(t: Tampered) -> None:
        for key, value in attributes.items():
            target = t.rig.bench.wired.boxes[name]
            if not hasattr(target, key):
                target = target.faults
            setattr(target, key, value)

    return strike


def replugged(t: Tampered) -> None:
    """Unplug the encoder box for 50 ticks."""
    encoders = t.rig.bench.wired.boxes["encoders"]
    encoders.plugged = False
    t.words = lambda counts, gauges: setattr(encoders, "plugged", t.tick > t.struck + 50)


def turn(**clocks: int) -> Callable[[Tampered], None]:
    """Add to what the machine's clocks show [ns]."""

    def strike(t: Tampered) -> None:
        for name, by in clocks.items():
            setattr(t.sources, name, getattr(t.sources, name) + by)

    return strike


def nothing(t: Tampered) -> None:
    """What goes wrong is in the rig file."""
