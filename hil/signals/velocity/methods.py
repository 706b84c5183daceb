"""Velocity estimators by name; each keeps the counts of some channels and gives their rates.

Sources: first-order adaptive windowing after Janabi-Sharifi, Hayward & Chen, IEEE Trans. Control
Syst. Technol. 8(6) 2000; the Kalman filter is the textbook one for constant velocity with white
acceleration, and treats the count as uniform noise of variance 1/12.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi
from typing import Any, Protocol

import numpy as np

from hil import registry
from hil.errors import ConfigError
from hil.signals.device import FloatArray, IntArray
from hil.signals.velocity import kernels
from hil.toml import parse

GROUP = "hil.velocity"


class VelocityEstimator(Protocol):
    """Rates of some channels from their counts."""

    def reset(self, counts: IntArray) -> None:
        """Start anew at rest at `counts` (n,)."""
        ...

    def update(self, counts: IntArray, steps: int, rate: FloatArray) -> None:
        """Write counts per period into `rate` (n,); `steps` periods have passed since the last."""
        ...


def names() -> list[str]:
    """All estimators, built in or from entry points of the group ``hil.velocity``."""
    return sorted(registry.names(GROUP))


def estimator(
    name: str, options: dict[str, Any], channels: int, period: float
) -> VelocityEstimator:
    """Estimator by name.

    Parameters
    ----------
    name : str
        One of `names`.
    options : dict
        Fields of the estimator's dataclass; what is not given has its default.
    channels : int
        How many counts it follows.
    period : float
        Sample period [s].

    Raises
    ------
    ConfigError
        For an unknown name or option, or a value out of range.
    """
    config = parse(registry.load(GROUP, name), options, f"velocity {name}")
    built: VelocityEstimator = config.build(channels, period)
    return built


@dataclass(frozen=True)
class FirstDifference:
    """Difference of two neighbouring counts: no delay to speak of, all of the quantisation."""

    def build(self, channels: int, period: float) -> VelocityEstimator:
        """Estimator of so many channels."""
        return _Plain(channels, 1, kernels.first_difference, ())


@dataclass(frozen=True)
class FilteredDifference:
    """First difference behind a first-order low-pass.

    Parameters
    ----------
    cutoff_hz : float
        Corner of the filter.
    """

    cutoff_hz: float = 30.0

    def build(self, channels: int, period: float) -> VelocityEstimator:
        """Estimator of so many channels."""
        beta = low_pass(self.cutoff_hz, period)
        return _Plain(channels, 2, kernels.filtered_difference, (beta,))


@dataclass(frozen=True)
class FoawEndFit:
    """Adaptive window, line through its ends.

    Parameters
    ----------
    window : int
        Longest window [counts kept].
    noise : float
        Peak noise that a line may miss a count by; 1 is the quantisation alone.
    """

    window: int = 24
    noise: float = 1.0

    def __post_init__(self) -> None:
        if self.window < 2 or self.noise <= 0:
            raise ConfigError("velocity foaw: window must be at least 2, noise positive.")

    def build(self, channels: int, period: float) -> VelocityEstimator:
        """Estimator of so many channels."""
        return _Windowed(channels, self.window, self.noise, kernels.end_fit)


@dataclass(frozen=True)
class FoawBestFit(FoawEndFit):
    """Adaptive window, least-squares line."""

    def build(self, channels: int, period: float) -> VelocityEstimator:
        """Estimator of so many channels."""
        return _Windowed(channels, self.window, self.noise, kernels.best_fit)


@dataclass(frozen=True)
class Kalman:
    """Constant-velocity Kalman filter.

    Parameters
    ----------
    acceleration : float
        How much the acceleration may change from period to period, rms [counts/s^2].
    """

    acceleration: float = 1e5

    def __post_init__(self) -> None:
        if self.acceleration <= 0:
            raise ConfigError("velocity kalman: acceleration must be positive.")

    def build(self, channels: int, period: float) -> VelocityEstimator:
        """Estimator of so many channels."""
        return _Kalman(channels, (self.acceleration * period * period) ** 2)


def low_pass(cutoff_hz: float, period: float) -> float:
    """Share beta = 1 - exp(-2 pi f_c T) of a first-order low-pass.

    Raises
    ------
    ConfigError
        If the corner is not between 0 and half the sample rate.
    """
    if not 0.0 < cutoff_hz <= 0.5 / period:
        raise ConfigError(
            f"cutoff_hz = {cutoff_hz}: between 0 and half the sample rate, {0.5 / period:.0f} Hz."
        )
    return 1.0 - exp(-2.0 * pi * cutoff_hz * period)


class _Plain:
    def __init__(
        self, channels: int, columns: int, kernel: Any, options: tuple[float, ...]
    ) -> None:
        self._state = np.zeros((channels, columns))
        self._kernel, self._options = kernel, options

    def reset(self, counts: IntArray) -> None:
        self._state[:] = 0.0
        self._state[:, 0] = counts

    def update(self, counts: IntArray, steps: int, rate: FloatArray) -> None:
        self._kernel(counts, self._state, steps, *self._options, rate)


class _Windowed:
    def __init__(self, channels: int, window: int, noise: float, kernel: Any) -> None:
        self._past = np.zeros((channels, window))
        self._noise, self._kernel = noise, kernel

    def reset(self, counts: IntArray) -> None:
        self._past[:] = counts[:, None]

    def update(self, counts: IntArray, steps: int, rate: FloatArray) -> None:
        self._kernel(counts, self._past, steps, self._noise, rate)


class _Kalman:
    def __init__(self, channels: int, drive: float) -> None:
        self._state, self._spread = np.zeros((channels, 2)), np.zeros(3)
        self._drive = drive
        self.reset(np.zeros(channels, np.int64))

    def reset(self, counts: IntArray) -> None:
        self._state[:, 0], self._state[:, 1] = counts + 0.5, 0.0
        self._spread[:] = 1.0 / 12.0, 0.0, 1.0

    def update(self, counts: IntArray, steps: int, rate: FloatArray) -> None:
        kernels.kalman(counts, self._state, self._spread, steps, 1.0 / 12.0, self._drive, rate)
