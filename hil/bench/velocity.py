"""Velocity estimators on known motions: error, delay and noise of each, with quantised counts.

The motion is a formula, so its velocity and acceleration are exact at any time; the counts are
floor(q / resolution) at 1 kHz, with the resolution of joint 1 of a PHANTOM Premium 1.5.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from math import pi

import numpy as np

from hil import terminal
from hil.signals.device import FloatArray
from hil.signals.velocity import FilteredAcceleration, estimator
from hil.terminal import Found

_PERIOD = 1e-3
#: Joint 1: 4096 counts a motor turn, gear 13.3 [rad].
_RESOLUTION = 2 * pi / 4096 / 13.3
_SECONDS, _SETTLE = 5.0, 0.5
#: Name in the table, registry name, options.
_CASES: tuple[tuple[str, str, dict[str, object]], ...] = (
    ("first difference", "first-difference", {}),
    ("filtered difference, 30 Hz", "filtered-difference", {"cutoff_hz": 30.0}),
    ("filtered difference, 100 Hz", "filtered-difference", {"cutoff_hz": 100.0}),
    ("FOAW end fit, 16", "foaw-end-fit", {"window": 16}),
    ("FOAW end fit, 24 (default)", "foaw-end-fit", {"window": 24}),
    ("FOAW best fit, 16", "foaw-best-fit", {"window": 16}),
    ("FOAW best fit, 24", "foaw-best-fit", {"window": 24}),
    ("Kalman, 1e4 counts/s^2", "kalman", {"acceleration": 1e4}),
    ("Kalman, 1e5 counts/s^2", "kalman", {"acceleration": 1e5}),
)
#: Filtered acceleration as in the thesis, over two of the estimators.
_SOURCES = (("FOAW end fit", "foaw-end-fit"), ("first difference", "first-difference"))
_CUTOFFS = (10.0, 30.0, 100.0)

#: Sines of a motion: amplitude of the speed [rad/s], frequency [Hz], phase [rad].
Sines = tuple[tuple[float, float, float], ...]
VELOCITY_MOTIONS: dict[str, Sines] = {
    "1 Hz, 0.02 rad/s": ((0.02, 1.0, 0.3),),
    "1 Hz, 0.5 rad/s": ((0.5, 1.0, 0.3),),
    "1 Hz, 3 rad/s": ((3.0, 1.0, 0.3),),
    "hand": (
        (0.3, 0.31, 0.1),
        (0.4, 0.73, 1.0),
        (0.3, 1.9, 2.0),
        (0.1, 4.1, 0.7),
        (0.02, 9.3, 0.2),
    ),
    "20 Hz, 0.2 rad/s": ((0.2, 20.0, 0.3),),
}


@dataclass(frozen=True)
class VelocityRow:
    """One estimator on one motion.

    Parameters
    ----------
    method, motion : str
        Names.
    error : float
        RMS of estimate - truth [rad/s, or rad/s^2].
    delay_ms : float
        Delay of the truth that fits the estimate best [ms]; not a number where its standard
        error is above a millisecond.
    noise : float
        RMS that is left with this delay taken off.
    worst : float
        Largest error.
    """

    method: str
    motion: str
    error: float
    delay_ms: float
    noise: float
    worst: float


def velocity(sines: Sines, t: FloatArray) -> FloatArray:
    """Speed of a motion at `t` (n,) [rad/s]."""
    return np.asarray(sum(a * np.sin(2 * pi * f * t + p) for a, f, p in sines))


def true_position(sines: Sines, t: FloatArray) -> FloatArray:
    """Angle of a motion at `t` (n,) [rad]."""
    terms = (-a / (2 * pi * f) * np.cos(2 * pi * f * t + p) for a, f, p in sines)
    return np.asarray(sum(terms))


def acceleration(sines: Sines, t: FloatArray) -> FloatArray:
    """Acceleration of a motion at `t` (n,) [rad/s^2]."""
    return np.asarray(sum(2 * pi * f * a * np.cos(2 * pi * f * t + p) for a, f, p in sines))


def times() -> FloatArray:
    """Sample times of a comparison [s]."""
    return np.asarray(np.arange(round(_SECONDS / _PERIOD)) * _PERIOD, np.float64)


def compare_estimators(motions: Iterable[str] = tuple(VELOCITY_MOTIONS)) -> list[VelocityRow]:
    """All estimators on some motions."""
    rows = []
    for motion in motions:
        sines = VELOCITY_MOTIONS[motion]
        t = times()
        counts = np.floor(true_position(sines, t) / _RESOLUTION).astype(np.int64)
        for label, name, options in _CASES:
            estimate = _follow(name, options, counts)
            rows.append(judge_estimate(label, motion, t, estimate, partial(velocity, sines)))
    return rows


def _compare_acceleration() -> list[VelocityRow]:
    """Filtered acceleration over the default estimator and over the first difference."""
    rows = []
    for motion in ("1 Hz, 0.5 rad/s", "hand"):
        sines = VELOCITY_MOTIONS[motion]
        t = times()
        counts = np.floor(true_position(sines, t) / _RESOLUTION).astype(np.int64)
        for label, name in _SOURCES:
            speed = _follow(name, {}, counts)
            for cutoff in _CUTOFFS:
                method, out = FilteredAcceleration(1, _PERIOD, cutoff), np.zeros(1)
                found = np.zeros(len(t))
                for k in range(len(t)):
                    method.update(speed[k : k + 1], 1, out)
                    found[k] = out[0]
                rows.append(
                    judge_estimate(
                        f"{label}, {cutoff:.0f} Hz", motion, t, found, partial(acceleration, sines)
                    )
                )
    return rows


def _follow(name: str, options: dict[str, object], counts: np.ndarray) -> FloatArray:
    """Speeds [rad/s] that an estimator finds along counts (n,)."""
    method, rate = estimator(name, options, 1, _PERIOD), np.zeros(1)
    found = np.zeros(len(counts))
    method.reset(counts[:1])
    for k in range(1, len(counts)):
        method.update(counts[k : k + 1], 1, rate)
        found[k] = rate[0]
    return found * _RESOLUTION / _PERIOD


def judge_estimate(
    label: str,
    motion: str,
    t: FloatArray,
    found: FloatArray,
    truth: Callable[[FloatArray], FloatArray],
) -> VelocityRow:
    """Error, delay and noise of an estimate `found` (n,) of `truth` at `t` (n,)."""
    keep = t >= _SETTLE
    t, found = t[keep], found[keep]
    error = found - truth(t)
    delays = np.arange(0.0, 25e-3, 0.1e-3)
    left = np.array([np.sqrt(np.mean((found - truth(t - d)) ** 2)) for d in delays])
    k = int(np.argmin(left))
    slope = float(np.sqrt(np.mean(np.gradient(truth(t), _PERIOD) ** 2)))
    # noise of neighbouring estimates is common over about ten of them
    spread = left[k] / slope / np.sqrt(len(t) / 10)
    delay = 1e3 * float(delays[k]) if spread < 1e-3 else float("nan")
    rms = float(np.sqrt(np.mean(error**2)))
    return VelocityRow(label, motion, rms, delay, float(left[k]), float(np.abs(error).max()))


def report() -> str:
    """Tables of errors and delays in Markdown; the same on every machine."""
    return "\n".join(
        [
            *_HEAD,
            "## Velocity [rad/s]",
            "",
            *velocity_table(compare_estimators(), 4),
            "",
            "## Acceleration [rad/s^2]: low-pass filtered first difference of the velocity",
            "",
            *velocity_table(_compare_acceleration(), 2),
            "",
            *_TAKE,
        ]
    )


_URAD = 1e6 * _RESOLUTION
_HEAD = f"""# Velocity and acceleration from encoder counts

