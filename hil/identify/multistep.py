"""Forward simulation of fitted models from measured states, and its error over short horizons.

One-step (inverse dynamics) error can fall while the simulated motion gets worse; both are
shown, always.

`forward` takes models and windows and gives position errors.  A step costs about the same for one
window as for hundreds, whatever run they are of: several models are simulated together, a term that
they share is evaluated once for all of them, and runs are joined where the terms of all models see
the same in them but for the states.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numba
import numpy as np
from numpy.typing import NDArray

from hil.identify.column_cache import watched
from hil.identify.context import carrying
from hil.identify.design import Term, by_run
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.effect import Trait
from hil.models.motion import Motion

FloatArray = NDArray[np.float64]
WINDOWS = 60
#: Short horizon [s].
SHORT = 0.5
#: Bandwidth of the servo in a closed-loop replay [Hz].
SERVO = 1.0
IntArray = NDArray[np.int_]
#: Share of the effort that drives a joint below which a step's balance counts as found, and the
#: effort [N m or N] that is nothing.
CLOSE, TINY = 1e-3, 1e-12
#: Secants of a joint that turns round or sticks.
SECANTS = 3
#: A term and its coefficients: (m,), or (w, m) row by row.
Part = tuple[Term, FloatArray]
#: Instants of a run that show which fields a term looks at.
PROBED = 200


@dataclass(frozen=True)
class Windows:
    """What is simulated with one model.

    Parameters
    ----------
    result : FitResult
        The fit.
    starts : ndarray of int (windows,)
        First instants.
    horizon : int
        Instants of each window.
    servo : float
        Bandwidth [Hz] of a servo that leads the model back to the measured motion; 0 = none.
    motion : Motion, optional
        The run with the load of this model, where that is another one.
    offset : ndarray (2, windows, d), optional
        What the first positions and speeds differ from the measured ones by [rad, rad/s].
    run : int
        Number of the run, where several are joined.
    """

    result: FitResult
    starts: IntArray
    horizon: int
    servo: float = 0.0
    motion: Motion | None = None
    offset: FloatArray | None = None
    run: int = 0


class _Forward:
    """Effort of the models for many states at once; state effects follow the measured motion.

    Row k of the states belongs to jobs[owner[k]].
    """

    def __init__(self, jobs: Sequence[Windows], motion: Motion, owner: IntArray) -> None:
        self.motion, self.owner = motion, owner
        runs = runs_of(motion)
        every = shared([parts_of(job.result, runs[job.run]) for job in jobs], owner)
        #: Rigid-body parameters: the robot gives their balance at once; no parts of the rest.
        own = [Trait.BODY in t.effect.traits for t, _ in every]
        self._masses = [theta for (_, theta), mine in zip(every, own, strict=True) if mine]
        self._parts = [part for part, mine in zip(every, own, strict=True) if not mine]
        self._seen = [looked_at(t, motion) for t, _ in self._parts]
        #: Whether anything but the rigid bodies has a mass.
        self._heavy = any("qdd" in seen for seen in self._seen)

    def drag(
        self, q: FloatArray, qd: FloatArray, load: FloatArray, rows: IntArray | None = None
    ) -> FloatArray:
        """What depends on the speed but for the rigid bodies: effort (w, d) at states of `rows`."""
        none = np.zeros((1, *q.shape))
        out: FloatArray = self.effort(q, qd, none, load, mass=False, rows=rows)[0]
        return out

    def balance(
        self, q: FloatArray, qd: FloatArray, load: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Effort (w, d) without acceleration, and mass matrix (w, d, d), at states (w, d)."""
        w, d = q.shape
        # no acceleration, then one of each joint where it matters: all states at once
        unit = np.zeros((1 + d * self._heavy, w, d))
        for j in range(len(unit) - 1):
            unit[1 + j, :, j] = 1.0
        each = self.effort(q, qd, unit, load)
        rest, mass = each[0], np.zeros((w, d, d))
        if self._heavy:
            mass = np.moveaxis(each[1:] - each[0], 0, -1)
        for pi in self._masses:
            still, heavy = self.motion.robot.balance(q, qd, pi)
            rest, mass = rest + still, mass + heavy
        return rest, mass

    def solve(self, mass: FloatArray, push: FloatArray) -> FloatArray:
        """Acceleration (w, d); NaN for all windows of a job that has a singular one."""
        out = eliminated(mass, push)
        if np.isfinite(out).all():
            return out
        size = np.abs(np.linalg.det(mass))
        bad = ~(np.isfinite(size) & (size > 1e-300) & np.isfinite(mass).all(axis=(1, 2)))
        lost = np.isin(self.owner, self.owner[bad])
        safe = np.where(lost[:, None, None], np.eye(mass.shape[1]), mass)
        return np.where(lost[:, None], np.nan, eliminated(safe, push))

    def effort(
        self,
        q: FloatArray,
        qd: FloatArray,
        qdd: FloatArray,
        load: FloatArray,
        mass: bool = True,
        rows: IntArray | None = None,
    ) -> FloatArray:
        """Effort (r, w, d) but for `_masses`, at q (w, d), qd (w, d) or (r, w, d), qdd (r, w, d).

        Without the mass' on demand.  `load` (w, 3, d): all that is transmitted as measured, its
        static part, and the motors' effort.  States of some `rows` only, or of all.
        """
        shape = qdd.shape
        flat = (q, qd, load[:, 0], load[:, 1], load[:, 2])
        positions, speeds, *loads = (
            x.reshape(-1, shape[2]) if x.ndim == 3 else _times(x, shape[0]) for x in flat
        )
        every = few = self.motion.at_states(positions, speeds, qdd.reshape(positions.shape), *loads)
        if qd.ndim == 2 and shape[0] > 1:
            # one state each is enough for what no acceleration changes
            few = self.motion.at_states(q, qd, qdd[0], *flat[2:])
        out = np.zeros(shape)
        for (t, theta), seen in zip(self._parts, self._seen, strict=True):
            if not mass and (t.effect.scope.whole or "qd" not in seen):
                continue
            theta = theta if rows is None else theta[rows]
            if not theta.shape[1]:  # of other runs alone
                continue
            m = every if "qdd" in seen else few
            columns = t.effect.columns(m, t.joint, t.shape)
            if t.effect.scope.whole:
                columns = columns.reshape(-1, shape[1], *columns.shape[1:])
                out += np.einsum("rwdm,wm->rwd", columns, theta)
            elif theta.shape[1] == 1:
                out[..., t.joint] += columns.reshape(-1, shape[1]) * theta[:, 0]
            else:
                columns = columns.reshape(-1, *theta.shape)
                out[..., t.joint] += (columns * theta).sum(axis=2)
        return out


