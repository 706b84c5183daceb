"""Multi-step error: the model simulated forward from measured states, over short horizons.

One-step (inverse dynamics) error can fall while the simulated motion gets worse; both are
shown, always.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.identify.context import carrying
from hil.identify.forward import Windows, forward, groups, joined, looked_at
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
