"""`hil diagnose`: which physical effect is missing.

Its text serves `hil improve` and `hil demo` too: verdict, findings, error ladder, ambiguity.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hil import terminal
from hil.commands import common
from hil.diagnosis import engine, verbs
from hil.diagnosis.artefacts import blurred_above
from hil.diagnosis.constants import CONFIDENT, HALF, TENTH
from hil.diagnosis.equivalence import at_issue_of, sets_of
from hil.diagnosis.floor import function_sentences
from hil.diagnosis.heldout import DIFFER
from hil.diagnosis.types import Diagnosis, Finding
from hil.diagnosis.verbs import Rung, rising
from hil.diagnosis.verdict import NO_GEOMETRY, effort_lateness, not_white, only_there
from hil.errors import plural
from hil.identify.fit import in_units
from hil.identify.multistep import MultiStep
from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.effect import VALUE_DEVIATIONS, Effect, Lines, Trait, Waves
from hil.models.model import SIGN, Value, in_words, remark
from hil.models.motion import FloatArray
from hil.models.parts import JOINT
from hil.record.checks import OF_UNITS
from hil.record.consistency import Note
from hil.record.sources import find, passed_over
from hil.report.data import (
    Files,
    add_command,
    diagnosis_json,
    from_diagnosis,
    ladder_json,
    with_files,
)
from hil.report.text import (
    ACCEPT,
    LEADING,
    TWO_ERRORS,
    corrections,
    effect_on_joint,
    ended,
    explains,
    floor_says,
    headline,
    laws,
    listed,
    next_steps,
    of_geometry,
    percent,
    remains,
    rest,
    unit_doubts,
)

#: Periods that a range must hold for a wave to be told as one.  Half: a slope over half the range
#: is a "period" that nobody saw; double: a ripple of one and a half turns is told as a change.
_PERIODS = 0.8
#: Share of the best determined coefficient's standard errors from which another one, in another
#: unit, may stand for an effect.  Double: dry friction that warms is told by its viscous part;
#: half: two coupled motors by an inertia of 2.5 standard errors beside a friction of fifty.
SURER = 0.1
SENTENCES = {
    "missing-effect": "missing-effect: the given model lacks what is named below.",
    "ambiguous": "ambiguous: an effect is missing; these data do not show which of several it is.",
    "unexplained": "unexplained: an effect is missing; none of the catalogue passes every test.",
    "not-identifiable": "not-identifiable: nothing can be concluded from these data.",
    "bad-data": "bad-data: the recording or the robot description is faulty; no fit makes sense.",
}


def text(d: Diagnosis, rungs: list[Rung], verbose: bool = False, files: Files | None = None) -> str:
    """The diagnosis for a terminal; `verbose` also explains what no motion could ever tell."""
    lines = [*_lacks(d), f"Verdict: {_of_arm(d, verdict_sentence(d))}"]
    if not d.ladder:
        return "\n".join([*lines, *dict.fromkeys(f"  {ended(w)}" for _, w in d.warnings)])
    if d.verdict == "not-identifiable":
        lines += [f"  {w}." for code, w in d.warnings if code != NO_GEOMETRY]
    else:
        lines += [f"  {w}" for w in unit_doubts(d.warnings)]
    for f in d.findings:
        lines += ["", *_finding(f, d.result.problem.joints)]
    lines += [
        f"  partial explanation: {effect_on_joint(f)} (no name: {f.reason})" for f in d.partial
    ]
    lines += _left(d) + _corrections(d, files)
    beside = set(LEADING) - {NO_GEOMETRY}
    lines += dict.fromkeys(_line(w) for code, w in d.warnings if code in beside)
    if d.verdict == "adequate":
        lines += [f"  {floor_says(d.beyond)}"]
    if d.network:
        lines += ["", "How much of the remaining error functions without a name could explain"]
        lines += [f"  - {line}" for line in function_sentences(d.network)]
    lines += ["", ladder_text(d)]
    if d.result.model.explains == "motor":
        lines += ["", multi_text(rungs)]
    lines += _apart(d, verbose)
    if d.verdict == "adequate" and d.unseen:
        lines += ["", "What this motion could not show"]
        for u in d.unseen:
            lines += [
                f"  - {replace(u, command='').text}",
                *([f"      {u.command}"] * bool(u.command)),
            ]
    notes = _notes(d)
    lines += ["", *(f"  note: {w}" for w in notes)] if notes else []
    return "\n".join(lines)


def _lacks(d: Diagnosis) -> list[str]:
    """What is said before the verdict: that the robot description is missing, and what follows."""
    return [line for code, w in d.warnings if code == NO_GEOMETRY for line in (ended(w), "")]


def _line(said: str) -> str:
    """Sentences on a line, and their commands on lines of their own."""
    return f"  {ended(said)}".replace("\n", "\n    ")


def short(d: Diagnosis, rungs: list[Rung], files: Files | None, done: bool = False) -> str:
    """The answer on one screen: verdict, names, errors before and after, what to do next.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    rungs : list of Rung
        Its ladder with both errors.
    files : Files, optional
        What it was made from, for the commands that come next.
    done : bool
        Whether the improved model is written already.
    """
    if not d.ladder or d.verdict == "not-identifiable":
        return text(d, rungs)
    m = from_diagnosis(d)
    lines = [*_lacks(d), f"Verdict: {_of_arm(d, verdict_sentence(d))}"]
    if doubtful := unit_doubts(d.warnings):
        lines += ["", *(f"  {text}" for text in doubtful)]
    if d.findings:
        shown, others = _likely(d)
        lines += ["", _names_table(d, shown)]
        open_ = d.verdict == "ambiguous"
        with_rivals = [f for f in shown if f.rivals and (open_ or f.confidence < CONFIDENT)]
        lines += [
            f"  rivals of {effect_on_joint(f)}: {', '.join(f.weighed_rivals)}" for f in with_rivals
        ]
        if others:
            names = listed([f"{effect_on_joint(f)} ({f.confidence:.2f})" for f in others])
            lines.append(f"  of less than even odds, see --verbose: {names}")
        sure = [f for f in d.findings if f.confidence >= CONFIDENT]
        noted = [(effect_on_joint(f), remark(f.effect, f.parameters)) for f in sure]
        lines += [f"  {name}: {said}" for name, said in noted if said]
        lines += _alike(d, sure)
    lines += ["", _joints_table(d, rungs)]
    said = [line.strip() for line in _left(d)[1:]]
    beside = set(LEADING) - {NO_GEOMETRY}
    said += dict.fromkeys(w for code, w in d.warnings if code in beside)
    said += _worse(rising(rungs))
    said += [f"{effect_on_joint(f)} has no name: {f.reason}" for f in d.partial if d.findings]
    if d.corrections:
        count = plural(len(d.corrections), "correction")
        said.append(f"The improved model also holds {count} without a name")
        said += laws(d.corrections, files)
    lines += ["", *map(_line, said)] if said else []
    lines += ["", "Next"]
    typed = add_command(m, files).splitlines() if files and not done else []
    commands = [f"    {line}" for line in typed]
    if rising(rungs, 1 / HALF):
        lines.append(f"  - {_NO_SIMULATION}")
    for step in next_steps(m)[:_STEPS]:
        if step.startswith(ACCEPT):
            lines += [f"  - {step.removesuffix('.')}:", *commands] if commands else []
            commands = []
        else:
            first, *typed = step.splitlines()
            lines += [f"  - {first}", *(f"    {line}" for line in typed)]
    if commands:
        lines.append(
            "  - For a model that predicts motions like these, although it names no effect:"
        )
    lines += commands
    lines.append("  - All parameters, all steps and open questions: --verbose, --report R.html")
    return "\n".join(lines)


def _alike(d: Diagnosis, sure: list[Finding]) -> list[str]:
    """Effects that act in this motion like one that is named: it may hold their part, too."""
    sets, standing = at_issue_of(d)
    lines = []
    for f in sure:
        others = [n for s in (*sets, *standing) if f.effect in s.effects for n in s.effects]
        others = [n for n in dict.fromkeys(others) if n != f.effect and n in catalogue.table()]
        if others:
            lines.append(
                f"  {effect_on_joint(f)} acts like {listed(others)} in this motion: if both act, "
                "its values include the part of both"
            )
    return lines


#: Steps that a short answer proposes.
_STEPS = 3
#: Where a name more than doubles a simulated error.
_NO_SIMULATION = (
    "Use the improved model to predict efforts, not to simulate: its simulated error is more than "
    "twice that of the model before. A longer recording may settle the values."
)


def _sure(v: Value, deviations: float) -> bool:
    """Whether the data determine a value to so many standard errors."""
    fixed = not v.identifiable or v.at_bound or not v.stderr > 0
    return not fixed and abs(v.value) > deviations * v.stderr


def _telling(f: Finding, contribution: str = "", problem: Problem | None = None) -> str:
    """The value that says how large an effect is.

    Of a function of the position what it changes over the range, of a wave its amplitude and
    period; else a coefficient that the data determine, the largest of one unit, or both of two.
    A shape (a time, a speed) stands for the size only where all coefficients are shares of one: one
    that is declared to be the size and determined, else the one of the least relative standard
    error.  Where the data determine none of these, what the effect takes off the error, in words.
    """
    if wave := _change(f, problem) or _wave(f):
        return wave
    short = {n.rpartition(".")[2]: v for n, v in f.parameters.items()}
    kind = catalogue.get(f.effect)
    instant = [p.name for p in kind.shape if p.name in short and p.unit == "s"]
    if kind.variation.sudden and instant:
        at = ", ".join(common.value_line(n, short[n]) for n in instant)
        return f"{_sized(short, kind, contribution)}, {at}"
    coded = [in_words(n, v.value) for n, v in f.parameters.items() if v.unit == "s"]
    if said := [x for x in coded if x]:  # an instant in words
        name, first = next(iter(short.items()))
        return ", ".join([common.value_line(name, first), *said])
    return _sized(short, kind, contribution)


def _sized(short: dict[str, Value], kind: Effect, contribution: str) -> str:
    """The same of what is no wave: values by their short names."""
    # a share of one says nothing of the size: that of a delay or a gap is in its shape
    own = [n for p in kind.params for n in short if n.split("[")[0] == p.name]
    sized = [n for n in own if not (n == "a" and short[n].unit == "1" and kind.shape)]
    for deviations in (VALUE_DEVIATIONS, 1.0):
        if sure := [n for n in sized if _sure(short[n], deviations)]:
            times = {n: abs(short[n].value) / short[n].stderr for n in sure}
            first = next(n for n in sure if times[n] >= SURER * max(times.values()))
            like = [n for n in sure if short[n].unit == short[first].unit]
            if like == own and len(own) == 2:  # a direction: neither part says its size alone
                return ", ".join(common.value_line(n, short[n]) for n in own)
            best = max(like, key=lambda n: abs(short[n].value))
            lasts = [p.name for p in kind.shape if p.size and p.unit == "s"]
            told = [n for n in lasts if n in short and _sure(short[n], VALUE_DEVIATIONS)]
            size_told = ", ".join(common.value_line(n, short[n]) for n in (best, *told))
            more = [n for n in _where(short, kind) if n not in told]
            return "; ".join([size_told, *(common.value_line(n, short[n]) for n in more)])
    shapes = [p for p in kind.shape if p.name in short and p.unit != "1"]
    shaped = [p.name for p in shapes]
    size = [p.name for p in shapes if p.size and _sure(short[p.name], VALUE_DEVIATIONS)]
    if not sized and (name := _surest(short, size or shaped)):
        return ", ".join([common.value_line(name, short[name]), *_in_part(short, name in size)])
    if contribution:
        return f"{contribution} rms in total; no value is determined"
    return _undetermined(short, [*sized, *shaped, *own])


def _where(short: dict[str, Value], kind: Effect) -> list[str]:
    """Shape values that a reader needs beside the size: a speed, a place, a frequency, a ratio.

    Those that the data determine, or that ended on a bound: the size then holds with that only.
    """
    own = [p for p in kind.shape if p.name in short and not (p.choice or p.tuned)]
    if kind.variation.sudden:  # its instant is told by itself
        own = [p for p in own if p.unit != "s"]
    named = [p.name for p in own if p.name != SIGN]
    told = [n for n in named if _sure(short[n], VALUE_DEVIATIONS) or short[n].at_bound]
    return told[:_SHAPES]


#: Shape values beside the size of an effect.
_SHAPES = 2


def _in_part(values: dict[str, Value], sized: bool) -> list[str]:
    """The share to which a law of that size holds, where the data say that it is not all."""
    a = values.get("a")
    if not sized or a is None or a.unit != "1" or not _sure(a, VALUE_DEVIATIONS):
        return []
    if abs(a.value - 1.0) < max(TENTH, VALUE_DEVIATIONS * a.stderr):
        return []
    return [f"a = {a.value:.3g}"]


def _surest(values: dict[str, Value], names: list[str]) -> str:
    """The value of the least relative standard error; one of a grid, which has none, comes last.

    Zero of such a one says that this part of the law is not there, and nothing of the size.
    """
    sure = [n for n in names if _sure(values[n], 1.0)]
    if sure:
        return min(sure, key=lambda n: values[n].stderr / abs(values[n].value))
    free = (n for n in names if values[n].identifiable and not values[n].at_bound)
    return next((n for n in free if values[n].value and not math.isfinite(values[n].stderr)), "")


def _undetermined(values: dict[str, Value], names: list[str]) -> str:
    """A value that the data do not determine, which the line says; empty where there is none."""
    name = next(iter([*names, *values]), "")
    line = common.value_line(name, values[name]) if name else ""
    doubtful = name and values[name].identifiable and not values[name].at_bound
    return f"{line}, undetermined" if doubtful else line


def _contribution(d: Diagnosis, f: Finding) -> str:
    """Rms effort that an effect takes off the error of its joint, with unit; empty without one."""
    joints = d.result.problem.joints
    joint = f.felt
    if joint not in joints or not f.relative_before > f.relative_after:
        return ""
    j = joints.index(joint)
    # what is explained and what is left are uncorrelated: squares add up
    share = math.sqrt(f.relative_before**2 - f.relative_after**2) / 100
    unit = "N" if d.result.problem.robot.units[j] == "m" else "N m"
    return f"{share * d.ladder[0].heldout.effort_rms[j]:.2g} {unit}"


def _wave(f: Finding) -> str:
    """Amplitude and period of the strongest harmonic of a wave; empty where it is none."""
    short = {n.rpartition(".")[2]: v for n, v in f.parameters.items()}
    kind = catalogue.get(f.effect)
    # where every run has its own coefficients, those of the first one that has both
    run = next((f"[{n.partition('[')[2]}" for n in short if "[" in n), "")
    names = [p.name + run for p in kind.params]
    number = next((p.name for p in kind.shape if p.unit in ("1/{x}", "Hz")), "")
    waves = isinstance(kind.search, Waves | Lines)
    if not waves or not names or len(names) % 2 or not {number, *names} <= set(short):
        return ""
    pairs = [(short[s], short[c]) for s, c in zip(names[::2], names[1::2], strict=True)]
    sizes = [math.hypot(s.value, c.value) for s, c in pairs]
    k = sizes.index(max(sizes))
    s, c = pairs[k]
    if not sizes[k] > 0 or not short[number].value > 0 or not (s.identifiable and c.identifiable):
        return ""
    # A = |(s, c)|,   se(A) = |(s se_s, c se_c)| / A
    error = math.hypot(s.value * s.stderr, c.value * c.stderr) / sizes[k]
    size = common.value_line(f"amplitude{run}", Value(sizes[k], error, s.unit))
    unit = short[number].unit.removeprefix("1/").replace("Hz", "s")
    return f"{size}, period = {1 / (short[number].value * (k + 1)):.4g} {unit}"


def _change(f: Finding, problem: Problem | None) -> str:
    """What an effect of one joint's position changes over the recorded range.

    Empty where it depends on more than that, where one coefficient says it, and for waves of which
    the range holds a period.
    """
    kind, values = catalogue.get(f.effect), {}
    for name, v in f.parameters.items():
        values[name.rpartition(".")[2]] = v.value
    place = _place(kind, values) if problem is not None else ""
    if problem is None or not place:
        return ""
    own = problem.joints.index(f.joint)
    k = own if place == "q" else int(values[JOINT]) - 1
    low, high = map(float, problem.span[k])
    if isinstance(kind.search, Waves) and values["p"] * (high - low) >= _PERIODS:
        return ""
    x = np.linspace(low, high, 201)
    y = _effort(kind, {**values, place: x, "v0": 1e-9, "low": low, "high": high})
    if y is None:
        return ""
    at = "" if place == "q" else f"{problem.joints[k]} = "
    unit = in_units("{x}", problem, k)
    least, most = (f"{at}{x[n]:.3g} {unit}" for n in (np.argmin(y), np.argmax(y)))
    size = f"{np.ptp(y):.3g} {in_units('{F}', problem, own)}"
    return f"changes by {size}: least at {least}, most at {most}"


def _place(kind: Effect, values: Mapping[str, float]) -> str:
    """The only position that an effect of several coefficients depends on: ``q`` or ``qk``."""
    # of effects of a position alone
    from hil.models import formula

    texts = kind.doc.formulas
    state = {n for x in texts for n in formula.names(x) & {*formula.STATE}} - {"v"}
    few = len(texts) < (2 if kind.shape else 3)
    known = {p.name for p in (*kind.params, *kind.shape)} <= set(values)
    return "".join(state) if state in ({"q"}, {"qk"}) and known and not few else ""


def _effort(kind: Effect, known: dict[str, Any]) -> FloatArray | None:
    """Effort of an effect in forward motion; None where it depends on the speed."""
    from hil.models import formula

    slow, fast = (
        sum(known[p.name] * c for p, c in zip(kind.params, columns, strict=True))
        for columns in (formula.evaluated(kind.doc.formulas, {**known, "v": v}) for v in (1.0, 2.0))
    )
    return np.asarray(slow) if np.array_equal(slow, fast) else None


#: Names that a short answer lists before it puts those of less than even odds into one line.
_NAMES = 3


def _likely(d: Diagnosis) -> tuple[list[Finding], list[Finding]]:
    """Findings of a short answer, and those that are hardly names beside sure ones."""
    many = len(d.findings) > _NAMES and any(f.confidence >= CONFIDENT for f in d.findings)
    doubtful = [f for f in d.findings if many and f.confidence < HALF]
    return [f for f in d.findings if f not in doubtful], doubtful


def _names_table(d: Diagnosis, shown: list[Finding] | None = None) -> str:
    """Effects that were found, a row each, with the value that tells their size.

    The values stand below it where the terminal is too narrow for them.
    """
    rows, joints = [], d.result.problem.joints
    shown = d.findings if shown is None else shown
    for f in shown:
        value = _late(d, f) or _telling(f, _contribution(d, f), d.result.problem)
        rows.append(
            [
                f"{effect_on_joint(f)}{OR_A_RIVAL * _is_less_likely(f)}",
                f"{f.confidence:.2f}",
                f"{f.relative_before:.2f} -> {f.relative_after:.2f}",
                percent(f.excess_explained),
                "; ".join([value, *(x for x in _forms(f, joints) if x not in value)]),
            ]
        )
    head = ["missing effect", "confidence", "error %", "explains %", "value"]
    table, notes = terminal.aligned(head, rows, (0, 4), None), list[str]()
    if max(map(len, table.splitlines())) > (terminal.width() or math.inf):
        table = terminal.table(head[:-1], [row[:-1] for row in rows], (0,))
        notes = [f"{row[0]}: {row[-1]}" for row in rows]
    notes += [ERROR_LEGEND] if any(_later(d, f) for f in shown) else []
    notes += [EXPLAINS] if any(f.excess_explained < OF_ALL for f in shown) else []
    return "\n  ".join([table, *notes])


#: What stands behind a name that the model holds although a rival of it is likelier.
OR_A_RIVAL = ", or a rival"


def _is_less_likely(f: Finding) -> bool:
    """Whether a rival of a name has more weight than the name itself."""
    return bool(f.rivals) and max(f.rival_weights, default=0.0) > f.confidence


def _late(d: Diagnosis, f: Finding) -> str:
    """How late an effort acts, of an effect that surely makes it late; else empty.

    Recorded efforts are values of an instant or averages over a sample: half a sample lies between
    these where no reversal shows which.
    """
    if Trait.LATE not in catalogue.get(f.effect).traits:
        return ""
    problem = d.result.problem
    apart = 0.0 if problem.of_instants else 0.5 / min(problem.sources)
    v = effort_lateness(f, apart)
    if not v.stderr < abs(v.value):
        return ""
    return f"late by {1e3 * v.value:.3g} +- {1e3 * v.stderr:.2g} ms"


def _later(d: Diagnosis, f: Finding) -> bool:
    """Whether an effect's first error is another one than that of the given model."""
    joints, joint = d.result.problem.joints, f.felt
    if joint not in joints:
        return False
    given = float(d.ladder[0].heldout.relative[joints.index(joint)])
    return f"{given:.2f}" != f"{f.relative_before:.2f}"