def _times(x: FloatArray, count: int) -> FloatArray:
    """States (w, d) that many times, one after the other."""
    return x if count == 1 else np.concatenate([x] * count)


def forward(motion: Motion, jobs: Sequence[Windows]) -> list[tuple[FloatArray, FloatArray]]:
    """Position errors and displacements (windows, horizon, d) of each job.

    (M(q) + dt D) qdd = tau + tau_ext - h(q, qd),  qdd += w^2 (q_m - q) + 2 w (qd_m - qd)

    with w = 2 pi servo and D the secant slope of friction over the step (implicit Euler at the
    evaluation rate, see `_braked`).

    Parameters
    ----------
    motion : Motion
        Measured run, or several joined ones.
    jobs : sequence of Windows
        Models and windows.
    """
    owner = np.repeat(np.arange(len(jobs)), [len(job.starts) for job in jobs])
    starts = np.concatenate([job.starts for job in jobs])
    horizon = np.array([job.horizon for job in jobs])[owner]
    drive, loads = _drives(jobs, motion, owner), _loads(jobs, motion, owner)
    w = 2 * np.pi * np.array([job.servo for job in jobs])
    path = np.full((len(starts), int(horizon.max()), motion.d), np.nan)
    rows, begin, (q, qd) = np.arange(len(starts)), 0, _beginning(jobs, motion)
    with np.errstate(all="ignore"):
        for end in np.unique(horizon).tolist():
            on = horizon[rows] >= end
            q, qd, rows = q[on], qd[on], rows[on]
            model, servo = _Forward(jobs, motion, owner[rows]), w[owner[rows], None]
            for k in range(begin, end):
                now = starts[rows] + k
                q, qd = _step(model, q, qd, drive(rows, now), loads(rows, now), servo, now)
                path[rows, k] = q
            begin = end
    return [
        _errors(path[owner == k, : job.horizon], job.starts, motion) for k, job in enumerate(jobs)
    ]


