"""Gauss-Newton on the simulated motion: many fits of one model at once.

With z the free directions of a fitted model in units of their standard errors, a task's cost is

    C(z) = mean_w rho(u_w^2) + pull^2 |z - centre|^2,    rho(x) = 2 (sqrt(1 + x) - 1),
    u_w^2 = min_o  mean_t,j (e_w(z) - A_w o)^2 / s_j^2 + |o|^2,

e_w the position error of window w, A_w what a standard error of its first position or speed does
to it, and s_j joint j's error before.  rho counts a window that goes wrong (a joint that sticks in
one and not in the other) by its size and not by its square.  Derivatives are differences over one
and over several standard errors, for friction makes the cost rough; steps of both are tried, of
several dampings, and some at random.  All models that differ are simulated abreast, and all tasks
step together.

Source: Bock, Randwertproblemmethoden zur Parameteridentifizierung, 1987 (multiple shooting);
Ljung, System Identification, 2nd ed., 1999, section 7.2 (output error).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.identify.context import carrying
from hil.identify.design import Term, prefix
from hil.identify.multistep import Windows, forward
from hil.identify.problem import Problem
from hil.identify.regression import least_squares
from hil.identify.result import FitResult
from hil.identify.solve import limits
from hil.models.effect import continuous

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int_]
#: Difference steps, in standard errors: a law with kinks has another slope from afar.
STRIDES = (1.0, 8.0)
#: Trials drawn at random about the model, for a cost with kinks has hollows.
DRAWN = 8
#: Instants of a window that count.
INSTANTS = 100
#: Numbers that one simulation keeps at most: models times windows times instants times joints.
STATE_ROOM = 10_000_000
#: Damping that is tried at once, in the present one.
TRIED = (0.01, 0.3, 10.0, 300.0)
#: Relative fall of the cost that is worth another step.
STEP_FALL = 2e-3
#: Steps without one after which a task ends.
PATIENCE = 3


class Coordinates:
    """Free directions z of a fitted model: theta = theta_0 + T z, first shape values s_0 + e z.

    With the weighted regressor X = Q S V' D of the one-step fit,  T = g D^-1 V S^-1,  whose columns
    are standard errors of independent directions; g makes those of white residuals the honest
    ones of the fit.  What the one-step fit does not determine stays; bounds clip.

    Parameters
    ----------
    result : FitResult
        The one-step fit.
    """

    def __init__(self, result: FitResult) -> None:
        self.result, b = result, result.basis
        t = b.v / b.s / b.scale[:, None]
        white = np.linalg.norm(t, axis=1)
        told = np.array([result.values[name].stderr for name in result.names])
        known = np.isfinite(told) & (white > 0) & (told > 0)
        ratio = float(np.median(told[known] / white[known])) if known.any() else 1.0
        self._t = max(ratio, 1.0) * t
        self._low, self._high = limits(result.terms, result.problem)
        self._shapes = [k for k, t in enumerate(result.terms) if np.isfinite(_error(result, t))]

    @property
    def size(self) -> int:
        """Number of directions."""
        return int(self._t.shape[1]) + len(self._shapes)

    def at(self, z: FloatArray) -> FitResult:
        """The model at z (size,); values, residual and errors are still those of the fit."""
        count = self._t.shape[1]
        # theta = theta_0 + T z
        moved = self.result.theta + self._t @ z[:count]
        theta = np.clip(moved, self._low, self._high)
        terms = list(self.result.terms)
        for k, part in zip(self._shapes, z[count:], strict=True):
            own = terms[k].effect.shape[0]
            first = terms[k].shape[0] + part * _error(self.result, terms[k])
            value = float(np.clip(first, own.lower, own.upper))
            terms[k] = terms[k].reshaped((value, *terms[k].shape[1:]))
        return replace(self.result, theta=theta, terms=terms)

    def one_step(self, rows: NDArray[np.bool_]) -> FloatArray:
        """Where least squares of the one-step error on some rows (n,) lies: z (size,)."""
        r, d, n = self.result, self.result.problem.d, self.result.problem.n
        x = r.x.reshape(d, n, -1)[:, rows] / r.sigma[:, None, None]
        y = (r.residual[:, rows] / r.sigma[:, None]).reshape(-1)
        count = self._t.shape[1]
        z = least_squares(x.reshape(y.size, -1) @ self._t, y, 1e-6)
        return np.concatenate([z, np.zeros(self.size - count)])

    def shapes(self, moved: FitResult) -> dict[str, float]:
        """First shape values that are free, by name, of a model of `at`."""
        return {
            _shape_name(self.result, moved.terms[k]): moved.terms[k].shape[0] for k in self._shapes
        }

    def errors(self, cov: FloatArray) -> dict[str, float]:
        """Standard errors by name, of a covariance of z (size, size)."""
        count = self._t.shape[1]
        # cov theta = T cov z T'
        spread = np.sqrt(np.einsum("ik,kl,il->i", self._t, cov[:count, :count], self._t))
        out = dict(zip(self.result.names, map(float, spread), strict=True))
        for k, place in enumerate(self._shapes, count):
            term = self.result.terms[place]
            name = _shape_name(self.result, term)
            out[name] = float(np.sqrt(cov[k, k])) * _error(self.result, term)
        return out


def _shape_name(result: FitResult, term: Term) -> str:
    """Full name of a term's first shape value."""
    return f"{prefix(term, result.problem.joints)}.{term.effect.shape[0].name}"


