"""What must not run: judged over a set of operators, environments, poses and delays.

An axis: master with operator and slave with environment meet in two scalars, the forces that each
commands of the other.  With the transfer functions G_m, G_s between them, in sampled time,

    1 - G_m(z) G_s(z) z^-d = 0

for d ticks of delay to and fro together.  Without delay the eigenvalues of both decide exactly.
A longer delay makes a loop unstable where a root reaches the unit circle: |G_m G_s| = 1 there, at
d = arg(G_m G_s) / angle(z).  The smallest such d over the set is the delay margin, so that every
delay up to the longest is covered; stability is not monotonic in the delay, because of the cable.

Two whole arms: a law that couples them is a function of the loop, whose derivatives at rest are
taken from itself.  With the mass matrix M, weight g and tip Jacobian J of each arm,

    M q'' + J^T (B J q' + K J q) + g(q) = tau,   held between ticks,

the eigenvalues of arms, law and delay decide, in small motions about a posture where it starts.
No arm has friction here, nor does the law feed any forward.  'hil design' and every start of the
law ask for the same.

Weight that is compensated a time T late, in a posture that falls, makes a free arm drift slowly:

    M q'' = G q - G q(t - T),   growth at most  T max eig(M^-1 G),

which the friction of any arm ends.  A law that holds no arm but at the other one has such a mode in
every posture; there, slow modes may grow by that much.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np
from scipy.linalg import expm
from scipy.stats import qmc

from hil.errors import ConfigError
from hil.models.robots import Robot, bare_robot
from hil.record.recording import RobotSource
from hil.signals.device import Controller
from hil.signals.settable import ArmDescription
from hil.teleop import hybrid
from hil.teleop.architecture import MOTION
from hil.teleop.hybrid import ComplexArray, FloatArray, Impedance
from hil.teleop.sampled_loop import Axis, SampledLoop, dominant_mode

#: Beyond this per period a mode grows; a free position is a mode of exactly 1.
GROWTH = 1e-7
#: From here on a growing mode is put down to the cable [Hz].
_CABLE_HZ = 80.0
#: Angles of the unit circle at which the loop is evaluated [rad a period].
_ANGLES: FloatArray = np.geomspace(1e-4, np.pi, 1600)
#: Delays above are not looked for [s].
_LONGEST = 4.0


@dataclass(frozen=True)
class Margins:
    """Margins of one axis over its set of operators, environments and poses.

    Parameters
    ----------
    axis : str
        Which.
    pole : float
        Largest real part of the continuous closed-loop poles without delay and cable [rad/s].
    radius : float
        Largest magnitude of the sampled closed-loop eigenvalues without delay.
    delay_s : float
        Round-trip delay up to which all of the set is stable [s]; infinite where none matters,
        0 where it is unstable without delay already.
    pair : str
        The member of the set that bears the least.
    """

    axis: str
    pole: float
    radius: float
    delay_s: float
    pair: str


@dataclass(frozen=True)
class _Member:
    """One operator, environment and pose: eigenvalue without delay, and the delay it bears."""

    zh: Impedance
    ze: Impedance
    tip: tuple[float, float]
    radius: float
    delay_s: float
    within: bool = False

    @property
    def unstable(self) -> bool:
        return self.radius > 1.0 + GROWTH

    @property
    def text(self) -> str:
        tips = f"tips of {self.tip[0]:.3g} and {self.tip[1]:.3g} kg"
        where = ", in the virtual fixtures" if self.within else ""
        return f"{_pair_text(self.zh, self.ze)}, {tips}{where}"


@dataclass(frozen=True)
class _Side:
    """One arm with what it touches, from the force it hears of to the force it asks for.

    Parameters
    ----------
    a, b, c : ndarray (n, n), (n,), (n,)
        State z' = a z + b heard, asked = c z.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray

    def response(self, z: ComplexArray) -> ComplexArray:
        """Transfer function at z: det(z - a + b c) / det(z - a) - 1, with the sign of b c."""
        ahead = np.linalg.eigvals(self.a - np.outer(self.b, self.c))
        own = np.linalg.eigvals(self.a)
        ratio = np.ones_like(z)
        for p, q in zip(ahead, own, strict=True):
            ratio *= (z - p) / (z - q)
        out: ComplexArray = ratio - 1.0
        return out


