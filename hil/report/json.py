"""Results as the JSON of the contract."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hil.diagnosis.attribution import plausible, weights
from hil.diagnosis.equivalence import sets_of
from hil.diagnosis.residuals import Region, regions
from hil.diagnosis.types import Candidate, Diagnosis, Evidence, Explainable, Finding, joint_of
from hil.diagnosis.verbs import Comparison, Rung
from hil.identify.multistep import MultiStep
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.model import Value, in_words

#: Fields of an indistinguishable set, and of what a motion could not show.
SETS = ("effects", "why", "experiment", "reason", "motion", "command")
UNSEEN_KEYS = ("effects", "joints", "why", "command")
CORRECTION = ("effect", "of", "joint", "relative_before", "relative_after", "se", "alike")


def number(x: float, digits: int = 6) -> float | None:
    """A float for JSON: rounded to significant digits, None if not finite."""
    if not math.isfinite(x):
        return None
    return float(f"{x:.{digits}g}")


def by_joint(result: FitResult, values: Any) -> dict[str, float | None]:
    """One number a joint, by joint name."""
    return {j: number(float(v)) for j, v in zip(result.problem.joints, values, strict=True)}


def value_json(name: str, v: Value) -> dict[str, object]:
    """A parameter; `text` where its value is a code."""
    said = in_words(name, v.value)
    text = {"text": said} if said else {}
    return {
        "value": number(v.value, 9),
        "stderr": number(v.stderr),
        "unit": v.unit,
        **text,
    }


def region_json(r: Region) -> dict[str, object]:
    """A place where the model fails."""
    return {
        "feature": r.feature,
        "range": [number(r.low), number(r.high)],
        "unit": r.unit,
        "rms": number(r.rms),
        "mean": number(r.mean),
        "share": number(r.share, 3),
        "text": r.text,
    }


def multi_json(m: MultiStep, result: FitResult) -> dict[str, object]:
    """Multi-step error: short horizons, and the closed-loop replay below ``closed_loop``."""
    out: dict[str, object] = {
        "horizon_s": m.horizon,
        "windows": m.windows,
        "diverged": m.diverged,
        "rms": by_joint(result, m.rms),
        "relative": by_joint(result, m.relative),
    }
    if m.closed_loop is not None:
        out["closed_loop"] = multi_json(m.closed_loop, result)
    return out


def comparison_json(c: Comparison) -> dict[str, object]:
    """`hil compare --json`."""
    result, floor = c.result, c.noise
    joints = []
    for j, name in enumerate(result.problem.joints):
        rms = float(c.heldout.rms[j])
        excess = max(0.0, 1 - (float(floor[j]) / rms) ** 2) if rms > 0 else 0.0
        joints.append(
            {
                "name": name,
                "rms": number(rms),
                "relative": number(float(c.heldout.relative[j])),
                "se": number(float(c.heldout.standard_error()[j])),
                "noise_floor": number(float(floor[j])),
                "excess_share": number(excess, 3),
                "where": [region_json(r) for r in c.where[name]],
            }
        )
    return {
        "schema": "hil.compare/1",
        "joints": joints,
        "held_out": c.heldout.kind,
        "noise_floor_from": c.evidence.floor.method,
        "multi_step": multi_json(c.multi_step, result),
        "signal": _band(result.problem),
        "warnings": [{"code": f.code, "text": f.sentence} for f in c.faults],
    }


def finding_json(f: Finding) -> dict[str, object]:
    """One accepted effect."""
    return {
        "effect": f.effect,
        "joint": f.joint,
        "confidence": number(f.confidence, 3),
        "relative_before": number(f.relative_before),
        "relative_after": number(f.relative_after),
        "se": number(f.se, 3),
        "excess_explained": number(f.excess_explained, 3),
        "parameters": {n: value_json(n, v) for n, v in f.parameters.items()},
        "rivals": f.rivals,
    }


def candidate_json(c: Candidate, evidence: Evidence, diagnosis: Diagnosis) -> dict[str, object]:
    """One candidate beside the first model."""
    base = diagnosis.ladder[0]
    problem, j = base.result.problem, c.joint
    fall = c.parts[j] * base.result.sigma[j] ** 2 / problem.count[j]
    power = base.result.rms[j] ** 2 - fall
    size = float(problem.rms(problem.effort)[j])
    whole = c.term.effect.scope.of_robot
    return {
        "effect": c.name,
        "joint": None if whole else problem.joints[j],
        "relative_after": number(100 * math.sqrt(max(float(power), 0.0)) / max(size, 1e-300)),
        "se": number(float(base.heldout.standard_error()[j]), 3),
        "confidence": number(_confidence(c, evidence, diagnosis), 3),
        "p_value": number(c.p_value, 3),
        "absorbed": number(c.absorbed, 4),
    }


def _confidence(c: Candidate, evidence: Evidence, d: Diagnosis) -> float:
    """That of the finding, if it became one; else its share among what is plausible there."""
    joint = joint_of(c, d.ladder[0].result.problem)
    for f in [*d.findings, *d.partial]:
        if (f.effect, f.joint) == (c.name, joint):
            return f.confidence
    near = [x for x in plausible(evidence, d.ladder[0].result) if x.joint == c.joint]
    if d.verdict == "adequate" or evidence.projector is None or c not in near:
        return 0.0
    return weights(near[0], near[1:], evidence.projector).get(near.index(c), 0.0)


def diagnosis_json(d: Diagnosis) -> dict[str, object]:
    """`hil diagnose --json`."""
    return {
        "schema": "hil.diagnose/1",
        "verdict": d.verdict,
        "findings": [finding_json(f) for f in d.findings],
        "candidates": [candidate_json(c, d.first, d) for c in d.first.candidates[:20]],
        "remaining": _remaining(d),
        "corrections": [_fields(c, CORRECTION) for c in d.corrections],
        "indistinguishable": [_fields(s, SETS) for s in sets_of(d)],
        "could_not_show": [_fields(u, UNSEEN_KEYS) for u in d.unseen],
        "warnings": [{"code": code, "text": text} for code, text in d.warnings],
        "signal": _signal(d),
    }


def _signal(d: Diagnosis) -> dict[str, object] | None:
    """Band, rate and shift of the efforts of all errors, and the runs that were fitted."""
    if not d.ladder:
        return None
    problem = d.ladder[-1].result.problem
    return _band(problem) | {
        "runs": list(dict.fromkeys(r.name for r in problem.recordings)),
    }


def _band(problem: Problem) -> dict[str, object]:
    """The same of the filters alone, in SI units."""
    return {
        "position_hz": number(problem.rates.position),
        "effort_hz": number(problem.rates.effort),
        "rate_hz": number(problem.rate),
        "shift_s": number(problem.shift),
        "lag_s": number(problem.alignment.lag),
        "lag_poles": problem.alignment.poles,
        "clock_ppm": number(1e6 * problem.alignment.rate),
    }


def _remaining(d: Diagnosis) -> dict[str, object]:
    """What is left after the last rung, and where it lives."""
    last = d.ladder[-1] if d.ladder else None
    places = (regions(last.result, d.last.floor, 3) if last else {}).values()
    structure = [_structure(r) for items in places for r in items]
    structure += [_structure(s) for s in d.network]
    return {
        "relative": by_joint(last.result, last.heldout.relative) if last else {},
        "rms": by_joint(last.result, last.heldout.rms) if last else {},
        "noise_floor": by_joint(last.result, d.noise) if last else {},
        "noise_floor_from": d.last.floor.method,
        "structure": structure,
        "any_function": None if d.beyond is None else number(d.beyond, 3),
        "best_partial": [{**finding_json(f), "reason": f.reason} for f in d.partial],
    }


def _structure(x: Region | Explainable) -> dict[str, object]:
    return {"joint": x.joint, "feature": x.feature, "share": number(x.share, 3), "text": x.text}


def _fields(x: object, names: Sequence[str]) -> dict[str, object]:
    """Fields of an answer by name, tuples as lists."""
    values = ((n, getattr(x, n)) for n in names)
    return {n: list(v) if isinstance(v, tuple) else v for n, v in values}


def ladder_json(rungs: list[Rung]) -> list[dict[str, object]]:
    """The error ladder."""
    return [
        {
            "model": r.step.label,
            "relative": by_joint(r.step.result, r.step.heldout.relative),
            "relative_all": number(r.step.heldout.relative_all),
            "rms": by_joint(r.step.result, r.step.heldout.rms),
            "multi_step": multi_json(r.multi_step, r.step.result),
        }
        for r in rungs
    ]
