"""A floor that holds something systematic is said to, where a model only seems to be right."""

import plants
import pytest

import hil
from hil.commands.compare import text
from hil.diagnosis import residuals


@pytest.fixture(scope="module")
def failing():
    run = plants.axis(1, extra=lambda t, q, v: 0.3 * v * abs(v))
    return hil.compare([run], hil.base_model(run.robot))


def test_an_error_at_a_floor_that_fails_in_places_is_said_to(failing):
    # a floor as it comes out where two effects that are missing hide each other
    ((code, said),) = residuals.seeming({"joint1": 1.05}, failing.where)
    assert code == residuals.SEEMING
    assert said.startswith("joint1: the error is near the noise floor, but")


def test_a_joint_far_above_its_floor_does_not_seem_right(failing):
    assert residuals.seeming({"joint1": 3.0}, failing.where) == []
    assert residuals.SEEMING not in [f.code for f in failing.faults]


def test_a_right_model_is_not_said_to_seem_so():
    run = plants.axis(2)
    assert "near the noise floor" not in text(hil.compare([run], hil.base_model(run.robot)))
