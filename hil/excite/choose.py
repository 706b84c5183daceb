"""The menu of safe motions, the one that answers a question best, and whether any can.

A question is made from names of effects, with and without a recording.

Each motion of the menu isolates one factor: speed, direction, position, load, frequency, the other
joints' motion.  Paths are built from strokes at constant speed and rests.

Sources: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994 (strokes, reversals);
Swevers, Verdonck, De Schutter, IEEE Control Systems 27(5), 2007 (periodic excitation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.excite.question import Foreseen as Foreseen
from hil.excite.question import (
    Question,
    Rival,
    Space,
    Stage,
    Verdict,
    against,
    complete_foreseen,
    gram,
    imitations,
    nominal,
    playable,
    sharp,
    unfelt,
    within_limits,
)
from hil.excite.trajectory import Margin, Trajectory
from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.solve import slices_of
from hil.models import catalogue
from hil.models.model import BASE_EFFECTS, RobotModel

FloatArray = NDArray[np.float64]
#: Time to go from rest to the largest speed, and the shortest rounding of a corner [s].
_RISE, _SHORTEST = 0.2, 0.04
#: Shortest move, and shortest move between two sets of strokes [s].
QUICKEST, UNHURRIED = 0.05, 0.5
#: What separates effects that no motion of the menu does, nor all together.
NO_MOTION = "no motion within the limits of this robot"


class Path:
    """Via points with times, from the middle posture on.

    Parameters
    ----------
    space : Space
        Room and speeds.
    """

    def __init__(self, space: Space) -> None:
        self.space = space
        self.times: list[float] = [0.0]
        self.points: list[FloatArray] = [space.center.copy()]

    @property
    def time(self) -> float:
        """Length so far [s]."""
        return self.times[-1]

    def to(self, target: FloatArray, speed: float, least: float = QUICKEST) -> None:
        """Go straight to a posture; the joint that needs longest moves at `speed` of its most."""
        needed = np.abs(target - self.points[-1]) / (speed * self.space.speed)
        if np.any(needed > 1e-9):
            self._add(target, max(float(np.max(needed)), least))

    def rest(self, seconds: float) -> None:
        """Stay."""
        self._add(self.points[-1], max(seconds, QUICKEST))

    def _add(self, target: FloatArray, seconds: float) -> None:
        self.times.append(self.time + seconds)
        self.points.append(np.array(target, dtype=np.float64))

    def posture(self, places: dict[int, float]) -> FloatArray:
        """Middle posture with some joints elsewhere."""
        q = self.space.center.copy()
        for j, value in places.items():
            q[j] = value
        return q

    def strokes(self, ends: tuple[FloatArray, FloatArray], speed: float, seconds: float) -> None:
        """To and fro between two postures at constant speed for about `seconds`.

        Where the time is too short for the whole way, a shorter way about its middle.
        """
        a, b = ends
        whole = float(np.max(np.abs(b - a) / self.space.speed)) / speed
        share = min(1.0, seconds / 2 / max(whole, 1e-9))
        middle = (a + b) / 2
        low, high = middle + share * (a - middle), middle + share * (b - middle)
        self.to(low, max(speed, 0.3), UNHURRIED)
        for _ in range(max(1, round(seconds / 2 / max(share * whole, QUICKEST)))):
            self.to(high, speed)
            self.to(low, speed)

    def closed(self, name: str, seconds: float) -> Trajectory:
        """The path as a trajectory: back to its start, repeated to fill about `seconds`."""
        self.to(self.space.center, 0.3, UNHURRIED)
        self.rest(0.3)
        rounds = max(1, int(seconds / self.time))
        t, q = np.array(self.times), np.array(self.points)
        times = np.concatenate([[0.0], *(k * self.time + t[1:] for k in range(rounds))])
        via = np.concatenate([q[:1], *(q[1:] for _ in range(rounds))])
        robot = self.space.robot
        return Trajectory(
            tuple(robot.joints),
            tuple(robot.units),
            float(times[-1]),
            times,
            via,
            _blends(times, via, self.space.speed),
            np.zeros((len(robot.joints), 0, 2)),
            name,
        )


def _blends(times: FloatArray, via: FloatArray, speed: FloatArray) -> FloatArray:
    """Rounding of each corner: in proportion to its change of speed, never meeting the next."""
    gaps = np.diff(times)
    slope = np.diff(via, axis=0) / gaps[:, None]
    change = np.abs(np.diff(np.concatenate([slope[-1:], slope, slope[:1]]), axis=0))
    wanted = np.maximum(_RISE * np.max(change / speed, axis=1), _SHORTEST)
    room = np.minimum(np.concatenate([gaps[-1:], gaps]), np.concatenate([gaps, gaps[:1]]))
    out: FloatArray = np.minimum(wanted, room)
    return out


def series(
    space: Space, values: FloatArray, period: float, name: str, highest: float
) -> Trajectory:
    """Trajectory about the middle posture from samples (n, d) of one period, band-limited.

    Parameters
    ----------
    highest : float
        Highest frequency kept [Hz].
    """
    n, robot = len(values), space.robot
    spectrum = np.fft.rfft(values - values.mean(axis=0), axis=0) / (n / 2)
    h = max(1, min(int(highest * period), n // 2 - 1))
    part = spectrum[1 : h + 1].T
    via = np.stack([space.center, space.center])
    return Trajectory(
        tuple(robot.joints),
        tuple(robot.units),
        period,
        np.array([0.0, period]),
        via,
        np.full(2, min(1.0, period)),
        np.stack([-part.imag, part.real], axis=-1),
        name,
    )


def joints_of(space: Space, j: int | None) -> Sequence[int]:
    """The joint in question, or all."""
    return range(space.center.size) if j is None else [j]


def _ends(path: Path, j: int, together: bool = False) -> tuple[FloatArray, FloatArray]:
    low, high = (path.space.together if together else path.space.alone)[j]
    return path.posture({j: float(low)}), path.posture({j: float(high)})


def _at_speeds(
    space: Space, j: int | None, seconds: float, speeds: FloatArray, name: str
) -> Trajectory:
    path, joints = Path(space), joints_of(space, j)
    for i in joints:
        for v in speeds:
            path.strokes(_ends(path, i), float(v), seconds / len(speeds) / len(joints))
    return path.closed(name, seconds)


def slow_strokes(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Slow constant-speed strokes in both directions, log-spaced speeds."""
    return _at_speeds(space, j, seconds, np.geomspace(0.01, 0.15, 5), "slow-strokes")


