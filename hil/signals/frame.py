"""Layout of one row of the ring: what a tick leaves behind, as one vector of numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.signals.device import FloatArray

#: Words of a force sensor, and its components.
GAUGES, WRENCH_COMPONENTS = 6, 6
#: The loop itself: lateness of the wake-up and time until the commands were out [ns], periods
#: missed and rows dropped so far, worst status of the tick, operating state, mask of conditions
#: (`hil.rig.safety`), rows that waited in the ring, hottest winding [degC].
TIMING = (
    "wake_late",
    "busy",
    "missed",
    "dropped",
    "status",
    "state",
    "conditions",
    "ring",
    "winding",
)
TIMING_UNITS = ("ns", "ns", "1", "1", "1", "1", "1", "1", "degC")


@dataclass(frozen=True)
class FrameLayout:
    """Row: measured of all arms, sent efforts, words, estimates, controller state, timing.

    Measured of an arm are position, velocity (d each) and wrench (6); its words are counts,
    codes (d each) and gauges (6).

    Parameters
    ----------
    arms, states, estimates : int
        Number of arms, of controller states and, before these, of estimates.
    joints : int
        Joints of every arm, d.
    """

    arms: int
    states: int
    estimates: int = 0
    joints: int = 3

    @property
    def measured(self) -> int:
        """Measured numbers of an arm."""
        return 2 * self.joints + WRENCH_COMPONENTS

    @property
    def words(self) -> int:
        """Words of an arm."""
        return 2 * self.joints + GAUGES

    def part(self, name: str, arm: int = 0) -> slice:
        """Columns of a part: ``js``, ``cf``, ``jf`` of an arm, or one of all below."""
        d, first = self.joints, arm * self.measured
        sent = self.arms * self.measured
        words = sent + self.arms * d
        estimates = words + self.arms * self.words
        state = estimates + self.estimates
        timing = state + self.states
        start, size = {
            "js": (first, 2 * d),
            "cf": (first + 2 * d, WRENCH_COMPONENTS),
            "jf": (sent + arm * d, d),
            "words": (words, self.arms * self.words),
            "estimates": (estimates, self.estimates),
            "state": (state, self.states),
            "timing": (timing, len(TIMING)),
        }[name]
        return slice(start, start + size)

    @property
    def width(self) -> int:
        """Numbers per row."""
        own = self.estimates + self.states
        return self.arms * (self.measured + self.joints + self.words) + own + len(TIMING)

    def zeros(self) -> FloatArray:
        """An empty row."""
        return np.zeros(self.width)

    def arm(
        self, frame: FloatArray, i: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Views of arm i: position, velocity, wrench, sent effort, words."""
        d, n = self.joints, self.words
        js = frame[self.part("js", i)]
        words = frame[self.part("words")][i * n : (i + 1) * n]
        return js[:d], js[d:], frame[self.part("cf", i)], frame[self.part("jf", i)], words

    def views(self, frame: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Views of u (arms, 2 d + 6), estimates and controller state together, and timing (9,)."""
        u = frame[: self.arms * self.measured].reshape(self.arms, self.measured)
        state = slice(self.part("estimates").start, self.part("state").stop)
        return u, frame[state], frame[self.part("timing")]