def _beginning(jobs: Sequence[Windows], motion: Motion) -> tuple[FloatArray, FloatArray]:
    """First positions and speeds (rows, d) of all windows."""
    parts = [np.stack([motion.q[job.starts], motion.qd[job.starts]]) for job in jobs]
    both = [p if j.offset is None else p + j.offset for p, j in zip(parts, jobs, strict=True)]
    q, qd = np.concatenate(both, axis=1)
    return q, qd


def _drives(
    jobs: Sequence[Windows], motion: Motion, owner: IntArray
) -> Callable[[IntArray, IntArray], FloatArray]:
    """What drives rows (w,) at instants (w,): efforts less those that are replayed, (w, d)."""
    results = list({id(job.result): job.result for job in jobs}.values())
    if not any(Trait.REPLAYED in t.effect.traits for r in results for t in r.terms):
        pushed = motion.tau + motion.tau_ext
        return lambda rows, now: np.asarray(pushed[now])
    place = {id(r): k for k, r in enumerate(results)}
    which = np.array([place[id(job.result)] for job in jobs])[owner]
    own = {id(job.result): job.motion for job in jobs}
    felt = np.stack([replayed(r, motion, own[id(r)]) for r in results])
    every = motion.tau + motion.tau_ext - felt
    return lambda rows, now: np.asarray(every[which[rows], now])


def _loads(
    jobs: Sequence[Windows], motion: Motion, owner: IntArray
) -> Callable[[IntArray, IntArray], FloatArray]:
    """Loads of rows (w,) at instants (w,), (w, 3, d): as `_Forward.effort` has them.

    The motors' effort is the recorded one: it is what moves the simulated joints.
    """
    carried = {id(job.motion or motion): job.motion or motion for job in jobs}
    place = {key: k for k, key in enumerate(carried)}
    which = np.array([place[id(job.motion or motion)] for job in jobs])[owner]
    every = np.stack([np.stack([m.load, m.static, m.tau], axis=1) for m in carried.values()])
    return lambda rows, now: np.asarray(every[which[rows], now])


