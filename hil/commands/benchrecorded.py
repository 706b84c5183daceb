"""`hil bench emps`, `contact`, `wrist` and `real`: what the public recordings give."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

from tqdm import tqdm

from hil.bench import real, real_table, recordings
from hil.bench.diagnosis.runner import revision
from hil.commands import benchpage, common
from hil.commands.benchpage import Found


def _emps(args: argparse.Namespace) -> Found:
    """Public recording of the EMPS drive: identification, and what is missing."""
    p, e, r = recordings.emps_published(), recordings.emps_diagnosed(), recordings.emps_refined()
    lines = ["Published identification", *_published(p), "", "What is missing", *_missing(e)]
    lines += ["", "Refined on free runs of the first record", *_refined(r)]
    data: dict[str, object] = {
        "published": p.values,
        "error": p.error,
        "heldout": e.heldout,
        "free_run_mm": e.free_run_mm,
        "models": [s.label for s in e.diagnosis.ladder],
        "simulated": {k: f.as_dict() for k, f in zip(r.labels, r.fits, strict=True)},
        "taken": r.labels[r.taken],
        "references_mm": recordings.REFERENCES,
    }
    return "\n".join(lines), data


def _published(p: recordings.Published) -> list[str]:
    """Parameters beside those of the publication."""
    rows = []
    for name, value in p.values.items():
        told = recordings.PUBLISHED[name]
        rows.append([name, f"{value:.3f}", f"{told:.2f}", f"{100 * (value / told - 1):+.2f} %"])
    return [
        common.table(["parameter", "here", "published", ""], rows),
        f"  relative force error {p.error:.2f} % (published {recordings.PUBLISHED_ERROR} %), "
        f"on the record with pulses {p.heldout:.2f} %",
    ]


def _missing(e: recordings.Emps) -> list[str]:
    """Both errors of every rung, and where one rises as the other falls."""
    steps = zip(e.diagnosis.ladder, e.heldout, e.free_run_mm, strict=True)
    table = [[s.label, f"{h:.2f}", f"{mm:.1f}"] for s, h, mm in steps]
    lines = [
        "Fitted on the first record, both errors on the record with pulses, which is simulated",
        "from its first state to its end",
        common.table(["model", "force %", "free run mm"], table),
    ]
    gain = 100 * (1 - e.heldout[-1] / e.heldout[0])
    lines.append(f"  held-out force error falls by {gain:.0f} %")
    for k in range(1, len(table)):
        if e.free_run_mm[k] > 1.05 * e.free_run_mm[k - 1]:
            lines.append(
                f"  warning: {table[k][0]} lowers the force error, but the free run's position "
                f"error rises from {e.free_run_mm[k - 1]:.1f} to {e.free_run_mm[k]:.1f} mm"
            )
    return lines


def _refined(r: recordings.Refined) -> list[str]:
    """Every structure before and after, on the first record's thirds and on the other record."""
    rows = []
    for label, f in zip(r.labels, r.fits, strict=True):
        before, after = f.official or f.heldout
        held = [f"{1e3 * e.simulated[0]:.2f}" for e in f.heldout]
        force = [f"{e.one_step[0]:.2f}" for e in (before, after)]
        mm = [f"{1e3 * e.simulated[0]:.2f}" for e in (before, after)]
        rows.append([label, *held, *force, *mm])
    rows += [[f"published: {k}", *["-"] * 5, f"{x:.2f}"] for k, x in recordings.REFERENCES.items()]
    head = ["model", "thirds mm", "refined", "force %", "refined", "free run mm", "refined"]
    return [
        "Held-out thirds of the first record, then both errors on the record with pulses",
        common.table(head, rows),
        f"  the first record takes {r.labels[r.taken]}",
    ]


def _contact(args: argparse.Namespace) -> Found:
    """Public recordings of a teleoperation rig against foam, springs and walls."""
    lines, data = [], {}
    for kind in ("foam", "spring", "rigid"):
        found = [recordings.contact(r) for r in recordings.contact_runs(kind)]
        rows = [
            [
                c.run,
                c.verdict,
                f"{c.spring:.1f}",
                f"{c.final:.1f}",
                ", ".join(c.named) or "-",
                f"{c.hysteresis - c.damping:+.0f}",
            ]
            for c in found
        ]
        head = ["run", "verdict", "spring %", "final %", "named", "hysteresis - damping"]
        lines += [kind, common.table(head, rows)]
        spring, final = (
            recordings.median([getattr(c, x) for c in found]) for x in ("spring", "final")
        )
        lines.append(
            f"  median held-out error {spring:.1f} % with a linear spring, "
            f"{final:.1f} % with the law found\n"
        )
        data[kind] = [vars(c) | {"named": list(c.named)} for c in found]
    return "\n".join(lines), dict(data)


def _wrist(args: argparse.Namespace) -> Found:
    """Public recording of the Staubli TX40: the coupling of its wrist."""
    lines, data = [], {}
    for split in ("fifths", "halves"):
        w = recordings.wrist(split)
        joints = w.diagnosis.result.problem.joints
        rows = [[s.label, *(f"{x:.1f}" for x in s.heldout.relative)] for s in w.diagnosis.ladder]
        what = {
            "fifths": "Blocks of the whole recording, held out",
            "halves": "First half fits, second half tests",
        }[split]
        lines += [f"{what}: held-out error %", common.table(["model", *joints], rows), ""]
        data[split] = {s.label: s.heldout.relative.tolist() for s in w.diagnosis.ladder}
    return "\n".join(lines), dict(data)


def _real(args: argparse.Namespace) -> Found:
    """Every public recording: the given model, a person's script, and the tool beside them."""
    benchpage.check(args.report)
    todo = real.cases(args.only)
    found: dict[str, real.Row] = {}
    with tqdm(total=len(todo), unit="case", disable=not sys.stderr.isatty()) as bar:
        for row in real.run(todo, args.jobs):
            found[row.case] = row
            bar.update()
    rows, made_by = [found[c.name] for c in todo], revision()
    only = "".join(f" --only {word}" for word in args.only)
    benchpage.write(
        args.report, real_table.page(rows, f"hil bench real{only} --jobs {args.jobs}", made_by)
    )
    data: dict[str, object] = {"revision": made_by, "cases": real_table.data(rows)}
    return real_table.text(rows, common.table), data


BENCHES: dict[str, Callable[[argparse.Namespace], Found]] = {
    "emps": _emps,
    "contact": _contact,
    "wrist": _wrist,
    "real": _real,
}
