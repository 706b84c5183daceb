"""What a report is made of, from a diagnosis or a comparison; and the same as JSON.

Results as the JSON of the contract, and the commands for what to do next, with files as typed.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.attribution import plausible, weights
from hil.diagnosis.constants import ADEQUATE, CONFIDENT
from hil.diagnosis.equivalence import pairs, sets_of
from hil.diagnosis.residual_tests import CHANGED, UNLIKE
from hil.diagnosis.residuals import Region, regions
from hil.diagnosis.types import (
    Candidate,
    Diagnosis,
    Evidence,
    Explainable,
    Finding,
    Indistinguishable,
    Step,
    UnnamedCorrection,
    Unseen,
    joint_of,
)
from hil.diagnosis.verbs import Comparison, Rung, ladder
from hil.identify.multistep import MultiStep
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.model import Range, Value, in_words
from hil.record.consistency import notes_of

FloatArray = NDArray[np.float64]
#: Verdict of a comparison, which judges nothing.
COMPARED = "compared"
#: Fields of an indistinguishable set, and of what a motion could not show.
SETS = ("effects", "why", "experiment", "reason", "motion", "command")
UNSEEN_KEYS = ("effects", "joints", "why", "command")
_CORRECTION = ("effect", "of", "joint", "relative_before", "relative_after", "se", "alike")


@dataclass(frozen=True)
class Material:
    """Verdict, ladder and evidence of one report.

    Parameters
    ----------
    verdict : str
        Verdict of a diagnosis, or ``"compared"``.
    rungs : list of Rung
        Ladder with both errors; empty where nothing was fitted.
    floor : ndarray (d,)
        Noise floor [N m or N].
    first, last : Evidence
        Candidates beside the first and the last model.
    findings, partial : list of Finding
        Accepted effects; effects that help but explain too little.
    sets : list of Indistinguishable
        What the data cannot tell apart.
    warnings : list of (code, str)
        Notes and faults.
    network : list of Share
        What any function of position, speeds or time could explain of what is left.
    corrections : list of Correction
        Free functions without a name that the last model holds.
    valid : tuple of Range
        What the given model had been identified on, before it was fitted to these sessions.
    """

    verdict: str
    rungs: list[Rung]
    floor: FloatArray
    first: Evidence
    last: Evidence
    findings: list[Finding] = field(default_factory=list)
    partial: list[Finding] = field(default_factory=list)
    sets: list[Indistinguishable] = field(default_factory=list)
    warnings: list[tuple[str, str]] = field(default_factory=list)
    network: list[Explainable] = field(default_factory=list)
    valid: tuple[Range, ...] = ()
    unseen: list[Unseen] = field(default_factory=list)
    beyond: float | None = None
    corrections: list[UnnamedCorrection] = field(default_factory=list)
    #: Rungs at the end of the ladder that corrections give.
    corrected: int = 0

    @property
    def before(self) -> Step:
        """First model."""
        return self.rungs[0].step

    @property
    def after(self) -> Step:
        """Last model."""
        return self.rungs[-1].step

    @property
    def explained(self) -> Step:
        """The last model without corrections."""
        return self.rungs[-1 - self.corrected].step

    @property
    def problem(self) -> Problem:
        """Runs of the fit."""
        return self.before.result.problem

    @property
    def joints(self) -> tuple[str, ...]:
        """Joint names."""
        return tuple(self.problem.joints)

    @property
    def external(self) -> bool:
        """Whether the model explains a contact force instead of the motor's effort."""
        return self.before.result.model.explains == "external"

    def effort_unit(self, j: int) -> str:
        """Unit of joint j's effort."""
        return "N" if self.problem.robot.units[j] == "m" else "N m"

    def relative_floor(self, j: int) -> float:
        """Noise floor of joint j in percent of the held-out effort."""
        size = float(self.before.heldout.effort_rms[j])
        return 100 * float(self.floor[j]) / max(size, 1e-300)

    def ratio(self, step: Step) -> FloatArray:
        """Held-out error of a rung in units of the noise floor (d,)."""
        out: FloatArray = step.heldout.rms / np.maximum(self.floor, 1e-300)
        return out

    def concerned(self, most: int = 3) -> list[int]:
        """Joints worth looking at: those of the findings, else the worst against the floor.

        Where every joint is at its floor, those of which something is said nevertheless.
        """
        names = [f.joint for f in (*self.findings, *self.partial) if f.joint in self.joints]
        ratio = self.ratio(self.before)
        if not names and float(ratio.max()) <= ADEQUATE:
            said = [n.joint for n in notes_of(self.warnings, CHANGED, UNLIKE)]
            said += [s.joint for s in self.network]
            names = [joint for joint in said if joint in self.joints]
        named = list(dict.fromkeys(self.joints.index(n) for n in names if n is not None))
        worst = [int(j) for j in np.argsort(-ratio)]
        return named[:most] if named else worst[:most]