#: Share of all that is to be explained below which the answer says of what it is one.
OF_ALL = 0.01
ERROR_LEGEND = (
    "error %: of the model without and with the effect, and with all that was added before it; the "
    "first error of the table below is that of the given model"
)
EXPLAINS = (
    "explains %: share of the squared error above the noise floor before any effect was added; "
    "the share of a later effect may therefore be small"
)


def _forms(f: Finding, joints: tuple[str, ...]) -> list[str]:
    """Words for the chosen form of an effect's law: of what it is a function, what it couples."""
    of = {n.rpartition(".")[2]: (n, v) for n, v in f.parameters.items()}
    named = [of[p.name] for p in catalogue.get(f.effect).shape if p.choice and p.name in of]
    words = [in_words(n, v.value, joints) for n, v in named]
    return [w for w in words if w]


def _joints_table(d: Diagnosis, rungs: list[Rung]) -> str:
    """Held-out error of the given and of the improved model, a row a joint."""
    first, last = d.ladder[0].heldout, d.ladder[-1].heldout
    size = last.effort_rms
    simulated = _cells(rungs[0].multi_step), _cells(rungs[-1].multi_step)
    grew = len(d.ladder) > 1
    rows = []
    for j, name in enumerate(d.result.problem.joints):
        errors = [f"{first.relative[j]:.2f}", *([f"{last.relative[j]:.2f}"] if grew else [])]
        ratio = f"{last.rms[j] / d.noise[j]:.2f}"
        row = [name, *errors, f"{100 * d.noise[j] / max(size[j], 1e-300):.2f}", ratio]
        if not size[j]:  # no effort was recorded
            row[1:] = ["-"] * len(row[1:])
        if d.result.model.explains == "motor":
            ends = simulated if grew else simulated[:1]
            row.append(" -> ".join("diverged" if s[j] == "-" else s[j] for s in ends))
        rows.append(row)
    head = ["joint", "error %", *(["improved %"] if grew else []), "floor %", "error/floor"]
    if d.result.model.explains == "motor":
        head.append("simulated %")
        said = TWO_ERRORS.format(horizon=rungs[0].multi_step.horizon)
        return f"{terminal.table(head, rows)}\n  {said}"
    return terminal.table(head, rows)


