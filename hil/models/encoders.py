"""Errors of the measured positions: zeros, ratios, eccentric discs, lost counts.

An error e of joint j's measured position is an error of the model's effort on every joint i, to
first order  -(M_ij e'' + C_ij e' + S_ij e)  with the derivatives of the model's own effort by
acceleration, speed and position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hil.models.effect import (
    STRICT,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Of,
    Over,
    Param,
    Scope,
    Shapes,
    Trait,
    Variation,
    Waves,
    instants,
    turning_orders,
)
from hil.models.kernels import eccentric
from hil.models.motion import FloatArray, Motion
from hil.models.robots import IndependentAxes

_UNFITTED = "needs the fitted model's inertia; fit the model first"
#: Largest error of a zero that its derivative stands for [rad or m], and of a ratio.
_FAR, _FURTHEST = 0.35, 0.2


def _lacks(motion: Motion, j: int) -> str:
    """Needs joints that feel each other's positions, and a fitted model."""
    if isinstance(motion.robot, IndependentAxes):
        return "a wrong zero shows only in how joints act on each other; these axes do not"
    return _UNFITTED if motion.response is None else ""


def _zero_remark(values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    """What corrects it."""
    z = values["z"]
    return (
        f"{math.degrees(z):.2g} degrees if it turns; add {-z:.4g} to the position's shift in a map"
    )


class JointZero(Effect):
    """The joint is not at zero where the description says: a homing that missed, a part re-fitted.

    A masses' centre may turn along, so that the last joint shows none of it and others only what
    the joints behind them feel.
    """

    name, family = "joint-zero", "sensor"
    doc = Doc(
        equation="tau = -z dtau/dq  (z = measured position less that of the description)",
        signature="gravity and couplings fit as if the posture were another one",
        confused_with=("spring", "position-torque", "base-tilt"),
        shown_by="slow strokes of this joint and of those behind it over all of their range",
        source="Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991 (offsets)",
        remark=_zero_remark,
    )
    params = (Param("z", "{x}", "measured position less the true one", -_FAR, _FAR),)
    scope = Scope(Of.JOINTS, lacks=_lacks)
    limits = (STRICT,)
    traits = Trait.LOAD | Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """-S of joint j, shape (n, d, 1)."""
        if motion.response is None:
            return np.zeros((motion.n, motion.d, 1))
        return -motion.response.slope(j)[:, :, None]


def _ratio_remark(values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    """What corrects it."""
    return f"multiply the position's scale in a map by {1 - values['r']:.4g}"


class JointRatio(Effect):
    """The measured position is wrong by a ratio: another gear, pulley or capstan than stated."""

    name, family = "joint-ratio", "sensor"
    doc = Doc(
        equation="tau = -r (M q'' + C q' + S q)  (true position = (1 - r) times the measured one)",
        signature="gravity and couplings fit as if the joint moved less or more than it does",
        confused_with=("joint-zero", "spring", "position-torque"),
        shown_by="slow strokes of this joint and of those behind it over all of their range",
        source="Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991 (gains)",
        remark=_ratio_remark,
    )
    params = (Param("r", "1", "share of it that is too much", -_FURTHEST, _FURTHEST),)
    scope = Scope(Of.JOINTS, lacks=_lacks)
    limits = (STRICT,)
    traits = Trait.LOAD | Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """-(M q'' + C q' + S q) of joint j, shape (n, d, 1)."""
        out = np.zeros((motion.n, motion.d, 1))
        r = motion.response
        if r is None:
            return out
        q, qd, qdd = motion.q[:, j], motion.qd[:, j], motion.qdd[:, j]
        felt = r.inertia[:, :, j] * qdd[:, None] + r.coriolis(j) * qd[:, None]
        out[:, :, 0] = -(felt + r.slope(j) * q[:, None])
        out[:, j, 0] -= float(r.damping[j]) * qd
        return out


#: Orders of an eccentric disc beyond this many periods over the span are a motor's cogging.
DISC_ORDER = 40.0
#: Shape of jumps that are recorded, and the coefficient that says that they were lost counts.
_SEEN = (0.0,)
CONFIRMED = Param("a", "1", "share of the recorded jumps that the effort confirms as lost", 0.0)
#: Largest such share beside a model that was fitted with the jumps as motion.
DILUTED = 5.0
_SHIFT = Param("s", "{x}", "shift of the measured position")


def _encoder_eccentricity_powers(motion: Motion, j: int) -> NDArray[np.complex128] | None:
    """-(G, i (M q'' + D q'), -M q'^2) on the own joint: e, e' and e'' of exp(i k q)."""
    if motion.response is None:
        return None
    m, g = motion.response.inertia[:, j, j], motion.response.gradient[:, j, j]
    v, damping = motion.qd[:, j], motion.response.damping[j]
    parts = (g, 1j * (m * motion.qdd[:, j] + damping * v), -m * v**2)
    return -np.stack(parts, axis=1).astype(np.complex128)


def _encoder_eccentricity_grid(motion: Motion, j: int) -> Shapes:
    """Every half order over the span, and those of a joint's own disc."""
    return turning_orders(motion, j, DISC_ORDER, 1.0)


def _encoder_eccentricity_lacks(motion: Motion, j: int) -> str:
    """Needs a fitted model."""
    return _UNFITTED if motion.response is None else ""


class EncoderEccentricity(Effect):
    """The encoder's disc sits off centre: its error repeats once per turn.

    Cogging repeats over position, too, but has one size at all speeds; this grows with the
    square of the speed and with the acceleration, for it is inertia that it falsifies.  A tilted
    or oval disc errs twice a turn, too; and what is a sine over the true position is a bent one
    over the measured one, and a third harmonic counts nine times in the acceleration.
    """

    name, family = "encoder-eccentricity", "sensor"
    doc = Doc(
        equation=(
            "tau = -(M e'' + D e' + G e),  "
            "e = es sin kq + ec cos kq + es2 sin 2kq + .. + ec3 cos 3kq, k = 2 pi p"
        ),
        signature="a ripple over position that grows with the square of the speed",
        confused_with=("cogging", "position-friction"),
        shown_by="the same stroke at several speeds",
        source="Kavanagh, IEEE Trans. Instrumentation and Measurement 50(6), 2001 (encoder errors)",
    )
    params = (
        Param("es", "{x}", "error that goes with the sine"),
        Param("ec", "{x}", "error that goes with the cosine"),
        Param("es2", "{x}", "twice a turn, with the sine: a tilted or oval disc"),
        Param("ec2", "{x}", "twice a turn, with the cosine"),
        Param("es3", "{x}", "three times a turn, with the sine"),
        Param("ec3", "{x}", "three times a turn, with the cosine"),
    )
    shape = (Param("p", "1/{x}", "turns of the disc per unit of position", 0.0, size=True),)
    scope = Scope(Of.JOINTS, lacks=_encoder_eccentricity_lacks)
    search = Waves(_encoder_eccentricity_grid, powers=_encoder_eccentricity_powers)
    traits = Trait.LOAD | Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """-(M e'' + D e' + G e) for e = sin and cos of kq, 2kq and 3kq, shape (n, d, 6)."""
        if motion.response is None:
            return np.zeros((motion.n, motion.d, 6))
        r, k, q = motion.response, 2 * np.pi * float(shape[0]), motion.q[:, j]
        out = np.empty((motion.n, motion.d, 6))
        for h in (1, 2, 3):
            angle = (h * k) * q
            eccentric(
                np.sin(angle),
                np.cos(angle),
                h * k,
                motion.qd[:, j],
                motion.qdd[:, j],
                r.inertia[:, :, j],
                r.gradient[:, :, j],
                float(r.damping[j]),
                j,
                out[:, :, 2 * h - 2 : 2 * h],
            )
        return out


def _missed_counts_grid(motion: Motion, j: int) -> Shapes:
    """The recorded jumps if there are any, else fifteen instants from 5 to 95 % of the run."""
    if motion.jumps(j):
        return [_SEEN]
    return [(t,) for t in instants(motion.since[-1])]


def _missed_counts_terms(motion: Motion, j: int) -> tuple[Param, ...]:
    """Share of the recorded jumps, or the shift."""
    return (CONFIRMED,) if motion.jumps(j) else (_SHIFT,)


def _missed_counts_small(f: Fitted) -> bool:
    """No shift beyond half a radian; recorded jumps are nearer to lost counts than to motion.

    Beside jumps a model finds too small an inertia, so that the first share may exceed 1.
    A run without jumps has none (0).
    """
    if not _missed_counts_dated(f.shape):
        return max(map(abs, f.beta)) < 0.5
    return all(0.5 < b < DILUTED for b in f.beta if b)


def _missed_counts_dated(shape: Sequence[float]) -> bool:
    """Recorded jumps are."""
    return tuple(shape) == _SEEN


def _missed_counts_own(shape: Sequence[float]) -> bool:
    """A shift does, to the run in which it happened."""
    return not _missed_counts_dated(shape)


def _missed_counts_lacks(motion: Motion, j: int) -> str:
    """Needs gravity or a spring, unless the jumps are recorded."""
    if motion.response is None:
        return _UNFITTED
    if motion.jumps(j) or np.any(motion.response.gradient[:, :, j]):
        return ""
    return "no gravity or spring of the model depends on the position, so a shift has no effect"


class MissedCounts(Effect):
    """The encoder lost counts: all positions after that are shifted.

    Lost within a sample, they are seen as jumps of the recorded position; then instants and
    sizes are known, and what is fitted is whether the effort confirms that the joint did not
    jump: a share of 1.  Lost little by little they are one shift at an instant that is searched;
    only gravity and springs feel it, and without them it cannot be seen in the effort.
    """

    name, family = "missed-counts", "sensor"
    doc = Doc(
        equation=(
            "tau = f(q - a e) - f(q), e = jumps of the recorded position, each staying; "
            "without any tau = -G s for t > t0 (s = shift of the measured position)"
        ),
        signature=(
            "the position jumps and the effort does not; or gravity fits before an instant only"
        ),
        confused_with=("force-drift", "torque-offset", "vibration-mode"),
        shown_by="a return to a mechanical reference at the end of the run",
        source=(
            "Naerum thesis, appendix A (counts lost above the decoder's rate are a lasting offset)"
        ),
        over=Over.TIME,
    )
    params = (_SHIFT,)
    shape = (
        Param(
            "t0",
            "s",
            "instant, from the start; 0: the jumps that are recorded",
            0.0,
            codes=((_SEEN[0], "at the jumps that are recorded"),),
        ),
    )
    scope = Scope(Of.JOINTS, lacks=_missed_counts_lacks, terms=_missed_counts_terms)
    variation = Variation(per_run=True, dated=_missed_counts_dated, own=_missed_counts_own)
    search = Grid(_missed_counts_grid)
    limits = (Limit("size", _missed_counts_small, says="the shift is too large for lost counts"),)
    traits = Trait.LOAD | Trait.REPLAYED | Trait.JUMPS

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """f(q - e) - f(q), or -G after t0, shape (n, d, 1)."""
        if motion.response is None:
            return np.zeros((motion.n, motion.d, 1))
        if _missed_counts_dated(shape):
            return motion.response.unslipped(j)[:, :, None]
        after = motion.after(float(shape[0]))
        out: FloatArray = -(motion.response.gradient[:, :, j] * after[:, None])[:, :, None]
        return out


EFFECTS = (EncoderEccentricity(), MissedCounts(), JointZero(), JointRatio())
