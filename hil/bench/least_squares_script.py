"""What a person's forty lines reach: greedy least squares on hand-made features.

The yardstick of `hil bench real`: rows and band are those of `hil.identify`, everything else is
plain numpy.  Features are chosen joint by joint on the training runs alone, by the error of runs
left out (fifths of a single run); then all is fitted once and shown the held-out runs once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray
from scipy.signal import lfilter

from hil.identify.problem import Problem
from hil.models import catalogue
from hil.models.kernels import slip_state
from hil.models.motion import Motion
from hil.record.recording import Recording, RobotSource
from hil.work import single_threaded

FloatArray = NDArray[np.float64]
#: Motion of a run and rigid-body effort (n, d) to columns (n, k).
FeatureFunction = Callable[[Motion, FloatArray], FloatArray]
NamedFeatures = Iterator[tuple[str, FeatureFunction]]
#: A little beyond the range of the training runs polynomials stay where they end.
_BEYOND = 1.05


@dataclass(frozen=True)
class Scales:
    """Scales of the training runs.

    Parameters
    ----------
    centre, half : ndarray (d,)
        Middle of each joint's range and half its width [rad or m].
    slow : ndarray (d,)
        Speed below which a sign is soft [rad/s or m/s].
    speed : ndarray (d,)
        Rms speed [rad/s or m/s].
    loaded : bool
        Whether an external effort was measured.
    """

    centre: FloatArray
    half: FloatArray
    slow: FloatArray
    speed: FloatArray
    loaded: bool

    @classmethod
    def of(cls, train: Problem) -> Scales:
        """Scales of the runs of a problem."""
        span, speeds = train.span, np.concatenate([m.qd for m in train.motions])
        return cls(
            centre=span.mean(axis=1),
            half=np.maximum(np.ptp(span, axis=1) / 2, 1e-9),
            slow=train.motions[0].v0,
            speed=np.sqrt(np.mean(speeds**2, axis=0)),
            loaded=any(bool(np.any(m.tau_ext)) for m in train.motions),
        )

    def place(self, m: Motion, j: int) -> FloatArray:
        """Position of joint j, -1 to 1 over its range (n,)."""
        x: FloatArray = np.clip((m.q[:, j] - self.centre[j]) / self.half[j], -_BEYOND, _BEYOND)
        return x

    def sign(self, m: Motion, j: int) -> FloatArray:
        """Soft sign of joint j's speed (n,)."""
        return np.asarray(np.tanh(m.qd[:, j] / self.slow[j]))

    def slip(self, m: Motion, j: int, share: float) -> FloatArray:
        """State of a spring that slips after a share of joint j's range (n,)."""
        width = share * 2 * float(self.half[j])
        return np.asarray(slip_state(np.ascontiguousarray(m.q[:, j]), width))

    def power(self, m: Motion, j: int, degree: int) -> FloatArray:
        """Chebyshev polynomials 1 to `degree` of joint j's position (n, degree)."""
        return np.asarray(chebvander(self.place(m, j), degree)[:, 1:])


def motor(s: Scales, j: int) -> dict[str, FeatureFunction]:
    """Features of the motor's effort on joint j, by name, in the order in which they are tried."""
    parts = (_place(s, j), _slip(s, j), _speed(s, j), _stop(s, j), _load(s, j), _others(s, j))
    return {name: feature for part in parts for name, feature in part}


def external(s: Scales, j: int) -> dict[str, FeatureFunction]:
    """Features of what an object does to joint j: of its position and speed alone."""
    parts = (_place(s, j), _slip(s, j), _speed(s, j), _stop(s, j), _object(s, j))
    return {name: feature for part in parts for name, feature in part}


def columns(*parts: FloatArray) -> FloatArray:
    """Columns (n,) each beside each other (n, k)."""
    return np.stack(parts, axis=1)


def _place(s: Scales, j: int) -> NamedFeatures:
    """What depends on where the joint is: unbalanced mass, cogging, cables, springs."""
    for n in (1, 3, 6):
        yield f"poly{n}", _poly(s, j, n)
    yield "sincos", lambda m, _: columns(np.sin(m.q[:, j]), np.cos(m.q[:, j]))


