"""What is said of a diagnosis after its verdict: errors of all values, ranges, notes, what is left.

Nothing here changes a name or a confidence, nor a verdict but one: an error at its floor that a
function of positions or speeds foretells on left-out data, or that keeps to two sides as no noise
does, is not adequate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.compare.common import common
from hil.compare.fallback import explainable, foretold, hidden
from hil.compare.findings import Diagnosis
from hil.compare.heldout import Examiner
from hil.compare.lost import lost_counts
from hil.compare.otherrobot import other_robot
from hil.compare.sessions import differences
from hil.compare.unlike import notes as unlike_notes
from hil.compare.unlike import unlike
from hil.compare.unseen import unseen
from hil.diagnosis.constants import MATTERS
from hil.identify.errors import complete
from hil.identify.result import FitResult
from hil.identify.validity import outside
from hil.models.model import RobotModel
from hil.record.checks import Finding as Fault
from hil.record.recording import Recording


def finish(
    out: Diagnosis, examine: Examiner, model: RobotModel, recordings: list[Recording],
    faults: list[Fault],
) -> Diagnosis:  # fmt: skip
    """The diagnosis with all that is said beside its verdict.

    Parameters
    ----------
    out : Diagnosis
        With its verdict.
    examine : Examiner
        Knows the held-out runs.
    model : RobotModel
        The model under suspicion.
    recordings : list of Recording
        Runs that were fitted.
    faults : list of Fault
        What the checks say of them.
    """
    result = out.ladder[-1].result
    out.unseen = unseen(result, out.last)
    out.valid = model.valid
    # before the held-out runs are predicted anew: their loads are those of their own fit
    differ = differences(out, examine)
    left = outside(model.valid, result.problem) + examine.outside(result)
    out.warnings += other_robot(model, recordings)
    out.warnings += [("outside-range", text) for text in left]
    out.warnings += differ
    out.warnings += [(f.code, f.sentence) for f in faults]
    out.warnings += lost_counts(out.findings, recordings, out.warnings)
    told = {s.joint for s in out.network}
    out.network += [s for s in explainable(result, out.last.floor) if s.joint not in told]
    if out.verdict == "adequate":
        # what is less than efforts are known to needs no explanation
        falls = foretold(result)
        if falls is not None:
            falls = {j: x for j, x in falls.items() if matters(result)[j]}
        out.beyond = None if falls is None else max([0.0, *falls.values()])
        out.network = hidden(result, falls or {})
        if out.network:
            out.verdict = "unexplained"
    _with_unlike(out)
    _with_errors(out)
    holds = zip(result.problem.joints, result.problem.holds, strict=True)
    out.warnings += common(out.findings, [name for name, still in holds if not still])
    return out


def _with_unlike(out: Diagnosis) -> None:
    """What is left where that is no noise; who leaves a wave or a switch is not adequate."""
    step = out.ladder[-1]
    found = unlike(step.result, step.heldout.rms, out.noise, out.last.projector)
    out.warnings += unlike_notes(found)
    felt = dict(zip(step.result.problem.joints, matters(step.result), strict=True))
    if out.verdict == "adequate" and any(u.matters and felt[u.joint] for u in found):
        out.verdict = "unexplained"


def matters(result: FitResult) -> NDArray[np.bool_]:
    """Joints (d,) whose error is more than efforts are known to."""
    size = result.problem.rms(result.problem.effort)
    return np.asarray(result.rms > MATTERS * size)


def _with_errors(out: Diagnosis) -> None:
    """Standard errors of every shape value, in the last model and in what was found."""
    step = out.ladder[-1]
    out.ladder = [*out.ladder[:-1], replace(step, result=complete(step.result))]
    values = out.ladder[-1].result.values
    for kind in ("findings", "partial"):
        told = [
            replace(f, parameters={n: values.get(n, v) for n, v in f.parameters.items()})
            for f in getattr(out, kind)
        ]
        setattr(out, kind, told)
