"""The tables of `hil bench identify`, for the terminal and for a page."""

from __future__ import annotations

import math
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hil.bench.identify import DATA, Report
from hil.commands import common

COMMAND = "hil bench identify"
TITLE = "# Speed of identification and diagnosis"
#: Most that a peer may take, in units of the reference, without and with the missing effect.
GOALS = (
    ("hil.fit", False, 0.8),
    ("hil.fit", True, 0.8),
    ("hil diagnose", False, 6.0),
    ("hil diagnose", True, 15.0),
)
#: Most memory of the longest recording [MiB].
PEAK_MIB = 1024.0


def text(r: Report) -> str:
    """Both tables with what they were measured on."""
    lines = [
        f"3 joints, {r.recorded:g} s at 1 kHz, 42 parameters, on a {machine()}",
        f"processor seconds on one thread, median of {r.repeats} after a warm-up; ratio to the "
        "reference of the same run",
        "",
        _peers(r),
        "",
        "held-out / floor: rms error on the second motion, at 1 kHz, over the effort's noise of "
        "5 mN m;\nof hil diagnose: in its own band, over the floor that it measured itself. The "
        "reference and\nFIGAROH get the exact motion, hil only positions.",
    ]
    if r.lengths:
        lines += [
            "",
            "hil diagnose, one cold run each in a process of its own, as a user runs it",
            "",
            _lengths(r),
        ]
    return "\n".join(lines)


def _peers(r: Report) -> str:
    """Times of all peers on the same data."""
    rows = [
        [
            row.peer, row.data, _number(row.seconds), _number(row.ratio),
            " ".join(f"{x:.3f}" for x in row.floor) or "-", row.note,
        ]
        for row in r.rows
    ]  # fmt: skip
    return common.table(["peer", "data", "seconds", "ratio", "held-out / floor", ""], rows)


def _lengths(r: Report) -> str:
    """Time and memory of the diagnosis over the length of the recording."""
    grown = [
        [
            f"{x.recorded:g}", x.data, f"{x.wall:.2f}", f"{x.seconds:.2f}", f"{x.peak_mib:.0f}",
            f"{1e3 * x.wall / x.recorded:.0f}", x.verdict,
        ]
        for x in r.lengths
    ]  # fmt: skip
    names = [
        "recorded s", "data", "wall s", "processor s", "peak MiB", "wall ms per s", "verdict",
    ]  # fmt: skip
    return common.table(names, grown)


def _number(x: float) -> str:
    return "-" if math.isnan(x) else f"{x:.2f}"


def data(r: Report) -> dict[str, Any]:
    """The same as JSON; what did not run is null."""
    rows: list[dict[str, Any]] = [asdict(row) for row in r.rows]
    for row in rows:
        for key in ("seconds", "wall", "ratio"):
            row[key] = None if math.isnan(row[key]) else row[key]
    return {
        "machine": machine(), "recorded_s": r.recorded, "repeats": r.repeats, "rows": rows,
        "lengths": [asdict(x) for x in r.lengths],
    }  # fmt: skip


def machine() -> str:
    """Class of this machine, without its name."""
    info = Path("/proc/cpuinfo")
    guest = info.exists() and " hypervisor" in info.read_text(encoding="utf-8")
    return f"{os.cpu_count()}-core {'virtual ' if guest else ''}machine"


def page(r: Report) -> str:
    """Markdown page with the printed result."""
    return (
        f"{TITLE}\n\n"
        f"Printed by `{COMMAND} --figaroh PYTHON --report docs/bench/identify.md`, where\n"
        "PYTHON is an interpreter that has `figaroh` (the extra `bench`). It measures speed: the\n"
        "data come from the same rigid-body equations that are fitted.\n\n"
        f"```\n{text(r)}\n```\n\n"
        f"{goals(r)}\n"
    )


def goals(r: Report) -> str:
    """Which goals hold in this run, a line each."""
    ratios = {(row.peer, row.data): row.ratio for row in r.rows}
    found = [
        (f"{peer}, {DATA[missing]}", ratios.get((peer, DATA[missing]), float("nan")), most)
        for peer, missing, most in GOALS
    ]
    rows = [
        f"- {what}: {ratio:.2f} times the reference, goal {most:g}" for what, ratio, most in found
    ]
    met = [ratio <= most for _, ratio, most in found]
    if r.lengths:
        longest = max(r.lengths, key=lambda x: (x.recorded, x.peak_mib))
        rows.append(f"- {longest.recorded:g} s: {longest.peak_mib:.0f} MiB, goal {PEAK_MIB:g}")
        met.append(longest.peak_mib <= PEAK_MIB)
    said = (f"{row}: {'met' if ok else 'missed'}" for row, ok in zip(rows, met, strict=True))
    return "Goals:\n\n" + "\n".join(said)


def is_page(path: Path) -> bool:
    """Whether a file is such a page, or empty."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False
    return not text.strip() or text.startswith(TITLE)
