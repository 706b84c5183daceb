"""A question about rival effects, how well a motion answers it, and where that is played.

What a planned motion would record is an identification problem without a measurement.

A question says what is refitted, what is suspected, and how loud the noise is.  A motion separates
rivals by what the one does and the other cannot imitate.

With base columns X, rival columns C_b and the signal s = C_a theta_a (all divided by the noise),
the noncentrality of a against b is

    lambda = min over the shapes of b of  |s - P s|^2,  P the projector on [X, C_b];

largest lambda = T-optimal (Atkinson and Fedorov, Biometrika 62, 1975).  Only Gram matrices are
needed, so runs simply add up.  No equation is exactly the truth, so lambda counts against
1 + 1 % of the signal's own power, as in the attribution of `hil.diagnosis`; and where nothing has
been recorded yet, against the share of the noise that an effect must exceed to be noticed.

A stage says where a motion is to be played, and makes it fit there: how far each joint may go
from the middle posture, alone and together with the others.  A motion that follows on a recording
is played within the robot's limits, else within its own.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.excite.trajectory import (
    HEADROOM,
    Limits,
    Margin,
    Trajectory,
    allowed,
    exceeds,
    motion_margins,
    of_data,
    of_robot,
    period_times,
    sample,
    torques,
)
from hil.identify import bands
from hil.identify.bands import Rates
from hil.identify.context import drives, update_load
from hil.identify.design import Term, bind, coefficients, stack
from hil.identify.problem import Problem
from hil.identify.solve import prior, slices_of
from hil.models.effect import Effect, Trait
from hil.models.model import RobotModel
from hil.models.robots import Robot
from hil.record.recording import BAG, Recording, RobotSource

FloatArray = NDArray[np.float64]
#: Samples per cut-off of the position filter.
OVERSAMPLING = 3.0
#: Filter band where no recording sets one [Hz].
DEFAULT_BAND = Rates(60.0, 20.0)
#: Friction of a joint of which nothing is known, as a share of its torque limit.
FRICTION = 0.015
#: Share of the way to a position limit that is used.
LIMIT_USE = 0.95
#: Speed of a joint whose limit nobody knows: its range in two seconds.
CROSSING = 2.0


def problem_of(x: Trajectory, source: RobotSource, rates: Rates, quantum: FloatArray) -> Problem:
    """Problem of one period of a motion, without efforts.

    `quantum` (d,) [rad or m] is what the encoders resolve: what is slower than that stands.  The
    motion itself is not rounded: steps of coarse encoders are accelerations that no motor has.
    """
    t = period_times(x, OVERSAMPLING * rates.position)
    exact = sample(x, t)[0]
    q = np.round(exact / quantum) * quantum
    nothing = np.zeros_like(q)
    run = Recording(x.name, "arm", x.joints, t, q, nothing, robot=source)
    problem = Problem([run], source, rates=rates)
    (m,) = problem.motions
    lost = bands.derivatives(exact - q, run.rate, rates.position)
    e, de, dde = (bands.every(z, m.dt * run.rate)[: m.n] for z in lost)
    problem.motions = [m.with_(q=m.q + e, qd=m.qd + de, qdd=m.qdd + dde)]
    return problem


def complete_foreseen(problem: Problem, terms: Sequence[Term], theta: FloatArray) -> None:
    """Give a foreseen problem the loads and efforts that a model predicts.

    tau = sum of all terms' columns times their coefficients, before the filter.
    """
    listed = list(terms)
    slices = slices_of(problem, listed)
    update_load(problem, listed, theta, slices)
    total = [np.zeros_like(m.q) for m in problem.motions]
    for t, where in zip(listed, slices, strict=True):
        at = slice(None) if t.effect.scope.whole else t.joint
        for tau, columns in zip(total, problem.raw(t.effect, t.joint, t.shape), strict=True):
            tau[:, at] += columns @ theta[where]
    pairs = zip(problem.motions, total, strict=True)
    problem.motions = [m.with_(tau=tau) for m, tau in pairs]


def nominal(model: RobotModel, problem: Problem, limits: Limits) -> tuple[list[Term], FloatArray]:
    """Terms of a model and what is known of their coefficients.

    The model's values, else the robot's own; a joint without friction values gets Coulomb
    friction of 1.5 % of its torque limit and as much viscous friction at its top speed.
    """
    terms = []
    for t in bind(model, problem):
        shape = t.shape or t.effect.search.grid(problem.motions[0], t.joint)[0]
        terms.append(t.reshaped(shape))
    names = [n for t in terms for n, _ in coefficients(t, problem)]
    theta = prior(problem, terms, model, names)
    for t, where in zip(terms, slices_of(problem, terms), strict=True):
        torque, speed = float(limits.torque[t.joint]), float(limits.speed[t.joint])
        if t.effect.traits & (Trait.DRY | Trait.VISCOUS) and not np.any(theta[where]):
            dry = FRICTION * torque if np.isfinite(torque) else 0.0
            theta[where] = dry if Trait.DRY in t.effect.traits else dry / max(speed, 1e-9)
    return terms, theta


def efforts(problem: Problem) -> FloatArray:
    """Foreseen efforts before the filter, all runs, shape (n, d) [N m or N]."""
    return np.concatenate([m.tau for m in problem.motions])


#: Share of a signal's power by which functional forms miss the truth.
FORM = 0.01
#: Log odds at which a rival has less than 5 % left.
DECIDED = float(np.log(19.0))
#: Sign resolution of a question, in units of what the recording resolves.
SHARP = 0.02


@dataclass(frozen=True)
class Rival:
    """One effect under suspicion.

    Parameters
    ----------
    term : Term
        With its shape as fitted, or one of its grid.
    theta : ndarray (m,)
        Its coefficients [SI].
    shapes : tuple of tuple of float
        Shapes with which it may imitate another effect.
    """

    term: Term
    theta: FloatArray
    shapes: tuple[tuple[float, ...], ...] = ((),)

    @property
    def name(self) -> str:
        """Effect's name."""
        return self.term.effect.name


