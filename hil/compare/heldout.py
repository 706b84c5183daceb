"""Errors on data that the parameters have not seen."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hil.compare.evidence import Evidence, floor_of
from hil.errors import DataError
from hil.identify.bounds import bounded, limits
from hil.identify.fit import fit, predict, time_blocks
from hil.identify.normal import ENOUGH, Normal
from hil.identify.problem import Problem
from hil.identify.regression import Basis, basis
from hil.identify.result import FitResult, relative
from hil.identify.validity import outside
from hil.record.checks import check
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]
FOLDS = 5


@dataclass(frozen=True)
class HeldOut:
    """Residuals on held-out data.

    Parameters
    ----------
    residual, effort : ndarray (d, n)
        Residual and measured effort after the same filter.
    blocks : ndarray (n,)
        Blocks of time, for standard errors.
    kind : str
        ``"holdout"`` (other runs) or ``"folds"`` (contiguous fifths of the same runs).
    run : ndarray (n,)
        Run of each instant.
    names : tuple of str
        Names of the runs.
    """

    residual: FloatArray
    effort: FloatArray
    blocks: NDArray[np.int_]
    kind: str
    run: NDArray[np.int_] = field(default_factory=lambda: np.zeros(0, dtype=np.int_))
    names: tuple[str, ...] = ()

    @property
    def rms(self) -> FloatArray:
        """Rms residual (d,)."""
        return self._rms(self.residual)

    @property
    def effort_rms(self) -> FloatArray:
        """Rms measured effort at the same instants (d,)."""
        return self._rms(self.effort)

    def _rms(self, x: FloatArray) -> FloatArray:
        moving = np.sum(self.effort != 0.0, axis=1)  # zero where the joint stands still
        out: FloatArray = np.sqrt(np.sum(x**2, axis=1) / np.maximum(moving, 1))
        return out

    @property
    def relative(self) -> FloatArray:
        """100 rms(residual) / rms(effort) (d,) [%]."""
        return relative(self.residual, self.effort)

    @property
    def relative_all(self) -> float:
        """The same over all joints together, each in its own effort's scale [%]."""
        return float(np.sqrt(np.mean(self.relative**2)))

    def standard_error(self) -> FloatArray:
        """Standard error of `relative` from the spread over blocks (d,)."""
        count = int(self.blocks.max()) + 1
        size = np.bincount(self.blocks, minlength=count)
        power = np.stack([np.bincount(self.blocks, r**2, minlength=count) for r in self.residual])
        mean = power.sum(axis=1) / size.sum()
        spread = np.sqrt(np.sum((power - mean[:, None] * size) ** 2, axis=1)) / size.sum()
        out: FloatArray = self.relative * spread / np.maximum(2 * mean, 1e-300)
        return out

    def gain(self, before: HeldOut, j: int) -> float:
        """Fall of joint j's squared error against `before`, in standard errors (paired blocks)."""
        fall = np.bincount(self.blocks, before.residual[j] ** 2 - self.residual[j] ** 2)
        spread = float(np.sqrt(np.sum((fall - fall.mean()) ** 2)))
        return float(fall.sum()) / max(spread, 1e-300)

    def share(self, first: HeldOut, floor: float, j: int) -> tuple[float, float]:
        """Share of joint j's squared error above `floor` that is gone since `first`, and its se.

        With A and B the sums of squares after and before and F the floor's, s = (B - A) / (B - F);
        blocks are paired, so that  se(s)^2 = sum ((1 - s) b_k - a_k)^2 / (B - F)^2  about the
        mean, the floor being taken as known.
        """
        before = np.bincount(self.blocks, first.residual[j] ** 2)
        after = np.bincount(self.blocks, self.residual[j] ** 2)
        moving = float(np.sum(self.effort[j] != 0.0))
        excess = max(float(before.sum()) - moving * floor**2, 1e-300)
        share = float(before.sum() - after.sum()) / excess
        each = (1.0 - share) * before - after
        return share, float(np.sqrt(np.sum((each - each.mean()) ** 2))) / excess


class Examiner:
    """Evaluates fits on held-out runs if there are any, else on contiguous fifths.

    Parameters
    ----------
    problem : Problem
        The runs of the fit.
    holdout : list of Recording
        Other runs; may be empty.
    """

    def __init__(self, problem: Problem, holdout: list[Recording]) -> None:
        self.kind = "holdout" if holdout else "folds"
        self._problem = problem
        self._other: Problem | None = None
        #: The last model fitted to the held-out runs alone, once their floor was asked for.
        self.alone: FitResult | None = None
        if holdout:
            for other in holdout:
                _of_robot(other, problem)
                _sound(other)
            _other_than(problem.recordings, holdout)
            self._other = Problem(
                holdout, problem.source, problem.explains, rates=problem.rates, span=problem.span
            )

    def outside(self, result: FitResult) -> list[str]:
        """Where the held-out runs leave the range of the fit; empty without any."""
        if self._other is None:
            return []
        predict(result, self._other)  # the load there is the fit's
        return outside(result.model.valid, self._other, "held-out session")

    def __call__(self, result: FitResult) -> HeldOut:
        """Held-out residuals of a fit."""
        if self._other is not None:
            if self._other.shift != self._problem.shift:
                self._other.shift_effort(self._problem.shift - self._other.shift)
            residual = predict(result, self._other)
            return _held(residual, self._other, self.kind)
        return _held(_folds(result), self._problem, self.kind)

    def floor(self, result: FitResult, evidence: Evidence) -> FloatArray | None:
        """Noise floor of the held-out runs themselves (d,); None without any.

        `evidence` is that beside the fit: its candidates are what might be explained there.
        """
        if self._other is None:
            return None
        self.alone = fit(self._other, result.model)
        return np.asarray(floor_of(self.alone, evidence).rms)