def _poly(s: Scales, j: int, degree: int) -> FeatureFunction:
    return lambda m, _: s.power(m, j, degree)


def _slip(s: Scales, j: int) -> NamedFeatures:
    """Hysteresis: three springs that slip one after the other, and friction by place."""
    for share in (0.001, 0.003, 0.01, 0.03):
        yield f"slip{share}", _slips(s, j, share)
    yield "dirpoly", lambda m, _: s.sign(m, j)[:, None] * s.power(m, j, 3)
    yield "slip*poly", lambda m, _: s.slip(m, j, 0.01)[:, None] * s.power(m, j, 3)


def _slips(s: Scales, j: int, share: float) -> FeatureFunction:
    return lambda m, _: columns(*(s.slip(m, j, k * share) for k in (1, 3, 9)))


def _speed(s: Scales, j: int) -> NamedFeatures:
    """Curves of friction over speed, by direction and place."""
    for share in (0.03, 0.1, 0.3):
        yield f"stribeck{share}", _stribeck(s, j, share * float(s.speed[j]))
    yield "asym", lambda m, _: columns(np.abs(m.qd[:, j]), np.abs(s.sign(m, j)))
    yield "curve", partial(_curve, s, j)
    yield "viscous(q)", partial(_viscous, s, j)


def _stribeck(s: Scales, j: int, width: float) -> FeatureFunction:
    return lambda m, _: columns(np.exp(-((m.qd[:, j] / width) ** 2)) * s.sign(m, j))


def _curve(s: Scales, j: int, m: Motion, _: FloatArray) -> FloatArray:
    v = m.qd[:, j]
    return columns(v * np.abs(v), np.sqrt(np.abs(v)) * s.sign(m, j))


def _viscous(s: Scales, j: int, m: Motion, _: FloatArray) -> FloatArray:
    v, x = m.qd[:, j], s.place(m, j)
    return columns(v * x, v * x**2)


def _stop(s: Scales, j: int) -> NamedFeatures:
    """Soft stops near the ends of the range."""
    for share in (0.9, 0.95, 0.98):
        yield f"stop{share}", _ends(s, j, share)


def _ends(s: Scales, j: int, share: float) -> FeatureFunction:
    def feature(m: Motion, _: FloatArray) -> FloatArray:
        x = s.place(m, j)
        return columns(np.maximum(0, x - share), np.minimum(0, x + share))

    return feature


def _load(s: Scales, j: int) -> NamedFeatures:
    """Friction that grows with the load, and the ratio of a measured load."""
    if s.loaded:
        yield "extgain", lambda m, _: m.tau_ext[:, j : j + 1]
    yield "load*sgn", lambda m, load: columns(np.abs(load[:, j]) * s.sign(m, j))
    yield "load*slip", partial(_load_slip, s, j)


def _load_slip(s: Scales, j: int, m: Motion, load: FloatArray) -> FloatArray:
    slips = (s.slip(m, j, share) for share in (0.003, 0.01, 0.03))
    return np.abs(load[:, j : j + 1]) * columns(s.sign(m, j), *slips)


def _others(s: Scales, j: int) -> NamedFeatures:
    """What another joint does to this one: coupled transmissions, cables across it."""
    for i in (i for i in range(s.half.size) if i != j):
        yield f"couple{i + 1}", partial(_coupled, s, i)
        for ratio in (1, -1):
            yield f"rel{i + 1}{ratio:+d}", _relative(s, j, i, ratio)
        yield f"poly3q{i + 1}", _poly(s, i, 3)


def _coupled(s: Scales, i: int, m: Motion, _: FloatArray) -> FloatArray:
    return columns(m.qd[:, i], s.sign(m, i), m.qdd[:, i])


def _relative(s: Scales, j: int, i: int, ratio: int) -> FeatureFunction:
    def feature(m: Motion, _: FloatArray) -> FloatArray:
        v, a = (x[:, j] + ratio * x[:, i] for x in (m.qd, m.qdd))
        return columns(v, np.tanh(v / s.slow[j]), a)

    return feature


