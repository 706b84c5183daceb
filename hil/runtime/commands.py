"""The operator's commands: from a line of text on the slow side to a change in one tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from hil.errors import ConfigError, DeviceError, unknown
from hil.signals.device import Controller
from hil.signals.settable import SettableRange, told

#: Words of the command ``record``, and whether rows are written after them.
RECORD_WORDS = {"on": True, "off": False}


class Operated(Protocol):
    """What commands act on: the loop, between two ticks.

    Attributes
    ----------
    reason : int
        Conditions for which the safety paused; 0 where it did not.
    """

    reason: int

    @property
    def powered(self) -> bool:
        """ENABLED or PAUSED."""
        ...

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

    def settable(self) -> Mapping[str, SettableRange]:
        """What may be set of the law, and how far."""
        ...

    def values(self) -> Mapping[str, list[float]]:
        """What may be set of the law, as it is now."""
        ...

    def law(self, changes: Mapping[str, Sequence[float]]) -> Controller:
        """The law with some parameters changed."""
        ...

    def home(self) -> Controller:
        """A law that drives the arms to their home pose and holds them there."""
        ...


@dataclass(frozen=True)
class OperatorCommand:
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


def parse_command(text: str, shop: Workshop) -> OperatorCommand:
    """Command from a line such as ``pause`` or ``set force_scale 0.5``.

    Raises
    ------
    ConfigError
        For an unknown command, parameter, or value.
    """
    words = text.split()
    if not words or words[0] not in OPERATOR_COMMANDS:
        raise ConfigError(unknown("command", words[0] if words else "", OPERATOR_COMMANDS))
    form, build = OPERATOR_COMMANDS[words[0]]
    try:
        return OperatorCommand(" ".join(words), build(words[1:], shop))
    except ConfigError:
        raise
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{' '.join(words)!r}: {error}; usage: {form}") from error


def _bare(words: Sequence[str]) -> None:
    if words:
        raise ValueError(f"{' '.join(words)!r} is one word too many")


def _start(words: Sequence[str], shop: Workshop) -> Callable[[Operated], None]:
    _bare(words)
    try:
        shop.enable()
    except DeviceError as error:
        raise ConfigError(
            f"start: {error} A session that is PAUSED goes on with resume."
        ) from error
    return lambda loop: loop.begin()


def _pause(words: Sequence[str], _: Workshop) -> Callable[[Operated], None]:
    _bare(words)
    return lambda loop: loop.pause()


def _anew(law: Controller) -> Callable[[Operated], None]:
    """Begin with a law where the arms are; only `start` gives power to what has none."""

    def apply(loop: Operated) -> None:
        if loop.powered:
            loop.follow(law, restart=True)
            loop.begin()

    return apply


def _resume(words: Sequence[str], shop: Workshop) -> Callable[[Operated], None]:
    _bare(words)
    return _anew(shop.law({}))


def _stop(words: Sequence[str], _: Workshop) -> Callable[[Operated], None]:
    _bare(words)
    return lambda loop: loop.finish()


def _note(words: Sequence[str], _: Workshop) -> Callable[[Operated], None]:
    """Nothing but an event in the session, as every command is one."""
    if not words:
        raise ValueError("a text is needed")
    return lambda loop: None


def _record(words: Sequence[str], _: Workshop) -> Callable[[Operated], None]:
    """Nothing to the loop: the slow side acts on it, from the tick of its event on."""
    if len(words) != 1 or words[0] not in RECORD_WORDS:
        raise ValueError(f"one of {', '.join(RECORD_WORDS)} is needed")
    return lambda loop: None


def _home(words: Sequence[str], shop: Workshop) -> Callable[[Operated], None]:
    """To the middle posture; out of a pause of the safety only after `resume`."""
    _bare(words)
    begin = _anew(shop.home())
    return lambda loop: None if loop.reason else begin(loop)


def _set(words: Sequence[str], shop: Workshop) -> Callable[[Operated], None]:
    if len(words) < 2:
        raise ValueError("a name and a number are needed")
    name, *values = words
    law = shop.law({name: [_number(v) for v in values]})
    return lambda loop: loop.follow(law, restart=False)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{text!r} is no number") from None


#: name -> usage, and what makes it.
OPERATOR_COMMANDS: dict[
    str, tuple[str, Callable[[Sequence[str], Workshop], Callable[[Operated], None]]]
] = {
    "start": ("start", _start),
    "stop": ("stop", _stop),
    "quit": ("quit", _stop),
    "pause": ("pause", _pause),
    "resume": ("resume", _resume),
    "home": ("home", _home),
    "set": ("set PARAMETER NUMBER...", _set),
    "note": ("note TEXT", _note),
    "record": ("record on|off", _record),
}


def usage_lines(known: Mapping[str, SettableRange]) -> str:
    """All commands, and what may be set, for the operator."""
    usages = ", ".join(text for text, _ in OPERATOR_COMMANDS.values())
    return f"commands: {usages}; to set: {told(known)}"


def rehearse(schedule: Sequence[tuple[float, str]], seconds: float, shop: Workshop) -> None:
    """Make every command of a schedule once, before anything moves.

    Raises
    ------
    ConfigError
        For a command that cannot be made, or that would come after the end of the session.
    """
    for when, text in schedule:
        if not 0.0 <= when <= seconds:
            raise ConfigError(
                f"--at '{when:g} {text}': the session lasts from 0 to {seconds:g} s; take a time "
                "within it, or a longer --seconds"
            )
        try:
            parse_command(text, shop)
        except ConfigError as error:
            raise ConfigError(f"--at '{when:g} {text}': {error}") from error


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
            raise ConfigError(
                f"--at {text!r}: seconds and a command are needed, e.g. '2.5 pause'."
            ) from None
    return sorted(found, key=lambda entry: entry[0])
