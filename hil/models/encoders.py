"""Errors of the measured motion: a lag of its filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.models.effect import Effect, Param
from hil.models.motion import FloatArray, Motion


class FilterLag(Effect):
    """The motion is measured late: a low-pass in the drive or in the encoder's interface.

    Where the motor's effort is all that acts, a late motion and a late command are the same
    thing: both let the effort lead the measured motion.  A measured external effort leads with
    a late motion, too, but not with a late command: then the two differ.
    """

    name, family = "filter-lag", "sensor"
    equation = "tau + tau_ext = model(t) + T d(tau + tau_ext)/dt  (first order in T)"
    signature = "motor effort and external effort both lead the measured motion"
    confused_with = ("delay", "actuator-lag")
    shown_by = "pushes by hand while the motor moves"
    source = "Gautier, Vandanjon, Presse, CDC 1994 (filtering in identification); Taylor expansion"
    replayed = True
    params = (Param("T", "s", "lag of the measured motion", 0.0),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """d(tau + tau_ext)/dt."""
        whole = motion.tau[:, j] + motion.tau_ext[:, j]
        return np.gradient(whole, motion.dt)[:, None]

    def available(self, motion: Motion, j: int) -> str:
        """Structural: without an external effort it is a delay of the command."""
        if np.ptp(motion.tau_ext[:, j]) > 0:
            return ""
        return (
            "without a measured external force a lag of the measured motion is the same as "
            "'delay': both let the effort lead the motion"
        )


EFFECTS: tuple[Effect, ...] = (FilterLag(),)
