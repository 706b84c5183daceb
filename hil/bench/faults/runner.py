"""Run a fault in a lockstep session, and judge what its record says."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.faults.cases import Fault
from hil.bench.faults.tamper import Tampered
from hil.errors import HilError
from hil.record.container import read
from hil.record.decode import decode_numbers
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.runtime.conditions import BITS, named
from hil.runtime.frame import TIMING, WORDS
from hil.signals.state import OperatingState

#: After the strike [s].
SECONDS = 0.6
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
    loop = {"seconds": fault.at * 1e-3 + SECONDS, **fault.over.get("loop", {})}
    over: dict[str, Any] = {**fault.over, "loop": loop}
    if fault.wire:
        over["backend"] = "sim-wire"
    tampered = Tampered(fault.strike, fault.at, fault.steered)
    config = load_rig(rig_path(fault.rig), over)
    # a run that wrote nothing must not be judged by the one before
    path.unlink(missing_ok=True)
    try:
        runner.run(config, None, 1, "lockstep", path, opener=tampered.open, timer=tampered.timer)
    except (HilError, ZeroDivisionError):
        pass  # the record, which `judge` needs, tells how it ended
    return judge(fault, tampered.struck, path)


def judge(fault: Fault, struck: int, path: Path) -> Outcome:
    """What the session says, against what was expected."""
    box = read(path)
    topic = box.topics["/loop/timing"]
    ticks = np.array(topic.sequence)
    timing = decode_numbers(topic)
    raw = decode_numbers(box.topics["/rig/raw"]).reshape(len(ticks), -1, WORDS)
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
        found == fault.state and (taken is None or taken <= fault.within) and zero
        and (not fault.condition or fault.condition in said) and last["name"] == fault.ends
        and np.all(np.diff(topic.times) > 0) and not box.truncated
        and (not fault.condition or fault.condition in BITS)
    )  # fmt: skip
    return Outcome(
        fault.name, fault.state, found, taken, said, zero, last["name"], lost, right, fault.note
    )