@dataclass(frozen=True)
class Question:
    """Base terms with their values, rivals, and the noise.

    Parameters
    ----------
    base : list of Term
        What is refitted together with any rival.
    theta : ndarray (p,)
        Its coefficients.
    rivals : list of Rival
        One (against the base alone) or more.
    noise : ndarray (d,)
        Noise that one instant carries, coloured noise counted up [N m or N].
    v0, contact, span : ndarray (d,), (d, 2), (d, 2)
        Sign resolution, surface, and the range of positions that all columns refer to.
    floor : float
        Power, in units of the noise that one instant carries, that an effect must show before
        it counts; 0 where it is known already that it does.
    """

    base: list[Term]
    theta: FloatArray
    rivals: list[Rival]
    noise: FloatArray
    v0: FloatArray
    contact: FloatArray
    span: FloatArray
    floor: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """What one set of runs says of a pair.

    Parameters
    ----------
    odds : float
        Log odds with which the better of the two would win.
    share : float
        Share of the signal's power that the other one cannot imitate (0 to 1).
    fresh : float
        The same for its columns with any coefficients: the largest share there is.
    """

    odds: float
    share: float
    fresh: float = 0.0

    @property
    def decided(self) -> bool:
        """Whether the rival would be out."""
        return self.odds >= DECIDED

    @property
    def possible(self) -> bool:
        """Whether the rival would be out if the effect were large enough."""
        return max(self.share, self.fresh) / (2 * FORM) >= DECIDED


def sharp(base: Sequence[Term], v0: FloatArray) -> tuple[list[Term], FloatArray]:
    """Base terms and sign resolution in the limit of dry friction.

    How the sign of a speed is smoothed near zero is a convention of the fit; it must not count
    as a difference between two effects.
    """
    tiny = SHARP * v0
    dry = (Trait.DRY in t.effect.traits for t in base)
    each = zip(base, dry, strict=True)
    terms = [t.reshaped((float(tiny[t.joint]), *t.shape[1:])) if dry else t for t, dry in each]
    return terms, tiny


