"""No fit of the base model leaves less than what its columns reach without bounds."""

from dataclasses import replace

import numpy as np
import plants
import pytest

from hil.diagnosis.grams import Reach
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models.model import base_model


@pytest.mark.parametrize("columns", [[0, 1], [1, 0]])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_least_error_is_below_that_of_any_fit(columns: list[int], sign: float) -> None:
    run = plants.coulomb_axes(0, 4000, d=2, drag=0.1)
    problem = Problem([run], run.robot)
    reach = Reach(fit(problem, base_model(run.robot)))
    changed = replace(run, tau=run.tau[:, columns] * np.array([sign, 1.0]))
    other = Problem([changed], run.robot, rates=problem.rates)
    found = fit(other, base_model(run.robot)).relative
    y, effort = other.as_recorded
    least = float(np.sqrt(np.mean(reach.by_joint(y, effort) ** 2)))
    signs = np.array([[sign], [1.0]])
    if columns == [0, 1]:  # another sign is seen without the fit of another problem
        y, effort = (x * signs for x in problem.as_recorded)
        assert np.allclose(reach.by_joint(y, effort), reach.by_joint(*other.as_recorded))
    assert 0.0 < least <= np.sqrt(np.mean(found**2)) * (1 + 1e-9)
    if columns == [1, 0]:  # an effort of white noise and another motion's friction fits none
        assert least > 20.0


def test_nothing_is_known_of_other_models() -> None:
    run = plants.coulomb_axes(0, 4000, d=2, drag=0.1)
    problem = Problem([run], run.robot)
    reach = Reach(fit(problem, base_model(run.robot) + "quadratic-drag"))
    assert not reach.by_joint(*problem.as_recorded).any()


def test_another_sign_is_fitted_without_preparing_the_runs_again() -> None:
    run = plants.coulomb_axes(0, 4000, d=2, drag=0.1)
    problem, model, signs = Problem([run], run.robot), base_model(run.robot), np.array([-1.0, 1.0])
    fit(problem, model)
    changed = [replace(run, tau=run.tau * signs)]
    turned = problem.with_signs(changed, signs)
    anew = Problem(changed, run.robot, rates=problem.rates)
    assert np.allclose(turned.y, anew.y, rtol=1e-12, atol=1e-12 * np.abs(anew.y).max())
    assert np.allclose(turned.recordings[0].tau, anew.recordings[0].tau)
    found, same = fit(turned, model), fit(anew, model)
    assert np.allclose(found.relative, same.relative)
    assert found.values.keys() == same.values.keys()
    # what it was made from is as it was
    assert np.allclose(fit(problem, model).relative, fit(Problem([run], run.robot), model).relative)