def _sides(loop: SampledLoop, zh: Impedance, ze: Impedance, period: float) -> tuple[_Side, _Side]:
    """Both arms of an axis apart, from the kernels of the law."""
    real = replace(loop.real, forward_s=0.0, backward_s=0.0)
    axis = Axis(replace(loop, real=real), zh, ze, period)
    found = axis.apart()
    return _Side(*found[0]), _Side(*found[1])


def _members(loop: SampledLoop, period: float) -> Iterator[_Member]:
    """The whole set, judged one by one, beside and within the virtual fixtures."""
    yield from _beside(loop, period)
    if any(loop.fixture):
        yield from (replace(m, within=True) for m in _beside(loop.within(), period))


def _beside(loop: SampledLoop, period: float) -> Iterator[_Member]:
    """The set without fixtures: slow modes with the arms' friction, fast ones with little of it.

    While an arm slides, Coulomb friction damps no small oscillation about the sliding.
    """
    if not any((*loop.friction, *loop.compensated)):
        yield from _judged(loop, period, 0.0)
        return
    fast = _judged(_sliding(loop), period, 2 * np.pi * _FAST_HZ * period)
    for a, b in zip(_judged(loop, period, 0.0), fast, strict=True):
        yield a if (a.delay_s, -a.radius) <= (b.delay_s, -b.radius) else b


def _sliding(loop: SampledLoop) -> SampledLoop:
    """The loop with the friction that is left while the arms slide."""
    return replace(
        loop,
        friction=(_SLIDING * loop.friction[0], _SLIDING * loop.friction[1]),
        compensated=(_SLIDING * loop.compensated[0], _SLIDING * loop.compensated[1]),
    )


#: Part of the friction that damps while the arm slides, and from where modes count as fast [Hz].
_SLIDING, _FAST_HZ = 0.2, 50.0


def _judged(loop: SampledLoop, period: float, slowest: float) -> Iterator[_Member]:
    """The whole set, modes slower than `slowest` [rad a period] left out."""
    z = np.exp(1j * _ANGLES)
    for tip in loop.tips or (loop.masses(),):
        masters, slaves = _each(replace(loop, tip=tip), period)
        responses: dict[int, ComplexArray] = {}
        for (zh, master), (ze, slave) in product(
            zip(loop.operators, masters, strict=True), zip(loop.environments, slaves, strict=True)
        ):
            radius, bears = _radius(master, slave, slowest), 0.0
            if radius <= 1.0 + GROWTH:
                for side in (master, slave):
                    if id(side) not in responses:
                        responses[id(side)] = side.response(z)
                around = responses[id(master)] * responses[id(slave)]
                bears = _first_crossing(around, slowest) * period
            yield _Member(zh, ze, tip, radius, bears)


def _each(loop: SampledLoop, period: float) -> tuple[list[_Side], list[_Side]]:
    """Master with every operator, slave with every environment."""
    n, m = len(loop.operators), len(loop.environments)
    both = [
        _sides(loop, loop.operators[min(k, n - 1)], loop.environments[min(k, m - 1)], period)
        for k in range(max(n, m))
    ]
    return [x[0] for x in both[:n]], [x[1] for x in both[:m]]


def _radius(master: _Side, slave: _Side, slowest: float) -> float:
    """Largest eigenvalue of both arms together without delay, of modes from `slowest` on."""
    there, back = np.outer(slave.b, master.c), np.outer(master.b, slave.c)
    whole = np.block([[master.a, back], [there, slave.a]])
    values = np.linalg.eigvals(whole)
    return float(np.abs(values[np.abs(np.angle(values)) >= slowest]).max(initial=0.0))


def _first_crossing(around: ComplexArray, slowest: float) -> float:
    """Delay [periods] at which the first root of 1 = L z^-d reaches the unit circle."""
    size = np.log(np.maximum(np.abs(around), 1e-300))
    at = np.flatnonzero((size[:-1] * size[1:] < 0.0) & (_ANGLES[:-1] >= slowest))
    if not at.size:
        return float("inf")
    share = size[at] / (size[at] - size[at + 1])
    turn = np.angle(around[at + 1] / around[at])
    angle = _ANGLES[at] * (_ANGLES[at + 1] / _ANGLES[at]) ** share
    phase = np.angle(around[at]) + share * turn
    return float(np.min(np.mod(phase, 2 * np.pi) / angle))