def in_context(problem: Problem, v0: FloatArray, contact: FloatArray, span: FloatArray) -> Problem:
    """A copy of a problem in a question's context: sharp signs, known surface, common range."""
    out = copy.copy(problem)
    out.motions = [replace(m, average=0.0, span=span) for m in problem.motions]
    out.set_context(v0=v0, contact=contact)
    return out


def ready(problem: Problem, question: Question) -> Problem:
    """A foreseen problem with the question's context, loads and efforts."""
    out = in_context(problem, question.v0, question.contact, question.span)
    complete_foreseen(out, question.base, question.theta)
    return out


#: Share of an effect's power below which another one contains it.
CONTAINED = 1e-3
#: Largest number of shapes with which a rival may imitate.
MAX_SHAPES = 6


def gram(problem: Problem, question: Question) -> FloatArray:
    """Gram matrix of all columns, in the order base, then each rival's shapes; noise = 1.

    Rivals' own (fitted) shape comes first, then the shapes with which they may imitate.
    """
    terms = [*question.base]
    for r in question.rivals:
        terms += [r.term, *(r.term.reshaped(s) for s in r.shapes)]
    terms = [replace(t, per_run=False) for t in terms]
    x, _ = stack(problem, terms)
    w = np.repeat(1.0 / question.noise, problem.n)
    x = x * w[:, None]
    return x.T @ x


def _verdicts(g: FloatArray, question: Question) -> dict[tuple[str, str], Verdict]:
    """Verdict on every ordered pair of rivals; of a single one against the base alone."""
    where, base = _slots(question)
    out = {}
    for a, slots in zip(question.rivals, where, strict=True):
        power, _ = _left(g, base, slots[0], a.theta)
        others = [(b, s) for b, s in zip(question.rivals, where, strict=True) if b is not a]
        if not others:
            out[a.name, "base"] = _from_base(g, question, a)
        for b, other in others:
            tries = [_left(g, np.concatenate([base, s]), slots[0], a.theta) for s in other[1:]]
            least = min(left for left, _ in tries)
            fresh = min(float(np.linalg.eigvalsh(schur)[-1]) for _, schur in tries)
            out[a.name, b.name] = replace(_verdict(least, power, question.floor), fresh=fresh)
    return out


def _from_base(g: FloatArray, question: Question, a: Rival) -> Verdict:
    """Verdict on one rival against the base alone."""
    where, base = _slots(question)
    slots = next(s for r, s in zip(question.rivals, where, strict=True) if r is a)[0]
    power, _ = _left(g, base, slots, a.theta)
    whole = float(a.theta @ g[np.ix_(slots, slots)] @ a.theta)
    return _verdict(power, whole, question.floor)


def pair(found: dict[tuple[str, str], Verdict], a: Rival, b: Rival) -> Verdict:
    """Verdict on two rivals: the smaller of both directions, for either may be true.

    Where the one contains the other (a spring with its rest position, an offset), only the
    richer one's surplus can show, if not with these coefficients then with others; without
    surplus the price of its coefficients decides.
    """
    ab, ba = found[a.name, b.name], found[b.name, a.name]
    if a.theta.size != b.theta.size:
        poor, rich = (ab, ba) if a.theta.size < b.theta.size else (ba, ab)
        if poor.share < CONTAINED:
            return rich
    return replace(min(ab, ba, key=lambda v: v.odds), fresh=0.0)


def against(g: FloatArray, question: Question, names: tuple[str, ...]) -> dict[str, Verdict]:
    """Verdict on the first of some rivals against each other one; of a single one, the base."""
    found = _verdicts(g, question)
    rivals = {r.name: r for r in question.rivals}
    first, *others = names or tuple(rivals)
    if not others:
        return {"base": _from_base(g, question, rivals[first])}
    return {n: pair(found, rivals[first], rivals[n]) for n in others}


def _verdict(left: float, power: float, floor: float) -> Verdict:
    # log odds = lambda / 2 (1 + f power + floor)
    return Verdict(left / (2 * (1 + FORM * power + floor)), left / max(power, 1e-300))


