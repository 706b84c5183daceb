"""The report: one self-contained HTML file about a comparison or a diagnosis."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hil.diagnosis.equivalence import at_issue, concerned
from hil.diagnosis.residuals import Region, nowhere, that_matter
from hil.diagnosis.types import Diagnosis, Indistinguishable
from hil.diagnosis.verbs import Comparison, Rung, rising
from hil.identify.design import head
from hil.models import catalogue
from hil.models.effect import Trait
from hil.models.model import Value, in_words, remark, without_error
from hil.record.checks import OF_UNITS
from hil.record.recording import Recording
from hil.report import text
from hil.report.data import (
    COMPARED,
    Files,
    Material,
    add_command,
    from_comparison,
    from_diagnosis,
    readable_number,
)
from hil.report.effects import effect_figure
from hil.report.elements import (
    document,
    escape,
    expandable,
    html_table,
    items,
    paragraph,
    section,
    typeset,
    verdict_box,
    warnings,
)
from hil.report.figures import (
    candidates_figure,
    candidates_table,
    ladder_figure,
    spectra_figures,
    trace_figure,
    view_figures,
)
from hil.report.text import LEADING
from hil.revision import source_revision
from hil.userfile import write_text

#: What the title of every report ends in, and where it stands at the latest [byte].
_TITLE, _HEAD = "of a robot model with measurements", 4096

# ------------------------------------------------------------ report


def comparison_report(comparison: Comparison, path: str | Path) -> None:
    """Write the report of a comparison.

    Parameters
    ----------
    comparison : Comparison
        Model against measurement.
    path : str or Path
        HTML file to write.
    """
    _write(from_comparison(comparison), path)


def diagnosis_report(diagnosis: Diagnosis, path: str | Path, files: Files | None = None) -> None:
    """Write the report of a diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
        Verdict, findings and what they rest on.
    path : str or Path
        HTML file to write.
    files : Files, optional
        Where the data and the model are, for the commands that the report suggests.
    """
    _write(from_diagnosis(diagnosis), path, files)


def is_report(path: Path) -> bool:
    """Whether a file is a report of `hil`, or empty."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD).decode("utf-8", "replace")
    except OSError:
        return False
    return not head.strip() or f" {_TITLE}</title>" in head


def _write(m: Material, path: str | Path, files: Files | None = None) -> None:
    kind = "Comparison" if m.verdict == COMPARED else "Diagnosis"
    title = f"{kind} {_TITLE}"
    body = f"<h1>{escape(title)}</h1>" + top(m, files)
    if m.rungs:
        body += "".join(
            (_ladder(m), _fails(m), _tried(m), _effects(m), traces(m), _parameters(m), _further(m))
        )
    body += provenance(m)
    write_text(path, document(title, body, figures=bool(m.rungs)))


def top(m: Material, files: Files | None = None) -> str:
    """Headline, what it rests on, what to do next."""
    box = verdict_box(text.headline(m), text.details(m, files), text.tone(m))
    lines_to_type = add_command(m, files)
    pre = f"<pre>{escape(lines_to_type)}</pre>" if lines_to_type else ""
    after = f'<div class="next"><b>What to do next</b>{items(text.next_steps(m))}{pre}</div>'
    return box + after


def _ladder(m: Material) -> str:
    """Errors of every model beside the noise floor."""
    judged = (
        "sessions that were not fitted"
        if m.before.heldout.kind == "holdout"
        else "many short blocks of the same sessions, each predicted from the others"
    )
    note = (
        f"Errors are rms residual over rms measured effort on {judged}; in brackets the multiple "
        "of the noise floor."
    )
    simulated = "" if m.external else paragraph(text.BOTH_ERRORS, "note")
    return section(
        "Error ladder",
        ladder_figure(m).html(),
        _numbers(m),
        paragraph(note, "note"),
        simulated,
        paragraph(text.origin(m), "note"),
        warnings(_alarms(m)),
    )


