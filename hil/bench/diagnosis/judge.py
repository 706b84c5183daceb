"""One case: record, diagnose, and compare what was said with what was hidden."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from hil.bench.diagnosis import amplitudes, session, testplants
from hil.bench.diagnosis.cases import Case, Hidden, suspected
from hil.bench.diagnosis.figures import accepted
from hil.diagnosis.engine import diagnose
from hil.diagnosis.types import Diagnosis
from hil.record.recording import Recording

#: Between the seeds of two runs of one motion: no noise comes twice.
OTHER = 5000


def recordings(case: Case) -> tuple[list[Recording], list[Recording]]:
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
    if any(session.kinds(case.plant)[h.effect][0] == "runs" for h in case.hidden):
        return [_record(case, [], 0, OTHER), runs[0]], runs[1:]
    return runs[:1], runs[1:]


def _record(case: Case, rows: list[session.Row], k: int, noise: int = 0) -> Recording:
    motion = (case.excitation, 2 * case.seed + k)
    seed = 2 * case.seed + k + noise
    return session.record(case.robot, rows, case.noise, motion, seed, case.force)


def judge(case: Case) -> dict[str, Any]:
    """Row of the results: the case, what was said, the outcome, the times."""
    began = time.process_time()
    train, other = recordings(case)
    simulated = time.process_time()
    row: dict[str, Any] = {
        "case": case.name, "plant": case.plant, "kind": case.kind, "robot": case.robot,
        "noise": case.noise, "excitation": case.excitation, "seed": case.seed, "force": case.force,
        "hidden": [[h.effect, h.label, h.level] for h in case.hidden],
    }  # fmt: skip
    if case.plant == "test":
        row["lost"] = testplants.lost(2 * case.seed)
    if not all(session.sane(r) for r in (*train, *other)):
        return row | {"outcome": "unstable", "named": [], "verdict": ""}
    motion = (case.excitation, 2 * case.seed)
    model = suspected(case, train[0].robot)
    row["excess"] = amplitudes.excess(
        train, case.robot, case.noise, motion, motion[1], case.force,
        "torque-offset" in model.names(),
    )  # fmt: skip
    started = time.process_time()
    row |= answer(case, train, other)
    if row["outcome"] != "crashed":
        row["cpu"] = [round(simulated - began, 3), round(time.process_time() - started, 3)]
    return row


def answer(case: Case, train: list[Recording], other: list[Recording]) -> dict[str, Any]:
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
            {"effect": f.effect, "joint": f.joint, "confidence": f.confidence,
             "share": round(f.excess_explained, 3), "rivals": f.rivals}
            for f in d.findings
        ],
        # for a calibration without another run: the first candidates, as (effect, joint, chi2, dof)
        "candidates": [
            [c.name, c.term.joint + 1, round(c.chi2, 1), c.dof] for c in d.first.candidates[:8]
        ],
        "partial": [[f.effect, f.joint] for f in d.partial],
        # rules that stopped something, and those that no other rule would have stood in for
        "fired": sorted(d.fired), "alone": sorted(k for k, sole in d.fired.items() if sole),
        "before": round(steps[0], 3), "after": round(steps[-1], 3),
    }  # fmt: skip


def hit(finding: dict[str, Any], hidden: Hidden) -> bool:
    """Whether a finding is this hidden effect, on its joint where it has one."""
    joint = finding["joint"]
    return finding["effect"] in accepted(hidden.effect) and joint in (None, hidden.label)


def outcome(case: Case, row: dict[str, Any]) -> str:
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
    found = [h for h in case.hidden if any(hit(f, h) for f in named)]
    if len(found) == len(case.hidden):
        if verdict == "ambiguous":
            return "ambiguous"
        return "right" if len(named) == len(found) else "extra"
    rivals = {r for f in named for r in f["rivals"]} | {f["effect"] for f in named}
    if verdict == "ambiguous" and all(accepted(h.effect) & rivals for h in case.hidden):
        return "ambiguous"
    return "one" if found else "wrong"
