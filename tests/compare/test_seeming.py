"""A floor that holds something systematic is said to, where a model only seems to be right."""

from dataclasses import replace

import compare_plants as plants

import hil
from hil.commands.compare import text


def test_an_error_at_a_floor_that_fails_in_places_is_said_to():
    run = plants.axis(1, extra=lambda t, q, v: 0.3 * v * abs(v))
    found = hil.compare([run], hil.base_model(run.robot))
    said = "joint1: its error is near a floor that no model at hand goes below"
    assert said not in text(found)
    # a floor as it comes out where two effects that are missing hide each other
    assert said in text(replace(found, heldout_floor=0.95 * found.heldout.rms))


def test_a_right_model_is_not():
    run = plants.axis(2)
    assert "near a floor" not in text(hil.compare([run], hil.base_model(run.robot)))
