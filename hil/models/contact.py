"""The environment that a tip or lever touches: laws of the force it returns.

d = max(0, side (q - q0)) is the penetration; the force ON the robot pushes it back.  The
other laws refer to the surface (q0, side) that `contact-stiffness` found.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from hil.models.effect import (
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Over,
    Param,
    Scope,
    Shapes,
    Trait,
    log_grid,
)
from hil.models.motion import FloatArray, Motion


def penetration(motion: Motion, j: int) -> tuple[FloatArray, float]:
    """Penetration d (n,) and side of the known surface."""
    q0, side = motion.contact[j]
    return np.maximum(0.0, side * (motion.q[:, j] - q0)), float(side)


def _contact_law_lacks(motion: Motion, j: int) -> str:
    """Needs a surface."""
    known = np.isfinite(motion.contact[j]).all()
    return "" if known else "needs 'contact-stiffness' in the model: it finds the surface"


class _ContactLaw(Effect):
    """A law that needs the surface found first."""

    family = "contact"
    scope = Scope(explains=("external",), lacks=_contact_law_lacks)


def _contact_stiffness_grid(motion: Motion, j: int) -> Shapes:
    """Surfaces over the range, either side; far beyond it, a spring that always touches."""
    low, high = motion.span[j]
    fractions = (-2.0, *np.arange(-0.1, 1.0, 0.1))
    places = [float(low + f * (high - low)) for f in fractions]
    mirrored = [float(high - f * (high - low)) for f in fractions]
    return [*((x, 1.0) for x in places), *((x, -1.0) for x in mirrored)]


class ContactStiffness(Effect):
    """A linear spring behind a surface."""

    name, family = "contact-stiffness", "contact"
    doc = Doc(
        equation="f = -side k d,  d = max(0, side (q - q0))",
        signature="force proportional to penetration",
        confused_with=("spring", "contact-hardening"),
        shown_by="slow press and release",
        source="Naerum thesis 3.3.3 (gel palpation)",
        over=Over.POSITION,
    )
    params = (Param("k", "{F}/{x}", "stiffness", 0.0),)
    shape = (
        Param("q0", "{x}", "surface position"),
        Param(
            "side",
            "1",
            "+1: contact above q0, -1: below",
            -1.0,
            1.0,
            codes=((1.0, "contact above q0"), (-1.0, "contact below q0")),
            choice=True,
        ),
    )
    scope = Scope(explains=("external",))
    search = Grid(_contact_stiffness_grid)
    traits = Trait.SURFACE

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """-side d."""
        side = 1.0 if shape[1] > 0 else -1.0
        return -side * np.maximum(0.0, side * (motion.q[:, j] - shape[0]))[:, None]


def _contact_damping_brakes(f: Fitted) -> bool:
    """A damper takes energy."""
    return f.beta[0] >= -f.slack[0]


class ContactDamping(_ContactLaw):
    """A damper in parallel to the spring."""

    name = "contact-damping"
    doc = Doc(
        equation="f = -c v  while d > 0",
        signature="loop over penetration that opens with speed",
        confused_with=("contact-hysteresis",),
        shown_by="the same press at several speeds",
        source="Kelvin-Voigt; Hunt, Crossley, J. Applied Mechanics 42, 1975",
        over=Over.DEPTH,
    )
    params = (Param("c", "{F} s/{x}", "damping"),)
    limits = (Limit("drives", _contact_damping_brakes, says="it would drive the joint"),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """-v while touching."""
        depth, _ = penetration(motion, j)
        return -(np.where(depth > 0, motion.qd[:, j], 0.0))[:, None]


def _contact_hardening_hardens(f: Fitted) -> bool:
    """What grows softer with depth does not harden."""
    return f.beta[0] >= -f.slack[0]


def _contact_hardening_grid(motion: Motion, j: int) -> Shapes:
    """Exponents 1.5 to 6."""
    return [(n,) for n in (1.5, 2.0, 3.0, 4.0, 6.0)]


class ContactHardening(_ContactLaw):
    """Stiffness that grows with penetration."""

    name = "contact-hardening"
    doc = Doc(
        equation="f = -side h (d / d_max)^n",
        signature="force curves upwards over penetration",
        confused_with=("contact-stiffness", "contact-hysteresis"),
        shown_by="slow presses to several depths",
        source="Hertz 1882; Hunt, Crossley, J. Applied Mechanics 42, 1975",
        over=Over.DEPTH,
    )
    params = (Param("h", "{F}", "additional force at the deepest penetration"),)
    shape = (Param("n", "1", "exponent", 1.0, 8.0),)
    search = Grid(_contact_hardening_grid)
    limits = (Limit("softens", _contact_hardening_hardens, says="it would soften with depth"),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """-side (d / d_max)^n."""
        depth, side = penetration(motion, j)
        low, high = motion.span[j]
        deepest = max(side * ((high if side > 0 else low) - motion.contact[j, 0]), 1e-12)
        force: FloatArray = -side * (depth / deepest) ** shape[0]
        return force[:, None]


@numba.njit(cache=True, nogil=True)
def slip_state(x: FloatArray, width: float) -> FloatArray:
    """Elastoplastic element: z follows x but saturates, z <- clip(z + dx, -width, width)."""
    z = np.zeros(x.size)
    for k in range(1, x.size):
        z[k] = min(max(z[k - 1] + x[k] - x[k - 1], -width), width)
    return z


def _contact_hysteresis_grid(motion: Motion, j: int) -> Shapes:
    """1 to 60 % of the span."""
    span = float(np.ptp(motion.span[j])) or 1.0
    return log_grid(0.01 * span, 0.6 * span, 10)


class ContactHysteresis(_ContactLaw):
    """A loop over penetration that does not depend on speed."""

    name = "contact-hysteresis"
    doc = Doc(
        equation="f = -side h z,  z <- clip(z + dd, -r, r)",
        signature="loop over penetration of the same width at all speeds",
        confused_with=("contact-damping", "contact-hardening"),
        shown_by="the same press at several speeds and depths",
        source="Iwan 1966; Lampaert, Swevers, Al-Bender 2002 (Maxwell-slip element)",
        over=Over.DEPTH,
    )
    params = (Param("h", "{F}/{x}", "stiffness of the slipping element", 0.0),)
    shape = (Param("r", "{x}", "play: penetration at which it slips", 0.0),)
    search = Grid(_contact_hysteresis_grid)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """-side z(d; r)."""
        depth, side = penetration(motion, j)
        return (-side * slip_state(depth, float(shape[0])))[:, None]


def _contact_inclusion_grid(motion: Motion, j: int) -> Shapes:
    """5 to 75 % of the span."""
    span = float(np.ptp(motion.span[j])) or 1.0
    return [(float(f * span),) for f in np.arange(0.05, 0.8, 0.07)]


class ContactInclusion(_ContactLaw):
    """A stiffer layer below the surface: a stone, a bone, the table under the foam."""

    name = "contact-inclusion"
    doc = Doc(
        equation="f = -side h max(0, d - d1)",
        signature="force over penetration has a kink: it is steeper beyond one depth",
        confused_with=("contact-hardening", "contact-stiffness"),
        shown_by="slow presses well beyond the layer's depth",
        source="Naerum thesis 3.3.3 (bolt under gel); Yamamoto et al., IEEE Trans. Haptics 5, 2012",
        over=Over.DEPTH,
    )
    params = (Param("h", "{F}/{x}", "stiffness that the layer adds", 0.0),)
    shape = (Param("d1", "{x}", "depth of the layer below the surface", 0.0),)
    search = Grid(_contact_inclusion_grid)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """-side max(0, d - d1)."""
        depth, side = penetration(motion, j)
        return (-side * np.maximum(0.0, depth - shape[0]))[:, None]


EFFECTS: tuple[Effect, ...] = (
    ContactStiffness(),
    ContactDamping(),
    ContactHardening(),
    ContactHysteresis(),
    ContactInclusion(),
)
