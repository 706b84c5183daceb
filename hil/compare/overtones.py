"""Waves over position that are harmonics of one that is named: its own law, no second effect."""

from __future__ import annotations

from collections.abc import Sequence

from hil.compare.attribute import plausible
from hil.compare.candidate import Candidate
from hil.compare.evidence import Evidence
from hil.compare.findings import Accepted
from hil.identify.result import FitResult
from hil.models.motion import Motion

CODE = "harmonic"
#: Relative error of an order that is a multiple of another one, and the highest multiple.
NEAR, MOST = 0.01, 9


def overtone(c: Candidate, found: Sequence[Accepted], motion: Motion) -> tuple[int, Candidate]:
    """How many periods of a wave over position fit into one of a named wave, and that; 0: none.

    Real cogging and ripple have more harmonics than their laws here; the order of another cause is
    a whole multiple by chance only.
    """
    for f, _, _ in found:
        if f.term.joint == c.term.joint and _wave(c, motion) and _wave(f, motion):
            ratio = c.term.shape[0] / f.term.shape[0]
            times = round(ratio)
            if 2 <= times <= MOST and abs(ratio - times) < NEAR * times:
                return times, f
    return 0, c


def _wave(c: Candidate, motion: Motion) -> bool:
    """Whether a candidate repeats over position, with an order for its first shape value."""
    effect, j = c.term.effect, c.term.joint
    waves = effect.carrier(motion, j) is not None or effect.powers(motion, j) is not None
    return waves and bool(c.term.shape) and c.term.shape[0] > 0


def overtones(
    found: Sequence[Accepted], last: Evidence, result: FitResult
) -> list[tuple[str, str]]:
    """Notes (code, sentence) on harmonics that are left, and are the best explanation of it."""
    motion, joints, told = result.problem.motions[0], result.problem.joints, {}
    for c in plausible(last, result):
        times, f = overtone(c, found, motion)
        if c.joint not in told:
            told[c.joint] = (times, f)
    return [
        (
            CODE,
            f"{joints[j]}: what is left repeats {times} times within a period of its {f.name}: a "
            "further harmonic of that, not another effect",
        )
        for j, (times, f) in told.items()
        if times
    ]
