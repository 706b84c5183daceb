"""Who moves the leader: a hand (mass, arm and grip impedance, tremor) or a machine."""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Any

import numba as nb

from hil.sim_devices.plants.layout import SINES


@nb.njit(cache=True, nogil=True, error_model="numpy")
def aim(h: Any, t: float) -> None:
    """Where the operator wants the tip at time t [s]: a sum of sines about home."""
    if h.kind == 0:
        return
    ramp = min(1.0, t / h.onset)
    ramp = ramp * ramp * (3.0 - 2.0 * ramp)
    for k in range(3):
        place, speed = h.home[k], 0.0
        for n in range(SINES):
            angle = h.rate[k, n] * t + h.phase[k, n]
            place += ramp * h.size[k, n] * sin(angle)
            speed += ramp * h.size[k, n] * h.rate[k, n] * cos(angle)
        h.aim[k] = place
        h.aim_v[k] = speed


@nb.njit(cache=True, nogil=True, error_model="numpy")
def hold(h: Any, x: Any, dt: float) -> None:
    """Add the operator's force [N] on the tip to `x.force`; advances the hand by `dt`."""
    if h.kind == 1:
        for k in range(3):
            # grip between hand and tip; m x'' = arm spring and damper - grip
            grip = h.grip_k * (h.x[k] - x.tip[k]) + h.grip_b * (h.v[k] - x.tip_v[k])
            arm = h.arm_k * (h.aim[k] - h.x[k]) + h.arm_b * (h.aim_v[k] - h.v[k])
            h.v[k] += dt * (arm - grip) / h.mass
            h.x[k] += dt * h.v[k]
            h.aim[k] += dt * h.aim_v[k]
            x.force[k] += grip
    elif h.kind == 2:
        size, push = 0.0, h.x
        for k in range(3):
            # machine: PD to the aim, limited in norm
            push[k] = h.arm_k * (h.aim[k] - x.tip[k]) + h.arm_b * (h.aim_v[k] - x.tip_v[k])
            size += push[k] * push[k]
            h.aim[k] += dt * h.aim_v[k]
        scale = min(1.0, h.limit / (sqrt(size) + 1e-12))
        for k in range(3):
            x.force[k] += scale * push[k]
