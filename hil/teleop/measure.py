"""Hybrid matrix from data: several experiments, whole periods, with its uncertainty.

    H = S_yu S_uu^-1,   y = (f_m, -v_s),   u = (v_m, f_s)

pooled over experiments whose u differ: against one linear environment v_m and f_s go together
and H is not identifiable.  Only whole periods of a periodic motion are transformed (a tapered
window would bias h12 by tens of percent); the scatter from period to period is the uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.errors import DataError
from hil.teleop.hybrid import ComplexArray, FloatArray

#: Condition of the pooled input spectrum above which H is not determined.
LIMIT = 30.0


@dataclass(frozen=True)
class Experiment:
    """One axis of one run over whole periods.

    Parameters
    ----------
    vm, fm, vs, fs : ndarray (n,)
        Speeds [m/s], operator's force ON the master, slave's force ON the environment [N].
    periods : int
        Periods in the record; n must be a multiple.
    period : float
        Sample period [s].
    """

    vm: FloatArray
    fm: FloatArray
    vs: FloatArray
    fs: FloatArray
    periods: int
    period: float

    def __post_init__(self) -> None:
        if self.periods < 2 or self.vm.size % self.periods:
            raise DataError(
                f"{self.vm.size} samples are not {self.periods} whole periods (at least 2)"
            )

    def spectra(self, harmonic: int) -> tuple[ComplexArray, ComplexArray]:
        """Y and u of each period at a harmonic, (periods, 2) each."""
        n = self.vm.size // self.periods
        wave = np.exp(-2j * np.pi * harmonic * np.arange(n) / n) * 2 / n
        rows = np.stack([self.fm, -self.vs, self.vm, self.fs]).reshape(4, self.periods, n) @ wave
        return rows[:2].T, rows[2:].T


@dataclass(frozen=True)
class Measured:
    """Hybrid matrix at one frequency.

    Parameters
    ----------
    w : float
        [rad/s].
    h, std : ndarray (2, 2)
        Estimate (complex) and standard error of its magnitude's scatter, real and imaginary
        part together.
    condition : float
        Of the pooled input spectrum, both inputs scaled to unit size.
    """

    w: float
    h: ComplexArray
    std: FloatArray
    condition: float


def estimate(experiments: Sequence[Experiment], harmonic: int = 1) -> Measured:
    """Hybrid matrix at one harmonic of the motion.

    Parameters
    ----------
    experiments : sequence of Experiment
        At least two that differ in their environment, with the same length of a period.
    harmonic : int
        Number of the harmonic.

    Raises
    ------
    DataError
        If the experiments do not tell v_m and f_s apart.
    """
    parts = [e.spectra(harmonic) for e in experiments]
    lengths = {e.vm.size // e.periods * e.period for e in experiments}
    if len(lengths) != 1:
        raise DataError("the experiments have periods of different length")
    h, condition = _solve([y.mean(0) for y, _ in parts], [u.mean(0) for _, u in parts])
    if not condition < LIMIT:
        raise DataError(
            f"v_m and f_s go together in these {len(parts)} runs (condition {condition:.3g}, at "
            f"most {LIMIT:g}): H is not identifiable; add a run against another environment"
        )
    # jackknife over the periods of every experiment
    variance = np.zeros((2, 2))
    for k, (y, u) in enumerate(parts):
        n, left = len(y), []
        for j in range(n):
            keep = np.arange(n) != j
            ys = [y[keep].mean(0) if i == k else a.mean(0) for i, (a, _) in enumerate(parts)]
            us = [u[keep].mean(0) if i == k else b.mean(0) for i, (_, b) in enumerate(parts)]
            left.append(_solve(ys, us)[0])
        spread = np.array(left) - np.mean(left, axis=0)
        variance += (n - 1) / n * (np.abs(spread) ** 2).sum(0)
    return Measured(2 * np.pi * harmonic / lengths.pop(), h, np.sqrt(variance), condition)


def _solve(y: list[ComplexArray], u: list[ComplexArray]) -> tuple[ComplexArray, float]:
    """H from one row (2,) per experiment, and the condition of the scaled inputs."""
    right, left = np.array(y), np.array(u)
    scale = np.maximum(np.abs(left).max(axis=0), 1e-300)
    unit = left / scale
    values = np.linalg.svd(unit, compute_uv=False)
    condition = float(values[0] / max(values[-1], 1e-300)) if len(u) > 1 else float("inf")
    h = np.linalg.lstsq(unit, right, rcond=None)[0].T / scale
    return np.asarray(h, np.complex128), condition