def _object(s: Scales, j: int) -> NamedFeatures:
    """What an object does: a damper, a damper with a spring in series, where contact begins."""
    yield "viscous", lambda m, _: m.qd[:, j : j + 1]
    for seconds in (0.03, 0.1, 0.3):
        yield f"maxwell{seconds}", _maxwell(j, seconds)
    for share in (-0.6, -0.2, 0.2, 0.6):
        yield f"onset{share}", _onset(s, j, share)


def _maxwell(j: int, seconds: float) -> FeatureFunction:
    return lambda m, _: columns(_relaxing(m, j, seconds))


def _onset(s: Scales, j: int, share: float) -> FeatureFunction:
    return lambda m, _: columns(np.maximum(0, s.place(m, j) - share))


def _relaxing(m: Motion, j: int, seconds: float) -> FloatArray:
    """Deflection of a spring behind a damper: its own speed is q's less its deflection / T (n,)."""
    keep = float(np.exp(-m.dt / seconds))
    steps = np.diff(m.q[:, j], prepend=m.q[:1, j])
    return np.asarray(lfilter([keep], [1.0, -keep], steps))


#: A feature stays if it takes this share of the left-out error of its joint.
_WORTH = 0.03
_PASSES = 5
_FOLDS = 5
#: So many runs are left out one by one; fewer are cut into fifths.
_RUNS = 3
#: Shares of the diagonal of the normal equations that are tried with several joints.
_RIDGES = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
_RIDGE_OF_ONE = 1e-9
#: A column of this share of the largest one is rounding.
_NOTHING = 1e-9
#: With more joints a feature is first sized up on its own joint's rows.
_MANY = 3


@dataclass(frozen=True)
class Person:
    """Outcome of the script.

    Parameters
    ----------
    given, final : ndarray (d,)
        Held-out relative error of each joint [%], before and after the features.
    holds : ndarray (d,) of bool
        Joints that only hold their place; their errors do not count.
    chosen : tuple of tuple of str
        Features by joint, in the order in which they were taken.
    ridge : float
        Share of the diagonal that was added.
    """

    given: FloatArray
    final: FloatArray
    holds: NDArray[np.bool_]
    chosen: tuple[tuple[str, ...], ...]
    ridge: float


