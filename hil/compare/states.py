"""Terms of fitted models at unconnected states: which are shared, and what they look at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.identify.design import Term, by_run
from hil.identify.kept import watched
from hil.identify.result import FitResult
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int_]
#: A term and its coefficients: (m,), or (w, m) row by row.
Part = tuple[Term, FloatArray]
#: Instants of a run that show which fields a term looks at.
SOME = 200


def looked_at(term: Term, motion: Motion) -> set[str]:
    """Fields of unconnected states that a term looks at."""
    few = slice(None, None, max(1, motion.n // SOME))
    rows = [x[few] for x in (motion.q, motion.qd, motion.qdd, motion.load, motion.static)]
    return {
        name
        for name, _ in watched(term.effect, [motion.at_states(*rows)], term.joint, term.shape)[1]
    }


def shared(parts: Sequence[Sequence[Part]], owner: IntArray) -> list[Part]:
    """Terms of all models that follow the state, with the coefficients (w, m) of each row.

    Zero where a row's model has no such term.
    """
    found: dict[tuple[object, ...], Part] = {}
    for k, own in enumerate(parts):
        for t, theta in own:
            if not t.effect.replayed:
                key = (*t.key, t.shape)
                if key not in found:
                    found[key] = (t, np.zeros((len(owner), theta.size)))
                found[key][1][owner == k] = theta
    return list(found.values())


def parts_of(result: FitResult, motion: Motion) -> list[Part]:
    """Terms of a model with their coefficients in a run; zero in a run that was not fitted."""
    out = []
    for t, where in zip(result.terms, result.slices, strict=True):
        theta = result.theta[where]
        if t.per_run:
            motions = result.problem.motions
            own = by_run(t, theta, result.problem.runs)[result.problem.whole]
            known = [own[k] for k, m in enumerate(motions) if m is motion]
            theta = np.asarray(known[0]) if known else np.zeros(own.shape[1])
        elif t.effect.belongs(t.shape) and all(m is not motion for m in result.problem.motions):
            theta = np.zeros_like(theta)
        out.append((t, theta))
    return out


def replayed(result: FitResult, motion: Motion, own: Motion | None = None) -> FloatArray:
    """Effort (n, d) of states and measured derivatives, taken from the measured run.

    `own` is the run with this model's load, where that is another one.
    """
    out = np.zeros_like(motion.q)
    for t, theta in parts_of(result, motion):
        if t.effect.replayed:
            where = slice(None) if t.effect.whole_robot else t.joint
            out[:, where] += t.effect.columns(own or motion, t.joint, t.shape) @ theta
    return out
