"""No fit of the base model leaves less than what its columns reach without bounds."""

from dataclasses import replace

import numpy as np
import plants
import pytest

from hil.diagnosis.columns import Reach
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
