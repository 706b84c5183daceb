"""Where counts were lost: instants and sizes, said beside the name."""

from __future__ import annotations

from hil.compare.findings import Finding
from hil.record.jumps import described
from hil.record.recording import Recording


def lost_counts(
    findings: list[Finding], recordings: list[Recording], said: list[tuple[str, str]]
) -> list[tuple[str, str]]:
    """Instants and sizes of jumps that are named, unless the checks of the recording gave them."""
    out = []
    for f in findings:
        if f.effect != "missed-counts" or f.joint is None:
            continue
        for r in recordings:
            j = r.joints.index(f.joint)
            lost = r.jumps[j]
            text = f"{f.joint}: q{j + 1} {described(r.t, lost)}"
            if lost.at.size and ("step", text) not in said:
                out.append(("step", text if len(recordings) == 1 else f"{r.name}, {text}"))
    return out
