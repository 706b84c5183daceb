"""What lies between the commanded and the real motor effort, and between motor and link.

What the motors' amplifiers do to their commands: run into a limit, lose the small ones, leak into
each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.models.effect import (
    PER_RUN,
    RIPPLES,
    STRICT,
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
    brakes,
    even_ratio,
    log_grid,
    one_joint,
    other_ratios,
)
from hil.models.friction import AMPLITUDES, HARMONICS, harmonics
from hil.models.motion import FloatArray, Motion
from hil.models.parts import JOINT


class TorqueOffset(Effect):
    """A constant between commanded and real effort."""

    name, family = "torque-offset", "actuator"
    doc = Doc(
        equation="tau = t0  (one value a run)",
        signature="the residual's mean, moving or at rest",
        confused_with=("asymmetric-coulomb", "rigid-body"),
        shown_by="rests in several postures",
        source="Janot, Gautier, Brunot, 2019 (offset of the EMPS)",
        formulas=("1",),
    )
    params = (Param("t0", "{F}", "offset"),)
    scope = Scope(explains=("motor", "external"))
    variation = PER_RUN
    relations = Relations(causes=("constant",))
    traits = Trait.MOTION

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """1."""
        return np.ones((motion.n, 1))


def _torque_gain_forwards(f: Fitted) -> bool:
    """A command that acts backwards is a wrong sign, not a gain."""
    return f.beta[0] > -0.9


def _torque_gain_lacks(motion: Motion, j: int) -> str:
    """Structural: without an external force the gain scales every parameter alike."""
    if np.any(motion.tau_ext[:, j]) or motion.d > 1:
        return ""
    return "without a measured external force the gain only scales all other parameters"


class TorqueGain(Effect):
    """The motor constant is not what the command assumes."""

    name, family = "torque-gain", "actuator"
    doc = Doc(
        equation="tau = (1 + g) load  (g = 1/kappa - 1, load = rigid body less external effort)",
        signature="residual proportional to everything the motor carries, external force included",
        confused_with=("rigid-body", "payload", "load-friction", "gain-drift"),
        shown_by="hand force and motor effort together, or a known payload",
        source="Naerum thesis 3.1.3 (motor constants by manual excitation)",
        shown=Sight.FORCE,
        over=Over.LOAD,
    )
    params = (Param("g", "1", "relative error of the command"),)
    scope = Scope(lacks=_torque_gain_lacks)
    limits = (Limit("backwards", _torque_gain_forwards, says="a gain below zero is a wrong sign"),)
    traits = Trait.LOAD | Trait.GAIN

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Transmitted load."""
        return motion.load[:, j : j + 1]


#: Periods over the range of motion below which a wave over the position is no ripple: a little more
#: than the fewest that are sought, which stand for any slower change.  Half: any smooth change over
#: the range is one; double: a motor of few poles goes unnamed on a short stroke.
REPEATED = 1.6


def _cogging_repeats(f: Fitted) -> bool:
    """What does not come back within the range is a change over the position."""
    low, high = f.motion.span[f.j]
    return bool(f.shape[0] * (high - low) >= REPEATED)


class Cogging(Effect):
    """Effort over motor position that does not depend on the command."""

    name, family = "cogging", "actuator"
    doc = Doc(
        equation="tau = a1 sin kq + b1 cos kq + a2 sin 2kq + b2 cos 2kq,  k = 2 pi p",
        signature="lines of the residual over position at fixed orders, whatever the speed",
        confused_with=("position-friction", "spring", "encoder-eccentricity"),
        shown_by="several constant speeds over two periods or more",
        source="Holtz, Springob, IEEE Trans. Industrial Electronics 43(6), 1996",
        shown=Sight.RANGE,
        over=Over.POSITION,
        formulas=HARMONICS,
    )
    params = AMPLITUDES
    shape = (Param("p", "1/{x}", "periods per unit of position", 0.0, size=True),)
    search = RIPPLES
    limits = (
        Limit("single", _cogging_repeats, says="its period hardly comes back within the range"),
    )

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Two harmonics over position."""
        return harmonics(motion.q[:, j], shape[0])


class SecondCogging(Cogging):
    """A second ripple over the position: a gear's or a screw's beside the motor's."""

    name = "second-cogging"
    doc = replace(
        Cogging.doc,
        signature="lines of the residual over position at orders that are none of the first ones'",
        confused_with=("encoder-eccentricity", "position-friction", "spring"),
    )
    relations = Relations(extends=("cogging",))


