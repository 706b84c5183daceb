"""How recordings, models, fits and answers show themselves: text, HTML, frames, figures, pages.

One table an object, a `Sheet`; `hil.shown` calls this by name.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from hil import terminal
from hil.diagnosis.types import Diagnosis, Finding
from hil.diagnosis.verbs import Added, Comparison
from hil.diagnosis.verdict import NO_GEOMETRY
from hil.errors import ConfigError
from hil.identify.result import FitResult
from hil.models.model import RobotModel, Value, in_words, without_error
from hil.models.robots import undescribed
from hil.record.recording import COLUMNS, Recording
from hil.report import elements
from hil.report import text as sentences
from hil.report.data import Material, from_comparison, from_diagnosis
from hil.report.effects import effect_figure
from hil.report.figures import (
    candidates_figure,
    ladder_figure,
    spectra_figures,
    trace_figure,
    view_figures,
)
from hil.report.html import comparison_report, diagnosis_report, is_report

Cell = str | float
#: Of a longer table a prompt shows this many rows, a notebook all of them.
_MOST_ROWS = 60


@dataclass(frozen=True)
class Sheet:
    """One table with what stands above and below it.

    Parameters
    ----------
    title : str
        What the object is.
    lines : tuple of str
        Sentences below the title.
    head : tuple of str
        Names of the columns.
    rows : list of list
        Words and numbers; a number that is none is an empty cell.
    """

    title: str
    lines: tuple[str, ...]
    head: tuple[str, ...]
    rows: list[list[Cell]]

    def words(self) -> list[list[str]]:
        """Cells as text, numbers in four digits."""
        return [[x if isinstance(x, str) else _number(x) for x in row] for row in self.rows]

    def left(self) -> list[int]:
        """Columns of words."""
        return [k for k in range(len(self.head)) if any(isinstance(r[k], str) for r in self.rows)]


def _number(x: float) -> str:
    return f"{x:.4g}" if math.isfinite(x) else ""


# ------------------------------------------------------------ one sheet an object


@singledispatch
def sheet(shown: Any) -> Sheet:
    """Table of an object.

    Raises
    ------
    ConfigError
        If it has none.
    """
    raise ConfigError(f"a {type(shown).__name__} has no table")


@sheet.register
def _(shown: Recording) -> Sheet:
    units = dict.fromkeys(shown.units)
    unit = " or ".join(units)
    rows: list[list[Cell]] = []
    for k, joint in enumerate(shown.joints):
        q, tau = shown.q[:, k], shown.tau[:, k]
        if shown.n:
            rows.append([joint, float(q.min()), float(q.max()), float(np.sqrt(np.mean(tau**2)))])
    length = f"{shown.t[-1] - shown.t[0]:.4g} s at {shown.rate:.4g} Hz" if shown.n > 1 else "empty"
    beside = [name for name in COLUMNS[2:] if getattr(shown, name) is not None]
    robot = shown.robot.preset or "a URDF"
    lacking = undescribed(shown.robot, shown.d)
    lines = [sentences.ended(lacking)] if lacking else []
    lines += [f"arm {shown.arm}; robot: {robot}"]
    lines += [f"also recorded: {', '.join(beside)}"] if beside else []
    lines += [f"note: {note}"] if (note := shown.metadata.get("note")) else []
    effort = " or ".join("N" if u == "m" else "N m" for u in units)
    head = ("joint", f"lowest [{unit}]", f"highest [{unit}]", f"rms effort [{effort}]")
    return Sheet(f"Recording {shown.name!r}: {length}, {shown.n} samples", tuple(lines), head, rows)


PARAMETERS = ("parameter", "value", "standard error", "unit", "remarks")


@sheet.register
def _(shown: RobotModel) -> Sheet:
    robot = shown.robot.preset or ("a URDF" if shown.robot.urdf else "that of the session")
    title = f"RobotModel of {shown.explains} efforts; robot: {robot}"
    lines = (" + ".join(shown.names()),)
    if values := shown.values():
        return Sheet(title, lines, PARAMETERS, [_parameter(n, v) for n, v in values.items()])
    rows: list[list[Cell]] = [
        [u.type, "all" if u.joints == ("*",) else ", ".join(u.joints), sentences.meaning(u.type)]
        for u in shown.effects
    ]
    return Sheet(title, ("no values yet: hil.fit finds them",), ("effect", "joints", "is"), rows)


@sheet.register
def _(shown: FitResult) -> Sheet:
    joints = shown.problem.joints
    errors = ", ".join(f"{j} {x:.2f} %" for j, x in zip(joints, shown.relative, strict=True))
    lacks = [sentences.ended(w) for code, w in shown.warnings if code == NO_GEOMETRY]
    others = [f"warning: {w}" for code, w in shown.warnings if code != NO_GEOMETRY]
    error = f"error of the fitted data, rms residual over rms effort: {errors}"
    lines = (*lacks, error, *others)
    rows = [_parameter(n, v, tuple(joints)) for n, v in shown.values.items()]
    return Sheet(f"FitResult of {_runs(shown)}", lines, PARAMETERS, rows)


@sheet.register
def _(shown: Added) -> Sheet:
    before, after = shown
    errors = [r.step.heldout.relative for r in shown] + [r.multi_step.relative for r in shown]
    joints = after.step.result.problem.joints
    rows: list[list[Cell]] = [
        [joint, *(float(x) for x in each)] for joint, *each in zip(joints, *errors, strict=True)
    ]
    new = {n: v for n, v in after.step.result.values.items() if n not in before.step.result.values}
    values = ", ".join(f"{n} = {v.value:.4g} {v.unit}".removesuffix(" 1") for n, v in new.items())
    lines = (f"new: {values}",) if values else ()
    head = ("joint", "error % before", "after", "simulated % before", "after, simulated")
    return Sheet(f"Added {after.step.label}", lines, head, rows)


@sheet.register
def _(shown: Comparison) -> Sheet:
    held, multi = shown.heldout, shown.multi_step
    rows: list[list[Cell]] = [
        [
            joint,
            float(held.relative[j]),
            float(100 * shown.noise[j] / max(held.effort_rms[j], 1e-300)),
            float(held.rms[j] / shown.noise[j]),
            math.nan if multi.lost else float(multi.relative[j]),
        ]
        for j, joint in enumerate(shown.result.problem.joints)
    ]
    head = ("joint", "held-out error %", "noise floor %", "error/floor", "simulated error %")
    lacks = [sentences.ended(f.sentence) for f in shown.faults if f.code == NO_GEOMETRY]
    lines = (*lacks, *(f"warning: {f.sentence}" for f in shown.faults if f.code != NO_GEOMETRY))
    return Sheet(f"Comparison of a model with {_runs(shown.result)}", lines, head, rows)


@sheet.register
def _(shown: Diagnosis) -> Sheet:
    m = from_diagnosis(shown, simulated=False)
    head = ("model", "joint", "held-out error %", "noise floor %", "error/floor")
    rows: list[list[Cell]] = [
        [r.step.label, joint, float(r.step.heldout.relative[j]), m.relative_floor(j), float(x)]
        for r in m.rungs
        for j, (joint, x) in enumerate(zip(m.joints, m.ratio(r.step), strict=True))
    ]
    title = f"Diagnosis: {shown.verdict}. {sentences.headline(m)}"
    values = [
        sentences.value(n, v, m.joints) for f in shown.findings for n, v in f.parameters.items()
    ]
    return Sheet(title, (*sentences.details(m), *values), head, rows)


def _parameter(name: str, v: Value, joints: tuple[str, ...] = ()) -> list[Cell]:
    said = [in_words(name, v.value, joints)]
    said += ["at its bound"] if v.at_bound else []
    said += [] if v.identifiable else ["only in combination"]
    if v.identifiable and not v.at_bound and (why := without_error(name, v)):
        said.append(f"no standard error: {why}")
    unit = "" if v.unit == "1" else v.unit
    return [name, v.value, v.stderr, unit, ", ".join(x for x in said if x)]


def _runs(result: FitResult) -> str:
    return ", ".join(dict.fromkeys(r.name for r in result.problem.recordings))


# ------------------------------------------------------------ ways to show it


def text(shown: Any) -> str:
    """Title, sentences and table, for a prompt."""
    made = sheet(shown)
    words = made.words()
    more = [f"  ... {len(words) - _MOST_ROWS} more rows"] if len(words) > _MOST_ROWS else []
    body = terminal.aligned(made.head, words[:_MOST_ROWS], made.left()) if words else ""
    return "\n".join(x for x in (made.title, *(f"  {s}" for s in made.lines), body, *more) if x)


def markup(shown: Any) -> str:
    """The same as HTML, for a notebook."""
    made = sheet(shown)
    parts = [f"<b>{elements.escape(made.title)}</b>", *(elements.paragraph(s) for s in made.lines)]
    if made.rows:
        parts.append(elements.html_table(made.head, made.words(), made.left()))
    return f"<div>{''.join(parts)}</div>"


@singledispatch
def frame(shown: Any) -> Any:
    """The table of an object as a pandas frame."""
    made = sheet(shown)
    return _pandas().DataFrame(made.rows, columns=list(made.head))


@frame.register
def _(shown: Recording) -> Any:
    """Samples, with the columns that `hil.from_arrays` and `hil import` know."""
    return _pandas().DataFrame(shown.columns())


def _pandas() -> Any:
    try:
        import pandas
    except ImportError as error:
        raise ConfigError("to_frame needs pandas: pip install 'hil-teleop[tables]'") from error
    return pandas


# ------------------------------------------------------------ figures and pages


@singledispatch
def material(shown: Any) -> Material:
    """What the report of an object is made of.

    Raises
    ------
    ConfigError
        If it has no report.
    """
    raise ConfigError(f"a {type(shown).__name__} has no report")


material.register(Diagnosis, from_diagnosis)
material.register(Comparison, from_comparison)


def figures(shown: Any) -> dict[str, Any]:
    """Figures of the report, those of the plotly library, by the name they have there.

    Raises
    ------
    ConfigError
        If nothing was fitted, so that there is nothing to draw.
    """
    m = material(shown)
    if not m.rungs:
        raise ConfigError(
            f"there is nothing to draw: the verdict is {m.verdict!r} and nothing was fitted; "
            "print the answer to see why"
        )
    named: Sequence[Finding] = (*m.findings, *m.partial)
    made = [ladder_figure(m), *view_figures(m), *spectra_figures(m), candidates_figure(m)]
    made += [effect_figure(m, f, f"effect-{k + 1}") for k, f in enumerate(named)]
    made.append(trace_figure(m))
    return {f.name: f.plotly() for f in made if f is not None}


def write(shown: Any, path: str | Path) -> Path:
    """Write the report of a diagnosis or a comparison.

    Raises
    ------
    ConfigError
        If the place is none for a report.
    """
    if not isinstance(path, str | PathLike):
        raise ConfigError(
            f"report takes the name of a file, not {type(path).__name__}; e.g. report('why.html')"
        )
    place = Path(path)
    if place.suffix.lower() != ".html":
        raise ConfigError(f"cannot write {place}: a report must end in .html")
    if not place.resolve().parent.is_dir():
        raise ConfigError(f"cannot write {place}: its folder does not exist; make it first")
    if place.exists() and not is_report(place):
        raise ConfigError(
            f"cannot write {place}: a file is there that is not a report of hil; choose another "
            "name or move it away"
        )
    (diagnosis_report if isinstance(shown, Diagnosis) else comparison_report)(shown, place)
    return place
