"""Who runs a session, and what it turned out to be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from hil.errors import DataError
from hil.record import mcap_read


@dataclass
class Operator:
    """Who watches and commands a session.

    Parameters
    ----------
    schedule : sequence of (float, str)
        Commands and their times [s].
    say : callable
        Takes sentences.
    live : callable or None
        Takes a line of figures a few times a second.
    lines : callable or None
        Called with a function that takes the operator's lines, once the loop is ready.
    wait : bool
        The session begins DISABLED and waits for ``start``.
    """

    schedule: Sequence[tuple[float, str]] = ()
    say: Callable[[str], None] = lambda text: None
    live: Callable[[str], None] | None = None
    lines: Callable[[Callable[[str], None]], None] | None = None
    wait: bool = False


@dataclass(frozen=True)
class Summary:
    """What a session turned out to be.

    Parameters
    ----------
    path : str
        Session file.
    clock : str
        ``"lockstep"`` or ``"real"``.
    seed : int
        Of the noise, and of what the rig file leaves open.
    ticks, missed, dropped, limited : int
        Ticks run, periods skipped, rows lost, ticks with a limited command.
    seconds, wall_seconds : float
        Length of the session, and how long it took [s].
    longest_tick_us : float
        Longest time from wake-up to the last command [us]; 0 in virtual time.
    state, reason : str
        Operating state before the end, and the conditions that led to it.
    unwritten : int
        Rows that the loop gave but the disk did not take.
    figures : dict
        `hil.runtime.statistics.Figures`.
    granted, refused : list of str
        What the operating system did for the loop, and sentences about what it did not.
    """

    path: str
    clock: str
    seed: int
    ticks: int
    missed: int
    dropped: int
    limited: int
    seconds: float
    wall_seconds: float
    longest_tick_us: float
    state: str = "ENABLED"
    reason: str = ""
    unwritten: int = 0
    figures: dict[str, float] = field(default_factory=dict)
    granted: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, object]:
        """Plain dictionary for JSON."""
        return {"schema": "hil.run/1", **asdict(self)}


def cut_short(output: Path, error: OSError, lost: int) -> str:
    """What is left of a session that could not be written on."""
    try:
        longest = max(
            (c.last_s for c in mcap_read.summary(output).channels if c.count), default=0.0
        )
    except DataError:
        longest = 0.0
    kept = (
        f"the first {longest:.3g} s are kept; once there is room, 'hil info {output} --recover "
        "NEW.mcap' writes them as a proper session"
        if longest
        else "nothing of it was kept; make room and run it again"
    )
    return (
        f"session {output} was cut short while the loop went on to its end, {lost} rows are lost, "
        f"the arms are released: {error.strerror or error}; {kept}"
    )
