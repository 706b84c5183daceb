"""Laws of a transmission that do no more than smooth the noise of the measured positions.

The model's load is made of measured positions, and takes their noise times the inertia with it.
What passes an elastic transmission is a smoother load, so that such a law lowers the error of any
joint whose encoder is coarse, on held-out runs, too.  A smoother without any delay does that
better than a spring, which also rings and lags:

    s = smoothed load - load,   gain(s, law) - gain(s) < NEW gain(law)   =>   the law smooths.

Source: errors in variables, Soederstroem, Automatica 43(6), 2007.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from hil.compare.candidate import Candidate
from hil.compare.detect import LEVEL
from hil.identify import standstill
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.identify.timing import LATE, real_delay

if TYPE_CHECKING:
    from hil.compare.evidence import Evidence

FloatArray = NDArray[np.float64]
CODE = "position-noise"
#: Share of the squared error that is worth a word.
MUCH = 0.17
#: Steps of an encoder from row to row below which it is coarse.
COUNTS = 3.0
#: Cut-offs of smoothers [Hz].
CUTS = (1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0)
#: Share of a law's gain that smoothing must leave to it: clean arms and axes behind encoders of
#: 14 to 16 bits leave below 0.07, springs and modes of half a floor above 0.14.
NEW = 0.10


def mark(found: list[Candidate], projector: Projector) -> None:
    """Say of every candidate that was detected whether all it does is to smooth.

    Parameters
    ----------
    found : list of Candidate
        With their evidence.
    projector : Projector
        Of the fit that they were tried beside.
    """
    own = [c for c in found if c.term.effect.smooths and c.p_value <= LEVEL and c.score > 0]
    for j in {c.term.joint for c in own}:
        smoothers = _smoothers(projector, j)
        for c in own:
            if c.term.joint == j:
                c.smoother = _left(c, projector, smoothers) < NEW * c.gain


def _left(c: Candidate, projector: Projector, smoothers: FloatArray) -> float:
    """Gain of a law beside the best of the smoothers (n, k)."""
    rows, law = projector.rows(c.term), projector.weighted(c.term)
    r = projector.residual[rows]
    best, more = 0.0, c.gain
    for k in range(smoothers.shape[1]):
        x = np.column_stack([smoothers[:, k], law])
        known = projector.inner(rows, x)
        gram, along = x.T @ x - known.T @ known, x.T @ r
        alone = float(along[0] ** 2 / max(gram[0, 0], 1e-300))
        # one with a negative sign would sharpen
        if along[0] > 0.0 and alone > best:
            both = float(along @ np.linalg.lstsq(gram, along, rcond=None)[0])
            best, more = alone, both - alone
    return more


def _smoothers(projector: Projector, j: int) -> FloatArray:
    """What smoothers without delay take from joint j's load, weighted rows (n, k)."""
    problem = projector.problem
    raw = [
        np.stack([_smoothed(m.load[:, j], 1 / m.dt, cut) for cut in CUTS], axis=1)
        for m in problem.motions
    ]
    return np.asarray(problem.gated(raw, j) / projector.sigma[j], dtype=np.float64)


def _smoothed(load: FloatArray, fs: float, cut: float) -> FloatArray:
    sos = scipy.signal.butter(2, min(cut / (fs / 2), 0.9), output="sos")
    out: FloatArray = scipy.signal.sosfiltfilt(sos, load) - load
    return out


def smoothed(evidence: Evidence, result: FitResult) -> FloatArray:
    """Part of the squared error (d,) that smoothing the positions' noise would take away."""
    out = np.zeros(result.problem.d)
    for c in evidence.candidates:
        if c.smoother:
            j = c.term.joint
            power = c.parts[j] * result.sigma[j] ** 2 / max(result.problem.count[j], 1.0)
            out[j] = max(out[j], float(power))
    return out


def coarse(problem: Problem) -> NDArray[np.bool_]:
    """Joints (d,) that mostly move by less than COUNTS steps of their encoder from row to row."""
    if ("coarse",) not in problem.memo:
        out = np.zeros(problem.d, dtype=bool)
        for m, r in zip(problem.motions, problem.recordings, strict=True):
            moved = np.median(np.abs(m.qd), axis=0) * m.dt
            out |= moved < COUNTS * standstill.quanta(r.q)
        problem.memo["coarse",] = out
    found: NDArray[np.bool_] = problem.memo["coarse",]
    return found


def returned(evidence: Evidence, result: FitResult) -> FloatArray:
    """Part of the squared error (d,) that a lateness takes away which the slow motion denies.

    A controller answers the noise of a coarse encoder a little later: so a delay of the effort
    lowers the error, though nothing is late.
    """
    out, rough = np.zeros(result.problem.d), coarse(result.problem)
    for c in evidence.candidates:
        j = c.term.joint
        if not (rough[j] and c.name in LATE and c.p_value <= LEVEL):
            continue
        if not real_delay(result, j, c.late):
            power = c.parts[j] * result.sigma[j] ** 2 / max(result.problem.count[j], 1.0)
            out[j] = max(out[j], float(power))
    return out


def shaken(evidence: Evidence, result: FitResult) -> list[tuple[str, str]]:
    """Warnings (code, sentence) for joints where that is a good part of the error."""
    power = np.maximum(smoothed(evidence, result), returned(evidence, result))
    share = power / np.maximum(result.rms**2, 1e-300)
    return [
        (
            CODE,
            f"{joint}: {100 * share[j]:.0f} % of the squared error is the noise of the measured "
            "positions, in the model's accelerations or as the controller answers it, and no "
            "physics: a finer encoder, more motion or a narrower [signal] in the model file would "
            "show more",
        )
        for j, joint in enumerate(result.problem.joints)
        if share[j] > MUCH
    ]