def _numbers(m: Material) -> str:
    """Both errors of every model; one column a joint, or one row where there are many."""
    rows = [["model", *m.joints], *(_errors(m, r) for r in m.rungs)]
    floor = [f"{readable_number(m.relative_floor(j))} %" for j in range(len(m.joints))]
    rows.append(["noise floor", *floor])
    for r in [] if m.external else m.rungs:
        cells = [_simulated(float(x)) for x in r.multi_step.relative]
        rows.append([f"simulated, {r.step.label}", *cells])
        if r.multi_step.closed_loop is not None:
            cells = [_simulated(float(x)) for x in r.multi_step.closed_loop.relative]
            rows.append([f"closed-loop replay, {r.step.label}", *cells])
    if len(m.joints) <= 4:
        return html_table(rows[0], rows[1:], strong=[len(m.rungs) - 1])
    turned = [list(column) for column in zip(*rows, strict=True)]
    return html_table(["joint", *turned[0][1:]], turned[1:])


def _errors(m: Material, r: Rung) -> list[str]:
    both = zip(r.step.heldout.relative, m.ratio(r.step), strict=True)
    return [r.step.label, *(text.cell(float(x), float(f)) for x, f in both)]


def _alarms(m: Material) -> list[str]:
    """Where the simulated motion gets worse or leaves the recorded range."""
    if m.external:
        return []
    diverged = [
        f"{r.step.label}: {r.multi_step.diverged} of {r.multi_step.windows} simulations left the "
        "recorded range" + (": no simulated error" if r.multi_step.lost else " and are not counted")
        for r in m.rungs
        if r.multi_step.diverged
    ]
    return [*rising(m.rungs), *diverged]


def _fails(m: Material) -> str:
    """Views of the residual, strongest regions as sentences."""
    first = _strongest(that_matter(m.before.result, m.last.floor), 6)
    none = f"{nowhere(m.before.result.problem)}."
    text = items(first) if first else paragraph(none.capitalize())
    several = len(m.rungs) > 1
    lead = "Before any effect was added, strongest first:" if several else "Strongest first:"
    parts = [paragraph(lead) if first else "", text]
    if several:
        left = _strongest(that_matter(m.after.result, m.last.floor), 5)
        nothing = f"With the added effects: {none}"
        parts.append(paragraph("Left over with all added effects:" if left else nothing))
        parts.append(items(left))
    figures = [f.html() for f in (*view_figures(m), *spectra_figures(m))]
    return section("Where the model fails", *parts, _network(m), *figures)


def _network(m: Material) -> str:
    """What any function of a few variables could explain of what is left."""
    if not m.network:
        return ""
    note = (
        "Share of the error above the noise floor that a wavelet network of these variables "
        "explains on left-out blocks of time. It was fitted beside the last model."
    )
    rows = [[s.joint, s.feature.removeprefix("network: "), f"{s.share:.0%}"] for s in m.network]
    lead = paragraph("How much of the remaining error functions of these variables could explain:")
    return lead + html_table(["joint", "variables", "share"], rows) + paragraph(note, "note")


def _strongest(found: dict[str, list[Region]], most: int) -> list[str]:
    places = sorted((r for some in found.values() for r in some), key=lambda r: -r.strength)
    return [r.text for r in places[:most]]


def _tried(m: Material) -> str:
    return "" if m.verdict == "not-identifiable" else candidates(m)


def candidates(m: Material) -> str:
    """What was tried, what stands out, what cannot be tested."""
    listed = candidates_table(m)
    note = (
        "chi2: fall of the squared residual in units of the noise. Penalty: for the number of "
        "parameters. p value: chance that noise alone makes any candidate look "
        "this good (0.0025 is the least that the test can show). "
        "Imitated: the share of the effect that the first model can imitate. Only "
        "the rest counts. Highlighted: accepted effects. After each accepted effect the "
        "others were tried again."
    )
    never = [f"{name}: {why}" for name, why in m.first.impossible]
    tail = paragraph("Not testable with these data:") + items(never) if never else ""
    figure = candidates_figure(m)
    body = (figure.html() if figure else "") + listed + paragraph(note, "note")
    return section("Candidates", body if listed else paragraph("None was tried."), tail)


