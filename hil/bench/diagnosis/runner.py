"""All cases in several processes: record, diagnose, compare what was said with what was hidden.

Results are written line by line, so that a run can be resumed.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.diagnosis import amplitudes, cases, session
from hil.bench.diagnosis.cases import HiddenEffect, SessionCase, suspected
from hil.bench.diagnosis.tables import accepted
from hil.diagnosis.engine import diagnose
from hil.diagnosis.types import Diagnosis
from hil.errors import ConfigError, DataError, DeviceError
from hil.experiments.parallel_runs import LostRun, Where, counted, spread
from hil.record.recording import Recording

#: Between the seeds of two runs of one motion: no noise comes twice.
_OTHER_NOISE = 5000


def recordings(case: SessionCase) -> tuple[list[Recording], list[Recording]]:
    """Runs to fit and a held-out run on another motion, with another noise."""
    rows = [
        (
            h.effect,
            h.joint,
            amplitudes.amplitude(h.effect, h.joint, case.robot, case.excitation, h.level),
        )
        for h in case.hidden
    ]
    runs = [_record(case, rows, k) for k in (0, 1)]
    if any(session.kinds_of_plant(case.plant)[h.effect][0] == "runs" for h in case.hidden):
        return [_record(case, [], 0, _OTHER_NOISE), runs[0]], runs[1:]
    return runs[:1], runs[1:]


def _record(case: SessionCase, rows: list[session.HiddenRow], k: int, noise: int = 0) -> Recording:
    motion = (case.excitation, 2 * case.seed + k)
    seed = 2 * case.seed + k + noise
    return session.record_case(case.robot, rows, case.noise, motion, seed, case.force)


def judged_row(case: SessionCase) -> dict[str, Any]:
    """Row of the results: the case, what was said, the outcome, the times."""
    began = time.process_time()
    train, other = recordings(case)
    simulated = time.process_time()
    row = told(case)
    if case.plant == "test":
        row["lost"] = session.lost_share(2 * case.seed)
    if not all(session.sane(r) for r in (*train, *other)):
        return row | {"outcome": "unstable", "named": [], "verdict": ""}
    motion = (case.excitation, 2 * case.seed)
    model = suspected(case, train[0].robot)
    row["excess"] = amplitudes.excess(
        train,
        case.robot,
        case.noise,
        motion,
        motion[1],
        case.force,
        "torque-offset" in model.names(),
    )
    started = time.process_time()
    row |= diagnosed_answer(case, train, other)
    if row["outcome"] != "crashed":
        row["cpu"] = [round(simulated - began, 3), round(time.process_time() - started, 3)]
    return row


def told(case: SessionCase) -> dict[str, Any]:
    """What a row says of its case."""
    return {
        "case": case.name,
        "plant": case.plant,
        "kind": case.kind,
        "robot": case.robot,
        "noise": case.noise,
        "excitation": case.excitation,
        "seed": case.seed,
        "force": case.force,
        "hidden": [[h.effect, h.label, h.level] for h in case.hidden],
    }


def diagnosed_answer(
    case: SessionCase, train: list[Recording], other: list[Recording]
) -> dict[str, Any]:
    """What a diagnosis of a case's sessions said, with its outcome."""
    try:
        row = said(diagnose(train, suspected(case, train[0].robot), other))
    except Exception as error:  # a crash of the diagnosis is a result, with its case
        return {"outcome": "crashed", "named": [], "verdict": repr(error)}
    return row | {"outcome": outcome(case, row)}


def said(d: Diagnosis) -> dict[str, Any]:
    """What a diagnosis said, in plain types."""
    steps = [float(np.max(s.heldout.rms / d.noise)) for s in d.ladder] or [0.0]
    return {
        "verdict": d.verdict,
        "named": [
            {
                "effect": f.effect,
                "joint": f.joint,
                "confidence": f.confidence,
                "share": round(f.excess_explained, 3),
                "rivals": f.rivals,
            }
            for f in d.findings
        ],
        # for a calibration without another run: the first candidates, as (effect, joint, chi2, dof)
        "candidates": [
            [c.name, c.term.joint + 1, round(c.chi2, 1), c.dof] for c in d.first.candidates[:8]
        ],
        "partial": [[f.effect, f.joint] for f in d.partial],
        # rules that stopped something, and those that no other rule would have stood in for
        "fired": sorted(d.fired),
        "alone": sorted(k for k, sole in d.fired.items() if sole),
        "before": round(steps[0], 3),
        "after": round(steps[-1], 3),
    }


def _hit(finding: dict[str, Any], hidden: HiddenEffect) -> bool:
    """Whether a finding is this hidden effect, on its joint where it has one."""
    joint = finding["joint"]
    return finding["effect"] in accepted(hidden.effect) and joint in (None, hidden.label)


