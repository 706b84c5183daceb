"""The noise floor is that beside what was found, not that beside a large missing effect."""

from __future__ import annotations

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis.engine import _begun
from hil.diagnosis.grams import split
from hil.diagnosis.heldout import Examiner
from hil.identify.fit import fit
from hil.identify.problem import Problem


@pytest.mark.parametrize(("weight", "again"), [(20.0, True), (0.5, False)])
def test_the_floor_is_measured_again_once_an_error_has_halved(weight: float, again: bool) -> None:
    """Beside the weight no candidate has the order of a ripple that grows with the speed."""

    def hidden(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return weight * np.sin(q) + 0.1 * np.sin(30.0 * q) * v**2 + 0.05 * v * np.abs(v)

    run = plants.smooth_axis(1, seconds=20.0, rate=250.0, extra=hidden)
    problem, model = Problem([run], run.robot), hil.base_model(run.robot)
    search = _begun(fit(problem, model), split(problem), Examiner(problem, []), 0)
    search.first, _ = search.evidence([0])
    search.rungs.append(search.rung("+ weight", model + "unbalance"))
    before, now = search.first.floor.rms[0], search.evidence([0])[0].floor.rms[0]
    halved = search.now.result.rms[0] < 0.5 * search.rungs[0].result.rms[0]
    assert halved == again
    assert (now < 0.5 * before) == again and now <= before
    assert now > 0.01  # the noise of the effort
