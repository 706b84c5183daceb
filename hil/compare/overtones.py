"""Waves over position that are a part of one that is named: its own law, no second effect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.compare.attribute import plausible
from hil.compare.candidate import Candidate
from hil.compare.evidence import Evidence
from hil.compare.findings import Accepted
from hil.identify.projector import Projector
from hil.identify.result import FitResult
from hil.models.motion import Motion

CODE = "harmonic"
#: Relative error of an order that is a multiple of another one, and the highest multiple.
NEAR, MOST = 0.01, 9
#: Multiples of a named wave's order of which its law, two harmonics each, is tried beside it.
FURTHER = (2, 3, 5)


def harmonic(c: Candidate, found: Sequence[Accepted], motion: Motion, projector: Projector) -> str:
    """Why a wave over position is no effect beside a named one; empty where it may be one.

    Real cogging, ripple and tight spots have more harmonics than their laws here.  The order of
    another cause is a whole multiple by chance only; and where the motion goes through little more
    than a period, a wave is a shape and has hardly an order: then it is a part of the named one
    if the second to tenth harmonics of that lower the error as much.

    Parameters
    ----------
    c : Candidate
        What may be another effect.
    found : sequence of Accepted
        What is named.
    motion : Motion
        The first run.
    projector : Projector
        The present model.
    """
    for f, _, _ in found:
        if f.term.joint != c.term.joint or not (_wave(c, motion) and _wave(f, motion)):
            continue
        ratio = c.term.shape[0] / f.term.shape[0]
        times = round(ratio)
        if 2 <= times <= MOST and abs(ratio - times) < NEAR * times:
            return f"repeats {times} times within a period of its {f.name}: a further harmonic"
        if _more(f, projector) >= c.parts[c.joint]:
            return f"is as well explained by further harmonics of its {f.name}: a part"
    return ""


def _more(f: Candidate, projector: Projector) -> float:
    """Gain of further harmonics of a named wave, all at once."""
    order, *rest = f.term.shape
    shapes = [(k * order, *rest) for k in FURTHER]
    columns = [projector.weighted(f.term.reshaped(shape)) for shape in shapes]
    return projector.gain_of(f.term, np.concatenate(columns, axis=1))


def _wave(c: Candidate, motion: Motion) -> bool:
    """Whether a candidate repeats over position, with an order for its first shape value."""
    effect, j = c.term.effect, c.term.joint
    waves = effect.carrier(motion, j) is not None or effect.powers(motion, j) is not None
    return waves and bool(c.term.shape) and c.term.shape[0] > 0


def overtones(
    found: Sequence[Accepted], last: Evidence, result: FitResult
) -> list[tuple[str, str]]:
    """Notes (code, sentence) on harmonics that are left, and are the best explanation of it."""
    motion, joints, told = result.problem.motions[0], result.problem.joints, dict[int, str]()
    if last.projector is None:
        return []
    for c in plausible(last, result):
        if c.joint not in told:
            told[c.joint] = harmonic(c, found, motion, last.projector)
    return [
        (CODE, f"{joints[j]}: what is left {why} of that, not another effect")
        for j, why in told.items()
        if why
    ]
