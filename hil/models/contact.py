"""What a tip or lever touches or holds, laws of the force; and the stops that a joint meets.

d = max(0, side (q - q0)) is the penetration; the force ON the robot pushes it back.  The
other laws refer to the surface (q0, side) that `contact-stiffness` found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numba
import numpy as np

from hil.models.effect import (
    BOUNDS,
    VALUE_DEVIATIONS,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Of,
    Over,
    Param,
    Relations,
    Scope,
    Shapes,
    Sight,
    Trait,
    log_grid,
)
from hil.models.motion import FloatArray, Motion


def penetration(motion: Motion, j: int) -> tuple[FloatArray, float]:
    """Penetration d (n,) and side of the known surface."""
    q0, side = motion.contact[j]
    return np.maximum(0.0, side * (motion.q[:, j] - q0)), float(side)


def _deepest(motion: Motion, j: int) -> float:
    """Deepest penetration of the known surface over all runs."""
    q0, side = motion.contact[j]
    low, high = motion.span[j]
    return max(float(side * ((high if side > 0 else low) - q0)), 1e-12)


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
        force: FloatArray = -side * (depth / _deepest(motion, j)) ** shape[0]
        return force[:, None]


@numba.njit(cache=True, nogil=True)
def _slip_state(x: FloatArray, width: float) -> FloatArray:
    """Elastoplastic element: z follows x but saturates, z <- clip(z + dx, -width, width)."""
    z = np.zeros(x.size)
    for k in range(1, x.size):
        z[k] = min(max(z[k - 1] + x[k] - x[k - 1], -width), width)
    return z


def _contact_hysteresis_grid(motion: Motion, j: int) -> Shapes:
    """1 to 45 % of the deepest penetration.

    An element that slips in one direction needs twice its play to slip in the other.  One that
    never does is a spring whose rest is where a run began, and foretells no other run.
    """
    deepest = _deepest(motion, j)
    return log_grid(0.01 * deepest, 0.45 * deepest, 10)


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
        return (-side * _slip_state(depth, float(shape[0])))[:, None]


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


#: Share of a stop's squared effort that may pull: noise, and the form of its law.
PULL = 0.05


def _end_stop_pushes(f: Fitted) -> bool:
    """A stop pushes back and takes energy: it neither pulls nor drives.

    Its effort acts towards the range at (nearly) all instants of contact, and what drives in
    its damping is noise or next to nothing: another effect that is still missing on the joint
    tilts it by so much.  Friction that depends on the position fails this: it changes its sign
    with the speed.
    """
    side = 1.0 if f.shape[1] > 0 else -1.0
    return _pushes(side * f.effect.columns(f.motion, f.j, f.shape), f.beta, f.slack[2])


def _pushes(columns: FloatArray, beta: Sequence[float], slack: float) -> bool:
    """Whether a stop's columns (n, 3), as if it were an upper one, push back and take energy."""
    parts = columns * np.array(beta)
    push = parts.sum(axis=1)
    power = PULL * float(np.sum(push**2))
    pull = float(np.sum(np.minimum(push, 0.0) ** 2))
    brakes = beta[2] >= -slack or float(np.sum(parts[:, 2] ** 2)) <= power
    return brakes and 0.0 < power and pull <= power


def _end_stop_grid(motion: Motion, j: int) -> Shapes:
    """2 to 55 % of the span from either end: a spring may engage within the range, too."""
    low, high = motion.span[j]
    fractions = (0.02, 0.05, 0.1, 0.15, 0.2, 0.27, 0.35, 0.45, 0.55)
    upper: Shapes
    upper = [(float(high - f * (high - low)), 1.0) for f in fractions]
    return upper + [(float(low + f * (high - low)), -1.0) for f in fractions]


#: Penetration; the side is 1 or -1.
_DEPTH = "side * max(0, side * (q - q0))"


