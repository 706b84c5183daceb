"""Winding temperature of a motor by two time constants: winding to housing, housing to air."""

from __future__ import annotations

from typing import Any

import numba as nb

#: Copper: resistance per kelvin, about 25 degC [1/K].
COPPER = 0.00393
#: Order of the constants that `warm` takes.
CONSTANTS = (
    "resistance", "winding_to_housing", "housing_to_air", "winding_time", "housing_time", "ambient",
)  # fmt: skip


@nb.njit(cache=True, nogil=True)
def warm(current: float, dt: float, c: Any, heat: Any) -> float:
    """Advance one motor by `dt` [s] under `current` [A]; its winding temperature [degC].

    Parameters
    ----------
    c : ndarray (6,)
        `CONSTANTS`.
    heat : ndarray (2,)
        Rise of the housing over the air, and of the winding over the housing [K]; written.

    Notes
    -----
    Maxon, key information on motors: the two stages are first-order lags of the copper loss.
    Exact only while the stages are far apart in time (here 12 s and 612 s).
    """
    # P = R25 (1 + alpha (T - 25)) i^2
    temperature = c[5] + heat[0] + heat[1]
    loss = c[0] * (1.0 + COPPER * (temperature - 25.0)) * current * current
    # tau1 dT1/dt = R1 P - T1;  tau2 dT2/dt = R2 P - T2
    heat[1] += dt / c[3] * (c[1] * loss - heat[1])
    heat[0] += dt / c[4] * (c[2] * loss - heat[0])
    return float(c[5] + heat[0] + heat[1])