def from_diagnosis(d: Diagnosis, simulated: bool = True) -> Material:
    """Material of a diagnosis; both errors of every rung, the simulated one where it is wanted."""
    if not d.ladder:
        return Material(d.verdict, [], d.noise, d.first, d.last, warnings=d.warnings)
    motor = d.ladder[0].result.model.explains == "motor"
    rungs = (
        [_honest(r) for r in ladder(d)]
        if motor and simulated
        else [Rung(s, _none(len(d.noise))) for s in d.ladder]
    )
    return Material(
        d.verdict,
        rungs,
        d.noise,
        d.first,
        d.last,
        d.findings,
        d.partial,
        sets_of(d),
        d.warnings,
        d.network,
        d.valid,
        d.unseen,
        d.beyond,
        d.corrections,
        d.corrected,
    )


def from_comparison(c: Comparison) -> Material:
    """Material of a comparison: a ladder of one rung."""
    rung = _honest(Rung(Step("model", c.result, c.heldout), c.multi_step))
    faults: list[tuple[str, str]] = [f.note for f in c.faults]
    return Material(
        COMPARED,
        [rung],
        c.noise,
        c.evidence,
        c.evidence,
        sets=pairs(c.evidence, [], c.result),
        warnings=faults,
        valid=c.valid,
    )


def _honest(rung: Rung) -> Rung:
    """Rung without a simulated error where most simulations left the recorded range."""
    multi = rung.multi_step
    if not multi.windows or not multi.lost:
        return rung
    nothing = np.full(multi.rms.size, np.nan)
    return Rung(rung.step, replace(multi, rms=nothing, relative=nothing))


def _none(d: int) -> MultiStep:
    nothing = np.full(d, np.nan)
    return MultiStep(0.0, nothing, nothing, 0, 0)


def readable_number(x: float, digits: int = 3) -> str:
    """A number for people: significant digits, a dash where there is none."""
    if not math.isfinite(x):
        return "-"
    text = f"{x:.{digits}g}"
    if "e+" in text and abs(x) < 1e6:
        text = f"{x:.0f}"
    return text.replace("-", "\u2212")


def rounded(x: float, digits: int = 6) -> float | None:
    """A float for JSON: rounded to significant digits, None if not finite."""
    if not math.isfinite(x):
        return None
    return float(f"{x:.{digits}g}")


def by_joint(result: FitResult, values: Any) -> dict[str, float | None]:
    """One number a joint, by joint name."""
    return {j: rounded(float(v)) for j, v in zip(result.problem.joints, values, strict=True)}


def value_json(name: str, v: Value) -> dict[str, object]:
    """A parameter; `text` where its value is a code."""
    said = in_words(name, v.value)
    text = {"text": said} if said else {}
    return {
        "value": rounded(v.value, 9),
        "stderr": rounded(v.stderr),
        "unit": v.unit,
        **text,
    }


def region_json(r: Region) -> dict[str, object]:
    """A place where the model fails."""
    return {
        "feature": r.feature,
        "range": [rounded(r.low), rounded(r.high)],
        "unit": r.unit,
        "rms": rounded(r.rms),
        "mean": rounded(r.mean),
        "share": rounded(r.share, 3),
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
                "rms": rounded(rms),
                "relative": rounded(float(c.heldout.relative[j])),
                "se": rounded(float(c.heldout.standard_error()[j])),
                "noise_floor": rounded(float(floor[j])),
                "excess_share": rounded(excess, 3),
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
        "confidence": rounded(f.confidence, 3),
        "relative_before": rounded(f.relative_before),
        "relative_after": rounded(f.relative_after),
        "se": rounded(f.se, 3),
        "excess_explained": rounded(f.excess_explained, 3),
        "parameters": {n: value_json(n, v) for n, v in f.parameters.items()},
        "rivals": f.rivals,
        "rival_weights": f.rival_weights,
        "felt_on": f.felt_on,
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
        "relative_after": rounded(100 * math.sqrt(max(float(power), 0.0)) / max(size, 1e-300)),
        "se": rounded(float(base.heldout.standard_error()[j]), 3),
        "confidence": rounded(_confidence(c, evidence, diagnosis), 3),
        "p_value": rounded(c.p_value, 3),
        "absorbed": rounded(c.absorbed, 4),
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
        "corrections": [_fields(c, _CORRECTION) for c in d.corrections],
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
        "position_hz": rounded(problem.rates.position),
        "effort_hz": rounded(problem.rates.effort),
        "rate_hz": rounded(problem.rate),
        "shift_s": rounded(problem.shift),
        "lag_s": rounded(problem.alignment.lag),
        "lag_poles": problem.alignment.poles,
        "clock_ppm": rounded(1e6 * problem.alignment.rate),
        "effort_step": [rounded(x) for x in problem.effort_step],
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
        "any_function": None if d.beyond is None else rounded(d.beyond, 3),
        "best_partial": [{**finding_json(f), "reason": f.reason} for f in d.partial],
    }


