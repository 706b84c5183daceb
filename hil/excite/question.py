"""A question about rival effects: what is refitted, what is suspected, how loud the noise is."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.excite import foresee
from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.models.effect import Trait

FloatArray = NDArray[np.float64]
#: Share of a signal's power by which functional forms miss the truth.
FORM = 0.01
#: Log odds at which a rival has less than 5 % left.
DECIDED = float(np.log(19.0))
#: Sign resolution of a question, in units of what the recording resolves.
SHARP = 0.02


@dataclass(frozen=True)
class Rival:
    """One effect under suspicion.

    Parameters
    ----------
    term : Term
        With its shape as fitted, or one of its grid.
    theta : ndarray (m,)
        Its coefficients [SI].
    shapes : tuple of tuple of float
        Shapes with which it may imitate another effect.
    """

    term: Term
    theta: FloatArray
    shapes: tuple[tuple[float, ...], ...] = ((),)

    @property
    def name(self) -> str:
        """Effect's name."""
        return self.term.effect.name


@dataclass(frozen=True)
class Question:
    """Base terms with their values, rivals, and the noise.

    Parameters
    ----------
    base : list of Term
        What is refitted together with any rival.
    theta : ndarray (p,)
        Its coefficients.
    rivals : list of Rival
        One (against the base alone) or more.
    noise : ndarray (d,)
        Noise that one instant carries, coloured noise counted up [N m or N].
    v0, contact, span : ndarray (d,), (d, 2), (d, 2)
        Sign resolution, surface, and the range of positions that all columns refer to.
    floor : float
        Power, in units of the noise that one instant carries, that an effect must show before
        it counts; 0 where it is known already that it does.
    """

    base: list[Term]
    theta: FloatArray
    rivals: list[Rival]
    noise: FloatArray
    v0: FloatArray
    contact: FloatArray
    span: FloatArray
    floor: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """What one set of runs says of a pair.

    Parameters
    ----------
    odds : float
        Log odds with which the better of the two would win.
    share : float
        Share of the signal's power that the other one cannot imitate (0 to 1).
    fresh : float
        The same for its columns with any coefficients: the largest share there is.
    """

    odds: float
    share: float
    fresh: float = 0.0

    @property
    def decided(self) -> bool:
        """Whether the rival would be out."""
        return self.odds >= DECIDED

    @property
    def possible(self) -> bool:
        """Whether the rival would be out if the effect were large enough."""
        return max(self.share, self.fresh) / (2 * FORM) >= DECIDED


def sharp(base: Sequence[Term], v0: FloatArray) -> tuple[list[Term], FloatArray]:
    """Base terms and sign resolution in the limit of dry friction.

    How the sign of a speed is smoothed near zero is a convention of the fit; it must not count
    as a difference between two effects.
    """
    tiny = SHARP * v0
    dry = (Trait.DRY in t.effect.traits for t in base)
    each = zip(base, dry, strict=True)
    terms = [t.reshaped((float(tiny[t.joint]), *t.shape[1:])) if dry else t for t, dry in each]
    return terms, tiny


def in_context(problem: Problem, v0: FloatArray, contact: FloatArray, span: FloatArray) -> Problem:
    """A copy of a problem in a question's context: sharp signs, known surface, common range."""
    out = copy.copy(problem)
    out.motions = [replace(m, average=0.0, span=span) for m in problem.motions]
    out.set_context(v0=v0, contact=contact)
    return out


def ready(problem: Problem, question: Question) -> Problem:
    """A foreseen problem with the question's context, loads and efforts."""
    out = in_context(problem, question.v0, question.contact, question.span)
    foresee.complete(out, question.base, question.theta)
    return out
