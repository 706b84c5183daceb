"""`hil diagnose`: which physical effect is missing."""

from __future__ import annotations

import argparse

from hil.commands import common
from hil.compare import analysis
from hil.compare.diagnose import Diagnosis, Finding
from hil.compare.tables import diagnosis_json, sets_of

HELP = "which physical effect is missing"
EXAMPLE = "hil diagnose run.mcap --model arm.toml --holdout other.mcap --report why.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    common.add_sessions(parser)
    parser.add_argument("--report", metavar="R.html", help="write a self-contained report")


def run(args: argparse.Namespace) -> int:
    """Diagnose and print."""
    common.writable(args.report, ".html")
    runs, held, model = common.load(args)
    result = analysis.diagnose(runs, model, held)
    if args.report:
        from hil.compare.report import diagnosis_report

        diagnosis_report(result, args.report)
    if args.json:
        common.emit(diagnosis_json(result))
        return 0
    common.out(text(result))
    if args.report:
        common.out(f"\nreport: {args.report}")
    return 0


SENTENCES = {
    "adequate": "adequate: the model explains the data down to the noise floor.",
    "missing-effect": "missing effect found.",
    "ambiguous": "something is missing, but these data cannot say which of several effects it is.",
    "unexplained": "something is missing, and no effect of the catalogue explains it.",
    "not-identifiable": "these data do not determine the model.",
    "bad-data": "the recording has faults; nothing fitted to it would mean anything.",
}


def text(d: Diagnosis) -> str:
    """The diagnosis for a terminal."""
    lines = [f"Verdict: {SENTENCES[d.verdict]}"]
    for f in d.findings:
        lines += ["", *_finding(f)]
    if d.partial:
        names = ", ".join(f"{f.effect} on {f.joint}" for f in d.partial)
        lines.append(f"  best partial explanation: {names} (explains too little to be the cause)")
    if not d.ladder:
        return "\n".join([*lines, *(f"  {w}" for _, w in d.warnings)])
    lines += ["", ladder_text(d)]
    sets = sets_of(d)
    if sets:
        lines += ["", "What these data cannot tell apart"]
        lines += [
            f"  - {' / '.join(s.effects)}: {s.why}. Would show it: {s.experiment}." for s in sets
        ]
    notes = [w for code, w in d.warnings if not code.startswith("impossible")]
    lines += ["", *(f"  note: {w}" for w in notes)] if notes else []
    return "\n".join(lines)


def _finding(f: Finding) -> list[str]:
    where = f" on {f.joint}" if f.joint else ""
    lines = [
        f"  {f.effect}{where}  (confidence {f.confidence:.2f})",
        f"    held-out error {f.relative_before:.2f} % -> {f.relative_after:.2f} % "
        f"(se {f.se:.2f}), {100 * f.excess_explained:.0f} % of what was above the noise floor",
    ]
    for name, v in f.parameters.items():
        error = f" +- {v.stderr:.2g}" if v.stderr == v.stderr else ""
        lines.append(f"    {name} = {v.value:.4g}{error} {v.unit}")
    if f.rivals:
        lines.append(f"    rivals with this motion: {', '.join(f.rivals)}")
    return lines


def ladder_text(d: Diagnosis) -> str:
    """Error ladder: held-out rms error over the noise floor, by joint."""
    joints = d.result.problem.joints
    rows = [
        [s.label, *(f"{x:.2f}" for x in (*s.heldout.relative, *(s.heldout.rms / d.noise)))]
        for s in d.ladder
    ]
    head = ["held-out error", *(f"{j} %" for j in joints), *(f"{j}/floor" for j in joints)]
    return common.table(head, rows)
