"""Columns that are not what they are said to be: signs, order, zeros of joints, axes of a force.

A model that cannot follow its own recording at all is fitted again to the same recording with an
effort turned round, with two of them exchanged, or with a joint's position turned round or counted
from another zero.  No missing effect makes one of these fit.

*Efforts.*  Which error no fit of the base model can go below, whatever its shapes and bounds?  Its
columns are those of the motion.  With all of them, in all shapes that a fit tries, as free columns
X_j of each joint's rows, and efforts y_j of rms size s_j,

    min over theta of  sum_j |y_j - X_j theta|^2 / (N_j s_j^2)

is no more than what any fit leaves.  X_j = Q_j R_j is made once for any number of efforts that the
same motion may have had.

*Postures.*  Another zero or sense of a joint is another motion, and another gravity acts on it.  On
some instants of the run it is seen what the rigid body leaves of the efforts, friction, rotor and
offset of each joint projected out:  q_j -> s q_j + z  for s = +-1 and z in steps around
the turn, the best joint first, then the next, as long as one helps; gravity along each axis of the
base, and none.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from hil.diagnosis.constants import HALF, MATTERS, NEAR_FLOOR, OPEN, TENTH, WHOLE, WORTH
from hil.diagnosis.preconditions import GRAVITY
from hil.identify.design import head
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.identify.regression import least_squares
from hil.identify.result import FitResult
from hil.identify.solve import factors
from hil.models.effect import Trait
from hil.models.model import BASE_EFFECTS
from hil.models.robots import IndependentAxes
from hil.record.locked import in_base_axes
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]


class Reach:
    """Least errors of the base model over the motion of a fit.

    Parameters
    ----------
    result : FitResult
        The fit; of one with other terms than the base model's nothing is known.
    """

    def __init__(self, result: FitResult) -> None:
        self._known = all(t.effect.name in BASE_EFFECTS for t in result.terms)
        if self._known:
            problem = result.problem
            grids = ((t, problem.grid(t.effect, t.joint) or [t.shape]) for t in result.terms)
            terms = [replace(t, shape=s) for t, grid in grids for s in grid]
            with problem.aside():
                self._q, self._r = factors(problem, terms, np.ones(problem.d))

    def least(self, problem: Problem) -> float:
        """Least relative error over all joints [%] for the efforts of another problem.

        Parameters
        ----------
        problem : Problem
            Of the same motion.

        Returns
        -------
        float
            Root mean square over the joints; 0 where nothing is known.
        """
        if not self._known or any(len(q) != problem.n for q in self._q):
            return 0.0
        size = np.sqrt(np.sum(problem.effort**2, axis=1))
        weight = 100.0 / np.maximum(size, 1e-300)
        parts = zip(self._q, self._r, problem.y, weight, strict=True)
        each = [(w * (q.T @ y), w * r, w * w * float(y @ y)) for q, r, y, w in parts]
        right = np.concatenate([c for c, _, _ in each])
        rows = np.concatenate([r for _, r, _ in each])
        theta = least_squares(rows, right)
        # what no column of its joint reaches, and what not all joints reach at once
        beyond = sum(whole - float(c @ c) for c, _, whole in each)
        rest = float(np.sum((right - rows @ theta) ** 2))
        return float(np.sqrt(max(beyond + rest, 0.0) / problem.d))


# ------------------------------------------------------------ efforts and forces


def mistaken(result: FitResult, recordings: list[Recording]) -> list[tuple[str, str]]:
    """Faults (code, sentence) of columns that the base fit shows; empty if there are none.

    Only where the motors alone act: beside a measured force, it may be the force that is wrong.

    Parameters
    ----------
    result : FitResult
        Base model fitted to the runs as they are.
    recordings : list of Recording
        The runs.
    """
    pushed = any(r.wrench is not None or r.tau_ext is not None for r in recordings)
    worst = float(np.max(result.relative)) / 100
    doubtful = worst >= TENTH or driven(result)
    if doubtful and pushed and result.model.explains == "motor":
        return _of_tip(result, recordings)
    # what would be of no size once it fits is no mistake
    if result.model.explains != "motor" or pushed or OPEN * worst < MATTERS:
        return []
    found = _other_posture(result, recordings)
    found += _other_efforts(result, recordings) if doubtful else []
    return [(code, text) for _, code, text in sorted(found)[:1]]


def _other_efforts(result: FitResult, recordings: list[Recording]) -> list[tuple[float, str, str]]:
    """Doubt, code and sentence of efforts that fit turned round or exchanged."""
    reach, found = Reach(result), []
    for code, text, columns, signs in _changes(result.problem.joints, result.relative):
        changed = [replace(r, tau=r.tau[:, columns] * signs) for r in recordings]
        before, problem = _size(result), _again(result, changed)
        if reach.least(problem) > NEAR_FLOOR * OPEN * before:
            continue
        after = fit(problem, result.model, sweeps=1)
        if _fits(after, before, OPEN):
            # an effort that is read wrongly is less to assume than a posture
            found.append((HALF * _size(after), code, text))
    if either := _out_of_order(result, recordings):
        found = [x for x in found if x[1] != "swapped"]
    return found + either


def _out_of_order(result: FitResult, recordings: list[Recording]) -> list[tuple[float, str, str]]:
    """Doubt, code and sentence of efforts that stand in another order than their positions.

    Either ones may be in the wrong columns: what fits is offered, both where both do.
    """
    order = _followed(result.problem)
    if order == sorted(order):
        return []
    back, before = [order.index(k) for k in range(len(order))], _size(result)
    efforts = [replace(r, tau=r.tau[:, back]) for r in recordings]
    motions = [replace(_ordered(r, order), tau=r.tau) for r in recordings]
    tried = []
    for stem, columns, runs in (("tau", back, efforts), ("q", order, motions)):
        after = fit(_again(result, runs), result.model, sweeps=1)
        if _fits(after, before, OPEN):
            tried.append((_size(after), stem, columns))
    if not tried:
        return []
    least = min(size for size, *_ in tried)
    said = [_exchange(stem, x, result.problem.joints) for e, stem, x in tried if HALF * e < least]
    text = f"{said[0][0]}; name the columns in a map ({said[0][1]})"
    if len(said) > 1:
        text += (
            f". With the positions in another order it fits as well ({said[1][1]}): the program "
            "that wrote the table knows which of the two it exchanged; change only one of them"
        )
    return [(HALF * least, "swapped", text)]


def _exchange(stem: str, order: Sequence[int], joints: tuple[str, ...]) -> tuple[str, str]:
    """What columns are taken in another order, and what a map says of them."""
    moved = [k for k, column in enumerate(order) if k != column]
    names = [f"{stem}{k + 1}" for k in moved]
    how = "swapped" if len(moved) == 2 else "in the wrong columns"
    what = f"{', '.join(names[:-1])} and {names[-1]} ({', '.join(joints[k] for k in moved)})"
    taken = [f"{stem}{k + 1} from the column of {stem}{order[k] + 1}" for k in moved]
    return f"{what} are {how}: in the other order the model fits", ", ".join(taken)


def _followed(problem: Problem) -> list[int]:
    """Position that each joint's effort follows best, each taken once: column of q by joint.

    By what a joint's own acceleration, speed, direction and posture leave of an effort; counted
    from the efforts: position order[k] belongs with effort k.
    """
    moves = np.flatnonzero(~problem.holds)
    order = list(range(problem.d))
    left = np.zeros((moves.size, moves.size))
    for a, j in enumerate(moves):
        at = problem.live[j]
        y = problem.effort[j, at]
        for b, k in enumerate(moves):
            q, v = problem.q[k, at], problem.qd[k, at]
            sign = np.tanh(v / max(float(problem.speed_noise[k]), 1e-300))
            one = np.ones(q.size)
            own = np.stack([problem.qdd[k, at], v, sign, one, q, np.sin(q), np.cos(q)], axis=1)
            basis = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
            left[a, b] = float(np.linalg.norm(_beside(y, basis)))
    left = np.log(np.maximum(left, 1e-300))
    rows, taken = scipy.optimize.linear_sum_assignment(left)
    gain = float(np.trace(left) - left[rows, taken].sum())
    moved = int(np.sum(rows != taken))
    if moved and gain > -moved * np.log(WHOLE):
        for row, column in zip(rows, taken, strict=True):
            order[int(moves[row])] = int(moves[column])
    return order


def _again(
    result: FitResult, changed: list[Recording], robot: RobotSource | None = None
) -> Problem:
    """The problem of a fit with changed runs, or of another robot."""
    problem = result.problem
    source = robot or problem.source
    return Problem(changed, source, result.model.explains, rates=problem.rates)


def _fits(after: FitResult, before: float, share: float) -> bool:
    """Whether a model that left so much over all joints [%] leaves less than a share of it now."""
    return _size(after) < share * before and float(np.max(after.relative)) < 100 * HALF


def _of_tip(result: FitResult, recordings: list[Recording]) -> list[tuple[str, str]]:
    """Fault (code, sentence) of a force in the axes of its sensor at the tip; none where it is not.

    Told where the base model fits with the force turned into axes of the base, and not without.
    """
    robot, source = result.problem.robot, result.problem.source
    if robot.tree is None or any(r.wrench is None for r in recordings):
        return []
    changed = []
    for r in recordings:
        axes = robot.tip_axes(r.q)
        if axes is None or r.wrench is None:
            return []
        changed.append(replace(r, wrench=in_base_axes(r.wrench, axes)))
    before = _size(result)
    after = fit(_again(result, changed), result.model, sweeps=1)
    if _size(after) >= OPEN * before:
        return []
    link = source.tip or "LINK"
    return [
        (
            "force-axes",
            "the measured force (fx, fy, fz) is in the axes of its sensor at the tip and not in "
            f"those of the base: turned, the model's error falls from {before:.3g} to "
            f'{_size(after):.3g} % of the effort. Say force_axes = "{link}" under [robot] in a '
            "map, with the link that carries the sensor, and import again",
        )
    ]


def driven(result: FitResult) -> bool:
    """Whether all friction lies on its bound, zero: free masses take a wrong sign, it cannot."""
    friction = Trait.DRY | Trait.VISCOUS
    rubbing = [t for t in result.terms if t.effect.traits & friction]
    every = [f"{head(t.effect, t.joint)}.{t.effect.params[0].name}" for t in rubbing]
    names = [n for n in every if n in result.values]
    return bool(names) and all(result.values[n].at_bound for n in names)


def _size(result: FitResult) -> float:
    """Relative error over all joints [%]."""
    return float(np.sqrt(np.mean(result.relative**2)))


def _changes(
    joints: tuple[str, ...], error: FloatArray
) -> Iterator[tuple[str, str, list[int], FloatArray]]:
    """Code, sentence, order and signs of the columns that may be meant.

    A joint whose effort is another one's fits badly, and so does the other one's.
    """
    d, bad = len(joints), error > 100 * TENTH
    order, fits = list(range(d)), "with the other sign the model fits; change it in a map"
    for k, joint in ((k, x) for k, x in enumerate(joints) if bad[k]):
        signs = np.where(np.arange(d) == k, -1.0, 1.0)
        yield "sign", f"tau{k + 1} ({joint}) has the wrong sign: {fits}", order, signs
    if d > 1 and (2 * np.sum(error > 100 * OPEN) >= d or not np.any(bad)):
        text = (
            "all efforts have the wrong sign: with the other one the model fits; change it in a map"
        )
        yield "sign", text, order, np.full(d, -1.0)
    for a, b in combinations(np.flatnonzero(bad).tolist(), 2):
        swapped = _exchanged(order, a, b)
        text, taken = _exchange("tau", swapped, joints)
        yield "swapped", f"{text}; name the columns in a map ({taken})", swapped, np.ones(d)


# ------------------------------------------------------------ postures

#: Instants on which other postures are tried, and steps of a zero around the turn.
INSTANTS, STEPS = 500, 24
#: Gravity where the description has none [m/s^2].
EARTH = 9.81
#: Share of the largest direction of the rigid body below which another one counts as none.
SAME = 1e-9


@dataclass(frozen=True)
class Sense:
    """How a joint's recorded position and effort are to be read.

    Parameters
    ----------
    sign, shift : float
        True position = sign * recorded + shift [rad or m].
    effort : float
        The same sign of the effort.
    """

    sign: float = 1.0
    shift: float = 0.0
    effort: float = 1.0


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
    """

    def __init__(self, result: FitResult) -> None:
        problem, body = result.problem, np.zeros(result.theta.size, dtype=bool)
        for t, where in zip(result.terms, result.slices, strict=True):
            body[where] = Trait.BODY in t.effect.traits
        self._robot, self._d = problem.robot, problem.d
        pick = np.unique(np.linspace(0, problem.n - 1, INSTANTS).astype(int))
        self._states = [x[:, pick].T for x in (problem.q, problem.qd, problem.qdd)]
        beside = result.x.reshape(problem.d, problem.n, -1)[:, pick][:, :, ~body]
        self._rows = []
        for j in np.flatnonzero(~problem.holds).tolist():
            at = np.flatnonzero(problem.live[j, pick])
            own, y = beside[j, at], problem.effort[j, pick[at]]
            size, wide = max(float(np.linalg.norm(y)), 1e-300), np.linalg.norm(own, axis=0)
            q = np.linalg.qr(own[:, wide > 0] / wide[wide > 0])[0]
            self._rows.append(_Rows(j, at, size, q, _beside(y / size, q)))

    def left(
        self,
        senses: Sequence[Sense],
        j: int,
        gravity: FloatArray | None = None,
        order: Sequence[int] | None = None,
    ) -> tuple[float, float]:
        """Squared share of the efforts that is left, with joint j's effort as it is and turned.

        `gravity` (3,) [m/s^2] in place of the described one; `order`: the columns of each joint.
        """
        sign, shift = np.array([(x.sign, x.shift) for x in senses]).T
        taken = list(order or range(self._d))
        q, v, a = (x[:, taken] for x in self._states)
        tree, states = self._robot.tree, (q * sign + shift, v * sign, a * sign)
        if tree is None or gravity is None:
            y = self._robot.regressor(*states)
        else:
            y = replace(tree, gravity=gravity).regressor(*states) @ tree.spread
        parts = [_beside(y[r.at, taken.index(r.j)] / r.size, r.own) for r in self._rows]
        size = np.sqrt(np.sum([np.sum(x**2, axis=0) for x in parts], axis=0))
        parts = [x / np.maximum(size, 1e-300) for x in parts]
        values, vectors = np.linalg.eigh(np.sum([x.T @ x for x in parts], axis=0))
        known = values > SAME * values[-1]
        pull = {r.j: x.T @ r.y for r, x in zip(self._rows, parts, strict=True)}
        others = sum((senses[k].effort * c for k, c in pull.items() if k != j), 0.0 * pull[j])
        whole = sum(float(r.y @ r.y) for r in self._rows)
        as_it_is, turned = (
            whole - float(np.sum((vectors.T[known] @ c) ** 2 / values[known]))
            for c in (others + pull[j], others - pull[j])
        )
        return as_it_is, turned

    def order(self) -> list[int]:
        """Columns of each joint that leave least: two joints exchanged, then two others."""
        as_read, now = [Sense() for _ in range(self._d)], list(range(self._d))
        if len(self._rows) < 2:
            return now

        def left(order: list[int]) -> float:
            return self.left(as_read, self._rows[0].j, order=order)[0]

        for _ in self._rows[1:]:
            tried = [_exchanged(now, a, b) for a, b in combinations(range(self._d), 2)]
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
            return self.left(as_read, j, g)[0]

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

    def best(self) -> list[Sense]:
        """Senses of all joints that leave least: the joint that helps most first, then the next."""
        senses = [Sense() for _ in range(self._d)]
        for _ in self._rows:
            now = self.left(senses, self._rows[0].j)[0]
            found = [(*self._of_one(senses, r.j), r.j) for r in self._rows]
            left, sense, j = min(found, key=lambda x: x[0])
            if left > WHOLE * now:
                break
            senses[j] = sense
        return senses

    def _of_one(self, senses: Sequence[Sense], j: int) -> tuple[float, Sense]:
        """What the best sense of one joint leaves, and that sense; the others keep theirs."""

        def left(sign: float, shift: float) -> tuple[float, Sense]:
            now = [Sense(sign, shift) if k == j else x for k, x in enumerate(senses)]
            as_it_is, turned = self.left(now, j)
            return min(as_it_is, turned), Sense(sign, shift, 1.0 if as_it_is <= turned else -1.0)

        turns, step = self._robot.units[j] == "rad", 2 * np.pi / STEPS
        shifts = step * np.arange(STEPS) if turns else np.zeros(1)
        least, best = min(
            (left(sign, float(z)) for sign in (1.0, -1.0) for z in shifts), key=lambda x: x[0]
        )
        if not turns or least > WHOLE * self.left(senses, j)[senses[j].effort < 0]:
            return least, best
        found = scipy.optimize.minimize_scalar(
            lambda z: left(best.sign, float(z))[0],
            bounds=(best.shift - step, best.shift + step),
            method="bounded",
        )
        least = float(found.fun)
        # a quarter of a turn, or none, where the motion shows no finer angle
        near = left(best.sign, np.pi / 2 * round(float(found.x) / (np.pi / 2)))
        if near[0] > (1 + WORTH) * least:
            near = left(best.sign, float(found.x))
        shift = float((near[1].shift + np.pi) % (2 * np.pi) - np.pi)
        return near[0], replace(near[1], shift=shift)