@lru_cache(maxsize=64)
def axis_margins(loop: SampledLoop, period: float) -> Margins:
    """Margins of one axis.

    Parameters
    ----------
    loop : SampledLoop
        The axis with its set.
    period : float
        Of the loop [s].
    """
    found = list(_members(loop, period))
    least = min(found, key=lambda m: (m.delay_s, -m.radius))
    now = replace(loop.real, forward_s=0.0, backward_s=0.0)
    pole = max(
        float(hybrid.poles(loop.design, zh, ze, now).real.max(initial=-np.inf))
        for zh in loop.operators
        for ze in loop.environments
    )
    radius = max(m.radius for m in found)
    return Margins(loop.axis, pole, radius, least.delay_s, least.text)


def refuse(loops: Iterable[SampledLoop], period: float) -> None:
    """Refuse a controller that must not run.

    Parameters
    ----------
    loops : iterable of SampledLoop
        Its axes; axes that are equal but for their name are checked once.
    period : float
        Of the loop [s].

    Raises
    ------
    ConfigError
        Naming axis, condition and margin.
    """
    seen = set()
    for loop in loops:
        same = replace(loop, axis="")
        if same not in seen:
            seen.add(same)
            _proper(loop)
            said = _refusal(same, period)
            if said:
                raise ConfigError(f"axis {loop.axis or '-'}, {said}")


def passes(loop: SampledLoop, period: float) -> bool:
    """Whether one axis may run."""
    try:
        _proper(loop)
    except ConfigError:
        return False
    return _unfit(replace(loop, axis=""), period) is None


@lru_cache(maxsize=64)
def _unfit(loop: SampledLoop, period: float) -> _Member | None:
    """The first member of the set that is unstable, else the one that bears too short a delay."""
    least: _Member | None = None
    for member in _members(loop, period):
        if member.unstable:
            return member
        least = member if least is None or member.delay_s < least.delay_s else least
    total = _round_trip(loop, period)
    return least if least and total > min(least.delay_s, _LONGEST) else None


def _round_trip(loop: SampledLoop, period: float) -> float:
    """Delay to and fro [s]; the loop has whole ticks."""
    real = loop.real.held(period)
    return real.forward_s + real.backward_s


@lru_cache(maxsize=64)
def _refusal(loop: SampledLoop, period: float) -> str:
    """Why the loop must not run; empty where it may."""
    least = _unfit(loop, period)
    if least is None:
        return ""
    if least.unstable:
        here = loop.within() if least.within else loop
        return f"{least.text}: {_why(here, least, period)}"
    total = _round_trip(loop, period)
    return (
        f"{least.text}: the round-trip delay of {1e3 * total:.3g} ms is beyond the margin of "
        f"{1e3 * least.delay_s:.3g} ms; shorten the delay, lower c2, c4 and the stiffness, or take "
        "a law that bears any delay: 'hil design RIG.toml --design passivity', waves, tanks, model"
    )


def _why(loop: SampledLoop, member: _Member, period: float) -> str:
    now = replace(loop.real, forward_s=0.0, backward_s=0.0)
    pole = hybrid.poles(loop.design, member.zh, member.ze, now).real.max(initial=-np.inf)
    if pole > 1e-6:
        return (
            f"the loop is unstable, a pole at +{pole:.3g} rad/s (it must be negative); "
            "run 'hil design RIG.toml' for the margins"
        )
    here = replace(loop, real=now, tip=member.tip)
    size, hz = max(
        dominant_mode(one, member.zh, member.ze, period) for one in (here, _sliding(here))
    )
    return (
        f"this pair is stable on paper, with its rightmost pole at {pole:.3g} rad/s, "
        f"but not when sampled every {1e3 * period:.3g} ms with these "
        f"filters: a mode of {hz:.3g} Hz grows by {np.log(size) / period:.3g} /s (eigenvalue "
        f"{size:.5f}, at most 1); {_advice(here, member, hz, period)}"
    )


