"""What is worth knowing of a design before it runs: figures of merit of one axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.teleop import fsf, hybrid, passivity, transparency
from hil.teleop.axis import Loop
from hil.teleop.hybrid import FREE, GRID, FloatArray, Impedance
from hil.teleop.refuse import Margins, margins

#: Band over which the sensitivity is averaged, and up to which tracking counts [Hz].
BAND, TRACKING = (0.2, 5.0), 1.0
#: Largest environment of the bounded test: stiffness [N/m], damping [N s/m].
LARGEST = Impedance(0.0, 6.0, 1500.0)


@dataclass(frozen=True)
class Summary:
    """Figures of merit of one axis, with filters and delays.

    Parameters
    ----------
    axis, name : str
        Axis and design.
    missed : tuple of str
        Conditions of transparency that fail, with what they should be.
    sensitivity, sensitivity_dc : float
        Weighted rms of abs(dz_t/dz_e) over 0.2 to 5 Hz about the environment, and its value at
        rest; transparent = 1.
    tracking_free, tracking_contact : float
        Largest abs(1 - v_s / (kp v_m)) to 1 Hz in free space and against the environment.
    width : float
        Smallest width of transmitted impedance over 0.2 to 5 Hz [N s/m].
    llewellyn, passive : float
        Smallest margin of absolute stability, smallest eigenvalue of passivity, over 0.016 to 320 Hz.
    bounded : float
        Smallest Re z_t over passive environments up to 1500 N/m and 6 N s/m [N s/m].
    D, kappa : float
        Distance to the force estimation singularity: 0, infinite at it.
    fsf_smallest, fsf_bound : float
        Loop gain of the force-sensor-free form, and what sampling demands of it.
    margins : Margins
        Stability with the declared operators and environments.
    """  # noqa: E501

    axis: str
    name: str
    missed: tuple[str, ...]
    sensitivity: float
    sensitivity_dc: float
    tracking_free: float
    tracking_contact: float
    width: float
    llewellyn: float
    passive: float
    bounded: float
    D: float
    kappa: float
    fsf_smallest: float
    fsf_bound: float
    margins: Margins


def weighted(values: Any, w: FloatArray) -> float:
    """Root of the mean square of `values` (n,) over w [rad/s], trapezoidal."""
    square = np.abs(np.asarray(values)) ** 2
    return float(np.sqrt(np.trapezoid(square, w) / (w[-1] - w[0])))


def band() -> FloatArray:
    """Frequencies of the sensitivity [rad/s]."""
    return 2 * np.pi * np.geomspace(*BAND, 60)


def tracking(h: Any, ze: Any, scale: float) -> FloatArray:
    """|1 - v_s / (kp v_m)| with v_s/v_m = -h21 / (1 + h22 z_e), (n,)."""
    ratio = -h[..., 1, 0] / (1 + h[..., 1, 1] * ze)
    out: FloatArray = np.abs(1 - ratio / scale)
    return out


def summarise(loop: Loop, period: float) -> Summary:
    """Figures of merit of one axis.

    Parameters
    ----------
    loop : Loop
        The axis.
    period : float
        Of the loop [s].
    """
    d, ze = loop.design, next((z for z in loop.environments if z != FREE), hybrid.GEL)
    w, slow = band(), 2 * np.pi * np.geomspace(0.02, TRACKING, 40)
    wide, near, far = (hybrid.hybrid(d, hybrid.jw(x), loop.real) for x in (GRID, w, slow))
    sampled = fsf.sampled_condition(d, loop.real.acceleration_hz, period)
    still = hybrid.hybrid(d, np.array([1e-4j]), loop.real)
    gap = tracking(far, ze(hybrid.jw(slow)), d.motion_scale)
    return Summary(
        loop.axis, d.name,
        tuple(c.text for c in transparency.check(d) if not c.holds),
        weighted(hybrid.sensitivity(near, ze(hybrid.jw(w))), w),
        float(abs(hybrid.sensitivity(still, ze(np.array([1e-4j])))[0])),
        float(tracking(far, 0.0, d.motion_scale).max()), float(gap.max()),
        float(hybrid.width(near, w, LARGEST).min()),
        float(passivity.llewellyn(wide).min()), float(passivity.passive(wide).min()),
        float(passivity.half_disc(wide, np.abs(LARGEST(hybrid.jw(GRID)))).min()),
        d.D, fsf.conditioning(d), sampled.smallest, sampled.bound, margins(loop, period),
    )  # fmt: skip
