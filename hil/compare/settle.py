"""How sharp the sign of Coulomb friction is, where the fitted runs hardly say but others do.

A fit takes the sharpest sign that explains its runs about as well as the best one, for a blunt
sign imitates what happens at low speed.  Runs that reverse quickly hardly tell them apart; a run
that lingers about zero speed does, and its error is then neither noise nor a missing effect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.compare.findings import Step
from hil.compare.heldout import Examiner, HeldOut
from hil.identify.assemble import assemble
from hil.identify.context import set_context
from hil.identify.design import Term
from hil.identify.result import FitResult
from hil.identify.timing import fit_aligned
from hil.identify.trial import CLOSE

FloatArray = NDArray[np.float64]
#: Share by which the held-out error must fall.  One place where a joint lingers may hold all of it,
#: so that its spread over blocks says nothing; the fitted runs must bear it as well.
WORTH = 0.04
#: Ratio of held-out to fitted residual from which so much is there to be gained.
APART = 1 + WORTH
#: Ratio of one resolution to the next that is tried.
STEP = 1.25


def settled(result: FitResult, examine: Examiner, label: str) -> Step:
    """A first rung: the fit with signs as blunt as the held-out runs ask for, and its errors."""
    step = Step(label, result, examine(result))
    found = blunt(result, step.heldout, examine)
    if not found:
        return step
    result.problem.least.update(found)
    again = fit_aligned(result.problem, result.model, result.sigma)
    return Step(label, again, examine(again))


def blunt(result: FitResult, heldout: HeldOut, examine: Examiner) -> dict[tuple[str, int], float]:
    """Least resolution of the sign that other runs ask for, by (``"coulomb"``, joint).

    Parameters
    ----------
    result : FitResult
        A fit.
    heldout : HeldOut
        Its residuals on other runs.
    examine : Examiner
        Makes these.

    Returns
    -------
    dict
        For joints whose error is larger on the other runs, the sharpest value, in steps of
        `STEP`, that explains the fitted runs as well as the present one and lowers the held-out
        error by more than `WORTH`, to within 1 % of the best one's.  Empty without other runs.
    """
    if heldout.kind != "holdout":
        return {}
    problem = result.problem
    ratio = heldout.rms / np.maximum(result.rms, 1e-300)
    signs = [t for t in result.terms if t.effect.name == "coulomb" and not t.fixed_shape]
    signs = [t for t in signs if ratio[t.joint] > APART and not problem.holds[t.joint]]
    if not signs:
        return {}
    found = {t.key: _sharpest(t, result, heldout, examine) for t in signs}
    set_context(problem, result.terms)
    return {key: v0 for key, v0 in found.items() if v0 > 0.0}


def _sharpest(term: Term, result: FitResult, heldout: HeldOut, examine: Examiner) -> float:
    """Sharpest resolution that is about the best on other runs; 0 where the present one will do."""
    j = term.joint
    rows: list[tuple[float, float]] = []
    for v0 in _blunter(term, result):
        other = _with(result, term, v0)
        if other.rms[j] ** 2 > CLOSE * result.rms[j] ** 2:
            break
        rows.append((v0, float(examine(other).rms[j])))
    least = min((error for _, error in rows), default=np.inf)
    if least > (1 - WORTH) * heldout.rms[j]:
        return 0.0
    return next(v0 for v0, error in rows if error**2 <= CLOSE * least**2)


def _blunter(term: Term, result: FitResult) -> list[float]:
    """Resolutions blunter than the present one, in steps of `STEP` to the end of its grid."""
    (most,) = result.problem.grid(term.effect, term.joint)[-1]
    v0 = float(term.shape[0])
    return [float(v0 * STEP**k) for k in range(1, int(np.log(most / v0) / np.log(STEP)) + 1)]


def _with(result: FitResult, term: Term, v0: float) -> FitResult:
    """The fit with another sign on a joint, its coefficients solved again."""
    terms = [replace(t, shape=(v0,)) if t is term else t for t in result.terms]
    set_context(result.problem, terms)
    return assemble(result.problem, result.model, terms, result.sigma)