def _worse(lines: list[str]) -> list[str]:
    """Warnings of the simulated error, one for all where there are several."""
    if len(lines) < 2:
        return lines
    return [f"{lines[0]}; and {plural(len(lines) - 1, 'warning')} of this kind (--verbose)"]


def _left(d: Diagnosis) -> list[str]:
    """What all that was named leaves."""
    left = remains(from_diagnosis(d, simulated=False))
    return ["", f"  {left}"] if left else []


def _corrections(d: Diagnosis, files: Files | None) -> list[str]:
    """What the improved model holds without a name."""
    said = [corrections(d.corrections), *laws(d.corrections, files)] if d.corrections else []
    return ["", *map(_line, said)] if said else []


def _of_arm(d: Diagnosis, sentence: str) -> str:
    """The verdict with the arm of the rig; as it is where a recording says only that it is one."""
    arm = d.result.problem.recordings[0].arm if d.ladder else ""
    return sentence if arm in ("", "arm") else f"{sentence.removesuffix('.')} (arm {arm})."


def verdict_sentence(d: Diagnosis) -> str:
    """The verdict as a sentence."""
    if d.verdict == "adequate" and any(code == DIFFER for code, _ in d.warnings):
        return (
            "adequate for the fitted data: the model explains them down to the noise floor, but "
            "not the held-out data."
        )
    if d.verdict == "unexplained" and only_there(d.ladder[-1], d.last, d.noise):
        which = "the model" if len(d.ladder) == 1 else "the improved model"
        return (
            f"unexplained: {which} explains the fitted data down to the noise floor, but not the "
            "held-out data."
        )
    if d.verdict == "adequate":
        error = d.ladder[-1].heldout.rms / d.noise
        ratio = dict(zip(d.result.problem.joints, error.tolist(), strict=True))
        blurred = blurred_above(d.warnings, ratio)
        most = max(ratio.values())
        return f"adequate: {explains(blurred, 'the model', most, not_white(d.warnings))}"
    if d.verdict == "ambiguous" and of_geometry(d.findings):
        said = headline(from_diagnosis(d, simulated=False))
        return f"ambiguous: {said[0].lower()}{said[1:]}"
    if d.verdict == "unexplained" and d.ladder:
        said = headline(from_diagnosis(d, simulated=False))
        return f"unexplained: {said[0].lower()}{said[1:]}"
    if d.verdict == "missing-effect":
        return f"{SENTENCES[d.verdict]}{rest(from_diagnosis(d, simulated=False))}"
    return SENTENCES[d.verdict]


