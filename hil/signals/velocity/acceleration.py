"""Acceleration as in the thesis (appendix A): a low-pass filtered first difference of velocity."""

from __future__ import annotations

import numpy as np

from hil.signals.device import FloatArray
from hil.signals.velocity import kernels
from hil.signals.velocity.methods import low_pass


class FilteredAcceleration:
    """Low-pass filtered first difference.

    White noise of the velocity, sigma_v, comes out as sigma_v / T beta sqrt(2 / (2 - beta)); the
    delay of slow motion is about 1 / (2 pi f_c) + T / 2.

    Parameters
    ----------
    channels : int
        Axes.
    period : float
        Sample period [s].
    cutoff_hz : float
        Corner of the filter.

    Raises
    ------
    ConfigError
        If the corner is not between 0 and half the sample rate.
    """

    def __init__(self, channels: int, period: float, cutoff_hz: float = 30.0) -> None:
        self._state = np.zeros((channels, 2))
        self._beta, self._period = low_pass(cutoff_hz, period), period

    def reset(self, velocity: FloatArray) -> None:
        """Start anew at a steady `velocity` (n,)."""
        self._state[:, 0], self._state[:, 1] = velocity, 0.0

    def update(self, velocity: FloatArray, steps: int, acceleration: FloatArray) -> None:
        """Write `acceleration` (n,) [rad/s^2]; `steps` periods have passed since the last."""
        kernels.low_passed_slope(
            velocity, self._state, steps, self._beta, self._period, acceleration
        )