def _exchanged(order: list[int], a: int, b: int) -> list[int]:
    """An order with two places exchanged."""
    return [order[b] if k == a else order[a] if k == b else x for k, x in enumerate(order)]


def _beside(x: FloatArray, q: FloatArray) -> FloatArray:
    """What orthonormal columns leave of others."""
    out: FloatArray = x - q @ (q.T @ x)
    return out


@dataclass(frozen=True)
class _Reading:
    """The runs read in another way: code, sentence, the share of the error that may stay."""

    runs: list[Recording]
    robot: RobotSource
    code: str
    text: str
    share: float


def _other_posture(result: FitResult, recordings: list[Recording]) -> list[tuple[float, str, str]]:
    """Error [%], code and sentence of postures that fit in another way; none where none does."""
    if isinstance(result.problem.robot, IndependentAxes) or result.problem.d < 2:
        return []
    before, out = _size(result), []
    for x in _readings(result, recordings):
        model = replace(result.model, robot=x.robot)
        after = fit(_again(result, x.runs, x.robot), model, sweeps=1)
        if _fits(after, before, x.share):
            left = f"{before:.3g} to {_size(after):.3g} % of the effort"
            said = f"{x.text}, and import again: the model's error falls from {left}"
            out.append((_size(after), x.code, said))
    return out