def _step(
    model: _Forward,
    q: FloatArray,
    qd: FloatArray,
    drive: FloatArray,
    load: FloatArray,
    w: FloatArray,
    now: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """Positions and speeds (rows, d) one instant after `now` (rows,)."""
    m = model.motion
    rest, mass = model.balance(q, qd, load)
    push = drive - rest
    free = model.solve(mass, push)
    speed = _braked(model, (q, qd, load), mass, push, qd + m.dt * free)
    pull = w**2 * (m.q[now] - q) + 2 * w * (m.qd[now] - qd)
    qd = speed + m.dt * pull
    q = q + m.dt * qd
    return np.clip(q, -1e6, 1e6), np.clip(qd, -1e6, 1e6)


def _braked(
    model: _Forward,
    state: tuple[FloatArray, FloatArray, FloatArray],
    mass: FloatArray,
    push: FloatArray,
    far: FloatArray,
) -> FloatArray:
    """Speeds x (w, d) one instant later, with the friction F that they meet (implicit Euler).

        R(x) = M (x - v) / dt - push + F(x) - F(v) = 0,

    first by the secant from v to `far`, where the friction of v would lead.  Friction that grows
    with the speed has the solution between the two, joint by joint: rows where it is not found
    yet (a reversal, a joint that sticks) go on by secants, within what is left of that interval.
    """
    q, v, load = state
    dt, held = model.motion.dt, model.drag(q, v, load)
    rise = model.drag(q, far, load) - held
    secant = np.maximum(rise / _apart(far - v), 0.0)
    x = v + dt * model.solve(mass + dt * secant[..., None] * np.eye(v.shape[1]), push)
    if not np.any(rise):
        return x
    left = (mass @ (x - v)[..., None])[..., 0] / dt - push
    left = left + model.drag(q, x, load) - held
    rows = np.flatnonzero(np.any(np.abs(left) > CLOSE * np.abs(push) + TINY, axis=1))
    if rows.size:
        part = q[rows], v[rows], load[rows]
        ends = _Ends(part[1], -push[rows], far[rows], rise[rows], x[rows], left[rows])
        x[rows] = _found(model, rows, part, mass[rows], push[rows] + held[rows], ends)
    return x


@dataclass
class _Ends:
    """Speeds that enclose a solution with what is left of R there, and the last one tried."""

    a: FloatArray
    left_a: FloatArray
    b: FloatArray
    left_b: FloatArray
    x: FloatArray
    left: FloatArray

    def narrowed(self) -> FloatArray:
        """Put x in place of the end on its side; the speed that was there (w, d)."""
        same = self.left * self.left_a > 0
        old = np.where(same, self.a, self.b), np.where(same, self.left_a, self.left_b)
        self.a, self.b = np.where(same, self.x, self.a), np.where(same, self.b, self.x)
        # Illinois: an end that stays counts half, so that it will not stay for ever
        near = np.where(same, self.left, 0.5 * self.left_a)
        self.left_b = np.where(same, 0.5 * self.left_b, self.left)
        self.left_a = near
        slope: FloatArray = (self.left - old[1]) / _apart(self.x - old[0])
        return slope

    def inside(self, y: FloatArray) -> FloatArray:
        """Speeds y where they lie between the ends, else those of the false position."""
        chord = self.a - self.left_a * (self.b - self.a) / _apart(self.left_b - self.left_a)
        low, high = np.minimum(self.a, self.b), np.maximum(self.a, self.b)
        return np.where((y >= low) & (y <= high), y, np.clip(chord, low, high))


def _found(
    model: _Forward,
    rows: IntArray,
    state: tuple[FloatArray, FloatArray, FloatArray],
    mass: FloatArray,
    pushed: FloatArray,
    ends: _Ends,
) -> FloatArray:
    """Speeds of some rows that bring R close to zero; `pushed` is push + F(v)."""
    q, v, load = state
    dt, own = model.motion.dt, np.einsum("wdd->wd", mass)
    for _ in range(SECANTS):
        # slope of F alone: that of R less the mass
        slope = np.maximum(ends.narrowed() - own / dt, 0.0)
        each = mass + dt * slope[..., None] * np.eye(v.shape[1])
        ends.x = ends.inside(ends.x - dt * eliminated(each, ends.left))
        ends.left = (mass @ (ends.x - v)[..., None])[..., 0] / dt - pushed
        ends.left = ends.left + model.drag(q, ends.x, load, rows)
    return ends.x


def _apart(x: FloatArray) -> FloatArray:
    """Differences to divide by, none of them zero."""
    return np.where(np.abs(x) < 1e-300, 1e-300, x)


def _errors(path: FloatArray, starts: IntArray, motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Errors and displacements of simulated positions (windows, horizon, d)."""
    true = motion.q[starts[:, None] + np.arange(1, path.shape[1] + 1)]
    return path - true, true - motion.q[starts][:, None]


def looked_at(term: Term, motion: Motion) -> set[str]:
    """Fields of unconnected states that a term looks at."""
    few = slice(None, None, max(1, motion.n // PROBED))
    rows = [
        x[few] for x in (motion.q, motion.qd, motion.qdd, motion.load, motion.static, motion.tau)
    ]
    return {
        name
        for name, _ in watched(term.effect, [motion.at_states(*rows)], term.joint, term.shape)[1]
    }


def shared(parts: Sequence[Sequence[Part]], owner: IntArray) -> list[Part]:
    """Terms of all models that follow the state, with the coefficients (w, m) of each row.

    Zero where a row's model has no such term.
    """
    found: dict[tuple[object, ...], Part] = {}
    for k, own in enumerate(parts):
        for t, theta in own:
            if Trait.REPLAYED not in t.effect.traits:
                key = (*t.key, t.shape)
                if key not in found:
                    found[key] = (t, np.zeros((len(owner), theta.size)))
                found[key][1][owner == k] = theta
    return list(found.values())


def parts_of(result: FitResult, motion: Motion) -> list[Part]:
    """Terms of a model with their coefficients in a run; zero in a run that was not fitted."""
    out = []
    for t, where in zip(result.terms, result.slices, strict=True):
        theta = result.theta[where]
        if t.per_run:
            motions = result.problem.motions
            own = by_run(t, theta, result.problem.runs)[result.problem.whole]
            known = [own[k] for k, m in enumerate(motions) if m is motion]
            theta = np.asarray(known[0]) if known else np.zeros(own.shape[1])
        elif t.effect.variation.own(t.shape) and all(
            m is not motion for m in result.problem.motions
        ):
            theta = np.zeros_like(theta)
        out.append((t, theta))
    return out


def replayed(result: FitResult, motion: Motion, own: Motion | None = None) -> FloatArray:
    """Effort (n, d) of states and measured derivatives, taken from the measured run.

    `own` is the run with this model's load, where that is another one.
    """
    parts = zip(runs_of(motion), runs_of(own or motion), strict=True)
    return np.concatenate([_replayed(result, m, mine) for m, mine in parts])


def _replayed(result: FitResult, motion: Motion, own: Motion) -> FloatArray:
    """The same of one run."""
    out = np.zeros_like(motion.q)
    for t, theta in parts_of(result, motion):
        if Trait.REPLAYED in t.effect.traits:
            where = slice(None) if t.effect.scope.whole else t.joint
            out[:, where] += t.effect.columns(own, t.joint, t.shape) @ theta
    return out


def eliminated(a: FloatArray, b: FloatArray) -> FloatArray:
    """Solutions x (n, d) of A x = b, a (n, d, d) and b (n, d); NaN or infinite where singular.

    Gauss' elimination with the largest pivot of a column: for matrices of a few joints the call
    of a general solver costs more than the arithmetic.
    """
    out = np.array(b, dtype=np.float64)
    _eliminate(np.array(a, dtype=np.float64, order="C"), out)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _eliminate(a: FloatArray, x: FloatArray) -> None:
    """Solutions in place of the right sides; the matrices are lost."""
    n, d = x.shape
    for k in range(n):
        m, y = a[k], x[k]
        for i in range(d):
            top = i
            for r in range(i + 1, d):
                if abs(m[r, i]) > abs(m[top, i]):
                    top = r
            if top != i:
                for c in range(i, d):
                    m[i, c], m[top, c] = m[top, c], m[i, c]
                y[i], y[top] = y[top], y[i]
            for r in range(i + 1, d):
                f = m[r, i] / m[i, i]
                for c in range(i + 1, d):
                    m[r, c] -= f * m[i, c]
                y[r] -= f * y[i]
        for i in range(d - 1, -1, -1):
            for c in range(i + 1, d):
                y[i] -= m[i, c] * y[c]
            y[i] /= m[i, i]


#: Fields that `Motion.at_states` replaces.
STATES = frozenset("t q qd qdd load static tau tau_ext average drive friction".split())


class Joined(Motion):
    """Runs one after the other: states and efforts of all, everything else of the first."""

    runs: tuple[Motion, ...]


def joined(runs: Sequence[Motion]) -> Motion:
    """The run itself if there is but one, else all of them in one."""
    first = runs[0]
    if len(runs) == 1:
        return first
    out: Joined = object.__new__(Joined)
    names = ("t", "q", "qd", "qdd", "load", "static", "tau", "tau_ext")
    every = {name: np.concatenate([getattr(m, name) for m in runs]) for name in names}
    out.__dict__.update(first.__dict__, **every, runs=tuple(runs), _signs={})
    return out


def runs_of(motion: Motion) -> tuple[Motion, ...]:
    """The runs that a motion consists of."""
    return motion.runs if isinstance(motion, Joined) else (motion,)


def groups(motions: Sequence[Motion], seen: Collection[str]) -> list[list[int]]:
    """Numbers of the runs that may be joined, where `seen` fields of a motion are looked at."""
    out: list[list[int]] = []
    for k, m in enumerate(motions):
        own = next((g for g in out if alike(motions[g[0]], m, seen)), None)
        if own is None:
            out.append([k])
        else:
            own.append(k)
    return out


def alike(a: Motion, b: Motion, seen: Collection[str]) -> bool:
    """Whether two runs are the same in some fields, but for the states, and in their period."""
    return (
        a.dt == b.dt
        and a.robot is b.robot
        and all(_same(getattr(a, x), getattr(b, x)) for x in seen if x not in STATES)
    )


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return _equal(a, b)
    return a is b


def _equal(a: NDArray[np.generic], b: NDArray[np.generic]) -> bool:
    return a.shape == b.shape and a.tobytes() == b.tobytes()


@dataclass(frozen=True)
class MultiStep:
    """Simulated position error.

    Parameters
    ----------
    horizon : float
        Length of each simulation [s].
    rms : ndarray (d,)
        Rms position error over all windows and instants [rad or m].
    relative : ndarray (d,)
        100 rms error / rms displacement within the windows [%].
    windows : int
        Number of simulations.
    diverged : int
        Windows whose simulation left the recorded range by more than its span.
    power : ndarray (windows, d)
        Mean squared position error of each window; NaN where it diverged.
    closed_loop : MultiStep or None
        The same of the closed-loop replay, where it was made.
    """

    horizon: float
    rms: FloatArray
    relative: FloatArray
    windows: int
    diverged: int
    power: FloatArray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    closed_loop: MultiStep | None = None

    @property
    def lost(self) -> bool:
        """Whether at least half of the simulations left the recorded range.

        The error of the others means nothing then: they are those that had the least to go wrong.
        """
        return 2 * self.diverged >= self.windows

    def rises(self, before: MultiStep, j: int, factor: float) -> bool:
        """Whether joint j's error rose by this factor and by more than its standard error.

        The same windows are compared; neighbours overlap by half, which halves their number.
        """
        if self.lost or before.lost:
            return self.lost and not before.lost
        if self.power.shape != before.power.shape or not self.power.size:
            return bool(self.rms[j] > factor * before.rms[j])
        pair = np.stack([before.power[:, j], self.power[:, j]])
        pair = pair[:, np.isfinite(pair).all(axis=0)]
        old, new = np.sqrt(pair.mean(axis=1)) if pair.size else (np.inf, np.inf)
        rise = pair[1] - pair[0]
        chance = float(np.std(rise)) * np.sqrt(2 / max(rise.size - 1, 1))
        return bool(new > factor * old and rise.mean() > chance)


def both(result: FitResult, problem: Problem) -> MultiStep:
    """Short horizons and, for models of the motor's effort, the closed-loop replay."""
    return each([result], problem)[0]


def each(results: Sequence[FitResult], problem: Problem) -> list[MultiStep]:
    """The same of several models, simulated together.

    The closed-loop replay simulates windows of several seconds under a soft servo to the measured
    motion: what the servo of 1 Hz has to make up for is what the model gets wrong; drift that
    short horizons do not show shows there.  Its windows are eighths of a run, at most 2.5 s long.
    """
    longest = max(min(m.n * m.dt for m in problem.motions) / 8, 0.5)
    asked = [(SHORT, 0.0), (float(min(longest, 2.5)), SERVO)]
    jobs = [
        (r, *ask) for r in results for ask in asked if r.model.explains == "motor" or not ask[1]
    ]
    found = iter(_simulated(jobs, problem))
    out = []
    for r in results:
        short = next(found)
        motor = r.model.explains == "motor"
        out.append(replace(short, closed_loop=next(found)) if motor else short)
    return out


def simulate(
    result: FitResult, problem: Problem, seconds: float = SHORT, servo: float = 0.0
) -> MultiStep:
    """Simulate a fitted model from measured states with the measured effort.

    M(q) qdd = tau + tau_ext - h(q, qd); semi-implicit Euler at the evaluation rate.

    Parameters
    ----------
    result : FitResult
        The fit.
    problem : Problem
        Runs to simulate (the same or held-out ones).
    seconds : float
        Horizon.
    servo : float
        Bandwidth of a servo to the measured motion [Hz]; 0 = none.
    """
    return _simulated([(result, seconds, servo)], problem)[0]


def _simulated(
    asked: Sequence[tuple[FitResult, float, float]], problem: Problem
) -> list[MultiStep]:
    """Errors of models over horizons [s] under servos [Hz], over all runs."""
    found: dict[tuple[int, int], tuple[FloatArray, FloatArray]] = {}
    results = list({id(r): r for r, _, _ in asked}.values())
    carried = {id(r): carrying(r, problem) for r in results}
    terms = [t for r in results for t in r.terms if Trait.REPLAYED not in t.effect.traits]
    seen = set().union(*(looked_at(t, problem.motions[0]) for t in terms))
    for group in groups(problem.motions, seen):
        motion = joined([problem.motions[i] for i in group])
        own = {key: joined([motions[i] for i in group]) for key, motions in carried.items()}
        firsts = np.cumsum([0, *(problem.motions[i].n for i in group)]).tolist()
        jobs = {
            (i, k): Windows(result, starts + first, horizon, servo, own[id(result)], run=at)
            for at, (i, first) in enumerate(zip(group, firsts, strict=False))
            for k, (result, seconds, servo) in enumerate(asked)
            for starts, horizon in [
                _windows(problem.motions[i], problem.stretches(i), seconds, servo)
            ]
            if starts.size  # else a run shorter than the shortest window
        }
        if jobs:
            found |= dict(zip(jobs, forward(motion, list(jobs.values())), strict=True))
    return [
        _summary([found[key] for key in sorted(found) if key[1] == k], seconds, problem)
        for k, (_, seconds, _) in enumerate(asked)
    ]


def _windows(
    motion: Motion, stretches: Sequence[tuple[int, int]], seconds: float, servo: float
) -> tuple[NDArray[np.int_], int]:
    """First instants of the windows of a run, and their length; windows without a servo overlap.

    None leaves its stretch of the run: what a bridge puts in the place of missing rows is no
    motion to compare with.
    """
    horizon = max(2, round(seconds / motion.dt))
    edge, overlap = int(0.2 / motion.dt), 1 if servo else 2
    found = [np.zeros(0, dtype=np.int_)]
    for a, b in stretches:
        first, last = max(a, edge), min(b, motion.n - edge + 1) - 1 - horizon
        if last > first:
            count = min(WINDOWS, max(1, overlap * (last - first) // max(horizon, 1)))
            found.append(np.linspace(first, last, count).astype(np.int_))
    every = np.concatenate(found)
    few = np.linspace(0, every.size - 1, min(every.size, WINDOWS)).astype(np.int_)
    return every[few], horizon


def _summary(
    pairs: list[tuple[FloatArray, FloatArray]], seconds: float, problem: Problem
) -> MultiStep:
    if not pairs:
        nothing = np.full(problem.d, np.nan)
        return MultiStep(seconds, nothing, nothing, 0, 0)
    # runs of slightly different rates have windows of slightly different lengths
    shortest = min(e.shape[1] for e, _ in pairs)
    error, move = (
        np.concatenate([x[:, :shortest] for x in some]) for some in zip(*pairs, strict=True)
    )
    span = np.ptp(problem.span, axis=1)
    bad = np.any(~np.isfinite(error) | (np.abs(error) > span), axis=(1, 2))
    good = error[~bad] if (~bad).any() else np.nan_to_num(error, nan=np.inf)
    rms = np.sqrt(np.mean(good**2, axis=(0, 1)))
    size = np.sqrt(np.mean(move**2, axis=(0, 1)))
    power = np.full((len(error), problem.d), np.nan)
    power[~bad] = np.mean(error[~bad] ** 2, axis=1)
    relative = 100 * rms / np.maximum(size, 1e-12)
    return MultiStep(seconds, rms, relative, len(error), int(bad.sum()), power)
