"""One effect on one joint beside a fit: how much of the residual it explains, and at what cost."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.compare.detect import FLIPS
from hil.identify.abreast import abreast
from hil.identify.design import Term
from hil.identify.projector import Projector
from hil.identify.refine import COARSE
from hil.identify.result import FitResult
from hil.identify.shapes import best_shape

FloatArray = NDArray[np.float64]


@dataclass
class Candidate:
    """One effect on one joint, tried beside the present model.

    Parameters
    ----------
    term : Term
        With the best shape.
    gain : float
        Fall of the weighted residual sum of squares if it is added.
    net : float
        The same if it takes the place of what it replaces.
    chi2 : float
        `net` in units of the noise, for the effective number of instants.
    dof : int
        Coefficients and shape values spent.
    price : float
        dof * log(effective instants).
    spare : float
        What a rival may lack in chi2 and still leave less than 1.1 times the noise floor.
    absorbed : float
        Share of its columns that the base model imitates (1 = indistinguishable from it).
    p_value : float
        Family-wise, by sign flips of noise blocks.
    coefficients, errors : tuple of float
        Its coefficients if it is added, and their standard errors.
    joint : int
        Its joint; of an effect of the whole robot, the joint where it explains most.
    smoother : bool
        Whether all that it does is to smooth the noise of the positions.
    blurred : bool
        Whether all that it explains is reversals that the motion's filter blurs.
    parts : ndarray (d,)
        `net` by joint.
    """

    term: Term
    gain: float
    net: float
    chi2: float = 0.0
    dof: int = 1
    price: float = 0.0
    spare: float = 0.0
    absorbed: float = 0.0
    p_value: float = 1.0
    coefficients: tuple[float, ...] = (0.0,)
    errors: tuple[float, ...] = ()
    joint: int = 0
    smoother: bool = False
    blurred: bool = False
    parts: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    null: FloatArray = field(default_factory=lambda: np.zeros(FLIPS), repr=False)

    @property
    def late(self) -> float:
        """How late it says that the effort acts [s], for effects that say so."""
        return self.coefficient * float(np.prod(self.term.shape))

    @property
    def coefficient(self) -> float:
        """First coefficient if it is added."""
        return self.coefficients[0]

    @property
    def name(self) -> str:
        """Effect's name."""
        return self.term.effect.name

    @property
    def score(self) -> float:
        """chi2 less its price (BIC, up to sign)."""
        return self.chi2 - self.price


def ranking(c: Candidate) -> tuple[float, int, float]:
    """Sort key: the higher score first, of equals (in four digits) the one with less to fit."""
    return -float(f"{c.score:.4g}"), c.dof, -float(f"{c.score:.8g}")


def try_all(projector: Projector, result: FitResult, terms: list[Term]) -> list[Candidate]:
    """Candidates for terms, without those that have no shape here, or nothing but zeros."""
    tried = abreast(lambda t: _try(projector, result, t), terms, projector.problem.instants)
    return [c for c in tried if c is not None]


def _try(projector: Projector, result: FitResult, term: Term) -> Candidate | None:
    if not term.shape:
        term, _ = best_shape(projector, term, accuracy=COARSE)
    if not term.shape and term.effect.shape:
        return None
    gain, beta, inverse, qc = projector.score(term)
    columns = projector.weighted(term)
    size = float(np.sum(columns**2))
    if size == 0.0:
        return None
    absorbed = float(np.sum(qc**2)) / size
    dof = columns.shape[1] + _free(term, projector)
    net = _net(projector, result, term, gain)
    parts = _parts(projector, term, net, columns @ beta, qc @ beta)
    return Candidate(
        term,
        gain,
        net,
        dof=dof,
        absorbed=absorbed,
        coefficients=tuple(map(float, beta)),
        errors=tuple(np.sqrt(np.maximum(np.diag(inverse), 0.0)).tolist()),
        joint=int(np.argmax(parts)) if term.effect.of_robot else term.joint,
        parts=parts,
    )


def _free(term: Term, projector: Projector) -> int:
    """Shape values that were searched; a choice of a few forms is none."""
    grid = projector.problem.grid(term.effect, term.joint)
    each = zip(term.effect.shape, zip(*grid, strict=True), strict=False)
    return sum(len(set(values)) > 2 and not p.choice for p, values in each)


def _parts(
    projector: Projector, term: Term, net: float, effort: FloatArray, known: FloatArray
) -> FloatArray:
    """Fall of every joint's squared residual (d,); `known`: what the base takes, in Q."""
    d = projector.problem.d
    if not term.effect.whole_robot:
        out = np.zeros(d)
        out[term.joint] = net
        return out
    new, r = effort - projector.spanned(known), projector.residual
    fall: FloatArray = (r**2 - (r - new) ** 2).reshape(d, -1).sum(axis=1)
    return np.where(projector.problem.holds, 0.0, fall)


def _net(projector: Projector, result: FitResult, term: Term, gain: float) -> float:
    """Gain when the candidate replaces what it stands for, e.g. presliding for Coulomb."""
    gone = [
        t for t in result.terms if t.joint == term.joint and t.effect.name in term.effect.replaces
    ]
    if not gone:
        return gain
    rest = [t for t in result.terms if t not in gone]
    reduced = Projector(projector.problem, rest, projector.sigma)
    return projector.rss - (reduced.rss - reduced.gain(term))
