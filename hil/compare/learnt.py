"""What a fitted effect contributes to the effort, and what the rest of the model leaves to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.identify.design import Term
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Learnt:
    """A fitted effect on one joint.

    Parameters
    ----------
    term : Term
        With its shape.
    joint : int
        Joint that it is drawn for.
    effort : ndarray (n,)
        What it contributes.
    partial : ndarray (n,)
        Residual of the final model plus that contribution.
    """

    term: Term
    joint: int
    effort: FloatArray
    partial: FloatArray


def learnt(result: FitResult, effect: str, joint: str | None) -> Learnt | None:
    """Contribution of a fitted effect; None if the final model does not hold it."""
    problem = result.problem
    x = result.x.reshape(problem.d, problem.n, -1)
    for term, where in zip(result.terms, result.slices, strict=True):
        if term.effect.name != effect or (joint and problem.joints[term.joint] != joint):
            continue
        effort = x[:, :, where] @ result.theta[where]
        j = term.joint
        if joint is None:
            j = int(np.argmax(np.sqrt(np.mean(effort**2, axis=1)) / result.sigma))
        return Learnt(term, j, effort[j], result.residual[j] + effort[j])
    return None
