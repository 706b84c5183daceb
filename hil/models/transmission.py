"""What lies between motor and link, seen from the motor's encoder alone.

With the load tau_l that a rigid joint would transmit (rigid body less external effort), a spring
of stiffness k and a link of inertia M behind it, w^2 = k / M, give

    tau_l(elastic) = H(s) tau_l,    H = w^2 / (s^2 + 2 zeta w s + w^2):

the link answers as through a resonator.  The motor supplies tau_l + (H - 1) tau_l.  The rotor
sits before the spring: its inertia is no part of tau_l where it is known apart from the link's.

The other joints i move a link that is at q_j - d, d the stretch, and not at q_j.  To first order
their efforts change by  -(M_ij d'' + G_ij d)  with the model's inertia M and static stiffness G.

A cable that is soft about zero tension and stiff under load: its strands and its winding settle
before they carry.  It is the family that joins the elastic transmission (one stiffness) and the
play (none, then a hard one).  With the stiffness k0 at zero tension and the stretch s that the
soft range takes up,

    d(T) = s T / (T0 + |T|),    s = T0 / k0,    dT/dd = k0 (1 + |T| / T0)^2:

T0 -> infinity is the elastic transmission, T0 -> 0 with s kept a play of width 2 s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from hil.models.effect import (
    STRICT,
    VALUE_DEVIATIONS,
    Doc,
    Effect,
    Fitted,
    Grid,
    Limit,
    Of,
    Param,
    Relations,
    Scope,
    Shapes,
    Sight,
    Trait,
    Twin,
    log_grid,
    motor_inertias,
)
from hil.models.kernels import slope, softened, sprung
from hil.models.motion import FloatArray, Motion

#: Longest step of the integration [s].
_LONGEST = 2e-3


def passing(
    motion: Motion,
    j: int,
    soft: tuple[float, float],
    lag: FloatArray,
    rub: float,
    own: float = 0.0,
) -> FloatArray:
    """What a cable (stretch, tension: `softened`) or a play passes, less the load, (n, d, 1)."""
    load, speed = _carried(motion, j, own), np.ascontiguousarray(motion.qd[:, j])
    slow, parts = float(motion.resolution[j]), int(np.ceil(motion.dt / _LONGEST))
    inertia = link_inertia(motion, j, own)
    weight = link_weight(motion, j)
    passed, *moved = softened(load, speed, inertia, weight, motion.dt, *soft, lag, rub, slow, parts)
    out = _felt(motion, j, *moved)
    out[:, j] = passed - load - rub * np.clip(speed / slow, -1.0, 1.0)
    return out[:, :, None]


def _felt(
    motion: Motion, j: int, stretch: FloatArray, rate: FloatArray, second: FloatArray
) -> FloatArray:
    """What the other joints feel of a link that is not where the motor is, (n, d).

    To first order -(M_ij d'' + D_ij d' + G_ij d) for a stretch d and its derivatives: the link of
    joint j is at q_j - d.  Nothing where joint j alone is asked for.
    """
    if motion.response is None or motion.d == 1 or motion.lone:
        return np.zeros((motion.n, motion.d))
    inertia, gradient = motion.response.inertia[:, :, j], motion.response.gradient[:, :, j]
    turning = motion.response.coriolis(j)
    out: FloatArray = inertia * second[:, None]
    out += turning * rate[:, None]
    out += gradient * stretch[:, None]
    return -out


def _carried(motion: Motion, j: int, own: float = 0.0) -> FloatArray:
    """Load behind the transmission (n,), without the motor's inertia that the masses hold."""
    load = motion.load[:, j]
    return np.ascontiguousarray(load - own * motion.qdd[:, j] if own else load)


def load_size(motion: Motion, j: int) -> float:
    """Standard deviation of the load behind the transmission; 1 where there is none."""
    return float(np.std(_carried(motion, j))) or 1.0


def link_inertia(motion: Motion, j: int, own: float = 0.0) -> FloatArray:
    """Inertia of the link as the joint feels it (n,): of the model, or load by acceleration.

    `own` of it is the motor's; where that leaves the link less than none it has next to none.
    """
    if motion.response is not None:
        link = motion.response.inertia[:, j, j] - motion.response.rotor[j] - own
        mean = float(np.mean(link))
        if np.min(link) > 0 or (own and mean > 0):
            return np.ascontiguousarray(np.maximum(link, NEXT_TO_NONE * mean if own else 0.0))
    slope = float(np.std(_carried(motion, j)) / max(float(np.std(motion.qdd[:, j])), 1e-12))
    return np.full(motion.n, max(slope, 1e-12))


def link_weight(motion: Motion, j: int) -> FloatArray:
    """By how much the weight of the link grows with the link's own position (n,)."""
    if motion.response is None:
        return np.zeros(motion.n)
    return motion.response.weight(j)


def rotors(motion: Motion, j: int, own: float) -> list[float]:
    """Inertias of the motor that leave the link one, where they are told from the share `a`.

    They are where the link's inertia changes, or a weight hangs on it, too.
    """
    if motion.response is None:
        return []
    link = motion.response.inertia[:, j, j] - motion.response.rotor[j]
    told = np.ptp(link) > _VARIES * np.mean(link) or np.any(motion.response.weight(j))
    return [x for x in motor_inertias(motion, j, own) if told and x < np.min(link)]


#: The motor's part of the inertia, a value of every law of what lies behind the motor.
_ROTOR = Param("i", "{F} s^2/{x}", "inertia of the motor within the model's masses", tuned=True)
_SPONG = "Spong, J. Dyn. Syst. Meas. Control 109, 1987"
#: Damping ratios tried.
ZETAS = (0.1, 0.3)
#: ... and once a resonance is found.
MORE_ZETAS = (*ZETAS, 0.02, 0.005, 0.05, 0.15, 0.5, 0.8)
#: Damping ratio from which on a mass on a spring loses five sixths of its swing at each one.
SWINGING = 0.5
#: Resonance at which the grid begins, to both sides [Hz], and its step in half-power widths; a
#: transmission's are above.
_MIDDLE, _STEP = 2.0, 1.75
#: Periods of the lowest resonance tried in a run, as of a disturbance; what swings less often is a
#: spring or a drift.  Double: the slosh of a run of a few swings goes unnamed; half: springs swing.
_SEEN = 4.0


def lowest(motion: Motion) -> float:
    """Lowest resonance worth trying [Hz]: several of its periods must fit into the run."""
    return min(_SEEN / max(float(motion.since[-1]), _SEEN * motion.dt), _MIDDLE)


def highest(motion: Motion) -> float:
    """Highest resonance worth trying [Hz]: an eighth of the evaluation rate.

    That is well above the effort filter; what is faster looks like a delay or an inertia.
    """
    return max(0.125 / motion.dt, 1.5 * _MIDDLE)


def _frequencies(motion: Motion, zeta: float) -> list[float]:
    """Resonances worth trying [Hz], so close that one of them lies on the flank of any other.

    A longer run has slower ones, and the same fast ones.
    """
    low, high, step = lowest(motion), highest(motion), np.log(1 + 2 * zeta * _STEP)
    down, up = (int(np.ceil(np.log(x) / step)) for x in (_MIDDLE / low, high / _MIDDLE))
    below = np.geomspace(low, _MIDDLE, 1 + down)[:-1]
    return [float(f) for f in (*below, *np.geomspace(_MIDDLE, high, 1 + up))]


def inside(motion: Motion, f: float) -> bool:
    """Whether a resonance lies within the band; one at its end stands for something else."""
    return 1.05 * lowest(motion) < f < 0.95 * highest(motion)


#: How far beyond the effort filter's cut-off a mode still shows its flank.  Half: modes of the
#: upper band go unnamed; double: what reversals leave of dry friction is a mode.
BEYOND_BAND = 1.1
#: Share of the load behind a spring or a play from which it is one (the rotor is before it).
LOAD_SHARE = 0.25
#: Frictions behind a play that are tried, in units of the load's standard deviation.
FRICTIONS = (0.03, 0.06, 0.1, 0.15, 0.25)
#: ... and behind a spring, which may carry little but friction; nearer ones lie by this apart.
_MORE_FRICTIONS, _CLOSER = (*FRICTIONS, 0.4, 0.7), 1.25
#: Tension at which a spring would be four times as stiff, in the same units: beyond any.
STRAIGHT = 1e4
#: Tension that takes up half a play, in the same units: next to none.
HARD = 3e-3
#: Least inertia of a link over its mean, where a recording goes to postures beyond the fitted ones.
NEXT_TO_NONE = 0.01
#: Range of a link's inertia over its mean from which on it is not the same everywhere.
_VARIES = 0.1
#: Times in which a flank is relieved that are tried [s], the usual one first.
_LAGS = (0.01, 0.003, 0.0055)


def stiffness(motion: Motion, j: int, f: float, own: float = 0.0) -> float:
    """Stiffness of a spring for a resonance f [Hz] with the motor held, at the mean inertia."""
    return (2 * np.pi * f) ** 2 * float(np.mean(link_inertia(motion, j, own)))


def resonance(motion: Motion, j: int, k: float, own: float = 0.0) -> float:
    """Resonance [Hz] of a stiffness with the motor held, at the mean inertia."""
    return float(np.sqrt(k / np.mean(link_inertia(motion, j, own)))) / (2 * np.pi)


def lag_of(inertia: FloatArray, k: float, zeta: float) -> FloatArray:
    """Damping over the stiffness c / k = 2 zeta sqrt(I / k) (n,) [s]."""
    out: FloatArray = 2 * zeta * np.sqrt(inertia / k)
    return out


def _resonance_grid(motion: Motion, j: int) -> Shapes:
    """Resonances over the band for two damping ratios, each in steps of its own width."""
    return [(f, z) for z in ZETAS for f in _frequencies(motion, z)]


def _resonance_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Damping ratios."""
    return [(shape[0], z) for z in MORE_ZETAS]


def _rings(f: Fitted) -> bool:
    """Within the band, and ringing: beyond a damping ratio of 0.7 a resonance has no peak."""
    return _ringing(f.motion, *f.shape[:2])


def _ringing(motion: Motion, f: float, zeta: float) -> bool:
    return zeta < max(MORE_ZETAS) and inside(motion, f)


RINGS = Limit(
    "resonance",
    _rings,
    says="its resonance lies outside the band, or is damped so much that nothing rings",
)


class _Resonance(Effect):
    """What rings at one frequency: f [Hz] and a damping ratio are its shape."""

    shape: ClassVar[tuple[Param, ...]] = (
        Param("f", "Hz", "frequency at which the mode swings", 0.0, size=True),
        Param("zeta", "1", "damping ratio", 0.0, 1.0, tuned=True),
    )
    search = Grid(_resonance_grid, across=_resonance_across, rounds=2)
    limits: ClassVar[tuple[Limit, ...]] = (RINGS, STRICT)
    traits = Trait.REPLAYED | Trait.SMOOTHS


def _elastic_transmission_grid(motion: Motion, j: int) -> Shapes:
    """Resonances and damping ratios, without friction of the link.

    A link that swings slower hardly follows its motor: its spring is one against what stands.
    """
    shapes = [(f, z) for f, z in _resonance_grid(motion, j) if f >= _MIDDLE]
    return [(stiffness(motion, j, f), z, 0.0, 0.0) for f, z in shapes]


def _elastic_transmission_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Damping ratios, frictions of the link, inertias of the motor; one changed at a time."""
    k, zeta, rub, own = shape
    size, f = load_size(motion, j), resonance(motion, j, k, own)
    near = [rub / _CLOSER, rub * _CLOSER] if rub else []
    frictions = [0.0, *(r * size for r in _MORE_FRICTIONS), *near]
    return [
        *((k, z, rub, own) for z in MORE_ZETAS),
        *((k, zeta, r, own) for r in frictions),
        # the resonance shows: it stays, and the stiffness changes with what swings on it
        *((stiffness(motion, j, f, x), zeta, rub, x) for x in rotors(motion, j, own)),
    ]


#: What `fl` is: the friction acts as the load does, by the share that lies behind the spring.
_RUBS = "Coulomb friction behind the spring, over the share a"


def _elastic_transmission_rings(f: Fitted) -> bool:
    """Within the band, and ringing."""
    k, zeta, _, own = f.shape
    return _ringing(f.motion, resonance(f.motion, f.j, k, own), zeta)


def _elastic_transmission_carries(f: Fitted) -> bool:
    """Within the band, and a good part of the load behind it; a small one is a mode."""
    return f.beta[0] > LOAD_SHARE


#: Part of a load by which its share behind a spring must be below all of it to be worth a word.
#: Double: a stiffness is a quarter too high in silence; half: errors of the form get one.
_LESS = 0.1


def _elastic_transmission_remark(values: Mapping[str, float], errors: Mapping[str, float]) -> str:
    """What swings on the spring is less than the model's inertia: so is the spring."""
    a, k = values["a"], values["k"]
    most = 1.0 - max(_LESS, VALUE_DEVIATIONS * errors["a"])
    if values["i"] > 0.0 or not 0.0 < a < most:
        return ""
    return (
        f"a = {a:.3g} is well below 1. If the rest of the inertia is the motor's own, the spring's "
        f"stiffness is a k = {a * k:.4g}; if the motion is far slower than the resonance, which "
        f"tells a / k alone, it may be k / a = {k / a:.4g}"
    )


def _free(motion: Motion) -> bool:
    """One axis without gravity or contact: the load is inertia alone."""
    return motion.d == 1 and not np.any(link_weight(motion, 0)) and not np.any(motion.tau_ext)


class ElasticTransmission(_Resonance):
    """The cable or gear between motor and link gives.

    The link moves otherwise than the motor: its friction has the sign of its own speed, and
    every change of that sign makes the spring ring.
    """

    name, family = "elastic-transmission", "transmission"
    doc = Doc(
        equation=(
            "tau = a (T - load - fl sgn v),  (I d')' + G d + T = load + fl sgn(v - d'),  "
            "T = k d + c d',  c = 2 zeta sqrt(k I);  "
            "d and T: stretch and tension; load, its growth G with the link's position and "
            "the link's inertia I without the motor's i"
        ),
        signature="residual grows with frequency towards a resonance, and rings after reversals",
        confused_with=("vibration-mode", "hardening-cable", "armature"),
        shown_by="fast motion towards the resonance; chirp under load",
        source=_SPONG + "; Naerum thesis 3.2 (elastic transmission from the motor's side)",
        remark=_elastic_transmission_remark,
    )
    params = (Param("a", "1", "share of the load that the spring carries", LOAD_SHARE, 2.0),)
    shape = (
        Param("k", "{F}/{x}", "stiffness of the spring", 0.0, size=True),
        Param("zeta", "1", "damping ratio", 0.0, 1.0, tuned=True),
        Param("fl", "{F}", _RUBS, 0.0, tuned=True),
        _ROTOR,
    )
    relations = Relations(twins=(Twin("vibration-mode", _free),), causes=("resonance",))
    search = Grid(_elastic_transmission_grid, across=_elastic_transmission_across, rounds=4)
    scope = Scope(Of.JOINTS, sought_alone=True)
    limits = (
        Limit("share", _elastic_transmission_carries, says="too little of the load lies behind it"),
        Limit(
            "resonance",
            _elastic_transmission_rings,
            says="its resonance lies outside the band, or is damped so much that nothing rings",
        ),
        STRICT,
    )
    traits = Trait.LOAD | _Resonance.traits

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """What passes the spring, less the load, and what that does to others."""
        k, zeta, rub, own = map(float, shape)
        inertia = link_inertia(motion, j, own)
        if rub:
            # a spring that no load makes stiffer
            tension = STRAIGHT * load_size(motion, j)
            lag = lag_of(inertia, k, zeta)
            return passing(motion, j, (tension / k, tension), lag, rub, own)
        load = _carried(motion, j, own)
        weight = link_weight(motion, j)
        passed, stretch, rate = sprung(load, inertia, weight, motion.dt, k, zeta)
        grows = slope(inertia, 1 / motion.dt)
        second = (load - passed - weight * stretch - grows * rate) / inertia
        out = _felt(motion, j, stretch, rate, second)
        out[:, j] = passed - load
        return out[:, :, None]


def _backlash_grid(motion: Motion, j: int) -> Shapes:
    """From 1e-4 of the span, and from four times what the encoder resolves, to 5e-2."""
    span = float(np.ptp(motion.span[j])) or 1.0
    grain = float(motion.grain[j]) if motion.grain.size else 0.0
    widths = log_grid(min(max(1e-4 * span, 4 * grain), 2e-2 * span), 5e-2 * span, 10)
    return [(b, 0.0, _LAGS[0], 0.0) for (b,) in widths]


def _backlash_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Frictions of the link, which then needs a narrower play; flanks; inertias of the motor."""
    size, (width, rub, lag, own) = load_size(motion, j), shape
    slower = [(k * width, r * size, lag, own) for r in FRICTIONS for k in (0.7, 0.85, 1.0)]
    return [
        (width, 0.0, lag, own),
        *slower,
        *((width, rub, c, own) for c in _LAGS),
        *((width, rub, lag, x) for x in rotors(motion, j, own)),
    ]


def _backlash_carries(f: Fitted) -> bool:
    """A good part of the load lies behind the play; a small one is friction under load."""
    return f.beta[0] > LOAD_SHARE


class Backlash(Effect):
    """Play between motor and link: within it the link is not carried."""

    name, family = "backlash", "transmission"
    doc = Doc(
        equation=(
            "tau = a (P - L),  L = load + fl sgn(v - d'),  (I d')' + P = L,  P = T + c T',  "
            "T = 0 for |d| < b / 2, whatever is needed at the flanks;  "
            "load and the link's inertia I without the motor's i"
        ),
        signature="the load is missing over a fixed displacement after it changes its sign",
        confused_with=("hardening-cable", "presliding", "elastic-transmission", "coulomb"),
        shown_by="small reversals under a load that changes its sign",
        source="Nordin, Gutman, Automatica 38, 2002",
        shown=Sight.REVERSALS,
        caveat=(
            "its flanks are hard and without bounce: where they are springy, width and share may "
            "be wrong by tens of percent, and the standard errors count noise alone"
        ),
    )
    params = (Param("a", "1", "share of the load behind the play", 0.0, 1.5),)
    shape = (
        Param("b", "{x}", "width of the play", 0.0, size=True),
        Param("fl", "{F}", "Coulomb friction behind the play", 0.0),
        Param("c", "s", "time in which a flank loses what a blow has pressed into it", 0.0),
        _ROTOR,
    )
    scope = Scope(Of.JOINTS, sought_alone=True)
    relations = Relations(causes=("play",))
    search = Grid(_backlash_grid, across=_backlash_across, rounds=2)
    limits = (
        Limit("share", _backlash_carries, says="too little of the load lies behind it"),
        STRICT,
    )
    traits = Trait.LOAD | Trait.REPLAYED | Trait.SMOOTHS

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """What passes the play, less the load."""
        width, rub, lag, own = map(float, shape)
        # a cable that a load next to nothing stretches by half the play, and no load by more
        soft = 0.5 * width, HARD * load_size(motion, j)
        return passing(motion, j, soft, np.full(motion.n, lag), rub, own)


def _vibration_mode_swings(f: Fitted) -> bool:
    """A structure that rings: one damped more than `SWINGING` is an inertia that fades.

    That is also what the filtered noise of a coarse position looks like.  Nor does one ring that is
    faster than what the efforts show: it is an inertia with a lag.
    """
    within = not f.motion.band or f.shape[0] < BEYOND_BAND * f.motion.band
    return f.shape[1] < SWINGING and within


class VibrationMode(_Resonance):
    """A mass on a spring that the joint's acceleration excites (structure, tool, table)."""

    name, family = "vibration-mode", "structure"
    doc = Doc(
        equation="tau = m (H - 1) qdd,  H = (2 z w s + w^2) / (s^2 + 2 z w s + w^2),  w = 2 pi f",
        signature="the residual rings at one frequency after every change of acceleration",
        confused_with=("elastic-transmission", "armature"),
        shown_by="steps of acceleration, then rest; chirp through the resonance",
        source="Preumont, Vibration Control of Active Structures, 2011, 2.2",
    )
    params = (Param("m", "{F} s^2/{x}", "inertia of the mode at this joint", 0.0),)
    relations = Relations(twins=(Twin("elastic-transmission", _free),), causes=("resonance",))
    limits = (
        Limit("damped", _vibration_mode_swings, says="it is damped so much that nothing rings"),
        RINGS,
        STRICT,
    )
    traits = Trait.MOTION | _Resonance.traits

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """(H - 1) qdd."""
        w, qdd = 2 * np.pi * float(shape[0]), np.ascontiguousarray(motion.qdd[:, j])
        # unit mass: k = w^2
        one, none = np.ones(motion.n), np.zeros(motion.n)
        passed, _, _ = sprung(qdd, one, none, motion.dt, w * w, float(shape[1]))
        return (passed - qdd)[:, None]


#: Tensions that take up half the soft range, in units of the load's standard deviation: tried at
#: first, and once a resonance is found.  At the largest such a load makes the cable hardly more
#: than twice as stiff: that is an elastic transmission.  At the smallest it makes it some hundreds
#: of times as stiff: that is a play.  With the first ones the steps of the frequency: the sooner
#: it stiffens the less it rings.
TENSIONS = {0.3: 1.5, 0.1: 1.7, 1.0: 1.35}
MORE_TENSIONS = (0.05, 0.1, 0.17, 0.3, 0.55, 1.0, 2.0)
#: Damping ratios at zero tension: at first, and then.
CABLE_ZETA, CABLE_ZETAS = 0.1, (0.03, 0.05, 0.1, 0.2, 0.4)
#: Friction of the link that is tried at first, in the same units.
_RUB = 0.1


def _hardening_cable_grid(motion: Motion, j: int) -> Shapes:
    """Resonances over the lower half of the band, three tensions, some damping."""
    low, high = _MIDDLE, max(0.5 * highest(motion), 1.5 * _MIDDLE)
    size = load_size(motion, j)
    out: Shapes = []
    for t, step in TENSIONS.items():
        some = np.geomspace(low, high, 1 + int(np.ceil(np.log(high / low) / np.log(step))))
        other = t * size, CABLE_ZETA, _RUB * size, 0.0
        out += [(stiffness(motion, j, f), *other) for f in some.tolist()]
    return out


def _hardening_cable_across(motion: Motion, j: int, shape: Sequence[float]) -> Shapes:
    """Tensions, then dampings and frictions of the link, one of them changed at a time."""
    k, tension, zeta, rub, own = shape
    size, f = load_size(motion, j), resonance(motion, j, k, own)
    return [
        *((k, t * size, zeta, rub, own) for t in MORE_TENSIONS),
        *((k, tension, z, rub, own) for z in CABLE_ZETAS),
        *((k, tension, zeta, r * size, own) for r in (0.0, *FRICTIONS)),
        *((stiffness(motion, j, f, x), tension, zeta, rub, x) for x in rotors(motion, j, own)),
    ]


def _hardening_cable_between(f: Fitted) -> bool:
    """Neither all of the motion in its soft range nor next to nothing, and much behind it."""
    low, high = (t * load_size(f.motion, f.j) for t in (MORE_TENSIONS[0], MORE_TENSIONS[-1]))
    rings = inside(f.motion, resonance(f.motion, f.j, f.shape[0], f.shape[4]))
    between = 1.05 * low < f.shape[1] < 0.95 * high and rings
    return between and f.beta[0] > LOAD_SHARE


class HardeningCable(Effect):
    """A cable that is soft about zero tension and stiffer the more it carries."""

    name, family = "hardening-cable", "transmission"
    doc = Doc(
        equation=(
            "tau = a (P - L),  L = load + fl sgn(v - d'),  (I d')' + P = L,  P = T + c T',  "
            "d = (T / k0) / (1 + |T| / T0),  c = 2 zeta sqrt(I / k0);  "
            "load and the link's inertia I without the motor's i"
        ),
        signature=(
            "the load comes late and rings after it changes its sign, the less the larger it is"
        ),
        confused_with=("backlash", "elastic-transmission", "vibration-mode"),
        shown_by="the same fast motion under a small and a large static load",
        source="Naerum thesis 3.2; Miyasaka et al., ICRA 2015 (cable stiffness rises with load)",
        caveat=(
            "the law of a real cable is another one: stretch, tension and damping are those of "
            "the nearest cable of this form, and the standard errors count noise alone"
        ),
    )
    params = (Param("a", "1", "share of the load that the cable carries", 0.0, 2.0),)
    shape = (
        Param("k0", "{F}/{x}", "stiffness about zero tension", 0.0, size=True),
        Param("T0", "{F}", "tension at which it is four times as stiff as at zero", 0.0),
        Param("zeta", "1", "damping ratio about zero tension", 0.0),
        Param("fl", "{F}", "Coulomb friction behind the cable", 0.0),
        _ROTOR,
    )
    scope = Scope(Of.JOINTS, sought_alone=True)
    relations = Relations(limit="elastic-transmission", causes=("resonance", "play"))
    search = Grid(_hardening_cable_grid, across=_hardening_cable_across, rounds=2)
    limits = (
        Limit(
            "between",
            _hardening_cable_between,
            says="its soft range holds all of the motion, or next to none",
        ),
        STRICT,
    )
    traits = Trait.LOAD | Trait.REPLAYED | Trait.SMOOTHS

    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """What passes the cable, less the load."""
        k, tension, zeta, rub, own = map(float, shape)
        lag = lag_of(link_inertia(motion, j, own), k, zeta)
        return passing(motion, j, (tension / k, tension), lag, rub, own)


EFFECTS = (
    ElasticTransmission(),
    Backlash(),
    VibrationMode(),
    HardeningCable(),
)