class EndStop(Effect):
    """A stop that pushes back beyond a position."""

    name, family = "end-stop", "stiffness"
    doc = Doc(
        equation=(
            "tau = k d + h d |d| + c |d| v,  d = max(0, q - q0) (upper), min(0, q - q0) (lower)"
        ),
        signature="residual only on one side of a position, often near an end of the range",
        confused_with=("spring", "position-torque"),
        shown_by="strokes that reach the end of the range, slowly and fast",
        source="Hunt, Crossley, J. Applied Mechanics 42, 1975",
        shown=Sight.RANGE,
        over=Over.POSITION,
        formulas=(_DEPTH, f"{_DEPTH} * abs({_DEPTH})", f"abs({_DEPTH}) * v"),
    )
    params = (
        Param("k", "{F}/{x}", "stiffness at first touch", 0.0),
        Param("h", "{F}/{x}^2", "hardening"),
        Param("c", "{F} s/{x}^2", "damping per penetration"),
    )
    shape = (
        Param("q0", "{x}", "position of the stop"),
        Param(
            "side",
            "1",
            "+1 upper, -1 lower",
            -1.0,
            1.0,
            codes=((1.0, "upper stop"), (-1.0, "lower stop")),
            choice=True,
        ),
    )
    relations = Relations(causes=("stop",))
    search = Grid(_end_stop_grid)
    limits = (
        Limit(
            "pulls",
            _end_stop_pushes,
            says="a stop pushes back and takes energy, and this one does not",
        ),
    )
    traits = Trait.STOP

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[d, d |d|, |d| v]."""
        side = 1.0 if shape[1] > 0 else -1.0
        depth = side * np.maximum(0.0, side * (motion.q[:, j] - shape[0]))
        return np.stack([depth, depth * np.abs(depth), np.abs(depth) * motion.qd[:, j]]).T


#: Parts of the span that each of two stops takes, of the grid.
TWO_DEPTHS = (0.02, 0.05, 0.1, 0.16, 0.24, 0.35, 0.48)


def _two_stops_grid(motion: Motion, j: int) -> Shapes:
    """As far from either end."""
    low, high = motion.span[j]
    return [(float(high - f * (high - low)), float(low + f * (high - low))) for f in TWO_DEPTHS]


def _two_stops_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Other places of the lower one, below the upper one."""
    low, high = motion.span[j]
    places = [float(low + f * (high - low)) for f in np.linspace(0.01, 0.6, 25)]
    return [(shape[0], x) for x in places if x <= shape[0]]


def _two_stops_push(f: Fitted) -> bool:
    """Each pushes back, stiffens and takes energy, and the lower one is the lower one.

    Two that soften are a curve over the position.
    """
    upper, lower = f.shape
    columns = f.effect.columns(f.motion, f.j, f.shape)
    return lower <= upper and all(
        f.beta[k + 1] >= -f.slack[k + 1]
        and _pushes(side * columns[:, k : k + 3], f.beta[k : k + 3], f.slack[k + 2])
        for k, side in ((0, 1.0), (3, -1.0))
    )


