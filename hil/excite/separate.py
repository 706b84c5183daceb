"""How well a motion separates rival effects: what the one does and the other cannot imitate.

With base columns X, rival columns C_b and the signal s = C_a theta_a (all divided by the noise),
the noncentrality of a against b is

    lambda = min over the shapes of b of  |s - P s|^2,  P the projector on [X, C_b];

largest lambda = T-optimal (Atkinson and Fedorov, Biometrika 62, 1975).  Only Gram matrices are
needed, so runs simply add up.  No equation is exactly the truth, so lambda counts against
1 + 1 % of the signal's own power, as in the attribution of `hil.compare`.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from hil.excite import foresee
from hil.identify.design import Term, stack
from hil.identify.problem import Problem

FloatArray = NDArray[np.float64]
#: Share of a signal's power by which functional forms miss the truth.
FORM = 0.01
#: Log odds at which a rival has less than 5 % left.
DECIDED = float(np.log(19.0))
#: Sign resolution of a question, in units of what the recording resolves.
SHARP = 0.02
#: Largest number of shapes with which a rival may imitate.
SHAPES = 6


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
    v0, contact : ndarray (d,), (d, 2)
        Sign resolution and surface as the fit found them.
    """

    base: list[Term]
    theta: FloatArray
    rivals: list[Rival]
    noise: FloatArray
    v0: FloatArray
    contact: FloatArray


@dataclass(frozen=True)
class Verdict:
    """What one set of runs says of a pair.

    Parameters
    ----------
    odds : float
        Log odds with which the better of the two would win.
    share : float
        Share of the signal's power that the other one cannot imitate (0 to 1).
    """

    odds: float
    share: float

    @property
    def decided(self) -> bool:
        """Whether the rival would be out."""
        return self.odds >= DECIDED

    @property
    def possible(self) -> bool:
        """Whether the rival would be out if the effect were large enough."""
        return self.share / (2 * FORM) >= DECIDED


def sharp(base: Sequence[Term], v0: FloatArray) -> tuple[list[Term], FloatArray]:
    """Base terms and sign resolution in the limit of dry friction.

    How the sign of a speed is smoothed near zero is a convention of the fit; it must not count
    as a difference between two effects.
    """
    tiny = SHARP * v0
    terms = [t.reshaped((float(tiny[t.joint]),)) if t.effect.name == "coulomb" else t for t in base]
    return terms, tiny


def in_context(problem: Problem, question: Question) -> Problem:
    """A copy of a problem in the question's context: sharp signs, known surface."""
    out = copy.copy(problem)
    out.motions = [replace(m, average=0.0) for m in problem.motions]
    out.set_context(v0=question.v0, contact=question.contact)
    return out


def ready(problem: Problem, question: Question) -> Problem:
    """A foreseen problem with the question's context, loads and efforts."""
    out = in_context(problem, question)
    foresee.complete(out, question.base, question.theta)
    return out


def gram(problem: Problem, question: Question) -> FloatArray:
    """Gram matrix of all columns, in the order base, then each rival's shapes; noise = 1.

    Rivals' own (fitted) shape comes first, then the shapes with which they may imitate.
    """
    terms = [*question.base]
    for r in question.rivals:
        terms += [r.term, *(r.term.reshaped(s) for s in r.shapes)]
    terms = [replace(t, per_run=False) for t in terms]
    x, _ = stack(problem, terms)
    w = np.repeat(1.0 / question.noise, problem.n)
    x = x * w[:, None]
    return x.T @ x


def verdicts(g: FloatArray, question: Question) -> dict[tuple[str, str], Verdict]:
    """Verdict on every ordered pair of rivals; of a single one against the base alone."""
    where, base = _slots(question)
    out = {}
    for a, slots in zip(question.rivals, where, strict=True):
        power, _ = _left(g, base, slots[0], a.theta)
        others = [(b, s) for b, s in zip(question.rivals, where, strict=True) if b is not a]
        if not others:
            whole = float(a.theta @ g[np.ix_(slots[0], slots[0])] @ a.theta)
            out[a.name, "base"] = _verdict(power, whole)
        for b, other in others:
            least = min(
                _left(g, np.concatenate([base, s]), slots[0], a.theta)[0] for s in other[1:]
            )
            out[a.name, b.name] = _verdict(least, power)
    return out


def worst(g: FloatArray, question: Question) -> Verdict:
    """Verdict on the pair that is hardest to separate."""
    return min(verdicts(g, question).values(), key=lambda v: v.odds)


def _verdict(left: float, power: float) -> Verdict:
    # log odds = lambda / 2 (1 + f power)
    return Verdict(left / (2 * (1 + FORM * power)), left / max(power, 1e-300))


def _slots(question: Question) -> tuple[list[list[NDArray[np.int_]]], NDArray[np.int_]]:
    """Column numbers: per rival its own and its imitating shapes; and those of the base."""
    start = question.theta.size
    out = []
    for r in question.rivals:
        m = r.theta.size
        own = [start + m * k + np.arange(m) for k in range(1 + len(r.shapes))]
        start += m * len(own)
        out.append(own)
    return out, np.arange(question.theta.size)


def _left(
    g: FloatArray, base: NDArray[np.int_], own: NDArray[np.int_], theta: FloatArray
) -> tuple[float, FloatArray]:
    """|s - P s|^2 of the signal s = C theta, and the Schur complement of its columns."""
    size = np.sqrt(np.maximum(np.diag(g), 1e-300))
    unit = g / np.outer(size, size)
    inner = unit[np.ix_(base, base)]
    value, vector = scipy.linalg.eigh(inner)
    keep = value > 1e-10 * max(float(value[-1]), 1e-300)
    half = vector[:, keep] / np.sqrt(value[keep])
    cross = half.T @ unit[np.ix_(base, own)]
    schur = unit[np.ix_(own, own)] - cross.T @ cross
    scaled = theta * size[own]
    return max(float(scaled @ schur @ scaled), 0.0), schur


def imitations(term: Term, problem: Problem, near: Sequence[tuple[float, ...]]) -> tuple[
    tuple[float, ...], ...
]:  # fmt: skip
    """Shapes with which an effect may imitate another: its own, `near`, and its grid thinned."""
    grid = term.effect.grid(problem.motions[0], term.joint) or [term.shape]
    step = max(1, len(grid) // SHAPES)
    return tuple(dict.fromkeys([term.shape, *near, *grid[step // 2 :: step]]))