def _notes(d: Diagnosis) -> list[str]:
    """Warnings that were not said above, in words."""
    if d.verdict == "not-identifiable":
        return []
    shown = {n for f in d.findings for n in f.parameters}
    return [
        text
        for code, text in d.warnings
        if not code.startswith("impossible")
        and code not in LEADING
        and code not in OF_UNITS
        and not (code == "at-bound" and text.split()[1] in shown)
    ]


def _apart(d: Diagnosis, verbose: bool) -> list[str]:
    """Sets that the data cannot tell apart; one line for those that no answer of this was about."""
    sets, standing = at_issue_of(d)
    if verbose:
        sets, standing = [*sets, *standing], []
    lines = ["", "What these data cannot tell apart"] if sets else []
    told = [
        f"  - {' / '.join(s.effects)}: {s.why}. Would show it: {s.experiment}."
        + (f"\n      {s.command}" if s.command else "")
        for s in sets
    ]
    lines += dict.fromkeys(told)
    if standing:
        pairs = "; ".join(f"{s.effects[0]} from {', '.join(s.effects[1:])}" for s in standing)
        lines += ["", f"  not separable by motion alone: {pairs} (details: --verbose)"]
    return lines


def _finding(f: Finding, joints: tuple[str, ...]) -> list[str]:
    lines = [
        f"  {effect_on_joint(f)}  (confidence {f.confidence:.2f})",
        f"    held-out error {f'of {f.felt_on} ' if f.felt_on else ''}{f.relative_before:.2f} % -> "
        f"{f.relative_after:.2f} % "
        f"(standard error {f.se:.2g}); explains {percent(f.excess_explained)} % of the squared "
        "error above the noise floor",
    ]
    lines += [f"    {common.value_line(name, v, joints)}" for name, v in f.parameters.items()]
    if said := remark(f.effect, f.parameters):
        lines.append(f"    {said}")
    if caveat := catalogue.get(f.effect).doc.caveat:
        lines.append(f"    read with care: {caveat}")
    if f.rivals:
        lines.append(f"    rivals with this motion: {', '.join(f.weighed_rivals)}")
    return lines


