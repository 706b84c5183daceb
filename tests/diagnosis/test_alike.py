"""Which candidates look alike beside what the model has already."""

import plants
import pytest

from hil.diagnosis.attribution import overlap
from hil.diagnosis.evidence import gather
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.models.model import base_model


@pytest.fixture(scope="module")
def evidence():
    run = plants.smooth_axis(2, seconds=20.0, rate=250.0, extra=lambda t, q, v, a: 0.12 * q)
    model = base_model(run.robot)
    return gather(fit(Problem([run], model.robot), model))


@pytest.mark.parametrize("other", ["unbalance", "position-torque"])
def test_a_column_that_the_model_holds_tells_nothing_apart(evidence, other):
    """The spring's second column is the offset that the model has: it leaves rounding alone."""
    found = {c.name: c for c in evidence.candidates}
    assert overlap(found["spring"], found[other], evidence.projector) > 0.99


def test_a_wave_is_no_spring(evidence):
    found = {c.name: c for c in evidence.candidates}
    assert overlap(found["spring"], found["cogging"], evidence.projector) < 0.9
