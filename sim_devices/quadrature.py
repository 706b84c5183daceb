"""Optical encoders as edges: two tracks, a decoder that samples them, and what it gets wrong.

The tracks A and B run through 00 01 11 10 in the forward direction.  A decoder that sees both
change between two samples cannot tell the direction: it counts nothing and raises a flag.  Two
samples three edges apart look like one edge back, and no flag tells.  A dirty line is a track A
that stays dark over one line: four counts are lost in either direction, and none is illegal.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

#: Steps in which a slow motion is looked at [quarter lines].
FINE = 0.25
_STEP = np.zeros((4, 4), np.int64)
for _before, _after in ((0, 1), (1, 3), (3, 2), (2, 0)):
    _STEP[_before, _after], _STEP[_after, _before] = 1, -1
for _before, _after in ((0, 3), (3, 0), (1, 2), (2, 1)):
    _STEP[_before, _after] = 2  # illegal


class Quadrature:
    """Encoders of some motors with their decoders.

    Parameters
    ----------
    channels : int
        Encoders.
    lines : int
        Lines a turn.
    phase_error : float
        How far track A is out of place against B [quarter lines], below 1.
    dirty : sequence of int
        Lines on which A stays dark.
    decoder_hz : float
        Samples of the decoder per second.

    Attributes
    ----------
    counts, illegal : ndarray (channels,) of int
        What the decoder has counted, and how often it saw an illegal transition.

    Raises
    ------
    ConfigError
        For values out of range.
    """

    def __init__(
        self,
        channels: int,
        lines: int = 1024,
        phase_error: float = 0.0,
        dirty: Sequence[int] = (),
        decoder_hz: float = 1e7,
    ) -> None:
        if not abs(phase_error) < 1.0 or decoder_hz <= 0 or lines < 1:
            raise ConfigError("quadrature: |phase_error| < 1, decoder_hz > 0, lines > 0 needed.")
        if any(not 0 <= line < lines for line in dirty):
            raise ConfigError(f"quadrature: dirty lines are 0 to {lines - 1}.")
        self._dark = np.zeros(lines, np.bool_)
        self._dark[list(dirty)] = True
        self._phase, self._rate = phase_error, decoder_hz
        self.counts, self.illegal = np.zeros(channels, np.int64), np.zeros(channels, np.int64)
        self._at = np.zeros(channels)

    def reset(self, place: NDArray[np.float64]) -> None:
        """The encoders stand at `place` (channels,) [quarter lines], and the counts agree."""
        self._at[:] = place
        self.counts[:], self.illegal[:] = np.floor(place).astype(np.int64), 0

    def advance(self, place: NDArray[np.float64], seconds: float) -> None:
        """The encoders go evenly to `place` (channels,) [quarter lines] within `seconds`."""
        _advance(
            self._at,
            place,
            seconds * self._rate,
            self._phase,
            self._dark,
            _STEP,
            self.counts,
            self.illegal,
        )


@nb.njit(cache=True, nogil=True)
def tracks(x: float, phase: float, dark: Any) -> int:
    """State 2 A + B of the tracks at `x` quarter lines."""
    b = 1 if 1.0 <= x % 4.0 < 3.0 else 0
    a = 1 if (x - phase) % 4.0 >= 2.0 else 0
    if dark[int(x // 4.0) % dark.size]:
        a = 0
    return 2 * a + b


@nb.njit(cache=True, nogil=True)
def _advance(
    at: Any,
    place: Any,
    samples: float,
    phase: float,
    dark: Any,
    step: Any,
    counts: Any,
    illegal: Any,
) -> None:
    for i in range(at.size):
        way = place[i] - at[i]
        if way == 0.0:
            continue
        # a fast motion is seen once a sample of the decoder, a slow one in fine steps
        n = max(1, int(np.ceil(min(abs(way) / FINE, samples))))
        seen = tracks(at[i], phase, dark)
        for k in range(1, n + 1):
            now = tracks(at[i] + way * k / n, phase, dark)
            moved = step[seen, now]
            if moved == 2:
                illegal[i] += 1
            else:
                counts[i] += moved
            seen = now
        at[i] = place[i]