def ladder_text(d: Diagnosis) -> str:
    """Error ladder: held-out rms error over the noise floor, by joint."""
    joints = d.result.problem.joints
    rows = [(s.label, [_two(s.heldout.relative), _two(s.heldout.rms / d.noise)]) for s in d.ladder]
    with np.errstate(divide="ignore", invalid="ignore"):  # a motor that never moved
        floor = 100 * d.noise / d.ladder[-1].heldout.effort_rms
    rows.append(("noise floor", [_two(floor), _two(np.ones(len(joints)))]))
    band = d.result.problem.rates.effort
    return terminal.of_joints("held-out error", joints, rows, ("%", "over floor")) + (
        f"\n  Errors are of efforts up to {band:.3g} Hz. The band follows the fitted motion: "
        "compare "
        "two reports only if their bands are equal."
    )


def _two(values: Iterable[float]) -> list[str]:
    return [f"{x:.2f}" for x in values]


def _cells(m: MultiStep) -> list[str]:
    return ["-"] * len(m.relative) if m.lost else _two(m.relative)


def _closed(m: MultiStep) -> list[str]:
    return ["-"] * len(m.relative) if m.closed_loop is None else _cells(m.closed_loop)


def multi_text(rungs: list[Rung]) -> str:
    """Simulated error of the same ladder: of the position, by joint."""
    first = rungs[0]
    joints = first.step.result.problem.joints
    replay = first.multi_step.closed_loop is not None
    rows = [
        (r.step.label, [_cells(r.multi_step), *([_closed(r.multi_step)] if replay else [])])
        for r in rungs
    ]
    what = f"simulated error, {first.multi_step.horizon:g} s"
    meaning = "rms error of the simulated position, in % of its motion; starts from measured states"
    meaning += "; replay: longer windows with a 1 Hz servo" if replay else ""
    kinds = ("%", "replay %") if replay else ("%",)
    lines = [terminal.of_joints(what, joints, rows, kinds), f"  {meaning}"]
    for r in rungs:
        m = r.multi_step
        if m.diverged:
            lines.append(
                f"  {r.step.label}: {m.diverged} of {m.windows} simulations left the recorded range"
                f"{': no simulated error' if m.lost else ' and are not counted'}"
            )
    return "\n".join(lines)