def _error(result: FitResult, term: Term) -> float:
    """Standard error of a term's first shape value; NaN where it stays as it is."""
    if term.fixed_shape or term.fixed or not continuous(term.effect):
        return float("nan")
    known = result.values[_shape_name(result, term)]
    return known.stderr if known.identifiable and not known.at_bound else float("nan")


@dataclass
class Task:
    """One fit on the simulated motion.

    Parameters
    ----------
    starts : list of ndarray of int
        First instants of its windows, run by run.
    horizon : int
        Instants of each window.
    pull : float
        Weight of one standard error of distance from `centre`.
    centre : ndarray (size,)
        The one-step fit of the same data, where it starts.
    scale : ndarray (d,)
        Unit of each joint's error [rad or m].
    """

    starts: list[IntArray]
    horizon: int
    pull: float
    centre: FloatArray
    scale: FloatArray
    z: FloatArray = field(init=False)
    cost: float = field(init=False, default=np.inf)
    done: bool = field(init=False, default=False)
    damping: float = field(init=False, default=0.1)
    #: Steps tried, and how many of the last ones brought nothing.
    taken: int = field(init=False, default=0)
    idle: int = field(init=False, default=0)
    #: Curvature of the cost (size, size) where it was last taken, without the pull.
    curvature: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.z = self.centre.copy()
        self.curvature = np.zeros((self.z.size, self.z.size))


@dataclass(frozen=True)
class Asked:
    """One model to simulate: windows as in `Task`; `offset` (2, d) is added to their first states.

    `every`: each how manieth instant is kept; 0 = some `INSTANTS` of a window.
    """

    result: FitResult
    starts: list[IntArray]
    horizon: int
    offset: FloatArray | None = None
    every: int = 0