Printed by `hil bench velocity --report docs/bench/velocity.md`. Counts of joint 1 of a PHANTOM
Premium 1.5 (one count is {_URAD:.1f} urad) at 1 kHz along known motions; *error* is the rms of
estimate minus truth, *delay* the shift of the truth that fits best (- where the noise hides
it), *noise* the rms that this shift leaves, *worst* the largest error. *hand* is five sines from
0.3 to 9.3 Hz with a peak near 1 rad/s.
""".splitlines()
_TAKE = """Reading it: the first difference has the least delay and by far the most noise. A Kalman
filter has the least noise for its delay, and its delay does not change with the motion, but it must
be set: at 1e4 counts/s^2 it is the slowest of all at 20 Hz. Adaptive windowing sets itself: little
noise at low speed, little delay at high speed, and so a delay that changes with the motion. End
fit and best fit differ at low speed alone. Acceleration is usable only over a filtered velocity.
""".splitlines()


def velocity_table(rows: list[VelocityRow], digits: int) -> list[str]:
    """Rows in Markdown, with so many digits."""
    lines = [
        "| motion | estimator | error | delay [ms] | noise | worst |",
        "|---|---|---|---|---|---|",
    ]
    for r in rows:
        delay = "-" if np.isnan(r.delay_ms) else f"{r.delay_ms:.1f}"
        values = " | ".join(f"{x:.{digits}f}" for x in (r.noise, r.worst))
        lines.append(f"| {r.motion} | {r.method} | {r.error:.{digits}f} | {delay} | {values} |")
    return lines


def cost_ns(name: str, options: dict[str, object], ticks: int = 20_000) -> float:
    """Time of one update of three channels on this machine, median of five runs [ns]."""
    method, rate = estimator(name, options, 3, _PERIOD), np.zeros(3)
    counts = (np.outer(np.arange(ticks), [1.3, 0.2, 5.7])).astype(np.int64)
    runs = []
    for _ in range(5):
        began = time.perf_counter_ns()
        for row in counts:
            method.update(row, 1, rate)
        runs.append((time.perf_counter_ns() - began) / ticks)
    return float(np.median(runs))


def command(args: argparse.Namespace) -> Found:
    """Velocity estimators: error and delay of each, and what an update costs here."""
    terminal.check_page(args.report)
    text = report()
    terminal.write_page(args.report, text)
    rows = [[label, f"{cost_ns(name, options):.0f}"] for label, name, options in _CASES]
    cost = terminal.table(["estimator", "ns"], rows)
    data = {
        "rows": [
            vars(r) | {"delay_ms": None if r.delay_ms != r.delay_ms else r.delay_ms}
            for r in compare_estimators()
        ]
    }
    return f"{text}\nOne update of three channels on this machine\n{cost}", dict(data)