def _holds(loop: SampledLoop, member: _Member, period: float) -> bool:
    """Whether the loop is stable with the member's operator and environment, without delay."""
    return dominant_mode(loop, member.zh, member.ze, period)[0] <= 1.0 + GROWTH


def _advice(loop: SampledLoop, member: _Member, hz: float, period: float) -> str:
    """What to change: first of all a part without which this member is stable."""
    quiet = replace(loop, disturbance=0.0)
    plain = replace(loop, compensated=(0.0, 0.0))
    pulls = -min(loop.compensated)
    if loop.disturbance and _holds(quiet, member, period):
        return "lower observer_hz or disturbance"
    if pulls > 0.0 and _holds(plain, member, period):
        return (
            f"its compensation of friction brakes by {pulls:.3g} N s/m at the tip, as the friction "
            "of leader_effects, leader_friction or the follower's is negative: check the signs"
        )
    if any(getattr(loop.design, c).a for c in MOTION):
        return (
            "lower acceleration_hz, or go further from the estimation singularity (smaller c2 c3)"
        )
    if loop.cable and hz > _CABLE_HZ:
        return "it is the cable between motor and tip: lower the damping of c7 and c8"
    if max(loop.compensated) > 0.0:
        return "lower friction_share, the gains, or raise velocity_hz and force_hz"
    return "lower the gains, or raise velocity_hz and force_hz"


def _proper(loop: SampledLoop) -> None:
    """Refuse gains that cannot be realised or cannot hold a slave.

    Raises
    ------
    ConfigError
        Naming the gain.
    """
    d, where = loop.design, f"axis {loop.axis or '-'}"
    for name in MOTION:
        term = getattr(d, name)
        if not np.isfinite([term.k, term.b, term.a]).all():
            raise ConfigError(f"{where}: {name} has a gain that is not a finite number")
        if term.a and loop.real.acceleration_hz == 0.0:
            raise ConfigError(
                f"{where}: {name} has an acceleration term ({term.a:.3g} kg) without a filter, an "
                "improper gain; set acceleration_hz (30, say)"
            )
    for name in ("c2", "c3", "c5", "c6"):
        value = getattr(d, name)
        if not np.isfinite(value) or (name in ("c5", "c6") and value < -1.0):
            raise ConfigError(f"{where}: {name} = {value:.4g} is improper; c5, c6 >= -1 is needed")
    if d.c7.k < 0.0 or d.c7.b < 0.0:
        raise ConfigError(
            f"{where}: c7 = ({d.c7.k:.4g}, {d.c7.b:.4g}) pushes the follower away from its place; "
            "its stiffness and damping must not be negative"
        )


def operators_up_to(operator: Impedance, free: Impedance) -> Iterator[Impedance]:
    """Operators up to a firm one: as declared, held loosely, and what lies between and beyond."""
    yield operator
    yield free
    for mass, firm in product((0.0, operator.m), _FIRMNESS):
        if mass == 0.0 or firm != 1.0:
            yield Impedance(mass, max(operator.b * firm, free.b), operator.k * firm)


#: Operators relative to the declared one: a light grip, a machine, a firm grip.
_FIRMNESS = (0.3, 1.0, 2.7)


def surroundings(environment: Impedance) -> Iterator[Impedance]:
    """Environments up to the declared one: free, as declared, softer, and a fifth less damped."""
    yield hybrid.FREE_MOTION
    yield environment
    for share in _SOFTNESS:
        yield Impedance(share * environment.m, 0.8 * share * environment.b, share * environment.k)


#: Environments relative to the declared one.
_SOFTNESS = (0.25, 0.6, 1.0)


def _pair_text(zh: Impedance, ze: Impedance) -> str:
    def one(z: Impedance) -> str:
        return f"{z.m:g} kg, {z.b:g} N s/m, {z.k:g} N/m"

    return f"operator ({one(zh)}), environment ({one(ze)})"


# ------------------------------------------------------------ a law of two whole arms