def _effects(m: Material) -> str:
    """Each learnt effect over the data."""
    parts = []
    for k, f in enumerate((*m.findings, *m.partial)):
        figure = effect_figure(m, f, f"effect-{k + 1}")
        if not figure:
            continue
        effect = catalogue.get(f.effect)
        parts.append(f"<h3>{escape(text.effect_on_joint(f))}</h3>")
        parts.append(paragraph(f"{text.meaning(f.effect)}."))
        parts.append(f'<p class="equation">{typeset(effect.doc.equation)}</p>')
        values = [text.value(n, v, m.joints) for n, v in f.parameters.items()]
        said = remark(f.effect, f.parameters)
        parts += [items([*values, *([said] if said else [])]), figure.html()]
        parts += (
            [paragraph(f"Read with care: {effect.doc.caveat}.", "note")]
            if effect.doc.caveat
            else []
        )
        parts.append(paragraph(f"Source: {effect.doc.source}.", "note"))
    return section("The learnt effect over the data", *parts)


def traces(m: Material) -> str:
    """Measured against predicted."""
    return section("Measured and predicted effort", trace_figure(m).html())


def _percent(x: float) -> str:
    """A share for people; a dash where there is none."""
    return f"{readable_number(x)} %" if math.isfinite(x) else "-"


#: Simulated error [%] from which on it is no size of anything.
DIVERGED = 1000.0


def _simulated(x: float) -> str:
    """A simulated error for people."""
    return _percent(x) if not x > DIVERGED else "diverged"


# ------------------------------------------------------------ what cannot be told apart


def _further(m: Material) -> str:
    """What the data cannot tell apart, and which motion would."""
    parts = []
    named = [(f.effect, f.rivals, f.confidence) for f in (*m.findings, *m.partial)]
    sets, standing = at_issue(m.sets, concerned(named, m.first, m.last))
    if sets:
        parts.append(_sets(sets))
    elif m.verdict != COMPARED:
        parts.append(paragraph("No two of the plausible effects coincide with this motion."))
    if m.unseen:
        parts += [paragraph("What this motion could not show:"), items([u.text for u in m.unseen])]
    steps = [f"{f.effect}: {text.shown_by(f.effect)}" for f in (*m.findings, *m.partial)]
    if steps:
        parts += [paragraph("What to measure next, to confirm each effect:"), items(steps)]
    notes = [
        text
        for code, text in m.warnings
        if m.verdict != "not-identifiable"
        and not code.startswith("impossible")
        and code not in LEADING
        and code not in OF_UNITS
    ]
    if notes:
        parts += ["<h3>Notes</h3>", items(notes)]
    if standing:
        names = "; ".join(f"{s.effects[0]} from {', '.join(s.effects[1:])}" for s in standing)
        parts.append(expandable(f"No motion alone tells apart: {names}", _sets(standing)))
    return section("What these data cannot tell apart, and what to measure next", *parts)


def _sets(sets: list[Indistinguishable]) -> str:
    rows = [
        [" / ".join(s.effects), s.why, ": ".join(x for x in (s.experiment, s.command) if x)]
        for s in sets
    ]
    return html_table(["effects", "why", "motion that would show it"], rows, (0, 1, 2))


#: Metadata of a session worth printing.
KEYS = ("rig", "package_version", "git_revision", "git_dirty", "seed", "clock", "rate_hz")
#: More rigid-body parameters than this are folded away.
FOLD_FROM = 4


# ------------------------------------------------------------ parameters and provenance


