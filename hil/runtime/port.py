"""What the loop is given of one arm, whichever devices it is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hil.signals.device import FloatArray, IntArray, MeasuredCf, MeasuredJs, ServoJf


@dataclass(frozen=True)
class ArmPort:
    """Capabilities and words of one arm.

    Parameters
    ----------
    joints : MeasuredJs
        Joint state.
    efforts : ServoJf
        Takes joint efforts.
    force : MeasuredCf or None
        Force at the tip.
    counts, codes : ndarray (3,) of int
        Words of the last exchange.
    gauges : ndarray (6,) of int
        Words of the force sensor.
    torque_limit, speed_limit : ndarray (3,)
        [N m], [rad/s].
    limits : ndarray
        Of `hil.runtime.safety.limits`.
    tip : callable or None
        Writes the tip position [m] of a posture into an array (3,), where there is a `box`.
    box : ndarray (2, 3) or None
        Workspace of the tip [m].
    """

    joints: MeasuredJs
    efforts: ServoJf
    force: MeasuredCf | None
    counts: IntArray
    codes: IntArray
    gauges: IntArray
    torque_limit: FloatArray
    speed_limit: FloatArray
    limits: FloatArray
    tip: Callable[[FloatArray, FloatArray], None] | None = None
    box: FloatArray | None = None
