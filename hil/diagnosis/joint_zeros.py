"""Joints that are otherwise than the robot's description has it: zeros, senses, order, lengths.

Another zero or sense of a joint is another motion, and another gravity acts on it.  On
some instants of the run it is seen what the rigid body leaves of the efforts, friction, rotor and
offset of each joint projected out:  q_j -> s q_j + z  for s = +-1 and z in steps around
the turn, the best joint first, then the next, as long as one helps; gravity along each axis of the
base, and none; the places of the joints times a factor, all of them or one.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from hil.diagnosis.constants import HALF, LITTLE, OPEN, TENTH, WHOLE, WORTH
from hil.diagnosis.preconditions import GRAVITY_WARNING, weighed
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.bodies import Tree
from hil.models.effect import Trait
from hil.record.recording import Recording, RobotSource
from hil.record.urdf_checks import link_at

FloatArray = NDArray[np.float64]

#: Instants on which other postures are tried, and steps of a zero around the turn.
_INSTANTS, _STEPS = 500, 24
#: Highest power of a joint's own position of a law that is asked whether it explains more than
#: another zero: springs, hoses, stops.
OWN_LAWS = 3
#: Stands for a factor until a fit has told it.
TIMES = "{times}"
#: Largest scale of an effort and of a position that is tried.
OTHER_SCALES = {"effort": 1000.0, "scale": 8.0}
#: Millimetres in a metre, and the largest factor of the description's lengths that is tried.
MILLIMETRES, OTHER_LENGTHS = 1000.0, 2000.0
#: Gravity where the description has none [m/s^2].
EARTH = 9.81
#: Code of lengths that do not fit.
LENGTHS = "lengths"
#: Share of the largest direction of the rigid body below which another one counts as none.
SAME = 1e-9


@dataclass(frozen=True)
class Sense:
    """How a joint's recorded position and effort are to be read.

    Parameters
    ----------
    sign, shift : float
        True position = sign * scale * recorded + shift [rad or m].
    effort : float
        Factor of the effort, its sign among it.
    scale : float
        Factor of the position.
    """

    sign: float = 1.0
    shift: float = 0.0
    effort: float = 1.0
    scale: float = 1.0

    @property
    def free(self) -> bool:
        """Whether its zero is a number that was fitted, and no quarter of a turn."""
        turns = self.shift / (np.pi / 2)
        return abs(turns - round(turns)) > SAME

    @property
    def changes(self) -> int:
        """How many entries of a map this is; a zero that was fitted counts twice."""
        entries = (self.sign < 0, self.shift != 0.0, self.effort != 1.0, self.scale != 1.0)
        return sum(entries) + self.free


@dataclass(frozen=True)
class Lengths:
    """Places of joints in the description, times a factor.

    Parameters
    ----------
    left : float
        Squared share of the efforts that it leaves.
    factor : float
        Of the lengths.
    joints : (str, str) or None
        From which moving joint to which; None for all lengths.
    step : float
        Log of the factor within which it was sought.
    alike : bool
        Whether a factor of all lengths leaves as little.
    """

    left: float
    factor: float
    joints: tuple[str, str] | None
    step: float
    alike: bool = False


@dataclass(frozen=True)
class _Rows:
    """One joint's efforts at the instants at which it moves, in shares of their size."""

    j: int
    at: NDArray[np.int_]
    size: float
    own: FloatArray
    y: FloatArray


