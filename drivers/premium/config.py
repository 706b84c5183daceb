"""Constants of the PHANTOM Premium 1.5 drive train, each with its source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hil.errors import ConfigError


@dataclass(frozen=True)
class PremiumConfig:
    """How counts become angles and torques become codes.

    Parameters
    ----------
    gear : tuple of 3 tuples of 3 floats
        Motor angles = gear @ joint angles; joint 3 is measured from the base, hence diagonal
        (cable reductions 13.3, 11.2, 11.2: mahilab/Phantom, after Cavusoglu et al. 2002).
    counts_per_turn : int
        HEDM-5500 with 1024 lines, four edges each.
    torque_constant : float
        Maxon RE25 118743 [N m/A].
    amps_per_volt, dac_volts, dac_bits : float, float, int
        Amplifier [A/V] and its DAC.
    stall_torque : float
        Of the motor [N m].
    home : tuple of 3 floats
        Joint angles at which the arm rests when it is opened [rad]; encoders that count from
        where they were switched on are referred to it.
    velocity : str
        Velocity estimator, a name of the registry group ``hil.velocity``.
    velocity_options : mapping
        Its options, e.g. ``{ cutoff_hz = 30.0 }``.
    """

    gear: tuple[tuple[float, ...], ...] = ((13.3, 0.0, 0.0), (0.0, 11.2, 0.0), (0.0, 0.0, 11.2))
    counts_per_turn: int = 4096
    torque_constant: float = 0.0234
    amps_per_volt: float = 0.5513
    dac_volts: float = 10.0
    dac_bits: int = 16
    stall_torque: float = 0.129
    home: tuple[float, ...] = (0.0, 0.0, 0.0)
    velocity: str = "foaw-end-fit"
    velocity_options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.home) != 3:
            raise ConfigError("home: three joint angles [rad] are needed.")