def _slots(question: Question) -> tuple[list[list[NDArray[np.int_]]], NDArray[np.int_]]:
    """Column numbers: per rival its own and its imitating shapes; and those of the base."""
    start = question.theta.size
    out = []
    for r in question.rivals:
        m = r.theta.size
        own = [start + m * k + np.arange(m) for k in range(1 + len(r.shapes))]
        start += m * len(own)
        out.append(own)
    return out, np.arange(question.theta.size)


def _left(
    g: FloatArray, base: NDArray[np.int_], own: NDArray[np.int_], theta: FloatArray
) -> tuple[float, FloatArray]:
    """|s - P s|^2 of the signal s = C theta, and the Schur complement of its columns."""
    size = np.sqrt(np.maximum(np.diag(g), 1e-300))
    size[own[_nothing(size[own])]] = np.inf
    unit = g / np.outer(size, size)
    inner = unit[np.ix_(base, base)]
    value, vector = scipy.linalg.eigh(inner)
    keep = value > NULL * max(float(value[-1]), 1e-300)
    half = vector[:, keep] / np.sqrt(value[keep])
    cross = half.T @ unit[np.ix_(base, own)]
    schur = unit[np.ix_(own, own)] - cross.T @ cross
    scaled = theta * np.where(np.isfinite(size[own]), size[own], 0.0)
    left, whole = float(scaled @ schur @ scaled), float(np.sum(scaled**2))
    return left if left > NULL * whole else 0.0, schur


#: Share of a power below which it is rounding of the projection.
NULL = 1e-10
#: Share of the largest column of an effect below which one is rounding.
_ROUNDING = 1e-12


def _nothing(size: FloatArray) -> NDArray[np.bool_]:
    """Which columns of an effect, of these norms, are none but for rounding."""
    out: NDArray[np.bool_] = size <= max(_ROUNDING * float(size.max(initial=0.0)), 1e-150)
    return out


def unfelt(g: FloatArray, question: Question, names: tuple[str, ...]) -> tuple[str, ...]:
    """Coefficients of the first of some rivals, () of all, whose columns are nothing."""
    rivals = [r.name for r in question.rivals]
    k = rivals.index(names[0]) if names else 0
    own = _slots(question)[0][k][0]
    gone = _nothing(np.sqrt(np.maximum(np.diag(g)[own], 0.0)))
    params = question.rivals[k].term.effect.params
    return tuple(p.name for p, x in zip(params, gone, strict=False) if x)


