"""A slow recording of a complete model is the model's, whatever its rate."""

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
