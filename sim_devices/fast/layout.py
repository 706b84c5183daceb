"""Memory layout of the compiled session: the further hidden effects and the plant's records."""

from __future__ import annotations

import numpy as np

from hil.sim_devices.plants.layout import ARM as PLANT_ARM
from hil.sim_devices.plants.layout import ELEMENTS
from hil.sim_devices.plants.layout import STATE as PLANT_STATE

_F, _J = np.float64, (3,)

_MORE = np.dtype(
    [
        ("locked", np.int64),  # 1: joints 2 and 3 are clamped, a single axis is left
        ("preslide", _F, _J),
        ("preslide_at", _F, (3, ELEMENTS)),  # [N m], [rad]
        ("rub", _F, _J),
        ("rub_cycles", _F, _J),  # [N m], [rad/rad]
        ("load_rub", _F, _J),
        ("fade", _F, _J),  # [N m]
        ("give", _F, _J),
        ("soft", _F, _J),
        ("soft_at", _F, _J),  # [rad/(N m)], 1, [rad]
        ("slack", _F, _J),  # [rad]
        ("idler", _F, _J),  # [N m]
        ("ripple", _F, _J),
        ("ripple_cycles", _F, _J),  # 1, [rad/rad]
        ("detent", _F, _J),
        ("detent_cycles", _F, _J),  # [N m], [rad/rad]
        ("slow_drive", _F, _J),
        ("jitter", _F, _J),
        ("offset", _F, _J),  # [s], [s], [N m]
        ("leak", _F, _J),
        ("choke", _F, _J),  # 1, [1/(N m)]
        ("oscillator", _F, _J),
        ("oscillator_rate", _F, _J),  # [kg m^2], [rad/s]
        ("hum", _F, _J),
        ("hum_rate", _F, _J),  # [N m], [rad/s]
        ("wobble", _F, _J),
        ("wobble_cycles", _F, _J),
        ("slips", _F, _J),  # [rad], 1, [counts]
        ("telegraph", _F, _J),
        ("chirp", _F, _J),
        ("pair", _F, _J),  # [N m]
        ("thixotropy", _F, _J),
        ("placed_viscous", _F, _J),  # [N m], [N m s/rad^2]
    ]
)

_MORE_STATE = np.dtype(
    [
        ("zp", _F, (3, ELEMENTS)),  # presliding elements [rad]
        ("slow", _F, (3, 2)),  # second-order amplifier [N m], [N m/s]
        ("idle", _F, (3, 2)),
        ("osc", _F, (3, 2)),  # idler and attached oscillator [rad], [rad/s]
        ("idle_z", _F, (3, ELEMENTS)),
        ("lost", _F, _J),
        ("flip", _F, _J),
        ("thick", _F, _J),  # [counts], +-1, 0..1
    ]
)

#: Parameters of the arm; all of the first part are zero unless an effect is hidden.
# The plant's fields come last: Numba takes a record that only continues another one for that
# other type, with a warning, and a function compiled for the plant would serve both.
ARM = np.dtype(_MORE.descr + PLANT_ARM.descr)
STATE = np.dtype(_MORE_STATE.descr + PLANT_STATE.descr)
