"""The campaign as one table."""

from __future__ import annotations

from collections.abc import Sequence

from hil.bench.faults.runner import Outcome

HEAD = ("fault", "must lead to", "led to", "after", "record says", "motors", "rows lost", "")


def row(o: Outcome) -> list[str]:
    """One line."""
    taken = "-" if o.ticks is None else f"{o.ticks} ms"
    said = ", ".join(o.conditions) or "-"
    note = f"; {o.note}" if o.note else ""
    verdict = "as expected" if o.right else "WRONG"
    return [
        o.name, o.expected, o.state, taken, said + note, "zero" if o.zero else "NOT ZERO",
        str(o.lost), verdict,
    ]  # fmt: skip


def verdict(outcomes: Sequence[Outcome]) -> str:
    """Sentence over all."""
    right = sum(o.right for o in outcomes)
    soon = [o.ticks for o in outcomes if o.ticks is not None and o.state in ("PAUSED", "FAULT")]
    two = sum(t <= 2 for t in soon)
    later = [f"{o.name} ({o.ticks})" for o in outcomes if o.state in ("PAUSED", "FAULT")
             and o.ticks is not None and o.ticks > 2]  # fmt: skip
    return (
        f"{right} of {len(outcomes)} faults lead to the expected state; of {len(soon)} that stop "
        f"the motors in lockstep {two} do so within two ticks of the strike"
        + (f"; later, in ticks: {', '.join(later)}." if later else ".")
    )


def report(outcomes: Sequence[Outcome], command: str) -> str:
    """Page for the documentation."""
    lines = [
        "# Injected faults", "",
        f"Printed by `{command}`.  Every fault strikes a session with torque on the motors; state,",
        "time and conditions are read from the session that it leaves.  One tick is 1 ms; the tick",
        "of the strike counts.  `ENABLED`: the loop must go on.  `motors`: every DAC code in the",
        "record from that state on; for faults of the process, the codes and the power that its",
        "devices had when it was gone, or the watchdog that cut it (time since the last tick).",
        "The faults of encoders, law and clock strike ideal wires, those of boxes and boards",
        "simulated USB, HID and CAN, through the drivers.", "",
        "| " + " | ".join(HEAD) + " |", "|" + "---|" * len(HEAD),
        *("| " + " | ".join(row(o)) + " |" for o in outcomes), "", verdict(outcomes), "",
    ]  # fmt: skip
    return "\n".join(lines)
