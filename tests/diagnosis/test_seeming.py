"""A floor that holds something systematic is said to, where a model only seems to be right."""

import numpy as np
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


def test_what_is_smaller_than_efforts_are_known_to_is_no_failure():
    """A quiet axis under a load: an eighth of a percent of its effort is far above the noise."""

    def run(size):
        t = np.arange(0, 25, 0.004)
        q, v, a = plants.sines(
            t,
            2 * np.pi * np.array([0.13, 0.31, 0.83]),
            np.array([0.6, 0.3, 0.1]),
            np.array([0.0, 1.0, 2.0]),
        )
        tau = 20.0 + 2.0 * a + 3.0 * v + size * v * np.abs(v)
        tau += 2e-4 * np.random.default_rng(1).normal(size=t.size)
        return plants.single("axis", t, q, tau)

    small, large = (run(size) for size in (0.05, 1.0))
    quiet, loud = (
        hil.compare([r], hil.base_model(r.robot), simulate=False) for r in (small, large)
    )
    assert any(residuals.regions(quiet.result, quiet.evidence.floor).values())
    assert not any(quiet.where.values())
    assert "nowhere above the noise band by more than 0.3 % of the rms effort" in text(quiet)
    assert residuals.SEEMING not in [f.code for f in quiet.faults]
    assert any(loud.where.values()) and "predicts too" in text(loud)
