"""A slow recording of a complete model is the model's, whatever its rate."""

import numpy as np
import plants
import pytest

import hil


def moves(seed: int, rate: float, seconds: float = 60.0):
    """Point to point with rests: an inertia with friction that is recorded at `rate`."""
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * rate)) / rate
    q, v, a = np.zeros((3, t.size))
    start, at = 0.5, 0.0
    while start < seconds - 2.0:
        took, size = rng.uniform(0.25, 0.5), rng.uniform(-1.0, 1.0) - at
        s = np.clip((t - start) / took, 0.0, 1.0)
        q += size * s**3 * (10 - 15 * s + 6 * s**2)
        v += size * 30 * s**2 * (1 - s) ** 2 / took
        a += size * 60 * s * (1 - s) * (1 - 2 * s) / took**2
        at, start = at + size, start + took + rng.uniform(0.1, 0.5)
    tau = 0.1 * a + 0.05 * np.tanh(v / 0.01) + 0.02 * v + 0.004 * rng.normal(size=t.size)
    return plants.single(f"moves{seed}", t, q, tau, robot=plants.SINGLE)


@pytest.mark.parametrize("rate", [50.0, 100.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_moves_of_few_samples_are_no_effect(seed, rate):
    run = moves(seed, rate)
    answer = hil.diagnose(run, hil.base_model(run.robot))
    assert answer.verdict == "adequate"
    values = hil.fit(run, hil.base_model(run.robot)).to_frame().set_index("parameter")["value"]
    assert values["rigid-body.m"] == pytest.approx(0.1, rel=2e-3)
