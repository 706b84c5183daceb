"""Errors of the force sensor, as the effort that they add to the measured external effort.

The sensor says w_m where w acts.  What is fitted is  tau + tau_ext,m = model + J' (w_m - w), so
an error of the sensor is a column J' e on the model's side, e its error for unit coefficient; its
channels and J are those of `hil.models.channels`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.models.channels import AXES, BASE, TIP, at_tip, channels, lever, pairs, readings
from hil.models.effect import Effect, Param, margins
from hil.models.motion import FloatArray, Motion

#: Share of the motor's effort from which a force is more than the noise of its sensor.
PUSH = 0.05
_SOURCE = "Cao, Laws, Rodriguez y Baena, IEEE Sensors J. 21(18), 2021 (six-axis force sensors)"


class _ForceSensor(Effect):
    """An error of every channel of the force sensor, with one coefficient each."""

    family = "sensor"
    source = _SOURCE
    whole_robot = replayed = motion_only = jointless = True
    refine = False
    letter = ""
    shape: ClassVar[tuple[Param, ...]] = (
        Param(
            "frame",
            "1",
            "axes of the channels: 0 base, 1 tip",
            BASE,
            TIP,
            codes=((BASE, "along the base's axes"), (TIP, "along the tip's axes")),
            choice=True,
        ),
    )

    def error(self, motion: Motion, readings: FloatArray) -> FloatArray:
        """Error of the channels for unit coefficient (n, channels)."""
        raise NotImplementedError

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """J' e of every channel, shape (n, d, channels); nothing without a sensor."""
        if self.available(motion, j):
            return np.zeros((motion.n, motion.d, len(self.terms(motion, j))))
        error = self.error(motion, readings(motion, shape[0]))
        return lever(motion, shape[0]) * error[:, None, :]

    def grid(self, motion: Motion, j: int) -> list[tuple[float, ...]]:
        """Base axes; those of the tip where there is one that turns."""
        turned = motion.robot.tip_axes(motion.q[:2]) if at_tip(motion) else None
        return [(BASE,)] if turned is None else [(BASE,), (TIP,)]

    def credible(
        self, motion: Motion, j: int, shape: Sequence[float], beta: Sequence[float],
        error: Sequence[float] = (),
    ) -> bool:  # fmt: skip
        """What a sensor adds to its reading stands in the reading: no more than twice its size."""
        shown = readings(motion, shape[-1])
        if len(beta) != shown.shape[1]:
            return True
        added = self.error(motion, shown) * np.array(beta) * self.warmth(motion, shape[0])[:, 0]
        return float(np.sum(added**2)) <= 4.0 * float(np.sum(shown**2))

    def warmth(self, motion: Motion, time: float) -> FloatArray:
        """Factor over time of all channels, shape (n, 1, 1)."""
        return np.ones((motion.n, 1, 1))

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
        some = np.any(motion.wrench) if at_tip(motion) else np.any(motion.tau_ext)
        return "" if some else "no external force was measured"


class ForceBias(_ForceSensor):
    """A constant that the force sensor adds: it was not zeroed."""

    name, letter = "force-bias", "b"
    equation = "tau = J' b  (b in the sensor's channels, along base or tip axes)"
    signature = "a residual like that of a constant force at the tip, with no contact, too"
    confused_with = ("torque-offset", "rigid-body", "payload")
    shown_by = "rests without contact in several postures"
    explains = ("motor", "external")
    params = (Param("b", "{F}", "bias of a channel"),)

    def error(self, motion: Motion, readings: FloatArray) -> FloatArray:
        """1."""
        return np.ones_like(readings)

    def twins(self, motion: Motion) -> tuple[str, ...]:
        """Measured joint by joint, a sensor's constant is an actuator's."""
        return () if at_tip(motion) else ("torque-offset",)


