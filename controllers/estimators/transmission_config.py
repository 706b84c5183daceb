"""Parameters of the estimator of a cable-driven arm, as in a rig file, and what it tells."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hil.controllers import geometry
from hil.controllers.estimators.network import WaveletConfig
from hil.controllers.lawrence_config import PREMIUM
from hil.errors import ConfigError
from hil.estimate.elastic_ukf import UkfConfig

_EACH = (
    "stiffness", "hardening", "coulomb_motor", "viscous_motor", "coulomb_link", "viscous_link",
)  # fmt: skip
NAMES = (
    *(f"force_{axis}" for axis in "xyz"),
    *(f"{what}{j}" for what in ("torque", "position", "velocity", "cable", "friction", "innovation",
                                *_EACH) for j in (1, 2, 3)),
    "learning", "nodes",
)  # fmt: skip
UNITS = (
    *["N"] * 3, *["N m"] * 3, *["rad"] * 3, *["rad/s"] * 3, *["N m"] * 6, *["rad"] * 3,
    *["N m/rad"] * 3, *["N m/rad^3"] * 3, *["N m"] * 3, *["N m s/rad"] * 3, *["N m"] * 3,
    *["N m s/rad"] * 3, *["1"] * 2,
)  # fmt: skip
#: Reflected rotors of the Premium 1.5 [kg m^2], and a count of its encoders [rad].
ROTORS, COUNTS = (1.8e-4, 1.3e-4, 1.3e-4), (1.15e-4, 1.37e-4, 1.37e-4)


@dataclass(frozen=True)
class TransmissionConfig:
    """Parameters of the estimator.

    Parameters
    ----------
    model : tuple of 8 floats
        Rigid-body parameters pi of the arm with rotors and sensor.
    rotor : tuple of 3 floats
        Reflected inertia of the motors Jm [kg m^2].
    start : tuple of 6 or 18 floats
        First guess of k1 [N m/rad], k3 [N m/rad^3], Fcm [N m], Fvm [N m s/rad], Fcl, Fvl.
    resolution : tuple of 3 floats
        Encoder counts [rad].
    noise : tuple of 5 floats
        Variances a tick: q_m, q_m', q, q', log parameters.
    spread : float
        Variance of the log parameters at the start.
    soft : float
        Speed over which the sign of friction is resolved [rad/s].
    corner_hz : float
        Low-pass of the force.
    learn_until : float
        Time after which parameters and networks stay as they are [s].
    touch : float
        Measured force above which, and for half a second after, nothing is learnt [N].
    network : table
        See `WaveletConfig`; nodes = 0: the filters alone.
    lengths : tuple of 2 floats
        l1, l2 [m].
    """

    model: tuple[float, ...] = PREMIUM
    rotor: tuple[float, float, float] = ROTORS
    start: tuple[float, ...] = (150.0, 1e4, 0.008, 6e-4, 0.004, 6e-4)
    resolution: tuple[float, float, float] = COUNTS
    noise: tuple[float, ...] = (1e-12, 1e-4, 1e-12, 1e-4, 1e-10)
    spread: float = 0.1
    soft: float = 0.02
    corner_hz: float = 10.0
    learn_until: float = float("inf")
    touch: float = 0.3
    network: WaveletConfig = field(default_factory=lambda: WaveletConfig(nodes=0))
    lengths: tuple[float, float] = geometry.LENGTHS

    def __post_init__(self) -> None:
        if len(self.model) != 8 or len(self.start) not in (6, 18):
            raise ConfigError("elastic-ukf: model needs 8 numbers, start 6 or 18")
        if min(self.corner_hz, self.touch) <= 0.0:
            raise ConfigError("elastic-ukf: corner_hz and touch must be positive")
        self.joints()

    def joints(self) -> list[UkfConfig]:
        """One filter a joint."""
        rows = np.resize(self.start, 18).reshape(3, 6)
        return [
            UkfConfig(
                rotor, 1e-3, tuple(map(float, row)), grain, self.noise, self.spread, self.soft
            )
            for rotor, row, grain in zip(self.rotor, rows, self.resolution, strict=True)
        ]
