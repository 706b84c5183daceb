"""Whether effort columns have the wrong sign or were swapped: then nothing can be diagnosed.

A model that cannot follow its own recording at all is fitted again to the same recording with an
effort turned round, or with two of them exchanged.  No missing effect makes one of these fit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
#: Relative error from which on a fit is none, and from which on columns are tried in another way;
#: a joint's that may be the other one of two [%].
HOPELESS, DOUBTFUL, OTHER = 50.0, 30.0, 10.0
#: Share of the error that is left when the columns are put right, at most.
RIGHT = 1 / 3


def mistaken(result: FitResult, recordings: list[Recording]) -> list[tuple[str, str]]:
    """Faults (code, sentence) of effort columns that the base fit shows; empty if there are none.

    Only where the motors alone act: beside a measured force, it may be the force that is wrong.

    Parameters
    ----------
    result : FitResult
        Base model fitted to the runs as they are.
    recordings : list of Recording
        The runs.
    """
    pushed = any(r.wrench is not None or r.tau_ext is not None for r in recordings)
    doubtful = float(np.max(result.relative)) >= DOUBTFUL or driven(result)
    if result.model.explains != "motor" or pushed or not doubtful:
        return []
    before, found = _size(result), []
    for code, text, columns, signs in _changes(result.problem.joints, result.relative):
        changed = [replace(r, tau=r.tau[:, columns] * signs) for r in recordings]
        problem = Problem(
            changed, result.problem.source, result.model.explains, rates=result.problem.rates
        )
        after = fit(problem, result.model, sweeps=1)
        better = _size(after) < RIGHT * before and float(np.max(after.relative)) < HOPELESS
        if better:
            found.append((_size(after), code, text))
    return [(code, text) for _, code, text in sorted(found)[:1]]


def driven(result: FitResult) -> bool:
    """Whether all friction lies on its bound, zero: free masses take a wrong sign, it cannot."""
    names = [n for n in result.values if n.endswith((".coulomb.fc", ".viscous.fv"))]
    return bool(names) and all(result.values[n].at_bound for n in names)


def _size(result: FitResult) -> float:
    """Relative error over all joints [%]."""
    return float(np.sqrt(np.mean(result.relative**2)))


def _changes(
    joints: tuple[str, ...], error: FloatArray
) -> Iterator[tuple[str, str, list[int], FloatArray]]:
    """Code, sentence, order and signs of the columns that may be meant.

    A joint whose effort is another one's fits badly, and so does the other one's.
    """
    d, bad, poor = len(joints), error > DOUBTFUL, error > OTHER
    order, fits = list(range(d)), "turned round, the model fits; change its sign in a map"
    for k, joint in ((k, x) for k, x in enumerate(joints) if bad[k]):
        signs = np.where(np.arange(d) == k, -1.0, 1.0)
        yield "sign", f"tau{k + 1} ({joint}) has the wrong sign: {fits}", order, signs
    if d > 1 and (2 * np.sum(error > HOPELESS / 2) >= d or not np.any(bad)):
        text = "all efforts have the wrong sign: turned round, the model fits; change them in a map"
        yield "sign", text, order, np.full(d, -1.0)
    for a, b in combinations(np.flatnonzero(poor).tolist(), 2):
        if not (bad[a] or bad[b]):
            continue
        swapped = [b if k == a else a if k == b else k for k in order]
        text = (
            f"tau{a + 1} and tau{b + 1} ({joints[a]}, {joints[b]}) are swapped: exchanged, the "
            "model fits; name the columns in a map"
        )
        yield "swapped", text, swapped, np.ones(d)