class Postures:
    """What the rigid body leaves of the efforts if joints are counted in another sense.

    Parameters
    ----------
    result : FitResult
        Base model fitted to the runs as they are.
    laws : int
        Highest power of its own position that every joint's effort may hold beside the rigid body.
    run : int, optional
        Number of the run alone that may be counted otherwise; default all.
    """

    def __init__(self, result: FitResult, laws: int = 0, run: int | None = None) -> None:
        problem, body = result.problem, np.zeros(result.theta.size, dtype=bool)
        for t, where in zip(result.terms, result.slices, strict=True):
            body[where] = Trait.BODY in t.effect.traits
        self._robot, self._d = problem.robot, problem.d
        pick = np.unique(np.linspace(0, problem.n - 1, _INSTANTS).astype(int))
        self._states = [x[:, pick].T for x in (problem.q, problem.qd, problem.qdd)]
        whose = problem.whole[problem.run[pick]]  # a recording with gaps has several parts
        self._counted = ((whose == run) | (run is None))[:, None]
        rest = result.x.reshape(problem.d, problem.n, -1)[:, pick][:, :, ~body]
        self._rows = list[_Rows]()
        self._kept: tuple[object, FloatArray] | None = None
        for j in np.flatnonzero(~problem.holds).tolist():
            at = np.flatnonzero(problem.live[j, pick])
            own, y = self._beside(rest[j, at], j, at, laws), problem.effort[j, pick[at]]
            size, wide = max(float(np.linalg.norm(y)), 1e-300), np.linalg.norm(own, axis=0)
            q = np.linalg.qr(own[:, wide > 0] / wide[wide > 0])[0]
            self._rows.append(_Rows(j, at, size, q, orthogonal_part(y / size, q)))

    def _beside(self, own: FloatArray, j: int, at: NDArray[np.int64], laws: int) -> FloatArray:
        """Columns of joint j beside the rigid body, and powers of its position."""
        q = self._states[0][at, j]
        middle, half = (q.min() + q.max()) / 2, max(float(np.ptp(q)) / 2, 1e-300)
        powers = ((q - middle) / half)[:, None] ** np.arange(1, laws + 1)
        return np.concatenate([own, powers], axis=1)

    def left(
        self,
        senses: Sequence[Sense],
        j: int,
        tree: Tree | None = None,
        order: Sequence[int] | None = None,
    ) -> tuple[float, float]:
        """Squared share of the efforts that is left, with joint j's effort as it is and turned.

        `tree` in place of the described bodies; `order`: the columns of each joint.
        """
        taken = list(order or range(self._d))
        y = self._regressor(senses, taken, tree)
        # an effort in another scale: the masses of its joint seem so many times smaller
        sizes = [r.size * abs(senses[r.j].effort) for r in self._rows]
        parts = [
            orthogonal_part(y[r.at, taken.index(r.j)] / size, r.own)
            for r, size in zip(self._rows, sizes, strict=True)
        ]
        size = np.sqrt(np.sum([np.sum(x**2, axis=0) for x in parts], axis=0))
        parts = [x / np.maximum(size, 1e-300) for x in parts]
        values, vectors = np.linalg.eigh(np.sum([x.T @ x for x in parts], axis=0))
        known = values > SAME * values[-1]
        pull = {r.j: x.T @ r.y for r, x in zip(self._rows, parts, strict=True)}
        signs = {k: np.sign(senses[k].effort) for k in pull}
        others = sum((signs[k] * c for k, c in pull.items() if k != j), 0.0 * pull[j])
        whole = sum(float(r.y @ r.y) for r in self._rows)
        as_it_is, turned = (
            whole - float(np.sum((vectors.T[known] @ c) ** 2 / values[known]))
            for c in (others + pull[j], others - pull[j])
        )
        return as_it_is, turned

    def _regressor(
        self, senses: Sequence[Sense], taken: list[int], tree: Tree | None
    ) -> FloatArray:
        """Columns of the rigid body as joints are counted; those of the last posture are kept."""
        moved = [(x.sign * x.scale, x.shift) for x in senses]
        if tree is None and self._kept and self._kept[0] == (moved, taken):
            return self._kept[1]
        factor, shift = np.array(moved).T
        q, v, a = (x[:, taken] for x in self._states)
        factor, shift = np.where(self._counted, factor, 1.0), np.where(self._counted, shift, 0.0)
        states = q * factor + shift, v * factor, a * factor
        if tree is not None:
            self._kept = None
            return tree.regressor(*states) @ tree.spread
        y = self._robot.regressor(*states)
        self._kept = ((moved, taken), y)
        return y

    def order(self) -> list[int]:
        """Columns of each joint that leave least: two joints exchanged, then two others."""
        as_read, now = [Sense() for _ in range(self._d)], list(range(self._d))
        if len(self._rows) < 2:
            return now

        def left(order: list[int]) -> float:
            return self.left(as_read, self._rows[0].j, order=order)[0]

        for _ in self._rows[1:]:
            tried = [exchanged(now, a, b) for a, b in combinations(range(self._d), 2)]
            best = min(tried, key=left)
            if left(best) > WHOLE * left(now):
                break
            now = best
        return now

    def gravity(self) -> FloatArray | None:
        """Gravity (3,) [m/s^2] that leaves clearly less than the described one; None without."""
        tree, j = self._robot.tree, self._rows[0].j if self._rows else 0
        if tree is None or not self._rows:
            return None
        as_read = [Sense() for _ in range(self._d)]

        def left(g: FloatArray) -> float:
            return self.left(as_read, j, replace(tree, gravity=g))[0]

        size = float(np.linalg.norm(tree.gravity)) or EARTH
        axes = [sign * size * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
        best = min([np.zeros(3), *axes], key=left)
        if left(best) > WHOLE * left(tree.gravity):
            return None
        if not np.any(best):
            return best
        aside = np.eye(3)[best == 0.0]

        def turned(x: FloatArray) -> FloatArray:
            g = best / size + x @ aside
            return np.asarray(size * g / np.linalg.norm(g))

        def rest(x: FloatArray) -> float:
            return left(turned(np.asarray(x, dtype=np.float64)))

        found = scipy.optimize.minimize(rest, np.zeros(2), method="Nelder-Mead")
        return turned(found.x) if found.fun < WHOLE * left(best) else best

    def leans(self, gravity: FloatArray) -> bool:
        """Whether a gravity is the described one on a base that leans by less than 14 degrees.

        g.g0 > (1 - w) |g| |g0|:  what is left of it along the described one is nearly all, as the
        law of a leaning base has it to first order.
        """
        described = self._robot.tree.gravity if self._robot.tree else np.zeros(3)
        both = float(np.linalg.norm(gravity) * np.linalg.norm(described))
        return float(gravity @ described) > (1 - WORTH) * both

    def bests(self) -> list[list[Sense]]:
        """Senses of all joints that leave least: the joint that helps most first, then the next.

        Where another joint does as much at first, what begins with it, too.
        """
        as_read = [Sense() for _ in range(self._d)]
        first = self._tried(as_read)
        out: list[list[Sense]] = []
        for left, sense, j in first:
            if left <= (1 + WORTH) * first[0][0] and left <= WHOLE * self.now(as_read):
                senses = [sense if k == j else x for k, x in enumerate(as_read)]
                for _ in self._rows[1:]:
                    now, (then, other, k) = self.now(senses), self._tried(senses)[0]
                    if then > WHOLE * now:
                        break
                    senses[k] = other
                out += [] if senses in out else [senses]
        return out

    def best(self) -> list[Sense]:
        """The first of them; as recorded where none helps."""
        return next(iter(self.bests()), [Sense() for _ in range(self._d)])

    def now(self, senses: Sequence[Sense] | None = None, tree: Tree | None = None) -> float:
        """Squared share of the efforts that some senses leave; those that are recorded if None.

        `tree`: as of `left`.
        """
        senses = senses or [Sense() for _ in range(self._d)]
        j = self._rows[0].j
        return self.left(senses, j, tree)[int(senses[j].effort < 0)]

    def within(self, gravity: FloatArray) -> float:
        """The same in another gravity (3,) [m/s^2]."""
        tree = self._robot.tree
        return self.now(tree=None if tree is None else replace(tree, gravity=gravity))

    def lengths(self) -> list[Lengths]:
        """Factors of the lengths that leave less: of one joint's place, and of all of them.

        The one that leaves least, then all; only what leaves less at all, by `WORTH`.
        """
        tree = self._robot.tree
        if tree is None or not self._rows[1:]:
            return []
        # where the first body is fixed to the base changes no effort
        far = (tree.parent >= 0) & np.any(tree.place != 0.0, axis=1)
        ones = [self._longer(tree, np.arange(len(far)) == k) for k in np.flatnonzero(far)]
        most = (1 - WORTH) * self.now()
        good = sorted((x for x in ones if x.left < most), key=lambda x: x.left)[:1]
        every = self._longer(tree, np.ones(len(far), dtype=bool)) if far.any() else None
        if every is None or every.left >= most:
            return good
        alike = (replace(x, alike=every.left <= (1 + WORTH) * x.left) for x in good)
        return [*alike, every]

    def _longer(self, tree: Tree, which: NDArray[np.bool_]) -> Lengths:
        """The factor of some bodies' places that leaves least."""

        def left(x: float) -> float:
            place = np.where(which[:, None], float(np.exp(x)), 1.0) * tree.place
            return self.now(tree=replace(tree, place=place))

        grid = np.log(OTHER_LENGTHS) * np.linspace(-1, 1, 2 * _STEPS + 1)
        best, step = min(grid.tolist(), key=left), float(grid[1] - grid[0])
        fine = scipy.optimize.minimize_scalar(
            left, bounds=(best - step, best + step), method="bounded"
        )
        k = int(np.flatnonzero(which)[-1])
        names = (tree.joints[tree.parent[k]], tree.joints[k]) if which.sum() == 1 else None
        return Lengths(float(fine.fun), float(np.exp(fine.x)), names, step)

    def _tried(self, senses: Sequence[Sense]) -> list[tuple[float, Sense, int]]:
        """What the best sense of each joint leaves beside those of the others, least first."""
        found = [(*self._of_one(senses, r.j), r.j) for r in self._rows]
        return sorted(found, key=lambda x: x[0])

    def _of_one(self, senses: Sequence[Sense], j: int) -> tuple[float, Sense]:
        """What the best sense of one joint leaves, and that sense; the others keep theirs.

        Of senses that leave as little it is the nearest to the recorded one: the motion may show no
        zero, as of a last joint, whose centre of mass is free.
        """

        def left(sign: float, shift: float) -> tuple[float, Sense]:
            now = [Sense(sign, shift) if k == j else x for k, x in enumerate(senses)]
            as_it_is, turned = self.left(now, j)
            return min(as_it_is, turned), Sense(sign, shift, 1.0 if as_it_is <= turned else -1.0)

        turns, step = self._robot.units[j] == "rad", 2 * np.pi / _STEPS
        shifts = step * np.arange(_STEPS) if turns else np.zeros(1)
        tried = [left(sign, float(z)) for sign in (1.0, -1.0) for z in shifts]
        least = min(x for x, _ in tried)
        if not turns or least > WHOLE * self.now(senses):
            return min(tried, key=lambda x: x[0])
        simple = [left(sign, z) for sign in (1.0, -1.0) for z in np.pi / 2 * np.arange(4)]
        near = [x for x in simple if x[0] <= (1 + WORTH) * least]
        if near:
            return self._centred(min(near, key=lambda x: x[1].changes))
        best = min(tried, key=lambda x: x[0])[1]
        found = scipy.optimize.minimize_scalar(
            lambda z: left(best.sign, float(z))[0],
            bounds=(best.shift - step, best.shift + step),
            method="bounded",
        )
        # a quarter of a turn, or none, where the motion shows no finer angle
        nearest = left(best.sign, np.pi / 2 * round(float(found.x) / (np.pi / 2)))
        if nearest[0] > (1 + WORTH) * float(found.fun):
            nearest = left(best.sign, float(found.x))
        return self._centred(nearest)

    def zeros(self) -> list[Sense]:
        """Other zeros of turning joints that leave least: what helps most, then the next."""
        senses = [Sense() for _ in range(self._d)]
        for _ in self._rows:
            tried = [
                (*self._zero(senses, r.j), r.j)
                for r in self._rows
                if self._robot.units[r.j] == "rad" and senses[r.j] == Sense()
            ]
            left, best, j = min(tried, key=lambda x: x[0], default=(np.inf, Sense(), 0))
            if left > WHOLE * self.now(senses):
                break
            senses[j] = best
        return senses

    def _zero(self, senses: Sequence[Sense], j: int) -> tuple[float, Sense]:
        """What the best zero of one joint leaves beside those of the others, and that zero."""

        def left(z: float) -> float:
            return self.now([Sense(shift=z) if k == j else x for k, x in enumerate(senses)])

        step = 2 * np.pi / _STEPS
        best = min((step * np.arange(_STEPS)).tolist(), key=left)
        fine = scipy.optimize.minimize_scalar(
            left, bounds=(best - step, best + step), method="bounded"
        )
        return self._centred((float(fine.fun), Sense(shift=float(fine.x))))

    @staticmethod
    def _centred(x: tuple[float, Sense]) -> tuple[float, Sense]:
        """The same zero within half a turn."""
        return x[0], replace(x[1], shift=float((x[1].shift + np.pi) % (2 * np.pi) - np.pi))

    def scales(self) -> list[list[Sense]]:
        """Senses with one joint's position or effort in another scale that leave clearly less.

        Of twice or more, or half and less: what is nearer is a drive's, or a transmission's.
        """
        as_read = [Sense() for _ in range(self._d)]
        now, found = self.now(as_read), list[tuple[float, list[Sense]]]()
        for name, most in OTHER_SCALES.items() if self._rows[1:] else ():
            for r in self._rows:

                def senses(x: float, name: str = name, j: int = r.j) -> list[Sense]:
                    one = replace(as_read[j], **{name: float(np.exp(x))})
                    return [one if k == j else s for k, s in enumerate(as_read)]

                def left(x: float, senses: Callable[[float], list[Sense]] = senses) -> float:
                    return self.now(senses(float(x)))

                grid = np.log(most) * np.linspace(-1, 1, _STEPS + 1)
                best = min(grid.tolist(), key=left)
                if left(best) > WHOLE * now:
                    continue
                step = float(grid[1] - grid[0])
                fine = scipy.optimize.minimize_scalar(
                    left, bounds=(best - step, best + step), method="bounded"
                )
                if abs(fine.x) > -np.log(HALF) - TENTH:
                    found.append((float(fine.fun), senses(float(fine.x))))
        least = min((x for x, _ in found), default=0.0)
        return [x for left, x in found if left <= 2 * least]


def exchanged(order: list[int], a: int, b: int) -> list[int]:
    """An order with two places exchanged."""
    return [order[b] if k == a else order[a] if k == b else x for k, x in enumerate(order)]


def orthogonal_part(x: FloatArray, q: FloatArray) -> FloatArray:
    """What orthonormal columns leave of others."""
    out: FloatArray = x - q @ (q.T @ x)
    return out


@dataclass(frozen=True)
class Counting:
    """The runs read in another way: code, sentence, the share of the error that may stay.

    Without a sentence nothing was written down wrongly: an effect of the catalogue says the same.
    How many entries of a map it changes, and whether none of them is a number that was fitted.
    """

    runs: list[Recording]
    robot: RobotSource
    code: str
    text: str
    share: float
    changes: int = 1
    fixed: bool = False
    senses: tuple[Sense, ...] = ()
    lengths: Lengths | None = None

    def tuned(self, left: Callable[[RobotSource], float]) -> Counting:
        """The same with the factor of its lengths that leaves least of a whole fit, if it has one.

        What some instants tell of a factor is near, and a fit is sharper.
        """
        x = self.lengths
        if x is None:
            return self

        def at(f: float) -> RobotSource:
            return with_lengths(self.robot, x, float(np.exp(f)) / x.factor)

        fine = scipy.optimize.minimize_scalar(
            lambda f: left(at(float(f))),
            bounds=(np.log(x.factor) - x.step, np.log(x.factor) + x.step),
            method="bounded",
            options={"xatol": LITTLE / 2},
        )
        size = float(fine.x)
        unit = np.log(MILLIMETRES) * np.sign(size)
        if abs(size - unit) > TENTH:
            return replace(self, robot=at(size), lengths=replace(x, factor=float(np.exp(size))))
        # a unit is no number that was fitted, and one of all lengths
        found = replace(x, factor=float(np.exp(unit)))
        changes = 2 if x.joints else 1
        return replace(self, robot=at(unit), lengths=found, fixed=True, changes=changes)


def countings(result: FitResult, recordings: list[Recording]) -> Iterator[Counting]:
    """Other orders and senses of the joints, and another gravity, that promise less error."""
    postures, joints, robot = Postures(result), result.problem.joints, result.problem.source
    sprung = Postures(result, OWN_LAWS).now()
    order, gravity = postures.order(), postures.gravity()
    if order != sorted(order):
        runs = [ordered(r, order) for r in recordings]
        moved = sum(k != n for n, k in enumerate(order))
        yield Counting(runs, robot, "order", _of_order(joints, order), OPEN, moved, True)
    for senses in (*postures.bests(), *postures.scales()):
        columns = np.array([(x.sign * x.scale, x.shift, x.effort) for x in senses]).T
        runs = [_read(r, *columns) for r in recordings]
        # a quarter of a turn is no chance: what other effects leave may be half of the square then
        turned = any(x.sign < 0 or x.shift for x in senses)
        quarters = not any(x.free for x in senses)
        scaled = any(x.scale != 1.0 or abs(x.effort) != 1.0 for x in senses)
        if sprung < WHOLE * postures.now(senses):
            continue  # laws of the joints' own positions explain more than what a map may say
        yield Counting(
            runs,
            robot,
            "scale" if scaled else "posture" if turned else "sign",
            _of_senses(result.problem, senses),
            HALF**0.5 if turned and quarters else OPEN,
            sum(x.changes for x in senses),
            quarters,
            tuple(senses),
        )
    # springs of the joints seem to be a gravity from another side, which must leave clearly less
    if gravity is not None and postures.within(gravity) < WHOLE * sprung:
        numbers = " ".join(f"{x:.3g}" for x in gravity + 0.0)
        text = (
            f"gravity does not act as the robot description says. Write <gravity>{numbers}"
            "</gravity> within <robot> of the URDF"
        )
        # another zero of the first joint may be the same, and is a commoner mistake
        said, changes = ("", 0) if postures.leans(gravity) else (text, 2)
        yield Counting(
            recordings, _in_gravity(robot, gravity), GRAVITY_WARNING, said, OPEN, changes
        )
    for x in postures.lengths():
        as_found, text = with_lengths(robot, x, x.factor), _of_lengths(x)
        changes = 1 if x.joints else 2
        yield Counting(recordings, as_found, LENGTHS, text, OPEN, changes, lengths=x)


def other_zeros(
    result: FitResult, recordings: list[Recording], run: int
) -> tuple[list[Recording], list[Sense]]:
    """The runs with other zeros of one of them, where they promise less error, and these zeros."""
    senses = Postures(result, run=run).zeros()
    return with_senses(recordings, senses, run), senses


def with_senses(recordings: list[Recording], senses: Sequence[Sense], run: int) -> list[Recording]:
    """The runs, one of which is counted in another sense."""
    columns = np.array([(x.sign * x.scale, x.shift, x.effort) for x in senses]).T
    return [_read(r, *columns) if k == run else r for k, r in enumerate(recordings)]


def nearest_zeros(senses: Sequence[Sense], left: Callable[[Sequence[Sense]], float]) -> list[Sense]:
    """Zeros near these that leave least of a whole fit."""
    which = [j for j, x in enumerate(senses) if x.shift]
    start = np.array([senses[j].shift for j in which])

    def at(z: FloatArray) -> list[Sense]:
        shifts = dict(zip(which, z.tolist(), strict=True))
        return [replace(x, shift=shifts.get(j, 0.0)) for j, x in enumerate(senses)]

    def rest(z: FloatArray) -> float:
        return left(at(np.asarray(z, dtype=np.float64)))

    corners = np.vstack([start, start + TENTH * np.eye(len(which))])
    found = scipy.optimize.minimize(
        rest,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": corners, "xatol": LITTLE / 10, "fatol": LITTLE / 10},
    )
    return at(np.asarray(found.x, dtype=np.float64))


def of_zeros(problem: Problem, senses: Sequence[Sense], run: str, others: Sequence[str]) -> str:
    """What is said of joints whose zeros are other ones in one run."""
    rows = zip(problem.joints, problem.robot.units, senses, strict=True)
    said = [
        f"q{k + 1} ({joint}): {_in_words(x, unit)}"
        for k, (joint, unit, x) in enumerate(rows)
        if x != Sense()
    ]
    either = f", or the opposite in {others[0]}" if len(others) == 1 else ""
    which = [f"q{k + 1} ({x})" for k, x in enumerate(problem.joints) if senses[k] != Sense()]
    counted = "are counted from other zeros" if which[1:] else "is counted from another zero"
    return (
        f"in {run}, {' and '.join(which)} {counted} than in {others[0]}"
        f"{' and others' if others[1:] else ''}. Write in a map of {run} ({'; '.join(said)})"
        f"{either}, and import again"
    )


def scale_factor(x: Counting, after: FitResult) -> float:
    """Factor of what is scaled; of an effort, that which gives the described gravity."""
    if x.lengths is not None:
        return x.lengths.factor
    j, sense = next((j, s) for j, s in enumerate(x.senses) if s != Sense())
    if sense.scale != 1.0:
        return sense.scale
    ratio = next((w.ratio for w in weighed(after) if w.joint == j), 1.0)
    return sense.effort / ratio if ratio > 0.0 else sense.effort


def ordered(r: Recording, order: list[int]) -> Recording:
    """The same run with the columns of its joints in another order."""
    speed = None if r.qd is None else r.qd[:, order]
    return replace(r, q=r.q[:, order], qd=speed, tau=r.tau[:, order])


def _of_order(joints: tuple[str, ...], order: list[int]) -> str:
    """What a map says of columns in another order."""
    moved = [(joint, k + 1) for joint, k in zip(joints, order, strict=True)]
    said = [f"{joint} is q{k} and tau{k}" for n, (joint, k) in enumerate(moved) if k != n + 1]
    return (
        "the columns are not in the order of the joints in the robot description. Name them in a "
        f"map ({', '.join(said)})"
    )


def _in_gravity(source: RobotSource, gravity: FloatArray) -> RobotSource:
    """The same robot in another gravity."""
    root = ET.fromstring(source.urdf)
    for old in root.findall("gravity"):
        root.remove(old)
    ET.SubElement(root, "gravity").text = " ".join(repr(float(x)) for x in gravity)
    return replace(source, urdf=ET.tostring(root, encoding="unicode"))


def with_lengths(source: RobotSource, x: Lengths, factor: float) -> RobotSource:
    """The same robot with other lengths: between two moving joints, or of all of it.

    Fixed joints between the two count; of all lengths also those of the masses.
    """
    root = ET.fromstring(source.urdf)
    behind = {link_at(e, "child"): e for e in root.findall("joint")}
    places: list[ET.Element] = []
    if x.joints is None:
        places = list(root.iter("origin"))
    else:
        named = {str(e.get("name")): e for e in root.findall("joint")}
        at: ET.Element | None = named[x.joints[1]]
        while at is not None and at.get("name") != x.joints[0]:
            places += at.findall("origin")
            at = behind.get(link_at(at, "parent"))
    for e in places:
        numbers = [float(v) * factor for v in e.get("xyz", "0 0 0").split()]
        e.set("xyz", " ".join(map(repr, numbers)))
    return replace(source, urdf=ET.tostring(root, encoding="unicode"))


def _of_lengths(x: Lengths) -> str:
    """What the description should have."""
    if x.joints is None:
        return (
            "the lengths in the robot description do not fit the motion. Multiply all of them "
            f"(every <origin xyz>) by about {TIMES} in the URDF"
        )
    near, far = x.joints
    more = " (all its lengths may be wrong alike)" if x.alike else ""
    return (
        f"the distance from {near} to {far} in the robot description does not fit the motion"
        f"{more}. Multiply <origin xyz> of {far} by about {TIMES} in the URDF"
    )


def _of_senses(problem: Problem, senses: Sequence[Sense]) -> str:
    """What a map says of joints that are counted in another sense, or in another scale."""
    rows = zip(problem.joints, problem.robot.units, senses, strict=True)
    said = [
        f"q{k + 1} ({joint}): {_in_words(x, unit)}"
        for k, (joint, unit, x) in enumerate(rows)
        if x != Sense()
    ]
    for k, x in enumerate(senses):
        if x.scale != 1.0 or abs(x.effort) != 1.0:
            stem = "q" if x.scale != 1.0 else "tau"
            return (
                f"{stem}{k + 1} ({problem.joints[k]}) is in another unit or scale than the other "
                f"columns. Multiply it by about {TIMES} in a map (scale = {TIMES}; the exact "
                "number is that of the unit or of the gear)"
            )
    if all(x == Sense(effort=x.effort) for x in senses):
        turned = [f"tau{k + 1} ({problem.joints[k]})" for k, x in enumerate(senses) if x.effort < 0]
        have = "has" if len(turned) == 1 else "have"
        return f"{' and '.join(turned)} {have} the wrong sign: write sign = -1 for it in a map"
    return f"the positions do not follow the robot description. Write in a map ({'; '.join(said)})"


def _read(r: Recording, sign: FloatArray, shift: FloatArray, effort: FloatArray) -> Recording:
    """The same run with its joints counted in another sense."""
    speed = None if r.qd is None else r.qd * sign
    return replace(r, q=r.q * sign + shift, qd=speed, tau=r.tau * effort)


def _in_words(x: Sense, unit: str) -> str:
    """What a map says of a joint."""
    parts = ["sign = -1"] if x.sign < 0 else []
    if x.shift:
        parts.append(f"shift = {x.shift:.4g} {unit}")
        if unit == "rad":
            parts[-1] += f" ({np.degrees(x.shift):.3g} deg)"
    own = " and ".join(parts)
    if x.effort > 0:
        return own
    return f"{own}, and sign = -1 for its effort" if own else "sign = -1 for its effort"