def _of_robot(other: Recording, problem: Problem) -> None:
    """Refuse a held-out run of another robot."""
    if other.joints != problem.joints:
        raise DataError(
            f"held-out session {other.name!r} has joints {', '.join(other.joints)}, the "
            f"fitted ones {', '.join(problem.joints)}; give sessions of one robot"
        )
    ours, theirs = problem.recordings[0].robot, other.robot
    if _named(ours) and _named(theirs) and ours.preset != theirs.preset:
        raise DataError(
            f"held-out session {other.name!r} is of the robot {theirs.preset!r}, the fitted ones "
            f"of {ours.preset!r}; give sessions of one robot"
        )


def _named(robot: RobotSource) -> bool:
    """Whether a session says of which known robot it is; axes may be anybody's."""
    return not robot.urdf and robot.preset not in ("", "single-axis")


def _sound(run: Recording) -> None:
    """Refuse a held-out run whose faults would make every error meaningless."""
    errors = [f.sentence for f in check(run) if f.severity == "error"]
    if errors:
        raise DataError(
            f"held-out session {run.name!r} has faults, nothing can be judged on it: "
            f"{'; '.join(errors[:3])}. See 'hil info', then mend or leave it out."
        )


def _other_than(fitted: list[Recording], holdout: list[Recording]) -> None:
    """Refuse a held-out run that was fitted: nothing is held out then."""
    for h in holdout:
        for r in fitted:
            if np.array_equal(h.q, r.q) and np.array_equal(h.tau, r.tau):
                raise DataError(
                    f"held-out session {h.name!r} holds the same data as the fitted session "
                    f"{r.name!r}; give another one, or none: then contiguous fifths are held out"
                )


def _held(residual: FloatArray, problem: Problem, kind: str) -> HeldOut:
    names = tuple(r.name for r in problem.recordings)
    return HeldOut(residual, problem.effort, _blocks(problem), kind, problem.run, names)


def _blocks(problem: Problem) -> NDArray[np.int_]:
    """Blocks of a twentieth of the shortest run, 0.2 to 1 s."""
    shortest = float(min(np.bincount(problem.run))) / problem.rate
    return time_blocks(problem, float(np.clip(shortest / 20, 0.2, 1.0)))


def _folds(result: FitResult) -> FloatArray:
    """Residual of each contiguous fifth, coefficients from the other four."""
    problem = result.problem
    x, y = result.x.reshape(problem.d, problem.n, -1), problem.y
    # what the other folds do not determine stays where the fit began, not where it ended
    start, out = y - x @ result.prior, np.empty_like(y)
    edges = list(pairwise(-(-k * problem.n // FOLDS) for k in range(FOLDS + 1)))
    parts = [Normal.of(x[:, a:b], start[:, a:b], result.sigma) for a, b in edges]
    every = Normal.of(x, start, result.sigma)
    low, high = limits(result.terms, problem)
    held = [
        np.full(s.stop - s.start, t.fixed) for t, s in zip(result.terms, result.slices, strict=True)
    ]
    for part, (a, b) in zip(parts, edges, strict=True):
        train = np.r_[0:a, b : problem.n]
        least = 1.0 / max(float(np.linalg.norm(y[:, train] / result.sigma[:, None])), 1.0)
        if least > ENOUGH:
            step, found = (every - part).solved(least)
        else:
            step, found = _solved(x[:, train], start[:, train], result.sigma, least)
        theta = bounded(result.prior + step, found, low, high)
        theta = np.where(np.concatenate(held), result.theta, theta)
        out[:, a:b] = y[:, a:b] - x[:, a:b] @ theta
    return out


def _solved(
    x: FloatArray, y: FloatArray, sigma: FloatArray, least: float
) -> tuple[FloatArray, Basis]:
    """Shortest theta (p,) of columns (d, n, p) and target (d, n), and the basis."""
    weighted = (x / sigma[:, None, None]).reshape(-1, x.shape[-1])
    target, nothing = (y / sigma[:, None]).reshape(-1), np.zeros(x.shape[-1])
    b = basis(weighted, least)
    return b.solve(target, nothing, np.zeros_like(target)), b
