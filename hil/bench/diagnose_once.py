"""One diagnosis from file to report in a process of its own: seconds, peak memory, held-out error.

    python -m hil.bench.diagnose_once REPEATS REPORT TRAIN.mcap [HOLDOUT.mcap]

The result is one line of JSON; with 0 repeats the only run is timed, else the first warms up.
"""

from __future__ import annotations

import json
import sys
import time

from hil.diagnosis.engine import diagnose
from hil.diagnosis.types import Diagnosis
from hil.models.model import base_model
from hil.record.mcap_read import load
from hil.report.html import diagnosis_report
from hil.revision import peak


def _once(report: str, train: str, holdout: list[str]) -> tuple[float, float, Diagnosis]:
    """Load, fit, rank all candidates, test held out; the report says where the model fails."""
    start, clock = time.process_time(), time.perf_counter()
    run = load(train)
    model = base_model(run.robot)
    d = diagnose([run], model, [load(path) for path in holdout])
    diagnosis_report(d, report)
    return time.process_time() - start, time.perf_counter() - clock, d


def main(words: list[str]) -> None:
    """Run and print."""
    repeats, report, train, *holdout = words
    runs = [_once(report, train, holdout) for _ in range(1 + int(repeats))]
    seconds, wall, (*_, d) = zip(*runs[-max(int(repeats), 1) :], strict=True)
    names = [f"{f.effect} on {f.joint}" for f in d.findings]
    ratio = (d.ladder[-1].heldout.rms / d.noise).tolist()
    result = {
        "seconds": seconds,
        "wall": wall,
        "peak": peak(),
        "candidates": len(d.first.candidates),
        "rungs": len(d.ladder),
        "verdict": d.verdict,
        "named": names,
        "ratio": ratio,
    }
    sys.stdout.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
