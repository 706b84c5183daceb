"""Model card: what was identified from which runs, where it holds, how sure it is, what it misses.

It says what stands in the model file, and with recordings what those show of it.  What nobody
measured is said to be unknown.
"""

from __future__ import annotations

import hashlib
import math
import platform
import re
from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version

from hil.diagnosis.verbs import Comparison, compare
from hil.errors import printable
from hil.export.target import Job, Made
from hil.models import catalogue
from hil.models.model import Value, in_words, without_error

#: Packages whose versions matter to a fit.
PACKAGES = ("hil-teleop", "numpy", "scipy", "numba", "pin")


class Card:
    """The target: a page in Markdown."""

    what = "model card: a page on what was identified, from what, and how far it holds"
    ending = ".md"

    def make(self, job: Job) -> Made:
        """Write the card; with runs, with the errors there."""
        found = compare(job.runs, job.model, job.holdout) if job.runs else None
        head = [_title(job), _source(job), _errors(job, found), _ranges(job)]
        parts = [*head, _values(job), _misses(job, found), _versions()]
        return Made({self.ending: "\n\n".join("\n".join(part) for part in parts) + "\n"})


TARGET = Card()


def content_hash(job: Job) -> str:
    """SHA-256 of the model file, then of its robot description."""
    data = job.source.read_bytes() + b"\0" + job.model.robot.urdf.encode("utf-8")
    return hashlib.sha256(data).hexdigest()


def _plain(text: object) -> str:
    """Text in a cell of a table: no markup, no line feed."""
    one = " ".join(printable(str(text)).split())
    return re.sub(r"([\\|<>`*_\[\]#&])", r"\\\1", one)


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    lines = [head, tuple("---" for _ in head), *(tuple(map(_plain, r)) for r in rows)]
    return [f"| {' | '.join(line)} |" for line in lines]


def _title(job: Job) -> Iterator[str]:
    model, robot = job.model, job.model.robot
    described = "a URDF" if robot.urdf else f"preset {robot.preset}" if robot.preset else "unnamed"
    yield f"# Model card: {_plain(job.source.name)}"
    yield ""
    yield from _table(
        ("", ""),
        [
            ("robot", described),
            ("explains", f"the {model.explains} effort"),
            ("effects", ", ".join(model.names())),
            ("content (SHA-256 of model and description)", content_hash(job)),
        ],
    )


def _source(job: Job) -> Iterator[str]:
    yield "## Identified from"
    yield ""
    told: dict[str, int] = {}
    for value in job.model.values().values():
        told[value.source or "unknown"] = told.get(value.source or "unknown", 0) + 1
    if not told:
        yield "Nothing: the model has no values."
        return
    yield from _table(("source", "values"), [(k, str(n)) for k, n in told.items()])


def _errors(job: Job, found: Comparison | None) -> Iterator[str]:
    yield "## Error"
    yield ""
    if found is None:
        yield "Unknown: no recording was given (`--data`)."
        return
    kind = "other sessions" if job.holdout else "blocks of the same sessions that were not fitted"
    yield f"Fitted anew to {', '.join(_plain(r.name) for r in job.runs)}; held out: {kind}."
    yield ""
    joints, held = found.result.problem.joints, found.heldout
    rows = [
        (joint, f"{held.relative[j]:.2f} %", f"{held.rms[j]:.3g}", f"{found.noise[j]:.3g}")
        for j, joint in enumerate(joints)
    ]
    yield from _table(("joint", "held-out error", "rms [N m or N]", "noise floor"), rows)


def _ranges(job: Job) -> Iterator[str]:
    yield "## Ranges of validity"
    yield ""
    if not job.model.valid:
        yield "Unknown: the model file has none. A fit writes them."
        return
    yield "Beyond these ranges the model extrapolates."
    yield ""
    rows = [
        (r.joint, *(f"{low:.3g} to {high:.3g}" for low, high in (r.position, r.speed, r.load)))
        for r in job.model.valid
    ]
    head = ("joint", "position [rad or m]", "speed [rad/s or m/s]", "load [N m or N]")
    yield from _table(head, rows)


def _values(job: Job) -> Iterator[str]:
    yield "## Values"
    yield ""
    joints = tuple(r.joint for r in job.model.valid)
    rows = [
        (
            name,
            f"{v.value:.6g}",
            _uncertainty(v),
            "" if v.unit == "1" else v.unit,
            _note(name, v, joints),
        )
        for name, v in job.model.values().items()
    ]
    yield from _table(("parameter", "value", "standard error", "unit", "remark"), rows)


def _uncertainty(v: Value) -> str:
    return f"{v.stderr:.2g}" if math.isfinite(v.stderr) else "unknown"


def _note(name: str, v: Value, joints: tuple[str, ...]) -> str:
    if v.at_bound:
        return "on its bound"
    if not v.identifiable:
        return "determined only in combination with others"
    return in_words(name, v.value, joints) or without_error(name, v)


def _misses(job: Job, found: Comparison | None) -> Iterator[str]:
    yield "## Known misses"
    yield ""
    lines = [
        f"{name}: {effect.doc.caveat}"
        for name in job.model.names()
        if (effect := catalogue.get(name)).doc.caveat
    ]
    loose = [name for name, v in job.model.values().items() if not v.identifiable]
    if loose:
        lines.append(f"{len(loose)} values are determined only in combination with others")
    bound = [name for name, v in job.model.values().items() if v.at_bound]
    if bound:
        lines.append(f"on their bounds: {', '.join(bound)}")
    if found is not None:
        named = ((f"{joint}: ", r.text) for joint, rs in found.where.items() for r in rs)
        lines += [head + text.removeprefix(head) for head, text in named]
        lines += [f.text for f in found.faults]
    yield from (f"- {_plain(line)}" for line in lines)
    if found is None:
        yield "- No recording was given, so what else the model misses is unknown (`--data`)."
    elif not lines:
        yield "None was found in these recordings."


def _versions() -> Iterator[str]:
    yield "## Versions"
    yield ""
    rows = [("python", platform.python_version())]
    for name in PACKAGES:
        try:
            rows.append((name, version(name)))
        except PackageNotFoundError:
            rows.append((name, "not installed"))
    yield from _table(("package", "version"), rows)
