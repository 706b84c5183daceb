"""Velocity and acceleration from encoder counts: a family of estimators under one registry.

Differences, first-order adaptive windowing (end fit and best fit) and a Kalman filter; their
kernels are compiled and work on all channels at once.  Acceleration is a filtered difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, fabs, inf, pi, pow
from typing import Any, Protocol

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil import registry
from hil.errors import ConfigError
from hil.signals.device import FloatArray, IntArray
from hil.toml import parse


@nb.njit(cache=True, nogil=True)
def _first_difference(counts: Any, state: Any, steps: int, out: Any) -> None:
    """V = (y_k - y_(k-1)) / T; state: last count."""
    for i in range(counts.size):
        out[i] = (counts[i] - state[i, 0]) / steps
        state[i, 0] = counts[i]


@nb.njit(cache=True, nogil=True)
def filtered_difference(counts: Any, state: Any, steps: int, beta: float, out: Any) -> None:
    """First-order low-pass of the first difference; state: last count, last output."""
    # v += (1 - (1 - beta)^steps) (difference - v), beta = 1 - exp(-2 pi f_c T)
    share = 1.0 - pow(1.0 - beta, steps)
    for i in range(counts.size):
        difference = (counts[i] - state[i, 0]) / steps
        state[i, 0] = counts[i]
        state[i, 1] += share * (difference - state[i, 1])
        out[i] = state[i, 1]


@nb.njit(cache=True, nogil=True)
def _remember(counts: Any, past: Any, steps: int) -> None:
    """Move `counts` (n,) into `past` (n, window), in which the newest comes first.

    What lies between the last call and this one is filled in by a line.
    """
    window = past.shape[1]
    for i in range(counts.size):
        row, now = past[i], float(counts[i])
        last = row[0] if steps < window else now
        for k in range(window - 1, steps - 1, -1):
            row[k] = row[k - steps]
        for k in range(min(steps, window)):
            row[k] = now - (now - last) * k / steps


@nb.njit(cache=True, nogil=True)
def end_fit(counts: Any, past: Any, steps: int, noise: float, out: Any) -> None:
    """Counts per period through the two ends of the longest window that the noise allows.

    b_n = (y_k - y_(k-n)) / n; accept n while |y_k - b_n j - y_(k-j)| <= noise, 0 < j < n
    """
    _remember(counts, past, steps)
    window = past.shape[1]
    for i in range(past.shape[0]):
        row = past[i]
        now, best = row[0], 0.0
        for n in range(1, window):
            b = (now - row[n]) / n
            if not _within(row, n, now, b, noise):
                break
            best = b
        out[i] = best


@nb.njit(cache=True, nogil=True)
def best_fit(counts: Any, past: Any, steps: int, noise: float, out: Any) -> None:
    """Counts per period of the least-squares line of the longest window that the noise allows.

    b_n = 6 sum_(i=0..n) (n - 2 i) y_(k-i) / (n (n + 1) (n + 2)); accepted as in `end_fit`
    """
    _remember(counts, past, steps)
    window = past.shape[1]
    for i in range(past.shape[0]):
        row = past[i]
        now, best = row[0], 0.0
        plain, moment = 0.0, 0.0
        for n in range(1, window):
            # from the newest count on, for the weights sum to zero
            y = row[n] - now
            plain += y
            moment += n * y
            # sum (n - 2 i) y = n sum y - 2 sum i y
            b = 6.0 * (n * plain - 2.0 * moment) / (n * (n + 1.0) * (n + 2.0))
            if not _within(row, n, now, b, noise):
                break
            best = b
        out[i] = best


@nb.njit(cache=True, nogil=True)
def _within(row: Any, n: int, now: float, b: float, noise: float) -> bool:
    """Whether the line of slope b through the newest count passes all between within noise."""
    outside = 0
    for j in range(1, n):  # without a way out of the loop, so that it takes several at once
        outside += int(fabs(now - b * j - row[j]) > noise)
    return outside == 0


@nb.njit(cache=True, nogil=True)
def kalman(
    counts: Any, state: Any, spread: Any, steps: int, noise: float, drive: float, out: Any
) -> None:
    """Constant-velocity Kalman filter in counts and periods.

    Parameters
    ----------
    state : ndarray (n, 2)
        Position [counts] and velocity [counts per period].
    spread : ndarray (3,)
        Covariance p00, p01, p11, the same for all channels.
    noise, drive : float
        Variance of a count [counts^2], and of the acceleration per period [counts^2].
    """
    h = float(steps)
    p00, p01, p11 = spread[0], spread[1], spread[2]
    # P = F P F^T + Q, F = [[1, h], [0, 1]], Q = drive [[h^3/3, h^2/2], [h^2/2, h]]
    p00 += h * (2.0 * p01 + h * p11) + drive * h * h * h / 3.0
    p01 += h * p11 + drive * h * h / 2.0
    p11 += drive * h
    # K = P H^T / (H P H^T + R), H = [1, 0]
    k0, k1 = p00 / (p00 + noise), p01 / (p00 + noise)
    spread[2] = p11 - k1 * p01
    spread[1] = (1.0 - k0) * p01
    spread[0] = (1.0 - k0) * p00
    for i in range(counts.size):
        # count n stands for the interval n..n+1: take its middle
        ahead = state[i, 0] + h * state[i, 1]
        gap = counts[i] + 0.5 - ahead
        state[i, 0] = ahead + k0 * gap
        state[i, 1] += k1 * gap
        out[i] = state[i, 1]


@nb.njit(cache=True, nogil=True)
def low_passed_slope(
    value: Any, state: Any, steps: int, beta: float, period: float, out: Any
) -> None:
    """Low-pass of the first difference of `value`; state: last value, last output."""
    # a += beta ((v_k - v_(k-1)) / T - a)
    share = 1.0 - pow(1.0 - beta, steps)
    for i in range(value.size):
        slope = (value[i] - state[i, 0]) / (steps * period)
        state[i, 0] = value[i]
        state[i, 1] += share * (slope - state[i, 1])
        out[i] = state[i, 1]


_GROUP = "hil.velocity"


class VelocityEstimator(Protocol):
    """Rates of some channels from their counts."""

    def reset(self, counts: IntArray) -> None:
        """Start anew at rest at `counts` (n,)."""
        ...

    def update(self, counts: IntArray, steps: int, rate: FloatArray) -> None:
        """Write counts per period into `rate` (n,); `steps` periods have passed since the last.

        Raises
        ------
        ConfigError
            If there are not as many counts and rates as channels, or no period has passed.
        """
        ...


def estimator_names() -> list[str]:
    """All estimators, built in or from entry points of the group ``hil.velocity``."""
    return sorted(registry.names(_GROUP))


def estimator(
    name: str, options: dict[str, Any], channels: int, period: float
) -> VelocityEstimator:
    """Estimator by name.

    Parameters
    ----------
    name : str
        One of `estimator_names`.
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
    config = parse(registry.load(_GROUP, name), options, f"velocity {name}")
    built: VelocityEstimator = config.build(channels, period)
    return built


