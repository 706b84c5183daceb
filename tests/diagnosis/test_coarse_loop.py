"""A servo on a coarse encoder: what it answers to the counts is no missing physics."""

import numpy as np
import pytest

import hil
from hil.diagnosis.artefacts import POSITION_NOISE, coarse
from hil.identify.problem import Problem
from hil.record.recording import Recording

J, FC, FV, STEPS = 0.018, 0.12, 0.05, 4


def axis(seed: int, counts: int, seconds: float = 25.0) -> Recording:
    """J q'' = u - FC sgn q' - FV q', u a PD law with feedforward on the counted position."""
    rng, h, step = np.random.default_rng(seed), 1e-3, 2 * np.pi / counts
    t = np.arange(0.0, seconds, h)
    f = np.array([0.07, 0.16, 0.4, 0.9]) * rng.uniform(0.9, 1.1, 4)
    w, angle = 2 * np.pi * f, np.outer(t, 2 * np.pi * f) + rng.uniform(0, 6.28, 4)
    a = np.array([0.9, 0.5, 0.25, 0.08])
    goal, rate = np.sin(angle) @ a, np.cos(angle) @ (a * w)
    speed_up = -np.sin(angle) @ (a * w**2)
    q, v, before = float(goal[0]), float(rate[0]), 0.0
    seen, effort = np.empty((2, t.size))
    for k in range(t.size):
        seen[k] = np.round(q / step) * step
        moved = (seen[k] - before) / h if k else v
        before = seen[k]
        u = 25.0 * (goal[k] - seen[k]) + 0.7 * (rate[k] - moved) + J * speed_up[k]
        effort[k] = u
        for _ in range(STEPS):
            free = (v + h / STEPS * u / J) / (1 + h / STEPS * FV / J)
            v = float(np.sign(free) * max(abs(free) - h / STEPS * FC / J, 0.0))
            q += h / STEPS * v
    effort += 0.01 * rng.standard_normal(t.size)
    return Recording("axis", "arm", ("joint1",), t, seen[:, None], effort[:, None])


@pytest.mark.parametrize("counts", [2000, 4000])
@pytest.mark.parametrize("seed", [1, 2])
def test_nothing_is_missing_behind_a_coarse_encoder(counts, seed):
    run, other = axis(seed, counts), axis(seed + 10, counts)
    assert counts > 2000 or coarse(Problem([run], run.robot)).all()
    for held in ([], [other]):
        d = hil.diagnose([run], hil.base_model(run.robot), held)
        assert d.verdict == "adequate" and not d.findings, (d, d.warnings)
        assert not [text for code, text in d.warnings if code == "unlike-noise"]


def test_a_fine_encoder_is_not_coarse():
    run = axis(1, 100_000)
    assert not coarse(Problem([run], run.robot)).any()
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert d.verdict == "adequate" and POSITION_NOISE not in [code for code, _ in d.warnings]
