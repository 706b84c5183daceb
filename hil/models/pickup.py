"""A load that was picked up or put down in the middle of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.models.effect import (
    AT_AN_INSTANT,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Of,
    Param,
    Scope,
    Shapes,
    Trait,
)
from hil.models.motion import FloatArray, Motion

#: Farthest that a load's centre lies from the tip [m].
REACH = 0.5
MASS = Param("m", "kg", "mass at the tip from then on, more than before")
MOMENTS = tuple(
    Param(name, "kg m", f"its first moment about the tip, {axis} axis of the last link")
    for name, axis in (("mx", "x"), ("my", "y"), ("mz", "z"))
)
_LOAD = (MASS, *MOMENTS)


def _payload_change_grid(motion: Motion, j: int) -> Shapes:
    """Fifteen instants from 5 to 95 % of the run."""
    return [(float(t),) for t in np.linspace(0.05, 0.95, 15) * motion.since[-1]]


def _payload_change_terms(motion: Motion, j: int) -> tuple[Param, ...]:
    """The mass; where the last link is described, its moments, too."""
    load = motion.robot.tip_load(motion.q[:2], motion.qd[:2], motion.qdd[:2])
    return _LOAD if load is None else _LOAD[: load.shape[2]]


def _payload_change_near(f: Fitted) -> bool:
    """The load's centre lies within reach of the tip."""
    return float(np.linalg.norm(f.beta[1:])) <= REACH * abs(f.beta[0])


def _payload_change_lacks(motion: Motion, j: int) -> str:
    """Needs a tip."""
    none = motion.robot.tip_load(motion.q[:2], motion.qd[:2], motion.qdd[:2]) is None
    return "the robot has no geometry, so no tip" if none else ""


class PayloadChange(Effect):
    """A load picked up or put down at an instant of the run.

    Of a load that a whole run carries the links' own inertias take account (`payload`); one that
    changes shows on all joints at once, and belongs to its run.
    """

    name, family = "payload-change", "mass"
    doc = Doc(
        equation="tau = m J' (p'' + g e_z) for t > t0, its centre m c apart from the tip",
        signature="gravity and inertia of all joints change at one instant",
        confused_with=("missed-counts", "payload", "torque-offset"),
        shown_by="one recording before and one after, given as two sessions",
        source=(
            "Atkeson, An, Hollerbach, Int. J. Robotics Research 5(3), 1986 (load of a manipulator)"
        ),
    )
    params = _LOAD
    shape = (Param("t0", "s", "instant, since the start of the run", 0.0),)
    scope = Scope(Of.TIP, lacks=_payload_change_lacks, terms=_payload_change_terms)
    variation = AT_AN_INSTANT
    search = Grid(_payload_change_grid)
    limits = (Limit("reach", _payload_change_near),)
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort of a unit mass and of unit moments after t0, shape (n, d, 1 or 4)."""
        load = motion.robot.tip_load(motion.q, motion.qd, motion.qdd)
        if load is None:
            return np.zeros((motion.n, motion.d, len(self.params)))
        after = np.clip((motion.since - float(shape[0])) / motion.dt + 0.5, 0.0, 1.0)
        return load * after[:, None, None]


EFFECTS: tuple[Effect, ...] = (PayloadChange(),)