class TwoStops(Effect):
    """A stop at either end: cushions, springs that centre a lever, the ligaments of a joint."""

    name, family = "two-stops", "stiffness"
    doc = Doc(
        equation=(
            "tau = k d + h d |d| + c |d| v, with values of its own for d = max(0, q - q0) (upper) "
            "and for d = min(0, q - q1) (lower)"
        ),
        signature="residual at both ends of the range, with opposite signs, and none between",
        confused_with=("end-stop", "position-torque", "spring"),
        shown_by="strokes that reach both ends of the range, slowly and fast",
        source="Hunt, Crossley, J. Applied Mechanics 42, 1975",
        shown=Sight.RANGE,
        over=Over.POSITION,
        formulas=tuple(
            text
            for d in ("max(0, q - q0)", "min(0, q - q1)")
            for text in (d, f"{d} * abs({d})", f"abs({d}) * v")
        ),
    )
    params = tuple(
        Param(f"{name}{end}", unit, f"{text}, {which} stop", lower)
        for end, which in (("", "upper"), ("1", "lower"))
        for name, unit, text, lower in (
            ("k", "{F}/{x}", "stiffness at first touch", 0.0),
            ("h", "{F}/{x}^2", "hardening", -np.inf),
            ("c", "{F} s/{x}^2", "damping per penetration", -np.inf),
        )
    )
    shape = (
        Param("q0", "{x}", "position of the upper stop"),
        Param("q1", "{x}", "position of the lower stop"),
    )
    relations = Relations(replaces=("end-stop",), causes=("stop",))
    search = Grid(_two_stops_grid, across=_two_stops_across, rounds=3)
    limits = (
        Limit(
            "pulls",
            _two_stops_push,
            says="a stop pushes back, stiffens and takes energy, and one of these does not",
        ),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """[d, d |d|, |d| v] of the upper and of the lower stop."""
        q, v = motion.q[:, j], motion.qd[:, j]
        each = (np.maximum(0.0, q - shape[0]), np.minimum(0.0, q - shape[1]))
        return np.stack([x for d in each for x in (d, d * np.abs(d), np.abs(d) * v)]).T


def _tip_impedance_lacks(motion: Motion, j: int) -> str:
    """Needs a tip, several joints, and a force that nobody measured."""
    if motion.robot.tip(motion.q[:1]) is None:
        return "the robot has no geometry, so no tip"
    if motion.d < 2:
        return "of one joint it is a spring and friction"
    return "the force at the tip is measured" if np.any(motion.tau_ext) else ""


def _tip_impedance_resists(f: Fitted) -> bool:
    """What holds the tip pulls it back or brakes it; a constant force alone does neither."""
    return any(b > e for b, e in zip(f.beta[:2], f.slack[:2], strict=True))


def _tip_impedance_remark(values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    """Where the spring rests, for people."""
    if not values["k"] > VALUE_DEVIATIONS * errors["k"]:
        return ""
    # k p + f = 0
    place = (-values[axis] / values["k"] for axis in ("fx", "fy", "fz"))
    return "at rest with the tip at ({}) m".format(", ".join(f"{x + 0.0:.3g}" for x in place))


class TipImpedance(Effect):
    """A hand, a tissue, a hose or a tool balancer that holds the tip throughout.

    Its mass is the last link's, with a force f that carries the weight.
    """

    name, family = "tip-impedance", "contact"
    doc = Doc(
        equation="tau = J' (k p + b p' + f),  p the place of the tip in base axes",
        signature="the joints feel one force that follows the tip's place and speed",
        confused_with=("base-tilt", "spring", "payload"),
        shown_by="the same motion with the tip free",
        source=(
            "Hogan, J. Dyn. Syst. Meas. Control 107, 1985 (impedance); Khalil, Dombre 2002, 9.4 "
            "(force at the tip)"
        ),
        remark=_tip_impedance_remark,
    )
    params = (
        Param("k", "N/m", "stiffness, the same in all directions", 0.0),
        Param("b", "N s/m", "damping, the same in all directions", 0.0),
        *(Param(f"f{axis}", "N", f"force along {axis} with the tip at the base") for axis in "xyz"),
    )
    scope = Scope(Of.ROBOT, lacks=_tip_impedance_lacks)
    limits = (
        Limit("resists", _tip_impedance_resists, says="it neither pulls back nor brakes"),
        BOUNDS,
    )
    traits = Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Efforts J' p, J' p', and J' of a unit force along each axis, shape (n, d, 5)."""
        place = motion.robot.tip(motion.q)
        if place is None:
            return np.zeros((motion.n, motion.d, len(self.params)))
        units = (np.tile(row, (motion.n, 1)) for row in np.eye(6)[:3])
        back = np.stack([motion.robot.external(motion.q, x) for x in units], axis=2)
        # p' = J qd
        speed = np.einsum("ndk,nd->nk", back, motion.qd)
        held = [np.einsum("ndk,nk->nd", back, x) for x in (place, speed)]
        return np.concatenate([np.stack(held, axis=2), back], axis=2)


EFFECTS: tuple[Effect, ...] = (
    EndStop(),
    TwoStops(),
    ContactStiffness(),
    ContactDamping(),
    ContactHardening(),
    ContactHysteresis(),
    ContactInclusion(),
    TipImpedance(),
)