class Side:
    """Rows of some runs and the columns of each joint so far.

    Attributes
    ----------
    shared : ndarray (d, n, m)
        Columns whose coefficients all joints share: the rigid body's.
    own : list of ndarray (n, k)
        Columns of each joint by itself.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.load = [np.zeros_like(m.q) for m in problem.motions]
        if problem.explains == "motor":
            body = problem.columns(catalogue.get("rigid-body"), 0, ())
            self.shared = body if body.ndim == 3 else body[None]
            start = _friction
        else:
            self.shared = np.zeros((problem.d, problem.n, 0))
            start = _spring
        self.own = [self.rows(partial(start, j=j), j) for j in range(problem.d)]

    def rows(self, feature: FeatureFunction, j: int) -> FloatArray:
        """Columns (n, k) of a feature as the rows of joint j see it."""
        runs = zip(self.problem.motions, self.load, strict=True)
        return self.problem.gated([feature(m, load) for m, load in runs], j)

    def take_load(self, theta: FloatArray) -> None:
        """Effort of the rigid body at every instant of the runs, less the external one."""
        if not self.shared.shape[2]:
            return
        raw = self.problem.raw(catalogue.get("rigid-body"), 0, ())
        body = [x if x.ndim == 3 else x[:, None, :] for x in raw]
        runs = zip(body, self.problem.motions, strict=True)
        self.load = [x @ theta[: x.shape[2]] - m.tau_ext for x, m in runs]

    def with_(self, j: int, more: FloatArray) -> list[FloatArray]:
        """Columns of every joint, `more` beside those of joint j."""
        joints = range(self.problem.d)
        return [np.concatenate([self.own[k], more], 1) if k == j else self.own[k] for k in joints]

    def residual(self, theta: FloatArray) -> FloatArray:
        """What the coefficients leave of the target (d, n)."""
        places = _places(self.shared.shape[2], self.own)
        left = [
            y - np.concatenate([shared, own], axis=1) @ theta[at]
            for y, shared, own, at in zip(
                self.problem.y, self.shared, self.own, places, strict=True
            )
        ]
        return np.stack(left)


class Script:
    """Least squares over all joints on the training runs, with its left-out error."""

    def __init__(self, side: Side) -> None:
        problem = side.problem
        self.side, self.y = side, problem.y
        self.fold = problem.run if len(problem.motions) >= _RUNS else _fifths(problem.n)
        self.folds = int(self.fold.max()) + 1
        self.sigma = np.maximum(problem.y.std(axis=1), 1e-12)
        self.moving = ~problem.holds
        self.size = np.maximum(problem.rms(problem.effort), 1e-12)
        self.ridge = _RIDGE_OF_ONE
        if problem.d > 1:
            self.ridge = min(_RIDGES, key=self._error_with)

    def _error_with(self, ridge: float) -> float:
        self.ridge = ridge
        parts = self.left_out(self.side.own) / self.size
        return float(np.sum(parts[self.moving] ** 2))

    def solve(self, own: list[FloatArray]) -> FloatArray:
        """Coefficients (p,) from all rows."""
        gram, moment = self._normal(own)
        return _solve(gram.sum(axis=0), moment.sum(axis=0), _scale(gram.sum(axis=0)), self.ridge)

    def left_out(self, own: list[FloatArray]) -> FloatArray:
        """Rms error of each joint (d,) on each fold, coefficients from the others."""
        gram, moment = self._normal(own)
        scale, places = _scale(gram.sum(axis=0)), _places(self.side.shared.shape[2], own)
        whole, right, error = gram.sum(axis=0), moment.sum(axis=0), np.zeros(len(own))
        for f in range(self.folds):
            theta = _solve(whole - gram[f], right - moment[f], scale, self.ridge)
            rows = self.fold == f
            for j, at in enumerate(places):
                columns = np.concatenate([self.side.shared[j], own[j]], axis=1)[rows]
                error[j] += np.sum((self.y[j][rows] - columns @ theta[at]) ** 2)
        out: FloatArray = np.sqrt(error / self.side.problem.count)
        return out

    def left_out_alone(self, j: int, more: FloatArray) -> float:
        """Rms error of joint j with further columns, on its own rows alone: quick."""
        x = np.concatenate([self.side.shared[j], self.side.own[j], more], axis=1)
        parts = [(x[self.fold == f], self.y[j][self.fold == f]) for f in range(self.folds)]
        gram, moment = np.stack([a.T @ a for a, _ in parts]), np.stack([a.T @ b for a, b in parts])
        whole, right = gram.sum(axis=0), moment.sum(axis=0)
        scale = _scale(whole)
        thetas = [
            _solve(whole - g, right - r, scale, self.ridge)
            for g, r in zip(gram, moment, strict=True)
        ]
        error = sum(
            float(np.sum((b - a @ t) ** 2)) for (a, b), t in zip(parts, thetas, strict=True)
        )
        return float(np.sqrt(error / self.side.problem.count[j]))

    def best(
        self, j: int, now: float, pool: dict[str, FeatureFunction]
    ) -> tuple[str, FloatArray] | None:
        """The feature with the least left-out error of joint j below `now`, and its rows."""
        best, found = now, None
        for name, feature in pool.items():
            rows = self.side.rows(feature, j)
            if self.side.problem.d > _MANY:
                error = self.left_out_alone(j, rows)
            else:
                error = float(self.left_out(self.side.with_(j, rows))[j])
            if error < best:
                best, found = error, (name, rows)
        return found

    def _normal(self, own: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Normal equations of each fold: (folds, p, p) and (folds, p)."""
        places = _places(self.side.shared.shape[2], own)
        p = 1 + max((int(at.max()) for at in places if at.size), default=-1)
        gram, moment = np.zeros((self.folds, p, p)), np.zeros((self.folds, p))
        for j, at in enumerate(places):
            x = np.concatenate([self.side.shared[j], own[j]], axis=1) / self.sigma[j]
            y = self.y[j] / self.sigma[j]
            for f in range(self.folds):
                rows = self.fold == f
                gram[f][np.ix_(at, at)] += x[rows].T @ x[rows]
                moment[f][at] += x[rows].T @ y[rows]
        return gram, moment