EXAMPLE = "hil diagnose run.mcap --model arm.toml --holdout other.mcap --report why.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    common.add_sessions(parser)
    common.add_output(parser, "M2.toml", "the improved model, as hil improve does")
    common.add_report(parser)
    add_verbose(parser)
    add_groups(parser)


def add_groups(parser: argparse.ArgumentParser) -> None:
    """Options of many sessions."""
    group = parser.add_argument_group("many sessions")
    group.add_argument(
        "--by",
        choices=("robot", "folder", "session"),
        help="what is diagnosed together: all sessions of a robot (default), those of a robot in "
        "one folder, or each session alone; subfolders are searched, too",
    )
    common.add_workers(group)
    group.add_argument(
        "--keep",
        metavar="FOLDER",
        help="keep every finished answer in this folder; a session with an answer there is skipped",
    )


def add_verbose(parser: argparse.ArgumentParser) -> None:
    """--verbose."""
    parser.add_argument(
        "--verbose",
        action="store_true",
        help="the whole answer: parameters, every step, what the data cannot tell apart",
    )


def run(args: argparse.Namespace) -> int:
    """Diagnose and print: one robot's sessions together, those of several group by group."""
    if _many(args):
        from hil.commands import many_sessions  # only where there may be several

        found = many_sessions.session_groups(args)
        if many_sessions.several(args, found):
            return many_sessions.run_groups(args, found, group_answer)
    return concluded(args)


