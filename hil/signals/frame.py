"""Layout of one row of the ring: what a tick leaves behind, as one vector of numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.signals.device import FloatArray

#: Numbers per arm: measured = position, velocity (3 each), wrench (6); words = counts (3),
#: DAC codes (3), gauges (6).
MEASURED, SENT, WORDS = 12, 3, 12
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

    Parameters
    ----------
    arms, states, estimates : int
        Number of arms, of controller states and, before these, of estimates.
    """

    arms: int
    states: int
    estimates: int = 0

    def part(self, name: str, arm: int = 0) -> slice:
        """Columns of a part: ``js``, ``cf``, ``jf`` of an arm, or one of all below."""
        sent = self.arms * MEASURED
        words = sent + self.arms * SENT
        estimates = words + self.arms * WORDS
        state = estimates + self.estimates
        timing = state + self.states
        start, size = {
            "js": (arm * MEASURED, 6),
            "cf": (arm * MEASURED + 6, 6),
            "jf": (sent + arm * SENT, SENT),
            "words": (words, self.arms * WORDS),
            "estimates": (estimates, self.estimates),
            "state": (state, self.states),
            "timing": (timing, len(TIMING)),
        }[name]
        return slice(start, start + size)

    @property
    def width(self) -> int:
        """Numbers per row."""
        own = self.estimates + self.states
        return self.arms * (MEASURED + SENT + WORDS) + own + len(TIMING)

    def zeros(self) -> FloatArray:
        """An empty row."""
        return np.zeros(self.width)

    def arm(
        self, frame: FloatArray, i: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Views of arm i: position, velocity, wrench, sent effort, words."""
        js = frame[self.part("js", i)]
        words = frame[self.part("words")][i * WORDS : (i + 1) * WORDS]
        return js[:3], js[3:], frame[self.part("cf", i)], frame[self.part("jf", i)], words

    def views(self, frame: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Views of u (arms, 12), estimates and controller state together, and timing (9,)."""
        u = frame[: self.arms * MEASURED].reshape(self.arms, MEASURED)
        state = slice(self.part("estimates").start, self.part("state").stop)
        return u, frame[state], frame[self.part("timing")]
