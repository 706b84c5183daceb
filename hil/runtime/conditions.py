"""What may be wrong in a tick, and what the loop does about it: one table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Reaction(IntEnum):
    """What a condition leads to, in the tick in which it is seen."""

    NOTE = 0
    PAUSE = 1
    FAULT = 2


@dataclass(frozen=True)
class Condition:
    """One row.

    Parameters
    ----------
    name : str
        As in events and tables.
    reaction : Reaction
        NOTE: recorded; PAUSE: motors zero until the operator resumes; FAULT: latched.
    text : str
        Sentence for the operator.
    """

    name: str
    reaction: Reaction
    text: str


_R = Reaction
#: Bit k of the recorded mask is row k; new rows come last, old sessions keep their meaning.
TABLE: tuple[Condition, ...] = (
    Condition("effort-limited", _R.NOTE, "the law asked for more than the torque limit"),
    Condition("force-yellow", _R.NOTE, "the force at the tip is high"),
    Condition("winding-yellow", _R.NOTE, "a motor is warm"),
    Condition("sensor-late", _R.NOTE, "a sensor repeated its last good value once"),
    Condition("joint-stale", _R.PAUSE, "the encoders repeat their last good value"),
    Condition("force-stale", _R.PAUSE, "the force sensor repeats its last good value"),
    Condition("force-saturated", _R.PAUSE, "the force sensor is at the end of its range"),
    Condition("force-red", _R.PAUSE, "the force at the tip is above its limit"),
    Condition("winding-red", _R.PAUSE, "a motor winding is too hot"),
    Condition("position", _R.PAUSE, "a joint is outside of its range"),
    Condition("workspace", _R.PAUSE, "the tip is outside of the workspace"),
    Condition("overrun", _R.PAUSE, "the loop missed too many periods"),
    Condition("overspeed", _R.FAULT, "a joint passed its speed_limit"),
    Condition("encoder-jump", _R.FAULT, "an encoder moved as no joint can"),
    Condition("encoder-stuck", _R.FAULT, "an encoder stands still under torque"),
    Condition("joint-lost", _R.FAULT, "the encoders do not answer"),
    Condition("force-lost", _R.FAULT, "the force sensor does not answer"),
    Condition("not-a-number", _R.FAULT, "a measured value is not a number"),
    Condition("effort-invalid", _R.FAULT, "an effort of the law was not a number"),
    Condition("motor-refused", _R.FAULT, "the motor driver refused a command"),
)
BITS: dict[str, int] = {c.name: 1 << k for k, c in enumerate(TABLE)}


def _mask(reaction: Reaction) -> int:
    return sum(BITS[c.name] for c in TABLE if c.reaction is reaction)


PAUSING, FAULTING = _mask(Reaction.PAUSE), _mask(Reaction.FAULT)


def named(mask: int) -> list[Condition]:
    """Conditions of a recorded mask, the worst first."""
    found = [c for k, c in enumerate(TABLE) if mask >> k & 1]
    return sorted(found, key=lambda c: -c.reaction)


def sentence(mask: int) -> str:
    """What a mask means, in words, the worst first."""
    return "; ".join(c.text for c in named(mask)) or "nothing is wrong"
