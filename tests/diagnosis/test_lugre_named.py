"""LuGre, loops beside a Stribeck curve, and a Stribeck curve alone are told apart by name."""

import plants
import pytest

from hil.diagnosis.engine import diagnose
from hil.models.model import base_model


@pytest.mark.parametrize(
    ("law", "names", "form"),
    [
        (plants.lugre, {"presliding"}, 2.0),
        plants.further(plants.loops, {"presliding", "stribeck"}, 0.0),
        plants.further(plants.curve, {"stribeck"}, None),
    ],
)
@pytest.mark.slow
def test_each_is_named_as_what_it_is(law, names, form):
    runs = [plants.screw(law, seed) for seed in (1, 2)]
    out = diagnose(runs[:1], base_model(runs[0].robot), runs[1:])
    assert {f.effect for f in out.findings} == names
    if form is not None:
        values = {n.split(".")[-1]: v.value for n, v in out.findings[0].parameters.items()}
        assert values["form"] == form
    if law is plants.lugre:
        assert values["f1"] == pytest.approx(plants.SCREW_FC, rel=0.05)
        assert values["s"] == pytest.approx(plants.SCREW_FC / 8.0, rel=0.1)