class ForceDrift(_ForceSensor):
    """A reading of the force sensor that wanders with time."""

    name, letter = "force-drift", "d"
    equation = "tau = J' d T (1 - exp(-t / T))  (t since the start of the run)"
    signature = "a residual that grows with time, whatever the motion"
    confused_with = ("force-bias", "friction-drift", "missed-counts")
    shown_by = "the same rest without contact at the start and at the end"
    explains = ("motor", "external")
    params = (Param("d", "{F}/s", "drift of a channel at the start"),)
    shape = (Param("T", "s", "time constant", 0.0), *_ForceSensor.shape)
    refine = True

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """J' T (1 - exp(-t / T)) of every channel, shape (n, d, channels)."""
        return super().columns(motion, j, shape[1:]) * self.warmth(motion, shape[0])

    def warmth(self, motion: Motion, time: float) -> FloatArray:
        """T (1 - exp(-t / T)), shape (n, 1, 1)."""
        return (-time * np.expm1(-motion.since / time))[:, None, None]

    def grid(self, motion: Motion, j: int) -> list[tuple[float, ...]]:
        """Straight (a hundred times the run), and from ten times to a twentieth of it."""
        times = motion.since[-1] * np.array([100.0, 10.0, 1.0, 0.5, 0.2, 0.1, 0.05])
        return [(float(t), *frame) for frame in super().grid(motion, j) for t in times]

    def error(self, motion: Motion, readings: FloatArray) -> FloatArray:
        """1, before the time's part."""
        return np.ones_like(readings)

    def of(self, unit: str) -> str:
        """Per second."""
        return f"{unit}/s"


def pushed(motion: Motion) -> str:
    """Why an error that grows with the force cannot be seen; empty where a force of size acts."""
    size = np.std(motion.tau_ext, axis=0) > PUSH * np.std(motion.tau, axis=0)
    return "" if np.any(size) else "the measured force is no more than noise beside the effort"


class ForceGain(_ForceSensor):
    """Channels of the force sensor that show too much or too little."""

    name, letter = "force-gain", "g"
    equation = "tau = J' diag(g) w_m  (w_m measured; g = share of the reading that is too much)"
    signature = "residual proportional to the measured external force"
    confused_with = ("torque-gain", "force-crosstalk")
    shown_by = "known weights on the tip, each axis by itself"
    params = (Param("g", "1", "relative error of a channel"),)

    def error(self, motion: Motion, readings: FloatArray) -> FloatArray:
        """The channel's own reading."""
        return readings

    def of(self, unit: str) -> str:
        """A pure number."""
        return "1"

    def available(self, motion: Motion, j: int) -> str:
        """Needs a force that is felt."""
        return super().available(motion, j) or pushed(motion)

    def credible(
        self, motion: Motion, j: int, shape: Sequence[float], beta: Sequence[float],
        error: Sequence[float] = (),
    ) -> bool:  # fmt: skip
        """A channel that shows half as much again is broken, not out of calibration."""
        return max(abs(b) for b in beta) < 0.5

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
        if self.available(motion, j):
            return np.zeros((motion.n, motion.d, len(self.terms(motion, j))))
        w, arm = readings(motion, shape[0]), lever(motion, shape[0])
        return np.stack([arm[:, :, a] * w[:, b : b + 1] for a, b in pairs(motion)], axis=2)

    def credible(
        self, motion: Motion, j: int, shape: Sequence[float], beta: Sequence[float],
        error: Sequence[float] = (),
    ) -> bool:  # fmt: skip
        """A channel that shows more of another than of itself is swapped, not crossed."""
        slack = margins(beta, error)
        return all(abs(b) < 1.0 + e for b, e in zip(beta, slack, strict=True))

    def terms(self, motion: Motion, j: int) -> tuple[Param, ...]:
        """One coefficient a pair."""
        names = AXES if at_tip(motion) else tuple(str(k + 1) for k in range(motion.d))
        found = [(names[a], names[b]) for a, b in pairs(motion)]
        return tuple(Param(f"e{a}-{b}", "1", f"what {a} shows of {b}") for a, b in found)

    def available(self, motion: Motion, j: int) -> str:
        """Needs two channels that carry something."""
        return (
            super().available(motion, j)
            or pushed(motion)
            or ("" if pairs(motion) else "the force sensor has one channel")
        )


EFFECTS: tuple[Effect, ...] = (ForceBias(), ForceDrift(), ForceGain(), ForceCrosstalk())