def concluded(args: argparse.Namespace) -> int:
    """Diagnose sessions of one robot, print, and write the improved model where that is asked."""
    runs, held, model = common.load_inputs(args)
    result = engine.diagnose(runs, model, held)
    # an unexplained excess leaves the model as it was; bad data leave none
    written = args.output if result.ladder else None
    if written:
        common.save_model(result.model, written)
    show(args, result)
    if written and not args.json:
        terminal.out(f"{_what_is_written(result)}: {written}")
        for f in result.findings:
            if f.confidence < CONFIDENT:
                names = " or ".join([f"{f.effect} on {f.joint or 'the robot'}", *f.rivals])
                why = "these data fit either" if f.rivals else f.reason
                terminal.out(f"  not settled: {names}; {why}")
    return code(result)


def _what_is_written(result: Diagnosis) -> str:
    """What the model is beside the given one."""
    if result.findings:
        return "improved model"
    more = len(result.model.effects) > len(result.ladder[0].result.model.effects)
    return "improved model, what it adds has no sure name" if more else "model, refitted"


def _many(args: argparse.Namespace) -> bool:
    """Whether there may be several groups: what one path means is not looked at twice."""
    asked = bool(args.by or args.cluster or args.keep)
    for text in () if args.by else passed_over(args.sessions):
        terminal.log(text)
    return asked or len(find([*args.sessions, *args.holdout])) > 1


