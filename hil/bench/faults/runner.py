"""Run faults in lockstep sessions, judge what their records say, show the campaign as a table."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.faults.cases import Fault
from hil.bench.faults.fault_injection import FaultySession
from hil.errors import HilError
from hil.record.container import read
from hil.record.decode import decode_numbers
from hil.rig.config import load_rig
from hil.rig.safety import BITS, named
from hil.rigs import rig_path
from hil.runtime import runner
from hil.signals.frame import TIMING, FrameLayout
from hil.signals.state import OperatingState

#: After the strike [s].
_SECONDS = 0.6
_AT = {name: k for k, name in enumerate(TIMING)}


@dataclass(frozen=True)
class Outcome:
    """What a fault led to, read from the session.

    Parameters
    ----------
    name, expected, state : str
        The fault, the state that should follow, and the state that did.
    ticks : int or None
        From the strike to that state, the tick of the strike included; None where it goes on.
    conditions : list of str
        What the record names from the strike on.
    zero : bool
        All DAC codes were zero from that state on.
    ended : str
        Last event of the session.
    lost : int
        Rows missing in the record.
    right : bool
        All as expected.
    note : str
        For the reader.
    """

    name: str
    expected: str
    state: str
    ticks: int | None
    conditions: list[str]
    zero: bool
    ended: str
    lost: int
    right: bool
    note: str = ""


def run(
    faults: Iterable[Fault], folder: Path, report: Callable[[Outcome], None] = lambda o: None
) -> list[Outcome]:
    """Run faults one after the other; sessions are written into `folder`."""
    done = []
    for fault in faults:
        done.append(one(fault, folder / "fault.mcap"))
        report(done[-1])
    return done


def one(fault: Fault, path: Path) -> Outcome:
    """Run one fault."""
    loop = {"seconds": fault.at * 1e-3 + _SECONDS, **fault.over.get("loop", {})}
    over: dict[str, Any] = {**fault.over, "loop": loop}
    if fault.wire:
        over["backend"] = "sim-wire"
    faulty = FaultySession(fault.strike, fault.at, fault.steered)
    config = load_rig(rig_path(fault.rig), over)
    # a run that wrote nothing must not be judged by the one before
    path.unlink(missing_ok=True)
    try:
        runner.run(config, None, 1, "lockstep", path, opener=faulty.open, timer=faulty.timer)
    except (HilError, ZeroDivisionError):
        pass  # the record, which `judge` needs, tells how it ended
    return judge(fault, faulty.struck, path)


def judge(fault: Fault, struck: int, path: Path) -> Outcome:
    """What the session says, against what was expected."""
    box = read(path)
    topic = box.topics["/loop/timing"]
    ticks = np.array(topic.sequence)
    timing = decode_numbers(topic)
    raw = decode_numbers(box.topics["/rig/raw"]).reshape(len(ticks), -1, FrameLayout(1, 0).words)
    state, mask = timing[:, _AT["state"]].astype(int), timing[:, _AT["conditions"]].astype(int)
    after = ticks >= struck
    changed = np.flatnonzero(after & (state != OperatingState.ENABLED))
    first = int(changed[0]) if changed.size else None
    found = "ENABLED" if first is None else OperatingState(state[first]).name
    taken = None if first is None else int(after[: first + 1].sum())
    said = [c.name for c in named(int(np.bitwise_or.reduce(mask[after], initial=0)))]
    codes = raw[:, :, 3:6]
    zero = first is None or not codes[first:].any()
    last = json.loads(box.topics["/events"].data[-1])
    lost = int(timing[-1, _AT["dropped"]])
    right = bool(
        found == fault.state
        and (taken is None or taken <= fault.within)
        and zero
        and (not fault.condition or fault.condition in said)
        and last["name"] == fault.ends
        and np.all(np.diff(topic.times) > 0)
        and not box.truncated
        and (not fault.condition or fault.condition in BITS)
    )
    return Outcome(
        fault.name, fault.state, found, taken, said, zero, last["name"], lost, right, fault.note
    )


HEAD = ("fault", "must lead to", "led to", "after", "record says", "motors", "rows lost", "")


def row(o: Outcome) -> list[str]:
    """One line."""
    taken = "-" if o.ticks is None else f"{o.ticks} ms"
    said = ", ".join(o.conditions) or "-"
    note = f"; {o.note}" if o.note else ""
    verdict = "as expected" if o.right else "WRONG"
    return [
        o.name,
        o.expected,
        o.state,
        taken,
        said + note,
        "zero" if o.zero else "NOT ZERO",
        str(o.lost),
        verdict,
    ]


def verdict(outcomes: Sequence[Outcome]) -> str:
    """Sentence over all."""
    right = sum(o.right for o in outcomes)
    soon = [o.ticks for o in outcomes if o.ticks is not None and o.state in ("PAUSED", "FAULT")]
    two = sum(t <= 2 for t in soon)
    later = [
        f"{o.name} ({o.ticks})"
        for o in outcomes
        if o.state in ("PAUSED", "FAULT") and o.ticks is not None and o.ticks > 2
    ]
    return (
        f"{right} of {len(outcomes)} faults lead to the expected state; of {len(soon)} that stop "
        f"the motors in lockstep {two} do so within two ticks of the strike"
        + (f"; later, in ticks: {', '.join(later)}." if later else ".")
    )


def report(outcomes: Sequence[Outcome], command: str) -> str:
    """Page for the documentation."""
    lines = [
        "# Injected faults",
        "",
        f"Printed by `{command}`.  Every fault strikes a session with torque on the motors; state,",
        "time and conditions are read from the session that it leaves.  One tick is 1 ms; the tick",
        "of the strike counts.  `ENABLED`: the loop must go on.  `motors`: every DAC code in the",
        "record from that state on; for faults of the process, the codes and the power that its",
        "devices had when it was gone, or the watchdog that cut it (time since the last tick).",
        "The faults of encoders, law and clock strike ideal wires, those of boxes and boards",
        "simulated USB, HID and CAN, through the drivers.",
        "",
        "| " + " | ".join(HEAD) + " |",
        "|" + "---|" * len(HEAD),
        *("| " + " | ".join(row(o)) + " |" for o in outcomes),
        "",
        verdict(outcomes),
        "",
    ]
    return "\n".join(lines)
