"""From a DAC code to torque on the rotor: delay line, amplifier lag, gain, cogging, noise."""

from __future__ import annotations

from math import exp, sin, sqrt
from typing import Any

import numba as nb

from hil.sim_devices.plants.layout import HISTORY


@nb.njit(cache=True, nogil=True, error_model="numpy")
def command(p: Any, x: Any, codes: Any, random: Any, dt: float) -> None:
    """Take the DAC `codes` (3,) of a tick of length `dt` [s] and draw its disturbances."""
    x.head = (x.head + 1) % HISTORY
    for i in range(3):
        torque = codes[i] * p.dac[i]
        x.history[i, x.head] = min(max(torque, -p.torque_max[i]), p.torque_max[i])
        # AR(1): low <- a low + sqrt(1 - a^2) n, corner at noise_pole [rad/s]
        a = exp(-p.noise_pole * dt)
        x.low[i] = a * x.low[i] + sqrt(1.0 - a * a) * random[i]
        x.white[i] = random[3 + i]
    # rare bursts, three a second, that die within 80 ms
    x.bang *= exp(-dt / 0.08)
    if random[12] > 2.75:
        x.bang = 1.0 + 0.3 * random[13]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def torque(p: Any, x: Any, i: int, elapsed: float, tick: float, dt: float) -> float:
    """Torque [N m] of motor i at `elapsed` seconds into the tick, reflected to the joint."""
    return float(torque_by(p, x, i, elapsed, tick, share(p, dt)))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def share(p: Any, dt: float) -> float:
    """Share of a change of torque that the amplifier has made after `dt` [s]."""
    return 1.0 - exp(-dt / p.lag)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def torque_by(p: Any, x: Any, i: int, elapsed: float, tick: float, risen: float) -> float:
    """`torque` with the `share` of a substep."""
    back = 0
    if p.delay[i] > elapsed:
        back = 1 + int((p.delay[i] - elapsed) / tick)
    wanted = x.history[i, (x.head - back) % HISTORY]
    # lag T' = (u - T) / tau, exact over one substep
    x.drive[i] += (wanted - x.drive[i]) * risen
    value = (1.0 + p.gain[i]) * x.drive[i]
    if p.cogging[i] != 0.0:
        phase = p.cogging_cycles[i] * x.qm[i]
        value += p.cogging[i] * (sin(phase) + 0.4 * sin(2.0 * phase + 0.7))
    return float(value + p.noise_low[i] * x.low[i] + p.noise_white[i] * x.white[i])
