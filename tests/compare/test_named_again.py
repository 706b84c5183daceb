"""Names that are looked at again: beside later effects, on the edge of a range, between rivals."""

import numpy as np
import pytest

from hil.bench.diagnosis import judge
from hil.bench.diagnosis.cases import Case, Hidden
from hil.compare.diagnose import diagnose
from hil.identify.projector import within
from hil.models import catalogue
from hil.models.model import base_model


def named(*hidden: Hidden, noise: str, excitation: str, seed: int) -> dict[str, set[str]]:
    """Names with their rivals, for effects hidden in a session of the arm."""
    kind = "one" if len(hidden) == 1 else "two"
    train, other = judge.recordings(Case(kind, "arm", hidden, noise, excitation, seed))
    found = diagnose(train, base_model(train[0].robot), other).findings
    return {f.effect: {f.effect, *f.rivals} for f in found}


def test_forms_that_only_a_later_effect_tells_alike_are_rivals():
    # beside a missing torque over position a lag fits better than the delay that it is
    late, torque = Hidden("delay", 1, 5.0), Hidden("position-torque", 1, 5.0)
    found = named(late, torque, noise="white", excitation="strokes", seed=101)
    assert len(found) == 2 and "position-torque" in found
    assert any({"delay", "actuator-lag"} <= names for names in found.values())


def test_a_later_effect_on_the_joint_may_change_the_name_of_the_first():
    stop, slow = Hidden("end-stop", 2, 5.0), Hidden("stribeck", 2, 5.0)
    found = named(stop, slow, noise="coloured", excitation="repeated", seed=100)
    assert set(found) == {"end-stop", "stribeck"}


def test_a_scale_on_the_edge_is_a_name_where_next_to_nothing_is_left():
    wobble = Hidden("encoder-eccentricity", 0, 5.0)
    assert set(named(wobble, noise="white", excitation="repeated", seed=0)) == {wobble.effect}


@pytest.mark.parametrize("bound", [0.9, 1.1])
def test_a_coefficient_on_its_bound_is_within_it_in_any_unit(bound: float) -> None:
    delay = catalogue.get("delay")
    for unit in np.geomspace(1e-3, 1e3, 997):
        assert within(delay, np.array([bound * unit]) / unit)
        assert not within(delay, np.array([bound + np.copysign(1e-6, bound - 1)]))
