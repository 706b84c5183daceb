"""A slow recording, or a slow machine, of a complete model is the model's."""

import numpy as np
import plants
import pytest

import hil


@pytest.mark.parametrize("rate", [50.0, 100.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_moves_of_few_samples_are_no_effect(seed, rate):
    """Differences of two neighbours made accelerations a fifth too small."""
    run = plants.moved_axis(seed, rate, 60.0, took=(0.25, 0.5))
    answer = hil.diagnose(run, hil.base_model(run.robot))
    assert answer.verdict == "adequate"
    values = hil.fit(run, hil.base_model(run.robot)).to_frame().set_index("parameter")["value"]
    assert values["rigid-body.m"] == pytest.approx(0.1, rel=2e-3)


@pytest.mark.parametrize("width", [0.15, pytest.param(0.6, marks=pytest.mark.slow)])
def test_a_lubricated_slide_lacks_nothing(width):
    """A sign that turns over much of the speed was load friction, saturation or Stribeck's."""

    def extra(t, q, v, a):
        return 0.6 * np.tanh(v / width) - 0.05 * np.tanh(v / 0.01)

    run = plants.moved_axis(3, 200.0, 30.0, took=(0.4, 0.9), extra=extra)
    answer = hil.diagnose(run, hil.base_model(run.robot))
    assert answer.verdict == "adequate"
    (only,) = answer.ladder
    values = only.result.values
    assert values["j1.coulomb.fc"].value == pytest.approx(0.6, rel=0.03)
    assert values["j1.coulomb.v0"].value == pytest.approx(width, rel=0.05)


@pytest.mark.parametrize("seed", [30, 70, *plants.seeds(20, 50, 60, 80)])
def test_short_rests_between_slow_rows_lack_nothing(seed):
    """Sticking for two or three rows, and the acceleration between them, were friction laws."""
    run = plants.sent_axis(seed, 50.0)
    answer = hil.diagnose(run, hil.base_model(run.robot))
    assert answer.verdict == "adequate"