class Simulator:
    """Position errors of models over windows of the runs of a problem.

    Parameters
    ----------
    problem : Problem
        The runs.
    result : FitResult
        The fit whose load the models carry.
    """

    def __init__(self, problem: Problem, result: FitResult) -> None:
        self.problem = problem
        self._carried = carrying(result, problem)
        self._span = np.ptp(problem.span, axis=1)

    def __call__(self, asked: Sequence[Asked]) -> list[FloatArray]:
        """Errors (windows, some instants, d), at most the recorded span [rad or m]."""
        out: list[FloatArray] = []
        batch: list[Asked] = []
        for a in asked:
            longest = max(b.horizon for b in [*batch, a])
            rows = sum(s.size for b in [*batch, a] for s in b.starts)
            if batch and rows * longest * self.problem.d > STATE_ROOM:
                out += self._batch(batch)
                batch = []
            batch.append(a)
        return out + self._batch(batch)

    def _batch(self, asked: list[Asked]) -> list[FloatArray]:
        found: list[list[FloatArray]] = [[] for _ in asked]
        for i, motion in enumerate(self.problem.motions):
            jobs = {k: self._job(a, i) for k, a in enumerate(asked) if a.starts[i].size}
            if not jobs:
                continue
            for k, (error, _) in zip(jobs, forward(motion, list(jobs.values())), strict=True):
                step = asked[k].every or max(1, asked[k].horizon // INSTANTS)
                found[k].append(self._clipped(error[:, step - 1 :: step]))
        none = np.zeros((0, 1, self.problem.d))
        return [np.concatenate(parts) if parts else none for parts in found]

    def _job(self, a: Asked, run: int) -> Windows:
        starts, offset = a.starts[run], a.offset
        if offset is not None:
            offset = np.repeat(offset[:, None], starts.size, axis=1)
        return Windows(a.result, starts, a.horizon, motion=self._carried[run], offset=offset)

    def _clipped(self, error: FloatArray) -> FloatArray:
        """Errors within the recorded span: what left it is lost, however far it goes."""
        lost = np.where(np.isfinite(error), error, np.inf)
        return np.clip(lost, -self._span, self._span)

    def uncertain(self) -> FloatArray:
        """Standard errors (2, d) of measured positions and speeds after the filter.

        s_v = s_q 2 pi f_c sqrt(2 f_c / (3 f_s)) for white noise s_q up to the cut-off f_c.
        """
        grains = [m.grain for m in self.problem.motions if m.grain.size]
        tiny = 1e-9 * self._span + 1e-15
        sigma = np.maximum(np.max(grains, axis=0) / np.sqrt(12), tiny) if grains else tiny
        rate, cut = 1 / self.problem.motions[0].dt, self.problem.rates.position
        speed = sigma * 2 * np.pi * cut * np.sqrt(2 * cut / (3 * rate))
        return np.stack([sigma, speed])


def descend(where: Coordinates, simulator: Simulator, tasks: Sequence[Task], steps: int) -> None:
    """Bring all tasks to their optimum, or some steps nearer to it."""
    first = [Asked(where.at(t.z), t.starts, t.horizon) for t in tasks]
    errors = simulator(first)
    for _ in range(steps):
        active = [k for k, t in enumerate(tasks) if not t.done]
        if not active:
            return
        locals_ = _linear(where, simulator, [tasks[k] for k in active], [errors[k] for k in active])
        trials = [tasks[k].z + s for k, a in zip(active, locals_, strict=True) for s in a.steps]
        owners = [k for k, a in zip(active, locals_, strict=True) for _ in a.steps]
        asked = [
            Asked(where.at(z), tasks[k].starts, tasks[k].horizon)
            for z, k in zip(trials, owners, strict=True)
        ]
        found = simulator(asked)
        for n, (k, near) in enumerate(zip(active, locals_, strict=True)):
            own = slice(n * len(near.steps), (n + 1) * len(near.steps))
            best = _taken(tasks[k], near, trials[own], found[own])
            errors[k] = errors[k] if best is None else best


@dataclass(frozen=True)
class _Local:
    """What is known about a task's cost near its z."""

    steps: list[FloatArray]
    offsets: FloatArray


def _weighted(error: FloatArray, task: Task) -> FloatArray:
    """Errors (windows, m) in the task's units, so that their sum of squares is a mean."""
    w, m, d = error.shape
    out: FloatArray = (error / task.scale / np.sqrt(m * d)).reshape(w, m * d)
    return out


def _left(r: FloatArray, offsets: FloatArray) -> FloatArray:
    """What first states cannot explain: r - A (A'A + 1)^-1 A' r, for r (w, m, k), A (w, m, o)."""
    turned = np.swapaxes(offsets, 1, 2)
    gram = turned @ offsets + np.eye(offsets.shape[2])
    out: FloatArray = r - offsets @ np.linalg.solve(gram, turned @ r)
    return out


def _cost(r: FloatArray, near: FloatArray, task: Task, z: FloatArray) -> float:
    """C(z) of weighted errors r (w, m)."""
    # u^2 = r' (r - A (A'A + 1)^-1 A' r)
    square = np.einsum("wm,wm->w", r, _left(r[..., None], near)[..., 0])
    far = task.pull**2 * float(np.sum((z - task.centre) ** 2))
    return float(np.mean(2 * (np.sqrt(1 + np.maximum(square, 0)) - 1))) + far


def _linear(
    where: Coordinates, simulator: Simulator, tasks: list[Task], errors: list[FloatArray]
) -> list[_Local]:
    """Steps to try, for every task."""
    asked = [a for t in tasks for a in _around(where, simulator, t)]
    found, n = simulator(asked), where.size
    width = len(asked) // len(tasks)
    out = []
    for k, (t, error) in enumerate(zip(tasks, errors, strict=True)):
        r = _weighted(error, t)
        moved = np.stack([_weighted(e, t) - r for e in found[k * width : (k + 1) * width]], axis=-1)
        offsets = moved[..., len(STRIDES) * n :]
        steps = [
            step
            for i, stride in enumerate(STRIDES)
            for step in _steps(t, r, moved[..., i * n : (i + 1) * n] / stride, offsets)
        ]
        out.append(_Local(steps + _drawn(t), offsets))
    return out


def _around(where: Coordinates, simulator: Simulator, task: Task) -> list[Asked]:
    """The model a stride away in every direction, and from other first states."""
    out, d = [], simulator.problem.d
    for stride in STRIDES:
        for k in range(where.size):
            z = task.z.copy()
            z[k] += stride
            out.append(Asked(where.at(z), task.starts, task.horizon))
    here, unit = where.at(task.z), simulator.uncertain().reshape(-1)
    for k in range(2 * d):
        one = np.where(np.arange(2 * d) == k, unit, 0.0).reshape(2, d)
        out.append(Asked(here, task.starts, task.horizon, one))
    return out


def _drawn(task: Task) -> list[FloatArray]:
    """Random steps, as far as the cost at most doubles by its curvature."""
    h = task.curvature + task.pull**2 * np.eye(task.z.size)
    values, vectors = np.linalg.eigh(h)
    far = np.sqrt(task.cost / np.maximum(values, 1e-6 * values[-1] + 1e-300) / task.z.size)
    normal = np.random.default_rng(task.taken).standard_normal((DRAWN, task.z.size))
    sizes = np.geomspace(0.1, 1.0, DRAWN)
    # dz = sum_k v_k n_k sqrt(C / (lambda_k size))
    return [size * (vectors @ (far * n)) for size, n in zip(sizes, normal, strict=True)]


def _steps(task: Task, r: FloatArray, j: FloatArray, offsets: FloatArray) -> list[FloatArray]:
    """Gauss-Newton steps of several dampings; r (w, m), J (w, m, size), A (w, m, 2 d)."""
    task.cost = _cost(r, offsets, task, task.z)
    left = _left(r[..., None], offsets)[..., 0]
    square = np.einsum("wm,wm->w", r, left)
    # d rho / d u^2 = 1 / sqrt(1 + u^2)
    weight = 1 / np.sqrt(1 + np.maximum(square, 0)) / len(r)
    task.curvature = np.einsum("wmk,wml,w->kl", j, _left(j, offsets), weight)
    # H = sum w J'PJ + pull^2,  g = sum w J'Pr + pull^2 (z - centre)
    h = task.curvature + task.pull**2 * np.eye(task.z.size)
    g = np.einsum("wmk,wm,w->k", j, left, weight) + task.pull**2 * (task.z - task.centre)
    size = np.diag(np.maximum(np.diag(h), 1e-12 * np.max(np.diag(h)) + 1e-300))
    # (H + mu diag H) dz = -g
    return [-np.linalg.solve(h + task.damping * k * size, g) for k in TRIED]


def _taken(
    task: Task, near: _Local, trials: list[FloatArray], found: list[FloatArray]
) -> FloatArray | None:
    """Take the best trial where it is better; the errors there, or None."""
    costs = [
        _cost(_weighted(e, task), near.offsets, task, z) for z, e in zip(trials, found, strict=True)
    ]
    k, task.taken = int(np.argmin(costs)), task.taken + 1
    fall = (task.cost - costs[k]) / task.cost
    task.idle = 0 if fall > STEP_FALL else task.idle + 1
    task.done = task.idle >= PATIENCE
    if fall <= 0:
        task.damping = min(3 * task.damping, 1e6)
        return None
    task.cost, task.z = costs[k], trials[k]
    if k < len(STRIDES) * len(TRIED):
        task.damping = float(np.clip(task.damping * TRIED[k % len(TRIED)], 1e-6, 1e6))
    return found[k]
