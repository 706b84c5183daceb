"""The far end of a device under test: what `check_driver` moves, loads, breaks and reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.signals.device import FloatArray


@dataclass(frozen=True)
class Tolerance:
    """How near a driver must come to the truth of the far end.

    Parameters
    ----------
    position, velocity, force, torque, effort : float
        [rad], [rad/s], [N], [N m], [N m].
    """

    position: float = 2e-3
    velocity: float = 0.05
    force: float = 0.05
    torque: float = 0.01
    effort: float = 2e-3


class FarEnd:
    """Truth behind a wire.  Derive from it and write the methods that your simulation can do.

    What a class does not write is not checked, and `check_driver` says so.

    Attributes
    ----------
    joints : int
        Joints of the arm.
    pose : ndarray (joints,)
        Where the joints stand at the start, and while a force is measured [rad].
    axes : int
        Components of the wrench that `press` can apply: 3 without torques, or 6.
    """

    joints: int = 3
    axes: int = 6

    @property
    def now_ns(self) -> int:
        """Time [ns] from which the check goes on after the device was opened."""
        return 0

    def __init__(self) -> None:
        self.pose: FloatArray = np.zeros(self.joints)

    def advance(self, t_ns: int) -> None:
        """Let the far end run to `t_ns`; not needed where the device's wire does so itself."""

    def place(self, position: FloatArray) -> None:
        """The joints stand at `position` (joints,) [rad] from the next `advance` on."""
        raise NotImplementedError

    def press(self, wrench: FloatArray) -> None:
        """Force [N] and torque [N m] (6,) ON the robot, base frame, from now on."""
        raise NotImplementedError

    def effort(self) -> FloatArray:
        """Efforts (joints,) [N m] that the motors now get."""
        raise NotImplementedError

    def unplug(self) -> None:
        """Pull the device off its bus, or cut its supply."""
        raise NotImplementedError

    def replug(self) -> None:
        """Attach it again, as after a power-up."""
        raise NotImplementedError

    def mute(self, on: bool) -> None:
        """While on, the device takes requests and answers none."""
        raise NotImplementedError

    def garble(self) -> None:
        """Spoil the next answer: wrong length, wrong code, wrong order, flipped bits."""
        raise NotImplementedError

    @classmethod
    def can(cls, method: str) -> bool:
        """Whether a class has written `method`."""
        return getattr(cls, method) is not getattr(FarEnd, method)
