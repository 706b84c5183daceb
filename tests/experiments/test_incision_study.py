"""The study of the incision: what a held shaft foresees, and a session of each kind."""

from __future__ import annotations

import numpy as np
import pytest

from hil.controllers.cartesian import CartesianCoupling
from hil.errors import ConfigError
from hil.experiments import incision
from hil.experiments.pages import means
from hil.rig.config import load_rig
from hil.rig.open import build_controller


def test_a_held_shaft_bears_moments_at_its_tip_and_forces_along_it_alone():
    """Springs of tip and turning in one freedom: a moment about the incision over its lever."""
    k, kr, deep = 1500.0, 12.0, 0.12
    shaft, along = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1e-3]])
    turned = np.array([[0.0, 0.03, 0.0]])  # what the free shaft has turned by, its tip in place
    found = incision.held_error(along, turned, shaft, np.array([deep]), k, kr)[0]
    angle = kr * 0.03 / (kr + k * deep**2)  # the same moment against both springs
    assert found == pytest.approx([angle * deep, 0.0, 1e-3])


@pytest.mark.slow
def test_friction_of_an_arm_is_found_from_a_motion_that_touches_nothing(tmp_path):
    rig = load_rig("surgical", {"simulation": {"truth_seed": 1}})
    found = np.array(incision.fitted_friction(rig, "follower", tmp_path, 1))
    fed = np.array(rig.controller.parameters["follower_friction"])
    assert np.all(found > fed) and np.all(found < 3.0 * fed)


@pytest.mark.parametrize("form", [*incision.LAW_FORMS])
def test_every_form_passes_the_check_before_the_start(form):
    """With the stiffness of the rig file only the one that holds the shaft does."""
    gains = dict(incision.LAW_FORMS[form])
    built = build_controller(load_rig("surgical", {"controller": {"parameters": gains}}))
    assert isinstance(built, CartesianCoupling)
    of_the_rig = {k: v for k, v in gains.items() if k not in ("stiffness", "damping")}
    stiff = load_rig("surgical", {"controller": {"parameters": of_the_rig}})
    if form == incision.HELD_FORM:
        assert isinstance(build_controller(stiff), CartesianCoupling)
    else:
        with pytest.raises(ConfigError):
            build_controller(stiff)


def test_the_page_is_made_of_the_runs():
    names = [*incision.LAW_FORMS]
    names += [f + more for more in (incision.HALF_STIFF, incision.FITTED) for f in names[1:]]
    names.append(incision.HELD_FORM + incision.STIFF)
    one = {"off": 1e-3, "wall": 1.0, "tip": 2e-3, "turn": 1e-2, "felt": 3.0, "foreseen": 1e-3}
    data = {"rows": [{"name": n, **one} for n in names]}
    found = means(incision.PAGE, [data, data])
    assert [s.mean for s in found[incision.HELD_FORM]][:3] == [1.0, 1.0, 2.0]
    said = incision.PAGE.read(found)
    assert any("1.0 times the 2.00 mm" in line for line in said)
    assert any("something else adds to it" in line for line in said)  # twice what is foreseen
