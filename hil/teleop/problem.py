"""What a sensitivity-optimised design must do, and within which bounds."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hil.errors import ConfigError
from hil.teleop.design import IDEAL, Realisation, Robot
from hil.teleop.hybrid import GEL, HAND, FloatArray, Impedance

#: theta in this order; c4 enters with a minus.
ORDER = ("c1", "c2", "c3", "c4", "c5", "c6", "c7", "c8")
FORCES = np.array([False, True, True, False, True, True, False, False])


@dataclass(frozen=True)
class Problem:
    """What a design must do.

    Parameters
    ----------
    master, slave : Robot
        Controlled robots.
    environment, operator : Impedance
        Where the sensitivity is taken; for the pole check.
    largest : Impedance
        Edge of the bounded set of environments: every passive z_e with abs(z_e) below its size.
    stiffness, force : float
        Largest k of a motion term [N/m], largest force gain (all at least 0).
    corner : float
        k / b of the motion terms [rad/s].
    free, contact : float
        Largest tracking error to 1 Hz in free space and against the environment.
    kappa : float
        Largest condition number of Q; infinite = no force-sensor-free form is asked for.
    real : Realisation
        Filters and delays.
    """

    master: Robot = field(default_factory=lambda: Robot(0.3))
    slave: Robot = field(default_factory=lambda: Robot(0.3))
    environment: Impedance = GEL
    operator: Impedance = HAND
    largest: Impedance = Impedance(0.0, 6.0, 1500.0)  # noqa: RUF009
    stiffness: float = 300.0
    force: float = 1.0
    corner: float = 15.0
    free: float = 0.2
    contact: float = 0.6
    kappa: float = 1.5
    real: Realisation = IDEAL

    def __post_init__(self) -> None:
        if min(self.stiffness, self.force, self.corner, self.free, self.contact) <= 0.0:
            raise ConfigError("optimised design: bounds and tolerances must be positive")
        if self.kappa <= 1.0:
            raise ConfigError(f"optimised design: kappa = {self.kappa:.3g} must exceed 1")

    def bounds(self) -> FloatArray:
        """Upper bounds of theta, (8,): [N s/m] or 1."""
        return np.where(FORCES, self.force, self.stiffness / self.corner)
