"""Efforts of an instant, and motions that come again: what the clock does is no missing physics."""

import numpy as np
import plants
import pytest

import hil
from hil.identify.problem import Problem
from hil.identify.regression import phases, time_blocks
from hil.models.model import base_model


def prepared(run):
    model = base_model(run.robot)
    return Problem([run], model.robot, model.explains, model.band)


def diagnosed(*args, **more):
    run = plants.repeated(*args, **more)
    return hil.diagnose(run, base_model(run.robot))


@pytest.mark.parametrize("fs", [100.0, 101.3, 200.0])
def test_how_the_efforts_were_sampled_is_seen_where_friction_turns(fs):
    assert prepared(plants.repeated(1, fs)).motions[0].average == 0.0
    assert prepared(plants.repeated(1, fs, averaged=True)).motions[0].average > 0.0


def test_efforts_whose_noise_hides_it_count_as_averages():
    assert prepared(plants.repeated(1, noise=30.0)).motions[0].average > 0.0


@pytest.mark.parametrize("averaged", plants.seeds(False, True))
@pytest.mark.parametrize("seed", plants.seeds(3, 1, 2))
def test_a_clean_arm_on_a_motion_that_comes_again_has_no_name(seed, averaged):
    d = diagnosed(seed, averaged=averaged)
    assert d.verdict == "adequate" and not d.findings


@pytest.mark.slow
@pytest.mark.parametrize("fs", [100.0, 200.0])
def test_friction_at_low_speed_is_all_that_is_named(fs):
    d = diagnosed(1, fs, stribeck=0.35)
    assert [(f.effect, f.joint) for f in d.findings] == [("stribeck", "joint2")]


@pytest.mark.parametrize("fs", [100.0, 101.3])
def test_blocks_of_one_phase_are_one(fs):
    """The 10 s that come again are no whole number of the rows that are compared."""
    problem = prepared(plants.repeated(5, fs))
    lag, count = phases(problem, 0, round(0.5 * problem.rate))
    assert lag == pytest.approx(10.0 * problem.rate, abs=0.1) and count >= 12
    blocks = time_blocks(problem, 0.5)
    assert blocks.max() + 1 == count
    at = np.arange(problem.n - int(np.ceil(lag)))
    again = blocks[(at + lag).round().astype(int)]
    assert np.mean(again == blocks[at]) > 0.9


def test_a_motion_that_does_not_come_again_has_blocks_of_time():
    problem = prepared(plants.spatial(1))
    assert phases(problem, 0, 10) == (0.0, 0)
    assert np.all(np.diff(time_blocks(problem, 0.5)) >= 0)