#: Hands at the leader's tip: stiffness and damping of place [N/m], [N s/m] and of turning
#: [N m/rad], [N m s/rad].  A hand holds a stylus by 320 N/m; light and firm as of an axis.
HANDS = {
    "let go": (0.0, 0.0, 0.0, 0.0),
    "a light hand": (100.0, 2.0, 1.0, 0.02),
    "a hand": (320.0, 7.0, 3.5, 0.06),
    "a firm hand": (860.0, 19.0, 9.5, 0.16),
}
#: What the follower meets: stiffness at its tip and across its shaft in the incision [N/m].
CONTACTS = {
    "nothing": (0.0, 0.0),
    "tissue of 500 N/m": (500.0, 500.0),
    "a wall of 3000 N/m": (3000.0, 500.0),
}
#: Masses of the arms relative to their URDFs with the rotors of the rig file.
_MASSES = (0.75, 1.0)
#: Postures beside the middle, and the share of the joints' ranges that they are taken from.
_POSTURES, _REACH = 11, 0.6
#: Delay between measurement and effort that the loop has, the longest that is tried, and what it
#: grows by [ticks].
USUAL_DELAY_TICKS, LONGEST_DELAY_TICKS, _MORE = 1.0, 6.0, 0.25
#: Growth [1/s] that the friction of any arm ends: free positions are double modes of 0, and weight
#: that is compensated late makes them grow slowly.
DRIFT = 0.2
#: Below, a mode is slow enough to be such a drift [Hz].
_SLOW_HZ = 0.5
_STEP = 1e-6


@dataclass(frozen=True)
class CoupledMargin:
    """How a law of two arms stands over its set.

    Parameters
    ----------
    radius, hz : float
        Largest eigenvalue of a period without further delay, and its frequency.
    where : str
        The member of the set with it.
    delay_s : float
        Further delay that all of the set bears [s]; negative: it is unstable without.
    limit : str
        The member that bears no more; empty where more was not tried.
    members : int
        In the set.
    """

    radius: float
    hz: float
    where: str
    delay_s: float
    limit: str
    members: int


def coupled(
    law: Controller,
    arms: Sequence[ArmDescription],
    rotors: Sequence[FloatArray],
    period: float,
    behind: float = 0.0,
    latest: float = LONGEST_DELAY_TICKS,
    drifts: bool = False,
) -> CoupledMargin:
    """Judge a law of two arms that are described by URDFs.

    Parameters
    ----------
    law : Controller
        Without friction that is fed forward.
    arms : sequence of 2 ArmDescription
        Leader and follower.
    rotors : sequence of 2 ndarray (d,)
        Inertia of their rotors at the joints [kg m^2].
    period : float
        Of the loop [s].
    behind : float
        Where a wall is around the follower's shaft, from its tip on [m]; 0: none.
    latest : float
        Longest delay that is tried [ticks]; `USUAL_DELAY_TICKS`: only the one that the loop has.
    drifts : bool
        Whether growth by weight that is compensated late is left out; see above.
    """
    robots = [bare_robot(RobotSource("", arm.urdf), arm.joints) for arm in arms]
    members = []
    for posture, q in _postures(arms):
        near = _Near(law, q)
        for share in _MASSES:
            hands = [
                _Arm(robots[0], q[0], share, rotors[0], period, hand) for hand in HANDS.values()
            ]
            contacts = [
                _Arm(robots[1], q[1], share, rotors[1], period, (k, 0.0, 0.0, 0.0), behind, wall)
                for k, wall in CONTACTS.values()
            ]
            for (hand, one), (contact, other) in product(
                zip(HANDS, hands, strict=True), zip(CONTACTS, contacts, strict=True)
            ):
                where = f"{posture}, {100 * share:.0f} % of the masses, {hand}, {contact}"
                members.append((where, near, one, other))
    most = 1.0 + DRIFT * period
    radius, hz, where = _worst(members, USUAL_DELAY_TICKS, period, drifts)
    if radius > most:
        return CoupledMargin(radius, hz, where, -1.0, where, len(members))
    late = USUAL_DELAY_TICKS
    while late < latest:
        more, _, limit = _worst(members, late + _MORE, period, drifts)
        if more > most:
            return CoupledMargin(
                radius, hz, where, (late - USUAL_DELAY_TICKS) * period, limit, len(members)
            )
        late += _MORE
    return CoupledMargin(radius, hz, where, (late - USUAL_DELAY_TICKS) * period, "", len(members))


