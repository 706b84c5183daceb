"""What the studio works on: sessions, a stack of models, and what each of them shows as plain data.

No analysis is made here: every number comes from the public verbs, and the words from the report.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.diagnosis.constants import ADEQUATE
from hil.diagnosis.types import Diagnosis, FloatArray, HeldOut, Step
from hil.diagnosis.verbs import Comparison, compare, diagnose
from hil.errors import ConfigError, HilError
from hil.export import target
from hil.identify.result import FitResult
from hil.models import catalogue
from hil.models.files import write_model
from hil.models.model import RobotModel, Use, Value
from hil.record.recording import Recording
from hil.report import effects
from hil.report import text as sentences
from hil.report.data import candidate_json, diagnosis_json, from_diagnosis, region_json, rounded
from hil.report.html import comparison_report, diagnosis_report

#: Candidates that are listed.
_LISTED = 12


@dataclass(frozen=True)
class Inputs:
    """What the studio was opened with.

    Parameters
    ----------
    runs, held : tuple of Recording
        Sessions that are fitted, and held-out ones.
    model : RobotModel
        First model.
    sessions, holdout : tuple of str
        Their files.
    model_file : str
        File of the model; empty: the base model.
    arm : str
        Arm of the sessions; empty: the only one.
    """

    runs: tuple[Recording, ...]
    held: tuple[Recording, ...]
    model: RobotModel
    sessions: tuple[str, ...]
    holdout: tuple[str, ...] = ()
    model_file: str = ""
    arm: str = ""
    #: How the sessions came to be, on the command line.
    made: tuple[str, ...] = ()


@dataclass(frozen=True)
class WorkStep:
    """One command that makes a model of the one before.

    Parameters
    ----------
    verb : str
        Command of the program.
    before, after : tuple of str
        Its words before and behind the sessions.
    plugins : tuple of str
        Files of effects that the model names.
    """

    verb: str
    before: tuple[str, ...] = ()
    after: tuple[str, ...] = ()
    plugins: tuple[str, ...] = ()


@dataclass
class StudioRung:
    """One model of the stack.

    Parameters
    ----------
    label : str
        What was done to get it.
    model : RobotModel
        As it was asked for; fitted in `found`.
    steps : tuple of WorkStep
        How the command line makes it of the first model.
    """

    label: str
    model: RobotModel
    steps: tuple[WorkStep, ...] = ()
    found: Comparison | None = None
    #: File to which the fitted model was saved; empty: none.
    file: str = ""


@dataclass(frozen=True)
class Recommended:
    """What a diagnosis says and recommends: it outlives a computation that is broken off.

    Parameters
    ----------
    rung : StudioRung or None
        The model that it recommends; None where there is none.
    shown : dict
        What the page shows of it.
    """

    rung: StudioRung | None
    shown: dict[str, Any]


@dataclass
class Workbench:
    """Sessions and a stack of models with undo and redo.

    Parameters
    ----------
    inputs : Inputs
        What it begins with.
    """

    inputs: Inputs
    stack: list[StudioRung] = field(default_factory=list)
    at: int = 0
    diagnosis: Diagnosis | None = None
    #: Model whose residual is drawn beside the current one; below 0: none.
    other: int = -1
    #: What that diagnosis said, or one before the last computation was broken off.
    recommended: Recommended | None = None
    #: Names of the user's own effects, and their files.
    own: list[str] = field(default_factory=list)
    files: tuple[str, ...] = ()
    #: Gets what can be shown of a new model as soon as that is fitted, over the floor that is known
    #: by then: first the ladder alone, then with curves, learnt effects and parameters.
    early: Callable[[dict[str, Any]], None] = lambda look: None

    #: The last comparison that was made: the next one uses what it made of the motion.
    before: Comparison | None = None

    def __post_init__(self) -> None:
        if not self.stack:
            self.stack = [
                StudioRung(
                    "base model" if not self.inputs.model_file else "given model", self.inputs.model
                )
            ]

    # ------------------------------------------------------------ what can be asked

    def start(self) -> dict[str, Any]:
        """Compare the current model, and show everything."""
        return self.state()

    def add(self, effect: str, joint: str) -> dict[str, Any]:
        """Add an effect to the current model and refit it."""
        joints = ("*",) if not joint or catalogue.get(effect).scope.of_robot else (joint,)
        joints_of = self.inputs.runs[0].joints
        if joint and joint not in joints_of:
            raise ConfigError(f"no joint {joint!r}; this session has {', '.join(joints_of)}")
        kind = catalogue.get(effect)
        several = kind.variation.per_run and len(self.inputs.runs) > 1
        options: dict[str, object] = {"per_run": True} if several else {}
        model = self.now.model
        if effect in self.own:  # it may have been learnt beside another model
            model = replace(model, plugins=tuple(dict.fromkeys([*model.plugins, *self.files])))
        model = model + Use(effect, joints, options)
        where = "" if joints == ("*",) else f" on {joint}"
        chosen = () if joints == ("*",) else ("--joint", joint)
        step = WorkStep("add", (effect,), chosen, model.plugins)
        return self._push(StudioRung(f"+ {effect}{where}", model, (*self.now.steps, step)))

    def remove(self, effect: str, joint: str = "") -> dict[str, Any]:
        """Take an effect off a joint of the current model, or out of it, and refit it."""
        model = self.now.model.without(effect, joint or "*", self.inputs.runs[0].joints)
        where, named = (f" on {joint}", f"{effect}:{joint}") if joint else ("", effect)
        step = WorkStep("fit", (), ("--without", named), model.plugins)
        return self._push(StudioRung(f"- {effect}{where}", model, (*self.now.steps, step)))

    def undo(self) -> dict[str, Any]:
        """Back to the model before."""
        self.at = max(self.at - 1, 0)
        return self.state()

    def redo(self) -> dict[str, Any]:
        """Forward to the model after."""
        self.at = min(self.at + 1, len(self.stack) - 1)
        return self.state()

    def go(self, at: str) -> dict[str, Any]:
        """To the model with this number in the ladder."""
        self.at = self._number(at)
        return self.state()

    def beside(self, at: str) -> dict[str, Any]:
        """Draw the residual of another model beside that of the current one; empty: of none."""
        self.other = self._number(at) if at else -1
        return self.state()

    def _number(self, at: str) -> int:
        if not at.isdecimal() or int(at) >= len(self.stack):
            raise ConfigError(f"no model {at!r}; there are 0 to {len(self.stack) - 1}")
        return int(at)

    def diagnose(self) -> dict[str, Any]:
        """Run the whole diagnosis on the current model; its rungs become the stack."""
        now = self.now
        self.diagnosis = diagnose(list(self.inputs.runs), now.model, list(self.inputs.held))
        self.recommended = self._recommended(self.diagnosis)
        return self.state()

    def _recommended(self, d: Diagnosis) -> Recommended:
        """What a diagnosis of the current model says, and the model that it recommends."""
        now = self.now
        said = {"text": sentences.headline(from_diagnosis(d, simulated=False)), "of": now.label}
        shown = diagnosis_json(d) | said
        if not d.ladder:
            return Recommended(None, shown)
        names = " + ".join(f.effect for f in d.findings) or "corrections"
        steps = (*now.steps, WorkStep("improve", plugins=now.model.plugins))
        return Recommended(StudioRung(f"diagnosis: {names}", d.model, steps), shown)

    def take(self) -> dict[str, Any]:
        """Take the model that the diagnosis recommends."""
        if self.recommended is None or self.recommended.rung is None:
            raise ConfigError("there is no diagnosis yet; press Diagnose first")
        return self._push(replace(self.recommended.rung, found=None, file=""))

    def save(self, path: str) -> dict[str, Any]:
        """Write the current fitted model; only over an older model file."""
        place = Path(path)
        write_model(self.compared().result.model, place)
        written = str(place.resolve())
        for rung in self.stack:  # what another model had there is gone
            rung.file = "" if rung.file == written else rung.file
        self.now.file = written
        return {"saved": written}

    def export(self, kind: str, path: str) -> dict[str, Any]:
        """Write the current model for another program, refitted within what that can express.

        What is written names the model's file.  A model that was not saved is saved beside it.
        """
        program, place = target.get(kind), Path(path)
        if place.suffix != program.ending:
            raise ConfigError(f"cannot write {path}: this file ends in {program.ending}")
        i, model = self.inputs, self.compared().result.model
        source, fresh = self._file_of_model(place)
        try:
            job = target.Job(model, source, place.stem, list(i.runs), list(i.held))
            made = program.make(job)
            files = {place.with_suffix(ending): text for ending, text in made.texts.items()}
            for file in files:
                if file.exists():
                    raise ConfigError(f"cannot write {file}: a file is there; choose another name")
        except HilError:
            for file in fresh:
                file.unlink()
            raise
        for file, text in files.items():
            file.write_text(text, encoding="utf-8")
        self.now.file = str(source.resolve())
        notes = [*target.errors_of(made.steps), *(f"lost: {x}" for x in made.lost), *made.notes]
        return {"saved": ", ".join(str(f.resolve()) for f in (*files, *fresh)), "notes": notes}

    def _file_of_model(self, place: Path) -> tuple[Path, list[Path]]:
        """File of the current model, and the files that were written for it, beside an export."""
        if self.now.file and Path(self.now.file).is_file():
            return Path(self.now.file), []
        model = self.compared().result.model
        # a description has the stem of its model, and must not stand where the exported one goes
        source = place.with_suffix(".model.toml" if model.robot.urdf else ".toml")
        description = source.with_suffix(".urdf")
        if source.exists():
            raise ConfigError(
                f"cannot write {source} beside {place}: a file is there; save the model first, or "
                "choose another name"
            )
        fresh = [source, *([description] if model.robot.urdf and not description.exists() else [])]
        write_model(model, source)
        return source, fresh

    def report(self, path: str) -> dict[str, Any]:
        """Write the report of the diagnosis, or of the comparison where there is none."""
        place = Path(path)
        if place.suffix != ".html":
            raise ConfigError(f"cannot write {path}: a report ends in .html")
        if place.exists():
            raise ConfigError(f"cannot write {path}: a file is there; choose another name")
        about = "of the current model"
        if self.diagnosis is not None and self.recommended is not None:
            about = f"of the diagnosis of {self.recommended.shown['of']!r}"
            diagnosis_report(self.diagnosis, place)
        elif self.recommended is not None:
            raise ConfigError(
                "what the report of the diagnosis needs was lost when a computation was broken "
                "off; press Diagnose again"
            )
        else:
            i, model = self.inputs, self.compared().result.model
            whole = compare(list(i.runs), model, list(i.held) or None)
            comparison_report(whole, place)
        return {"saved": str(place.resolve()), "notes": [f"it is {about}"]}

    # ------------------------------------------------------------ inside

    @property
    def now(self) -> StudioRung:
        """Current rung."""
        return self.stack[self.at]

    def compared(self) -> Comparison:
        """Comparison of the current model, made once."""
        rung = self.now
        if rung.found is None:
            rung.found = self._seen(rung.model)
        return rung.found

    def _push(self, rung: StudioRung) -> dict[str, Any]:
        """Compare a new model first: one that cannot be fitted leaves the stack as it was."""
        rung.found = self._seen(
            rung.model, lambda result, held: self._first_look(rung, result, held)
        )
        self.stack[self.at + 1 :] = [rung]
        self.at += 1
        return self.state()

    def _seen(
        self,
        model: RobotModel,
        fitted: Callable[[FitResult, HeldOut], None] = lambda result, held: None,
    ) -> Comparison:
        """Comparison of a model; the page shows no simulation, so none is made."""
        i = self.inputs
        self.before = compare(
            list(i.runs),
            model,
            list(i.held) or None,
            simulate=False,
            fitted=fitted,
            before=self.before,
        )
        return self.before

    def _first_look(self, rung: StudioRung, result: FitResult, held: HeldOut) -> None:
        """Show a new model over the floor that is known, before its own is."""
        before = self.now.found
        if before is None or before.noise.shape != held.rms.shape:
            return
        floor = np.minimum(self._floor(self.stack[: self.at + 1]), held.rms)
        kept = [_rung(r, floor) for r in self.stack[: self.at + 1]]
        look: dict[str, Any] = {
            "ladder": [*kept, {"label": rung.label, "joints": _errors(held, floor)}]
        }
        self.early(look)
        curves = effects.series_json(result, before.evidence.floor.rms)
        self.early(
            look
            | {
                "series": curves,
                "learnt": effects.learnt_json(result),
                "model": _model(result),
            }
        )

    def _commands(self) -> list[str]:
        """How the command line makes the current model, and shows what the page shows of it.

        Every command takes what the last one wrote.
        """
        i, out = self.inputs, []
        model, known = i.model_file, set(i.model.plugins)
        show = WorkStep("compare", plugins=self.now.model.plugins)
        for k, step in enumerate((*self.now.steps, show)):
            words = ["hil", step.verb, *step.before, *i.sessions]
            words += ["--model", model] if model else []
            words += [w for p in step.plugins if p not in known for w in ("--plugin", p)]
            # a fit judges on nothing
            held = i.holdout if step.verb != "fit" else ()
            words += [w for h in held for w in ("--holdout", h)]
            words += ["--arm", i.arm] if i.arm else []
            words += step.after
            if step is not show:
                model, known = f"better{k + 1 if k else ''}.toml", known | set(step.plugins)
                words += ["-o", model]
            out.append(shlex.join(words))
        return out

    # ------------------------------------------------------------ what the page shows

    def state(self) -> dict[str, Any]:
        """Everything that the page shows of the current model."""
        c = self.compared()
        return {
            "sessions": [Path(p).name for p in self.inputs.sessions],
            "holdout": [Path(p).name for p in self.inputs.holdout],
            "heldOut": c.heldout.kind,
            "joints": list(c.result.problem.joints),
            "units": ["N" if u == "m" else "N m" for u in c.result.problem.robot.units],
            "motion": list(c.result.problem.robot.units),
            "adequate": ADEQUATE,
            "at": self.at,
            "ladder": self._ladder(),
            "warnings": [f.sentence for f in c.faults],
            "where": {j: [region_json(r) for r in found] for j, found in c.where.items()},
            "candidates": self._candidates(c),
            "model": _model(c.result),
            "learnt": effects.learnt_json(c.result),
            "series": effects.series_json(c.result, c.evidence.floor.rms),
            "beside": self._beside(c),
            "own": list(self.own),
            "exports": _exports(),
            "diagnosis": self.recommended.shown if self.recommended else None,
            "commands": [*self.inputs.made, *self._commands()],
        }

    def _beside(self, c: Comparison) -> dict[str, Any] | None:
        """Residual of the other model; none where it was not fitted to the same samples."""
        if not 0 <= self.other < len(self.stack) or self.other == self.at:
            return None
        rung = self.stack[self.other]
        if rung.found is None:
            rung.found = self._seen(rung.model)
        if rung.found.result.residual.shape != c.result.residual.shape:
            return None
        p = rung.found.result.problem
        traces = [effects.trace_json(p.t, p.run, r) for r in rung.found.result.residual]
        return {"at": self.other, "label": rung.label, "joints": traces}

    def _ladder(self) -> list[dict[str, Any]]:
        """Every model's label and errors, all of them over one floor."""
        floor = self._floor(self.stack)
        return [_rung(r, floor) for r in self.stack]

    def _floor(self, rungs: Sequence[StudioRung]) -> FloatArray:
        """The lowest floor that any of these models shows, by joint: they share their data.

        A floor that a model shows is an upper bound on the noise, so the least is the nearest.
        """
        known = [r.found.noise for r in rungs if r.found is not None]
        least: FloatArray = np.min([self.compared().noise, *known], axis=0)
        return least

    def _candidates(self, c: Comparison) -> list[dict[str, Any]]:
        """Best candidates of the current model, each with what it does and a sentence."""
        alone = Diagnosis(
            "compared", [], [Step("model", c.result, c.heldout)], c.evidence, c.evidence
        )
        held = {(u.type, j) for u in c.result.model.effects for j in u.joints}
        rows: list[dict[str, Any]] = []
        for x in c.evidence.candidates:
            own = x.name in self.own
            if not own and len(rows) >= _LISTED:
                continue
            data = candidate_json(x, c.evidence, alone)
            if (data["effect"], data["joint"] or "*") in held or (data["effect"], "*") in held:
                continue
            rows.append(data | {"meaning": sentences.meaning(x.name), "own": own})
        return rows