def imitations(
    term: Term, problem: Problem, near: Sequence[tuple[float, ...]]
) -> tuple[tuple[float, ...], ...]:
    """Shapes with which an effect may imitate another: its own, `near`, and its grid thinned."""
    grid = term.effect.search.grid(problem.motions[0], term.joint) or [term.shape]
    step = max(1, len(grid) // MAX_SHAPES)
    return tuple(dict.fromkeys([term.shape, *near, *grid[step // 2 :: step]]))


@dataclass(frozen=True)
class Space:
    """Room for motions around a posture.

    Parameters
    ----------
    robot : Robot
        Joints and geometry.
    limits : Limits
        The limits.
    center : ndarray (d,)
        Middle posture [rad or m].
    alone : ndarray (d, 2)
        Range of each joint while the others stay in the middle.
    together : ndarray (d, 2)
        Range of each joint in which all of them may move at once.
    speed : ndarray (d,)
        Largest planned speed [rad/s or m/s].
    """

    robot: Robot
    limits: Limits
    center: FloatArray
    alone: FloatArray
    together: FloatArray
    speed: FloatArray


def joint_space_room(limits: Limits, robot: Robot) -> Space:
    """Measure the room around the middle posture of the limits.

    Raises
    ------
    ConfigError
        If that posture itself is outside.
    """
    center = limits.center
    if not allowed(limits, robot, center[None])[0]:
        raise ConfigError(
            f"the middle posture {np.round(center, 3).tolist()} is outside the limits of "
            f"{limits.source}; give the rig file another center or wider limits"
        )
    d = center.size
    alone = np.array([_along(limits, robot, j) for j in range(d)])
    reach = alone - center[:, None]
    together = center[:, None] + _common(limits, robot, reach) * reach
    width = np.ptp(alone, axis=1)
    speed = HEADROOM * np.where(np.isfinite(limits.speed), limits.speed, width / CROSSING)
    return Space(robot, limits, center, alone, together, speed)


def _along(limits: Limits, robot: Robot, j: int) -> tuple[float, float]:
    """Positions that joint j reaches either way before a limit, less a margin."""
    ends = []
    for end in (limits.low[j], limits.high[j]):
        steps = np.linspace(0.0, 1.0, 200)
        q = np.tile(limits.center, (steps.size, 1))
        q[:, j] += steps * (end - limits.center[j])
        ok = allowed(limits, robot, q)
        far = steps[-1] if ok.all() else steps[int(np.argmin(ok)) - 1]
        ends.append(float(limits.center[j] + LIMIT_USE * far * (end - limits.center[j])))
    return ends[0], ends[1]


def _common(limits: Limits, robot: Robot, reach: FloatArray) -> float:
    """Largest factor by which all ranges may be used at once: corners and points between."""
    rng = np.random.default_rng(0)
    sides = rng.integers(0, 2, (256, reach.shape[0]))
    inner = rng.uniform(0.0, 1.0, (256, reach.shape[0]))
    inner[:64] = 1.0
    corners = np.take_along_axis(reach[None], sides[:, :, None], axis=2)[..., 0] * inner
    for factor in np.linspace(1.0, 0.05, 39):
        if np.all(allowed(limits, robot, limits.center + factor * corners)):
            return float(factor)
    return 0.05


@dataclass(frozen=True)
class Stage:
    """Where a motion is to be played.

    Parameters
    ----------
    space : Space
        Room and limits.
    source : RobotSource
        The robot.
    rates : Rates
        Filter band.
    quantum : ndarray (d,)
        Resolution of the encoders [rad or m].
    seconds : float
        Length of each motion [s].
    """

    space: Space
    source: RobotSource
    rates: Rates
    quantum: FloatArray
    seconds: float = 30.0

    def foresee(self, motion: Trajectory) -> Problem:
        """What a motion would record, but for the efforts."""
        return problem_of(motion, self.source, self.rates, self.quantum)


#: A motion made small enough, what it would record, and its margins.
Foreseen = tuple[Trajectory, Problem, list[Margin]]


def within_limits(motion: Trajectory, stage: Stage, question: Question) -> Foreseen:
    """The motion made small enough for every limit, foreseen, with its margins.

    One that breaks a limit at every size comes back, too: see `playable`.

    Its efforts are foreseen where it keeps the other limits.  Where the largest such size breaks a
    torque limit and the smallest does not, the size between is found by bisection.  Where the
    smallest breaks it, too, so does every size of a motion that passes the middle posture; of
    another one all are foreseen, as its postures of rest change with its size.
    """
    limits, robot = stage.space.limits, stage.space.robot
    sizes = [motion]
    for _ in range(SIZES):
        sizes.append(sizes[-1].shrunk(SMALLER, limits.center))

    def foreseen_at(k: int, free: list[Margin]) -> Foreseen:
        problem = ready(stage.foresee(sizes[k]), question)
        found = free + torques(limits, robot, efforts(problem))
        # one that is too large at any size is played smaller still
        return sizes[k + any(exceeds(m) for m in found)], problem, found

    def unloaded(k: int) -> list[Margin]:
        return motion_margins(sizes[k], limits, robot)

    last = SIZES - 1
    first = next((k for k in range(last) if not any(map(exceeds, unloaded(k)))), last)
    largest = foreseen_at(first, unloaded(first))
    if first == last or largest[0] is sizes[first]:
        return largest
    smallest = foreseen_at(last, unloaded(last))
    if smallest[0] is not sizes[last]:
        if _passes_middle(motion, stage.space):
            return smallest
        others = (foreseen_at(k, unloaded(k)) for k in range(first + 1, last))
        return next((x for x in others if not any(map(exceeds, x[2]))), smallest)
    # sizes[broken] breaks a limit, sizes[kept] keeps all
    broken, kept, out = first, last, smallest
    while kept - broken > 1:
        k = (broken + kept) // 2
        found = foreseen_at(k, unloaded(k))
        if any(map(exceeds, found[2])):
            broken = k
        else:
            kept, out = k, found
    return out


#: Sizes of a motion that are tried, each by so much smaller than the one before.
SIZES, SMALLER = 30, 0.9
#: Share of the way from the middle posture to the ends of the ranges that is next to it.
NEAR_MIDDLE = 0.05


def _passes_middle(motion: Trajectory, space: Space) -> bool:
    """Whether a motion passes by the middle posture."""
    q = sample(motion, period_times(motion, MIDDLE_RATE))[0]
    reach = np.maximum(np.max(np.abs(space.alone - space.center[:, None]), axis=1), 1e-12)
    return bool(np.min(np.max(np.abs(q - space.center) / reach, axis=1)) < NEAR_MIDDLE)


#: Rate at which that is looked at [Hz].
MIDDLE_RATE = 100.0


def foreseen(
    motion: Trajectory, stage: Stage, model: RobotModel
) -> tuple[Trajectory, list[Margin]]:
    """A motion that no question is asked of, made small enough, with its margins.

    Raises
    ------
    ConfigError
        If it breaks a limit at every size.
    """
    problem = stage.foresee(motion)
    base, theta = nominal(model, problem, stage.space.limits)
    first = problem.motions[0]
    one = np.ones(len(motion.joints))
    asked = Question(base, theta, [], one, first.v0, first.contact, stage.space.alone)
    made = within_limits(motion, stage, asked)
    if not playable(made):
        raise refusal(made, stage, asked)
    return made[0], made[2]


def playable(made: Foreseen) -> bool:
    """Whether a motion keeps to every limit, and to its share of speed and torque."""
    return not any(map(exceeds, made[2]))


def refusal(made: Foreseen, stage: Stage, question: Question) -> ConfigError:
    """Why a motion is not to be played, and what would help."""
    motion, problem, found = made
    worst = max(filter(exceeds, found), key=lambda m: m.used / m.limit if m.limit else np.inf)
    limits = stage.space.limits
    unit, share = worst.unit, f"(a plan uses at most {100 * HEADROOM:g} %) "
    most = f"of {worst.limit:.3g} {unit} {share}" if worst.limit else ""
    text = (
        f"motion {motion.name!r} does not keep to the limits of {limits.source or 'the arm'} at "
        f"any size: {worst.what} would be {worst.used:.3g} {unit} {most}at the smallest; "
        "nothing was written. "
    )
    if not worst.what.startswith("torque "):
        return ConfigError(f"{text}Give wider limits, or another motion")
    joint = list(stage.space.robot.joints).index(worst.what.removeprefix("torque "))
    return ConfigError(text + _torque_help(joint, worst, problem, stage, question))


def _torque_help(
    joint: int, worst: Margin, problem: Problem, stage: Stage, question: Question
) -> str:
    """What takes the torque of a joint, and what would help."""
    space = stage.space
    most = HEADROOM * np.where(space.limits.torque > 0, space.limits.torque, 1e-12)
    postures = _postures(space)
    held = np.abs(at_rest(postures, problem, question))
    rest, share = float(held[0, joint]), np.max(held / most, axis=1)
    said = f"Gravity alone takes {rest:.3g} {worst.unit} of it in the middle posture"
    more = "a larger torque limit, if the drive has it, or a model with its true values (--model)"
    if rest <= most[joint]:
        return f"{said}, friction and what moves the rest. What helps: {more}"
    best = int(np.argmin(share))
    if share[best] >= 1.0:
        return f"{said}, and too much in every other one. What helps: a counterweight; {more}"
    place = ", ".join(
        f"{name} = {x:.3g}" for name, x in zip(space.robot.joints, postures[best], strict=True)
    )
    return (
        f"{said} of the range. What helps: a smaller range, or a center, about another posture "
        f"(at {place} it takes {held[best, joint]:.3g} {worst.unit}); {more}"
    )


#: Postures in which the weight is looked at.
POSTURES = 1000


def _postures(space: Space) -> FloatArray:
    """Middle posture, and others that the limits allow, (n, d)."""
    rng = np.random.default_rng(0)
    low, high = space.alone.T
    q = rng.uniform(low, high, (POSTURES, low.size))
    inside = allowed(space.limits, space.robot, q)
    return np.concatenate([space.center[None], q[inside]])


def at_rest(q: FloatArray, problem: Problem, question: Question) -> FloatArray:
    """Efforts that hold postures (n, d) still, as the question's base foresees them [N m or N]."""
    nothing = np.zeros_like(q)
    states = dict.fromkeys(("qd", "qdd", "tau", "tau_ext", "load", "static"), nothing)
    motion = problem.motions[0].with_(t=np.arange(len(q), dtype=np.float64), q=q, **states)
    terms = list(question.base)
    return drives(problem, terms, question.theta, slices_of(problem, terms), [motion])[0]


#: Length of a motion of the menu [s]: of a described robot, whose rigid body costs time, and else.
_DESCRIBED, _BARE = 12.0, 30.0


def stage_of(problem: Problem, seconds: float = 0.0) -> Stage:
    """Stage for the robot of some runs, with their filter band and encoders.

    A robot that brings no limits (independent axes) keeps to what was recorded: its range, twice
    its speed, twice its effort.  Of an axis that turned on and on it takes the middle part, as far
    as it gets in a quarter of the motion.

    Parameters
    ----------
    problem : Problem
        The runs.
    seconds : float
        Length of each motion [s]; 0 chooses.

    Raises
    ------
    ConfigError
        If there is no room to move in.
    """
    q, qd = problem.q.T, problem.qd.T
    own = of_robot(problem.source)
    limits: Limits = of_data(q, qd, problem.effort.T) if own is None else own
    first = problem.recordings[0].q
    noise = np.maximum(bands.quanta(first), bands.position_noise(first))
    quantum = np.maximum(noise, 1e-6 * (limits.high - limits.low))
    space = joint_space_room(limits, problem.robot)
    seconds = seconds or (_DESCRIBED if problem.source.urdf else _BARE)
    space = space if own is not None else _crossed(space, seconds * QUARTER)
    return Stage(space, problem.source, problem.rates, quantum, seconds)


#: Share of a motion in which a joint crosses its range, at least.
QUARTER = 0.25


def _crossed(space: Space, seconds: float) -> Space:
    """The space with ranges that each joint crosses in so many seconds, about its middle."""
    half = np.maximum(space.speed * seconds / 2, 1e-9)[:, None]
    low, high = space.center[:, None] - half, space.center[:, None] + half
    return replace(
        space,
        alone=np.clip(space.alone, low, high),
        together=np.clip(space.together, low, high),
    )


def room(problem: Problem) -> bool:
    """Whether there is a range of every joint to move in."""
    own = of_robot(problem.source)
    limits = of_data(problem.q.T, problem.qd.T, problem.effort.T) if own is None else own
    return limits.center.size == problem.d and not np.any(limits.high <= limits.low)


def robot_word(problem: Problem) -> str:
    """The word for a robot in a command of `hil excite`: the session, where that says enough.

    Of a preset it is the rig; of a robot that only the model describes, its URDF; of a bag without
    a description, the bag.
    """
    source, first = problem.source, problem.recordings[0]
    if BAG in first.metadata:
        return "ROBOT.urdf" if source.urdf else first.metadata[BAG]
    if source.urdf:
        return f"{first.name}.mcap" if first.robot.urdf == source.urdf else "ROBOT.urdf"
    return f"{first.name}.mcap" if source.preset in ("", "single-axis") else "RIG.toml"


def output_words(problem: Problem) -> list[str]:
    """Where `hil excite` writes; of a robot that `hil run` cannot move also a table."""
    own = robot_word(problem) != "RIG.toml"
    return ["-o", "next.toml", *(["--csv", "next.csv"] if own else [])]


def model_words(effects: Iterable[Effect]) -> list[str]:
    """What a command of `hil excite` needs besides, where an effect is a user's own."""
    own = any(not type(e).__module__.startswith("hil.models.") for e in effects)
    return ["--model", "M.toml"] if own else []