def _readings(result: FitResult, recordings: list[Recording]) -> Iterator[_Reading]:
    """Other orders and senses of the joints, and another gravity, that promise less error."""
    postures, joints, robot = Postures(result), result.problem.joints, result.problem.source
    order, senses, gravity = postures.order(), postures.best(), postures.gravity()
    if order != sorted(order):
        runs = [_ordered(r, order) for r in recordings]
        yield _Reading(runs, robot, "order", _of_order(joints, order), OPEN)
    if any(x != Sense() for x in senses):
        columns = np.array([(x.sign, x.shift, x.effort) for x in senses]).T
        runs = [_read(r, *columns) for r in recordings]
        # a quarter of a turn is no chance: what other effects leave may be half of the square then
        turns = np.array([x.shift for x in senses]) / (np.pi / 2)
        share = HALF**0.5 if np.all(turns == np.round(turns)) else OPEN
        yield _Reading(runs, robot, "posture", _of_senses(result.problem, senses), share)
    if gravity is not None:
        numbers = " ".join(f"{x:.3g}" for x in gravity + 0.0)
        text = (
            f"gravity does not act as the robot description says. Write <gravity>{numbers}"
            "</gravity> within <robot> of the URDF"
        )
        yield _Reading(recordings, _in_gravity(robot, gravity), GRAVITY, text, OPEN)


def _ordered(r: Recording, order: list[int]) -> Recording:
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


def _of_senses(problem: Problem, senses: Sequence[Sense]) -> str:
    """What a map says of joints that are counted in another sense."""
    rows = zip(problem.joints, problem.robot.units, senses, strict=True)
    said = [
        f"q{k + 1} ({joint}): {_in_words(x, unit)}"
        for k, (joint, unit, x) in enumerate(rows)
        if x != Sense()
    ]
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
    return " and ".join(parts) + (", and sign = -1 for its effort" if x.effort < 0 else "")
