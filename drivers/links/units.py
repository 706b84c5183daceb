"""Counts of ATI's Net F/T box to newtons: what its configuration page says, given by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.errors import ConfigError, unknown
from hil.signals.device import FloatArray

FORCE = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "kgf": 9.80665}
TORQUE = {
    "N-m": 1.0,
    "N-mm": 1e-3,
    "kN-m": 1e3,
    "lbf-in": 0.1129848290276167,
    "lbf-ft": 1.3558179483314004,
}


@dataclass(frozen=True)
class CountScale:
    """Counts per unit and the units, as the box's configuration page shows them.

    Parameters
    ----------
    counts_per_force, counts_per_torque : int
        Usually a million each, but the page decides.
    force_unit, torque_unit : str
        Units of the calibration.
    """

    counts_per_force: int = 1_000_000
    counts_per_torque: int = 1_000_000
    force_unit: str = "N"
    torque_unit: str = "N-m"

    def __post_init__(self) -> None:
        if self.force_unit not in FORCE:
            raise ConfigError(unknown("force_unit", self.force_unit, FORCE))
        if self.torque_unit not in TORQUE:
            raise ConfigError(unknown("torque_unit", self.torque_unit, TORQUE))
        if self.counts_per_force < 1 or self.counts_per_torque < 1:
            raise ConfigError("counts_per_force and counts_per_torque must be positive.")

    def calibration(self, factors: tuple[float, ...] = (1.0,) * 6) -> FloatArray:
        """Matrix (6, 6): wrench per word [N, N m]; `factors` are counts per word of each axis."""
        force = FORCE[self.force_unit] / self.counts_per_force
        torque = TORQUE[self.torque_unit] / self.counts_per_torque
        return np.diag(np.array([force] * 3 + [torque] * 3) * np.array(factors))

    def record(self) -> dict[str, str]:
        """As text, for a session's metadata."""
        return {
            "counts_per_force": str(self.counts_per_force),
            "counts_per_torque": str(self.counts_per_torque),
            "units": f"{self.force_unit}, {self.torque_unit}",
        }