def _coupled_transmission_brakes(f: Fitted) -> bool:
    """Friction brakes the relative motion; the inertia is shared with the arm's own."""
    w = f.motion.qd[:, f.j] + f.shape[1] * f.motion.qd[:, int(f.shape[0]) - 1]
    return brakes(w, f.beta[1:], f.slack[1:])


def _coupled_transmission_grid(motion: Motion, j: int) -> Shapes:
    """Every later joint (the pair is unordered), equal or opposite."""
    later = range(j + 1, motion.d)
    return [(float(k + 1), s * even_ratio(motion, j, k)) for k in later for s in (1.0, -1.0)]


def _coupled_transmission_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Other ratios: motors behind unlike gears, or a metre a radian; equal or opposite first."""
    k, r = shape
    return [(k, x) for x in (r, *other_ratios(r, even_ratio(motion, j, int(k) - 1)))]


def _coupled_transmission_lacks(motion: Motion, j: int) -> str:
    """Needs a later joint."""
    return "" if j + 1 < motion.d else "no later joint to couple with"


class CoupledTransmission(Effect):
    """The motor of one joint also turns with another (a wrist's differential)."""

    name, family = "coupled-transmission", "transmission"
    doc = Doc(
        equation="tau_j = I w' + fc tanh(w / v0) + fv w,  tau_k = r tau_j,  w = v_j + r v_k",
        signature="residuals of two joints that follow the sum or difference of their motions",
        confused_with=("coupled-friction", "rigid-body"),
        shown_by="the two joints together with equal and with opposite signs",
        source="Khalil, Dombre 2002, 9.2 (kinematic coupling of wrists)",
        over=Over.OTHER_SPEED,
    )
    params = (
        Param("i", "{F} s^2/{x}", "inertia on the relative motion"),
        Param("fc", "{F}", "Coulomb friction of the relative motion"),
        Param("fv", "{F} s/{x}", "viscous friction of the relative motion"),
    )
    shape = (
        Param(JOINT, "1", "number of the other joint", 1.0, choice=True),
        Param("r", "1", "ratio of the other joint's motion"),
    )
    scope = Scope(Of.JOINTS, lacks=_coupled_transmission_lacks)
    search = Grid(
        _coupled_transmission_grid, across=_coupled_transmission_across, refine=False, rounds=4
    )
    limits = (Limit("drives", _coupled_transmission_brakes, says="it would drive the joint"),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Columns (n, d, 3), on joint j and, times r, on the other joint."""
        return _turned_by_both(motion, j, int(shape[0]) - 1, float(shape[1]))


def _turned_by_both(motion: Motion, j: int, k: int, r: float) -> FloatArray:
    """Inertia and friction of a motor that turns with q_j + r q_k: (n, d, 3)."""
    w = motion.qd[:, j] + r * motion.qd[:, k]
    slope = motion.qdd[:, j] + r * motion.qdd[:, k]
    v0 = float(max(motion.v0[j], abs(r) * motion.v0[k]))
    parts = np.stack([slope, motion.sign_of(w, slope, v0), w], axis=1)
    out = np.zeros((motion.n, motion.d, 3))
    out[:, j], out[:, k] = parts, r * parts
    return out


def _differential_brakes(f: Fitted) -> bool:
    """Friction brakes both motors; the inertia is shared with the arm's own.

    So is the viscous part: it may come out below zero alone, by any amount where the joints' own
    viscous friction leaves it undetermined.
    """
    k, r = int(f.shape[0]) - 1, f.shape[1]
    each = ((f.motion.qd[:, f.j] + s * r * f.motion.qd[:, k], at) for s, at in ((1, 1), (-1, 4)))
    beta = [b if sure else max(b, 0.0) for b, sure in zip(f.beta, f.determined, strict=True)]
    return all(brakes(w, beta[at : at + 2], f.slack[at : at + 2]) for w, at in each)


def _differential_grid(motion: Motion, j: int) -> Shapes:
    """Every later joint."""
    return [(float(k + 1), even_ratio(motion, j, k)) for k in range(j + 1, motion.d)]


def _differential_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Other ratios of the two gears; equal first."""
    k, r = shape
    return [(k, x) for x in (r, *other_ratios(r, even_ratio(motion, j, int(k) - 1))) if x > 0.0]


class Differential(Effect):
    """Two motors drive two joints together: one turns with their sum, one with their difference."""

    name, family = "differential", "transmission"
    doc = Doc(
        equation=(
            "tau_j = p + m,  tau_k = r (p - m),  p = ip w' + fcp tanh(w / v0) + fvp w with "
            "w = v_j + r v_k, and m alike with w = v_j - r v_k"
        ),
        signature="friction of two joints that turns with sum and difference of their speeds",
        confused_with=("coupled-transmission", "coupled-friction"),
        shown_by="the two joints together with equal and with opposite signs",
        source="Townsend, Salisbury, in: Robots and Biological Systems, 1993 (cable-driven arm)",
        over=Over.OTHER_SPEED,
    )
    params = tuple(
        Param(f"{name}{end}", unit, f"{text} of the motor that turns with the {which}", lower)
        for end, which in (("p", "sum"), ("m", "difference"))
        for name, unit, text, lower in (
            ("i", "{F} s^2/{x}", "inertia", -np.inf),
            ("fc", "{F}", "Coulomb friction", 0.0),
            ("fv", "{F} s/{x}", "viscous friction", -np.inf),
        )
    )
    shape = (
        Param(JOINT, "1", "number of the other joint", 1.0, choice=True),
        Param("r", "1", "ratio of the other joint's motion", 0.0),
    )
    scope = Scope(Of.JOINTS, lacks=_coupled_transmission_lacks)
    relations = Relations(replaces=("coupled-transmission",))
    search = Grid(_differential_grid, across=_differential_across, refine=False, rounds=4)
    limits = (Limit("drives", _differential_brakes, says="it would drive the joints"),)

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Columns (n, d, 6) of the motors that turn with the sum and with the difference."""
        k, r = int(shape[0]) - 1, float(shape[1])
        return np.concatenate([_turned_by_both(motion, j, k, x) for x in (r, -r)], axis=2)


#: How round a knee can be: its words, the largest limit worth trying as a share of the largest
#: effort, and how many of them.  Of a gradual one 3 % are lost there at the peak.
KNEES = {0.0: ("clipped", 0.98, 10), 4.0: ("a round knee", 1.8, 9), 2.0: ("gradually", 4.0, 9)}
#: Share of the rows below the least limit: beyond a limit an effort tells nothing, and with too
#: many such rows nothing is left to be explained.
_FREE = 0.8
#: Least limit of iron that saturates gradually, as a share of the largest effort: 38 % is lost
#: there.  Half: friction under load is one, for both bend with the effort; 1.25: drives that lose
#: 30 % go unnamed.
DEEP = 0.8
#: Share of the effort that a limit that acts takes at the largest command, at least.
LIMIT_SHARE = 0.01
#: Rows by which the command must be beyond a limit.
ROWS_BEYOND = 10
#: Share of the joint's largest command that a leak from the other one's largest is, at least.
LEAK = 0.01
#: Largest share of another channel that is a leak.  Half: two amplifiers on a poor common ground go
#: unnamed; double: two drives of one beam, which push against each other, leak into each other.
MOST_LEAK = 0.5
#: Share of the largest effort that either direction must ask for, so that they can be compared.
_ASKED = 0.2
#: Order of the polynomial of two positions that a leak is set against.
CUBIC = 3


def _torque_saturation_grid(motion: Motion, j: int) -> Shapes:
    """Limits from about the largest effort down to the least, by knee."""
    size = np.abs(motion.tau[:, j])
    top = max(float(size.max(initial=0.0)), 1e-12)
    return [
        (float(limit), p)
        for p, (_, most, count) in KNEES.items()
        for limit in np.geomspace(most * top, least_limit(size, p), count)
    ]


def _torque_saturation_felt(f: Fitted) -> bool:
    """It takes something of the largest efforts, and more than a few rows meet it.

    At the least and the largest limit that were tried another law is meant: one that bends
    everywhere.
    """
    limit, order = float(f.shape[0]), float(f.shape[1])
    size = np.sort(np.abs(f.motion.tau[:, f.j]))
    met = size[-ROWS_BEYOND:][:1]
    felt = bool(np.all(met - given(met, limit, order) > LIMIT_SHARE * met))
    inside = 1.02 * least_limit(size, order) < limit < max(KNEES[order][1], 1.0) * size[-1]
    return felt and inside


class TorqueSaturation(Effect):
    """The motor gives less than it is asked for: its amplifier clips, or its iron saturates."""

    name, family = "torque-saturation", "actuator"
    doc = Doc(
        equation=(
            "tau = model + a (tau - s(tau)),  s = tau / (1 + |tau/L|^p)^(1/p) or clip(tau, -L, L)"
        ),
        signature="what is missing grows with the command beyond a limit, in both directions",
        confused_with=("load-friction", "torque-gain", "gain-drift", "actuator-lag"),
        shown_by="the same motion slower, or with less load: what the limit cuts off is gone",
        source=(
            "Krause, Wasynczuk, Sudhoff, Pekarek, Analysis of Electric Machinery, 2013 (saturation)"
        ),
    )
    params = (Param("a", "1", "share of what the limit takes: 1 but for errors", 0.75, 1.33),)
    shape = (
        Param("L", "{F}", "limit", 0.0),
        Param(
            "p",
            "1",
            "order of the knee; 0: clipped",
            0.0,
            4.0,
            codes=tuple((p, words) for p, (words, *_) in KNEES.items()),
            choice=True,
        ),
    )
    search = Grid(_torque_saturation_grid)
    limits = (
        Limit(
            "unfelt",
            _torque_saturation_felt,
            says="the efforts hardly reach its limit, or all of them lie beyond it",
        ),
        STRICT,
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Command less what is given of it."""
        limit, order = float(shape[0]), float(shape[1])
        # beyond a sharp limit only the command says what was asked for; of a gradual one the
        # predicted effort does, and the measured one would explain whatever else grows with it
        tau = motion.driven(j) if order else motion.tau[:, j]
        return (tau - given(tau, limit, order))[:, None]


def least_limit(size: FloatArray, order: float) -> float:
    """Least limit worth trying for efforts of these sizes (n,) and a knee of this order."""
    top = max(float(size.max(initial=0.0)), 1e-12)
    return DEEP * top if order == 2.0 else max(float(np.quantile(size, _FREE)), 1e-3 * top)


def given(wanted: FloatArray, limit: float, order: float) -> FloatArray:
    """Effort (n,) that an amplifier with this `limit` and knee gives of what is `wanted` (n,)."""
    if not order:
        return np.clip(wanted, -limit, limit)
    # s(u) = u / (1 + |u / L|^p)^(1/p)
    out: FloatArray = wanted / (1.0 + np.abs(wanted / limit) ** order) ** (1.0 / order)
    return out


#: Narrowest dead zone that is sought, as a share of the largest effort.  Half: noise looks like
#: one; double: narrow ones go unnamed.
DEAD = 0.01
#: Largest share of the efforts that lie within it: a drive that lets less through hardly moves.
#: Half: the zone of a valve at small loads goes unnamed; double: what is missing is a part of the
#: command, and explains itself within a wide zone.
_INSIDE = 0.25
#: Share of the time in which effort and speed have opposite signs, at least: where they never have,
#: a dead zone is friction.  Half: friction of another form is a dead zone; double: motors that
#: brake little get none.
TURNED = 0.1
#: Places of the grid.
DEAD_PLACES = 10


def _widths(motion: Motion, j: int) -> tuple[float, float]:
    """Least and largest half width that is tried."""
    size = np.abs(motion.tau[:, j])
    least = DEAD * max(float(size.max(initial=0.0)), 1e-12)
    return least, max(float(np.quantile(size, _INSIDE)) if size.size else 0.0, 2 * least)


def _dead_zone_grid(motion: Motion, j: int) -> Shapes:
    """Half widths up to the size that the least efforts have."""
    return log_grid(*_widths(motion, j), DEAD_PLACES)


def _dead_zone_met(f: Fitted) -> bool:
    """Both sides of it were met: efforts beyond it, up and down, or it is an offset.

    At the least and the largest width that were tried, and where more is lost than is asked for,
    another law is meant.
    """
    tau, width, (low, high) = f.motion.tau[:, f.j], float(f.shape[0]), _widths(f.motion, f.j)
    passed = min(int(np.sum(tau > width)), int(np.sum(tau < -width))) > ROWS_BEYOND
    inside = 1.02 * low < width < 0.98 * high and f.beta[0] < 0.99 * f.effect.params[0].upper
    return bool(passed and inside)


def _dead_zone_apart(f: Fitted) -> bool:
    """The effort brakes, too: where it turns with the speed, a dead zone is dry friction."""
    tau, width = f.motion.tau[:, f.j], float(f.shape[0])
    braked = (np.abs(tau) > width) & (tau * f.motion.qd[:, f.j] < 0.0)
    return bool(np.mean(braked) > TURNED)


class DeadZone(Effect):
    """Nothing comes of a small command: an amplifier's dead time, the overlap of a valve."""

    name, family = "dead-zone", "actuator"
    doc = Doc(
        equation="tau = model + a clip(tau, -D, D)",
        signature="a step that turns with the effort, not with the motion",
        confused_with=("coulomb", "load-friction", "torque-saturation"),
        shown_by="slow strokes under a load that keeps its sign: friction turns, the zone does not",
        source=(
            "Tao, Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, "
            "1996, 2"
        ),
    )
    params = (Param("a", "1", "share of the zone that is lost: 1 but for errors", 0.75, 1.33),)
    shape = (Param("D", "{F}", "half width", 0.0, size=True),)
    search = Grid(_dead_zone_grid)
    limits = (
        Limit(
            "unmet",
            _dead_zone_met,
            says="the efforts hardly exceed it, or exceed it in one direction only",
        ),
        Limit(
            "unbraked",
            _dead_zone_apart,
            says="the effort hardly ever brakes; a dead zone then looks like dry friction",
        ),
        STRICT,
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """What the zone takes of the command."""
        width = float(shape[0])
        return np.clip(motion.tau[:, j : j + 1], -width, width)


#: Share by which the effort of one direction differs from the other's that is a gain.  Half: the
#: offset of a current sensor looks like one; double: an actuator that pulls a tenth weaker than it
#: pushes goes unnamed.  Beyond `MOST_UNEVEN` one direction hardly acts.
UNEVEN, MOST_UNEVEN = 0.02, 0.8


def _asymmetric_gain_lacks(motion: Motion, j: int) -> str:
    """In one direction alone the size of the effort is the effort."""
    tau = motion.tau[:, j]
    up, down = float(np.max(tau, initial=0.0)), float(np.max(-tau, initial=0.0))
    return "" if min(up, down) > _ASKED * max(up, down) else "the efforts are of one direction"


def _asymmetric_gain_felt(f: Fitted) -> bool:
    """What the directions give differs by more than an offset looks like; each gives something."""
    return UNEVEN < abs(f.beta[0]) + f.slack[0] and abs(f.beta[0]) < MOST_UNEVEN


class AsymmetricGain(Effect):
    """More comes of a command in one direction: a cylinder with one rod, a pair of muscles."""

    name, family = "asymmetric-gain", "actuator"
    doc = Doc(
        equation="tau = model + g |tau|",
        signature="residual proportional to the size of the effort, of one sign",
        confused_with=("asymmetric-coulomb", "torque-offset", "torque-saturation"),
        shown_by="the same load held in both directions, several sizes",
        source="Merritt, Hydraulic Control Systems, 1967, 6 (piston of unequal areas)",
    )
    params = (Param("g", "1", "half the difference of the two directions over their mean"),)
    scope = Scope(lacks=_asymmetric_gain_lacks)
    limits = (
        Limit("even", _asymmetric_gain_felt, says="so little is an offset, or one direction acts"),
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """|tau|, as predicted: the measured one would explain its own noise."""
        return np.abs(motion.driven(j))[:, None]


def _torque_crosstalk_foils(motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
    """What hangs on both joints' positions: a hose or a bundle of cables between them."""
    a, b = motion.scaled(j), motion.scaled(int(shape[0]) - 1)
    powers = [(m, n) for m in range(CUBIC + 1) for n in range(CUBIC + 1 - m) if m or n]
    return [np.stack([a**m * b**n for m, n in powers], axis=1)]


def _torque_crosstalk_grid(motion: Motion, j: int) -> Shapes:
    """Every other joint."""
    return [(float(k + 1),) for k in range(motion.d) if k != j]


def _torque_crosstalk_leaks(f: Fitted) -> bool:
    """A channel that follows another one by half and more is swapped or coupled, and no leak.

    What is less than `LEAK` of the largest effort is no leak: forces are measured to a
    percent or two, and within a sample of the motion.
    """
    most = np.max(np.abs(f.motion.tau), axis=0)
    felt = abs(f.beta[0]) * most[int(f.shape[0]) - 1] >= LEAK * most[f.j]
    return bool(felt and abs(f.beta[0]) < MOST_LEAK + f.slack[0])


class TorqueCrosstalk(Effect):
    """A part of another motor's command reaches this one: a common ground, cables side by side."""

    name, family = "torque-crosstalk", "actuator"
    doc = Doc(
        equation="tau_j = model - e tau_k",
        signature="residual that follows another motor's whole effort, its friction included",
        confused_with=("coupled-friction", "rigid-body", "torque-gain"),
        shown_by="one joint at a time, the others holding different loads",
        source="as in a force sensor: Cao, Laws, Rodriguez y Baena, IEEE Sensors J. 21(18), 2021",
    )
    params = (Param("e", "1", "share of the other motor's command"),)
    shape = (Param(JOINT, "1", "number of the other joint", 1.0, choice=True),)
    scope = Scope(lacks=one_joint)
    relations = Relations(foils=_torque_crosstalk_foils)
    search = Grid(_torque_crosstalk_grid, refine=False)
    limits = (
        Limit(
            "leak",
            _torque_crosstalk_leaks,
            says="so much is a swapped channel, or so little no leak",
        ),
    )
    traits = Trait.REPLAYED

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Less the other motor's command."""
        k = int(shape[0]) - 1
        return -motion.driven(k)[:, None]


EFFECTS = (
    TorqueOffset(),
    TorqueGain(),
    Cogging(),
    SecondCogging(),
    CoupledTransmission(),
    Differential(),
    TorqueSaturation(),
    DeadZone(),
    AsymmetricGain(),
    TorqueCrosstalk(),
)
