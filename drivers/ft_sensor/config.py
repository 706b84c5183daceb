"""Calibration of the force/torque sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown

#: model -> sensitivity of force [words/N] and torque [words/(N m)], range [N], [N m].
#: Ranges: ATI Nano17 SI-12-0.12 and Nano25 SI-125-3; sensitivities are of this rig's
#: converters.
MODELS: dict[str, tuple[float, float, float, float]] = {
    "nano17": (1280.0, 160000.0, 12.0, 0.12),
    "nano25": (192.0, 8000.0, 125.0, 3.0),
}


@dataclass(frozen=True)
class FtSensorConfig:
    """Which sensor.

    Parameters
    ----------
    model : str
        ``"nano17"`` or ``"nano25"``.
    tare_samples : int
        Readings that are averaged for the bias before the arm is enabled.
    """

    model: str = "nano17"
    tare_samples: int = 200

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ConfigError(unknown("force sensor model", self.model, MODELS))
        if self.tare_samples < 1:
            raise ConfigError("tare_samples must be at least 1.")

    def calibration(self) -> NDArray[np.float64]:
        """Matrix (6, 6): wrench in the sensor frame per word [N, N m].

        The three beams stand at 0, 120 and 240 degrees; each has an axial gauge
        fz + tx sin a - ty cos a and a tangential one fy cos a - fx sin a + tz.  Summing over
        the beams inverts this: fz = sum/3, tx = 2/3 sum(axial sin a), and so on.
        """
        force, torque, *_ = MODELS[self.model]
        c = np.zeros((6, 6))
        for beam in range(3):
            a = 2 * np.pi * beam / 3
            axial, tangential = 2 * beam, 2 * beam + 1
            c[2, axial], c[5, tangential] = 1 / 3, 1 / 3
            c[3, axial], c[4, axial] = 2 / 3 * np.sin(a), -2 / 3 * np.cos(a)
            c[0, tangential], c[1, tangential] = -2 / 3 * np.sin(a), 2 / 3 * np.cos(a)
        return np.asarray(c / np.array([force] * 3 + [torque] * 3)[:, None])
