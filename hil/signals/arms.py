"""What a law of any number of joints, or a simulator, is told of an arm."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ArmDescription:
    """An arm of d joints.

    Parameters
    ----------
    joints : tuple of str
        Names, in kinematic order, length d.
    urdf : str
        URDF text; empty for a preset.
    low, high, center : tuple of float
        Range of every joint and the posture in its middle [rad or m], length d.
    torque_limit : tuple of float
        [N m or N], length d.
    """

    joints: tuple[str, ...]
    urdf: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    center: tuple[float, ...]
    torque_limit: tuple[float, ...]

    @property
    def d(self) -> int:
        """Number of joints."""
        return len(self.joints)
