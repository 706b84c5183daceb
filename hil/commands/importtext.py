"""What `hil import` prints: JSON, the session and its faults, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hil.errors import plural
from hil.record.checks import Finding, check
from hil.record.tables import Imported


def as_dict(output: Path, found: Imported, model: tuple[Path, bool]) -> dict[str, object]:
    """`hil import --json`; the model with whether it was written now."""
    return {
        "schema": "hil.import/1",
        "session": str(output),
        "model": str(model[0]),
        "model_written": model[1],
        "arms": [
            {"name": r.arm, "joints": list(r.joints), "samples": r.n, "rate_hz": r.rate}
            for r in found.recordings
        ],
        "unused": list(found.unused),
        "warnings": [
            {"code": f.code, "severity": f.severity, "text": f.text}
            for r in found.recordings for f in check(r)
        ],
    }  # fmt: skip


def text(output: Path, found: Imported, model: Path, written: bool) -> str:
    """What was imported, its faults, and what to do next."""
    lines = []
    for r in found.recordings:
        lines.append(
            f"{output}: arm {r.arm}, {plural(r.n, 'sample')} at {r.rate:.5g} Hz, "
            f"{plural(r.d, 'joint')} ({', '.join(r.joints)})"
        )
    if shift := found.recordings[0].metadata.get("time_shift_s"):
        lines.append(f"time begins before 0: shifted by {float(shift):.6g} s")
    if found.unused:
        lines.append(f"not used: {', '.join(found.unused)}")
    lines.append(f"{model}: {'base model written' if written else _kept(model, found)}")
    faults = [f for r in found.recordings for f in check(r)]
    lines += [_fault(f) for f in faults if f.severity != "error"]
    return "\n".join([*lines, *_next(output, model, faults)]) + "\n"


def _kept(model: Path, found: Imported) -> str:
    """What is said of a model that was there already, and whether it is of another robot."""
    beside, urdf = model.with_suffix(".urdf"), found.recordings[0].robot.urdf
    if not urdf or (beside.is_file() and beside.read_text(encoding="utf-8") == urdf):
        return "model kept as it was"
    return (
        f"model kept as it was, of another robot than this session; delete it and {beside.name} "
        "for a new one"
    )


def _next(output: Path, model: Path, faults: list[Finding]) -> list[str]:
    """What to do with the session: look at it and diagnose it, or mend it where it is worthless."""
    errors = [f for f in faults if f.severity == "error"]
    if not errors:
        return ["next:", f"  hil info {output}", f"  hil diagnose {output} --model {model}"]
    return [
        *map(_fault, errors),
        f"{output} is written but cannot be fitted: {plural(len(errors), 'error')}, see above; "
        "mend the table and import it again",
    ]


def _fault(f: Finding) -> str:
    return f"{f.severity} [{f.code}] {f.sentence}"


def every_as_dict(found: Mapping[Path, Imported], model: tuple[Path, bool]) -> dict[str, object]:
    """`hil import --all-runs --json`."""
    sessions = [as_dict(path, one, model) for path, one in found.items()]
    return {"schema": "hil.import-all/1", "sessions": sessions}


def every(folder: Path, found: Mapping[Path, Imported], model: Path, written: bool) -> str:
    """Sessions and data faults of all runs together, and which run to look at first."""
    faults = {p: [f for r in one.recordings for f in check(r)] for p, one in found.items()}
    bad = [p.name for p, some in faults.items() if any(f.severity == "error" for f in some)]
    state = "base model written" if written else "model kept as it was"
    said = (
        f"{folder}: {plural(len(found), 'session')}, "
        f"{plural(sum(map(len, faults.values())), 'data fault')}\n{model}: {state}\n"
        f"next:\n  hil info {folder / (bad[0] if bad else next(iter(found)).name)}"
    )
    return said + (f"\n{len(bad)} of them cannot be fitted: {', '.join(bad)}" if bad else "")
