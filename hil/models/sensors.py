"""Errors of the force sensor, as the effort that they add to the measured external effort.

The sensor says w_m where w acts.  What is fitted is  tau + tau_ext,m = model + J' (w_m - w), so
an error of the sensor is a column J' e on the model's side, e its error for unit coefficient.
Without a wrench at the tip the sensors are one a joint and J is the unit matrix.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.models.effect import Effect, Param
from hil.models.motion import FloatArray, Motion

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
_SOURCE = "Cao, Laws, Rodriguez y Baena, IEEE Sensors J. 21(18), 2021 (six-axis force sensors)"


def at_tip(motion: Motion) -> bool:
    """Whether the external effort comes from a wrench at the tip."""
    return bool(motion.wrench.shape[0] == motion.n)


def channels(motion: Motion) -> list[int]:
    """Sensor channels: the wrench's three forces (and torques, if it has any), or the joints."""
    if not at_tip(motion):
        return list(range(motion.d))
    return list(range(6 if np.any(motion.wrench[:, 3:]) else 3))


def _measured(motion: Motion) -> FloatArray:
    """What the sensor says (n, channels)."""
    return motion.wrench if at_tip(motion) else motion.tau_ext


def mapped(motion: Motion, error: FloatArray, k: int) -> FloatArray:
    """Joint effort (n, d) of an error (n,) in channel k:  J' e_k error."""
    wide = np.zeros((motion.n, 6 if at_tip(motion) else motion.d))
    wide[:, k] = error
    return motion.robot.external(motion.q, wide) if at_tip(motion) else wide


class _ForceSensor(Effect):
    """An error of every channel of the force sensor, with one coefficient each."""

    family = "sensor"
    source = _SOURCE
    whole_robot = replayed = motion_only = True
    letter = ""
    unit: dict[bool, str] = {}  # noqa: RUF012  by "the channel is a force or effort"

    def error(self, motion: Motion, k: int) -> FloatArray:
        """Error of channel k for unit coefficient (n,)."""
        raise NotImplementedError

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """J' e of every channel, shape (n, d, channels); nothing without a sensor."""
        if self.available(motion, j):
            return np.zeros((motion.n, motion.d, len(self.terms(motion, j))))
        parts = [mapped(motion, self.error(motion, k), k) for k in channels(motion)]
        return np.stack(parts, axis=2)

    def terms(self, motion: Motion, j: int) -> tuple[Param, ...]:
        """One coefficient a channel."""
        tip = at_tip(motion)
        names = [AXES[k] if tip else str(k + 1) for k in channels(motion)]
        units = ["N m" if tip and k > 2 else "N" if tip else "{F}" for k in channels(motion)]
        return tuple(
            Param(f"{self.letter}{n}", self.of(u), f"{self.letter} of channel {n}")
            for n, u in zip(names, units, strict=True)
        )

    def of(self, unit: str) -> str:
        """Unit of the coefficient of a channel in `unit`."""
        return unit

    def available(self, motion: Motion, j: int) -> str:
        """Needs a force sensor."""
        return "" if np.any(_measured(motion)) else "no external force was measured"


class ForceBias(_ForceSensor):
    """A constant that the force sensor adds: it was not zeroed."""

    name, letter = "force-bias", "b"
    equation = "tau = J' b  (b in the sensor's channels)"
    signature = "a residual like that of a constant force at the tip, with no contact, too"
    confused_with = ("torque-offset", "rigid-body", "payload")
    shown_by = "rests without contact in several postures"
    explains = ("motor", "external")
    params = (Param("b", "{F}", "bias of a channel"),)

    def error(self, motion: Motion, k: int) -> FloatArray:
        """1."""
        return np.ones(motion.n)

    def twins(self, motion: Motion) -> tuple[str, ...]:
        """Measured joint by joint, a sensor's constant is an actuator's."""
        return () if at_tip(motion) else ("torque-offset",)


class ForceDrift(_ForceSensor):
    """A reading of the force sensor that wanders with time."""

    name, letter = "force-drift", "d"
    equation = "tau = J' d t  (t since the start of the run)"
    signature = "a residual that grows with time, whatever the motion"
    confused_with = ("force-bias", "friction-drift", "missed-counts")
    shown_by = "the same rest without contact at the start and at the end"
    explains = ("motor", "external")
    params = (Param("d", "{F}/s", "drift of a channel"),)

    def error(self, motion: Motion, k: int) -> FloatArray:
        """Time since the start."""
        return motion.since

    def of(self, unit: str) -> str:
        """Per second."""
        return f"{unit}/s"


class ForceGain(_ForceSensor):
    """Channels of the force sensor that show too much or too little."""

    name, letter = "force-gain", "g"
    equation = "tau = J' diag(g) w_m  (w_m measured; g = share of the reading that is too much)"
    signature = "residual proportional to the measured external force"
    confused_with = ("torque-gain", "force-crosstalk")
    shown_by = "known weights on the tip, each axis by itself"
    params = (Param("g", "1", "relative error of a channel"),)

    def error(self, motion: Motion, k: int) -> FloatArray:
        """The channel's own reading."""
        return _measured(motion)[:, k]

    def of(self, unit: str) -> str:
        """A pure number."""
        return "1"

    def twins(self, motion: Motion) -> tuple[str, ...]:
        """Joint by joint, too much force is too little motor: all else scales along."""
        return () if at_tip(motion) else ("torque-gain",)


class ForceCrosstalk(_ForceSensor):
    """One channel of the force sensor answers the force of another."""

    name, letter = "force-crosstalk", "e"
    equation = "tau = J' E w_m  (E without diagonal; forces with forces, torques with torques)"
    signature = "residual in one direction of force that follows the force in another"
    confused_with = ("force-gain", "rigid-body")
    shown_by = "forces along one axis at a time"
    explains = ("motor", "external")
    params = (Param("e", "1", "share of another channel's reading"),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """J' e_a w_b for every pair of channels (a, b), shape (n, d, pairs)."""
        w = _measured(motion)
        if self.available(motion, j):
            return np.zeros((motion.n, motion.d, len(self.terms(motion, j))))
        return np.stack([mapped(motion, w[:, b], a) for a, b in pairs(motion)], axis=2)

    def terms(self, motion: Motion, j: int) -> tuple[Param, ...]:
        """One coefficient a pair."""
        names = AXES if at_tip(motion) else tuple(str(k + 1) for k in range(motion.d))
        found = [(names[a], names[b]) for a, b in pairs(motion)]
        return tuple(Param(f"e{a}-{b}", "1", f"what {a} shows of {b}") for a, b in found)

    def available(self, motion: Motion, j: int) -> str:
        """Needs two channels that carry something."""
        if not np.any(_measured(motion)):
            return "no external force was measured"
        return "" if pairs(motion) else "the force sensor has one channel"


def pairs(motion: Motion) -> list[tuple[int, int]]:
    """Pairs (a, b) of different channels of one kind, b with a reading."""
    of = channels(motion)
    kinds = [of[:3], of[3:]] if at_tip(motion) else [of]
    return [(a, b) for kind in kinds for a in kind for b in kind if a != b]


EFFECTS: tuple[Effect, ...] = (ForceBias(), ForceDrift(), ForceGain(), ForceCrosstalk())