def outcome(case: SessionCase, row: dict[str, Any]) -> str:
    """One word for a case.

    ``right``: exactly what is hidden (rightly nothing); ``extra``: that and something else;
    ``ambiguous``: a set with the truth in it; ``one`` of two found; ``missed``: adequate;
    ``unexplained``; ``wrong``: another name, or a name where there is none.
    """
    named, verdict = row["named"], row["verdict"]
    if not named:
        if case.kind == "none":
            return "right" if verdict == "adequate" else str(verdict)
        if case.kind == "outside":
            return "right"
        return "missed" if verdict == "adequate" else str(verdict)
    if case.kind in ("none", "outside"):
        return "wrong"
    found = [h for h in case.hidden if any(_hit(f, h) for f in named)]
    if len(found) == len(case.hidden):
        if verdict == "ambiguous":
            return "ambiguous"
        return "right" if len(named) == len(found) else "extra"
    rivals = {r for f in named for r in f["rivals"]} | {f["effect"] for f in named}
    if verdict == "ambiguous" and all(accepted(h.effect) & rivals for h in case.hidden):
        return "ambiguous"
    return "one" if found else "wrong"


CaseRow = dict[str, Any]


def read(path: Path) -> list[CaseRow]:
    """Rows of an earlier run; a last line that a killed run left half is passed over."""
    if not path.is_file():
        return []
    lines = path.read_text(encoding="utf-8").splitlines()
    rows = []
    for k, line in enumerate(lines):
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError as error:
            if k + 1 < len(lines):
                raise DataError(f"{path}, line {k + 1}: not a result of this benchmark") from error
    return rows


def resumed(name: str) -> Path | None:
    """File of what was done before, as --resume names it; none without.

    Raises
    ------
    ConfigError
        If its name is not that of such a file.
    """
    kept = Path(name) if name else None
    if kept and kept.suffix != ".jsonl":
        raise ConfigError(f"--resume {kept}: a file that ends in .jsonl is needed")
    return kept


def append(path: Path, row: CaseRow) -> None:
    """Add a row to a file; half a line that a killed run left there is taken out first."""
    if path.is_file() and not path.read_bytes().endswith(b"\n"):
        path.write_text("".join(json.dumps(r) + "\n" for r in read(path)), encoding="utf-8")
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def run_cases(
    todo: Sequence[Any],
    where: Where,
    path: Path | None,
    work: Callable[[Any], CaseRow] = judged_row,
    key: str = "case",
) -> list[CaseRow]:
    """Rows of `todo`, those in `path` not done again; new ones are appended to it.

    Parameters
    ----------
    todo : sequence
        Cases, or other things with a name.
    where : Where
        Who computes.
    path : Path or None
        File of the rows.
    work : callable
        Makes the row of one of them.
    key : str
        Where a row has the name.
    """
    done = {r[key]: r for r in (read(path) if path else [])}
    left = [c for c in todo if c.name not in done]
    made_by = revision()
    for thing, made in results(work, left, where, "session"):
        # a lost process is a crash of the diagnosis: a result, with its case
        row = made if not isinstance(made, LostRun) else _lost(thing, key, made)
        row["revision"] = made_by
        done[row[key]] = row
        if path:
            append(path, row)
    return [done[c.name] for c in todo]


def _lost(thing: Any, key: str, lost: LostRun) -> CaseRow:
    if not isinstance(thing, SessionCase):
        raise DeviceError(f"{thing.name}: {lost.text}")
    crashed = {"outcome": "crashed", "named": [], "verdict": lost.text}
    return {key: thing.name, **told(thing), **crashed}


def results(
    work: Callable[[Any], Any], todo: list[Any], where: Where, unit: str
) -> Iterator[tuple[Any, Any]]:
    """Things and what `work` made of them, as they are finished, with progress on stderr."""
    found = spread(work, todo, where)
    for k, result in counted(found, len(todo), unit):
        yield todo[k], result


def revision() -> str:
    """Revision of the source tree, ``-dirty`` where files differ from it."""
    words = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip()


def _calibrated(key: tuple[str, int, str, str]) -> tuple[str, list[float]]:
    return amplitudes.name(*key), amplitudes.calibrate(*key)


def _keys(plant: str) -> list[tuple[str, int, str, str]]:
    """Effect, joint, robot and excitation of every amplitude that a plan needs."""
    if plant == "test":
        every = cases.mujoco_plan(seeds=cases.SEEDS_PER_CASE)
        return sorted({(h.effect, h.joint, c.robot, c.excitation) for c in every for h in c.hidden})
    return [
        (effect, joint, robot, excitation)
        for effect, (needs, *_) in session.kinds_of_plant().items()
        for robot, joint in (("arm", 0), ("arm", 1), ("arm", 2), ("axis", 0))
        for excitation in cases.EXCITATIONS
        if robot == "arm" or not needs
    ]


def _calibrate(
    plant: str, workers: int, todo: list[tuple[str, int, str, str]] | None = None
) -> None:
    """Find the amplitudes of `todo` (all of a plant's) and write them to its file."""
    known = amplitudes.amplitude_table(plant) if todo is not None else {}
    work = _keys(plant) if todo is None else todo
    found = dict(made for _, made in results(_calibrated, work, Where(workers), "effect"))
    found = dict(sorted((known | found).items()))
    lines = [f"{json.dumps(k)}: {json.dumps(v)}" for k, v in found.items()]
    Path(amplitudes.__file__).with_name(amplitudes.FILES[plant]).write_text(
        "{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8"
    )


if __name__ == "__main__":
    for plant in sys.argv[1:] or amplitudes.FILES:
        _calibrate(plant, 2)