def group_answer(args: argparse.Namespace) -> dict[str, Any]:
    """JSON and short answer of one group of sessions, see `hil.commands.many_sessions`."""
    runs, held, model = common.load_inputs(args)
    result = engine.diagnose(runs, model, held)
    rungs = verbs.ladder(result)
    if result.ladder:
        _as_typed(result, args)
    files = Files(
        tuple(args.typed),
        tuple(args.holdout),
        args.model or "",
        args.arm or "",
        common.bag_words(args),
    )
    return {
        "diagnosis": _json(result, rungs, rising(rungs)),
        "text": short(result, rungs, files),
    }


def show(args: argparse.Namespace, result: Diagnosis) -> None:
    """Report, then JSON or text, of a diagnosis with both errors of every rung."""
    rungs = verbs.ladder(result)
    if result.ladder:
        _as_typed(result, args)
    worse = rising(rungs)
    common.deliver(
        args,
        lambda path: _report(args, result, path),
        lambda: _json(result, rungs, worse),
        lambda: _words(args, result, rungs),
    )


def _of_files(note: tuple[str, str], files: Files) -> tuple[str, str]:
    """A note with the files that were analysed in the commands that it proposes."""
    said = with_files(note[1], files)
    return note.saying(said) if isinstance(note, Note) else (note[0], said)


def _as_typed(d: Diagnosis, args: argparse.Namespace) -> None:
    """Let the commands that are proposed be of the recordings and the model that were analysed."""
    files = _files(args)
    d.warnings = [_of_files(n, files) for n in d.warnings]
    files = replace(files, sessions=(str(find(args.sessions)[0]),))  # a motion is of one of them
    d.unseen = [replace(u, command=with_files(u.command, files)) for u in d.unseen]
    d.sets = [replace(s, command=with_files(s.command, files)) for s in sets_of(d)]


def _words(args: argparse.Namespace, result: Diagnosis, rungs: list[Rung]) -> str:
    """The answer for a terminal: one screen, or everything."""
    if not args.verbose:
        return short(result, rungs, _files(args), bool(getattr(args, "output", None)))
    whole = text(result, rungs, True, _files(args))
    return "\n".join([whole, *(f"  warning: {w}" for w in rising(rungs))])


def _files(args: argparse.Namespace) -> Files:
    """What was analysed, as it was typed."""
    more = common.bag_words(args)
    known = (args.model or "", args.arm or "", more, str(getattr(args, "output", None) or ""))
    return Files(tuple(args.sessions), tuple(args.holdout), *known)


def code(result: Diagnosis) -> int:
    """Exit code: 2 where the recording has faults and nothing was fitted."""
    return 2 if result.verdict == "bad-data" else 0


def _json(result: Diagnosis, rungs: list[Rung], worse: list[str]) -> dict[str, Any]:
    """The diagnosis with its ladder and the warnings of the simulated error."""
    data = diagnosis_json(result)
    more = [{"code": "multi-step", "text": w} for w in worse]
    return {
        **data,
        "warnings": [*data["warnings"], *more],  # type: ignore[misc]
        "ladder": ladder_json(rungs),
    }


def _report(args: argparse.Namespace, result: Diagnosis, path: str) -> None:
    from hil.report.html import diagnosis_report

    diagnosis_report(result, path, _files(args))
