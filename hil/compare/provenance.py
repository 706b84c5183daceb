"""Parameters of the final model, and where the numbers of a report come from."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from hil.compare.material import Material
from hil.compare.page import folded, number, paragraph, section, table
from hil.models.model import Value
from hil.models.told import in_words, without_error
from hil.record.recording import Recording

#: Metadata of a session worth printing.
KEYS = ("rig", "package_version", "git_revision", "git_dirty", "seed", "clock", "rate_hz")


#: More rigid-body parameters than this are folded away.
FOLD = 4


def parameters(m: Material) -> str:
    """Values with unit, standard error and flags; what was added first, rigid body folded."""
    new = m.after.result.values
    added = [n for f in (*m.findings, *m.partial) for n in f.parameters if n in new]
    added = list(dict.fromkeys(added))
    rigid = [n for n in new if n.startswith("rigid-body") and n not in added]
    if len(rigid) <= FOLD:
        rigid = []
    plain = [n for n in new if n not in added and n not in rigid]
    main = _values(m, [*added, *plain], len(added))
    rest = folded(f"{len(rigid)} rigid-body parameters", _values(m, rigid, 0)) if rigid else ""
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
        first = [number(old[n].value, 4) if n in old else "" for n in names]
        rows = [[*row, x] for row, x in zip(rows, first, strict=True)]
    return table(head, rows, (0, 3, 4), range(strong)) if rows else ""


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
    return [name, number(v.value, 4), number(v.stderr, 2), unit, ", ".join(remarks)]


def provenance(m: Material) -> str:
    """Sessions, band, versions."""
    rows = [["package", f"hil-teleop {_version()}"]]
    if m.rungs:
        problem, held = m.problem, m.before.heldout
        rows.append(["arm", ", ".join(dict.fromkeys(r.arm for r in problem.recordings))])
        rows.append(["robot", problem.source.preset or "from URDF"])
        rows.append(["explained", "external effort (contact)" if m.external else "motor effort"])
        rates = problem.rates
        rows.append([
            "filter", f"zero phase; positions up to {rates.position:.3g} Hz, effort and every "
            f"column of the model up to {rates.effort:.3g} Hz; evaluated at {problem.rate:.4g} Hz",
        ])  # fmt: skip
        rows += [[f"fitted: {r.name}", _run(r)] for r in problem.recordings]
        other = held.kind == "holdout"
        judged = ", ".join(held.names) if other else "contiguous fifths of the fitted sessions"
        rows.append(["judged on", judged or "other sessions"])
    return section("Provenance", table(["", ""], rows, (0, 1)))


def _run(r: Recording) -> str:
    text = f"{r.n} samples, {r.t[-1] - r.t[0]:.4g} s at {r.rate:.4g} Hz"
    known = {k: r.metadata.get(f"session.{k}", r.metadata.get(k, "")) for k in KEYS}
    return "; ".join([text, *(f"{k.replace('_', ' ')} {v}" for k, v in known.items() if v)])


def _version() -> str:
    try:
        return version("hil-teleop")
    except PackageNotFoundError:
        return "(not installed)"