#: What to lower of a law that couples two arms at the tips, and of one that does at the joints.
TIPS, JOINTS = "the stiffnesses and dampings", "bandwidth_hz, or give the rotors (armature)"


def refuse_coupled(found: CoupledMargin, period: float, gains: str = TIPS) -> None:
    """Refuse a law of two whole arms that must not run.

    Parameters
    ----------
    found : CoupledMargin
        What `coupled` says of it.
    period : float
        Of the loop [s].
    gains : str
        What to lower.

    Raises
    ------
    ConfigError
        Naming the member of the set, the mode and what to change.
    """
    if found.delay_s < 0.0:
        growth = np.log(found.radius) / period
        raise ConfigError(
            f"the law is unstable: with {found.where}, a mode of {found.hz:.3g} Hz grows by "
            f"{growth:.3g} /s; lower {gains}, or velocity_filter, or raise rate_hz; "
            "'hil design RIG.toml' judges it again"
        )


def _worst(
    members: Sequence[tuple[str, _Near, _Arm, _Arm]], late: float, period: float, drifts: bool
) -> tuple[float, float, str]:
    """Largest eigenvalue of the set with a delay of `late` ticks, its frequency [Hz], and where."""
    best = (0.0, 0.0, "")
    for where, near, one, other in members:
        values = np.linalg.eigvals(near.closed(one, other, late))
        size, hz = np.abs(values), np.abs(np.angle(values)) / (2.0 * np.pi * period)
        if drifts:  # held between ticks, an effort is half a tick later yet
            fall = max(one.falls, other.falls) * (late + 0.5) * period
            size = np.where(hz < _SLOW_HZ, size * np.exp(-fall * period), size)
        k = int(np.argmax(size))
        if size[k] > best[0]:
            best = (float(size[k]), float(hz[k]), where)
    return best


def _postures(arms: Sequence[ArmDescription]) -> Iterator[tuple[str, list[FloatArray]]]:
    """Both arms in their middle, then each anywhere in a part of its ranges, the same each time."""
    d = arms[0].d
    yield "both arms in the middle", [np.array(arm.center) for arm in arms]
    shares = qmc.Halton(2 * d, seed=1).random(_POSTURES)
    for n, row in enumerate(shares):
        q = []
        for arm, x in zip(arms, row.reshape(2, d), strict=True):
            low, high, middle = map(np.array, (arm.low, arm.high, arm.center))
            q.append(middle + _REACH * np.where(x > 0.5, high - middle, middle - low) * (2 * x - 1))
        yield f"posture {n + 1}", q


