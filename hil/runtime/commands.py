"""The operator's commands: from a line of text on the slow side to a change in one tick."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from hil.errors import ConfigError, unknown
from hil.signals.device import Controller


class Operated(Protocol):
    """What commands act on: the loop, between two ticks."""

    def begin(self) -> None:
        """To ENABLED."""
        ...

    def pause(self) -> None:
        """To PAUSED."""
        ...

    def finish(self) -> None:
        """End the session."""
        ...

    def follow(self, controller: Controller, restart: bool) -> None:
        """Take another law."""
        ...


class Workshop(Protocol):
    """Makes what a command needs, on the slow side, where it may take its time."""

    def enable(self) -> None:
        """Enable the devices."""
        ...

    def law(self, changes: dict[str, float]) -> Controller:
        """The law with some parameters changed."""
        ...

    def home(self) -> Controller:
        """A law that drives the arms to their home pose and holds them there."""
        ...


@dataclass(frozen=True)
class Command:
    """One command, ready to be applied between two ticks.

    Parameters
    ----------
    text : str
        As the operator said it.
    apply : callable
        What it does to the loop.
    """

    text: str
    apply: Callable[[Operated], None]


def parse(text: str, shop: Workshop) -> Command:
    """Command from a line such as ``pause`` or ``set force_scale 0.5``.

    Raises
    ------
    ConfigError
        For an unknown command, parameter, or value.
    """
    words = text.split()
    if not words or words[0] not in COMMANDS:
        raise ConfigError(unknown("command", words[0] if words else "", COMMANDS))
    usage, build = COMMANDS[words[0]]
    try:
        return Command(" ".join(words), build(words[1:], shop))
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{text!r}: {error}; usage: {usage}") from error


def _bare(words: Sequence[str]) -> None:
    if words:
        raise ValueError(f"{' '.join(words)!r} is one word too many")


def _start(words: Sequence[str], shop: Workshop) -> Callable[[Operated], None]:
    _bare(words)
    shop.enable()
    return lambda loop: loop.begin()


def _pause(words: Sequence[str], _: Workshop) -> Callable[[Operated], None]:
    _bare(words)
    return lambda loop: loop.pause()


def _resume(words: Sequence[str], shop: Workshop) -> Callable[[Operated], None]:
    _bare(words)
    law = shop.law({})

    def apply(loop: Operated) -> None:
        loop.follow(law, restart=True)
        loop.begin()

    return apply


def _stop(words: Sequence[str], _: Workshop) -> Callable[[Operated], None]:
    _bare(words)
    return lambda loop: loop.finish()


def _home(words: Sequence[str], shop: Workshop) -> Callable[[Operated], None]:
    _bare(words)
    law = shop.home()

    def apply(loop: Operated) -> None:
        loop.follow(law, restart=True)
        loop.begin()

    return apply


def _set(words: Sequence[str], shop: Workshop) -> Callable[[Operated], None]:
    if len(words) != 2:
        raise ValueError("one name and one number are needed")
    name, value = words
    law = shop.law({name: float(value)})
    return lambda loop: loop.follow(law, restart=False)


#: name -> usage, and what makes it.
COMMANDS: dict[str, tuple[str, Callable[[Sequence[str], Workshop], Callable[[Operated], None]]]] = {
    "start": ("start", _start),
    "stop": ("stop", _stop),
    "pause": ("pause", _pause),
    "resume": ("resume", _resume),
    "home": ("home", _home),
    "set": ("set PARAMETER NUMBER", _set),
}


def scheduled(texts: Sequence[str]) -> list[tuple[float, str]]:
    """Commands of ``--at "SECONDS COMMAND"``, in the order of their times.

    Raises
    ------
    ConfigError
        Where a time is missing.
    """
    found = []
    for text in texts:
        when, _, what = text.strip().partition(" ")
        try:
            found.append((float(when), what))
        except ValueError:
            raise ConfigError(f"--at {text!r}: seconds and a command are needed, e.g. '2.5 pause'."
                              ) from None  # fmt: skip
        if what.split()[:1] and what.split()[0] not in COMMANDS:
            raise ConfigError(f"--at {text!r}: {unknown('command', what.split()[0], COMMANDS)}")
    return sorted(found, key=lambda entry: entry[0])
