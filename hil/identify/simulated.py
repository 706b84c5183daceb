"""Refinement of a fitted model on its simulated motion, chosen on windows that were held out.

The one-step fit weighs efforts; what is wanted of a simulation is the motion.  Each run is cut
into thirds.  For each third the model is fitted to the others, first one-step, then on simulated
windows of several lengths and with several pulls towards the one-step fit (`outputerror`), and
then simulated over the third from its measured first state.  The longest windows whose error
there is within one standard error of the least are taken (they are nearest to what is judged),
with the pull that is best for them; where that is not better than the one-step fit, the given
model stays.
Runs kept apart (`holdout`) are only shown at the end, and choose nothing.

Source of the rule of one standard error: Breiman et al., Classification and Regression Trees, 1984.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError
from hil.identify.design import stack
from hil.identify.fit import predict
from hil.identify.outputerror import Asked, Coordinates, Simulator, Task, descend
from hil.identify.problem import Problem
from hil.identify.result import FitResult, relative
from hil.record.arrays import Runs, held_out
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int_]
T = TypeVar("T")
#: Parts of a run that are held out in turn.
SIMULATION_FOLDS = 3
#: Lengths of fitted windows, in the one that is judged, and their pulls; the first pull with all.
LENGTHS = (1.0, 0.5, 0.25)
PULLS = (0.005, 0.0005, 0.05)
#: Windows of one length at most; the ends of a run [s] that filters blur.
MAX_WINDOWS, EDGE = 24, 0.2
#: Instants of the shortest window.
SHORTEST_WINDOW = 2
#: Lengths [s] that are judged where none is asked for: the longest that stays in range.
USUAL = (8.0, 4.0, 2.0, 1.0, 0.5, 0.25)
#: Steps of a fit that is judged, and of the last one.
STEPS, LAST = 8, 16
#: Least gain of the held-out simulated error that counts.
GAIN = 1e-3


@dataclass(frozen=True)
class SimulationErrors:
    """Both errors of one model on data it was not fitted to.

    Parameters
    ----------
    one_step : ndarray (d,)
        100 rms(effort residual) / rms(effort) [%].
    simulated : ndarray (d,)
        Rms position error of the simulated windows [rad or m].
    each : ndarray (windows, d)
        Mean squared position error of each of them.
    """

    one_step: FloatArray
    simulated: FloatArray
    each: FloatArray = field(repr=False)


@dataclass(frozen=True)
class Tried:
    """A length of window [s] and a pull, with the held-out simulated error in the given one's."""

    window: float
    pull: float
    ratio: float


@dataclass(frozen=True)
class SimulatedFit:
    """A fit refined on the simulated motion.

    Parameters
    ----------
    given, refined : FitResult
        The one-step fit, and the same model after the refinement.
    better : bool
        Whether the refined model is better on held-out windows.
    judged : float
        Length of the held-out windows that were simulated [s].
    free_run : bool
        Whether whole runs are simulated on the official split.
    heldout : tuple of Errors
        On the held-out thirds of the fitted runs, before and after.
    official : tuple of Errors, or None
        On runs kept apart, before and after.
    tried : list of Tried
        All that was tried, what was taken first.
    """

    given: FitResult
    refined: FitResult
    better: bool
    judged: float
    free_run: bool
    heldout: tuple[SimulationErrors, SimulationErrors]
    official: tuple[SimulationErrors, SimulationErrors] | None = None
    tried: list[Tried] = field(default_factory=list)

    @property
    def result(self) -> FitResult:
        """The refined model where it is better on held-out windows, else the given one."""
        return self.refined if self.better else self.given

    def as_dict(self) -> dict[str, object]:
        """What `hil fit --json` says under ``simulated``."""
        joints = self.given.problem.joints
        pairs = {"heldout": self.heldout, "official": self.official}
        return {
            "refined": self.better,
            "window": self.tried[0].window,
            "pull": self.tried[0].pull,
            "judged": self.judged,
            "free_run": self.free_run,
            **{k: p and _named(p, joints) for k, p in pairs.items()},
            "tried": [vars(t) for t in self.tried],
        }


def _named(
    pair: tuple[SimulationErrors, SimulationErrors], joints: Sequence[str]
) -> dict[str, object]:
    """Errors before and after by joint."""
    return {
        when: {
            "one_step": dict(zip(joints, map(float, errors.one_step), strict=True)),
            "simulated": dict(zip(joints, map(float, errors.simulated), strict=True)),
        }
        for when, errors in zip(("before", "after"), pair, strict=True)
    }


