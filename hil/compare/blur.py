"""Reversals that the filter of the positions blurs: an error there is no missing physics.

Dry friction turns at once, and the acceleration jumps with it.  The filter rounds that corner, so
that its speed crosses zero some milliseconds away from where the joint did, and for so long the
model's friction has the wrong sign.  Where efforts are clean that is what is left.  With s the
sign of the filtered speed and s' that of a speed behind a wider filter, both as the rows see them,

    r ~ b (s' - s),   b > 0

lowers the error then; friction that builds up after a reversal, as before sliding, has b < 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from hil.compare.candidate import Candidate
from hil.compare.detect import LEVEL
from hil.compare.floor import ADEQUATE
from hil.identify import bands
from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult

if TYPE_CHECKING:
    from hil.compare.evidence import Evidence

FloatArray = NDArray[np.float64]
CODE = "blurred"
#: Wider cut-offs of the positions, in units of the present one, and in units of the sample rate.
WIDER, WIDEST = (2.0, 4.0), 0.35
#: Share of a law's gain that must be left beside it: false names of clean axes with exact dry
#: friction left 0.01 to 0.09 of theirs, true ones 0.98 and more.
NEW = 0.3
#: Share of the squared error that is worth a word.
MUCH = 0.17


@dataclass(frozen=True)
class Blur:
    """What blurred reversals explain on one joint.

    Parameters
    ----------
    column : ndarray (n,)
        Weighted column s' - s on the joint's rows; zeros where it explains nothing.
    effort : ndarray (n,)
        What it takes from the residual [N m or N].
    gain : float
        Fall of the weighted residual sum of squares.
    """

    column: FloatArray
    effort: FloatArray
    gain: float


def blur(result: FitResult, projector: Projector, j: int) -> Blur:
    """The wider filter that explains most of joint j's residual, with a positive coefficient."""
    term = next((t for t in result.terms if t.effect.name == "coulomb" and t.joint == j), None)
    if term is None:
        return Blur(np.zeros(result.problem.n), np.zeros(result.problem.n), 0.0)
    key = ("blur", j, term.shape)
    if key not in projector.memo:
        projector.memo[key] = _best(result.problem, term, projector)
    found: Blur = projector.memo[key]
    return found


def _best(problem: Problem, term: Term, projector: Projector) -> Blur:
    best = Blur(np.zeros(problem.n), np.zeros(problem.n), 0.0)
    j = term.joint
    rows, sigma = projector.rows(term), float(projector.sigma[j])
    r = projector.residual[rows]
    for wider in WIDER:
        c = _column(problem, term, wider) / sigma
        known = projector.inner(rows, c[:, None])
        new = c - projector.spanned(known)[rows][:, 0]
        along, size = float(new @ r), float(new @ new)
        if along > 0.0 and size > 1e-12 * float(c @ c) and along**2 / size > best.gain:
            best = Blur(c, new * (along / size) * sigma, along**2 / size)
    return best


def _column(problem: Problem, term: Term, wider: float) -> FloatArray:
    """Difference of the two signs, as the rows see it (n,)."""
    j = term.joint
    raw = [
        (sharp - term.effect.columns(m, j, term.shape)[:, 0])[:, None]
        for sharp, m in zip(_sharp(problem, j, wider), problem.motions, strict=True)
    ]
    out: FloatArray = problem.gated(raw, j)[:, 0]
    return out


def _sharp(problem: Problem, j: int, wider: float) -> list[FloatArray]:
    """Sign of the speed behind a wider filter, averaged over each evaluation period, run by run."""
    key = ("sharp", j, wider)
    if key not in problem.memo:
        out = []
        for r, m in zip(problem.recordings, problem.motions, strict=True):
            cut = min(wider * problem.rates.position, WIDEST * r.rate)
            speed = bands.derivatives(r.q[:, j : j + 1], r.rate, cut)[1][:, 0]
            stride = max(round(m.dt * r.rate), 1)
            out.append(uniform_filter1d(np.sign(speed), stride)[::stride][: m.n])
        problem.memo[key] = out
    found: list[FloatArray] = problem.memo[key]
    return found


def mark(found: list[Candidate], result: FitResult, projector: Projector) -> None:
    """Say of every candidate that was detected whether it explains no more than blurred reversals.

    Parameters
    ----------
    found : list of Candidate
        With their evidence.
    result : FitResult
        The fit that they were tried beside.
    projector : Projector
        Of that fit.
    """
    own = [c for c in found if c.p_value <= LEVEL and c.score > 0 and not c.term.effect.of_robot]
    for j in {c.term.joint for c in own}:
        blurred = blur(result, projector, j)
        for c in own:
            if blurred.gain > 0.0 and c.term.joint == j and not c.term.effect.whole_robot:
                beside = np.column_stack([blurred.column, projector.weighted(c.term)])
                more = projector.gain_of(c.term, beside) - blurred.gain
                c.blurred = more < NEW * c.gain
                c.smoother &= not c.blurred


def parts(evidence: Evidence, result: FitResult) -> FloatArray:
    """Part of the squared error (d,) that is blurred reversals.

    Parameters
    ----------
    evidence : Evidence
        What was tried beside the fit.
    result : FitResult
        The fit.
    """
    problem = result.problem
    out = np.zeros(problem.d)
    if evidence.projector is not None and result.model.explains == "motor":
        for j in range(problem.d):
            gain = blur(result, evidence.projector, j).gain
            out[j] = gain * evidence.projector.sigma[j] ** 2 / max(problem.count[j], 1.0)
    return out


def above(warnings: Sequence[tuple[str, str]], ratio: Mapping[str, float]) -> bool:
    """Whether a joint of which warnings (code, sentence) say so is above its floor.

    Parameters
    ----------
    warnings : sequence of (str, str)
        Of a diagnosis.
    ratio : mapping of str to float
        Error over the noise floor, by joint.
    """
    told = [text.split(":")[0] for code, text in warnings if code == CODE]
    return any(ratio.get(joint, 0.0) > ADEQUATE for joint in told)


def notes(evidence: Evidence, result: FitResult) -> list[tuple[str, str]]:
    """Warnings (code, sentence) for joints where that is a good part of the error."""
    share = parts(evidence, result) / np.maximum(result.rms**2, 1e-300)
    return [
        (
            CODE,
            f"{joint}: {100 * share[j]:.0f} % of the squared error is at reversals and no physics: "
            "dry friction turns there within less than the filter of the positions passes; with a "
            f"wider one (position_hz above {result.problem.rates.position:.3g} under [signal] in "
            "the model file) it is less",
        )
        for j, joint in enumerate(result.problem.joints)
        if share[j] > MUCH
    ]
