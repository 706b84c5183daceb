"""How the effort of a model answers small errors of the motion: against differences of its own."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import plants
import pytest

from hil.identify.context import update_load
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models import catalogue
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


def test_a_response_ends_with_its_fit():
    """Each had held that of the fit before: on eight joints gigabytes by the end of a search."""
    run = plants.spatial(1, seconds=4.0)
    model = base_model(run.robot)
    first = fit(problem := Problem([run], model.robot), model)
    every = []
    for k in range(10):
        update_load(problem, first.terms, (1 + 0.1 * k) * first.theta, first.slices)
        every.append(weakref.ref(problem.motions[0].response))
    gc.collect()
    # one or two serve columns that are kept
    assert sum(response() is not None for response in every) < 4


def test_what_a_turned_base_adds_is_no_slope_of_a_joint():
    """Its effort was there along the motion and not beside it: a difference over the step."""
    run = plants.spatial(1, seconds=8.0)
    model = base_model(run.robot) + "base-tilt"
    tilted = fit(Problem([run], model.robot), model)
    tilted = fit(tilted.problem, model)  # its columns are those of a response, which is there now
    motion, step = tilted.problem.motions[0], 1e-4 * np.eye(3)[1]
    masses = _masses(tilted)
    up, down = (masses(replace(motion, q=motion.q + x)) for x in (step, -step))
    expected = (up - down) / 2e-4
    got = motion.response.slope(1)
    assert np.max(np.abs(got - expected)) < 0.02 * np.max(np.abs(expected))


def _masses(fitted):
    """Efforts of the fitted masses along any motion."""
    body, theta = next(
        (t, fitted.theta[s])
        for t, s in zip(fitted.terms, fitted.slices, strict=True)
        if t.effect.name == "rigid-body"
    )
    return lambda motion: body.effect.columns(replace(motion, response=None), 0, ()) @ theta


@pytest.mark.parametrize("j", range(3))
def test_a_zero_and_a_ratio_are_derivatives_of_what_the_model_asks_for(fitted, j):
    motion, masses, step = fitted.problem.motions[0], _masses(fitted), 1e-4
    only = np.eye(3)[j]
    up, down = (masses(replace(motion, q=motion.q + x * only)) for x in (step, -step))
    zero = catalogue.get("joint-zero").columns(motion, j, ())[:, :, 0]
    np.testing.assert_allclose(-zero, (up - down) / (2 * step), rtol=1e-3, atol=1e-3)

    def read(share):
        less = 1.0 - share * only
        return replace(motion, q=motion.q * less, qd=motion.qd * less, qdd=motion.qdd * less)

    fall = (masses(read(step)) - masses(read(-step))) / (2 * step)
    fall[:, j] -= motion.response.damping[j] * motion.qd[:, j]
    # the rotor's inertia is the motor's, and felt on its own joint alone
    armature = fitted.values.get(f"j{j + 1}.armature.ia")
    fall[:, j] -= (armature.value if armature else 0.0) * motion.qdd[:, j]
    ratio = catalogue.get("joint-ratio").columns(motion, j, ())[:, :, 0]
    np.testing.assert_allclose(ratio, fall, atol=0.02 * np.max(np.abs(fall)))