def refine(
    result: FitResult,
    holdout: Runs = (),
    window: float = 0.0,
    free_run: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> SimulatedFit:
    """Refine a fitted model on its simulated motion.

    Parameters
    ----------
    result : FitResult
        A fit of the motor's effort.
    holdout : Recording or sequence of Recording
        Runs that both errors are shown on at the end (the official split).
    window : float
        Length of the simulations that matter [s]; 0 = the longest usual one within the range.
    free_run : bool
        Whether whole runs matter: thirds are then simulated as a whole.
    say : callable
        Told in a line what is being done.

    Raises
    ------
    ConfigError
        If an argument is of another kind, the model explains an external effort, or the windows do
        not fit into thirds of a run.
    DataError
        If a held-out run is of another robot.
    """
    if not isinstance(result, FitResult):
        raise ConfigError(
            f"hil.refine takes a fit, not {type(result).__name__}; hil.fit(run, model) makes one"
        )
    others = held_out(holdout, "hil.refine")
    for run in others:
        if run.joints != result.problem.joints:
            raise DataError(
                f"held-out session {run.name!r} has joints {', '.join(run.joints)}, the fitted "
                f"ones {', '.join(result.problem.joints)}; give sessions of one robot"
            )
    if result.model.explains != "motor":
        raise ConfigError(
            "only a model of the motor's effort moves by itself; this one explains external "
            "effort, so leave --simulate out"
        )
    work = _Refiner(result, window, free_run)
    tried: dict[tuple[float, float], _Fold] = {}
    lengths = work.lengths()
    for pulls in (PULLS[:1], PULLS[1:]):
        if tried:
            lengths = [max(alike([x.errors for x in tried.values()], [k[0] for k in tried]))]
        new = [(length, pull) for length in lengths for pull in pulls]
        say(f"simulating {len(new) * SIMULATION_FOLDS} fits of {work.where.size} directions")
        tried |= dict(zip(new, work.judge(new), strict=True))
    best = min((k for k in tried if k[0] == lengths[0]), key=lambda k: tried[k].ratio)
    order = [best, *(k for k in tried if k != best)]
    refined, official = work.whole(*best), None
    if others:
        other = _like(result.problem, others)
        horizon = 0 if free_run else work.horizon
        before, after = (_official(r, other, horizon) for r in (result, refined))
        official = (before, after)
    return SimulatedFit(
        result,
        refined,
        tried[best].ratio < 1 - GAIN,
        work.judged,
        free_run,
        (work.before, tried[best].errors),
        official,
        [Tried(*k, tried[k].ratio) for k in order],
    )


def free_run(result: FitResult, holdout: Sequence[Recording]) -> SimulationErrors:
    """Both errors on other runs, simulated from the first state of each stretch to its end."""
    return _official(result, _like(result.problem, holdout))


def alike(errors: Sequence[SimulationErrors], what: Sequence[T]) -> list[T]:
    """Those whose held-out simulated error is within one standard error of the least.

    With c_w the squared error of window w, each joint in its own scale, and b the best of them,
    mean (c_w - b_w) is compared with its standard error over the windows.
    """
    unit = np.mean([e.each for e in errors], axis=(0, 1))
    cost = np.array([np.mean(e.each / np.maximum(unit, 1e-300), axis=1) for e in errors])
    rise = cost - cost[np.argmin(cost.mean(axis=1))]
    se = np.std(rise, axis=1, ddof=1) / np.sqrt(rise.shape[1]) if rise.shape[1] > 1 else 0.0
    near = rise.mean(axis=1) <= se
    return [w for w, ok in zip(what, near.tolist(), strict=True) if ok]


def chosen(fits: Sequence[SimulatedFit]) -> int:
    """Number of the model to take, by the fitted runs alone.

    The one with the fewest values among those whose held-out simulated error is `alike`.

    Parameters
    ----------
    fits : sequence of SimulatedFit
        Refinements of several models on the same runs, judged alike.
    """
    near = alike([f.heldout[int(f.better)] for f in fits], range(len(fits)))
    return min(near, key=lambda k: len(fits[k].given.values))


@dataclass(frozen=True)
class _Fold:
    """Held-out errors of one plan, and their ratio to those of the one-step fits."""

    errors: SimulationErrors
    ratio: float


class _Refiner:
    """The data of one refinement: thirds, windows, one-step fits without each third."""

    def __init__(self, result: FitResult, window: float, free_run: bool) -> None:
        self.result, self.problem = result, result.problem
        self.where, self.free_run = Coordinates(result), free_run
        self.simulator = Simulator(self.problem, result)
        self._units: dict[int, FloatArray] = {}
        self._third = [m.n // SIMULATION_FOLDS for m in self.problem.motions]
        self._dt = self.problem.motions[0].dt
        self._centres = [self.where.one_step(self._rows(f, False)) for f in range(SIMULATION_FOLDS)]
        self._edge = 0 if free_run else round(EDGE / self._dt)
        longest = min(min(self._third) - self._edge - 1, self._unbroken())
        self.horizon = longest if free_run else self._asked(window, longest)
        self.judged = self.horizon * self._dt
        self.before = self._errors(self._centres)

    def _unbroken(self) -> int:
        """Instants of the longest window that each third holds, in some run, beside its gaps."""
        return min(
            max(
                b - a - 1
                for i, third in enumerate(self._third)
                for a, b in [(0, 1), *self._whole(i, f * third, (f + 1) * third)]
            )
            for f in range(SIMULATION_FOLDS)
        )

    def _whole(self, i: int, a: int, b: int) -> list[tuple[int, int]]:
        """Stretches of part i between two instants, without its gaps and its blurred start."""
        cut = ((max(a, x, self._edge), min(b, y)) for x, y in self.problem.stretches(i))
        return [(x, y) for x, y in cut if y > x]

    def _asked(self, window: float, longest: int) -> int:
        """Instants of the windows that are judged.

        Raises
        ------
        ConfigError
            If they do not fit into a third of the shortest run.
        """
        if window:
            if not 20 <= window / self._dt <= longest:
                raise ConfigError(
                    f"windows of {window:g} s: expected {20 * self._dt:.2g} to "
                    f"{longest * self._dt:.3g} s, a third of the shortest run"
                )
            return round(window / self._dt)
        usual = [round(x / self._dt) for x in USUAL if x / self._dt <= longest]
        for horizon in usual:
            found = self.simulator([Asked(self.result, self._heldout(horizon), horizon)])[0]
            half = np.ptp(self.problem.span, axis=1) / 2
            if np.all(np.abs(found) < half):
                return horizon
        return usual[-1] if usual else longest

    def lengths(self) -> list[float]:
        """Lengths of windows to fit [s]."""
        least = 20 * self._dt
        return [self.judged * x for x in LENGTHS if self.judged * x >= least]

    def judge(self, plans: list[tuple[float, float]]) -> list[_Fold]:
        """Held-out errors of lengths [s] and pulls."""
        tasks = [
            self._task(round(a / self._dt), pull, fold)
            for a, pull in plans
            for fold in range(SIMULATION_FOLDS)
        ]
        descend(self.where, self.simulator, tasks, STEPS)
        out = []
        for k in range(len(plans)):
            errors = self._errors(
                [t.z for t in tasks[k * SIMULATION_FOLDS : (k + 1) * SIMULATION_FOLDS]]
            )
            ratio = errors.simulated / np.maximum(self.before.simulated, 1e-300)
            out.append(_Fold(errors, float(np.sqrt(np.mean(ratio**2)))))
        return out

    def whole(self, length: float, pull: float) -> FitResult:
        """The refinement on all data."""
        task = self._task(round(length / self._dt), pull, None)
        descend(self.where, self.simulator, [task], LAST)
        # cov z = mean u^2 / number of windows and joints . H^-1
        count = sum(s.size for s in task.starts) * self.problem.d
        level = task.cost / max(count, 1)
        h = task.curvature + task.pull**2 * np.eye(task.z.size)
        return _assembled(
            self.where, task.z, np.asarray(np.linalg.pinv(h) * level, dtype=np.float64)
        )

    def _task(self, horizon: int, pull: float, fold: int | None) -> Task:
        starts = self._fitted(horizon, fold)
        if horizon not in self._units:
            every = [Asked(self.result, self._fitted(horizon, None), horizon)]
            size = np.sqrt(np.mean(self.simulator(every)[0] ** 2, axis=1))
            least = 1e-9 * np.ptp(self.problem.span, axis=1) + 1e-15
            self._units[horizon] = np.maximum(np.median(size, axis=0), least)
        centre = np.zeros(self.where.size) if fold is None else self._centres[fold]
        return Task(starts, horizon, pull, centre, self._units[horizon])

    def _fitted(self, horizon: int, fold: int | None) -> list[IntArray]:
        """First instants of windows outside a third, half over each other, run by run."""
        out = []
        for i, (third, m) in enumerate(zip(self._third, self.problem.motions, strict=True)):
            cuts = [0, m.n] if fold is None else [0, fold * third, (fold + 1) * third, m.n]
            ends = zip(cuts[::2], cuts[1::2], strict=True)
            whole = [x for a, b in ends for x in self._whole(i, a, min(b, m.n - self._edge))]
            parts = [_spaced(a, b, horizon, 2) for a, b in [(0, 0), *whole]]
            out.append(_thinned(np.concatenate(parts), MAX_WINDOWS // len(self.problem.motions)))
        return out

    def _heldout(self, horizon: int, fold: int | None = None) -> list[IntArray]:
        """First instants of windows within thirds, one after the other, run by run."""
        out = []
        for i, third in enumerate(self._third):
            ks = range(SIMULATION_FOLDS) if fold is None else [fold]
            whole = [x for k in ks for x in self._whole(i, k * third, (k + 1) * third)]
            parts = [_spaced(a, b, horizon, 1) for a, b in [(0, 0), *whole]]
            out.append(_thinned(np.concatenate(parts), MAX_WINDOWS))
        return out

    def _rows(self, fold: int, inside: bool) -> NDArray[np.bool_]:
        """Rows (n,) of the one-step fit inside or outside a third."""
        spans = [m.n * m.dt for m in self.problem.motions]
        part = self.problem.t * SIMULATION_FOLDS // np.array(spans)[self.problem.run]
        return np.asarray((np.minimum(part, SIMULATION_FOLDS - 1) == fold) == inside)

    def _errors(self, zs: Sequence[FloatArray]) -> SimulationErrors:
        """Errors of the models of every fold on its held-out third."""
        models = [self.where.at(z) for z in zs]
        asked = [
            Asked(m, self._heldout(self.horizon, k), self.horizon) for k, m in enumerate(models)
        ]
        each = np.concatenate([np.mean(e**2, axis=1) for e in self.simulator(asked)])
        left = np.empty_like(self.problem.y)
        for k, m in enumerate(models):
            rows = self._rows(k, True)
            left[:, rows] = _residual(m)[:, rows]
        one = relative(left, self.problem.effort)
        return SimulationErrors(one, np.sqrt(np.mean(each, axis=0)), each)


def _spaced(a: int, b: int, horizon: int, overlap: int) -> IntArray:
    """First instants of windows between two, `overlap` of them over each instant."""
    if b - a <= horizon:
        return np.zeros(0, dtype=np.int_)
    count = 1 + overlap * (b - a - horizon - 1) // horizon
    return np.linspace(a, b - horizon - 1, count).astype(np.int_)


def _thinned(starts: IntArray, most: int) -> IntArray:
    """At most so many of them, evenly."""
    few = np.linspace(0, starts.size - 1, min(starts.size, max(most, 1)))
    return starts[few.astype(np.int_)]


def _official(result: FitResult, other: Problem, horizon: int = 0) -> SimulationErrors:
    """Both errors on other runs: windows one after the other, or with 0 the whole of each.

    None leaves its stretch between gaps.
    """
    one = relative(predict(result, other), other.effort)
    simulator, each = Simulator(other, result), list[FloatArray]()
    for k, m in enumerate(other.motions):
        edge = round(EDGE / m.dt) if horizon else 0
        for a, b in other.stretches(k):
            start = max(a, edge)
            long = min(horizon or m.n, b - start - 1)
            if long < SHORTEST_WINDOW:
                continue
            first = _spaced(start, b, long, 1)
            starts = [first if i == k else first[:0] for i in range(len(other.motions))]
            found = simulator([Asked(result, starts, long, every=1)])[0]
            each.append(np.mean(found**2, axis=1))
    if not each:
        raise DataError("gaps leave no stretch of the held-out runs that is long enough")
    square = np.concatenate(each)
    return SimulationErrors(one, np.sqrt(np.mean(square, axis=0)), square)


def _like(problem: Problem, others: Sequence[Recording]) -> Problem:
    """Other runs with the filters of a problem."""
    return Problem(
        list(others), problem.source, problem.explains, rates=problem.rates, span=problem.span
    )


def _residual(result: FitResult) -> FloatArray:
    """One-step residual (d, n) of a model whose values have moved."""
    problem = result.problem
    x, _ = stack(problem, result.terms)
    out: FloatArray = (problem.y.reshape(-1) - x @ result.theta).reshape(problem.d, problem.n)
    return out


def _assembled(where: Coordinates, z: FloatArray, cov: FloatArray) -> FitResult:
    """The model at z with its values, their errors and its one-step residual."""
    moved, given = where.at(z), where.result
    numbers = dict(zip(moved.names, map(float, moved.theta), strict=True)) | where.shapes(moved)
    errors, values = where.errors(cov), dict(given.values)
    source = "simulated " + next(iter(values.values())).source
    for name, number in numbers.items():
        old = values[name]
        if old.source == "given" or name not in errors:
            continue
        end = number in (old.lower, old.upper)
        values[name] = replace(old, value=number, stderr=errors[name], at_bound=end, source=source)
    effects = tuple(
        replace(u, values={k: values.get(k, v) for k, v in u.values.items()})
        for u in given.model.effects
    )
    x, _ = stack(given.problem, moved.terms)
    return replace(
        moved,
        model=replace(given.model, effects=effects),
        values=values,
        residual=_residual(moved),
        x=x,
    )
