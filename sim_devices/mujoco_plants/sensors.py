"""Hidden effects of encoders and of the force sensor, and noise."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from hil.sim_devices.mujoco_plants.laws import Place, State

FloatArray = NDArray[np.float64]
#: What the encoder of a joint sees beside its motor's angle.
Encoder = Callable[[State], float]


def eccentricity(p: Place) -> Encoder:
    """A disc that sits off its axis: once a turn, and a little twice."""
    j, e, a = p.j, 2e-3 * p.amplitude * p.link.reach, p.phase(3.5, 1.1)

    def seen(x: State) -> float:
        w = a(x.m[j])
        return e * (sin(w) + 0.15 * cos(2 * w))

    return seen


def missed(p: Place) -> Encoder:
    """Counts lost at speed, some at a time, at random instants."""
    j, some, rng, lost = p.j, 4e-3 * p.amplitude * p.link.reach, p.rng, 0.0
    start = rng.uniform(2.0, 0.3 * p.robot.seconds)

    def seen(x: State) -> float:
        nonlocal lost, start
        if x.t > start and abs(x.w[j]) > 0.25 * p.link.speed:
            lost -= some * (1.0 if x.w[j] > 0.0 else -1.0)
            start = x.t + rng.uniform(0.15, 0.4) * p.robot.seconds
        return lost

    return seen


ENCODERS: dict[str, Callable[[Place], Encoder]] = {
    "encoder-eccentricity": eccentricity,
    "missed-counts": missed,
}

#: Change of what was recorded: positions (n, d), forces (n, 3), rows a second, place.
Recorded = Callable[[FloatArray, FloatArray, float, Place], None]


def late(q: FloatArray, force: FloatArray, rate: float, p: Place) -> None:
    """A first-order filter on the recorded position."""
    a = float(np.exp(-1.0 / (rate * 4e-3 * p.amplitude)))
    x = q[:, p.j]
    shifted = np.asarray(scipy.signal.lfilter([1.0 - a], [1.0, -a], x - x[0]))
    q[:, p.j] = shifted + x[0]


def bias(q: FloatArray, force: FloatArray, rate: float, p: Place) -> None:
    """A bridge that was not zeroed."""
    force[:, p.j % 3] += 0.1 * p.amplitude * _rms(force)


def drift(q: FloatArray, force: FloatArray, rate: float, p: Place) -> None:
    """Warming of the gauges: a square-root ramp that saturates."""
    u = np.arange(len(q)) / len(q)
    force[:, p.j % 3] += 0.2 * p.amplitude * _rms(force) * u / (0.3 + u)


def force_gain(q: FloatArray, force: FloatArray, rate: float, p: Place) -> None:
    """A channel whose reading grows by its square root's worth."""
    k = p.j % 3
    force[:, k] *= 1.0 + 0.08 * p.amplitude


def force_crosstalk(q: FloatArray, force: FloatArray, rate: float, p: Place) -> None:
    """A share of another channel."""
    k = p.j % 3
    force[:, k] += 0.1 * p.amplitude * force[:, (k + 1) % 3]


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


RECORDED: dict[str, Recorded] = {
    "filter-lag": late,
    "force-bias": bias,
    "force-drift": drift,
    "force-gain": force_gain,
    "force-crosstalk": force_crosstalk,
}


def disturbance(kind: str, n: int, std: FloatArray, step: float, seed: int) -> FloatArray:
    """Effort (n, d) that acts on the plant beside the motors' [N m or N].

    ``"coloured"`` is first-order noise of 4 Hz with a little white; ``"white"`` and ``"dac"`` have
    none: their noise lies between the effort that acts and the recorded one.
    """
    if kind != "coloured":
        return np.zeros((n, std.size))
    rng = np.random.default_rng([seed, 0xC010])
    a = float(np.exp(-2 * np.pi * 4.0 * step))
    drive = rng.standard_normal((n, std.size)) * np.sqrt(1.0 - a * a)
    low = np.asarray(scipy.signal.lfilter([1.0], [1.0, -a], drive, axis=0))
    return np.asarray(std * (0.22 * low + 0.25 * rng.standard_normal(low.shape)))


def recorded_noise(kind: str, n: int, std: FloatArray, seed: int) -> FloatArray:
    """Noise (n, d) of the recorded effort [N m or N]: white for a measured current, else none."""
    rng = np.random.default_rng([seed, 0x3117E])
    white: FloatArray = rng.standard_normal((n, std.size))
    return std * white * (1.0 if kind == "white" else 0.0)