class _Near:
    """A law in small motions about a posture that it starts from: what of its state moves."""

    def __init__(self, law: Controller, q: Sequence[FloatArray]) -> None:
        d, n = q[0].size, len(law.state_names)
        u, y = np.zeros((2, 3 * d)), np.zeros((2, d))
        u[:, :d] = q
        x0, rest = np.zeros(n), np.zeros(n)
        for _ in range(2):
            law.update(0.0, rest, u, x0, y)
            rest = x0.copy()
        slopes = []
        for k in range(4 * d + n):
            ends = []
            for side in (_STEP, -_STEP):
                u_near, x_near, x_next, out = u.copy(), rest.copy(), np.zeros(n), np.zeros((2, d))
                if k < 4 * d:
                    u_near[k // (2 * d), k % (2 * d)] += side
                else:
                    x_near[k - 4 * d] += side
                law.update(0.0, x_near, u_near, x_next, out)
                ends.append(np.concatenate([x_next, out.ravel()]))
            slopes.append((ends[0] - ends[1]) / (2.0 * _STEP))
        whole = np.array(slopes).T
        # a state counts that the arms move and that the efforts follow
        moves = np.any(whole[:n, : 4 * d], axis=1) & np.any(whole[n:, 4 * d :], axis=0)
        own = 4 * d + np.flatnonzero(moves)
        self.a, self.b = whole[:n][np.ix_(moves, own)], whole[:n][moves, : 4 * d]
        self.c, self.d = whole[n:, own], whole[n:, : 4 * d]

    def closed(self, leader: _Arm, follower: _Arm, late: float) -> FloatArray:
        """Arms, law and a delay of `late` ticks, one period on."""
        whole, part = divmod(late, 1.0)
        arms = [arm.period_on(part) for arm in (leader, follower)]
        p, m, e = 2 * arms[0][0].shape[0], self.a.shape[0], self.c.shape[0]
        law, first, half = slice(p, p + m), p + m, p // 2
        slots = int(whole) + (part > 0.0)
        out = np.zeros((first + slots * e, first + slots * e))
        out[law, :p], out[law, law] = self.b, self.a
        for k, (a, new, old) in enumerate(arms):
            rows, own = slice(k * half, (k + 1) * half), slice(k * e // 2, (k + 1) * e // 2)
            out[rows, rows] = a
            for age, b in ((int(whole), new), (int(whole) + 1, old)):
                if age == 0:
                    out[rows, :p] += b @ self.d[own]
                    out[rows, law] += b @ self.c[own]
                elif age <= slots:
                    at = first + (age - 1) * e + k * e // 2
                    out[rows, at : at + e // 2] += b
        if slots:
            out[first : first + e, :p], out[first : first + e, law] = self.d, self.c
            out[first + e :, first:-e] = np.eye((slots - 1) * e)
        return out


class _Arm:
    """An arm with what touches it, at rest.

    Parameters
    ----------
    robot, q, share, rotors : Robot, ndarray (d,), float, ndarray (d,)
        Its bodies, posture, part of the masses, and inertia of its rotors.
    period : float
        Of the loop [s].
    touch : tuple of 4 floats
        As in `HANDS`, at its tip.
    behind, wall : float
        Where a wall is around its shaft, from the tip on [m], and its stiffness [N/m].
    """

    def __init__(
        self,
        robot: Robot,
        q: FloatArray,
        share: float,
        rotors: FloatArray,
        period: float,
        touch: tuple[float, float, float, float],
        behind: float = 0.0,
        wall: float = 0.0,
    ) -> None:
        d, pi = q.size, robot.prior[None]
        mass = robot.balance(q[None], np.zeros((1, d)), pi)[1][0] + np.diag(rotors)
        stiff, damp = np.zeros((d, d)), np.zeros((d, d))
        for k in range(d):
            near = np.stack([q, q])
            near[:, k] += (_STEP, -_STEP)
            sides = robot.balance(near, np.zeros((2, d)), np.tile(pi, (2, 1)))[0]
            stiff[:, k] = (sides[0] - sides[1]) / (2.0 * _STEP)
        # of the weight alone [1/s^2]: the quickest fall from this posture
        self.falls = max(
            0.0, float(np.linalg.eigvals(-np.linalg.solve(share * mass, stiff)).real.max())
        )
        jac = robot.external(np.tile(q, (6, 1)), np.eye(6))
        rows = [(jac[:3], *touch[:2]), (jac[3:], *touch[2:])]
        axes = robot.tip_axes(q[None])
        if behind and axes is not None:
            lever = np.cross(jac[3:], -behind * axes[0, :, 2], axis=0)
            rows.append((axes[0, :, :2].T @ (jac[:3] + lever), wall, 0.0))
        for j, spring, damper in rows:
            stiff += spring * j.T @ j
            damp += damper * j.T @ j
        self._period, self._free = period, np.zeros((3 * d, 3 * d))
        self._free[:d, d : 2 * d] = np.eye(d)
        self._free[d : 2 * d] = np.linalg.solve(share * mass, np.hstack([-stiff, -damp, np.eye(d)]))
        self._known: dict[float, tuple[FloatArray, FloatArray, FloatArray]] = {}

    def period_on(self, part: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions and speeds a period on, by themselves, by the effort, and by the one before.

        The effort before acts for that part of the period yet.
        """
        if part not in self._known:
            n = 2 * self._free.shape[0] // 3
            before, after = (expm(x * self._period * self._free) for x in (part, 1.0 - part))
            old = after[:n, :n] @ before[:n, n:]
            self._known[part] = (after[:n, :n] @ before[:n, :n], after[:n, n:], old)
        return self._known[part]
