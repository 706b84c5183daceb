"""Periodic reference motion: a slow and a fast multisine, the fast one swelling and fading."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

HARMONICS = 26


def coefficients(
    rng: np.random.Generator, amplitude: NDArray[np.float64], speed: NDArray[np.float64],
    period: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Fourier coefficients of a motion within `amplitude` and `speed`.

    s(t) = slow(t) + (1 - cos(w t + a)) / 2 * fast(t): slow passes with small speeds and fast
    ones with many reversals alternate within one period.

    Parameters
    ----------
    rng : Generator
        Chooses phases.
    amplitude, speed : ndarray (d,)
        Largest excursion [rad] and speed [rad/s].
    period : float
        [s]

    Returns
    -------
    ndarray (d, HARMONICS, 2)
        Factors of sin(k w t) and cos(k w t), k = 1..HARMONICS.
    """
    t = np.arange(4096) / 4096.0
    k = np.arange(1, HARMONICS)
    out = np.zeros((amplitude.size, HARMONICS, 2))
    for joint in range(amplitude.size):
        phase = rng.uniform(0.0, 2 * np.pi, HARMONICS)
        waves = np.sin(2 * np.pi * k[:, None] * t + phase[1:, None]) / k[:, None]
        envelope = (1.0 - np.cos(2 * np.pi * t + phase[0])) / 2
        s = waves[:3].sum(0) + 1.6 * envelope * waves[3:].sum(0)
        s -= s.mean()
        s *= amplitude[joint] / np.abs(s).max()
        spectrum = np.fft.rfft(s)[1 : HARMONICS + 1] / (t.size / 2)
        rate = np.abs(np.gradient(s, t * period)).max()
        scale = min(1.0, speed[joint] / rate)
        out[joint] = scale * np.stack([-spectrum.imag, spectrum.real], -1)
    return out


def sample(c: NDArray[np.float64], t: NDArray[np.float64], period: float) -> NDArray[np.float64]:
    """Values (n, d) of the motion with coefficients `c` at times `t` (n,) [s]."""
    angle = 2 * np.pi / period * np.outer(t, np.arange(1, c.shape[1] + 1))
    return np.asarray(np.sin(angle) @ c[..., 0].T + np.cos(angle) @ c[..., 1].T)