def _parameters(m: Material) -> str:
    """Values with unit, standard error and flags; what was added first, rigid body folded."""
    new = m.after.result.values
    added = [n for f in (*m.findings, *m.partial) for n in f.parameters if n in new]
    added = list(dict.fromkeys(added))
    terms = m.after.result.terms
    bodies = tuple(f"{head(t.effect, t.joint)}." for t in terms if Trait.BODY in t.effect.traits)
    rigid = [n for n in new if n.startswith(bodies) and n not in added]
    if len(rigid) <= FOLD_FROM:
        rigid = []
    plain = [n for n in new if n not in added and n not in rigid]
    main = _values(m, [*added, *plain], len(added))
    rest = expandable(f"{len(rigid)} rigid-body parameters", _values(m, rigid, 0)) if rigid else ""
    note = (
        "Standard errors allow for residuals that are correlated in time. 'Only in combination': "
        "these data determine it only together with other parameters; its own value means nothing."
    )
    title = "Parameters of the final model" if len(m.rungs) > 1 else "Parameters of the model"
    return section(title, main, rest, paragraph(note, "note"))


def _values(m: Material, names: list[str], strong: int) -> str:
    """Table of some parameters; the column of the first model only where there is a second."""
    old, new = m.before.result.values, m.after.result.values
    several = len(m.rungs) > 1
    head = ["parameter", "value", "standard error", "unit", "remarks"]
    rows = [_row(n, new[n], m.joints) for n in names]
    if several:
        head.append("in the first model")
        first = [readable_number(old[n].value, 4) if n in old else "" for n in names]
        rows = [[*row, x] for row, x in zip(rows, first, strict=True)]
    return html_table(head, rows, (0, 3, 4), range(strong)) if rows else ""


def _row(name: str, v: Value, joints: tuple[str, ...]) -> list[str]:
    said = in_words(name, v.value, joints)
    remarks = [said] if said else []
    if v.at_bound:
        remarks.append("at its bound")
    if not v.identifiable:
        remarks.append("only in combination")
    if v.identifiable and not v.at_bound and (why := without_error(name, v)):
        remarks.append(f"no standard error: {why}")
    unit = "" if v.unit == "1" else v.unit
    return [
        name,
        readable_number(v.value, 4),
        readable_number(v.stderr, 2),
        unit,
        ", ".join(remarks),
    ]


def provenance(m: Material) -> str:
    """Sessions, band, versions."""
    rows = program_rows()
    if m.rungs:
        problem, held = m.problem, m.before.heldout
        rows.append(["arm", ", ".join(dict.fromkeys(r.arm for r in problem.recordings))])
        rows.append(["robot", problem.source.preset or "from URDF"])
        rows.append(["explained", "external effort (contact)" if m.external else "motor effort"])
        rates = problem.rates
        rows.append(
            [
                "filter",
                f"zero phase; positions up to {rates.position:.3g} Hz, effort and "
                f"every column of the model up to {rates.effort:.3g} Hz; "
                f"evaluated at {problem.rate:.4g} Hz",
            ]
        )
        rows += [[f"fitted: {r.name}", _run(r)] for r in problem.recordings]
        other = held.kind == "holdout"
        judged = ", ".join(held.names) if other else "blocks of the fitted sessions"
        rows.append(["judged on", judged or "other sessions"])
    return section("Provenance", html_table(["", ""], rows, (0, 1)))


def _run(r: Recording) -> str:
    text = f"{r.n} samples, {r.t[-1] - r.t[0]:.4g} s at {r.rate:.4g} Hz"
    known = {k: r.metadata.get(f"session.{k}", r.metadata.get(k, "")) for k in KEYS}
    return "; ".join([text, *(f"{k.replace('_', ' ')} {v}" for k, v in known.items() if v)])


def program_rows() -> list[list[str]]:
    """Rows on the program that writes a page: day, version, revision of its source."""
    revision, dirty = source_revision()
    changed = ", with changes" if dirty == "true" else ""
    day = f"{datetime.now(UTC):%Y-%m-%d}"
    source = [] if revision == "unknown" else [["revision", revision[:12] + changed]]
    return [["written", day], ["package", f"hil-teleop {_version()}"], *source]


def _version() -> str:
    try:
        return version("hil-teleop")
    except PackageNotFoundError:
        return "(not installed)"
