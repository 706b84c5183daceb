"""A coarse encoder in a velocity loop: the band narrows until the counts are not the message."""

import numpy as np
import pytest

from hil.diagnosis.engine import diagnose
from hil.identify.bands import CLEAR, choose
from hil.identify.problem import Problem
from hil.models.model import Band, base_model
from hil.record.recording import Recording, RobotSource

AXIS = base_model(RobotSource("single-axis"))
FS = 500.0


def geared(counts: int, seed: int, peak: float = 0.0) -> Recording:
    """A joint that a velocity loop on its counts moves; tanh and, if asked, Stribeck friction."""
    rng, dt, n = np.random.default_rng(seed), 0.2 / FS, int(25 * FS)
    w, phase = 2 * np.pi * rng.uniform(0.05, 0.5, 5), rng.uniform(0, 6, 5)
    step = 2 * np.pi / counts
    q = v = speed = last = integral = 0.0
    start = 0.3 * np.sin(phase).sum()
    rows = np.empty((n, 2))
    for k in range(n):
        angle = w * k / FS + phase
        goal, rate = 0.3 * np.sin(angle).sum() - start, 0.3 * (w * np.cos(angle)).sum()
        seen = step * np.round(q / step)
        speed += 0.1 * ((seen - last) * FS - speed)
        last = seen
        integral += 100.0 * (goal - seen) / FS
        tau = 150.0 * (goal - seen) + 25.0 * (rate - speed) + integral
        rows[k] = seen, tau + 0.1 * rng.normal()
        for _ in range(5):
            rub = (4.0 + peak / (1.0 + (v / 0.08) ** 2)) * np.tanh(v / 0.02) + 6.0 * v
            v += dt * (tau - rub) / 1.6
            q += dt * v
    t = np.arange(n) / FS
    return Recording("gear", "arm", ("joint1",), t, rows[:, :1], rows[:, 1:])


@pytest.mark.parametrize("peak", [0.0, 2.0])
def test_noise_of_two_thousand_counts_gets_no_name(peak: float) -> None:
    d = diagnose([geared(2000, 1, peak)], AXIS, [geared(2000, 2, peak)])
    assert {f.effect for f in d.findings} <= ({"stribeck"} if peak else set())
    assert d.ladder[0].heldout.relative[0] < 5.0  # behind a filter of 25 Hz 22 %


def test_the_band_narrows_only_as_far_as_the_counts_ask() -> None:
    coarse, fine = geared(2000, 1), geared(200_000, 1)
    narrow, wide = (choose([r], Band(), moving=True) for r in (coarse, fine))
    assert narrow.effort < 12.0 <= wide.effort
    assert wide == choose([fine], Band())
    problem = Problem([coarse], AXIS.robot)
    rms = np.sqrt(np.mean(problem.qd**2))
    assert rms > 0.8 * CLEAR * problem.speed_noise[0]
    given = Band(position_hz=75.0, effort_hz=25.0)
    assert choose([coarse], given, moving=True) == choose([coarse], given)