def speed_ladder(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Constant-speed strokes in both directions from very slow to fast, log-spaced speeds."""
    return _at_speeds(space, j, seconds, np.geomspace(0.01, 1.0, 8), "speed-ladder")


def fast_strokes(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Fast strokes over the range in both directions at three speeds."""
    return _at_speeds(space, j, seconds, np.array([0.4, 0.7, 1.0]), "fast-strokes")


def range_strokes(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Slow strokes over the whole range in both directions at two speeds."""
    path, joints = Path(space), joints_of(space, j)
    share = seconds / len(joints)
    for i in joints:
        low, high = _ends(path, i)
        whole = float(high[i] - low[i]) / float(space.speed[i])
        for v in (3.0 * whole / share, 6.0 * whole / share):
            path.to(low, 0.3)
            path.to(high, min(v, 1.0))
            path.to(low, min(v, 1.0))
    return path.closed("range-strokes", seconds)


def small_reversals(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Small nested reversals in two places, slowly and quickly."""
    path = Path(space)
    for i in joints_of(space, j):
        low, high = space.alone[i]
        for place in (0.35, 0.65):
            middle = low + place * (high - low)
            for size in np.geomspace(0.04, 0.001, 4):
                half = size * (high - low) / 2
                for period, count in ((1.4, 1), (0.5, 2)):
                    v = float(min(4 * half / period / space.speed[i], 1.0))
                    for _ in range(count):
                        path.to(path.posture({i: middle + half}), v)
                        path.to(path.posture({i: middle - half}), v)
    return path.closed("small-reversals", seconds)


def rests(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Rests in many postures, slow moves between them."""
    path = Path(space)
    count = max(4, int(seconds / 2.2))
    # Kronecker sequence of the plastic number's powers: spread evenly without a grid
    step = np.array([0.7548776662, 0.5698402910, 0.3, 0.8191725134, 0.6710436067, 0.5497, 0.45])
    for k in range(count):
        x = np.mod(0.5 + (k + 1) * np.resize(step, space.center.size), 1.0)
        q = space.together[:, 0] + x * np.ptp(space.together, axis=1)
        path.to(q if j is None else path.posture({j: float(q[j])}), 0.3)
        path.rest(1.5)
    return path.closed("rests", seconds)


def one_at_a_time(space: Space, j: int | None, seconds: float) -> Trajectory:
    """One joint at a time while the others rest."""
    speeds = np.array([0.05, 0.3, 0.8])
    return _at_speeds(space, None, seconds, speeds, "one-at-a-time")


def pairs(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Pairs of joints with all combinations of signs, at two speeds."""
    path, d = Path(space), space.center.size
    couples = [(i, k) for i in joints_of(space, j) for k in range(d) if k != i]
    for i, k in couples:
        (a, b), (c, e) = space.together[i], space.together[k]
        for v in (0.15, 0.5):
            for one, two in (((a, c), (b, e)), ((a, e), (b, c))):
                ends = tuple(path.posture({i: float(p), k: float(q)}) for p, q in (one, two))
                path.strokes((ends[0], ends[1]), v, seconds / 4 / len(couples))
    return path.closed("pairs", seconds)


def postures(space: Space, j: int | None, seconds: float) -> Trajectory:
    """The same strokes in four postures of the other joints, so under several static loads."""
    path, joints = Path(space), joints_of(space, j)
    others = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    for i in joints:
        rest = [k for k in range(space.center.size) if k != i]
        for side in others:
            sides = np.resize(side, len(rest))
            where = {k: float(space.together[k, s]) for k, s in zip(rest, sides, strict=True)}
            low, high = space.together[i]
            ends = tuple(path.posture(where | {i: float(x)}) for x in (low, high))
            path.strokes((ends[0], ends[1]), 0.25, seconds / 4 / len(joints))
    return path.closed("postures", seconds)


def range_ends(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Strokes that reach both ends of the range, slowly and fast."""
    path = Path(space)
    for i in joints_of(space, j):
        low, high = space.alone[i]
        for end in (low, high):
            near = path.posture({i: float(0.6 * end + 0.4 * space.center[i])})
            for v in (0.05, 0.2, 0.7):
                path.to(near, 0.3, 0.5)
                path.to(path.posture({i: float(end)}), v)
                path.to(near, v)
    return path.closed("range-ends", seconds)


def chirp(space: Space, j: int | None, seconds: float) -> Trajectory:
    """Sine whose frequency sweeps from 0.1 to 4 Hz and back, as large as speed allows."""
    t = np.arange(4096) / 4096
    up = 1 - np.abs(2 * t - 1)
    # f(t) = 0.1 * 40^up, phase = 2 pi times its integral
    f = 0.1 * 40.0**up
    cycles = np.cumsum(f) * seconds / t.size
    phase = 2 * np.pi * cycles * round(cycles[-1]) / cycles[-1]
    out = np.zeros((t.size, space.center.size))
    for i in joints_of(space, j):
        half = np.min(np.abs(space.together[i] - space.center[i]))
        size = np.minimum(half, 0.7 * space.speed[i] / (2 * np.pi * f))
        out[:, i] = size * np.sin(phase + 2.1 * i)
    return series(space, out, seconds, "chirp", 6.0)


def multisine(space: Space, j: int | None, seconds: float) -> Trajectory:
    """All joints at once, many frequencies from 0.1 to 1.5 Hz."""
    rng, t = np.random.default_rng(0), np.arange(4096) / 4096
    k = np.arange(max(1, int(0.1 * seconds)), int(1.5 * seconds) + 1)
    out = np.zeros((t.size, space.center.size))
    for i in range(space.center.size):
        phase = rng.uniform(0, 2 * np.pi, k.size)
        wave = np.sum(np.sin(2 * np.pi * k[:, None] * t + phase[:, None]) / k[:, None], axis=0)
        rate = float(np.abs(np.gradient(wave, t * seconds)).max())
        half = float(np.min(np.abs(space.together[i] - space.center[i])))
        out[:, i] = wave * min(half / float(np.abs(wave).max()), float(space.speed[i]) / rate)
    return series(space, out, seconds, "multisine", 2.0)


Maker = Callable[[Space, "int | None", float], Trajectory]
MENU: dict[str, Maker] = {
    "slow-strokes": slow_strokes,
    "speed-ladder": speed_ladder,
    "fast-strokes": fast_strokes,
    "range-strokes": range_strokes,
    "small-reversals": small_reversals,
    "rests": rests,
    "one-at-a-time": one_at_a_time,
    "pairs": pairs,
    "postures": postures,
    "range-ends": range_ends,
    "chirp": chirp,
    "multisine": multisine,
}


#: Motions that need more than one joint.
SEVERAL = ("pairs", "one-at-a-time", "postures")


def describe_motion(name: str, joints: int) -> str:
    """One sentence about a motion of the menu for so many joints, without its full stop."""
    text = (MENU[name].__doc__ or "").strip().rstrip(".")
    if joints == 1:
        text = text.removeprefix("All joints at once, ")
    return text[:1].lower() + text[1:]


@dataclass(frozen=True)
class Option:
    """One motion of the menu with what it would say.

    Parameters
    ----------
    motion : Trajectory
        The motion, within all limits.
    verdict : Verdict
        On the hardest pair, together with what is recorded already.
    margins : list of Margin
        To each limit.
    """

    motion: Trajectory
    verdict: Verdict
    margins: list[Margin]


@dataclass(frozen=True)
class Choice:
    """The menu, best first.

    Parameters
    ----------
    options : list of Option
        Best first.
    now : Verdict or None
        Of what is recorded already.
    everything : Verdict
        Of the whole menu together.
    never : tuple of str
        Rivals that no motion of the menu, nor all together, could ever separate from the first.
    structural : bool
        Whether that is all of them.
    unfelt : tuple of str
        Coefficients of the first that act on no joint, whatever the motion.
    """

    options: list[Option]
    now: Verdict | None
    everything: Verdict
    never: tuple[str, ...]
    structural: bool
    unfelt: tuple[str, ...] = ()

    @property
    def best(self) -> Option:
        """The best motion."""
        return self.options[0]


@dataclass(frozen=True)
class Survey:
    """Every motion of the menu with the Gram matrix of what it would record.

    Parameters
    ----------
    motions : list of (Trajectory, list of Margin)
        Within all limits.
    grams : list of ndarray (p, p)
        Of the question's columns, for the stage's length.
    known : ndarray (p, p) or None
        Of what is recorded already.
    """

    motions: list[tuple[Trajectory, list[Margin]]]
    grams: list[FloatArray]
    known: FloatArray | None


#: A motion that takes so many times as long as was asked for is none to propose: foreseeing it
#: takes that much longer, too.
MOST_TIMES = 20.0


def menu(
    question: Question, stage: Stage, joint: int | None, names: tuple[str, ...] = tuple(MENU)
) -> list[Foreseen]:
    """Foresee the motions of the menu; the question's rivals have no part in it.

    Parameters
    ----------
    question : Question
        Base and its context.
    stage : Stage
        Robot, limits, band, length.
    joint : int or None
        Joint that is to move; None: all of them in turn.
    names : tuple of str
        Motions to look at; what would last `MOST_TIMES` times the stage's length is left out, so
        that there may be none.
    """
    lone = SEVERAL if stage.space.center.size == 1 else ()
    out = []
    for name in (n for n in names if n not in lone):
        try:
            wanted = MENU[name](stage.space, joint, stage.seconds)
        except ConfigError:  # longer than any trajectory may be
            continue
        if wanted.period <= MOST_TIMES * stage.seconds:
            out.append(within_limits(wanted, stage, question))
    return out


def survey(
    foreseen: list[Foreseen], question: Question, stage: Stage, known: FloatArray | None = None
) -> Survey:
    """What each motion of a menu that keeps to the limits would say of a question.

    Parameters
    ----------
    foreseen : list of Foreseen
        From `menu`, of a question with the same base and context.
    question : Question
        Base, rivals, noise.
    stage : Stage
        The one of the menu.
    known : ndarray (p, p), optional
        Gram matrix of what is recorded already.
    """
    kept = [made for made in foreseen if playable(made)]
    # as long as the others: information per time counts
    grams = [gram(p, question) * (stage.seconds / motion.period) for motion, p, _ in kept]
    return Survey([(motion, found) for motion, _, found in kept], grams, known)


def decide(seen: Survey, question: Question, names: tuple[str, ...]) -> Choice:
    """The motion that separates the first of some rivals from the others best; () means all.

    Rivals that no motion separates from it stay out of the score, unless all are such.

    Raises
    ------
    ConfigError
        If there is no motion to choose from.
    """
    if not seen.motions:
        raise ConfigError(
            f"every motion would take more than {MOST_TIMES:g} times as long as asked for: the "
            "joints are too slow for their ranges; give narrower limits, or a longer motion"
        )

    def say(g: FloatArray) -> dict[str, Verdict]:
        return against(g, question, names)

    start = np.zeros_like(seen.grams[0]) if seen.known is None else seen.known
    single = [say(start + g) for g in seen.grams]
    every = start + np.sum(seen.grams, axis=0)
    union = say(every)
    never = tuple(n for n in union if not any(v[n].possible for v in (union, *single)))
    open_ = [n for n in union if n not in never] or list(union)

    def least(found: dict[str, Verdict]) -> Verdict:
        return min((found[n] for n in open_), key=lambda v: v.odds)

    pairs = zip(seen.motions, single, strict=True)
    ranked = [
        (least(v).odds, sum(v[n].odds for n in open_), Option(x, least(v), found))
        for (x, found), v in pairs
    ]
    # where the worst pair is hopeless everywhere, the others decide
    ranked.sort(key=lambda r: (-round(r[0], 1), -r[1]))
    options = [option for _, _, option in ranked]
    now = None if seen.known is None else least(say(seen.known))
    nothing = unfelt(every, question, names)
    return Choice(options, now, least(union), never, len(never) == len(union), nothing)


#: Noise of the effort where none was measured, as a share of the torque limit.
NOISE = 1e-3
#: Size of an effect of which nothing is known, as a share of the torque limit.
UNKNOWN_EFFECT_SHARE = 5e-3
#: Share of the noise power that an effect must exceed to be noticed: the 4 % of the error that
#: `hil diagnose` asks of every effect (1 - 0.96^2).
NOTICED_SHARE = 0.08


def question(
    model: RobotModel, effects: tuple[str, ...], joint: int | None, stage: Stage
) -> Question:
    """Question about rivals (or one effect) of which nothing has been measured.

    Each gets the middle of its shapes and coefficients that make it 0.5 % of the torque limit
    (rms, on strokes at all speeds), or what the model has fitted; the noise is 0.1 % of it.

    Raises
    ------
    ConfigError
        If an effect is unknown, part of every model, or cannot show in free motion.
    """
    space = stage.space
    motion = speed_ladder(space, joint, stage.seconds)
    problem = stage.foresee(motion)
    problem.motions = [replace(m, span=space.alone) for m in problem.motions]
    base, theta = nominal(model, problem, space.limits)
    first = problem.motions[0]
    problem.set_context(v0=first.v0, contact=first.contact)
    complete_foreseen(problem, base, theta)
    torque = _scale(space.limits.torque, problem)
    j = 0 if joint is None else joint
    unknown = {
        name: _unknown(name, j, problem, UNKNOWN_EFFECT_SHARE * float(torque[j]))
        for name in effects
    }
    known, base, theta = _of_model(base, theta, set(effects) - set(BASE_EFFECTS), j, problem)
    rivals = [known.get(name, rival) for name, rival in unknown.items()]
    _lacking(base, rivals)
    asked = _question(base, theta, _near(rivals, problem), NOISE * torque, problem)
    instants = problem.n * stage.seconds / motion.period
    return replace(asked, floor=NOTICED_SHARE * instants)


def _of_model(
    base: list[Term], theta: FloatArray, effects: set[str], j: int, problem: Problem
) -> tuple[dict[str, Rival], list[Term], FloatArray]:
    """Effects on joint j that the model has fitted, as rivals, and the model without them."""
    known, rest, left = {}, [], []
    for term, where in zip(base, slices_of(problem, base), strict=True):
        if term.effect.name in effects and term.joint == j and np.any(theta[where]):
            known[term.effect.name] = Rival(term, theta[where])
        else:
            rest.append(term)
            left.append(theta[where])
    return known, rest, np.concatenate([np.zeros(0), *left])


def _lacking(base: list[Term], rivals: list[Rival]) -> None:
    """Refuse an effect that the model has already."""
    there = {t.key for t in base} & {(r.name, r.term.joint) for r in rivals}
    if there:
        raise ConfigError(
            f"{', '.join(sorted(n for n, _ in there))}: already in the model; name effects that it "
            "lacks, or none, to identify the model as it is"
        )


def _scale(torque: FloatArray, problem: Problem) -> FloatArray:
    """Torque limits; where there is none, ten times the foreseen effort."""
    foreseen = 10 * np.sqrt(np.mean(problem.motions[0].tau ** 2, axis=0))
    out: FloatArray = np.where(np.isfinite(torque), torque, np.maximum(foreseen, 1e-9))
    return out


def _unknown(name: str, j: int, problem: Problem, size: float) -> Rival:
    """A rival with the middle of its shapes and coefficients of a given rms effort."""
    effect = catalogue.get(name)
    if "motor" not in effect.scope.explains:
        raise ConfigError(
            f"effect {name!r} shows in contact only; no free motion can tell: press on the object "
            f"instead ({effect.doc.shown_by})"
        )
    if reason := effect.scope.lacks(problem.motions[0], j):
        raise ConfigError(f"effect {name!r}: {reason}; no motion of this rig can show it")
    grid = effect.search.grid(problem.motions[0], j)
    term = Term(effect, j, grid[len(grid) // 2] if grid else ())
    columns = problem.columns(effect, j, term.shape)
    flat = columns[j] if columns.ndim == 3 else columns
    power = np.sqrt(np.mean(flat**2, axis=0))
    theta = size / np.maximum(power, 1e-12 + 1e-6 * power.max()) / np.sqrt(power.size)
    # alternate the signs, so that no sum over the columns cancels or doubles by design
    return Rival(term, theta * np.where(np.arange(theta.size) % 3 == 1, -1.0, 1.0))


def _near(rivals: list[Rival], problem: Problem) -> list[Rival]:
    """Rivals with the shapes by which they may imitate each other."""
    out = []
    for r in rivals:
        alike = [
            x.term.shape
            for x in rivals
            if x is not r
            and [p.name for p in x.term.effect.shape] == [p.name for p in r.term.effect.shape]
        ]
        out.append(replace(r, shapes=imitations(r.term, problem, alike)))
    return out


def measured(
    base: list[Term], theta: FloatArray, rivals: list[Rival], noise: FloatArray, problem: Problem
) -> Question:
    """Question about rivals as a recording, in its context, shows them."""
    first = problem.motions[0]
    return Question(base, theta, _near(rivals, problem), noise, first.v0, first.contact, first.span)


def _question(
    base: list[Term], theta: FloatArray, rivals: list[Rival], noise: FloatArray, problem: Problem
) -> Question:
    first = problem.motions[0]
    terms, v0 = sharp(base, first.resolution)
    return Question(terms, theta, rivals, noise, v0, first.contact, first.span)
