"""How the effort of a model answers small errors of the motion: against differences of its own."""

from dataclasses import replace

import numpy as np
import plants
import pytest

from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models.model import base_model
from hil.models.transmission import link_inertia


@pytest.fixture(scope="module")
def fitted():
    run = plants.spatial(1, seconds=8.0)
    model = base_model(run.robot)
    return fit(Problem([run], model.robot), model)


def test_a_link_keeps_some_inertia_in_a_posture_beyond_the_fitted_ones(fitted):
    motion = fitted.problem.motions[0]
    whole = link_inertia(motion, 0)
    own = 0.5 * float(np.min(whole) + np.mean(whole))  # more than there is in some postures
    left = link_inertia(motion, 0, own)
    there = whole - own > 0.02 * np.mean(whole - own)
    assert not np.all(there) and np.min(left) > 0
    np.testing.assert_allclose(left[there], (whole - own)[there])


@pytest.mark.parametrize("j", range(3))
def test_coriolis_is_the_derivative_of_what_masses_ask_for_by_a_speed(fitted, j):
    problem = fitted.problem
    motion, step = problem.motions[0], 1e-3 * np.eye(3)[j]
    body, theta = next(
        (t, fitted.theta[s])
        for t, s in zip(fitted.terms, fitted.slices, strict=True)
        if t.effect.name == "rigid-body"
    )
    up, down = (
        body.effect.columns(replace(motion, qd=motion.qd + x, response=None), 0, ()) @ theta
        for x in (step, -step)
    )
    expected = (up - down) / 2e-3
    assert np.max(np.abs(expected)) > 0.05
    got = motion.response.coriolis(j)
    assert np.max(np.abs(got - expected)) < 0.02 * np.max(np.abs(expected))
