"""Which joints' gains it is: of all of them only the ratios are determined.

Scaled efforts of all joints but one are, to a model whose masses are free, one effort that is
scaled the other way: a gain g on some joints is the same as  1 / (1 + g) - 1  on all others
(Gautier, Briot, J. Dynamic Systems, Measurement, and Control 136(5), 2014, 051025: gains need a
known payload or force).  Beside a first fit, whose loads are wrong by the gain itself, the joint
that explains most need not be the one; a refit with each of the others tells.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hil.compare.candidate import Candidate
from hil.compare.findings import Accepted, Step
from hil.compare.heldout import Examiner, HeldOut
from hil.compare.retest import larger, remade
from hil.compare.rivals import MIRROR

GAIN = "torque-gain"


def other_gains(
    found: list[Accepted], candidates: list[Candidate], ladder: list[Step], examine: Examiner
) -> bool:
    """Name other joints' gains where they do better, or as well and are fewer; whether that is so.

    Each is then as likely as not, with those that were named as its rivals.  Where as many do as
    well, as of a robot with two joints they always do, the names stay and have those as rivals.

    Parameters
    ----------
    found : list of Accepted
        Names in the order of the ladder; changed in place, as the ladder is.
    candidates : list of Candidate
        What was tried beside the first rung.
    """
    gains = [c for c, _, _ in found if c.name == GAIN]
    if not gains or min(c.absorbed for c in gains) <= MIRROR:
        return False
    rest = [x for x in found if x[0].name != GAIN]
    joints = np.flatnonzero(~ladder[0].result.problem.holds).tolist()
    alike: list[Candidate] = []
    for others in _others(gains, candidates, joints):
        names: list[Accepted] = [*((c, 0.5, gains) for c in others), *rest]
        steps = remade(names, ladder[0], examine)
        new, old = steps[-1].heldout, ladder[-1].heldout
        if _outdoes(new, old, joints, len(others) < len(gains)):
            shown = [_shown(c, *pair) for c, pair in zip(others, pairwise(steps), strict=False)]
            found[:], ladder[:] = [*((c, 0.5, gains) for c in shown), *rest], steps
            return True
        if len(others) == len(gains) and not _worse(new, old, joints):
            alike += others
    if alike:
        share = 1.0 / (1 + len(alike) // len(gains))
        found[:] = [(c, share, alike) if c.name == GAIN else (c, p, r) for c, p, r in found]
    return False


def _shown(c: Candidate, before: Step, after: Step) -> Candidate:
    """A gain with the joint whose error falls with it, which need not be its own."""
    fall = before.result.rms**2 - after.result.rms**2
    return replace(c, joint=int(np.argmax(fall / before.result.rms**2)))


def _others(
    gains: list[Candidate], candidates: list[Candidate], joints: list[int]
) -> Iterator[list[Candidate]]:
    """Gains of the other joints that move: each alone, and all of them if they are not more."""
    named = {c.joint for c in gains}
    others = [
        c for c in candidates
        if c.name == GAIN and c.joint in joints and c.joint not in named and c.absorbed > MIRROR
    ]  # fmt: skip
    yield from ([c] for c in others)
    if 1 < len(others) <= len(gains):
        yield others


def _outdoes(new: HeldOut, old: HeldOut, joints: list[int], fewer: bool) -> bool:
    """Whether held-out errors are larger on no joint, and smaller on one unless there are fewer."""
    better = fewer or any(larger(old, new, j) for j in joints)
    return better and not _worse(new, old, joints)


def _worse(new: HeldOut, old: HeldOut, joints: list[int]) -> bool:
    """Whether held-out errors are larger on any joint."""
    return any(larger(new, old, j) for j in joints)