@single_threaded
def cross_validated(
    train: list[Recording], hold: list[Recording], robot: RobotSource, explains: str = "motor"
) -> Person:
    """Choose features on the training runs, fit once, and show the held-out runs once.

    Parameters
    ----------
    train, hold : list of Recording
        Runs to fit and runs to judge on.
    robot : RobotSource
        The robot.
    explains : str
        ``"motor"``: rigid body, friction and an offset to begin with; ``"external"``: a spring
        and an offset.

    Returns
    -------
    Person
        Errors and features.
    """
    fitted = Problem(train, robot, explains)
    other = Problem(hold, robot, explains, rates=fitted.rates, span=fitted.span)
    other.set_context(v0=fitted.motions[0].v0)
    side, judged = Side(fitted), Side(other)
    script = Script(side)
    theta = script.solve(side.own)
    size = np.maximum(other.rms(other.effort), 1e-12)
    given = 100 * other.rms(judged.residual(theta)) / size
    side.take_load(theta)
    judged.take_load(theta)
    chosen = _choose(script, judged)
    final = 100 * other.rms(judged.residual(script.solve(side.own))) / size
    return Person(given, final, fitted.holds, chosen, script.ridge)


def _choose(script: Script, judged: Side) -> tuple[tuple[str, ...], ...]:
    """Add features to both sides while they pay; the judged side is given their columns only."""
    side, d = script.side, script.side.problem.d
    make = motor if side.problem.explains == "motor" else external
    pools = [make(Scales.of(side.problem), j) for j in range(d)]
    chosen: list[list[str]] = [[] for _ in range(d)]
    error = script.left_out(side.own)
    for _ in range(_PASSES):
        gained = False
        for j in map(int, np.flatnonzero(script.moving)):
            left = {k: f for k, f in pools[j].items() if k not in chosen[j]}
            found = script.best(j, float(error[j]), left)
            if found is None:
                continue
            trial = side.with_(j, found[1])
            after = script.left_out(trial)
            if after[j] < (1 - _WORTH) * error[j]:
                side.own, error, gained = trial, after, True
                judged.own = judged.with_(j, judged.rows(pools[j][found[0]], j))
                chosen[j].append(found[0])
        if not gained:
            break
    return tuple(tuple(names) for names in chosen)


def _friction(m: Motion, _: FloatArray, j: int) -> FloatArray:
    """Rotor inertia, viscous and Coulomb friction and an offset of joint j (n, 4)."""
    v = m.qd[:, j]
    return columns(m.qdd[:, j], v, np.tanh(v / m.v0[j]), np.ones(m.n))


def _spring(m: Motion, _: FloatArray, j: int) -> FloatArray:
    """A spring and an offset at joint j (n, 2)."""
    return columns(m.q[:, j], np.ones(m.n))


def _places(shared: int, own: list[FloatArray]) -> list[NDArray[np.int_]]:
    """Where the coefficients of each joint stand: the shared ones first, then joint by joint."""
    ends = shared + np.cumsum([0, *(x.shape[1] for x in own)])
    return [np.r_[0:shared, a:b] for a, b in pairwise(ends)]


def _fifths(n: int) -> NDArray[np.int_]:
    """Labels of contiguous fifths (n,)."""
    out: NDArray[np.int_] = np.arange(n) * _FOLDS // n
    return out


def _scale(gram: FloatArray) -> FloatArray:
    """What makes the diagonal one (p,), and leaves columns of nothing but rounding out."""
    power = np.diag(gram)
    there = power > _NOTHING**2 * power.max(initial=1e-30)
    return np.where(there, 1 / np.sqrt(np.where(there, power, 1.0)), 0.0)


def _solve(gram: FloatArray, moment: FloatArray, scale: FloatArray, ridge: float) -> FloatArray:
    """Coefficients of normal equations with a ridge on the scaled diagonal (p,)."""
    scaled = gram * scale[:, None] * scale + ridge * np.eye(scale.size)
    out: FloatArray = scale * np.linalg.solve(scaled, scale * moment)
    return out