def _structure(x: Region | Explainable) -> dict[str, object]:
    return {"joint": x.joint, "feature": x.feature, "share": rounded(x.share, 3), "text": x.text}


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
            "relative_all": rounded(r.step.heldout.relative_all),
            "rms": by_joint(r.step.result, r.step.heldout.rms),
            "multi_step": multi_json(r.multi_step, r.step.result),
        }
        for r in rungs
    ]


# ------------------------------------------------------------ commands


@dataclass(frozen=True)
class Files:
    """What a diagnosis was made from, as it was typed, for the commands that a report suggests.

    Parameters
    ----------
    sessions, holdout : tuple of str
        Sessions that were fitted, and those that were judged on.
    model : str
        Model file; empty for the base model of the session's robot.
    arm : str
        Arm, if one was named.
    more : tuple of str
        Words that say which robot and joints, and what of a ROS bag.
    written : str
        File of the improved model; empty where none was asked for.
    """

    sessions: tuple[str, ...] = ("SESSION.mcap",)
    holdout: tuple[str, ...] = ()
    model: str = "MODEL.toml"
    arm: str = ""
    more: tuple[str, ...] = ()
    written: str = ""

    def options(self) -> list[str]:
        """Words of a command line behind the model."""
        held = [w for h in self.holdout for w in ("--holdout", h)]
        arm = ["--arm", self.arm] if self.arm else []
        return [*arm, "--session", *self.sessions, *held, *self.more]

    def improved(self) -> list[str]:
        """Words of a command line that takes the sessions first, and the model."""
        named = ["--model", self.model] if self.model else []
        held = [w for h in self.holdout for w in ("--holdout", h)]
        arm = ["--arm", self.arm] if self.arm else []
        return [*self.sessions, *arm, *named, *held, *self.more]

    def better(self, k: int) -> str:
        """Name of the k-th improved model, beside the model or the first session."""
        return str(Path(self.model or self.sessions[0]).with_suffix(f".plus{k}.toml"))


#: What `to_try` writes: effect and joint, in front of a session and a model that stand in.
_ADD = re.compile(r"(hil add \S+) S\.mcap (--joint (?:'[^']*'|\S+))(?: --model (\w+\.toml))?")


def with_files(said: str, files: Files) -> str:
    """Commands of `hil excite` and `hil add` with what was analysed, as it was typed.

    The motion of a rig is planned within the limits of its file, which nobody has named.

    Parameters
    ----------
    said : str
        The command, or a sentence with one; or empty.
    files : Files
        What was analysed; the first of its sessions stands for the robot of a motion.
    """
    arm = ["--arm", files.arm] if files.arm else []
    model = ["--model", files.model] if files.model else []
    said = said.replace(" --model M.toml", "") if model else said
    robot = ["hil", "excite", files.sessions[0], *files.more]

    def named(found: re.Match[str]) -> str:
        rig = found[0].endswith(" RIG.toml")
        return shlex.join([*(found[0].split() if rig else robot), *arm, *model])

    said = re.sub(r"hil excite (?:'[^']*'|\S+)", named, said)
    better = ["--model", files.written or "IMPROVED.toml"]

    def added(found: re.Match[str]) -> str:
        to = better if found[3] == "IMPROVED.toml" else model
        return f"{found[1]} {found[2]} {shlex.join([*to, *files.options()])}"

    return _ADD.sub(added, said)


def add_command(m: Material, files: Files | None = None) -> str:
    """Commands that add the findings that are sure; empty if there is nothing to add.

    Where the model holds corrections, too, the one that writes all of it.
    """
    names = files or Files()
    if m.corrections:
        return shlex.join(["hil", "improve", *names.improved(), "-o", names.better(1)])
    if m.verdict != "missing-effect":
        return ""
    lines, source = [], names.model
    sure = [f for f in m.findings if f.confidence >= CONFIDENT]
    for k, f in enumerate(sure, 1):
        words = ["hil", "add", f.effect, *(["--joint", f.joint] if f.joint else [])]
        words += ["--model", source] if source else []
        source = names.better(k)
        lines.append(shlex.join([*words, *names.options(), "-o", source]))
    return "\n".join(lines)
