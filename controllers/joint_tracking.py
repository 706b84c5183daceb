"""Joint tracking: PD with gravity compensation to a periodic motion of every joint.

The motion is a slow and a fast multisine, the fast one swelling and fading.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin, tanh
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.excite import trajectory
from hil.excite.trajectory import period_times, sample
from hil.signals.device import FloatArray
from hil.signals.settable import SettableRange

_HARMONICS = 26


def coefficients(
    rng: np.random.Generator,
    amplitude: NDArray[np.float64],
    speed: NDArray[np.float64],
    period: float,
) -> NDArray[np.float64]:
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
    k = np.arange(1, _HARMONICS)
    out = np.zeros((amplitude.size, _HARMONICS, 2))
    for joint in range(amplitude.size):
        phase = rng.uniform(0.0, 2 * np.pi, _HARMONICS)
        waves = np.sin(2 * np.pi * k[:, None] * t + phase[1:, None]) / k[:, None]
        envelope = (1.0 - np.cos(2 * np.pi * t + phase[0])) / 2
        s = waves[:3].sum(0) + 1.6 * envelope * waves[3:].sum(0)
        s -= s.mean()
        s *= amplitude[joint] / np.abs(s).max()
        spectrum = np.fft.rfft(s)[1 : _HARMONICS + 1] / (t.size / 2)
        rate = np.abs(np.gradient(s, t * period)).max()
        scale = min(1.0, speed[joint] / rate) if rate > 0 else 1.0
        out[joint] = scale * np.stack([-spectrum.imag, spectrum.real], -1)
    return out


def multisine_values(c: FloatArray, t: FloatArray, period: float) -> FloatArray:
    """Values (n, d) of the motion with coefficients `c` at times `t` (n,) [s]."""
    angle = 2 * np.pi / period * np.outer(t, np.arange(1, c.shape[1] + 1))
    return np.asarray(np.sin(angle) @ c[..., 0].T + np.cos(angle) @ c[..., 1].T)


#: Limits of th2 - th3 by the parallelogram [rad] (Cavusoglu et al. 2002), less a margin.
FOLD = (-0.95, 1.13)


@dataclass(frozen=True)
class JointTrackingConfig:
    """Parameters of the law.

    Parameters
    ----------
    seed : int
        Chooses the motion.
    period : float
        After which the motion repeats [s].
    center, amplitude, speed : tuple of 3 floats
        Middle [rad], largest excursion [rad] and largest speed [rad/s] per joint.
    stiffness, damping : tuple of 3 floats
        PD gains [N m/rad], [N m s/rad].
    velocity_filter : float
        Time constant of the first-order filter on the speed [s]; keeps the damping away from
        the resonance of the cables.
    gravity : tuple of 2 floats
        Nominal gravity: g2 cos th2, g3 sin th3 [N m].
    inertia, friction : tuple of 3 floats
        Nominal inertia [kg m^2] and Coulomb friction [N m] that are fed forward, so that the
        joints do not stick where the motion turns round.
    blend : float
        Time over which the motion swells from the starting pose [s].
    trajectory : str
        Trajectory file (see `hil excite`) that every arm plays instead of the multisine; `seed`,
        `period`, `center`, `amplitude` and `speed` are then without meaning.
    """

    seed: int = 0
    period: float = 10.0
    center: tuple[float, ...] = (0.0, 0.4, 0.3)
    amplitude: tuple[float, ...] = (0.6, 0.45, 0.45)
    speed: tuple[float, ...] = (2.2, 2.2, 2.2)
    stiffness: tuple[float, ...] = (8.0, 8.0, 4.0)
    damping: tuple[float, ...] = (0.14, 0.14, 0.07)
    velocity_filter: float = 0.003
    gravity: tuple[float, ...] = (0.08, 0.0)
    inertia: tuple[float, ...] = (0.0035, 0.003, 0.0013)
    friction: tuple[float, ...] = (0.012, 0.011, 0.010)
    blend: float = 1.0
    trajectory: str = ""

    def __post_init__(self) -> None:
        for name in ("center", "amplitude", "speed", "stiffness", "damping", "inertia", "friction"):
            if len(getattr(self, name)) != 3:
                raise ConfigError(f"{name} needs three entries, one per joint.")
        if len(self.gravity) != 2:
            raise ConfigError("gravity needs two entries.")
        if self.period <= 0 or self.blend <= 0 or self.velocity_filter <= 0 or self.seed < 0:
            raise ConfigError("period, blend and velocity_filter are above 0, seed is from 0 on.")

    def settable(self) -> dict[str, SettableRange]:
        """What an operator may set: nothing of the motion, which would jump."""
        return {
            "stiffness": SettableRange(0.0, 20.0, "N m/rad", 3),
            "damping": SettableRange(0.0, 0.2, "N m s/rad", 3),
            "velocity_filter": SettableRange(0.0005, 0.02, "s"),
        }


@nb.njit(cache=True, nogil=True)
def motion(t: float, omega: float, c: Any) -> tuple[float, float, float]:
    """Place, speed and acceleration of the Fourier series `c` (h, 2) at time `t`."""
    place, speed, push = 0.0, 0.0, 0.0
    for k in range(c.shape[0]):
        w = (k + 1) * omega
        s, o = sin(w * t), cos(w * t)
        place += c[k, 0] * s + c[k, 1] * o
        speed += w * (c[k, 0] * o - c[k, 1] * s)
        push -= w * w * (c[k, 0] * s + c[k, 1] * o)
    return place, speed, push


@nb.njit(cache=True, nogil=True)
def aimed(
    t: float, i: int, c: Any, table: Any, center: Any, times: Any
) -> tuple[float, float, float]:
    """Place, speed and acceleration of joint `i` at time `t`, of the trajectory or the series."""
    if table.shape[0] > 0:
        row = round(t / times[3]) % table.shape[0]
        return table[row, i, 0], table[row, i, 1], table[row, i, 2]
    place, speed, push = motion(t, 2.0 * pi / times[0], c)
    return place + center[i], speed, push


@nb.njit(cache=True, nogil=True)
def law(
    t: float,
    x: Any,
    u: Any,
    c: Any,
    table: Any,
    center: Any,
    gains: Any,
    times: Any,
    x_next: Any,
    y: Any,
) -> None:
    """Torques of all arms: PD to the reference r, with nominal torques fed forward.

    tau = K (r - q) + D (r' - q') + I r'' + Fc tanh(r' / 0.02) + g(q)

    Parameters
    ----------
    x, x_next : ndarray (1 + 9 a,)
        1 once started; then starting pose [rad], reference [rad] and filtered speed [rad/s]
        of every arm.
    c : ndarray (a, 3, h, 2)
        Fourier coefficients of the motion.
    table : ndarray (n, 3, 3)
        Place, speed and acceleration of a trajectory at every tick of one period, instead of
        `c` and `center`; n = 0 where there is none.
    gains : ndarray (5, 3)
        Rows: stiffness, damping, nominal gravity (0, g2, g3), inertia and Coulomb friction.
    times : ndarray (4,)
        Period, blending time [s], share of the velocity filter, period of the loop [s].
    """
    arms = u.shape[0]
    x_next[0] = 1.0
    ramp = min(1.0, t / times[1])
    rate = (pi / times[1]) / 2.0 * sin(pi * ramp) if ramp < 1.0 else 0.0
    ramp = (1.0 - cos(pi * ramp)) / 2.0
    for a in range(arms):
        for i in range(3):
            place, speed, push = aimed(t, i, c[a, i], table, center, times)
            start = x[1 + 3 * a + i] if x[0] > 0.0 else u[a, i]
            # r = q0 + ramp (motion - q0)
            aim = start + ramp * (place - start)
            aim_rate = ramp * speed + rate * (place - start)
            # v <- v + share (q' - v)
            n = 1 + 6 * arms + 3 * a + i
            x_next[n] = x[n] + times[2] * (u[a, 3 + i] - x[n])
            y[a, i] = gains[0, i] * (aim - u[a, i]) + gains[1, i] * (aim_rate - x_next[n])
            y[a, i] += ramp * gains[3, i] * push + gains[4, i] * tanh(aim_rate / 0.02)
            x_next[1 + 3 * a + i] = start
            x_next[1 + 3 * arms + 3 * a + i] = aim
        y[a, 1] += gains[2, 1] * cos(u[a, 1])
        y[a, 2] += gains[2, 2] * sin(u[a, 2])


class JointTracking:
    """The law with its parameters; see `law`.

    Parameters
    ----------
    config : JointTrackingConfig
        Parameters.
    arms : tuple of str
        Names, in the order of u and y.
    period : float
        Of the loop [s].
    """

    def __init__(self, config: JointTrackingConfig, arms: tuple[str, ...], period: float) -> None:
        self.config = config
        self._center = np.array(config.center)
        self._table = _table(config.trajectory, period)
        none = np.zeros((len(arms), 3, 1, 2))
        played = bool(self._table.size)
        self._c = none if played else np.stack([self._motion(k) for k in range(len(arms))])
        self._gains = np.array(
            [
                config.stiffness,
                config.damping,
                (0.0, *config.gravity),
                config.inertia,
                config.friction,
            ]
        )
        share = 1.0 - np.exp(-period / config.velocity_filter)
        self._times = np.array([config.period, config.blend, share, period])
        names = [
            f"{arm}.{what}{i}"
            for what in ("start", "reference", "speed")
            for arm in arms
            for i in (1, 2, 3)
        ]
        self.state_names = ("started", *names)

    def _motion(self, arm: int) -> FloatArray:
        """Coefficients (3, h, 2) for one arm, scaled so that the parallelogram may fold so far."""
        config = self.config
        rng = np.random.default_rng([config.seed, arm])
        c = coefficients(rng, np.array(config.amplitude), np.array(config.speed), config.period)
        t = np.linspace(0.0, config.period, 2001)
        for _ in range(20):
            q = self._center + multisine_values(c, t, config.period)
            fold = q[:, 1] - q[:, 2]
            if fold.min() > FOLD[0] and fold.max() < FOLD[1]:
                return c
            c[1:] *= 0.9
        raise ConfigError("joint-tracking: center is outside -55..65 degrees of th2 - th3.")

    def update(
        self, t: float, x: FloatArray, u: FloatArray, x_next: FloatArray, y: FloatArray
    ) -> None:
        """One period; see `hil.signals.device.Controller`."""
        law(t, x, u, self._c, self._table, self._center, self._gains, self._times, x_next, y)


def _table(path: str, period: float) -> FloatArray:
    """Place, speed and acceleration (n, 3, 3) of a trajectory file at every tick; else empty."""
    if not path:
        return np.zeros((0, 3, 3))
    motion = trajectory.read_trajectory(path)
    if motion.d != 3:
        raise ConfigError(f"trajectory {path} moves {motion.d} joints, the arms have 3.")
    return np.ascontiguousarray(
        np.stack(sample(motion, period_times(motion, 1.0 / period)), axis=-1)
    )


Config = JointTrackingConfig
build = JointTracking