@dataclass(frozen=True)
class FirstDifference:
    """Difference of two neighbouring counts: no delay to speak of, all of the quantisation."""

    def build(self, channels: int, period: float) -> VelocityEstimator:
        """Estimator of so many channels."""
        return _Plain(channels, 1, _first_difference, ())


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
        return _Plain(channels, 2, filtered_difference, (beta,))


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
        if self.window < 2 or not 0 < self.noise < inf:
            raise ConfigError("velocity foaw: window must be at least 2, noise positive.")

    def build(self, channels: int, period: float) -> VelocityEstimator:
        """Estimator of so many channels."""
        return _Windowed(channels, self.window, self.noise, end_fit)


@dataclass(frozen=True)
class FoawBestFit(FoawEndFit):
    """Adaptive window, least-squares line."""

    def build(self, channels: int, period: float) -> VelocityEstimator:
        """Estimator of so many channels."""
        return _Windowed(channels, self.window, self.noise, best_fit)


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
        if not 0 < self.acceleration < inf:
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


def _refuse(values: NDArray[Any], out: FloatArray, channels: int, steps: int) -> None:
    """Refuse what a kernel would read or write beyond: its loops go over the values given."""
    if values.shape != (channels,) or out.shape != (channels,) or steps < 1:
        raise ConfigError(
            f"velocity: {channels} channels got values of the shape {values.shape} into rates of "
            f"the shape {out.shape} after {steps} periods; expected ({channels},) twice, and one "
            "period at least"
        )


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
        _refuse(counts, rate, len(self._state), steps)
        self._kernel(counts, self._state, steps, *self._options, rate)


class _Windowed:
    def __init__(self, channels: int, window: int, noise: float, kernel: Any) -> None:
        self._past = np.zeros((channels, window))
        self._noise, self._kernel = noise, kernel

    def reset(self, counts: IntArray) -> None:
        self._past[:] = counts[:, None]

    def update(self, counts: IntArray, steps: int, rate: FloatArray) -> None:
        _refuse(counts, rate, len(self._past), steps)
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
        _refuse(counts, rate, len(self._state), steps)
        kalman(counts, self._state, self._spread, steps, 1.0 / 12.0, self._drive, rate)


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
        _refuse(velocity, acceleration, len(self._state), steps)
        low_passed_slope(velocity, self._state, steps, self._beta, self._period, acceleration)