def _rung(rung: StudioRung, floor: FloatArray) -> dict[str, Any]:
    """Label and errors of a model over a floor; null where it was not compared."""
    found = rung.found
    errors = None if found is None else _errors(found.heldout, floor)
    return {"label": rung.label, "joints": errors}


def _errors(held: HeldOut, noise: FloatArray) -> list[dict[str, float | None]]:
    """Error of every joint over its noise floor, and relative to the effort [%]."""
    ratio = held.rms / np.maximum(noise, 1e-300)
    return [
        {"ratio": rounded(float(r)), "relative": rounded(float(x))}
        for r, x in zip(ratio, held.relative, strict=True)
    ]


def _model(result: FitResult) -> list[dict[str, Any]]:
    """Effects of a model, joint by joint, with their values and 95 % intervals."""
    joints = result.problem.joints
    rows = []
    for use in result.model.effects:
        of: dict[str, list[dict[str, Any]]] = {}
        for name, v in use.values.items():
            found = _JOINT.match(name)
            of.setdefault(joints[int(found[1]) - 1] if found else "", []).append(_value(name, v))
        rows += [{"effect": use.type, "joint": j, "values": values} for j, values in of.items()]
    return rows


#: Number of the joint that a parameter is of, from 1.
_JOINT = re.compile(r"j(\d+)\.")


def _value(name: str, v: Value) -> dict[str, Any]:
    half = 1.96 * v.stderr
    return {
        "name": name,
        "value": rounded(v.value, 5),
        "half": rounded(half, 2),
        "unit": "" if v.unit == "1" else v.unit,
        "note": "on its bound" if v.at_bound else "" if v.identifiable else "undetermined",
    }


def _exports() -> list[dict[str, str]]:
    """Programs for which a model can be written."""
    found = [(name, target.get(name)) for name in target.names()]
    return [{"name": n, "what": x.what, "ending": x.ending} for n, x in found]


#: What the page may ask for, and the names of its arguments.
VERBS: dict[str, Sequence[str]] = {
    "start": (),
    "add": ("effect", "joint"),
    "remove": ("effect", "joint"),
    "undo": (),
    "redo": (),
    "go": ("at",),
    "beside": ("at",),
    "diagnose": (),
    "take": (),
    "save": ("path",),
    "report": ("path",),
    "export": ("kind", "path"),
}
